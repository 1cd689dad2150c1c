/* SPDX-License-Identifier: MIT */
/* header.c: signature, meta block, directions and sizes. */
#include <math.h>
#include <stdio.h>

#include "bonn_btf/bonn_btf.h"

typedef struct signature {
  const char *text;
  bonn_family family;
  bool extended; /* an extension header precedes the factor */
} signature;

/* Without the R that announces rotations. */
static const signature signatures[] = {{"!DFMF08FC", BONN_DFMF, false},
                                       {"!FMF12FCE", BONN_FMF, true},
                                       {"!FMF06FC", BONN_FMF, false},
                                       {"!PVF06FC", BONN_PVF, false},
                                       {"!BDIF06R2!", BONN_BDI, false}};
enum { LEGACY_PVF = 301074, MOST_CHANNELS = 64, MOST_ANGLES = 65536 };
/* Two lists of lights are the same within this angle in radians. */
static const float same_angle = 1e-4f;

static const signature *find_signature(const unsigned char *head, uint64_t size) {
  for (size_t i = 0; i < sizeof signatures / sizeof *signatures; i++) {
    const size_t length = strlen(signatures[i].text);
    if (size >= length && memcmp(head, signatures[i].text, length) == 0) return &signatures[i];
  }
  return NULL;
}

bool bonn_is_signature(const unsigned char *head, uint64_t size) {
  return find_signature(head, size) != NULL;
}

btf_status bonn_truncated(const bonn_file *bonn, const char *within) {
  return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_TRUNCATED, "%s: the file ends within %s",
                                 bonn->file.path, within);
}

static btf_status corrupt(const bonn_file *bonn, const char *what, double got, double expected) {
  return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: %s is %.10g; expected %.10g",
                                 bonn->file.path, what, got, expected);
}

/* ---- meta block ---- */

static void copy_padded(char out[81], const unsigned char *text) {
  if (text != NULL) memcpy(out, text, 80);
  out[80] = '\0';
}

static btf_status read_channels(bonn_file *bonn, cursor *c) {
  const btf_host *host = bonn->file.host;
  const uint32_t count = cursor_u32(c);
  if (c->ended) return bonn_truncated(bonn, "the meta block");
  if (count < 1 || count > MOST_CHANNELS)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: %u channels; expected 1 to %d", bonn->file.path,
                        (unsigned)count, MOST_CHANNELS);
  bonn->channel_names = (host->alloc)(bonn->file.ctx, count, sizeof *bonn->channel_names);
  if (bonn->channel_names == NULL) return BTF_E_NOMEM;
  memset(bonn->channel_names, 0, count * sizeof *bonn->channel_names);
  bonn->channels = count;
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t length = cursor_u32(c);
    const unsigned char *text = cursor_take(c, length, 1);
    if (text == NULL) return bonn_truncated(bonn, "the names of the channels");
    bonn->channel_names[i] = (host->alloc)(bonn->file.ctx, (uint64_t)length + 1, 1);
    if (bonn->channel_names[i] == NULL) return BTF_E_NOMEM;
    memcpy(bonn->channel_names[i], text, length);
    bonn->channel_names[i][length] = '\0';
  }
  return BTF_OK;
}

static btf_status read_meta(bonn_file *bonn, cursor *c) {
  const uint64_t begin = c->at;
  const uint32_t size = cursor_u32(c);
  bonn->version = cursor_u32(c);
  copy_padded(bonn->setup, cursor_take(c, 80, 1));
  copy_padded(bonn->sensor, cursor_take(c, 80, 1));
  copy_padded(bonn->light_source, cursor_take(c, 80, 1));
  bonn->texels_per_mm = cursor_f32(c);
  cursor_take(c, 3, 4); /* scale factors of RGB, which no reader applies */
  bonn->channels = 3;
  if (bonn->version > 1) bonn->cosine = cursor_u32(c);
  if (bonn->version > 2) cursor_take(c, cursor_u32(c), 1); /* XML of the measurement */
  if (c->ended) return bonn_truncated(bonn, "the meta block");
  if (bonn->version > 3) BTF_TRY(read_channels(bonn, c));
  if (bonn->version == 0) return corrupt(bonn, "the version of the meta block", 0, 1);
  if (size != c->at - begin) {
    if (bonn->version > 4)
      return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_NEWER,
                                     "%s: the meta block has version %u; known are 1 to 4", bonn->file.path,
                                     (unsigned)bonn->version);
    return corrupt(bonn, "the size of the meta block", size, (double)(c->at - begin));
  }
  return BTF_OK;
}

/* ---- directions ---- */

