/* SPDX-License-Identifier: MIT */
/* Data-set folders: what opening refuses, and that writing gives back every bit or leaves nothing. */
#include "dataset_cube.h"

#include <errno.h>
#include <pthread.h>
#include <sys/stat.h>
#include <unistd.h>

#include "dataset/folder_writer.h"

static const uint32_t sample_types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_F16, BTF_SAMPLE_F32, BTF_SAMPLE_U16};
static const uint32_t orders[] = {BTF_ORDER_VLYXC, BTF_ORDER_YXVLC};

/* A fresh folder, so that leftovers can be counted. */
static const char *own_folder(const char *name) {
  const char *folder = test_path(name);
  assert_int_equal(mkdir(folder, 0777), 0);
  return folder;
}

/* folder / name, good for the next 63 calls. */
static const char *inside(const char *folder, const char *name) {
  static char paths[64][1024];
  static int next;
  const size_t length = strlen(folder), rest = strlen(name) + 1;
  assert_true(length + 1 + rest <= sizeof paths[0]);
  next = (next + 1) % 64;
  memmove(paths[next], folder, length);
  paths[next][length] = '/';
  memmove(paths[next] + length + 1, name, rest);
  return paths[next];
}

/* ---- opening ---- */

/* Text of the manifest that is changed, the status and what the message says. */
typedef struct manifest_fault {
  const char *find, *replace;
  btf_status status;
  const char *message;
} manifest_fault;

