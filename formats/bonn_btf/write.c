/* SPDX-License-Identifier: MIT */
/* write.c: factors of all views in one as a file of the FMF or DFMF family. */
#include <errno.h>
#include <stdio.h>

#include "bonn_btf/bonn_btf.h"

static const char *const families[] = {"fmf", "dfmf", NULL};
static const char *const numbers[] = {"auto", "half", "float", NULL};
enum { FMF = 0, DFMF = 1, AUTO = 0, HALF = 1 };
BTF_PARAM(family, BTF_PARAM_CHOICE,
          "one factorisation, or one of each channel, in which the texels' side comes once for each", NULL,
          "fmf", families, 0, 0);
BTF_PARAM(scalar, BTF_PARAM_CHOICE, "numbers of the factors; auto: halves where those hold them", NULL,
          "auto", numbers, 0, 0);
const btf_param_desc *const bonn_write_params[] = {&family, &scalar, NULL};

enum { ALL_CHANNELS = 64, META_FIXED = 276 };

/* What is known of a component. */
typedef struct component {
  double square[2];
  float largest[2];
  uint64_t channels; /* a bit for each that it is not 0 in */
  float scale[2];    /* powers of two that the vectors are stored times */
  double off[2];     /* largest error of the stored halves, before that scale is taken out */
  bool finite;
} component;

typedef struct writing {
  const btf_host *host;
  btf_context *ctx;
  const char *path;
  const btf_job *job;
  btf_dataset_desc desc;
  btf_factors factors;
  uint32_t views, lights;
  uint64_t pairs, texels, length[2], longest;
  bool halves;
  btf_io io;
  uint64_t offset;
  uint32_t buffers;     /* tasks at once, with a vector for each */
  float *values;        /* those vectors */
  uint64_t most_values; /* of rows that are written at once */
  component *components;
  uint32_t *used; /* components of the matrix at work */
  uint32_t used_count;
  double done, to_do; /* values written, and of the whole file */
} writing;

/* ---- bytes ---- */

static btf_status put(writing *w, const void *src, uint64_t size) {
  const char *bytes = src;
  while (size > 0) {
    const int64_t written = w->io.write(w->io.user, bytes, size, w->offset);
    if (written <= 0)
      return (w->host->fail)(w->ctx, BTF_E_IO, "%s: could not be written: %s", w->path,
                             strerror(written < 0 ? errno : ENOSPC));
    bytes += written;
    size -= (uint64_t)written;
    w->offset += (uint64_t)written;
  }
  return BTF_OK;
}

static btf_status put_u32(writing *w, uint32_t value) {
  unsigned char bytes[4];
  btf_put_u32(bytes, value);
  return put(w, bytes, sizeof bytes);
}

static btf_status put_f32(writing *w, double value) {
  unsigned char bytes[4];
  btf_put_f32(bytes, (float)value);
  return put(w, bytes, sizeof bytes);
}

/* ---- what stands before the factors ---- */

static const char *note(const writing *w, const char *key) {
  for (uint32_t i = 0; w->desc.notes != NULL && w->desc.notes[i] != NULL; i += 2)
    if (strcmp(w->desc.notes[i], key) == 0) return w->desc.notes[i + 1];
  return "";
}

static btf_status put_padded(writing *w, const char *text) {
  char bytes[80] = "";
  const size_t length = strlen(text);
  memcpy(bytes, text, length < sizeof bytes ? length : sizeof bytes);
  return put(w, bytes, sizeof bytes);
}

static btf_status put_meta(writing *w) {
  uint64_t size = META_FIXED;
  for (uint32_t c = 0; c < w->desc.channels; c++) size += 4 + strlen(w->desc.channel_names[c]);
  if (size > UINT32_MAX)
    return (w->host->fail)(w->ctx, BTF_E_LIMIT, "%s: the names of the channels are too long", w->path);
  BTF_TRY(put_u32(w, (uint32_t)size));
  BTF_TRY(put_u32(w, 4)); /* version */
  BTF_TRY(put_padded(w, note(w, "bonn_setup")));
  BTF_TRY(put_padded(w, note(w, "bonn_sensor")));
  BTF_TRY(put_padded(w, note(w, "bonn_light_source")));
  BTF_TRY(put_f32(w, w->desc.texels_per_mm));
  for (int i = 0; i < 3; i++) BTF_TRY(put_f32(w, 1));
  BTF_TRY(put_u32(w, w->desc.quantity == BTF_QUANTITY_BRDF_COS));
  BTF_TRY(put_u32(w, 0)); /* no XML */
  BTF_TRY(put_u32(w, w->desc.channels));
  for (uint32_t c = 0; c < w->desc.channels; c++) {
    const char *name = w->desc.channel_names[c];
    BTF_TRY(put_u32(w, (uint32_t)strlen(name)));
    BTF_TRY(put(w, name, strlen(name)));
  }
  return BTF_OK;
}

