/* SPDX-License-Identifier: MIT */
/* A host that links libbtf: fits a constant material and evaluates it. */
#include <btf/btf.h>

#include <math.h>
#include <stdio.h>

static float samples[81 * 81];

int main(void) {
  btf_context *ctx;
  btf_dirset *directions;
  btf_dataset *ds;
  btf_model *model;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_query query = {{0.0f, 0.6f, 0.8f}, {0.0f, 0.0f, 1.0f}, {0.5f, 0.5f}, 0.0f, 0};
  float value = 0.0f;
  int i;
  if (btf_context_create(NULL, &ctx) != BTF_OK) return 1;
  if (btf_dirset_create_named(ctx, "ubo81", &directions) != BTF_OK) return 2;
  for (i = 0; i < 81 * 81; i++) samples[i] = 0.25f;
  desc.lights = desc.views = directions;
  desc.width = desc.height = desc.channels = 1;
  desc.data = samples;
  desc.strides.channel = desc.strides.x = desc.strides.y = sizeof(float);
  desc.strides.light = sizeof(float);
  desc.strides.view = 81 * sizeof(float);
  if (btf_dataset_create(ctx, &desc, &ds) != BTF_OK) return 3;
  if (btf_codec_find(ctx, "fmf") != NULL) {
    if (btf_model_fit(ds, btf_codec_find(ctx, "fmf"), NULL, NULL, &model) != BTF_OK) {
      fprintf(stderr, "%s\n", btf_error_message());
      return 4;
    }
  } else if (btf_model_from_dataset(ds, NULL, &model) != BTF_OK) {
    return 5;
  }
  btf_model_eval(model, &query, &value);
  printf("libbtf %u.%u.%u: %.4f\n", btf_version() >> 16, btf_version() >> 8 & 255u, btf_version() & 255u,
         value);
  btf_model_release(model);
  btf_dataset_release(ds);
  btf_dirset_release(directions);
  btf_context_release(ctx);
  /* Half precision keeps 11 bits, the packed coding 0.3 %. */
  return fabs((double)value - 0.25) < 0.25 * 0.004 ? 0 : 6;
}
