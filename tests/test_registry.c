/* SPDX-License-Identifier: MIT */
/* The registry's door, options, and plug-ins by path. TEST_MEAN_PLUGIN is the example's module, TEST_PLUGINS
 * the folder of those that must be refused. */
#include "btf_test.h"

#include <locale.h>
#include <sys/stat.h>

#include "copy_codec.h"
#include "registry/registry.h"

extern const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi); /* the example, linked in as well */

/* A copy of a good codec with a range of parameters to spoil. */
static btf_codec_vtbl good(void) {
  btf_codec_vtbl v = copy_codec;
  v.id = "org.example.good";
  return v;
}

static void expect_refusal(const btf_codec_vtbl *v, btf_status expected, const char *part) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const uint32_t before = btf_codec_count(ctx);
  const btf_status status = btf_context_register(ctx, v);
  if (status != expected)
    fail_msg("%s instead of %s: %s (%s)", btf_status_name(status), btf_status_name(expected),
             btf_error_message(), part);
  if (expected != BTF_OK) assert_message_has(part);
  assert_int_equal(btf_codec_count(ctx), before + (expected == BTF_OK));
  test_context_done(ctx, &memory);
}

static void door(void **state) {
  btf_codec_vtbl v = good();
  struct {
    btf_codec_vtbl known;
    void *unknown;
  } longer = {good(), NULL};
  (void)state;
  expect_refusal(&v, BTF_OK, "");
#define REFUSE(change, status, part)                                                                         \
  v = good();                                                                                                \
  change;                                                                                                    \
  expect_refusal(&v, status, part)
  REFUSE(v.abi = LIBBTF_ABI + 1, BTF_E_ABI, "ABI 2");
  REFUSE(v.struct_size = offsetof(btf_codec_vtbl, texel), BTF_E_ABI, "table");
  REFUSE(v.struct_size = 0xffffffffu, BTF_E_ABI, "absurd");
  REFUSE(v.id = NULL, BTF_E_PLUGIN, "id");
  REFUSE(v.id = "", BTF_E_PLUGIN, "id");
  REFUSE(v.id = "Org.example", BTF_E_PLUGIN, "[a-z0-9._-]");
  REFUSE(v.id = "org.example.with space", BTF_E_PLUGIN, "[a-z0-9._-]");
  REFUSE(v.id = "org.a23456789012345678901234567890123456789012345678901234567890", BTF_E_PLUGIN, "1 to 63");
  REFUSE(v.id = "short", BTF_E_PLUGIN, "org.example.short");
  REFUSE(v.title = NULL, BTF_E_PLUGIN, "title");
  REFUSE(v.title = "two\nlines", BTF_E_PLUGIN, "title");
  REFUSE(v.format_read_min = 3, BTF_E_PLUGIN, "payload versions");
  REFUSE(v.load = NULL, BTF_E_PLUGIN, "`load`");
  REFUSE(v.destroy = NULL, BTF_E_PLUGIN, "`destroy`");
  REFUSE(v.levels = NULL, BTF_E_PLUGIN, "`levels`");
  REFUSE(v.resident_bytes = NULL, BTF_E_PLUGIN, "`resident_bytes`");
  REFUSE(v.eval = NULL, BTF_E_PLUGIN, "`eval`");
  REFUSE(v.texel = NULL, BTF_E_PLUGIN, "`texel`");
  REFUSE(v.fit = NULL, BTF_E_PLUGIN, "BTF_CAP_FIT");
  REFUSE(v.caps = BTF_CAP_BATCH, BTF_E_PLUGIN, "BTF_CAP_FIT");
  REFUSE(v.eval_n = NULL, BTF_E_PLUGIN, "BTF_CAP_BATCH");
  REFUSE(v.caps = BTF_CAP_FIT, BTF_E_PLUGIN, "BTF_CAP_BATCH");
  REFUSE(v.caps |= (uint64_t)1 << 40, BTF_E_PLUGIN, "capability");
  REFUSE(v.fit = NULL; v.caps = BTF_CAP_BATCH | BTF_CAP_STREAM_FIT, BTF_E_PLUGIN, "STREAM");
#undef REFUSE
  longer.known.struct_size = sizeof longer;
  expect_refusal(&longer.known, BTF_OK, "");
  longer.unknown = &longer;
  expect_refusal(&longer.known, BTF_E_ABI, "newer");
}

