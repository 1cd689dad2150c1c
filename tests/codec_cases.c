/* SPDX-License-Identifier: MIT */
#include "codec_cases.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <btf/btf_plugin.h>

#define ANY (CHANNELS(1) | CHANNELS(3) | CHANNELS(4))
#define RGB CHANNELS(3)
#define KIB 1024u
/* What a fit of cmf holds beyond its count: its lists of factors, levels and codebooks (45 KiB), and what a
 * data set reads at once (64 KiB or a 32nd of the working set, which is 4 MiB at most); less the state of the
 * model (54 KiB), which is part of the result and not there yet. */
#define CMF_SLACK ((45 + 128 - 54) * KIB)

/* Tolerances. isa: sums of n products in another order differ by n 2^-24 of the sum of their magnitudes; rows
 * say more where n is large or signs cancel. threads, streamed: fits by closed formulas differ by rounding;
 * fits that go downhill until little is gained differ by what is left to gain. */
const codec_case codec_cases[] = {
    {.codec = "fmf",
     .options = "components=8",
     .channels = ANY,
     .faults = 1,
     .rmse = 2e-3,
     .level_rmse = 2e-3,
     .isa = 2e-6, /* up to 12 rows are blended, then 8 columns multiplied */
     .threads = 1e-5,
     .streamed = 1e-5,
     .slack = 256 * KIB},
    {.codec = "fmf",
     .options = "components=8,storage=f32,coding=plain,mean=true",
     .channels = ANY,
     .faults = 1,
     .rmse = 1e-3,
     .level_rmse = 1e-3,
     .isa = 2e-6,
     .threads = 1e-5,
     .streamed = 1e-5,
     .slack = 4608 * KIB /* the histogram that the statistics of the data are read from, by two threads */},
    {.codec = "fmf",
     .options = "components=6,storage=bf16,coding=plain",
     .channels = RGB,
     .rmse = 4e-3,
     .level_rmse = 4e-3,
     .isa = 2e-6,
     .threads = 1e-4,
     .streamed = 1e-4,
     .slack = 256 * KIB},
    {.codec = "fmf",
     .options = "components=6,storage=q8,levels=2",
     .channels = RGB,
     .rmse = 6e-3,
     .level_rmse = 6e-3,
     .isa = 2e-6,
     .threads = 1e-4,
     .streamed = 1e-4,
     .slack = 256 * KIB},

    {.codec = "lafortune",
     .options = "",
     .channels = ANY,
     .faults = 1,
     .rmse = 0.15,
     .level_rmse = 0.15,
     .isa = 1e-5,
     .threads = 1e-3,
     .streamed = 1e-3,
     .most_psnr = 32, /* of four lobes */
     .slack = 1024 * KIB},

    {.codec = "cmf",
     .options = "edge=8,resolution=8,codebook=8",
     .channels = ANY,
     .faults = 1,
     .rmse = 0.15,
     .level_rmse = 0.15,
     .isa = 1e-5,
     .threads = 1e-3,
     .streamed = 1e-3,
     .slack = CMF_SLACK},
    {.codec = "cmf",
     .options = "edge=8,resolution=8,codebook=0,map=cube,levels=2",
     .channels = ANY,
     .rmse = 0.15,
     .level_rmse = 0.15,
     .isa = 1e-5,
     .threads = 1e-3,
     .streamed = 1e-3,
     .slack = CMF_SLACK},
    /* 22 dB are 0.24 at most, as below. */
    {.codec = "cmf",
     .options = "edge=8,resolution=8,psnr=22,max_codebook=0,levels=2",
     .channels = RGB,
     .rmse = 0.24,
     .level_rmse = 0.24,
     .isa = 1e-5,
     .threads = 1e-3,
     .streamed = 1e-3,
     .slack = 4080 * KIB +
              CMF_SLACK /* the histogram: 255 Ki bins of 8 bytes, and of 4 for each of two threads */},

    /* Fits of pvpca add up in parts whose number is not that of the threads, and read the same matrices from
     * every source: bit for bit. Values that are mostly means have the rounding of halves, 2^-11 at most; of
     * bytes half of 1/127 of the largest, which is below 1.5 times the root mean square. The peak of PSNR is
     * below three times the root mean square of each material: 40 dB are 0.03 at most. */
    {.codec = "pvpca",
     .options = "components=8",
     .channels = ANY,
     .faults = 1,
     .rmse = 5e-4,
     .level_rmse = 5e-4,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "pvpca",
     .options = "mean=false,storage=q8",
     .channels = RGB,
     .rmse = 6e-3,
     .level_rmse = 6e-3,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "pvpca",
     .options = "psnr=40",
     .channels = RGB,
     .rmse = 0.03,
     .level_rmse = 0.03,
     .isa = 2e-6,
     .slack = 64 * KIB},
    /* What the lights do to the cosine material is 0.48 of its root mean square, and less than rmse: the
     * means of the views do. */
    {.codec = "pvpca",
     .options = "storage=q8,rmse=0.1,color=texels",
     .channels = ANY,
     .rmse = 0.5,
     .level_rmse = 0.2,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "pvpca",
     .options = "budget=adaptive,mean=false",
     .channels = RGB,
     .rmse = 5e-4,
     .level_rmse = 5e-4,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "pvpca",
     .options = "psnr=40,mean=false,budget=adaptive,storage=f32",
     .channels = RGB,
     .faults = 1,
     .rmse = 0.03,
     .level_rmse = 0.03,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "pvpca",
     .options = "components=5,color=texels,levels=2",
     .channels = RGB,
     .rmse = 5e-4,
     .level_rmse = 5e-4,
     .isa = 2e-6,
     .slack = 64 * KIB},

    {.codec = "lpca",
     .options = "",
     .channels = ANY,
     .faults = 1,
     .rmse = 5e-3,
     .level_rmse = 5e-3,
     .isa = 1e-5,
     .threads = 1e-3,
     .streamed = 1e-3,
     .slack = 64 * KIB},

    /* Between samples mean=phong is the analytic mean at the directions themselves, not the mean of the
     * samples around: on grids of 5 x 3 and 4 x 3 directions that is 0.139 of the data. Tables interpolate as
     * the data do, and add nothing. Components in halves have a rounding of 2^-11; 30 dB are 0.095 at most,
     * as above. */
    {.codec = "laplacian",
     .options = "",
     .channels = RGB,
     .faults = 1,
     .rmse = 5e-4,
     .level_rmse = 5e-4,
     .between = 0.145,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "laplacian",
     .options = "psnr=30,mean=table,filter=paper,levels=2,storage=f32",
     .channels = RGB,
     .faults = 1,
     .rmse = 0.095,
     .level_rmse = 0.095,
     .between = 1e-3,
     .isa = 2e-6,
     .slack = 64 * KIB},
    /* A target above all of the dark material leaves its mean alone, which is off by 0.201. */
    {.codec = "laplacian",
     .options = "rmse=0.02,filter=binomial",
     .channels = RGB,
     .rmse = 0.25,
     .level_rmse = 0.25,
     .between = 0.145,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "laplacian",
     .options = "y=3,cb=0,cr=1,budget=adaptive,storage=f32,filter=paper",
     .channels = RGB,
     .rmse = 0.25,
     .level_rmse = 0.25,
     .between = 0.145,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "laplacian",
     .options = "y=20,mean=table,levels=2",
     .channels = RGB,
     .rmse = 5e-4,
     .level_rmse = 5e-4,
     .between = 0.011,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "laplacian",
     .options = "levels=25",
     .channels = RGB,
     .rmse = 5e-4,
     .level_rmse = 5e-4,
     .between = 0.145,
     .isa = 2e-6,
     .slack = 64 * KIB},
    {.codec = "laplacian",
     .options = "rmse=1e-4,max_components=3",
     .channels = RGB,
     .rmse = 0.25,
     .level_rmse = 0.25,
     .between = 0.145,
     .isa = 2e-6,
     .slack = 64 * KIB},
};
const size_t codec_case_count = sizeof codec_cases / sizeof *codec_cases;

