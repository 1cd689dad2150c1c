/* SPDX-License-Identifier: MIT */
/*
 * Opens a material (a .btfz file or a data-set folder) and evaluates it: one query, then a batch.
 *   example_evaluate wool.btfz
 */
#include <btf/btf.h>

#include <math.h>
#include <stdio.h>

enum { QUERIES = 8 };

int main(int argc, char **argv) {
  btf_context *ctx;
  btf_model *model;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  if (argc != 2) {
    fprintf(stderr, "usage: %s MATERIAL\n", argv[0]);
    return 1;
  }
  if (btf_context_create(NULL, &ctx) != BTF_OK || btf_model_load(ctx, argv[1], &model) != BTF_OK) {
    fprintf(stderr, "%s\n", btf_error_message());
    return 2;
  }
  btf_model_describe(model, &info);
  printf("%s: %u x %u texels, %u channels, %u levels, %.1f MiB to evaluate\n", info.codec_id, info.width,
         info.height, info.channels, info.levels, (double)info.resident_bytes / 1048576.0);

  /* One query: f per channel in 1/sr, without the cosine. */
  btf_query query = {{0.0f, 0.6f, 0.8f}, {0.6f, 0.0f, 0.8f}, {0.25f, 0.75f}, 0.0f, 0};
  float f[64];
  btf_model_eval(model, &query, f);
  printf("f = %g", f[0]);
  for (uint32_t c = 1; c < info.channels; c++) printf(" %g", f[c]);
  printf("\n");

  /* A batch: a light that sinks from the zenith to the horizon, seen from above; first channel printed. */
  float light[3][QUERIES], view[3][QUERIES], uv[2][QUERIES], values[64][QUERIES];
  float *out[64];
  for (int i = 0; i < QUERIES; i++) {
    const float theta = 1.5f * (float)i / (QUERIES - 1);
    light[0][i] = sinf(theta), light[1][i] = 0.0f, light[2][i] = cosf(theta);
    view[0][i] = view[1][i] = 0.0f, view[2][i] = 1.0f;
    uv[0][i] = uv[1][i] = 0.5f;
  }
  for (int c = 0; c < 64; c++) out[c] = values[c];
  btf_batch batch = BTF_BATCH_INIT;
  batch.count = QUERIES;
  for (int k = 0; k < 3; k++) batch.light[k] = light[k], batch.view[k] = view[k];
  batch.uv[0] = uv[0], batch.uv[1] = uv[1];
  btf_model_eval_n(model, &batch, BTF_VALUE_BRDF, out);
  for (int i = 0; i < QUERIES; i++) printf("light z %.3f: f = %g\n", light[2][i], values[0][i]);

  btf_model_release(model);
  btf_context_release(ctx);
  return 0;
}