static const manifest_fault manifest_faults[] = {
    {"\"format\"", "\"kind\"", BTF_E_NOT_BTF, "manifest.json: \"format\" is not \"btf-dataset\""},
    {"btf-dataset", "btf-model", BTF_E_NOT_BTF, "\"format\" is not"},
    {"\"version\": 1", "\"version\": 2", BTF_E_NEWER, "version 2 is newer than this library"},
    {"\"version\": 1", "\"version\": 0", BTF_E_CORRUPT, "\"version\" is 0; expected 1"},
    {"\"version\": 1", "\"version\": 1.5", BTF_E_CORRUPT, "\"version\" is 1.5"},
    {"\"version\": 1", "\"version\": \"1\"", BTF_E_CORRUPT, "\"version\" is \"1\""},
    {"\"version\": 1, ", "", BTF_E_CORRUPT, "\"version\" is missing"},
    {"\"width\": 6", "\"width\": 0", BTF_E_CORRUPT,
     "\"width\" is 0; expected a whole number from 1 to 65536"},
    {"\"width\": 6", "\"width\": -6", BTF_E_CORRUPT, "\"width\" is -6"},
    {"\"width\": 6", "\"width\": 6.5", BTF_E_CORRUPT, "\"width\" is 6.5"},
    {"\"width\": 6", "\"width\": 65537", BTF_E_CORRUPT, "\"width\" is 65537"},
    {"\"width\": 6", "\"width\": 1e300", BTF_E_CORRUPT, "\"width\" is 1e+300"},
    {"\"width\": 6", "\"width\": [6]", BTF_E_CORRUPT, "\"width\" has the wrong type"},
    {"\"width\": 6, ", "", BTF_E_CORRUPT, "\"width\" is missing"},
    {"\"height\": 5", "\"height\": null", BTF_E_CORRUPT, "\"height\" has the wrong type"},
    {"\"height\": 5", "\"height\": 70000", BTF_E_CORRUPT, "\"height\" is 70000"},
    {"\"channels\": [\"ch0\", \"ch1\"]", "\"channels\": 2", BTF_E_CORRUPT,
     "\"channels\" is 2; expected an array"},
    {"\"channels\": [\"ch0\", \"ch1\"]", "\"channels\": []", BTF_E_CORRUPT, "\"channels\" has 0 entries"},
    {"\"ch1\"", "1", BTF_E_CORRUPT, "\"channels\" entry 1 is not a string"},
    {"\"ch0\"",
     "1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,"
     "1,1,1,1,1,1,1,"
     "1,1,1,1,1,1",
     BTF_E_CORRUPT, "\"channels\" has 65 entries"},
    {"\"f32\"", "\"f64\"", BTF_E_CORRUPT,
     "\"type\" is \"f64\"; expected \"u8\", \"u16\", \"f16\" or \"f32\""},
    {"\"f32\"", "32", BTF_E_CORRUPT, "\"type\" is 32"},
    {"\"type\"", "\"typ\"", BTF_E_CORRUPT, "\"type\" is missing"},
    {"\"vlyxc\"", "\"lvyxc\"", BTF_E_CORRUPT, "\"order\" is \"lvyxc\"; expected \"vlyxc\" or \"yxvlc\""},
    {"\"order\"", "\"orders\"", BTF_E_CORRUPT, "\"order\" is missing"},
    {"\"brdf\"", "\"btdf\"", BTF_E_CORRUPT, "\"quantity\" is \"btdf\""},
    {"\"quantity\"", "\"quality\"", BTF_E_CORRUPT, "\"quantity\" is missing"},
    {"\"absolute\"", "\"unknown\"", BTF_E_CORRUPT,
     "\"scale\" is \"unknown\"; expected \"absolute\" or \"relative\""},
    {"\"absolute\"", "true", BTF_E_CORRUPT, "\"scale\" has the wrong type"},
    {"\"quantity\"", "\"wrap\": \"mirror\", \"quantity\"", BTF_E_CORRUPT, "\"wrap\" is \"mirror\""},
    {"\"quantity\"", "\"name\": 5, \"quantity\"", BTF_E_CORRUPT, "\"name\" is 5; expected a string"},
    {"\"quantity\"", "\"source\": [], \"quantity\"", BTF_E_CORRUPT, "\"source\" has the wrong type"},
    {"\"quantity\"", "\"license\": {}, \"quantity\"", BTF_E_CORRUPT, "\"license\" has the wrong type"},
    {"\"quantity\"", "\"name\": \"a\\u0000b\", \"quantity\"", BTF_E_CORRUPT, "\"name\""},
    {"\"quantity\"", "\"texels_per_mm\": -1, \"quantity\"", BTF_E_CORRUPT, "\"texels_per_mm\" is -1"},
    {"\"quantity\"", "\"texels_per_mm\": \"9\", \"quantity\"", BTF_E_CORRUPT, "\"texels_per_mm\" is \"9\""},
    {"\"quantity\"", "\"samples\": \"../samples.bin\", \"quantity\"", BTF_E_CORRUPT,
     "\"samples\" is \"../samples.bin\"; expected the name of a file beside the manifest"},
    {"\"quantity\"", "\"samples\": \"/etc/passwd\", \"quantity\"", BTF_E_CORRUPT,
     "\"samples\" is \"/etc/passwd\""},
    {"\"quantity\"", "\"samples\": \"..\", \"quantity\"", BTF_E_CORRUPT, "\"samples\" is \"..\""},
    {"\"quantity\"", "\"samples\": \"\", \"quantity\"", BTF_E_CORRUPT, "\"samples\" is \"\""},
    {"\"quantity\"", "\"samples\": 3, \"quantity\"", BTF_E_CORRUPT, "\"samples\" is 3"},
    {"\"quantity\"", "\"samples\": \"other.bin\", \"quantity\"", BTF_E_IO, "other.bin: cannot be opened"},
    {"\"quantity\"", "\"order\": \"vlyxc\", \"quantity\"", BTF_E_CORRUPT, "manifest.json: line 1"},
    {"\"views\": [[", "\"views\": [[0, 0, -1], [", BTF_E_CORRUPT, "\"views\" direction 0 has z = -1"},
    {"\"views\": [[", "\"views\": [[1, 0, 0], [", BTF_E_CORRUPT,
     "\"views\" direction 0 has z = 0; expected one above"},
    {"\"views\": [[", "\"views\": [[0, 0, 1.0011], [", BTF_E_CORRUPT,
     "\"views\" direction 0 has length 1.0011"},
    {"\"views\": [[", "\"views\": [[0, 0, 0], [", BTF_E_CORRUPT, "\"views\" direction 0 has length 0"},
    {"\"views\": [[", "\"views\": [[0, 0], [", BTF_E_CORRUPT,
     "\"views\" direction 0 is not an array of three numbers"},
    {"\"views\": [[", "\"views\": [[0, 0, \"1\"], [", BTF_E_CORRUPT,
     "direction 0 is not an array of three numbers"},
    {"\"views\": [[", "\"views\": [7, [", BTF_E_CORRUPT, "direction 0 is not an array of three numbers"},
    {"\"views\": [[", "\"views\": [[0, 0, 1], [0.00001, 0, 1], [", BTF_E_CORRUPT, "\"views\": "},
    {"\"views\": [[", "\"aims\": [[", BTF_E_CORRUPT, "\"views\" is missing"},
    {"\"views\": ", "\"views\": [], \"aims\": ", BTF_E_CORRUPT, "\"views\" is empty"},
    {"\"views\": ", "\"views\": {}, \"aims\": ", BTF_E_CORRUPT, "\"views\" has the wrong type"},
    {"\"lights\": [[", "\"lights\": [[0.6, 0, 0.6], [", BTF_E_CORRUPT,
     "\"lights\" direction 0 has length 0.848528"},
    {"\"lights\": [[", "\"lights\": [[0, 0, 1e999], [", BTF_E_CORRUPT, "manifest.json"},
    {"\"lights\": [[", "\"lights\": [[0, 0, NaN], [", BTF_E_CORRUPT, "manifest.json: line 1"},
    {"]]}", "]]", BTF_E_CORRUPT, "ends too early"},
    {"{\"format\"", "[\"format\"", BTF_E_CORRUPT, "manifest.json: line 1"},
};

