/* SPDX-License-Identifier: MIT */
#include "bonn_case.h"

const bonn_case bonn_cases[] = {
    {.label = "FMF half",
     .signature = "!FMF06FCR",
     .family = BONN_CASE_FMF,
     .version = 1,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 4},
    {.label = "FMF float, cosine",
     .signature = "!FMF06FC",
     .family = BONN_CASE_FMF,
     .version = 2,
     .scalar_size = 4,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .cosine = 1},
    {.label = "FMF double, xml",
     .signature = "!FMF06FCR",
     .family = BONN_CASE_FMF,
     .version = 3,
     .scalar_size = 8,
     .views = 5,
     .lights = 3,
     .width = 2,
     .height = 4,
     .channels = 3,
     .components = 2,
     .setup_bytes = 9},
    {.label = "FMF, a size that looks like an R",
     .signature = "!FMF06FC",
     .family = BONN_CASE_FMF,
     .version = 3,
     .scalar_size = 4,
     .views = 3,
     .lights = 4,
     .width = 2,
     .height = 3,
     .channels = 3,
     .components = 2,
     .setup_bytes = 66},
    {.label = "FMF12 logarithms",
     .signature = "!FMF12FCER",
     .family = BONN_CASE_FMF,
     .version = 4,
     .scalar_size = 2,
     .views = 3,
     .lights = 4,
     .width = 4,
     .height = 3,
     .channels = 3,
     .components = 3,
     .dynamic_range = 1,
     .setup_bytes = 4},
    {.label = "FMF12 spectral, by texel",
     .signature = "!FMF12FCE",
     .family = BONN_CASE_FMF,
     .version = 4,
     .scalar_size = 4,
     .views = 3,
     .lights = 4,
     .width = 3,
     .height = 5,
     .channels = 5,
     .components = 3,
     .transposed = true,
     .cosine = 1},
    {.label = "FMF by texel",
     .signature = "!FMF06FCR",
     .family = BONN_CASE_FMF,
     .version = 1,
     .scalar_size = 2,
     .views = 4,
     .lights = 4,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 2,
     .transposed = true},
    {.label = "DFMF RGB",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 1,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 4},
    {.label = "DFMF YUV",
     .signature = "!DFMF08FC",
     .family = BONN_CASE_DFMF,
     .version = 2,
     .scalar_size = 4,
     .views = 5,
     .lights = 4,
     .width = 2,
     .height = 3,
     .channels = 3,
     .components = 3,
     .cosine = 1,
     .colour_model = 1},
    {.label = "DFMF PCA",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 4,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .colour_model = 3},
    {.label = "DFMF YCoCg",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 8,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .colour_model = 4},
    {.label = "DFMF spectral",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 2,
     .views = 3,
     .lights = 3,
     .width = 3,
     .height = 2,
     .channels = 4,
     .components = 2,
     .colour_model = 5},
    {.label = "DFMF spectral, linear",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 2,
     .views = 3,
     .lights = 3,
     .width = 3,
     .height = 2,
     .channels = 4,
     .components = 2,
     .colour_model = 6},
    {.label = "DFMF log Y",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 4,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .transposed = true,
     .colour_model = 9},
    {.label = "DFMF logs",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 4,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .colour_model = 10},
    {.label = "DFMF log Y, ratios",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .cosine = 1,
     .colour_model = 11},
    {.label = "DFMF log RGB, rotations",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .colour_model = 12,
     .rotations = 3,
     .rotation_bytes = 36},
    {.label = "DFMF, short rotations",
     .signature = "!DFMF08FCR",
     .family = BONN_CASE_DFMF,
     .version = 4,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .rotations = 5,
     .rotation_bytes = 12},
    {.label = "PVF",
     .signature = "!PVF06FCR",
     .family = BONN_CASE_PVF,
     .version = 1,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3},
    {.label = "PVF by texel",
     .signature = "!PVF06FC",
     .family = BONN_CASE_PVF,
     .version = 4,
     .scalar_size = 4,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .transposed = true},
    {.label = "PVF, older",
     .signature = "!PVF06FC",
     .family = BONN_CASE_PVF,
     .scalar_size = 4,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 2,
     .channels = 3,
     .components = 3,
     .legacy = true},
    {.label = "BDI",
     .signature = "!BDIF06R2!",
     .family = BONN_CASE_BDI,
     .version = 1,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 5,
     .channels = 3,
     .components = 1,
     .chunk_rows = 2},
    {.label = "BDI with holes",
     .signature = "!BDIF06R2!",
     .family = BONN_CASE_BDI,
     .version = 4,
     .scalar_size = 2,
     .views = 4,
     .lights = 5,
     .width = 3,
     .height = 5,
     .channels = 3,
     .components = 1,
     .cosine = 1,
     .chunk_rows = 2,
     .holes = true},
};
const size_t bonn_case_count = sizeof bonn_cases / sizeof *bonn_cases;