void bonn_direction(const unsigned char *angles, float xyz[3]) {
  const double theta = (double)btf_get_f32(angles), phi = (double)btf_get_f32(angles + 4);
  xyz[0] = (float)(sin(theta) * cos(phi));
  xyz[1] = (float)(sin(theta) * sin(phi));
  xyz[2] = (float)cos(theta);
}

static btf_status check_angles(const bonn_file *bonn, const unsigned char *angles, const char *kind,
                               uint32_t i) {
  const float theta = btf_get_f32(angles), phi = btf_get_f32(angles + 4);
  if (!(fabsf(theta) <= 3.1416f) || !(fabsf(phi) <= 4 * 3.1416f))
    return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_CORRUPT,
                                   "%s: %s direction %u has the angles %g and %g; expected radians",
                                   bonn->file.path, kind, (unsigned)i, (double)theta, (double)phi);
  float direction[3];
  bonn_direction(angles, direction);
  if (!(direction[2] > 0))
    return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_CORRUPT,
                                   "%s: %s direction %u is %g degrees from the normal; expected less than 90",
                                   bonn->file.path, kind, (unsigned)i, (double)theta * 180 / acos(-1.0));
  return BTF_OK;
}

bool bonn_same_lights(const bonn_lights *a, const bonn_lights *b) {
  if (a->count != b->count) return false;
  if (memcmp(a->angles, b->angles, (size_t)a->count * 8) == 0) return true;
  for (uint32_t i = 0; i < a->count; i++) {
    float from[3], to[3];
    bonn_direction(a->angles + (size_t)i * 8, from);
    bonn_direction(b->angles + (size_t)i * 8, to);
    for (int k = 0; k < 3; k++)
      if (!(fabsf(from[k] - to[k]) <= same_angle)) return false;
  }
  return true;
}

static btf_status read_lights(bonn_file *bonn, cursor *c, uint32_t view) {
  bonn_lights *list = &bonn->lights[view];
  list->before = bonn->pairs;
  list->count = cursor_u32(c);
  if (c->ended) return bonn_truncated(bonn, "the directions");
  if (list->count < 1 || list->count > MOST_ANGLES || list->count > cursor_left(c) / 8)
    return (bonn->file.host->fail)(
        bonn->file.ctx, BTF_E_CORRUPT,
        "%s: %u lights of view %u; expected 1 to %d, and the file is of %llu bytes", bonn->file.path,
        (unsigned)list->count, (unsigned)view, MOST_ANGLES, (unsigned long long)bonn->file.size);
  list->angles = cursor_take(c, list->count, 8);
  bonn->pairs += list->count;
  /* What has the bytes of the first list is as sound as that. */
  if (view > 0 && list->count == bonn->lights[0].count &&
      memcmp(list->angles, bonn->lights[0].angles, (size_t)list->count * 8) == 0)
    return BTF_OK;
  for (uint32_t i = 0; i < list->count; i++)
    BTF_TRY(check_angles(bonn, list->angles + (size_t)i * 8, "light", i));
  if (!bonn_same_lights(&bonn->lights[0], list)) bonn->lights_differ = true;
  return BTF_OK;
}

static btf_status read_directions(bonn_file *bonn, cursor *c) {
  const btf_host *host = bonn->file.host;
  const uint32_t count = cursor_u32(c);
  if (c->ended) return bonn_truncated(bonn, "the directions");
  if (count < 1 || count > MOST_ANGLES || count > cursor_left(c) / 20)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT,
                        "%s: %u views; expected 1 to %d, and the file is of %llu bytes", bonn->file.path,
                        (unsigned)count, MOST_ANGLES, (unsigned long long)bonn->file.size);
  bonn->view_count = count;
  bonn->views = (host->alloc)(bonn->file.ctx, count, 3 * sizeof(float));
  if (bonn->views == NULL) return BTF_E_NOMEM;
  bonn->lights = (host->alloc)(bonn->file.ctx, count, sizeof *bonn->lights);
  if (bonn->lights == NULL) return BTF_E_NOMEM;
  for (uint32_t v = 0; v < count; v++) {
    const unsigned char *angles = cursor_take(c, 2, 4);
    if (angles == NULL) return bonn_truncated(bonn, "the directions");
    BTF_TRY(check_angles(bonn, angles, "view", v));
    bonn_direction(angles, bonn->views + 3 * (size_t)v);
    BTF_TRY(read_lights(bonn, c, v));
  }
  return BTF_OK;
}

/* ---- the file ---- */

static btf_status read_size(bonn_file *bonn, cursor *c) {
  bonn->width = cursor_u32(c);
  bonn->height = cursor_u32(c);
  if (c->ended) return bonn_truncated(bonn, "the size of the texture");
  if (bonn->width < 1 || bonn->height < 1 || (uint64_t)bonn->width * bonn->height > INT32_MAX)
    return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_CORRUPT,
                                   "%s: %u x %u texels; expected 1 to 2^31 - 1 in all", bonn->file.path,
                                   (unsigned)bonn->width, (unsigned)bonn->height);
  return BTF_OK;
}

