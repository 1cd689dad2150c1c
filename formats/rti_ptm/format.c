/* SPDX-License-Identifier: MIT */
/* format.c: polynomial texture maps (`.ptm`) as data sets of one view, from straight above. */
#include "source/source_file.h"

enum { TERMS = 6, MOST_SIZE = 1 << 20 };

typedef struct ptm_file {
  source_file file;
  btf_dirset *lights, *views;
  uint32_t width, height;
  bool separate; /* a polynomial for each channel; otherwise one, and a colour */
  bool together; /* polynomial and colour of a texel are neighbours */
  bool srgb;
  double scale[TERMS], bias[TERMS];
  const unsigned char *texels;
} ptm_file;

static const char *const transfers[] = {"srgb", "linear", NULL};
BTF_PARAM(
    directions, BTF_PARAM_STRING,
    "lights that the polynomials are evaluated for: ubo81, ubo151 or grid:PxT (P azimuths, T elevations)",
    NULL, "ubo81", NULL, 0, 0);
BTF_PARAM(transfer, BTF_PARAM_CHOICE, "the curve of the camera's values, which is undone", NULL, "srgb",
          transfers, 0, 0);
static const btf_param_desc *const params[] = {&directions, &transfer, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && probe->head_size >= 8 && memcmp(probe->head, "PTM_1.", 6) == 0 ? 90 : 0;
}

/* ---- header ---- */

static bool is_blank(uint8_t c) {
  return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}

/* The next word, cut at 63 characters; empty at the end. The cursor stays behind it. */
static void take_word(cursor *c, char word[64]) {
  size_t length = 0;
  while (cursor_left(c) > 0 && is_blank(c->file->data[c->at])) c->at++;
  while (cursor_left(c) > 0 && !is_blank(c->file->data[c->at])) {
    const char letter = (char)cursor_u8(c);
    if (length < 63) word[length++] = letter;
  }
  word[length] = '\0';
}

/* A decimal number, whatever the locale. */
static bool parse_number(const char *text, double *out) {
  const bool negative = *text == '-';
  double value = 0, place = 1;
  int digits = 0, power = 0;
  if (*text == '-' || *text == '+') text++;
  for (; *text >= '0' && *text <= '9'; text++, digits++) value = value * 10 + (*text - '0');
  if (*text == '.')
    for (text++; *text >= '0' && *text <= '9'; text++, digits++) value += (*text - '0') * (place /= 10);
  if (digits > 0 && (*text == 'e' || *text == 'E')) {
    const bool down = *++text == '-';
    int size = 0;
    if (*text == '-' || *text == '+') text++;
    for (digits = 0; *text >= '0' && *text <= '9'; text++, digits++)
      if (size < 1000) size = size * 10 + (*text - '0');
    power = down ? -size : size;
  }
  *out = (negative ? -value : value) * pow(10, power);
  return digits > 0 && *text == '\0' && isfinite(*out);
}

static btf_status fail_header(const source_file *file, cursor *c, const char *what) {
  return (file->host->fail)(file->ctx, cursor_left(c) == 0 ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                            "%s: its header has no sound %s", file->path, what);
}

static btf_status read_size(const source_file *file, cursor *c, const char *what, uint32_t *out) {
  char word[64];
  double value;
  take_word(c, word);
  if (!parse_number(word, &value) || !(value >= 1 && value <= MOST_SIZE) || value != floor(value))
    return fail_header(file, c, what);
  *out = (uint32_t)value;
  return BTF_OK;
}

/* One line end, perhaps after a blank: more may be texels already. */
static void skip_line_end(cursor *c) {
  uint8_t letter = cursor_u8(c);
  if (letter == ' ' || letter == '\t') letter = cursor_u8(c);
  if (letter == '\r') letter = cursor_u8(c);
  if (letter != '\n') c->ended = true;
}

static btf_status parse(ptm_file *ptm) {
  const source_file *file = &ptm->file;
  cursor c = {.file = file};
  char version[64], kind[64], word[64];
  take_word(&c, version);
  take_word(&c, kind);
  if (strncmp(version, "PTM_1.", 6) != 0)
    return (file->host->fail)(file->ctx, BTF_E_NOT_BTF, "%s: is not a polynomial texture map", file->path);
  if (version[6] < '0' || version[6] > '2' || version[7] != '\0')
    return (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED, "%s: is a PTM of another version than 1.0 to 1.2",
                              file->path);
  ptm->separate = strcmp(kind, "PTM_FORMAT_RGB") == 0;
  if (!ptm->separate && strcmp(kind, "PTM_FORMAT_LRGB") != 0)
    return cursor_left(&c) == 0
               ? fail_header(file, &c, "kind")
               : (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED,
                                    "%s: is a PTM of another kind than RGB and LRGB", file->path);
  ptm->together = !ptm->separate && version[6] < '2';
  BTF_TRY(read_size(file, &c, "width", &ptm->width));
  BTF_TRY(read_size(file, &c, "height", &ptm->height));
  for (int i = 0; i < 2 * TERMS; i++) {
    take_word(&c, word);
    if (!parse_number(word, i < TERMS ? &ptm->scale[i] : &ptm->bias[i - TERMS]))
      return fail_header(file, &c, i < TERMS ? "scale" : "bias");
  }
  skip_line_end(&c);
  const uint64_t bytes = (uint64_t)ptm->width * ptm->height * (ptm->separate ? 3 * TERMS : TERMS + 3);
  if (c.ended || cursor_left(&c) != bytes)
    return (file->host->fail)(file->ctx, c.ended || cursor_left(&c) < bytes ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                              "%s: has %llu bytes of texels instead of %llu", file->path,
                              (unsigned long long)cursor_left(&c), (unsigned long long)bytes);
  ptm->texels = cursor_take(&c, bytes, 1);
  return BTF_OK;
}

