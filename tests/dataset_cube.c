/* SPDX-License-Identifier: MIT */
#include "dataset_cube.h"

#include <errno.h>
#include <sys/stat.h>

#include <btf/btf_half.h>

uint32_t test_random(uint64_t *state) {
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (uint32_t)(*state >> 33);
}

float test_uniform(uint64_t *state) {
  return (float)(test_random(state) & 0xffffffu) / 16777215.0f;
}

btf_dirset *test_spiral(btf_context *ctx, uint32_t n, double phase) {
  btf_dirset *set = NULL;
  float *xyz = malloc(3 * n * sizeof *xyz);
  for (uint32_t i = 0; i < n; ++i) {
    const double z = 1.0 - 0.9 * (i + 0.5) / n, r = sqrt(1.0 - z * z), phi = phase + 2.399963229728653 * i;
    xyz[3 * i] = (float)(r * cos(phi));
    xyz[3 * i + 1] = (float)(r * sin(phi));
    xyz[3 * i + 2] = (float)z;
  }
  assert_ok(btf_dirset_create(ctx, xyz, n, &set));
  free(xyz);
  return set;
}

static void random_sample(uint32_t type, uint64_t *state, unsigned char *dst) {
  uint32_t bits = test_random(state) ^ test_random(state) << 16;
  if (type == BTF_SAMPLE_F16 && (bits & 0x7c00u) == 0x7c00u) bits ^= 0x4000u;
  if (type == BTF_SAMPLE_F32 && (bits & 0x7f800000u) == 0x7f800000u) bits ^= 0x40000000u;
  const uint16_t two = (uint16_t)bits;
  if (type == BTF_SAMPLE_U8)
    *dst = (unsigned char)bits;
  else if (type == BTF_SAMPLE_F32)
    memcpy(dst, &bits, 4);
  else
    memcpy(dst, &two, 2);
}

btf_strides test_cube_strides(const test_cube *cube, uint32_t order, ptrdiff_t size) {
  const ptrdiff_t v = cube->views, l = cube->lights, h = cube->height, w = cube->width, c = cube->channels;
  (void)v;
  (void)h;
  const btf_strides image = {l * h * w * c * size, h * w * c * size, w * c * size, c * size, size};
  const btf_strides texel = {l * c * size, c * size, w * v * l * c * size, v * l * c * size, size};
  return order == BTF_ORDER_VLYXC ? image : texel;
}

static size_t place(const test_cube *cube, uint32_t order, uint32_t v, uint32_t l, uint32_t y, uint32_t x,
                    uint32_t c) {
  const btf_strides s = test_cube_strides(cube, order, (ptrdiff_t)cube->size);
  return (size_t)((ptrdiff_t)v * s.view + (ptrdiff_t)l * s.light + (ptrdiff_t)y * s.y + (ptrdiff_t)x * s.x +
                  (ptrdiff_t)c * s.channel);
}

void test_cube_make(btf_context *ctx, test_cube *cube, uint32_t type, uint32_t views, uint32_t lights,
                    uint32_t height, uint32_t width, uint32_t channels, uint64_t seed) {
  static const uint32_t sizes[] = {0, 1, 2, 4, 2};
  *cube = (test_cube){views, lights, height, width, channels, type, sizes[type], 0, NULL, NULL, NULL, NULL};
  cube->count = (size_t)views * lights * height * width * channels;
  cube->image_major = malloc(cube->count * cube->size);
  cube->texel_major = malloc(cube->count * cube->size);
  cube->view_set = test_spiral(ctx, views, 0.3);
  cube->light_set = test_spiral(ctx, lights, 1.1);
  for (size_t i = 0; i < cube->count; ++i) random_sample(type, &seed, cube->image_major + i * cube->size);
  for (uint32_t v = 0; v < views; ++v)
    for (uint32_t l = 0; l < lights; ++l)
      for (uint32_t y = 0; y < height; ++y)
        for (uint32_t x = 0; x < width; ++x)
          for (uint32_t c = 0; c < channels; ++c)
            memcpy(cube->texel_major + place(cube, BTF_ORDER_YXVLC, v, l, y, x, c),
                   cube->image_major + place(cube, BTF_ORDER_VLYXC, v, l, y, x, c), cube->size);
}

void test_cube_free(test_cube *cube) {
  free(cube->image_major);
  free(cube->texel_major);
  btf_dirset_release(cube->view_set);
  btf_dirset_release(cube->light_set);
}

static double half_value(uint16_t h) {
  const int exponent = h >> 10 & 31;
  const double fraction = (h & 1023) / 1024.0;
  const double magnitude = exponent == 0 ? ldexp(fraction, -14) : ldexp(1.0 + fraction, exponent - 15);
  return h & 0x8000u ? -magnitude : magnitude;
}