static void faults_of_manifests_are_named(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 5, 6, 2, 1);
  const char *folder = test_path("fault.btfd");
  for (size_t i = 0; i < sizeof manifest_faults / sizeof manifest_faults[0]; ++i) {
    const manifest_fault *f = &manifest_faults[i];
    btf_dataset *ds = (btf_dataset *)&memory;
    test_cube_write_folder(&cube, BTF_ORDER_VLYXC, folder, f->find, f->replace);
    const btf_status status = btf_dataset_open(ctx, folder, &ds);
    if (status != f->status || !strstr(btf_error_message(), f->message) || ds)
      fail_msg("%s -> %s: %s: %s", f->find, f->replace, btf_status_name(status), btf_error_message());
    assert_null(strchr(btf_error_message(), '\n'));
  }
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void unknown_keys_are_ignored_and_known_ones_kept(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U8, 3, 4, 5, 6, 2, 1);
  const char *folder = test_path("known.btfd");
  test_cube_write_folder(
      &cube, BTF_ORDER_YXVLC, folder, "\"scale\": \"absolute\"",
      "\"name\": \"K\\u00e4se\", \"source\": \"own\", \"license\": \"CC0\", \"texels_per_mm\": 9.5, "
      "\"x-note\": {\"a\": [1, null]}, \"wrap\": \"clamp\", \"color_space\": \"aces\"");
  btf_dataset *ds;
  btf_dataset_desc got = BTF_DATASET_DESC_INIT;
  assert_ok(btf_dataset_open(ctx, folder, &ds));
  assert_ok(btf_dataset_describe(ds, &got));
  assert_string_equal(got.name, "K\xc3\xa4se");
  assert_string_equal(got.source, "own");
  assert_string_equal(got.license, "CC0");
  assert_string_equal(got.color_space, "aces");
  assert_string_equal(got.channel_names[1], "ch1");
  assert_true(got.texels_per_mm == 9.5);
  assert_int_equal(got.wrap, BTF_WRAP_CLAMP);
  assert_int_equal(got.scale, BTF_SCALE_RELATIVE);
  assert_int_equal(got.flags, BTF_DATASET_CONCURRENT_READ);
  assert_int_equal(btf_dirset_count(got.views), 3);
  assert_int_equal(btf_dirset_count(got.lights), 4);
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* A light that was measured twice: both measurements are there to be read. */
static void equal_directions_are_taken(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 2, 2, 1, 1);
  const char *folder = test_path("repeated.btfd");
  float lights[12];
  memcpy(lights, btf_dirset_directions(cube.light_set), sizeof lights);
  memcpy(lights + 9, lights + 3, 12); /* the fourth is the second again */
  btf_dirset_release(cube.light_set);
  assert_ok(btf_dirset_create(ctx, lights, 4, &cube.light_set));
  test_cube_write_folder(&cube, BTF_ORDER_VLYXC, folder, NULL, NULL);
  btf_dataset *ds;
  assert_ok(btf_dataset_open(ctx, folder, &ds));
  for (uint32_t l = 0; l < 4; ++l) {
    const btf_block one = {2, 1, l, 1, 1, 1, 1, 1};
    const btf_strides strides = {4, 4, 4, 4, 4};
    float value;
    assert_ok(btf_dataset_read(ds, &one, &value, &strides));
    assert_true(value == test_cube_value(&cube, 2, l, 1, 1, 0));
  }
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void samples_of_the_wrong_size_are_refused(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 3, 4, 5, 6, 2, 1);
  const char *folder = test_path("size.btfd");
  const size_t bytes = 3 * 4 * 5 * 6 * 2 * 2;
  btf_dataset *ds;
  char *text = calloc(1, bytes + 2), sizes[64];
  for (size_t size = 0; size <= bytes + 2; size += size < bytes - 3 ? 97 : 1) {
    if (size == bytes) continue;
    test_cube_write_folder(&cube, BTF_ORDER_VLYXC, folder, NULL, NULL);
    test_write_bytes(inside(folder, "samples.bin"), text, size);
    assert_status(btf_dataset_open(ctx, folder, &ds), size < bytes ? BTF_E_TRUNCATED : BTF_E_CORRUPT);
    snprintf(sizes, sizeof sizes, "samples.bin: has %zu bytes; expected %zu", size, bytes);
    assert_message_has(sizes);
    assert_message_has("3 views x 4 lights x 6 x 5 texels x 2 channels x 2 bytes");
  }
  free(text);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void what_is_no_data_set_is_told_apart(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  assert_status(btf_dataset_open(ctx, test_path("nowhere.btfd"), &ds), BTF_E_IO);
  assert_message_has("nowhere.btfd: cannot be opened: No such file");
  assert_status(btf_dataset_open(ctx, own_folder("empty"), &ds), BTF_E_NOT_BTF);
  assert_message_has("empty: has no manifest.json; expected a data-set folder");
  test_write_bytes(test_path("plain.txt"), "hello", 5);
  assert_status(btf_dataset_open(ctx, test_path("plain.txt"), &ds), BTF_E_NOT_BTF);
  assert_message_has("plain.txt: not a folder");
  const char *folder = own_folder("list");
  test_write_bytes(inside(folder, "manifest.json"), "[]", 2);
  assert_status(btf_dataset_open(ctx, folder, &ds), BTF_E_NOT_BTF);
  test_write_bytes(inside(folder, "manifest.json"), "", 0);
  assert_status(btf_dataset_open(ctx, folder, &ds), BTF_E_CORRUPT);
  assert_status(btf_dataset_open(ctx, NULL, &ds), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_open(NULL, folder, &ds), BTF_E_INVALID_ARG);
  test_context_done(ctx, &memory);
}

static void limits_hold_for_manifests(void **state) {
  (void)state;
  test_memory memory;
  btf_context *plain = test_context(&memory), *ctx;
  test_cube cube;
  test_cube_make(plain, &cube, BTF_SAMPLE_U8, 3, 4, 5, 6, 2, 1);
  const char *folder = test_path("limit.btfd");
  test_cube_write_folder(&cube, BTF_ORDER_VLYXC, folder, NULL, NULL);
  for (int k = 0; k < 4; ++k) {
    btf_limits limits = BTF_LIMITS_INIT;
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    btf_dataset *ds;
    desc.limits = &limits;
    if (k == 0) limits.max_dimension = 5;
    if (k == 1) limits.max_directions = 3;
    if (k == 2) limits.max_channels = 1;
    if (k == 3) limits.max_dimension = 6, limits.max_directions = 4, limits.max_channels = 2;
    assert_ok(btf_context_create(&desc, &ctx));
    assert_status(btf_dataset_open(ctx, folder, &ds), k == 3 ? BTF_OK : BTF_E_LIMIT);
    if (k == 0) assert_message_has("\"width\" is 6; the limit is 5");
    if (k == 1) assert_message_has("\"lights\" has 4 directions; the limit is 3");
    if (k == 2) assert_message_has("\"channels\" has 2 entries; the limit is 1");
    btf_dataset_release(ds);
    btf_context_release(ctx);
  }
  test_cube_free(&cube);
  test_context_done(plain, &memory);
}