/* ---- making things ---- */

#ifndef TEST_CODEC_MODULES
#define TEST_CODEC_MODULES ""
#endif

btf_status codec_case_context(const btf_context_desc *desc, btf_context **out) {
  static const char modules[] = TEST_CODEC_MODULES; /* absolute paths with a colon between */
  btf_status status = btf_context_create(desc, out);
  for (const char *at = modules; status == BTF_OK && *at != '\0';) {
    char path[1024];
    const size_t length = strcspn(at, ":");
    snprintf(path, sizeof path, "%.*s", (int)length, at);
    status = btf_context_load_plugin(*out, path);
    at += length + (at[length] != '\0');
  }
  if (status != BTF_OK) {
    btf_context_release(*out);
    *out = NULL;
  }
  return status;
}

static btf_status set_all(btf_options *options, const char *list) {
  btf_status status = BTF_OK;
  for (const char *at = list; status == BTF_OK && *at != '\0';) {
    char text[128];
    const size_t length = strcspn(at, ",");
    snprintf(text, sizeof text, "%.*s", (int)length, at);
    char *value = strchr(text, '=');
    if (value == NULL) return BTF_E_STATE; /* a row is wrong */
    *value++ = '\0';
    status = btf_options_set(options, text, value);
    at += length + (at[length] != '\0');
  }
  return status;
}