static void parameters(void **state) {
  static const char *const choices[] = {"a", "b", NULL}, *const repeated[] = {"a", "a", NULL},
                           *const none[] = {NULL};
  const btf_param_desc number = {sizeof number, "size", "A size.", NULL, "3", NULL, 1, 5, BTF_PARAM_INT, 0};
  const btf_param_desc choice = {sizeof choice,    "mode", "A mode.", NULL, "b", choices, 0, 0,
                                 BTF_PARAM_CHOICE, 0};
  btf_param_desc one, two;
  const btf_param_desc *list[] = {&one, &two, NULL};
  btf_codec_vtbl v = good();
  (void)state;
  v.params = list;
#define TRY(change, status, part)                                                                            \
  one = number;                                                                                              \
  two = choice;                                                                                              \
  change;                                                                                                    \
  expect_refusal(&v, status, part)
  TRY((void)0, BTF_OK, "");
  TRY(one.name = "mode", BTF_E_PLUGIN, "mode occurs twice");
  TRY(one.name = NULL, BTF_E_PLUGIN, "[a-z0-9_]");
  TRY(one.name = "a-b", BTF_E_PLUGIN, "[a-z0-9_]");
  TRY(one.name = "", BTF_E_PLUGIN, "[a-z0-9_]");
  TRY(one.type = 0, BTF_E_PLUGIN, "type 0");
  TRY(one.type = 6, BTF_E_PLUGIN, "type 6");
  TRY(one.summary = NULL, BTF_E_PLUGIN, "summary");
  TRY(one.default_text = NULL, BTF_E_PLUGIN, "default");
  TRY(one.default_text = "6", BTF_E_PLUGIN, "size: 6 is outside 1 to 5");
  TRY(one.default_text = "0", BTF_E_PLUGIN, "size: 0 is outside 1 to 5");
  TRY(one.default_text = "2.5", BTF_E_PLUGIN, "whole number");
  TRY(one.default_text = "", BTF_E_PLUGIN, "whole number");
  TRY(one.minimum = 6, BTF_E_PLUGIN, "empty");
  TRY(one.minimum = NAN, BTF_E_PLUGIN, "empty");
  TRY(one.maximum = 1e17, BTF_E_PLUGIN, "2^53");
  TRY(one.maximum = INFINITY, BTF_OK, "");
  TRY(one.type = BTF_PARAM_FLOAT; one.default_text = "2.5e0", BTF_OK, "");
  TRY(one.choices = choices, BTF_E_PLUGIN, "only a choice");
  TRY(one.flags = 4, BTF_E_PLUGIN, "size: flags is 0x4");
  TRY(one.struct_size = 8, BTF_E_ABI, "btf_param_desc");
  TRY(two.default_text = "c", BTF_E_PLUGIN, "a, b");
  TRY(two.choices = NULL, BTF_E_PLUGIN, "at least one");
  TRY(two.choices = none, BTF_E_PLUGIN, "at least one");
  TRY(two.choices = repeated, BTF_E_PLUGIN, "\"a\" occurs twice");
  TRY(two.type = BTF_PARAM_BOOL; two.choices = NULL, BTF_E_PLUGIN, "neither true nor false");
#undef TRY
}

/* A codec of the first version hands svd a shorter result, in a build without fitting too. */
static void results_of_old_codecs_are_not_overrun(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const size_t first_size = offsetof(btf_svd_result, least_working_set);
  btf_svd_result result;
  (void)state;
  memset(&result, 0x5a, sizeof result);
  result.struct_size = first_size;
  assert_true(btfi_host()->svd(ctx, NULL, NULL, 0.0, 1.0, &result) != BTF_OK);
  assert_int_equal(result.struct_size, first_size);
  assert_null(result.sigma);
  assert_int_equal(result.least_working_set, UINT64_C(0x5a5a5a5a5a5a5a5a));
  test_context_done(ctx, &memory);
}

