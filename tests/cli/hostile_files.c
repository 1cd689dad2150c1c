/* SPDX-License-Identifier: MIT */
/* Writes containers that no encoder makes, for the tests of the command: all their checksums are right.
 *   nan_fine.btfz, nan_coarse.btfz   a value of the finest or the coarsest level is NaN
 *   terminal.btfz                    metadata that would write to a terminal what it likes
 *   models.btfz                      two models with a note of each
 * Usage: hostile_files FOLDER. Status 77 if the build has no FMF codec. */
#include "btf_test.h"

#include "base/base.h"
#include "codec_material.h"
#include "container/format.h"
#include "container_image.h"

static btf_model *plain_model(btf_context *ctx, const btf_codec *codec) {
  const codec_dataset_recipe recipe = {MATERIAL_SMOOTH, 3, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  btf_dataset *dataset;
  btf_options *options;
  btf_model *model;
  assert_ok(codec_material_dataset(ctx, &recipe, &dataset));
  assert_ok(btf_options_create(codec, &options));
  assert_ok(btf_options_set(options, "coding", "plain"));
  assert_ok(btf_options_set(options, "storage", "f32"));
  assert_ok(btf_options_set(options, "components", "3"));
  assert_ok(btf_model_fit(dataset, codec, options, NULL, &model));
  btf_options_release(options);
  btf_dataset_release(dataset);
  return model;
}

static void write_image(btf_context *ctx, image *im, const btf_model *model, const char *key,
                        const char *value) {
  const btf_io io = image_sink(im);
  btf_writer *w;
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_ok(btf_writer_metadata(w, key, value));
  assert_ok(btf_writer_model(w, model, NULL));
  assert_ok(btf_writer_finish(w));
}

static void write_models(btf_context *ctx, image *im, const btf_model *model) {
  const btf_io io = image_sink(im);
  btf_writer *w;
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_ok(btf_writer_metadata(w, "setup", "a dome"));
  assert_ok(btf_writer_metadata(w, "btf.note.1.setup", "an arm"));
  for (int i = 0; i < 2; i++) assert_ok(btf_writer_model(w, model, NULL));
  assert_ok(btf_writer_finish(w));
}

static void write_file(const char *folder, const char *name, const image *im) {
  char path[4096];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  test_write_bytes(path, im->bytes, im->size);
}

/* The table of texels of the finest or of the coarsest level: the chunk's index is the level. */
static uint32_t texel_table(const image *im, bool coarsest) {
  uint32_t found = UINT32_MAX, level = 0;
  for (uint32_t i = 0; i < image_chunks(im); i++) {
    btfi_entry e;
    btfi_entry_decode(im->bytes + image_entry(im, i), &e);
    if (e.tag != (uint32_t)('V' | 'R' << 8 | 'O' << 16 | 'W' << 24)) continue;
    if (found != UINT32_MAX && (e.index > level) != coarsest) continue;
    found = i;
    level = e.index;
  }
  assert_true(found != UINT32_MAX);
  return found;
}

static void write_nan(btf_context *ctx, const btf_model *model, const char *folder, const char *name,
                      bool coarsest) {
  image im;
  btfi_entry e;
  uint32_t table;
  image_init(&im);
  write_image(ctx, &im, model, "note", "one NaN");
  table = texel_table(&im, coarsest);
  btfi_entry_decode(im.bytes + image_entry(&im, table), &e);
  image_put(&im, (size_t)e.offset, 4, 0x7fc00000);
  image_repair_chunk(&im, table);
  write_file(folder, name, &im);
  image_free(&im);
}

int main(int argc, char **argv) {
  btf_context *ctx;
  const btf_codec *codec;
  btf_model *model;
  image im;
  if (argc != 2 || btf_context_create(NULL, &ctx) != BTF_OK) return 1;
  codec = btf_codec_find(ctx, "fmf");
  if (codec == NULL || (btf_codec_caps(codec) & BTF_CAP_FIT) == 0) return 77;
  model = plain_model(ctx, codec);
  write_nan(ctx, model, argv[1], "nan_fine.btfz", false);
  write_nan(ctx, model, argv[1], "nan_coarse.btfz", true);
  image_init(&im);
  /* A line of its own, C1 controls (CSI and OSC), and a mark that turns the writing round. */
  write_image(ctx, &im, model,
              "x\nmodel 7\n  codec           trusted \xc2\x9b"
              "31m\xc2\x9d"
              "0;owned\xc2\x9c",
              "left\xe2\x80\xaeright\n  codec           mine\xc2\x85x");
  write_file(argv[1], "terminal.btfz", &im);
  image_free(&im);
  image_init(&im);
  write_models(ctx, &im, model);
  write_file(argv[1], "models.btfz", &im);
  image_free(&im);
  btf_model_release(model);
  btf_context_release(ctx);
  return 0;
}
