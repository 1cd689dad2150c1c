/* SPDX-License-Identifier: MIT */
/* parse.c: chunks, and what the description in XML says of directions. */
#include "utia_mif/mif.h"

enum { IMAGE = 0, XML = 1, IMAGE_HEAD = 48, CHUNK_HEAD = 16, MOST_XML = 1 << 24, MOST_DIRECTIONS = 4096 };

static const uint64_t signature = UINT64_C(0x454C49462046494D);

static uint64_t get_u64(const unsigned char *p) {
  return (uint64_t)btf_get_u32(p) | (uint64_t)btf_get_u32(p + 4) << 32;
}

bool mif_is_signature(const unsigned char *data, uint64_t size) {
  return size >= CHUNK_HEAD && get_u64(data) == signature;
}

typedef struct chunk {
  uint64_t type, size;
  const unsigned char *data;
} chunk;

/* 1 with a chunk, 0 at the end of the file, -1 where one is cut off. */
static int next_chunk(cursor *c, chunk *out) {
  if (cursor_left(c) == 0) return 0;
  const unsigned char *head = cursor_take(c, CHUNK_HEAD, 1);
  if (head == NULL) return -1;
  *out = (chunk){get_u64(head), get_u64(head + 8), NULL};
  out->data = cursor_take(c, out->size, 1);
  return out->data != NULL ? 1 : -1;
}

static btf_status scan(mif_file *mif) {
  const source_file *file = &mif->file;
  cursor c = {.file = file};
  chunk found;
  int more;
  while ((more = next_chunk(&c, &found)) > 0) {
    const bool first = mif->chunks++ == 0;
    if (first != (found.type == signature))
      return (file->host->fail)(file->ctx, first ? BTF_E_NOT_BTF : BTF_E_CORRUPT,
                                "%s: the chunk that marks a MIF file must be the first and only the first",
                                file->path);
    if (first && (found.size < 8 || get_u64(found.data) != 1))
      return (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED, "%s: is a MIF file of another version than 1",
                                file->path);
    if (found.type != XML) continue;
    if (mif->xml != NULL || found.size > MOST_XML)
      return (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: has %s", file->path,
                                mif->xml != NULL ? "two descriptions" : "a description of more than 16 MiB");
    mif->xml = found.data;
    mif->xml_size = found.size;
  }
  if (more < 0)
    return (file->host->fail)(file->ctx, BTF_E_TRUNCATED, "%s: ends within chunk %llu", file->path,
                              (unsigned long long)mif->chunks);
  if (mif->xml == NULL)
    return (file->host->fail)(file->ctx, mif->chunks > 0 ? BTF_E_UNSUPPORTED : BTF_E_NOT_BTF,
                              "%s: has no description of its images", file->path);
  return BTF_OK;
}

/* ---- description ---- */

/* Copies the value of an attribute of the tag in [at, end), cut at the size of `value`; false if it is not
 * there. */
static bool attribute(const unsigned char *at, const unsigned char *end, const char *name, char value[64]) {
  const size_t length = strlen(name);
  while (at < end) {
    while (at < end && !is_blank(*at)) at++;
    while (at < end && is_blank(*at)) at++;
    const unsigned char *key = at;
    while (at < end && *at != '=' && !is_blank(*at)) at++;
    const size_t key_length = (size_t)(at - key);
    while (at < end && (is_blank(*at) || *at == '=')) at++;
    if (at == end || (*at != '"' && *at != '\'')) continue;
    const unsigned char quote = *at++, *text = at;
    while (at < end && *at != quote) at++;
    if (key_length != length || memcmp(key, name, length) != 0) continue;
    const size_t size = (size_t)(at - text) < 63 ? (size_t)(at - text) : 63;
    memcpy(value, text, size);
    value[size] = '\0';
    return true;
  }
  return false;
}