static void codecs_describe_themselves(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_param_desc desc = {0};
  const btf_codec *codec;
  const uint32_t before = btf_codec_count(ctx);
  (void)state;
  assert_ok(btf_context_register(ctx, &copy_codec));
  assert_status(btf_context_register(ctx, &copy_codec), BTF_E_PLUGIN);
  assert_message_has("org.libbtf.copy: a codec of this id is registered already");
  assert_int_equal(btf_codec_count(ctx), before + 1);
  codec = btf_codec_find(ctx, "org.libbtf.copy");
  assert_non_null(codec);
  assert_ptr_equal(codec, btf_codec_at(ctx, before));
  assert_null(btf_codec_at(ctx, before + 1));
  assert_null(btf_codec_find(ctx, "org.libbtf.cop"));
  assert_null(btf_codec_find(ctx, NULL));
  assert_string_equal(btf_codec_title(codec), "Keeps every sample");
  assert_int_equal(btf_codec_caps(codec), BTF_CAP_FIT | BTF_CAP_BATCH);
  assert_int_equal(btf_codec_param_count(codec), 5);
  desc.struct_size = sizeof desc;
  assert_ok(btf_codec_param(codec, 3, &desc));
  assert_string_equal(desc.name, "storage");
  assert_string_equal(desc.choices[1], "packed");
  assert_status(btf_codec_param(codec, 5, &desc), BTF_E_INVALID_ARG);
  desc.struct_size = 4;
  assert_status(btf_codec_param(codec, 0, &desc), BTF_E_ABI);
  for (uint32_t i = 0; i < btf_codec_count(ctx); i++) /* what is built in passes the same door */
    assert_true(strlen(btf_codec_title(btf_codec_at(ctx, i))) > 0);
  test_context_done(ctx, &memory);
}

static void options(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const btf_codec *codec;
  btf_options *o;
  char text[16];
  static const struct {
    const char *name, *value;
    btf_status status;
    double number;
    const char *message;
  } cases[] = {
      {"rounds", "1024", BTF_OK, 1024, NULL},
      {"rounds", "+7", BTF_OK, 7, NULL},
      {"rounds", "0", BTF_E_INVALID_ARG, 7, "rounds: 0 is outside 1 to 1024"},
      {"rounds", "1025", BTF_E_INVALID_ARG, 7, "rounds: 1025 is outside 1 to 1024"},
      {"rounds", "many", BTF_E_INVALID_ARG, 7, "rounds: \"many\" is not a whole number; it takes 1 to 1024"},
      {"rounds", "3.0", BTF_E_INVALID_ARG, 7, "whole number"},
      {"rounds", " 3", BTF_E_INVALID_ARG, 7, "whole number"},
      {"rounds", "0x10", BTF_E_INVALID_ARG, 7, "whole number"},
      {"rounds", "99999999999999999999", BTF_E_INVALID_ARG, 7, "rounds"},
      {"gain", "2.5", BTF_OK, 2.5, NULL},
      {"gain", ".5", BTF_OK, 0.5, NULL},
      {"gain", "1e1", BTF_OK, 10.0, NULL},
      {"gain", "2,5", BTF_E_INVALID_ARG, 10.0, "gain: \"2,5\" is not a number; it takes 0 to 10"},
      {"gain", "nan", BTF_E_INVALID_ARG, 10.0, "not a number"},
      {"gain", "inf", BTF_E_INVALID_ARG, 10.0, "not a number"},
      {"gain", "1e999", BTF_E_INVALID_ARG, 10.0, "gain"},
      {"gain", "-0.1", BTF_E_INVALID_ARG, 10.0, "gain: -0.1 is outside 0 to 10"},
      {"gain", "1e", BTF_E_INVALID_ARG, 10.0, "not a number"},
      {"blocked", "yes", BTF_OK, 1.0, NULL},
      {"blocked", "off", BTF_OK, 0.0, NULL},
      {"blocked", "maybe", BTF_E_INVALID_ARG, 0.0, "blocked: \"maybe\" is neither true nor false"},
      {"storage", "packed", BTF_OK, 1.0, NULL},
      {"storage", "PACKED", BTF_E_INVALID_ARG, 1.0, "storage: \"PACKED\" is not one of plain, packed"},
      {"note", "W\xc3\xbcrzburg", BTF_OK, 0.0, NULL},
      {"colour", "1", BTF_E_INVALID_ARG, 0.0,
       "org.libbtf.copy has no parameter \"colour\"; it has gain, rounds, blocked, storage, note"},
  };
  (void)state;
  assert_ok(btf_context_register(ctx, &copy_codec));
  codec = btf_codec_find(ctx, copy_codec.id);
  assert_ok(btf_options_create(codec, &o));
  assert_true(btfi_option(o, "gain") == 1.0);
  assert_int_equal(btfi_option_is_set(o, "gain"), 0);
  assert_ok(btf_options_get(o, "gain", text, sizeof text));
  assert_string_equal(text, "1");
  setlocale(LC_ALL, "de_DE.UTF-8"); /* where there is one, it must make no difference */
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    assert_status(btf_options_set(o, cases[i].name, cases[i].value), cases[i].status);
    if (cases[i].message != NULL) assert_message_has(cases[i].message);
    assert_true(btfi_option(o, cases[i].name) == cases[i].number);
  }
  setlocale(LC_ALL, "C");
  assert_int_equal(btfi_option_is_set(o, "gain"), 1);
  assert_string_equal(btfi_option_text(o, "note"), "W\xc3\xbcrzburg");
  assert_null(btfi_option_text(o, "colour"));
  assert_ok(btf_options_get(o, "storage", text, 7));
  assert_string_equal(text, "packed");
  assert_status(btf_options_get(o, "storage", text, 6), BTF_E_LIMIT);
  assert_string_equal(text, "");
  assert_status(btf_options_get(o, "colour", text, 6), BTF_E_INVALID_ARG);
  btf_options_release(o);
  btf_options_release(NULL);
  assert_status(btf_options_create(NULL, &o), BTF_E_INVALID_ARG);
  assert_null(o);
  test_context_done(ctx, &memory);
}