btf_status codec_case_options(btf_context *ctx, const codec_case *row, const char *extra, btf_options **out) {
  btf_status status = btf_options_create(btf_codec_find(ctx, row->codec), out);
  if (status == BTF_OK) status = set_all(*out, row->options);
  if (status == BTF_OK && extra != NULL) status = set_all(*out, extra);
  if (status != BTF_OK) {
    btf_options_release(*out);
    *out = NULL;
  }
  return status;
}

btf_status codec_case_fit(btf_context *ctx, const codec_case *row, const codec_dataset_recipe *recipe,
                          const char *extra, const btf_job *job, btf_model **out) {
  btf_options *options;
  btf_dataset *ds;
  *out = NULL;
  btf_status status = codec_case_options(ctx, row, extra, &options);
  if (status != BTF_OK) return status;
  status = codec_material_dataset(ctx, recipe, &ds);
  if (status == BTF_OK) status = btf_model_fit(ds, btf_codec_find(ctx, row->codec), options, job, out);
  btf_dataset_release(ds);
  btf_options_release(options);
  return status;
}

uint32_t codec_case_channels(const codec_case *row, uint32_t from) {
  for (uint32_t n = from; n < 32; n++)
    if (row->channels & CHANNELS(n)) return n;
  return 0;
}

/* ---- queries ---- */

static uint32_t next(uint64_t *random) {
  *random = *random * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (uint32_t)(*random >> 32);
}

static float unit(uint64_t *random) {
  return (float)(next(random) >> 8) * (1.0f / 16777216.0f);
}

/* Uniform over the hemisphere above a height. */
static void direction(uint64_t *random, float lowest, float out[3]) {
  const float z = lowest + (1.0f - lowest) * unit(random), turn = 6.2831853f * unit(random);
  const float r = sqrtf(fmaxf(0.0f, 1.0f - z * z));
  out[0] = r * cosf(turn);
  out[1] = r * sinf(turn);
  out[2] = z;
}

static uint64_t seed_of(uint32_t i) {
  uint64_t random = (uint64_t)i * UINT64_C(0x9e3779b97f4a7c15) + 1;
  next(&random);
  next(&random);
  return random;
}

btf_query codec_case_plain_query(uint32_t i, float lod) {
  uint64_t random = seed_of(i);
  btf_query q = {.lod = lod};
  direction(&random, 0.2f, q.light);
  direction(&random, 0.2f, q.view);
  for (int k = 0; k < 2; k++) q.uv[k] = unit(&random);
  return q;
}

btf_query codec_case_query(uint32_t i) {
  static const float odd[] = {NAN,         INFINITY,     -INFINITY, 0.0f, -0.0f, 3.4e38f,
                              -3.4e38f,    1e-45f,       -1e-38f,   1.0f, -1.0f, 16777216.0f,
                              16777215.5f, 0.999999940f, 1e9f,      -0.3f};
  uint64_t random = seed_of(i), pair = seed_of(i / 4 + 1000000); /* directions stay for four queries */
  btf_query q = {{0}, {0}, {0}, 0.0f, 0};
  float *members[9] = {&q.light[0], &q.light[1], &q.light[2], &q.view[0], &q.view[1],
                       &q.view[2],  &q.uv[0],    &q.uv[1],    &q.lod};
  direction(&pair, 0.0f, q.light);
  direction(&pair, 0.0f, q.view);
  for (int k = 0; k < 2; k++) q.uv[k] = 6.0f * unit(&random) - 3.0f;
  q.lod = 7.0f * unit(&random) - 2.0f;
  switch (i % 8) {
  case 1: /* grazing */
    q.light[2] = next(&random) & 1 ? 1e-6f : 1e-38f;
    break;
  case 2:
    q.view[2] = -q.view[2];
    break;
  case 3:
    *members[next(&random) % 9] = odd[next(&random) % 16];
    break;
  case 5:
    for (int k = 0; k < 2; k++) q.uv[k] = (unit(&random) - 0.5f) * (next(&random) & 1 ? 1e7f : 1e30f);
    q.lod = next(&random) & 1 ? 1e9f : (float)(next(&random) % 4);
    break;
  case 6:
    if (i / 8 % 4 != 0) break;
    for (int k = 0; k < 9; k++) {
      const uint32_t bits = next(&random);
      memcpy(members[k], &bits, sizeof bits);
    }
    break;
  default:
    break;
  }
  return q;
}
