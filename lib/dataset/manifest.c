/* SPDX-License-Identifier: MIT */
#include "dataset/manifest.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* Reads the keys of one manifest; every failure names the file and the key. */
typedef struct manifest_reader {
  btf_context *ctx;
  const char *label;
  const btfi_json *root;
} manifest_reader;

typedef struct choice {
  const char *text;
  uint32_t value;
} choice;

static btf_status bad_key(const manifest_reader *r, const char *key, const char *expected) {
  const btfi_json *v = btfi_json_get(r->root, key);
  if (!v)
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" is missing; expected %s", r->label, key, expected);
  if (btfi_json_type(v) == BTFI_JSON_NUMBER)
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" is %.9g; expected %s", r->label, key,
                     btfi_json_number(v), expected);
  if (btfi_json_string(v))
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" is \"%.80s\"; expected %s", r->label, key,
                     btfi_json_string(v), expected);
  return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" has the wrong type; expected %s", r->label, key,
                   expected);
}

/* ---- single values ---- */

static btf_status read_size(const manifest_reader *r, const char *key, uint32_t *out) {
  const btfi_json *v = btfi_json_get(r->root, key);
  const double number = btfi_json_number(v);
  const uint32_t limit = btfi_limits(r->ctx)->max_dimension;
  if (btfi_json_type(v) != BTFI_JSON_NUMBER || !(number >= 1.0 && number <= 65536.0) ||
      number != floor(number))
    return bad_key(r, key, "a whole number from 1 to 65536");
  if (number > limit)
    return btfi_fail(r->ctx, BTF_E_LIMIT, "%s: \"%s\" is %.0f; the limit is %u", r->label, key, number,
                     limit);
  *out = (uint32_t)number;
  return BTF_OK;
}

static btf_status read_choice(const manifest_reader *r, const char *key, const choice *choices,
                              const char *expected, bool optional, uint32_t *out) {
  const btfi_json *v = btfi_json_get(r->root, key);
  if (!v && optional) return BTF_OK;
  const char *text = btfi_json_string(v);
  for (const choice *c = choices; text && c->text; ++c)
    if (strcmp(c->text, text) == 0) {
      *out = c->value;
      return BTF_OK;
    }
  return bad_key(r, key, expected);
}

static btf_status read_text(const manifest_reader *r, const char *key, const char **out) {
  const btfi_json *v = btfi_json_get(r->root, key);
  *out = NULL;
  if (!v || btfi_json_type(v) == BTFI_JSON_NULL) return BTF_OK;
  *out = btfi_json_string(v);
  return *out ? BTF_OK : bad_key(r, key, "a string");
}

static btf_status read_texels_per_mm(const manifest_reader *r, double *out) {
  const btfi_json *v = btfi_json_get(r->root, "texels_per_mm");
  *out = 0.0;
  if (!v || btfi_json_type(v) == BTFI_JSON_NULL) return BTF_OK;
  const double number = btfi_json_number(v);
  if (btfi_json_type(v) != BTFI_JSON_NUMBER || !(number >= 0.0 && number <= 1e12))
    return bad_key(r, "texels_per_mm", "a number above 0");
  *out = number;
  return BTF_OK;
}

/* ---- arrays ---- */

static btf_status read_channels(const manifest_reader *r, btfi_manifest *m) {
  static const char expected[] = "an array of 1 to 64 names";
  const btfi_json *v = btfi_json_get(r->root, "channels");
  const uint64_t count = btfi_json_length(v);
  const uint32_t limit = btfi_limits(r->ctx)->max_channels;
  if (btfi_json_type(v) != BTFI_JSON_ARRAY) return bad_key(r, "channels", expected);
  if (count < 1 || count > 64)
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"channels\" has %" PRIu64 " entries; expected %s", r->label,
                     count, expected);
  if (count > limit)
    return btfi_fail(r->ctx, BTF_E_LIMIT, "%s: \"channels\" has %" PRIu64 " entries; the limit is %u",
                     r->label, count, limit);
  m->channels = (uint32_t)count;
  for (uint32_t c = 0; c < m->channels; ++c) {
    m->channel_names[c] = btfi_json_string(btfi_json_at(v, c));
    if (!m->channel_names[c])
      return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"channels\" entry %u is not a string", r->label, c);
  }
  return BTF_OK;
}