/* ---- samples ---- */

/* Beyond 1 the curve goes on, below 0 it is turned about 0. */
static double linear_of(double value) {
  const double size = fabs(value);
  return copysign(size <= 0.04045 ? size / 12.92 : pow((size + 0.055) / 1.055, 2.4), value);
}

static double polynomial(const ptm_file *ptm, const unsigned char *p, const double weights[TERMS]) {
  double sum = 0;
  for (int i = 0; i < TERMS; i++) sum += weights[i] * ptm->scale[i] * (p[i] - ptm->bias[i]);
  return sum / 255;
}

static void texel(const ptm_file *ptm, uint64_t at, const double weights[TERMS], float out[3]) {
  const uint64_t count = (uint64_t)ptm->width * ptm->height;
  const unsigned char *p = ptm->texels + at * (ptm->together ? TERMS + 3 : TERMS);
  const unsigned char *colour = ptm->together ? p + TERMS : ptm->texels + count * TERMS + at * 3;
  for (uint32_t c = 0; c < 3; c++) {
    const double value = ptm->separate ? polynomial(ptm, p + c * count * TERMS, weights)
                                       : polynomial(ptm, p, weights) * colour[c] / 255;
    out[c] = (float)(ptm->srgb ? linear_of(value) : value);
  }
}

static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const ptm_file *ptm = user;
  const float *all = (ptm->file.host->dirset_directions)(ptm->lights);
  for (uint32_t l = 0; l < block->lights; l++) {
    const float *light = all + 3 * (size_t)(block->light0 + l);
    const double x = (double)light[0], y = (double)light[1];
    const double weights[TERMS] = {x * x, y * y, x * y, x, y, 1};
    for (uint32_t row = 0; row < block->height; row++)
      for (uint32_t column = 0; column < block->width; column++) {
        float values[3];
        /* The file's first row is the bottom one, as here. */
        texel(ptm, (uint64_t)(block->y0 + row) * ptm->width + block->x0 + column, weights, values);
        for (uint32_t c = 0; c < 3; c++)
          memcpy((char *)dst + (ptrdiff_t)l * strides->light + (ptrdiff_t)row * strides->y +
                     (ptrdiff_t)column * strides->x + (ptrdiff_t)c * strides->channel,
                 &values[c], sizeof values[c]);
      }
  }
  return BTF_OK;
}

static void release(void *user) {
  ptm_file *ptm = user;
  const btf_host *host = ptm->file.host;
  btf_context *ctx = ptm->file.ctx;
  (host->dirset_release)(ptm->lights);
  (host->dirset_release)(ptm->views);
  source_file_close(&ptm->file);
  (host->free)(ctx, ptm);
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  static const float above[3] = {0, 0, 1};
  const int choice = (int)(host->option)(options, "transfer");
  const char *const notes[] = {"reader", "rti-ptm", "transfer", transfers[choice], NULL};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  ptm_file *ptm = (host->alloc)(ctx, 1, sizeof *ptm);
  if (ptm == NULL) return BTF_E_NOMEM;
  *ptm = (ptm_file){.srgb = choice == 0};
  btf_status status = source_file_open(host, ctx, path, &ptm->file);
  if (status != BTF_OK) {
    (host->free)(ctx, ptm);
    return status;
  }
  status = parse(ptm);
  if (status == BTF_OK)
    status = (host->dirset_create_named)(ctx, (host->option_text)(options, "directions"), &ptm->lights);
  if (status == BTF_OK) status = (host->dirset_create)(ctx, above, 1, &ptm->views);
  if (status != BTF_OK) {
    release(ptm);
    return status;
  }
  const char *slash = strrchr(ptm->file.path, '/');
  desc.lights = ptm->lights;
  desc.views = ptm->views;
  desc.width = ptm->width;
  desc.height = ptm->height;
  desc.channels = 3;
  desc.quantity = BTF_QUANTITY_BRDF_COS;
  desc.flags = BTF_DATASET_CONCURRENT_READ;
  desc.name = slash != NULL ? slash + 1 : ptm->file.path;
  desc.read = read_block;
  desc.user = ptm;
  desc.release = release;
  desc.notes = notes;
  return (host->dataset_create)(ctx, &desc, out);
}

const btf_format_vtbl btf_format_rti_ptm = {.struct_size = sizeof(btf_format_vtbl),
                                            .abi = LIBBTF_ABI,
                                            .id = "rti-ptm",
                                            .title = "PTM: polynomial texture maps, one view (LRGB and RGB)",
                                            .version = "1",
                                            .params = params,
                                            .probe = probe,
                                            .open = open_file};