enum { FACTOR_LEFT = 1, FACTOR_RIGHT = 2, FACTOR_MEAN = 3, FACTOR_FIELD = 4 };

/* A multiple of 1/64 between -1 and 1, which a half holds exactly, from what it stands for. */
static double value(uint32_t kind, uint32_t factor, uint64_t row, uint32_t column) {
  uint64_t h = kind * UINT64_C(0x9e3779b97f4a7c15) + factor * UINT64_C(0xbf58476d1ce4e5b9) +
               row * UINT64_C(0x94d049bb133111eb) + column * UINT64_C(0xd6e8feb86659fd93);
  h ^= h >> 31;
  h *= UINT64_C(0xff51afd7ed558ccd);
  h ^= h >> 33;
  return (double)((int)(h % 129) - 64) / 64;
}

/* The number in the file. */
static double entry(const bonn_case *c, uint32_t kind, uint32_t factor, uint64_t row, uint32_t column) {
  const double even = value(kind, factor, row, column), uneven = even * 0.7317;
  const int bits = c->scalar_size == 2 ? 11 : 24;
  int exponent;
  if (!c->uneven) return even;
  frexp(uneven, &exponent);
  return ldexp(rint(ldexp(uneven, bits - exponent)), exponent - bits);
}

void bonn_case_angles(uint32_t i, uint32_t n, bool light, float *theta, float *phi) {
  *theta = light ? 0.15f + 1.1f * (float)i / (float)n : 0.1f + 1.2f * (float)i / (float)n;
  *phi = (light ? 2.4f : -1.9f) * (float)(i + 1);
  while (*phi > 3.14159f) *phi -= 6.2831853f;
  while (*phi < -3.14159f) *phi += 6.2831853f;
}

uint32_t bonn_case_lights(const bonn_case *c, uint32_t view) {
  static const uint32_t counts[] = {3, 4, 1, 4, 4};
  return c->own_lights ? counts[view % 5] : c->lights;
}

void bonn_case_light(const bonn_case *c, uint32_t view, uint32_t light, float *theta, float *phi) {
  const bool small = view % 5 == 1 || view % 5 == 4;
  if (!c->own_lights) {
    bonn_case_angles(light, c->lights, true, theta, phi);
    *theta += c->drift * (float)view;
    return;
  }
  *theta = light == 3 ? 0.05f : small ? 0.3f : 1.2f;
  *phi = (small ? 0.2f : fmodf(0.3f * (float)view, 6.2831853f)) + 2.0943951f * (float)light;
}

/* Number of a pair of view and light, views one after another. */
static uint32_t pair_of(const bonn_case *c, uint32_t view, uint32_t light) {
  uint32_t pair = light;
  for (uint32_t v = 0; v < view; v++) pair += bonn_case_lights(c, v);
  return pair;
}

bonn_case bonn_case_named(const char *label) {
  for (size_t i = 0; i < bonn_case_count; i++)
    if (strcmp(bonn_cases[i].label, label) == 0) return bonn_cases[i];
  fail_msg("no case %s", label);
  return bonn_cases[0];
}

void bonn_case_check_directions(const btf_dirset *set, uint32_t count, bool light) {
  assert_int_equal(btf_dirset_count(set), count);
  for (uint32_t i = 0; i < count; i++) {
    const float *d = btf_dirset_directions(set) + 3 * i;
    float theta, phi;
    bonn_case_angles(i, count, light, &theta, &phi);
    assert_near(d[0], sin(theta) * cos(phi), 1e-6);
    assert_near(d[1], sin(theta) * sin(phi), 1e-6);
    assert_near(d[2], cos(theta), 1e-6);
  }
}

/* ---- writing ---- */