static btf_status read_direction(const manifest_reader *r, const char *key, uint32_t i, const btfi_json *v,
                                 float xyz[3]) {
  double d[3] = {0.0, 0.0, 0.0};
  bool numbers = btfi_json_type(v) == BTFI_JSON_ARRAY && btfi_json_length(v) == 3;
  for (int k = 0; k < 3 && numbers; ++k) {
    const btfi_json *component = btfi_json_at(v, (uint64_t)k);
    numbers = btfi_json_type(component) == BTFI_JSON_NUMBER;
    d[k] = btfi_json_number(component);
    xyz[k] = (float)d[k];
  }
  if (!numbers)
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" direction %u is not an array of three numbers",
                     r->label, key, i);
  const double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
  if (!(fabs(length - 1.0) <= 1e-3))
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" direction %u has length %.6g; expected a unit vector",
                     r->label, key, i, length);
  if (!(xyz[2] > 0.0f))
    return btfi_fail(r->ctx, BTF_E_CORRUPT,
                     "%s: \"%s\" direction %u has z = %.6g; expected one above the horizon (z > 0)", r->label,
                     key, i, d[2]);
  return BTF_OK;
}

static btf_status read_directions(const manifest_reader *r, const char *key, btf_dirset **out) {
  const btfi_json *v = btfi_json_get(r->root, key);
  const uint64_t count = btfi_json_length(v);
  const uint32_t limit = btfi_limits(r->ctx)->max_directions;
  if (btfi_json_type(v) != BTFI_JSON_ARRAY) return bad_key(r, key, "an array of unit vectors [x, y, z]");
  if (count == 0)
    return btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\" is empty; expected at least one direction", r->label,
                     key);
  if (count > limit)
    return btfi_fail(r->ctx, BTF_E_LIMIT, "%s: \"%s\" has %" PRIu64 " directions; the limit is %u", r->label,
                     key, count, limit);
  float *xyz = btfi_alloc(r->ctx, count, 3 * sizeof *xyz);
  if (!xyz) return btfi_alloc_status();
  btf_status status = BTF_OK;
  for (uint32_t i = 0; i < count && status == BTF_OK; ++i)
    status = read_direction(r, key, i, btfi_json_at(v, i), xyz + 3 * (size_t)i);
  if (status == BTF_OK) {
    status = btf_dirset_create(r->ctx, xyz, (uint32_t)count, out);
    if (status == BTF_E_INVALID_ARG) {
      /* The set knows what is wrong with the directions, but not whose they are. */
      char reason[400];
      snprintf(reason, sizeof reason, "%s", btf_error_message());
      status = btfi_fail(r->ctx, BTF_E_CORRUPT, "%s: \"%s\": %s", r->label, key, reason);
    }
  }
  btfi_free(r->ctx, xyz);
  return status;
}

/* ---- the whole ---- */

static bool is_plain_file_name(const char *name) {
  return name[0] != '\0' && strcmp(name, ".") != 0 && strcmp(name, "..") != 0 && !strchr(name, '/') &&
         !strchr(name, '\\') && strcmp(name, BTFI_MANIFEST_FILE) != 0;
}

static btf_status read_format(const manifest_reader *r) {
  const char *format = btfi_json_string(btfi_json_get(r->root, "format"));
  if (format && strcmp(format, BTFI_EXPORT_FORMAT) == 0)
    return btfi_fail(r->ctx, BTF_E_NOT_BTF, "%s: is that of a GPU export; give the .btfz it was made of",
                     r->label);
  if (!format || strcmp(format, BTFI_MANIFEST_FORMAT) != 0)
    return btfi_fail(r->ctx, BTF_E_NOT_BTF, "%s: \"format\" is not \"" BTFI_MANIFEST_FORMAT "\"", r->label);
  const btfi_json *v = btfi_json_get(r->root, "version");
  const double version = btfi_json_number(v);
  if (btfi_json_type(v) != BTFI_JSON_NUMBER || !(version >= 1.0) || version != floor(version))
    return bad_key(r, "version", "1");
  if (version > btfi_manifest_version)
    return btfi_fail(r->ctx, BTF_E_NEWER, "%s: version %.9g is newer than this library; expected at most %d",
                     r->label, version, btfi_manifest_version);
  return BTF_OK;
}

static btf_status read_samples_size(const manifest_reader *r, btfi_manifest *m) {
  const uint64_t factors[] = {btf_dirset_count(m->views), btf_dirset_count(m->lights), m->height, m->width,
                              m->channels};
  m->bytes = btfi_sample_size(m->sample_type);
  for (size_t i = 0; i < sizeof factors / sizeof factors[0]; ++i)
    if (!btfi_mul(m->bytes, factors[i], &m->bytes) || m->bytes > INT64_MAX)
      return btfi_fail(r->ctx, BTF_E_LIMIT, "%s: the sizes make more than 2^63 bytes of samples", r->label);
  return BTF_OK;
}

/* What this format gives no meaning to; how the folder was made is no property of its data. */
static void read_notes(const manifest_reader *r, btfi_manifest *m) {
  uint32_t count = 0;
  for (uint64_t i = 0; i < btfi_json_length(r->root) && count < 2 * btfi_manifest_most_notes; ++i) {
    const btfi_json *member = btfi_json_at(r->root, i);
    const char *key = btfi_json_key(member), *text = btfi_json_string(member);
    if (!key || !text || btfi_manifest_key_is_taken(key) || strcmp(key, "command") == 0) continue;
    m->notes[count++] = key;
    m->notes[count++] = text;
  }
}