static btf_status read_rotations(bonn_file *bonn, cursor *c, uint32_t bytes) {
  bonn->rotations = cursor_u32(c);
  cursor_take(c, bonn->rotations, bytes);
  return c->ended ? bonn_truncated(bonn, "the rotations") : BTF_OK;
}

static btf_status read_extension(bonn_file *bonn, cursor *c) {
  const uint8_t version = cursor_u8(c);
  if (version >= 3)
    return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_NEWER,
                                   "%s: the extension has version %u; known are 0 to 2", bonn->file.path,
                                   (unsigned)version);
  if (version >= 1) bonn->dynamic_range = cursor_u32(c);
  if (version >= 2) {
    const uint32_t width = cursor_u32(c), height = cursor_u32(c);
    cursor_take(c, (uint64_t)width * height, 2); /* the height map */
  }
  return c->ended ? bonn_truncated(bonn, "the extension") : BTF_OK;
}

/* The older form of PVF: sizes first, then directions, no meta block. */
static btf_status read_legacy_pvf(bonn_file *bonn, cursor *c) {
  cursor_u32(c);
  cursor_u32(c); /* the largest number of components */
  bonn->channels = 3;
  BTF_TRY(read_size(bonn, c));
  const uint32_t slots = cursor_u32(c);
  BTF_TRY(read_directions(bonn, c));
  if (slots != bonn->view_count)
    return corrupt(bonn, "the number of factorisations", slots, bonn->view_count);
  bonn->factor_count = slots;
  return bonn_parse_factors(bonn, c);
}

static btf_status read_all(bonn_file *bonn, const signature *sign, bool rotations, uint32_t rotation_bytes) {
  cursor c = {&bonn->file, strlen(sign->text) + (rotations ? 1 : 0), false};
  cursor ahead = c;
  bonn->family = sign->family;
  if (sign->family == BONN_PVF && cursor_u32(&ahead) == LEGACY_PVF) return read_legacy_pvf(bonn, &c);
  BTF_TRY(read_meta(bonn, &c));
  BTF_TRY(read_directions(bonn, &c));
  BTF_TRY(read_size(bonn, &c));
  if (sign->family == BONN_BDI) return bonn_parse_fields(bonn, &c);
  if (rotations) BTF_TRY(read_rotations(bonn, &c, rotation_bytes));
  if (sign->extended) BTF_TRY(read_extension(bonn, &c));
  return bonn_parse_factors(bonn, &c);
}

static void forget(bonn_file *bonn) {
  const btf_host *host = bonn->file.host;
  btf_context *ctx = bonn->file.ctx;
  for (uint32_t i = 0; bonn->channel_names != NULL && i < bonn->channels; i++)
    (host->free)(ctx, bonn->channel_names[i]);
  (host->free)(ctx, bonn->channel_names);
  (host->free)(ctx, bonn->views);
  (host->free)(ctx, bonn->lights);
  (host->free)(ctx, bonn->factors);
  (host->free)(ctx, bonn->components);
  (host->free)(ctx, bonn->fields.chunks);
  (host->free)(ctx, bonn->fields.rank);
  *bonn = (bonn_file){.file = bonn->file};
}

btf_status bonn_file_parse(bonn_file *bonn) {
  const signature *sign = find_signature(bonn->file.data, bonn->file.size);
  if (sign == NULL)
    return (bonn->file.host->fail)(bonn->file.ctx, BTF_E_NOT_BTF,
                                   "%s: has none of the signatures of Bonn's containers", bonn->file.path);
  const size_t length = strlen(sign->text);
  /* An R announces rotations, but the low byte of the meta block's size may look like one. Nobody agrees on
   * the bytes of a rotation. What comes out even is right. */
  const bool r = sign->family != BONN_BDI && bonn->file.size > length && bonn->file.data[length] == 'R';
  const struct {
    bool rotations;
    uint32_t bytes;
  } forms[] = {{r, 36}, {r, 12}, {false, 0}};
  for (int i = 0; i < (r ? 3 : 1); i++) {
    const btf_status status = read_all(bonn, sign, forms[i].rotations, forms[i].bytes);
    if (status == BTF_OK || status == BTF_E_NOMEM) return status;
    forget(bonn);
  }
  return read_all(bonn, sign, r, 36); /* what was wrong with the likeliest form */
}

void bonn_file_close(bonn_file *bonn) {
  forget(bonn);
  source_file_close(&bonn->file);
}