/* ---- writing ---- */

static float *cube_floats(const test_cube *cube) {
  float *values = malloc(cube->count * sizeof *values), *next = values;
  for (uint32_t v = 0; v < cube->views; ++v)
    for (uint32_t l = 0; l < cube->lights; ++l)
      for (uint32_t y = 0; y < cube->height; ++y)
        for (uint32_t x = 0; x < cube->width; ++x)
          for (uint32_t c = 0; c < cube->channels; ++c) *next++ = test_cube_value(cube, v, l, y, x, c);
  return values;
}

static btf_status put_block(btf_dataset_writer *w, const test_cube *cube, const float *values,
                            const btf_block *b) {
  const btf_strides s = test_cube_strides(cube, BTF_ORDER_VLYXC, 4);
  return btf_dataset_writer_put(w, b,
                                values + ((ptrdiff_t)b->view0 * s.view + (ptrdiff_t)b->light0 * s.light +
                                          (ptrdiff_t)b->y0 * s.y + (ptrdiff_t)b->x0 * s.x) /
                                             4,
                                &s);
}

/* Writes the cube in blocks of at most the extents given. */
static void put_all(btf_dataset_writer *w, const test_cube *cube, const float *values,
                    const uint32_t extent[4]) {
  for (uint32_t v = 0; v < cube->views; v += extent[0])
    for (uint32_t y = 0; y < cube->height; y += extent[2])
      for (uint32_t l = 0; l < cube->lights; l += extent[1])
        for (uint32_t x = 0; x < cube->width; x += extent[3]) {
          const uint32_t left[4] = {cube->views - v, cube->lights - l, cube->height - y, cube->width - x};
          uint32_t n[4];
          for (int k = 0; k < 4; ++k) n[k] = left[k] < extent[k] ? left[k] : extent[k];
          const btf_block b = {v, n[0], l, n[1], x, y, n[3], n[2]};
          assert_ok(put_block(w, cube, values, &b));
        }
}

static void expect_samples(const char *folder, const void *expected, size_t size) {
  size_t got_size;
  unsigned char *got = test_read_bytes(inside(folder, "samples.bin"), &got_size);
  assert_int_equal(got_size, size);
  assert_memory_equal(got, expected, size);
  free(got);
}

/* Image-major to texel-major and back, through files, in blocks of many shapes (whole, images, texels,
 * crumbs). */
static void orders_turn_into_each_other_bit_for_bit(void **state) {
  (void)state;
  static const uint32_t extents[][4] = {{99, 99, 99, 99}, {1, 1, 99, 99}, {99, 99, 1, 99}, {99, 99, 1, 1},
                                        {1, 99, 99, 99},  {99, 1, 2, 99}, {2, 3, 4, 5},    {1, 1, 1, 7}};
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 2);
  const char *folder = own_folder("orders");
  for (size_t t = 0; t < 4; ++t) {
    test_cube cube;
    test_cube_make(ctx, &cube, sample_types[t], 5, 7, 6, 11, 3, t);
    if (sample_types[t] == BTF_SAMPLE_U8 || sample_types[t] == BTF_SAMPLE_U16) assert_true(cube.size <= 2);
    float *values = cube_floats(&cube);
    for (size_t e = 0; e < sizeof extents / sizeof extents[0]; ++e)
      for (int order = 0; order < 2; ++order) {
        const btf_dataset_desc desc = test_cube_desc(&cube);
        const char *path = inside(folder, "cube.btfd");
        btf_dataset_writer *w;
        btf_dataset *ds;
        assert_ok(btf_dataset_writer_create(ctx, path, &desc, orders[order], &w));
        put_all(w, &cube, values, extents[e]);
        assert_ok(btf_dataset_writer_finish(w));
        expect_samples(path, order ? cube.texel_major : cube.image_major, cube.count * cube.size);
        assert_int_equal(test_count_entries(folder), 1);
        assert_ok(btf_dataset_open(ctx, path, &ds));
        float *back = malloc(cube.count * sizeof *back);
        const btf_block all = {0, 5, 0, 7, 0, 0, 11, 6};
        const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 4);
        assert_ok(btf_dataset_read(ds, &all, back, &dense));
        assert_memory_equal(back, values, cube.count * sizeof *back);
        free(back);
        btf_dataset_release(ds);
      }
    free(values);
    test_cube_free(&cube);
  }
  test_context_done(ctx, &memory);
}

/* Images whose windows do not fit into memory together come in an order that evicts half-filled ones; columns
 * of texels likewise. */
