/* SPDX-License-Identifier: MIT */
/*
 * A data set that is computed on demand: the library pulls blocks of it while it fits, and never holds the
 * whole. Replace `read_block` by a reader of your own measurement format. example_source brushed.btfz
 */
#include <btf/btf.h>

#include <math.h>
#include <stdio.h>

typedef struct material {
  const float *lights, *views; /* 3 floats each */
} material;

/* A diffuse ground with a highlight whose sharpness changes along x. */
static float reflectance(const float *light, const float *view, uint32_t x, uint32_t y) {
  float half[3], length = 0.0f;
  for (int k = 0; k < 3; k++) half[k] = light[k] + view[k], length += half[k] * half[k];
  const float cosine = half[2] / sqrtf(length);
  return 0.1f + 0.05f * ((x / 4 + y / 4) % 2) + powf(cosine, 10.0f + 5.0f * (float)x);
}

static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const material *m = user;
  for (uint32_t v = 0; v < block->views; v++)
    for (uint32_t l = 0; l < block->lights; l++)
      for (uint32_t y = 0; y < block->height; y++)
        for (uint32_t x = 0; x < block->width; x++) {
          char *sample = (char *)dst + (ptrdiff_t)v * strides->view + (ptrdiff_t)l * strides->light +
                         (ptrdiff_t)y * strides->y + (ptrdiff_t)x * strides->x;
          *(float *)sample = reflectance(m->lights + 3 * (block->light0 + l),
                                         m->views + 3 * (block->view0 + v), block->x0 + x, block->y0 + y);
        }
  return BTF_OK; /* or: return btf_source_error(BTF_E_IO, "image %u is unreadable", number); */
}

int main(int argc, char **argv) {
  btf_context *ctx;
  btf_dirset *directions;
  btf_dataset *ds;
  btf_model *model;
  if (argc != 2) {
    fprintf(stderr, "usage: %s OUT.btfz\n", argv[0]);
    return 1;
  }
  if (btf_context_create(NULL, &ctx) != BTF_OK) goto failed;
  if (btf_dirset_create_named(ctx, "ubo81", &directions) != BTF_OK) goto failed;
  material m = {btf_dirset_directions(directions), btf_dirset_directions(directions)};

  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  desc.lights = desc.views = directions;
  desc.width = desc.height = 32;
  desc.channels = 1;
  desc.sample_type = BTF_SAMPLE_F32;
  desc.flags = BTF_DATASET_CONCURRENT_READ; /* read_block keeps no state */
  desc.read = read_block;
  desc.user = &m;
  if (btf_dataset_create(ctx, &desc, &ds) != BTF_OK) goto failed;
  if (btf_model_fit(ds, btf_codec_find(ctx, "fmf"), NULL, NULL, &model) != BTF_OK) goto failed;
  if (btf_model_save(model, argv[1], 0, "example_source", NULL) != BTF_OK) goto failed;
  printf("saved %s\n", argv[1]);

  btf_model_release(model);
  btf_dataset_release(ds);
  btf_dirset_release(directions);
  btf_context_release(ctx);
  return 0;
failed:
  fprintf(stderr, "%s\n", btf_error_message());
  return 2;
}