static void put(bonn_bytes *b, const void *data, size_t n) {
  if (b->size + n >= b->room) {
    b->room = 2 * (b->size + n) + 256;
    b->data = realloc(b->data, b->room);
    if (b->data == NULL) abort();
  }
  memcpy(b->data + b->size, data, n);
  b->size += n;
}
static void put_u32(bonn_bytes *b, uint32_t v) {
  const unsigned char bytes[4] = {(unsigned char)v, (unsigned char)(v >> 8), (unsigned char)(v >> 16),
                                  (unsigned char)(v >> 24)};
  put(b, bytes, 4);
}
/* A number that a hostile file would lie about. */
static void put_count(bonn_bytes *b, uint32_t v) {
  if (b->mark_count < 64) b->marks[b->mark_count++] = b->size;
  put_u32(b, v);
}
static void put_f32(bonn_bytes *b, float v) {
  uint32_t bits;
  memcpy(&bits, &v, 4);
  put_u32(b, bits);
}
/* Halfs of multiples of 1/64 up to 4: the mantissa is cut, nothing is rounded. */
static void put_half(bonn_bytes *b, double v) {
  float f = (float)v;
  uint32_t bits;
  memcpy(&bits, &f, 4);
  uint32_t half = 0;
  if ((bits & 0x7fffffff) != 0)
    half = (bits >> 16 & 0x8000) | (((bits >> 23 & 255) - 112) << 10 & 0x7c00) | (bits >> 13 & 0x3ff);
  const unsigned char bytes[2] = {(unsigned char)half, (unsigned char)(half >> 8)};
  put(b, bytes, 2);
}
static void put_scalar(bonn_bytes *b, uint32_t size, double v) {
  if (size == 2) {
    put_half(b, v);
  } else if (size == 4) {
    put_f32(b, (float)v);
  } else {
    uint64_t bits;
    memcpy(&bits, &v, 8);
    put_u32(b, (uint32_t)bits);
    put_u32(b, (uint32_t)(bits >> 32));
  }
}

static void put_meta(bonn_bytes *b, const bonn_case *c) {
  char text[80] = "";
  uint32_t size = c->version == 1 ? 264 : c->version == 2 ? 268 : 272 + c->setup_bytes;
  if (c->version > 3) size += 4 + 7 * c->channels;
  put_count(b, size);
  put_u32(b, c->version);
  strcpy(text, "a dome");
  put(b, text, 80);
  memset(text, 'x', 80); /* need not end */
  put(b, text, 80);
  memset(text, 0, 80);
  put(b, text, 80);
  put_f32(b, 7.5f);
  for (int i = 0; i < 3; i++) put_f32(b, 1.0f + (float)i);
  if (c->version > 1) put_u32(b, c->cosine);
  if (c->version > 2) {
    put_count(b, c->setup_bytes);
    for (uint32_t i = 0; i < c->setup_bytes; i++) put(b, "<", 1);
  }
  if (c->version > 3) {
    put_count(b, c->channels);
    for (uint32_t i = 0; i < c->channels; i++) {
      const char digits[3] = {(char)('4' + i % 5), '1', '0'};
      put_count(b, 3);
      put(b, digits, 3);
    }
  }
}

static void put_directions(bonn_bytes *b, const bonn_case *c) {
  float theta, phi;
  put_count(b, c->views);
  for (uint32_t v = 0; v < c->views; v++) {
    bonn_case_angles(v, c->views, false, &theta, &phi);
    put_f32(b, theta);
    put_f32(b, phi);
    put_count(b, bonn_case_lights(c, v));
    for (uint32_t l = 0; l < bonn_case_lights(c, v); l++) {
      bonn_case_light(c, v, l, &theta, &phi);
      put_f32(b, theta);
      put_f32(b, phi);
    }
  }
}

static void put_size(bonn_bytes *b, const bonn_case *c) {
  put_count(b, c->width);
  put_count(b, c->height);
}

static void put_rows(bonn_bytes *b, const bonn_case *c, uint32_t kind, uint32_t factor, uint64_t rows,
                     uint32_t columns) {
  for (uint64_t i = 0; i < rows; i++)
    for (uint32_t k = 0; k < columns; k++) put_scalar(b, c->scalar_size, entry(c, kind, factor, i, k));
}

static void put_matrix(bonn_bytes *b, const bonn_case *c, uint32_t factor, uint32_t channels) {
  const uint32_t angles = pair_of(c, c->views, 0), texels = c->width * c->height;
  const uint32_t rows = channels * (c->transposed ? texels : angles),
                 columns = c->transposed ? angles : texels;
  const unsigned char scalar_size = (unsigned char)c->scalar_size;
  put(b, &scalar_size, 1);
  put_count(b, c->components);
  put_count(b, rows);
  put_count(b, columns);
  for (uint32_t k = 0; k < c->components; k++) put_scalar(b, c->scalar_size, 1);
  put_rows(b, c, FACTOR_LEFT, factor, rows, c->components);
  put_rows(b, c, FACTOR_RIGHT, factor, columns, c->components);
}