/* ---- plug-ins ---- */

/* A rank-1 material, which the mean codec reproduces: the product of something of x, y and of something of
 * light, view. */
static btf_status read_separable(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  (void)user;
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++) {
          const float value = (1.0f + (float)(b->x0 + x)) * (2.0f + (float)(b->y0 + y)) *
                              (1.0f + 0.5f * (float)(b->light0 + l)) * (3.0f + (float)(b->view0 + v));
          memcpy((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                     (ptrdiff_t)x * s->x,
                 &value, sizeof value);
        }
  return BTF_OK;
}

static void use_mean_codec(btf_context *ctx) {
  const btf_codec *codec = btf_codec_find(ctx, "org.example.mean");
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_options *o;
  btf_dataset *ds;
  btf_dirset *set;
  btf_model *model, *loaded;
  assert_non_null(codec);
  assert_ok(btf_dirset_create_named(ctx, "grid:4x2", &set));
  desc.lights = desc.views = set;
  desc.width = 4;
  desc.height = 3;
  desc.channels = 1;
  desc.read = read_separable;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btf_model_fit(ds, codec, NULL, NULL, &model));
  assert_ok(btf_model_save(model, test_path("mean.btfz"), 0, NULL, NULL));
  assert_ok(btf_model_load(ctx, test_path("mean.btfz"), &loaded));
  for (uint32_t i = 0; i < 4 * 3 * 8 * 8; i++) {
    const uint32_t x = i % 4, y = i / 4 % 3, light = i / 12 % 8, view = i / 96;
    const float expected =
        (1.0f + (float)x) * (2.0f + (float)y) * (1.0f + 0.5f * (float)light) * (3.0f + (float)view);
    const float *l = btf_dirset_directions(set) + 3 * light, *v = btf_dirset_directions(set) + 3 * view;
    const btf_query query = {{l[0], l[1], l[2]},
                             {v[0], v[1], v[2]},
                             {((float)x + 0.5f) / 4.0f, ((float)y + 0.5f) / 3.0f},
                             0.0f,
                             0};
    float got, again;
    /* Two factors rounded to floats and their rounded product: at most 2^-22; interpolation adds as much
     * again. */
    btf_model_texel(loaded, 0, x, y, light, view, &got);
    assert_relative(got, expected, 5e-7);
    btf_model_eval(loaded, &query, &got);
    assert_relative(got, expected, 2e-6);
    btf_model_eval(model, &query, &again);
    assert_memory_equal(&got, &again, sizeof got);
  }
  btf_model_release(loaded);
  btf_model_release(model);
  /* Without contrast the texture is its mean colour: (1 + ... + 4) / 4 times (2 + 3 + 4) / 3. */
  assert_ok(btf_options_create(codec, &o));
  assert_ok(btf_options_set(o, "contrast", "0"));
  assert_ok(btf_model_fit(ds, codec, o, NULL, &model));
  for (uint32_t x = 0; x < 4; x++) {
    float got;
    btf_model_texel(model, 0, x, 2, 0, 0, &got);
    assert_relative(got, 2.5f * 3.0f * 1.0f * 3.0f, 5e-7);
  }
  btf_options_release(o);
  btf_model_release(model);
  btf_dataset_release(ds);
  btf_dirset_release(set);
}