static btf_status put_direction(writing *w, const float *xyz) {
  BTF_TRY(put_f32(w, atan2(hypot((double)xyz[0], (double)xyz[1]), (double)xyz[2])));
  return put_f32(w, atan2((double)xyz[1], (double)xyz[0]));
}

static btf_status put_directions(writing *w) {
  const float *views = (w->host->dirset_directions)(w->desc.views),
              *lights = (w->host->dirset_directions)(w->desc.lights);
  BTF_TRY(put_u32(w, w->views));
  for (uint32_t v = 0; v < w->views; v++) {
    BTF_TRY(put_direction(w, views + 3 * (size_t)v));
    BTF_TRY(put_u32(w, w->lights));
    for (uint32_t l = 0; l < w->lights; l++) BTF_TRY(put_direction(w, lights + 3 * (size_t)l));
  }
  return BTF_OK;
}

/* ---- components ---- */

static double half_error(const float *values, uint64_t count, float scale) {
  double most = 0;
  for (uint64_t i = 0; i < count; i++) {
    const double stored = (double)btf_half_to_float(btf_float_to_half(values[i] * scale));
    most = fmax(most, fabs(stored - (double)values[i] * (double)scale));
  }
  return most;
}

/* Both sides of a component get about the same magnitude, for halves hold 6e-5 to 65504 to full precision. */
static void balance(component *m) {
  int exponent[2];
  frexpf(m->largest[0], &exponent[0]);
  frexpf(m->largest[1], &exponent[1]);
  const int apart = (exponent[1] - exponent[0]) / 2, shift = apart < -126 ? -126 : apart > 126 ? 126 : apart;
  m->scale[0] = ldexpf(1, shift);
  m->scale[1] = ldexpf(1, -shift);
}

static void measure_component(const writing *w, uint32_t k, float *values) {
  component *m = &w->components[k];
  *m = (component){.scale = {1, 1}, .finite = true};
  for (uint32_t side = 0; side < 2; side++) {
    w->factors.column(w->factors.user, 0, side, k, values);
    for (uint64_t i = 0; i < w->length[side]; i++) {
      m->square[side] += (double)values[i] * values[i];
      m->largest[side] = fmaxf(m->largest[side], fabsf(values[i]));
      if (side == BTF_SIDE_ANGULAR && values[i] != 0) m->channels |= UINT64_C(1) << i % w->desc.channels;
    }
    m->finite = m->finite && isfinite(m->square[side]);
  }
  if (m->square[BTF_SIDE_TEXEL] == 0) m->channels = 0;
  if (!w->halves || !m->finite || m->channels == 0) return;
  balance(m);
  m->off[BTF_SIDE_TEXEL] = half_error(values, w->length[BTF_SIDE_TEXEL], m->scale[BTF_SIDE_TEXEL]);
  w->factors.column(w->factors.user, 0, BTF_SIDE_ANGULAR, k, values);
  m->off[BTF_SIDE_ANGULAR] = half_error(values, w->length[BTF_SIDE_ANGULAR], m->scale[BTF_SIDE_ANGULAR]);
}

static void measure(void *job, uint32_t task, uint32_t thread) {
  const writing *w = job;
  (void)thread;
  for (uint32_t k = task; k < w->factors.components[0]; k += w->buffers)
    measure_component(w, k, w->values + task * w->longest);
}

/* A product of two values that are off by e and f is off by |a| f + |b| e + e f. Halves of full precision are
 * off by 2^-11 of the value at most, smaller ones by 2^-25, larger ones are infinite. Together that must stay
 * within what full precision gives where all are largest. */