static void scattered_blocks_gather_in_either_order(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 30, 31, 12, 20, 1, 3);
  float *values = cube_floats(&cube);
  const btf_dataset_desc desc = test_cube_desc(&cube);
  const char *path = test_path("scattered.btfd");
  const uint64_t window_bytes = btfi_stage_window_bytes;
  for (int order = 0; order < 2; ++order)
    for (uint64_t columns = 33; columns < 200; columns += 64) {
      btf_dataset_writer *w;
      btfi_stage_window_bytes = columns * 2 * (order ? 12 * 20 : 30 * 31);
      assert_ok(btf_dataset_writer_create(ctx, path, &desc, orders[order], &w));
      for (uint32_t i = 0; order == 1 && i < 30 * 31; ++i) {
        const uint32_t pair = i * 577u % (30u * 31u); /* 577 is prime to 930 */
        const btf_block top = {pair / 31, 1, pair % 31, 1, 0, 0, 20, 5},
                        rest = {pair / 31, 1, pair % 31, 1, 0, 5, 20, 7};
        assert_ok(put_block(w, &cube, values, &top));
        assert_ok(put_block(w, &cube, values, &rest));
      }
      for (uint32_t i = 0; order == 0 && i < 12 * 10; ++i) {
        const uint32_t pair = i * 77u % (12u * 10u); /* of texels; 77 is prime to 120 */
        const btf_block two = {0, 30, 0, 31, pair % 10 * 2, pair / 10, 2, 1};
        assert_ok(put_block(w, &cube, values, &two));
      }
      assert_ok(btf_dataset_writer_finish(w));
      expect_samples(path, order ? cube.texel_major : cube.image_major, cube.count * cube.size);
    }
  btfi_stage_window_bytes = window_bytes;
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

typedef struct writing_thread {
  btf_dataset_writer *w;
  const test_cube *cube;
  const float *values;
  uint32_t first;
  int failed;
} writing_thread;

static void *write_every_fourth_image(void *user) {
  writing_thread *t = user;
  for (uint32_t pair = t->first; pair < t->cube->views * t->cube->lights; pair += 4) {
    const btf_block b = {pair / t->cube->lights, 1, pair % t->cube->lights, 1, 0, 0, t->cube->width,
                         t->cube->height};
    if (put_block(t->w, t->cube, t->values, &b) != BTF_OK) t->failed = 1;
  }
  return NULL;
}