static void example_registered(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  (void)state;
  assert_ok(btf_context_register(ctx, BTF_PLUGIN_ENTRY(LIBBTF_ABI)->codecs[0]));
  use_mean_codec(ctx);
  test_context_done(ctx, &memory);
}

static void example_loaded(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model;
  (void)state;
  assert_ok(btf_context_load_plugin(ctx, TEST_MEAN_PLUGIN));
  use_mean_codec(ctx);
  assert_status(btf_context_load_plugin(ctx, TEST_MEAN_PLUGIN), BTF_E_PLUGIN);
  assert_message_has("registered already");
  /* A model outlives the caller's context, and with it the module whose code evaluates it. */
  assert_ok(btf_model_load(ctx, test_path("mean.btfz"), &model));
  btf_context_release(ctx);
  {
    float value;
    btf_model_texel(model, 0, 0, 0, 0, 0, &value);
    assert_relative(value, 6.0f, 5e-7);
  }
  btf_model_release(model);
  assert_int_equal(memory.live_blocks, 0);
}

static void refused_modules(void **state) {
  static const struct {
    const char *module, *part;
  } cases[] = {
      {"wrong_abi", "built for ABI 2; this library has ABI 1"},
      {"newer_host", "needs a newer libbtf"},
      {"codec_abi", "ABI 2"},
      {"no_entry", "btf_plugin_entry_1"},
      {"refuses", "refuses this library"},
      {"empty", "0 codecs"},
      {"bad_id", "[a-z0-9._-]"},
      {"own_id", "without a dot"},
      {"taken_id", "registered already"},
      {"twice", "twice"},
      {"default", "level: 11 is outside 0 to 10"},
      {"second", "`eval`"}, /* the first codec is fine: all or none */
  };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const uint32_t own = btf_codec_count(ctx);
  char path[600];
  (void)state;
  assert_ok(btf_context_load_plugin(ctx, TEST_MEAN_PLUGIN));
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    snprintf(path, sizeof path, "%s/refused_%s.so", TEST_PLUGINS, cases[i].module);
    assert_status(btf_context_load_plugin(ctx, path), BTF_E_PLUGIN);
    assert_message_has(cases[i].part);
    assert_message_has(path);
    assert_int_equal(btf_codec_count(ctx), own + 1);
  }
  snprintf(path, sizeof path, "%s/refused_nothing.so", TEST_PLUGINS); /* the same source with nothing wrong */
  assert_ok(btf_context_load_plugin(ctx, path));
  assert_int_equal(btf_codec_count(ctx), own + 3);
  test_context_done(ctx, &memory);
}

static void refused_paths(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  FILE *text;
  (void)state;
  assert_status(btf_context_load_plugin(ctx, "org.example.mean.so"), BTF_E_PLUGIN);
  assert_message_has("absolute path");
  assert_status(btf_context_load_plugin(ctx, ""), BTF_E_PLUGIN);
  assert_status(btf_context_load_plugin(ctx, "/no/such/module.so"), BTF_E_PLUGIN);
  assert_message_has("/no/such/module.so");
  assert_status(btf_context_load_plugin(ctx, test_folder()), BTF_E_PLUGIN);
  assert_message_has("regular file");
  assert_int_equal(mkfifo(test_path("pipe.so"), 0600), 0);
  assert_status(btf_context_load_plugin(ctx, test_path("pipe.so")), BTF_E_PLUGIN);
  text = fopen(test_path("text.so"), "w");
  assert_non_null(text);
  fputs("not a module", text);
  fclose(text);
  assert_status(btf_context_load_plugin(ctx, test_path("text.so")), BTF_E_PLUGIN);
  assert_message_has("text.so");
  assert_status(btf_context_load_plugin(ctx, NULL), BTF_E_INVALID_ARG);
  test_context_done(ctx, &memory);
}