static void put_view(bonn_bytes *b, const bonn_case *c, uint32_t view) {
  const uint32_t texels = c->width * c->height;
  const uint32_t lights = bonn_case_lights(c, view);
  const uint32_t length = c->channels * (c->transposed ? texels : lights);
  const uint32_t weights = c->transposed ? lights : texels;
  const unsigned char scalar_size = (unsigned char)c->scalar_size;
  put(b, &scalar_size, 1);
  put_count(b, c->components);
  put_count(b, weights);
  put_count(b, length);
  for (uint32_t k = 0; k < c->components; k++) put_scalar(b, c->scalar_size, 1);
  put_rows(b, c, FACTOR_MEAN, view, length, 1);
  put_rows(b, c, FACTOR_LEFT, view, length, c->components);
  put_rows(b, c, FACTOR_RIGHT, view, weights, c->components);
}

static float colour_constant(uint32_t i) {
  return (float)value(9, 0, i, 0);
}

static bool is_hole(const bonn_case *c, uint32_t texel) {
  return c->holes && texel % 3 == 1;
}

static void put_fields(bonn_bytes *b, const bonn_case *c) {
  const uint32_t field = c->channels * pair_of(c, c->views, 0);
  const unsigned char sparse = c->holes ? 2 : 0;
  put_count(b, c->chunk_rows);
  put(b, &sparse, 1);
  for (uint32_t i = 0; i < c->width * c->height; i++) {
    const unsigned char there = !is_hole(c, i);
    put(b, &there, 1);
  }
  put_count(b, c->rotations);
  for (uint32_t row = 0; row < c->height; row += c->chunk_rows) {
    const uint32_t end = row + c->chunk_rows < c->height ? row + c->chunk_rows : c->height;
    uint32_t present = 0;
    for (uint32_t i = row * c->width; i < end * c->width; i++) present += !is_hole(c, i);
    put_count(b, 2 * field * present);
    for (uint32_t i = row * c->width; i < end * c->width; i++)
      for (uint32_t k = 0; k < field && !is_hole(c, i); k++) put_half(b, entry(c, FACTOR_FIELD, 0, i, k));
  }
}

bonn_bytes bonn_case_write(const bonn_case *c) {
  bonn_bytes b = {0};
  put(&b, c->signature, strlen(c->signature));
  if (c->legacy) {
    put_u32(&b, 301074);
    put_u32(&b, c->components);
    put_size(&b, c);
    put_count(&b, c->views);
    put_directions(&b, c);
    for (uint32_t v = 0; v < c->views; v++) put_view(&b, c, v);
    return b;
  }
  put_meta(&b, c);
  put_directions(&b, c);
  put_size(&b, c);
  if (c->family == BONN_CASE_BDI) {
    put_fields(&b, c);
    return b;
  }
  if (c->signature[strlen(c->signature) - 1] == 'R') {
    put_count(&b, c->rotations);
    for (uint32_t i = 0; i < c->rotations * c->rotation_bytes; i++) put(&b, "r", 1);
  }
  if (strncmp(c->signature, "!FMF12", 6) == 0) {
    const unsigned char extension = 2;
    put(&b, &extension, 1);
    put_u32(&b, c->dynamic_range);
    put_count(&b, 3);
    put_count(&b, 1);
    for (int i = 0; i < 3; i++) put_half(&b, i);
  }
  put_count(&b, c->components);
  if (c->family == BONN_CASE_PVF) {
    put_count(&b, c->views);
    for (uint32_t v = 0; v < c->views; v++) put_view(&b, c, v);
  } else if (c->family == BONN_CASE_FMF) {
    put_matrix(&b, c, 0, c->channels);
  } else {
    put_u32(&b, c->colour_model);
    for (uint32_t i = 0; i < 12; i++) put_f32(&b, colour_constant(i));
    for (uint32_t i = 0; i < c->channels; i++) put_matrix(&b, c, i, 1);
  }
  return b;
}

/* ---- samples ---- */

/* A summand, or its size. */
typedef double (*summand)(double);
static double as_it_is(double x) {
  return x;
}