static btf_status check_halves(writing *w) {
  static const double precision = 0x1p-10 + 0x1p-22;
  double off = 0, most = 0;
  for (uint32_t k = 0; k < w->factors.components[0]; k++) {
    const component *m = &w->components[k];
    if (m->channels == 0) continue;
    const double a = (double)m->largest[0] * (double)m->scale[0],
                 b = (double)m->largest[1] * (double)m->scale[1];
    off += a * m->off[1] + b * m->off[0] + m->off[0] * m->off[1];
    most += precision * a * b;
  }
  if (off <= most) return BTF_OK;
  return (w->host->fail)(
      w->ctx, BTF_E_UNSUPPORTED,
      "%s: the factors are too %s for halves, which would put samples off by %.3g instead of at "
      "most %.3g (scalar=float)",
      w->path, isinf(off) ? "large" : "small", off, most);
}

static btf_status choose_numbers(writing *w, bool may_be_floats) {
  const uint32_t components = w->factors.components[0];
  for (uint32_t k = 0; k < components; k++)
    if (!w->components[k].finite)
      return (w->host->fail)(w->ctx, BTF_E_CORRUPT, "%s: component %u of the factors is not finite", w->path,
                             (unsigned)k);
  const btf_status status = w->halves ? check_halves(w) : BTF_OK;
  if (status == BTF_OK || !may_be_floats) return status;
  w->halves = false;
  for (uint32_t k = 0; k < components; k++) w->components[k].scale[0] = w->components[k].scale[1] = 1;
  return BTF_OK;
}

/* ---- matrices ---- */

/* A run of rows of one side of a matrix. */
typedef struct rows {
  const writing *w;
  uint32_t side, channel;
  uint64_t first, count;
  float *values; /* count x used */
} rows;

static uint64_t index_of(const rows *r, uint64_t row) {
  const writing *w = r->w;
  if (r->side == BTF_SIDE_ANGULAR)
    return r->channel == ALL_CHANNELS ? row : row * w->desc.channels + r->channel;
  return (w->desc.height - 1 - row / w->desc.width) * w->desc.width + row % w->desc.width;
}

static void fill_components(void *job, uint32_t task, uint32_t thread) {
  const rows *r = job;
  const writing *w = r->w;
  float *values = w->values + task * w->longest;
  (void)thread;
  for (uint32_t i = task; i < w->used_count; i += w->buffers) {
    const float scale = w->components[w->used[i]].scale[r->side];
    w->factors.column(w->factors.user, 0, r->side, w->used[i], values);
    for (uint64_t row = 0; row < r->count; row++)
      r->values[row * w->used_count + i] = values[index_of(r, r->first + row)] * scale;
  }
}

static btf_status put_values(writing *w, float *values, uint64_t count) {
  unsigned char *bytes = (unsigned char *)values; /* no longer than the floats, from the front */
  for (uint64_t i = 0; i < count; i++) {
    const float value = values[i];
    if (w->halves) {
      const uint16_t half = btf_float_to_half(value);
      bytes[2 * i] = (unsigned char)half;
      bytes[2 * i + 1] = (unsigned char)(half >> 8);
    } else {
      btf_put_f32(bytes + 4 * i, value);
    }
  }
  w->done += (double)count;
  BTF_TRY(put(w, bytes, count * (w->halves ? 2 : 4)));
  return (w->host->progress)(w->job, w->done / w->to_do, "writing");
}

static btf_status put_side(writing *w, uint32_t side, uint32_t channel) {
  const uint64_t all = side == BTF_SIDE_TEXEL    ? w->texels
                       : channel == ALL_CHANNELS ? w->length[BTF_SIDE_ANGULAR]
                                                 : w->pairs;
  uint64_t at_once = w->most_values / w->used_count;
  if (at_once > all) at_once = all;
  rows r = {.w = w, .side = side, .channel = channel};
  r.values = (w->host->alloc)(w->ctx, at_once * w->used_count, sizeof *r.values);
  if (r.values == NULL) return BTF_E_NOMEM;
  btf_status status = BTF_OK;
  for (r.first = 0; r.first < all && status == BTF_OK; r.first += r.count) {
    r.count = all - r.first < at_once ? all - r.first : at_once;
    status = (w->host->parallel)(w->ctx, w->buffers, fill_components, &r);
    if (status == BTF_OK) status = put_values(w, r.values, r.count * w->used_count);
  }
  (w->host->free)(w->ctx, r.values);
  return status;
}