/* Each allocation fails in turn while a codec is registered, a plug-in loaded and options are made. */
static void out_of_memory(void **state) {
  (void)state;
  for (long n = 1;; n++) {
    test_memory memory;
    btf_context *ctx = test_context(&memory);
    const uint32_t before = btf_codec_count(ctx);
    btf_options *o = NULL;
    btf_status status;
    memory.fail_at = memory.total_allocations + n;
    status = btf_context_register(ctx, &copy_codec);
    if (status == BTF_OK)
      status = btf_context_load_plugin(ctx, TEST_MEAN_PLUGIN);
    else
      assert_int_equal(btf_codec_count(ctx), before);
    if (status == BTF_OK) status = btf_options_create(btf_codec_find(ctx, copy_codec.id), &o);
    if (status == BTF_OK) status = btf_options_set(o, "gain", "2");
    if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
    btf_options_release(o);
    test_context_done(ctx, &memory);
    if (status == BTF_OK) {
      assert_true(n > 6);
      break;
    }
  }
}

/* ---- formats ---- */

/* What the host table offers formats for text, by known answers. */
static void host_reads_text(void **state) {
  static const char text[] = "{\"a\": [1, 2.5e1, \"x\"], \"b\": null}";
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const btf_host *host = btfi_host();
  double number = 7;
  btf_json *document = NULL;
  (void)state;
  assert_int_equal((host->number)("-12.5e1", &number), 1);
  assert_true(number == -125.0);
  for (size_t i = 0; i < 6; i++) {
    static const char *const wrong[] = {"", "nan", "1,5", "1e999", "0x1", "1 "};
    assert_int_equal((host->number)(wrong[i], &number), 0);
  }
  assert_true(number == -125.0);
  assert_ok((host->json_parse)(ctx, "name", text, sizeof text - 1, &document));
  assert_int_equal((host->json_type)(document), BTF_JSON_OBJECT);
  const btf_json *list = (host->json_get)(document, "a");
  assert_int_equal((host->json_type)(list), BTF_JSON_ARRAY);
  assert_int_equal((host->json_length)(list), 3);
  assert_true((host->json_number)((host->json_at)(list, 1)) == 25.0);
  assert_string_equal((host->json_string)((host->json_at)(list, 2)), "x");
  assert_null((host->json_at)(list, 3));
  assert_int_equal((host->json_type)((host->json_get)(document, "b")), BTF_JSON_NULL);
  assert_null((host->json_get)(document, "c"));
  (host->json_free)(document);
  assert_status((host->json_parse)(ctx, "name", "[1,", 3, &document), BTF_E_CORRUPT);
  assert_message_has("name: line 1, column 4");
  assert_null(document);
  test_context_done(ctx, &memory);
}

static uint32_t probe_never(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx, (void)probe;
  return 0;
}
static uint32_t probe_length(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && probe->size == 5 && probe->head_size == 5 &&
                 memcmp(probe->head, "12345", 5) == 0
             ? 100
             : 0;
}
static btf_status open_unsupported(const btf_host *host, btf_context *ctx, const char *path,
                                   const btf_options *options, btf_dataset **out) {
  (void)out;
  (void)(host->option)(options, "no such parameter");
  return (host->fail)(ctx, BTF_E_UNSUPPORTED, "%s: is only recognised", path);
}

static btf_format_vtbl good_format(void) {
  return (btf_format_vtbl){.struct_size = sizeof(btf_format_vtbl),
                           .abi = LIBBTF_ABI,
                           .id = "org.example.five",
                           .title = "Five digits",
                           .probe = probe_length,
                           .open = open_unsupported};
}