/* The tag [*tag, *end) of the first element of that name from `at` on that has the attribute. */
static bool find_element(const mif_file *mif, const char *name, const char *key, const unsigned char **tag,
                         const unsigned char **end, char value[64]) {
  const unsigned char *at = mif->xml, *stop = mif->xml + mif->xml_size;
  const size_t length = strlen(name);
  while (at < stop && (at = memchr(at, '<', (size_t)(stop - at))) != NULL) {
    const bool comment = stop - at >= 4 && memcmp(at, "<!--", 4) == 0;
    const unsigned char *close = at;
    unsigned char quote = 0;
    for (; close < stop; close++) {
      if (comment ? close - at >= 6 && memcmp(close - 2, "-->", 3) == 0 : quote == 0 && *close == '>') break;
      if (!comment && (*close == '"' || *close == '\'') && (quote == 0 || quote == *close))
        quote = quote == 0 ? *close : 0;
    }
    if (close == stop) return false;
    if (!comment && (size_t)(close - at) > length + 1 && memcmp(at + 1, name, length) == 0 &&
        (is_blank(at[1 + length]) || at[1 + length] == '/') &&
        (key == NULL || attribute(at + 1 + length, close, key, value))) {
      *tag = at + 1 + length;
      *end = close;
      return true;
    }
    at = close + 1;
  }
  return false;
}

/* Rings every step degrees from the first to below 90, each of 360 / turn directions; the normal before them.
 */
static btf_status make_rings(mif_file *mif, uint32_t step, uint32_t turn, bool normal, btf_dirset **out) {
  const double radians = 3.14159265358979323846 / 180;
  const source_file *file = &mif->file;
  const uint32_t rings = 90 / step - 1, count = rings * (360 / turn) + normal;
  float *xyz = (file->host->alloc)(file->ctx, count, 3 * sizeof *xyz), *at = xyz;
  if (xyz == NULL) return BTF_E_NOMEM;
  if (normal) {
    at[0] = at[1] = 0;
    at[2] = 1;
    at += 3;
  }
  for (uint32_t i = 1; i <= rings; i++)
    for (uint32_t k = 0; k < 360 / turn; k++, at += 3) {
      const double theta = radians * (i * step), phi = radians * (k * turn);
      at[0] = (float)(sin(theta) * cos(phi));
      at[1] = (float)(sin(theta) * sin(phi));
      at[2] = (float)cos(theta);
    }
  const btf_status status = (file->host->dirset_create)(file->ctx, xyz, count, out);
  (file->host->free)(file->ctx, xyz);
  return status;
}

/* A whole number of degrees that divides `whole`, or 0. */
static uint32_t read_step(const mif_file *mif, const unsigned char *tag, const unsigned char *end,
                          const char *key, uint32_t whole) {
  char text[64];
  double value;
  if (!attribute(tag, end, key, text) || !(mif->file.host->number)(text, &value)) return 0;
  if (!(value >= 1 && value <= whole) || value != floor(value)) return 0;
  return whole % (uint32_t)value == 0 ? (uint32_t)value : 0;
}

static btf_status make_directions(mif_file *mif) {
  const source_file *file = &mif->file;
  const btf_host *host = file->host;
  const unsigned char *tag, *end, *other, *other_end;
  char name[64];
  if (find_element(mif, "mipmap", NULL, &other, &other_end, name))
    return (host->fail)(file->ctx, BTF_E_UNSUPPORTED,
                        "%s: has mipmaps packed into its images, which are not read", file->path);
  if (!find_element(mif, "directions", "name", &tag, &end, name))
    return (host->fail)(file->ctx, BTF_E_UNSUPPORTED, "%s: does not name its set of directions", file->path);
  if (strcmp(name, "UBO81x81") == 0) {
    BTF_TRY((host->dirset_create_named)(file->ctx, "ubo81", &mif->lights));
    BTF_TRY((host->dirset_create_named)(file->ctx, "ubo81", &mif->views));
  } else if (strcmp(name, "Uniform") == 0) {
    const uint32_t step = read_step(mif, tag, end, "stepTheta", 90),
                   turn = read_step(mif, tag, end, "stepPhi", 360);
    if (step == 0 || step > 45 || turn == 0 || (90 / step - 1) * (360 / turn) >= MOST_DIRECTIONS)
      return (host->fail)(file->ctx, BTF_E_CORRUPT,
                          "%s: its uniform directions have steps that do not divide a turn", file->path);
    BTF_TRY(make_rings(mif, step, turn, true, &mif->lights));
    BTF_TRY(make_rings(mif, step, turn, false, &mif->views));
  } else {
    return (host->fail)(file->ctx, BTF_E_UNSUPPORTED,
                        "%s: its directions are neither UBO81x81 nor Uniform, which are read", file->path);
  }
  mif->light_count = (host->dirset_count)(mif->lights);
  mif->view_count = (host->dirset_count)(mif->views);
  return BTF_OK;
}