/* Those that are not 0, or the first. */
static void choose_components(writing *w, uint32_t channel) {
  const uint64_t mask = channel == ALL_CHANNELS ? UINT64_MAX : UINT64_C(1) << channel;
  w->used_count = 0;
  for (uint32_t k = 0; k < w->factors.components[0]; k++)
    if ((w->components[k].channels & mask) != 0) w->used[w->used_count++] = k;
  if (w->used_count == 0) w->used[w->used_count++] = 0;
}

static uint64_t matrix_rows(const writing *w, uint32_t channel) {
  return channel == ALL_CHANNELS ? w->length[BTF_SIDE_ANGULAR] : w->pairs;
}

static btf_status put_matrix(writing *w, uint32_t channel) {
  const unsigned char size = w->halves ? 2 : 4;
  choose_components(w, channel);
  BTF_TRY(put(w, &size, 1));
  BTF_TRY(put_u32(w, w->used_count));
  BTF_TRY(put_u32(w, (uint32_t)matrix_rows(w, channel)));
  BTF_TRY(put_u32(w, (uint32_t)w->texels));
  for (uint32_t i = 0; i < w->used_count; i++) { /* singular values, if the vectors are singular */
    const component *m = &w->components[w->used[i]];
    const float value = (float)fmin(sqrt(m->square[0]) * sqrt(m->square[1]), w->halves ? 65504.0 : 3e38);
    unsigned char bytes[4];
    const uint16_t half = btf_float_to_half(value);
    btf_put_f32(bytes, value);
    if (w->halves) {
      bytes[0] = (unsigned char)half;
      bytes[1] = (unsigned char)(half >> 8);
    }
    BTF_TRY(put(w, bytes, size));
  }
  BTF_TRY(put_side(w, BTF_SIDE_ANGULAR, channel));
  return put_side(w, BTF_SIDE_TEXEL, channel);
}

/* Readers refuse more components than a matrix has rows or columns. */
static btf_status check_counts(writing *w, uint32_t channel) {
  const uint64_t all = matrix_rows(w, channel), least = all < w->texels ? all : w->texels;
  choose_components(w, channel);
  w->to_do += (double)w->used_count * ((double)all + (double)w->texels);
  if (w->used_count > least)
    return (w->host->fail)(
        w->ctx, BTF_E_UNSUPPORTED,
        "%s: %u components are more than a matrix of %llu x %llu values has in this format", w->path,
        (unsigned)w->used_count, (unsigned long long)all, (unsigned long long)w->texels);
  return BTF_OK;
}

/* ---- the file ---- */

static btf_status put_all(writing *w, bool by_channel) {
  uint32_t most = 0;
  const uint32_t first = by_channel ? 0 : ALL_CHANNELS,
                 last = by_channel ? w->desc.channels - 1 : ALL_CHANNELS;
  for (uint32_t c = first; c <= last; c++) {
    BTF_TRY(check_counts(w, c));
    if (w->used_count > most) most = w->used_count;
  }
  const char *signature = by_channel ? "!DFMF08FCR" : "!FMF06FCR";
  BTF_TRY(put(w, signature, strlen(signature)));
  BTF_TRY(put_meta(w));
  BTF_TRY(put_directions(w));
  BTF_TRY(put_u32(w, w->desc.width));
  BTF_TRY(put_u32(w, w->desc.height));
  BTF_TRY(put_u32(w, 0)); /* rotations */
  BTF_TRY(put_u32(w, most));
  if (by_channel) {
    BTF_TRY(put_u32(w, 0)); /* RGB as it is; its mean and matrix */
    for (int i = 0; i < 12; i++) BTF_TRY(put_f32(w, i >= 3 && i % 4 == 3));
  }
  for (uint32_t c = first; c <= last; c++) BTF_TRY(put_matrix(w, c));
  return BTF_OK;
}

static btf_status check_sizes(const writing *w) {
  if (w->length[BTF_SIDE_ANGULAR] > UINT32_MAX || w->texels > INT32_MAX)
    return (w->host->fail)(w->ctx, BTF_E_LIMIT, "%s: too many samples for a file of this format", w->path);
  if (w->factors.products != 1)
    return (w->host->fail)(
        w->ctx, BTF_E_UNSUPPORTED,
        "%s: the factors are of each view by itself; those of all views in one are written", w->path);
  return BTF_OK;
}