static double dot(const bonn_case *c, uint32_t factor, uint64_t left, uint64_t right, summand of) {
  double sum = 0;
  for (uint32_t k = 0; k < c->components; k++)
    sum += of(entry(c, FACTOR_LEFT, factor, left, k) * entry(c, FACTOR_RIGHT, factor, right, k));
  return sum;
}

static double stored(const bonn_case *c, uint32_t v, uint32_t l, uint32_t texel, uint32_t channel,
                     summand of) {
  const uint32_t lv = pair_of(c, v, l), n = c->channels;
  switch (c->family) {
  case BONN_CASE_DFMF:
    return c->transposed ? dot(c, channel, texel, lv, of) : dot(c, channel, lv, texel, of);
  case BONN_CASE_FMF:
    return c->transposed ? dot(c, 0, channel + (uint64_t)n * texel, lv, of)
                         : dot(c, 0, channel + (uint64_t)n * lv, texel, of);
  case BONN_CASE_PVF:
    return c->transposed ? dot(c, v, channel + (uint64_t)n * texel, l, of) +
                               of(entry(c, FACTOR_MEAN, v, channel + (uint64_t)n * texel, 0))
                         : dot(c, v, channel + (uint64_t)n * l, texel, of) +
                               of(entry(c, FACTOR_MEAN, v, channel + (uint64_t)n * l, 0));
  default:
    return is_hole(c, texel) ? 0 : of(entry(c, FACTOR_FIELD, 0, texel, channel + n * lv));
  }
}

double bonn_case_sample(const bonn_case *c, uint32_t view, uint32_t light, uint32_t x, uint32_t y,
                        uint32_t channel) {
  const double eps = 1e-5;
  const uint32_t texel = (c->height - 1 - y) * c->width + x;
  double s[8], f, sum = 0;
  double lum, u, v;
  for (uint32_t k = 0; k < c->channels; k++) s[k] = stored(c, view, light, texel, k, as_it_is);
  switch (c->colour_model) {
  case 0:
    return c->dynamic_range != 0 ? exp(s[channel]) - eps : s[channel];
  case 3:
    return s[0] * colour_constant(3 + channel) + s[1] * colour_constant(6 + channel) +
           s[2] * colour_constant(9 + channel) + colour_constant(channel);
  case 4:
    return channel == 0 ? s[0] + s[1] - s[2] : channel == 1 ? s[0] + s[2] : s[0] - s[1] - s[2];
  case 5:
    for (uint32_t k = 1; k < c->channels; k++) sum += s[k];
    return channel == 0 ? s[0] * (1 - sum) : s[channel] * s[0];
  case 6:
    f = s[0] * c->channels;
    for (uint32_t k = 1; k < c->channels; k++) sum += s[k];
    return channel == 0 ? f - sum / c->channels : f + s[channel] * f;
  case 12:
    return exp(s[channel]) - eps;
  default:
    break;
  }
  lum = c->colour_model == 1 ? s[0] : exp(s[0]) - eps;
  u = s[1];
  v = s[2];
  if (c->colour_model == 10) {
    u = copysign(exp(fabs(u) + log(eps)), u);
    v = copysign(exp(fabs(v) + log(eps)), v);
  } else if (c->colour_model == 11) {
    u *= lum + eps;
    v *= lum + eps;
  }
  return channel == 0 ? lum + 1.13983 * v : channel == 1 ? lum - 0.39465 * u - 0.5806 * v : lum + 2.03211 * u;
}

double bonn_case_size(const bonn_case *c, uint32_t view, uint32_t light, uint32_t x, uint32_t y,
                      uint32_t channel) {
  const uint32_t texel = (c->height - 1 - y) * c->width + x;
  double s[8];
  for (uint32_t k = 0; k < c->channels; k++) s[k] = stored(c, view, light, texel, k, fabs);
  switch (c->colour_model) {
  case 0:
    return s[channel];
  case 1:
    return channel == 0   ? s[0] + 1.13983 * s[2]
           : channel == 1 ? s[0] + 0.39465 * s[1] + 0.5806 * s[2]
                          : s[0] + 2.03211 * s[1];
  case 3:
    return s[0] * fabs(colour_constant(3 + channel)) + s[1] * fabs(colour_constant(6 + channel)) +
           s[2] * fabs(colour_constant(9 + channel)) + fabs(colour_constant(channel));
  case 4:
    return channel == 1 ? s[0] + s[2] : s[0] + s[1] + s[2];
  default:
    fail_msg("%s: samples are no sums", c->label);
    return 0;
  }
}