/* ---- images ---- */

static btf_status fail_image(const mif_file *mif, btf_status status, uint64_t index, const char *what) {
  return (mif->file.host->fail)(mif->file.ctx, status, "%s: image %llu %s", mif->file.path,
                                (unsigned long long)index, what);
}

static btf_status take_image(mif_file *mif, const chunk *image, uint64_t count) {
  static const uint32_t sizes[] = {0, 1, 2, 4, 8, 1, 2, 4, 8, 2, 4, 8};
  if (image->size < IMAGE_HEAD)
    return fail_image(mif, BTF_E_CORRUPT, 0, "or another is shorter than its head");
  const uint64_t index = get_u64(image->data), type = get_u64(image->data + 16);
  const uint64_t height = get_u64(image->data + 24), width = get_u64(image->data + 32),
                 planes = get_u64(image->data + 40);
  uint64_t bytes;
  if (index >= count) return BTF_OK; /* not of the BTF */
  if (type == 0 || type >= sizeof sizes / sizeof *sizes)
    return fail_image(mif, BTF_E_CORRUPT, index, "has no known type");
  if (type < 9)
    return fail_image(mif, BTF_E_UNSUPPORTED, index, "has whole numbers, whose scale nothing tells");
  if (__builtin_mul_overflow(width, height, &bytes) || __builtin_mul_overflow(bytes, planes, &bytes) ||
      __builtin_mul_overflow(bytes, sizes[type], &bytes) || bytes != image->size - IMAGE_HEAD || bytes == 0 ||
      width > INT32_MAX || height > INT32_MAX)
    return fail_image(mif, BTF_E_CORRUPT, index, "has another size than its chunk");
  if (planes != 1 && planes != 3)
    return fail_image(mif, BTF_E_UNSUPPORTED, index, "has neither one plane nor three");
  if (mif->width == 0) {
    mif->width = (uint32_t)width;
    mif->height = (uint32_t)height;
    mif->channels = (uint32_t)planes;
    mif->type = (uint32_t)type;
  }
  if (mif->width != width || mif->height != height || mif->channels != planes || mif->type != type)
    return fail_image(mif, BTF_E_CORRUPT, index, "has another size or type than the first");
  if (mif->images[index] != NULL) return fail_image(mif, BTF_E_CORRUPT, index, "is there twice");
  mif->images[index] = image->data + IMAGE_HEAD;
  return BTF_OK;
}

btf_status mif_parse(mif_file *mif) {
  const source_file *file = &mif->file;
  chunk found;
  BTF_TRY(scan(mif));
  BTF_TRY(make_directions(mif));
  const uint64_t count = (uint64_t)mif->light_count * mif->view_count;
  if (mif->chunks < count)
    return (file->host->fail)(file->ctx, BTF_E_TRUNCATED,
                              "%s: has fewer images than its %llu pairs of directions", file->path,
                              (unsigned long long)count);
  mif->images = (file->host->alloc)(file->ctx, count, sizeof *mif->images);
  if (mif->images == NULL) return BTF_E_NOMEM;
  for (uint64_t i = 0; i < count; i++) mif->images[i] = NULL;
  cursor c = {.file = file};
  while (next_chunk(&c, &found) > 0)
    if (found.type == IMAGE) BTF_TRY(take_image(mif, &found, count));
  for (uint64_t i = 0; i < count; i++)
    if (mif->images[i] == NULL) return fail_image(mif, BTF_E_TRUNCATED, i, "is missing");
  return BTF_OK;
}