/* Divides the working set: what is known of each component, then up to half of the rest for vectors, of which
 * whole ones are made, then rows that are written at once, one at least. */
static btf_status make_room(writing *w) {
  const btf_host *host = w->host;
  const uint64_t components = w->factors.components[0], vector = w->longest * sizeof *w->values;
  const uint64_t fixed = sizeof *w + components * (sizeof *w->components + sizeof *w->used);
  const uint64_t row = components * sizeof *w->values, least = fixed + row + vector;
  const uint64_t budget = w->job->max_working_set, threads = (host->thread_count)(w->ctx);
  if (budget < least)
    return (host->fail)(w->ctx, BTF_E_LIMIT,
                        "%s: a working set of %.0f MiB is too small for these factors; %.0f MiB would do",
                        w->path, (double)budget / 1048576, ceil((double)least / 1048576));
  const uint64_t vectors = (budget - fixed - row) / 2 / vector;
  w->buffers = (uint32_t)(vectors < 1 ? 1 : vectors < threads ? vectors : threads);
  w->most_values = (budget - fixed - w->buffers * vector) / sizeof *w->values;
  w->values = (host->alloc)(w->ctx, w->buffers, vector);
  w->components = (host->alloc)(w->ctx, components, sizeof *w->components);
  w->used = (host->alloc)(w->ctx, components, sizeof *w->used);
  return w->values != NULL && w->components != NULL && w->used != NULL ? BTF_OK : BTF_E_NOMEM;
}

static btf_status prepare(writing *w, const btf_options *options, const btf_dataset *ds) {
  const btf_host *host = w->host;
  const int number = (int)(host->option)(options, "scalar");
  BTF_TRY((host->dataset_describe)(ds, &w->desc));
  BTF_TRY((host->dataset_factors)(ds, &w->factors));
  w->views = (host->dirset_count)(w->desc.views);
  w->lights = (host->dirset_count)(w->desc.lights);
  w->pairs = (uint64_t)w->views * w->lights;
  w->texels = (uint64_t)w->desc.width * w->desc.height;
  w->length[BTF_SIDE_ANGULAR] = w->pairs * w->desc.channels;
  w->length[BTF_SIDE_TEXEL] = w->texels;
  w->longest = w->length[0] > w->length[1] ? w->length[0] : w->length[1];
  w->halves = number == HALF || (number == AUTO && w->factors.value_bytes == 2);
  BTF_TRY(check_sizes(w));
  BTF_TRY(make_room(w));
  BTF_TRY((host->progress)(w->job, 0, "writing"));
  BTF_TRY((host->parallel)(w->ctx, w->buffers, measure, w));
  return choose_numbers(w, number == AUTO);
}

static btf_status write_prepared(writing *w, bool by_channel) {
  BTF_TRY((w->host->io_file)(w->ctx, w->path, BTF_IO_WRITE, &w->io));
  btf_status status = put_all(w, by_channel);
  if (w->io.close(w->io.user, status != BTF_OK) != 0 && status == BTF_OK)
    status = (w->host->fail)(w->ctx, BTF_E_IO, "%s: could not be written: %s", w->path, strerror(errno));
  return status;
}

btf_status bonn_write(const btf_host *host, btf_context *ctx, const char *path, const btf_dataset *ds,
                      const btf_options *options, const btf_job *job) {
  writing *w = (host->alloc)(ctx, 1, sizeof *w);
  if (w == NULL) return BTF_E_NOMEM;
  *w = (writing){.host = host,
                 .ctx = ctx,
                 .path = path,
                 .job = job,
                 .desc = BTF_DATASET_DESC_INIT,
                 .factors = BTF_FACTORS_INIT,
                 .io = BTF_IO_INIT};
  btf_status status = prepare(w, options, ds);
  if (status == BTF_OK) status = write_prepared(w, (host->option)(options, "family") == DFMF);
  (host->free)(ctx, w->values);
  (host->free)(ctx, w->components);
  (host->free)(ctx, w->used);
  (host->free)(ctx, w);
  return status;
}