static void several_threads_write_one_folder(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 9, 8, 20, 30, 3, 3);
  float *values = cube_floats(&cube);
  for (int order = 0; order < 2; ++order) {
    const btf_dataset_desc desc = test_cube_desc(&cube);
    const char *path = test_path("threads.btfd");
    btf_dataset_writer *w;
    writing_thread threads[4];
    pthread_t handle[4];
    assert_ok(btf_dataset_writer_create(ctx, path, &desc, orders[order], &w));
    for (uint32_t i = 0; i < 4; ++i) {
      threads[i] = (writing_thread){w, &cube, values, i, 0};
      assert_int_equal(pthread_create(&handle[i], NULL, write_every_fourth_image, &threads[i]), 0);
    }
    for (int i = 0; i < 4; ++i) {
      pthread_join(handle[i], NULL);
      assert_int_equal(threads[i].failed, 0);
    }
    assert_ok(btf_dataset_writer_finish(w));
    expect_samples(path, order ? cube.texel_major : cube.image_major, cube.count * cube.size);
  }
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void manifests_are_complete_and_repeatable(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U16, 2, 3, 4, 5, 3, 3);
  float *values = cube_floats(&cube);
  static const uint32_t whole[4] = {99, 99, 99, 99};
  btf_dataset_desc desc = test_cube_desc(&cube), got = BTF_DATASET_DESC_INIT;
  desc.name = "line\nbreak \"quoted\" \xc3\xa4";
  desc.source = "own work";
  desc.license = "CC0-1.0";
  desc.texels_per_mm = 12.5;
  desc.quantity = BTF_QUANTITY_BRDF_COS;
  desc.scale = BTF_SCALE_ABSOLUTE;
  desc.wrap = BTF_WRAP_CLAMP;
  unsigned char *text[2];
  size_t size[2];
  const char *path = test_path("manifest.btfd");
  for (int k = 0; k < 2; ++k) {
    btf_dataset_writer *w;
    assert_ok(btf_dataset_writer_create(ctx, path, &desc, BTF_ORDER_VLYXC, &w));
    assert_ok(btf_dataset_writer_text(w, "command", "btf synth rings"));
    assert_status(btf_dataset_writer_text(w, "command", "again"), BTF_E_INVALID_ARG);
    assert_status(btf_dataset_writer_text(w, "views", "none"), BTF_E_INVALID_ARG);
    /* Bytes that are not UTF-8 become U+FFFD, so that these two keys would be the same. */
    assert_ok(btf_dataset_writer_text(w, "\xff", "\xfe"));
    assert_status(btf_dataset_writer_text(w, "\xfe", "x"), BTF_E_INVALID_ARG);
    assert_status(btf_dataset_writer_text(w, "", "x"), BTF_E_INVALID_ARG);
    assert_status(btf_dataset_writer_text(w, "x", NULL), BTF_E_INVALID_ARG);
    assert_ok(btf_dataset_writer_text(w, "light source", "LED"));
    put_all(w, &cube, values, whole);
    assert_ok(btf_dataset_writer_finish(w));
    text[k] = test_read_bytes(inside(path, "manifest.json"), &size[k]);
  }
  assert_int_equal(size[0], size[1]);
  assert_memory_equal(text[0], text[1], size[0]);
  static const char start[] =
      "{\n  \"format\": \"btf-dataset\",\n  \"version\": 1,\n  \"name\": \"line\\u000abreak \\\"quoted\\\" "
      "\xc3\xa4\",\n"
      "  \"source\": \"own work\",\n  \"license\": \"CC0-1.0\",\n  \"width\": 5,\n  \"height\": 4,\n"
      "  \"channels\": [\"R\", \"G\", \"B\"],\n  \"type\": \"u16\",\n  \"order\": \"vlyxc\",\n"
      "  \"quantity\": \"brdf_cos\",\n  \"scale\": \"absolute\",\n  \"wrap\": \"clamp\",\n"
      "  \"color_space\": \"lin_rec709\",\n  \"texels_per_mm\": 12.5,\n  \"command\": \"btf synth rings\",\n"
      "  \"\xef\xbf\xbd\": \"\xef\xbf\xbd\",\n  \"light source\": \"LED\",\n  \"samples\": "
      "\"samples.bin\",\n  \"views\": [\n    [";
  assert_true(size[0] > sizeof start);
  assert_memory_equal(text[0], start, sizeof start - 1);
  free(text[0]);
  free(text[1]);
  btf_dataset *ds;
  assert_ok(btf_dataset_open(ctx, path, &ds));
  assert_ok(btf_dataset_describe(ds, &got));
  assert_string_equal(got.name, desc.name);
  assert_true(got.texels_per_mm == 12.5);
  assert_int_equal(got.quantity, BTF_QUANTITY_BRDF_COS);
  assert_int_equal(got.scale, BTF_SCALE_ABSOLUTE);
  assert_int_equal(got.wrap, BTF_WRAP_CLAMP);
  /* Nine digits tell a float from its neighbours, and vectors that are unit already are left as they are. */
  assert_memory_equal(btf_dirset_directions(got.lights), btf_dirset_directions(cube.light_set),
                      9 * sizeof(float));
  assert_memory_equal(btf_dirset_directions(got.views), btf_dirset_directions(cube.view_set),
                      6 * sizeof(float));
  btf_dataset_release(ds);
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void values_that_cannot_be_stored_are_named(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  static const struct {
    uint32_t type;
    float value;
    int refused;
  } cases[] = {{BTF_SAMPLE_U8, NAN, 1},       {BTF_SAMPLE_U16, INFINITY, 1}, {BTF_SAMPLE_F16, -INFINITY, 1},
               {BTF_SAMPLE_F32, NAN, 1},      {BTF_SAMPLE_F16, 65520.0f, 1}, {BTF_SAMPLE_F16, -1e9f, 1},
               {BTF_SAMPLE_F16, 65519.0f, 0}, {BTF_SAMPLE_F32, 3.4e38f, 0},  {BTF_SAMPLE_U8, 7.0f, 0}};
  static const uint32_t whole[4] = {99, 99, 99, 99}, images[4] = {1, 1, 99, 99};
  const char *folder = own_folder("values");
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; ++i)
    for (int order = 0; order < 2; ++order)
      for (int by_image = 0; by_image < 2; ++by_image) {
        test_cube cube;
        test_cube_make(ctx, &cube, cases[i].type, 3, 4, 5, 6, 2, 1);
        float *values = cube_floats(&cube);
        btf_dataset_desc desc = test_cube_desc(&cube);
        btf_dataset_writer *w;
        const size_t place = ((((size_t)2 * 4 + 3) * 5 + 4) * 6 + 5) * 2 + 1, image = 5 * 6 * 2;
        const float kept = values[place];
        assert_ok(btf_dataset_writer_create(ctx, inside(folder, "values.btfd"), &desc, orders[order], &w));
        const btf_block all = {0, 3, 0, 4, 0, 0, 6, 5}, last = {2, 1, 3, 1, 0, 0, 6, 5};
        values[place] = cases[i].value;
        assert_status(put_block(w, &cube, values, by_image ? &last : &all),
                      cases[i].refused ? BTF_E_INVALID_ARG : BTF_OK);
        if (cases[i].refused) {
          assert_message_has("values.btfd: sample at view 2, light 3, row 4, column 5, channel 1 is ");
          assert_message_has(isfinite(cases[i].value) ? "expected a half float, which ends at 65504"
                                                      : "expected a finite number");
          /* The block may be put again, mended. */
          values[place] = kept;
          put_all(w, &cube, values, by_image ? images : whole);
          assert_ok(btf_dataset_writer_finish(w));
          expect_samples(inside(folder, "values.btfd"), order ? cube.texel_major : cube.image_major,
                         cube.count * cube.size);
        } else {
          btf_dataset_writer_abort(w);
        }
        (void)image;
        free(values);
        test_cube_free(&cube);
      }
  test_context_done(ctx, &memory);
}