float test_cube_value(const test_cube *cube, uint32_t v, uint32_t l, uint32_t y, uint32_t x, uint32_t c) {
  const unsigned char *sample = cube->image_major + place(cube, BTF_ORDER_VLYXC, v, l, y, x, c);
  uint16_t two;
  float value;
  switch (cube->type) {
  case BTF_SAMPLE_U8:
    return (float)(*sample / 255.0);
  case BTF_SAMPLE_U16:
    memcpy(&two, sample, 2);
    return (float)(two / 65535.0);
  case BTF_SAMPLE_F16:
    memcpy(&two, sample, 2);
    return (float)half_value(two);
  default:
    memcpy(&value, sample, 4);
    return value;
  }
}

btf_dataset_desc test_cube_desc(const test_cube *cube) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  desc.lights = cube->light_set;
  desc.views = cube->view_set;
  desc.width = cube->width;
  desc.height = cube->height;
  desc.channels = cube->channels;
  desc.sample_type = cube->type;
  return desc;
}

static btf_status copy_block(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const test_cube *cube = user;
  for (uint32_t v = 0; v < b->views; ++v)
    for (uint32_t l = 0; l < b->lights; ++l)
      for (uint32_t y = 0; y < b->height; ++y)
        for (uint32_t x = 0; x < b->width; ++x)
          for (uint32_t c = 0; c < cube->channels; ++c)
            memcpy((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                       (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel,
                   cube->image_major +
                       place(cube, BTF_ORDER_VLYXC, b->view0 + v, b->light0 + l, b->y0 + y, b->x0 + x, c),
                   cube->size);
  return BTF_OK;
}

static void write_bytes(const char *folder, const char *name, const void *data, size_t size) {
  char path[2048];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  assert_int_equal(fwrite(data, 1, size, file), size);
  assert_int_equal(fclose(file), 0);
}

static size_t put_set(char *text, size_t at, const char *key, const btf_dirset *set) {
  const float *d = btf_dirset_directions(set);
  at += (size_t)sprintf(text + at, "\"%s\": [", key);
  for (uint32_t i = 0; i < btf_dirset_count(set); ++i)
    at += (size_t)sprintf(text + at, "%s[%.9g, %.9g, %.9g]", i ? ", " : "", (double)d[3 * i],
                          (double)d[3 * i + 1], (double)d[3 * i + 2]);
  return at + (size_t)sprintf(text + at, "]");
}

void test_cube_write_folder(const test_cube *cube, uint32_t order, const char *folder, const char *find,
                            const char *replace) {
  static const char *const types[] = {"", "u8", "f16", "f32", "u16"};
  char *text = malloc(1 << 20), *changed = malloc(1 << 20);
  size_t at = (size_t)sprintf(
      text, "{\"format\": \"btf-dataset\", \"version\": 1, \"width\": %u, \"height\": %u, \"channels\": [",
      cube->width, cube->height);
  for (uint32_t c = 0; c < cube->channels; ++c)
    at += (size_t)sprintf(text + at, "%s\"ch%u\"", c ? ", " : "", c);
  at += (size_t)sprintf(
      text + at, "], \"type\": \"%s\", \"order\": \"%s\", \"quantity\": \"brdf\", \"scale\": \"absolute\", ",
      types[cube->type], order == BTF_ORDER_VLYXC ? "vlyxc" : "yxvlc");
  at = put_set(text, at, "views", cube->view_set);
  at += (size_t)sprintf(text + at, ", ");
  at = put_set(text, at, "lights", cube->light_set);
  sprintf(text + at, "}\n");
  const char *found = find ? strstr(text, find) : NULL;
  if (find) assert_non_null(found);
  if (found)
    sprintf(changed, "%.*s%s%s", (int)(found - text), text, replace, found + strlen(find));
  else
    strcpy(changed, text);
  if (mkdir(folder, 0777) != 0) assert_int_equal(errno, EEXIST);
  write_bytes(folder, "manifest.json", changed, strlen(changed));
  write_bytes(folder, "samples.bin", order == BTF_ORDER_VLYXC ? cube->image_major : cube->texel_major,
              cube->count * cube->size);
  free(text);
  free(changed);
}

btf_dataset *test_cube_dataset(btf_context *ctx, const test_cube *cube, uint32_t order, int source,
                               const char *folder) {
  btf_dataset *ds = NULL;
  btf_dataset_desc desc = test_cube_desc(cube);
  switch (source) {
  case TEST_RESIDENT:
    desc.data = order == BTF_ORDER_VLYXC ? cube->image_major : cube->texel_major;
    desc.strides = test_cube_strides(cube, order, (ptrdiff_t)cube->size);
    break;
  case TEST_MAPPED:
    test_cube_write_folder(cube, order, folder, NULL, NULL);
    assert_ok(btf_dataset_open(ctx, folder, &ds));
    return ds;
  default:
    desc.read = copy_block;
    desc.user = (void *)(uintptr_t)cube;
    desc.flags = (source == TEST_CONCURRENT ? BTF_DATASET_CONCURRENT_READ : 0) |
                 (order == BTF_ORDER_VLYXC ? BTF_DATASET_IMAGE_MAJOR : 0);
    break;
  }
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  return ds;
}
