/* SPDX-License-Identifier: MIT */
/*
 * Exports of every codec, evaluated by software GL from their folders alone and compared with the C
 * evaluation, in each dialect of GLSL. Faults planted in shaders and files show that the comparison and the
 * reader notice them.
 */
#include "gl_host.h"
#include "ktx2_read.h"
#include "trial.h"

#include "gpu/gpu.h"

static const btf_context_desc defaults = BTF_CONTEXT_DESC_INIT;

static gpu_host *open_host(gl_dialect dialect) {
  const char *why;
  gpu_host *host = gl_host_open(dialect, &why);
  if (host == NULL) print_message("%s: %s\n", gl_dialect_name(dialect), why);
  return host;
}

/* ---- every codec ---- */

/* Settings whose shaders differ from those of all rows of the table. */
static const codec_case more_cases[] = {
    {.codec = "lafortune", .options = "kind=full,lobes=1,storage=f32", .channels = CHANNELS(3)},
    {.codec = "lafortune",
     .options = "color=channel,lobes=1",
     .channels = CHANNELS(1) | CHANNELS(2) | CHANNELS(3)},
    {.codec = "lafortune", .options = "lobes=3", .channels = CHANNELS(4)},
    {.codec = "lafortune", .options = "kind=phong", .channels = CHANNELS(3)},
    {.codec = "lafortune", .options = "kind=blinn_phong,color=channel", .channels = CHANNELS(2)},
    {.codec = "lafortune", .options = "kind=ward,lobes=2", .channels = CHANNELS(3)},
    {.codec = "lafortune", .options = "kind=lewis", .channels = CHANNELS(2)},
    {.codec = "cmf",
     .options = "edge=8,resolution=8,codebook=8,rotate=true,storage=f16",
     .channels = CHANNELS(3)},
    {.codec = "cmf",
     .options = "edge=8,resolution=8,codebook=0,rotate=true,levels=2",
     .channels = CHANNELS(3)},
    {.codec = "cmf", .options = "edge=7,resolution=8,codebook=8,chain=hd:3", .channels = CHANNELS(3)},
    {.codec = "cmf",
     .options = "edge=6,resolution=8,codebook=9,factors=4,map=cube,storage=f32",
     .channels = CHANNELS(3)},
    {.codec = "cmf", .options = "edge=8,codebook=16,method=homomorphic", .channels = CHANNELS(3)},
    {.codec = "lpca", .options = "clusters=5,components=6,storage=q8", .channels = CHANNELS(3)},
    {.codec = "lpca",
     .options = "clusters=3,components=3,storage=f32,packing=tight",
     .channels = CHANNELS(3)},
};

/* Indices of two bytes. */
static const codec_case large_rows[] = {
    {.codec = "cmf", .options = TRIAL_CMF_LARGE, .channels = CHANNELS(3)},
    {.codec = "lpca", .options = "clusters=300,components=2", .channels = CHANNELS(3)},
};

static void check_materials(gpu_host *host, btf_context *ctx, const codec_case *row,
                            const uint32_t *materials, size_t count) {
  for (size_t m = 0; m < count; m++)
    trial_row(host, ctx, row, materials[m], codec_case_channels(row, 3), TRIAL_RANDOM);
}

static void every_codec(void **state) {
  static const uint32_t materials[] = {MATERIAL_SMOOTH, MATERIAL_COSINE, MATERIAL_CLAMPED,
                                       MATERIAL_PAIR,   MATERIAL_ROW,    MATERIAL_TEXEL};
  gpu_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  uint32_t tried = 0;
  (void)state;
  if (host == NULL) skip();
  print_message("%s\n", host->name);
  assert_ok(codec_case_context(&defaults, &ctx));
  for (size_t r = 0; r < codec_case_count; r++) {
    const codec_case *row = &codec_cases[r];
    if (!trial_exports(ctx, row)) continue;
    check_materials(host, ctx, row, materials, sizeof materials / sizeof *materials);
    if (codec_case_channels(row, 1) == 1) trial_row(host, ctx, row, MATERIAL_SMOOTH, 1, TRIAL_RANDOM);
    tried++;
  }
  for (size_t r = 0; r < sizeof more_cases / sizeof *more_cases; r++) {
    const codec_case *row = &more_cases[r];
    if (!trial_exports(ctx, row)) continue;
    for (uint32_t n = codec_case_channels(row, 1); n != 0; n = codec_case_channels(row, n + 1)) {
      trial_row(host, ctx, row, MATERIAL_SMOOTH, n, TRIAL_RANDOM);
      trial_row(host, ctx, row, MATERIAL_COSINE, n, TRIAL_RANDOM);
    }
  }
  assert_true(tried > 0);
  for (size_t r = 0; r < sizeof large_rows / sizeof *large_rows; r++)
    if (trial_exports(ctx, &large_rows[r]))
      trial_row(host, ctx, &large_rows[r], MATERIAL_LARGE, 3, TRIAL_RANDOM);
  btf_context_release(ctx);
  host->close(host);
}