static btf_status register_formats(btf_context *ctx, const btf_format_vtbl *first,
                                   const btf_format_vtbl *second) {
  const btf_format_vtbl *const formats[] = {first, second};
  const btf_plugin_info info = {.struct_size = sizeof info,
                                .abi = LIBBTF_ABI,
                                .name = "test",
                                .license = "MIT",
                                .host_size_needed = sizeof(btf_host),
                                .formats = formats,
                                .format_count = second != NULL ? 2 : 1};
  return btf_context_register_plugin(ctx, &info);
}

static void expect_format_refusal(btf_format_vtbl first, btf_format_vtbl second, btf_status expected,
                                  const char *part) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const uint32_t before = btf_format_count(ctx);
  assert_status(register_formats(ctx, &first, &second), expected);
  assert_message_has(part);
  assert_int_equal(btf_format_count(ctx), before); /* all or none */
  test_context_done(ctx, &memory);
}

static void formats_door(void **state) {
  btf_format_vtbl v = good_format(), other = good_format();
  (void)state;
  expect_format_refusal(v, other, BTF_E_PLUGIN, "twice");
  other.id = "org.example.other";
#define REFUSE_FORMAT(change, status, part)                                                                  \
  v = good_format();                                                                                         \
  change;                                                                                                    \
  expect_format_refusal(other, v, status, part)
  REFUSE_FORMAT(v.abi = LIBBTF_ABI + 1, BTF_E_PLUGIN, "ABI");
  REFUSE_FORMAT(v.struct_size = offsetof(btf_format_vtbl, open), BTF_E_PLUGIN, "table");
  REFUSE_FORMAT(v.id = "short", BTF_E_PLUGIN, "org.example.short");
  REFUSE_FORMAT(v.title = "", BTF_E_PLUGIN, "title");
  REFUSE_FORMAT(v.probe = NULL, BTF_E_PLUGIN, "`probe`");
  REFUSE_FORMAT(v.open = NULL, BTF_E_PLUGIN, "`open`");
#undef REFUSE_FORMAT
}

static void formats_recognise(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory), *another;
  test_memory memory_of_another;
  const btf_format *format;
  btf_dataset *ds;
  const char *five = test_path("five"), *other_file = test_path("other");
  btf_format_vtbl v = good_format(), never = good_format();
  (void)state;
  never.id = "org.example.never";
  never.probe = probe_never;
  assert_ok(register_formats(ctx, &never, &v));
  assert_string_equal(btf_format_id(btf_format_at(ctx, 0)), "folder");
  assert_null(btf_format_at(ctx, 3));
  test_write_bytes(five, "12345", 5);
  test_write_bytes(other_file, "12346", 5);
  assert_ok(btf_format_detect(ctx, five, &format));
  assert_string_equal(btf_format_id(format), "org.example.five");
  assert_status(btf_format_detect(ctx, other_file, &format), BTF_E_NOT_BTF);
  assert_status(btf_format_detect(ctx, test_path("absent"), &format), BTF_E_IO);
  assert_status(btf_format_detect(ctx, "/dev/null", &format), BTF_E_UNSUPPORTED);
  /* Asking for a parameter that is not there is the format's mistake, whatever else it says. */
  assert_status(btf_format_open(ctx, five, NULL, NULL, &ds), BTF_E_INVALID_ARG);
  assert_message_has("no such parameter");
  assert_null(ds);
  another = test_context(&memory_of_another);
  assert_ok(btf_format_detect(ctx, five, &format));
  assert_status(btf_format_open(another, five, format, NULL, &ds), BTF_E_INVALID_ARG);
  test_context_done(another, &memory_of_another);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(door),
      cmocka_unit_test(parameters),
      cmocka_unit_test(results_of_old_codecs_are_not_overrun),
      cmocka_unit_test(codecs_describe_themselves),
      cmocka_unit_test(options),
      cmocka_unit_test(formats_door),
      cmocka_unit_test(formats_recognise),
      cmocka_unit_test(host_reads_text),
      cmocka_unit_test(example_registered),
      cmocka_unit_test(example_loaded),
      cmocka_unit_test(refused_modules),
      cmocka_unit_test(refused_paths),
      cmocka_unit_test(out_of_memory),
  };
  return btf_run("registry", tests);
}