static btf_status read_keys(const manifest_reader *r, btfi_manifest *m) {
  static const choice types[] = {{"u8", BTF_SAMPLE_U8},
                                 {"u16", BTF_SAMPLE_U16},
                                 {"f16", BTF_SAMPLE_F16},
                                 {"f32", BTF_SAMPLE_F32},
                                 {NULL, 0}};
  static const choice orders[] = {{"vlyxc", BTF_ORDER_VLYXC}, {"yxvlc", BTF_ORDER_YXVLC}, {NULL, 0}};
  static const choice quantities[] = {
      {"brdf", BTF_QUANTITY_BRDF}, {"brdf_cos", BTF_QUANTITY_BRDF_COS}, {NULL, 0}};
  static const choice scales[] = {
      {"absolute", BTF_SCALE_ABSOLUTE}, {"relative", BTF_SCALE_RELATIVE}, {NULL, 0}};
  static const choice wraps[] = {{"periodic", BTF_WRAP_PERIODIC}, {"clamp", BTF_WRAP_CLAMP}, {NULL, 0}};
  m->scale = BTF_SCALE_RELATIVE;
  m->wrap = BTF_WRAP_PERIODIC;
  BTFI_TRY(read_format(r));
  BTFI_TRY(read_size(r, "width", &m->width));
  BTFI_TRY(read_size(r, "height", &m->height));
  BTFI_TRY(read_channels(r, m));
  BTFI_TRY(read_choice(r, "type", types, "\"u8\", \"u16\", \"f16\" or \"f32\"", false, &m->sample_type));
  BTFI_TRY(read_choice(r, "order", orders, "\"vlyxc\" or \"yxvlc\"", false, &m->order));
  BTFI_TRY(read_choice(r, "quantity", quantities, "\"brdf\" or \"brdf_cos\"", false, &m->quantity));
  BTFI_TRY(read_choice(r, "scale", scales, "\"absolute\" or \"relative\"", true, &m->scale));
  BTFI_TRY(read_choice(r, "wrap", wraps, "\"periodic\" or \"clamp\"", true, &m->wrap));
  BTFI_TRY(read_texels_per_mm(r, &m->texels_per_mm));
  BTFI_TRY(read_text(r, "name", &m->name));
  BTFI_TRY(read_text(r, "source", &m->source));
  BTFI_TRY(read_text(r, "license", &m->license));
  BTFI_TRY(read_text(r, "color_space", &m->color_space));
  BTFI_TRY(read_text(r, "samples", &m->samples));
  if (!m->samples) m->samples = "samples.bin";
  if (!is_plain_file_name(m->samples)) return bad_key(r, "samples", "the name of a file beside the manifest");
  BTFI_TRY(read_directions(r, "views", &m->views));
  BTFI_TRY(read_directions(r, "lights", &m->lights));
  read_notes(r, m);
  return read_samples_size(r, m);
}

btf_status btfi_manifest_parse(btf_context *ctx, const char *label, const char *text, uint64_t size,
                               btfi_manifest *out) {
  memset(out, 0, sizeof *out);
  BTFI_TRY(btfi_json_parse(ctx, label, text, size, &out->document));
  const manifest_reader reader = {ctx, label, out->document};
  const btf_status status =
      btfi_json_type(out->document) == BTFI_JSON_OBJECT
          ? read_keys(&reader, out)
          : btfi_fail(ctx, BTF_E_NOT_BTF, "%s: not a JSON object; expected the manifest of a data set",
                      label);
  if (status != BTF_OK) btfi_manifest_free(out);
  return status;
}

void btfi_manifest_free(btfi_manifest *m) {
  btf_dirset_release(m->views);
  btf_dirset_release(m->lights);
  btfi_json_free(m->document);
  memset(m, 0, sizeof *m);
}

btf_status btfi_manifest_is_ours(btf_context *ctx, const char *label, const char *text, uint64_t size,
                                 char *samples, size_t samples_size) {
  btfi_json *root;
  BTFI_TRY(btfi_json_parse(ctx, label, text, size, &root));
  const char *format = btfi_json_string(btfi_json_get(root, "format"));
  const char *file = btfi_json_string(btfi_json_get(root, "samples"));
  const bool ours = format && strcmp(format, BTFI_MANIFEST_FORMAT) == 0;
  snprintf(samples, samples_size, "%s", file && is_plain_file_name(file) ? file : "samples.bin");
  btfi_json_free(root);
  return ours ? BTF_OK : BTF_E_INVALID_ARG;
}