/* The first row of each codec in every dialect. */
static void every_dialect(void **state) {
  btf_context *ctx;
  (void)state;
  assert_ok(codec_case_context(&defaults, &ctx));
  for (int d = 0; d < GL_DIALECTS; d++) {
    gpu_host *host = open_host((gl_dialect)d);
    if (host == NULL) skip();
    print_message("%s\n", gl_dialect_name((gl_dialect)d));
    trial_first_rows(host, ctx, TRIAL_RANDOM);
    host->close(host);
  }
  btf_context_release(ctx);
}

static void pictures(void **state) {
  gpu_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  (void)state;
  if (host == NULL) skip();
  assert_ok(codec_case_context(&defaults, &ctx));
  trial_first_rows(host, ctx, TRIAL_PICTURE);
  btf_context_release(ctx);
  host->close(host);
}

/* ---- small targets ---- */

/* Targets whose limits are just above what a texture must have, so that the rest goes to more layers and more
 * textures; or below it. */
static void small_targets(void **state) {
  static const struct {
    codec_case row;
    btf_gpu_target target;
    bool fits;
  } trials[] = {
      /* 48 maps of 8 x 8, nine in a layer */
      {{.codec = "cmf", .options = "edge=8,resolution=8,codebook=16"},
       {.layout = "atlas", .max_2d = 24, .max_layers = 2},
       true},
      {{.codec = "cmf", .options = "edge=8,resolution=8,codebook=16"},
       {.layout = "stacks", .max_3d = 8},
       false},
      /* 4 x 3 views of 3 groups each */
      {{.codec = "pvpca", .options = "components=8"}, {.layout = "views", .max_layers = 7}, true},
      {{.codec = "pvpca", .options = "components=8"},
       {.layout = "views", .max_layers = 7, .max_textures = 8},
       false},
      /* 4 clusters of 2 groups in 3 channels */
      {{.codec = "lpca", .options = "clusters=4,components=8"}, {.layout = "full", .max_layers = 5}, true},
      {{.codec = "lpca", .options = "clusters=20"}, {.layout = "bytes", .max_3d = 17}, false},
  };
  const codec_dataset_recipe recipe = {MATERIAL_SMOOTH, 3, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  gpu_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  (void)state;
  if (host == NULL) skip();
  assert_ok(codec_case_context(&defaults, &ctx));
  for (size_t i = 0; i < sizeof trials / sizeof *trials; i++) {
    btf_gpu_target target = trials[i].target;
    btf_gpu_export *refused;
    btf_gpu_cost cost;
    btf_model *model;
    target.struct_size = sizeof target;
    if (btf_codec_find(ctx, trials[i].row.codec) == NULL) continue;
    assert_ok(codec_case_fit(ctx, &trials[i].row, &recipe, NULL, NULL, &model));
    if (trials[i].fits) {
      const trial_errors e = trial_run(host, model, &target, 0, TRIAL_RANDOM, NULL, &cost);
      print_message("%s %s: largest %.2g\n", trials[i].row.codec, target.layout, e.largest / e.peak);
      assert_true(e.beyond <= TRIAL_TOLERANCE * e.peak);
    } else {
      assert_status(btf_gpu_export_create(model, &target, &refused), BTF_E_LIMIT);
    }
    btf_model_release(model);
  }
  btf_context_release(ctx);
  host->close(host);
}

/* Flips every bit of bytes of a file; each must be noticed. */
static void expect_bits_to_count(const btfi_buffer *file, size_t at, size_t size, const char *what) {
  for (size_t bit = 8 * at; bit < 8 * (at + size); bit++) {
    ktx2_texture t;
    file->data[bit / 8] ^= (unsigned char)(1u << bit % 8);
    if (ktx2_read(file->data, file->size, &t) == NULL)
      fail_msg("bit %zu of byte %zu of the %s does not count", bit % 8, bit / 8 - at, what);
    ktx2_free(&t);
    file->data[bit / 8] ^= (unsigned char)(1u << bit % 8);
  }
}

/* The header has the descriptor's and the pairs' offsets and sizes in one byte each, as they are small. */
static void expect_file_as_specified(btf_context *ctx, uint32_t texel, uint32_t dimension) {
  enum { DESCRIPTOR = 48, PAIRS = 56, SIZE = 4 };
  btfi_gpu_texture texture = {.name = "btf_map",
                              .dimension = dimension,
                              .texel = texel,
                              .width = 5,
                              .height = 3,
                              .slices = dimension == BTF_TEXTURE_2D ? 1 : 2,
                              .level_count = 1};
  btfi_buffer file;
  ktx2_texture t;
  btfi_buffer_init(&file, ctx);
  assert_ok(btfi_gpu_texture_allocate(ctx, &texture));
  assert_ok(btfi_gpu_put_ktx2(&texture, 0, &file));
  const char *wrong = ktx2_read(file.data, file.size, &t);
  if (wrong != NULL) fail_msg("format %u: %s", texel, wrong);
  ktx2_free(&t);
  expect_bits_to_count(&file, file.data[DESCRIPTOR], file.data[DESCRIPTOR + SIZE], "descriptor");
  /* The first pair: its length, key and value. */
  expect_bits_to_count(&file, file.data[PAIRS], 4 + file.data[file.data[PAIRS]], "orientation");
  btfi_gpu_texture_free(ctx, &texture);
  btfi_buffer_free(&file);
}

static void files_are_as_specified(void **state) {
  static const uint32_t texels[] = {BTF_TEXEL_R8_UNORM,     BTF_TEXEL_RG8_UNORM,   BTF_TEXEL_RGBA8_UNORM,
                                    BTF_TEXEL_RGBA8_SNORM,  BTF_TEXEL_R16_FLOAT,   BTF_TEXEL_RG16_FLOAT,
                                    BTF_TEXEL_RGBA16_FLOAT, BTF_TEXEL_R32_FLOAT,   BTF_TEXEL_RG32_FLOAT,
                                    BTF_TEXEL_RGBA32_FLOAT, BTF_TEXEL_BC6H_UFLOAT, BTF_TEXEL_BC6H_SFLOAT,
                                    BTF_TEXEL_BC7_UNORM};
  btf_context *ctx;
  (void)state;
  assert_ok(btf_context_create(&defaults, &ctx));
  for (size_t i = 0; i < sizeof texels / sizeof *texels; i++) {
    expect_file_as_specified(ctx, texels[i], BTF_TEXTURE_2D);
    expect_file_as_specified(ctx, texels[i], BTF_TEXTURE_2D_ARRAY);
    if (btfi_texel_format_of(texels[i])->side == 1) expect_file_as_specified(ctx, texels[i], BTF_TEXTURE_3D);
  }
  btf_context_release(ctx);
}

static void faults_are_noticed(void **state) {
  gpu_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  (void)state;
  if (host == NULL) skip();
  assert_ok(codec_case_context(&defaults, &ctx));
  for (size_t i = 0; i < TRIAL_FAULTS; i++) trial_plant(host, ctx, &trial_faults[i]);
  btf_context_release(ctx);
  host->close(host);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_codec),        cmocka_unit_test(every_dialect),
      cmocka_unit_test(pictures),           cmocka_unit_test(small_targets),
      cmocka_unit_test(faults_are_noticed), cmocka_unit_test(files_are_as_specified)};
  return btf_run("gpu", tests);
}
