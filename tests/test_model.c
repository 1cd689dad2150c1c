/* SPDX-License-Identifier: MIT */
/* Models: fitting, storing, evaluating. */
#include "btf_test.h"
#include "copy_codec.h"
#include "model/model.h"

#include <float.h>

static btf_model *fit(btf_context *ctx, const char *id, uint32_t channels, uint32_t quantity, const char *storage) {
  btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, channels, quantity);
  const btf_codec *codec = btf_codec_find(ctx, id);
  btf_options *options;
  btf_model *model;
  assert_non_null(ds);
  if (codec == NULL) {
    assert_ok(btf_context_register(ctx, &copy_codec));
    assert_ok(btf_context_register(ctx, &copy_codec_single));
    codec = btf_codec_find(ctx, id);
  }
  assert_non_null(codec);
  assert_ok(btf_options_create(codec, &options));
  assert_ok(btf_options_set(options, "storage", storage));
  assert_ok(btf_model_fit(ds, codec, options, NULL, &model));
  btf_options_release(options);
  btf_dataset_release(ds);
  return model;
}

static void save_and_load(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model = fit(ctx, "org.libbtf.copy", 3, BTF_QUANTITY_BRDF, "plain"), *loaded;
  float expected[3], got[3];
  (void)state;
  assert_ok(btf_model_save(model, test_path("a.btfz"), 0, "make it", NULL));
  assert_ok(btf_model_load(ctx, test_path("a.btfz"), &loaded));
  for (uint32_t view = 0; view < 6; view++)
    for (uint32_t light = 0; light < 6; light++)
      for (uint32_t y = 0; y < 4; y++)
        for (uint32_t x = 0; x < 5; x++) {
          btf_model_texel(model, 0, x, y, light, view, expected);
          btf_model_texel(loaded, 0, x, y, light, view, got);
          for (uint32_t c = 0; c < 3; c++) assert_true(got[c] == copy_codec_sample(view, light, x, y, c));
          assert_memory_equal(expected, got, sizeof got);
        }
  btf_model_release(loaded);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(save_and_load),
  };
  return btf_run("model", tests);
}