static void every_sample_is_written_exactly_once(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 5, 6, 2, 1);
  float *values = cube_floats(&cube);
  const btf_dataset_desc desc = test_cube_desc(&cube);
  const btf_block all = {0, 3, 0, 4, 0, 0, 6, 5}, some = {0, 3, 0, 4, 0, 0, 6, 4},
                  row = {0, 3, 0, 4, 0, 4, 6, 1}, wrong_row = {0, 3, 0, 4, 0, 2, 6, 1};
  const char *folder = own_folder("once"), *path = inside(folder, "once.btfd");
  btf_dataset_writer *w;
  assert_ok(btf_dataset_writer_create(ctx, path, &desc, BTF_ORDER_VLYXC, &w));
  assert_ok(put_block(w, &cube, values, &some));
  assert_int_equal(test_count_entries(folder), 1);
  assert_status(btf_dataset_writer_finish(w), BTF_E_STATE);
  assert_message_has("once.btfd: 144 of 720 samples are missing");
  assert_int_equal(test_count_entries(folder), 0);
  assert_ok(btf_dataset_writer_create(ctx, path, &desc, BTF_ORDER_VLYXC, &w));
  assert_ok(put_block(w, &cube, values, &all));
  assert_status(put_block(w, &cube, values, &row), BTF_E_INVALID_ARG);
  assert_message_has("each may be written once");
  btf_dataset_writer_abort(w);
  assert_int_equal(test_count_entries(folder), 0);
  assert_ok(btf_dataset_writer_create(ctx, path, &desc, BTF_ORDER_VLYXC, &w));
  assert_ok(put_block(w, &cube, values, &some));
  assert_ok(put_block(w, &cube, values, &wrong_row));
  assert_status(btf_dataset_writer_finish(w), BTF_E_STATE);
  assert_message_has("some samples were written twice and others never");
  assert_int_equal(test_count_entries(folder), 0);
  assert_ok(btf_dataset_writer_create(ctx, path, &desc, BTF_ORDER_VLYXC, &w));
  const btf_block outside = {0, 3, 0, 4, 0, 0, 7, 5};
  assert_status(put_block(w, &cube, values, &outside), BTF_E_INVALID_ARG);
  assert_ok(put_block(w, &cube, values, &row));
  assert_ok(put_block(w, &cube, values, &some));
  assert_ok(btf_dataset_writer_finish(w));
  expect_samples(path, cube.image_major, cube.count * 4);
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void only_data_sets_are_replaced(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 5, 6, 2, 1);
  float *values = cube_floats(&cube);
  const btf_dataset_desc desc = test_cube_desc(&cube);
  static const uint32_t whole[4] = {99, 99, 99, 99};
  const char *folder = own_folder("replace");
  btf_dataset_writer *w;
  test_write_bytes(inside(folder, "file"), "x", 1);
  assert_int_equal(mkdir(inside(folder, "other"), 0777), 0);
  test_write_bytes(inside(inside(folder, "other"), "manifest.json"), "{\"format\": \"other\"}", 19);
  assert_int_equal(mkdir(inside(folder, "empty"), 0777), 0);
  static const char *const taken[] = {"file", "other", "empty"};
  for (int i = 0; i < 3; ++i) {
    assert_status(btf_dataset_writer_create(ctx, inside(folder, taken[i]), &desc, BTF_ORDER_VLYXC, &w),
                  BTF_E_IO);
    assert_message_has("exists and is not a data-set folder");
  }
  assert_status(
      btf_dataset_writer_create(ctx, inside(folder, "no/such/place.btfd"), &desc, BTF_ORDER_VLYXC, &w),
      BTF_E_IO);
  assert_int_equal(test_count_entries(folder), 3);

  /* A previous data set whose samples have another name goes; a picture beside it stays. */
  const char *path = inside(folder, "wool.btfd");
  test_cube_write_folder(&cube, BTF_ORDER_VLYXC, path, "\"quantity\"",
                         "\"samples\": \"old.bin\", \"quantity\"");
  assert_int_equal(rename(inside(path, "samples.bin"), inside(path, "old.bin")), 0);
  test_write_bytes(inside(path, "preview.png"), "png", 3);
  const char *with_slash = inside(path, "");
  assert_ok(btf_dataset_writer_create(ctx, with_slash, &desc, BTF_ORDER_YXVLC, &w));
  put_all(w, &cube, values, whole);
  assert_true(test_exists(inside(path, "old.bin")));
  assert_ok(btf_dataset_writer_finish(w));
  expect_samples(path, cube.texel_major, cube.count * 4);
  assert_true(test_exists(inside(path, "preview.png")));
  assert_int_equal(test_count_entries(path), 3);
  assert_int_equal(test_count_entries(folder), 4);
  btf_dataset_writer_abort(NULL);
  assert_status(btf_dataset_writer_finish(NULL), BTF_E_INVALID_ARG);
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void descriptions_of_writers_are_checked(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 5, 6, 2, 1);
  const char *folder = own_folder("checked"), *path = inside(folder, "x.btfd");
  btf_dataset_writer *w;
  btf_dataset_desc d = test_cube_desc(&cube);
  assert_status(btf_dataset_writer_create(ctx, path, &d, 0, &w), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_writer_create(ctx, "", &d, BTF_ORDER_VLYXC, &w), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_writer_create(ctx, path, NULL, BTF_ORDER_VLYXC, &w), BTF_E_INVALID_ARG);
  d.sample_type = 9;
  assert_status(btf_dataset_writer_create(ctx, path, &d, BTF_ORDER_VLYXC, &w), BTF_E_INVALID_ARG);
  assert_null(w);
  assert_int_equal(test_count_entries(folder), 0);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* ---- failing calls ---- */

static long fault_count, fault_at;
static int fail_call(const char *call) {
  (void)call;
  return ++fault_count == fault_at ? EIO : 0;
}

static btf_status write_small(btf_context *ctx, const test_cube *cube, const float *values,
                              const char *path) {
  const btf_dataset_desc desc = test_cube_desc(cube);
  const btf_block images = {0, 2, 0, 4, 0, 0, 6, 5}, rest = {2, 1, 0, 4, 0, 0, 6, 5};
  btf_dataset_writer *w;
  btf_status status = btf_dataset_writer_create(ctx, path, &desc, BTF_ORDER_YXVLC, &w);
  if (status != BTF_OK) return status;
  status = btf_dataset_writer_text(w, "note", "small");
  if (status == BTF_OK) status = put_block(w, cube, values, &images);
  if (status == BTF_OK) status = put_block(w, cube, values, &rest);
  if (status == BTF_OK) return btf_dataset_writer_finish(w);
  btf_dataset_writer_abort(w);
  return status;
}

/* Each system call in turn, with nothing at the final place and with a data set there already. */
static void failing_system_calls_leave_nothing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 5, 6, 2, 1);
  float *values = cube_floats(&cube);
  const char *folder = own_folder("calls");
  char path[1024];
  strcpy(path, inside(folder, "calls.btfd"));
  const size_t descriptors = test_count_entries("/proc/self/fd");
  for (int replacing = 0; replacing < 2; ++replacing) {
    for (fault_at = 1;; ++fault_at) {
      if (replacing) {
        test_cube_write_folder(&cube, BTF_ORDER_VLYXC, path, NULL, NULL);
      }
      fault_count = 0;
      btfi_io_fault = fail_call;
      const btf_status status = write_small(ctx, &cube, values, path);
      btfi_io_fault = NULL;
      const int failed = fault_count >= fault_at;
      if (!failed) {
        assert_ok(status);
        break;
      }
      if (status == BTF_OK) fail_msg("call %ld failed unnoticed", fault_at);
      assert_int_equal(status, BTF_E_IO);
      /* The path that was given, not the hidden one. */
      if (strncmp(btf_error_message(), path, strlen(path)) != 0 || strstr(btf_error_message(), "/."))
        fail_msg("call %ld: %s", fault_at, btf_error_message());
      assert_int_equal(test_count_entries(folder), replacing);
      if (replacing) expect_samples(path, cube.image_major, cube.count * 4);
      assert_int_equal(test_count_entries("/proc/self/fd"), descriptors);
    }
    assert_true(fault_at > 10);
    assert_int_equal(test_count_entries(folder), 1);
    expect_samples(path, cube.texel_major, cube.count * 4);
    assert_int_equal(unlink(inside(path, "samples.bin")), 0);
    assert_int_equal(unlink(inside(path, "manifest.json")), 0);
    assert_int_equal(rmdir(path), 0);
  }
  /* And while opening. */
  test_cube_write_folder(&cube, BTF_ORDER_VLYXC, path, NULL, NULL);
  for (fault_at = 1;; ++fault_at) {
    btf_dataset *ds;
    fault_count = 0;
    btfi_io_fault = fail_call;
    const btf_status status = btf_dataset_open(ctx, path, &ds);
    btfi_io_fault = NULL;
    btf_dataset_release(ds);
    assert_int_equal(test_count_entries("/proc/self/fd"), descriptors);
    if (fault_count < fault_at) {
      assert_ok(status);
      break;
    }
    assert_int_equal(status, BTF_E_IO);
  }
  assert_true(fault_at > 5);
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void failing_allocations_leave_nothing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 5, 6, 2, 1);
  float *values = cube_floats(&cube);
  const char *folder = own_folder("memory");
  char path[1024];
  strcpy(path, inside(folder, "memory.btfd"));
  const long live = memory.live_blocks;
  for (int opening = 0; opening < 2; ++opening)
    for (long fail_at = 1;; ++fail_at) {
      btf_dataset *ds = NULL;
      memory.fail_at = memory.total_allocations + fail_at;
      const btf_status status =
          opening ? btf_dataset_open(ctx, path, &ds) : write_small(ctx, &cube, values, path);
      const int failed = memory.total_allocations >= memory.fail_at;
      memory.fail_at = 0;
      btf_dataset_release(ds);
      assert_int_equal(memory.live_blocks, live);
      if (!failed) {
        assert_ok(status);
        assert_true(fail_at > 10);
        break;
      }
      assert_int_equal(status, BTF_E_NOMEM);
      assert_int_equal(test_count_entries(folder), opening);
    }
  free(values);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(faults_of_manifests_are_named),
      cmocka_unit_test(unknown_keys_are_ignored_and_known_ones_kept),
      cmocka_unit_test(equal_directions_are_taken),
      cmocka_unit_test(samples_of_the_wrong_size_are_refused),
      cmocka_unit_test(what_is_no_data_set_is_told_apart),
      cmocka_unit_test(limits_hold_for_manifests),
      cmocka_unit_test(orders_turn_into_each_other_bit_for_bit),
      cmocka_unit_test(scattered_blocks_gather_in_either_order),
      cmocka_unit_test(several_threads_write_one_folder),
      cmocka_unit_test(manifests_are_complete_and_repeatable),
      cmocka_unit_test(values_that_cannot_be_stored_are_named),
      cmocka_unit_test(every_sample_is_written_exactly_once),
      cmocka_unit_test(only_data_sets_are_replaced),
      cmocka_unit_test(descriptions_of_writers_are_checked),
      cmocka_unit_test(failing_system_calls_leave_nothing),
      cmocka_unit_test(failing_allocations_leave_nothing),
  };
  return btf_run("dataset_folder", tests);
}
