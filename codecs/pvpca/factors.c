/* SPDX-License-Identifier: MIT */
/* factors.c: a payload of factors of each view that are given, and the factors of a state. */
#include "pvpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>
#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

/* Sums of a view's components stay finite below it. */
#define LARGEST_VALUE 1e30

/* A vector of a component, which is stored divided by `scale`. */
typedef struct given_vector {
  double square; /* squared norm */
  double scale;
  float largest;   /* magnitude */
  bool are_halves; /* which hold the values without loss: */
  double half_scale;
} given_vector;

typedef struct given_term {
  given_vector side[2];
  double error;       /* squared, that storage adds if terms are orthogonal */
  uint32_t component; /* of the given ones of its view */
} given_term;

typedef struct keeping {
  btfi_pvpca_fit_job f; /* its tables of one view and its payload */
  const btf_factors *given;
  uint64_t longest;
  float *values;     /* a vector for each thread */
  given_term *terms; /* PVPCA_MAX_TERMS for each view */
  uint32_t view;     /* of a pass in parallel */
} keeping;

static given_term *terms_of(const keeping *k, uint32_t view) {
  return k->terms + (size_t)view * PVPCA_MAX_TERMS;
}

static uint64_t length_of(const keeping *k, uint32_t side) {
  return side == BTF_SIDE_ANGULAR ? k->f.rows : k->f.columns;
}

/* ---- what is given ---- */

/* The largest magnitude of halves is brought below 2^15, so that small ones stay clear of the coarse end of
 * their range; that of floats below 1. */
enum { HALF_EXPONENT = 15 };

static double power_scale(float largest, uint32_t storage) {
  int exponent;
  if (!(largest > 0.0f)) return 1.0;
  (void)frexp((double)largest, &exponent);
  return ldexp(1.0, exponent - (storage == PVPCA_F16 ? HALF_EXPONENT : 0));
}

static bool hold_halves(const float *values, uint64_t n, double scale) {
  for (uint64_t i = 0; i < n; i++)
    if ((float)(scale * (double)btfi_pvpca_round(PVPCA_F16, (float)(values[i] / scale))) != values[i])
      return false;
  return true;
}

static void measure(void *job, uint32_t component, uint32_t thread) {
  const keeping *k = job;
  float *values = k->values + thread * k->longest;
  given_term *term = terms_of(k, k->view) + component;
  term->component = component;
  for (uint32_t side = 0; side < 2; side++) {
    given_vector *v = &term->side[side];
    const uint64_t length = length_of(k, side);
    v->square = 0.0;
    v->largest = 0.0f;
    k->given->column(k->given->user, k->view, side, component, values);
    for (uint64_t i = 0; i < length; i++) {
      v->square += (double)values[i] * (double)values[i];
      v->largest = fmaxf(v->largest, fabsf(values[i]));
    }
    v->half_scale = power_scale(v->largest, PVPCA_F16);
    v->are_halves = hold_halves(values, length, v->half_scale);
    /* As the halves of a model come, times a scale of their own. */
    if (!v->are_halves && hold_halves(values, length, (double)v->largest)) {
      v->half_scale = (double)v->largest;
      v->are_halves = true;
    }
  }
}

/* Measures the components of all views; those that are 0 go. */
static btf_status measure_all(keeping *k, bool *all_halves) {
  const btf_host *host = k->f.host;
  uint32_t kept = 0;
  for (k->view = 0; k->view < k->f.layout.views; k->view++) {
    given_term *terms = terms_of(k, k->view);
    const uint32_t components = k->given->components[k->view];
    BTF_TRY(host->progress(k->f.job, 0.5 * k->view / k->f.layout.views, "factors"));
    BTF_TRY(host->parallel(k->f.ctx, components, measure, k));
    uint32_t count = 0;
    for (uint32_t i = 0; i < components; i++) {
      const given_term term = terms[i];
      const double squares = term.side[0].square * term.side[1].square;
      if (!isfinite(term.side[0].square) || !isfinite(term.side[1].square))
        return host->fail(k->f.ctx, BTF_E_CORRUPT,
                          "pvpca: component %u of the factors of view %u is not finite", i, k->view);
      if (squares == 0.0) continue;
      k->f.energy += squares;
      *all_halves = *all_halves && term.side[0].are_halves && term.side[1].are_halves;
      terms[count++] = term;
    }
    k->f.view[k->view].terms = count;
    kept += count;
  }
  if (!isfinite(k->f.energy)) return host->fail(k->f.ctx, BTF_E_NUMERIC, "pvpca: factors are too large");
  if (kept == 0) k->f.view[0].terms = 1; /* all samples are 0; a model has at least one column */
  return BTF_OK;
}

/* ---- tables ---- */

/* Writes a term's columns of the tables, scaled. */
static void fill(void *job, uint32_t j, uint32_t thread) {
  const keeping *k = job;
  float *values = k->values + thread * k->longest;
  given_term *term = terms_of(k, k->view) + j;
  const uint32_t terms = k->f.view[k->view].terms;
  double lost[2];
  for (uint32_t side = 0; side < 2; side++) {
    const uint32_t storage =
        side == BTF_SIDE_ANGULAR ? btfi_pvpca_weight_storage(k->f.layout.storage) : k->f.layout.storage;
    const double scale = term->side[side].scale;
    float *dst = (side == BTF_SIDE_ANGULAR ? k->f.weights : k->f.textures) + j;
    lost[side] = 0.0;
    k->given->column(k->given->user, k->view, side, term->component, values);
    for (uint64_t i = 0; i < length_of(k, side); i++, dst += terms) {
      *dst = (float)(values[i] / scale);
      const double off = scale * (double)btfi_pvpca_round(storage, *dst) - values[i];
      lost[side] += off * off;
    }
  }
  term->error = lost[0] * term->side[1].square + lost[1] * term->side[0].square;
}

static btf_status choose_scales(keeping *k, uint32_t view) {
  const uint32_t storage = k->f.layout.storage, weights = btfi_pvpca_weight_storage(storage);
  unsigned char *scales = k->f.scales + 4 * k->f.view[view].scale_start;
  for (uint32_t j = 0; j < k->f.view[view].terms; j++) {
    given_vector *side = terms_of(k, view)[j].side;
    for (uint32_t i = 0; i < 2; i++) {
      const uint32_t stored = i == BTF_SIDE_ANGULAR ? weights : storage;
      side[i].scale = stored == PVPCA_F16                            ? side[i].half_scale
                      : stored == PVPCA_Q8 && side[i].largest > 0.0f ? (double)side[i].largest
                                                                     : power_scale(side[i].largest, stored);
    }
    if ((double)side[0].largest * (double)side[1].largest > LARGEST_VALUE)
      return k->f.host->fail(k->f.ctx, BTF_E_NUMERIC, "pvpca: component %u of view %u has values beyond 1e30",
                             terms_of(k, view)[j].component, view);
    btf_put_f32(scales + 4 * (size_t)j, (float)(side[0].scale * side[1].scale));
  }
  return BTF_OK;
}

static btf_status write_views(keeping *k) {
  btfi_pvpca_fit_job *f = &k->f;
  for (k->view = 0; k->view < f->layout.views; k->view++) {
    BTF_TRY(f->host->progress(f->job, 0.5 + 0.5 * k->view / f->layout.views, "storing"));
    BTF_TRY(choose_scales(k, k->view));
    if (f->view[k->view].terms == 0) continue;
    BTF_TRY(f->host->parallel(f->ctx, f->view[k->view].terms, fill, k));
    BTF_TRY(btfi_pvpca_store_weights(f, k->view, NULL));
    BTF_TRY(btfi_pvpca_store_textures(f, k->view, NULL));
    for (uint32_t j = 0; j < f->view[k->view].terms; j++) f->squared_error += terms_of(k, k->view)[j].error;
  }
  return BTF_OK;
}

/* ---- what is asked for ---- */

/* Without a word about it, an option of the fit would seem to have an effect. */
static btf_status refuse_options(const keeping *k, const btf_options *options) {
  static const char *const of_fit[] = {"components", "psnr", "rmse", "max_components",
                                       "budget",     "mean", "color"};
  for (size_t i = 0; i < sizeof of_fit / sizeof *of_fit; i++)
    if (k->f.host->option_is_set(options, of_fit[i]))
      return k->f.host->fail(k->f.ctx, BTF_E_INVALID_ARG,
                             "pvpca: %s has no effect on factors that are kept as they are", of_fit[i]);
  return BTF_OK;
}

static btf_status check_given(keeping *k) {
  const btf_host *host = k->f.host;
  if (k->given->products != k->f.layout.views)
    return host->fail(
        k->f.ctx, BTF_E_UNSUPPORTED,
        "pvpca: these are factors of all views in one, which fmf holds; pvpca holds those of each "
        "view by itself");
  k->f.keep = 1;
  for (uint32_t v = 0; v < k->f.layout.views; v++) {
    if (k->given->components[v] > PVPCA_MAX_TERMS)
      return host->fail(k->f.ctx, BTF_E_UNSUPPORTED, "pvpca: %u components of view %u; it holds up to %d",
                        k->given->components[v], v, PVPCA_MAX_TERMS);
    if (k->given->components[v] > k->f.keep) k->f.keep = k->given->components[v];
  }
  return BTF_OK;
}

/* The tables of a view with the first coarser level, a vector for each thread, and what is known of the
 * terms. */
static btf_status make_room(keeping *k) {
  btfi_pvpca_fit_job *f = &k->f;
  const btf_host *host = f->host;
  const uint32_t threads = host->thread_count(f->ctx);
  const uint64_t level_texels = f->layout.levels > 1 ? (uint64_t)btf_sampling_level_size(f->layout.width, 1) *
                                                           btf_sampling_level_size(f->layout.height, 1)
                                                     : 1;
  k->longest = f->rows > f->columns ? f->rows : f->columns;
  const double bytes =
      4.0 * ((double)f->keep * ((double)f->rows + (double)f->columns + (double)level_texels) +
             (double)k->longest * threads) +
      (double)f->layout.views * (PVPCA_MAX_TERMS * sizeof *k->terms + sizeof *f->view);
  if (bytes > (double)f->job->max_working_set)
    return host->fail(f->ctx, BTF_E_LIMIT,
                      "pvpca: a working set of %.0f MiB is too small for these factors; %.0f MiB would do",
                      (double)f->job->max_working_set / 1048576.0, ceil(bytes / 1048576.0));
  f->textures = host->alloc(f->ctx, f->columns * f->keep, sizeof *f->textures);
  f->weights = host->alloc(f->ctx, f->rows * f->keep, sizeof *f->weights);
  f->level = host->alloc(f->ctx, level_texels * f->keep, sizeof *f->level);
  f->view = host->alloc(f->ctx, f->layout.views, sizeof *f->view);
  k->values = host->alloc(f->ctx, k->longest * threads, sizeof *k->values);
  k->terms = host->alloc(f->ctx, (uint64_t)f->layout.views * PVPCA_MAX_TERMS, sizeof *k->terms);
  if (f->textures == NULL || f->weights == NULL || f->level == NULL || f->view == NULL || k->values == NULL ||
      k->terms == NULL)
    return BTF_E_NOMEM;
  memset(f->view, 0, f->layout.views * sizeof *f->view);
  return BTF_OK;
}

static btf_status keep(keeping *k, const btf_options *options) {
  btfi_pvpca_fit_job *f = &k->f;
  const btf_host *host = f->host;
  bool all_halves = k->given->value_bytes == 2;
  BTF_TRY(check_given(k));
  BTF_TRY(refuse_options(k, options));
  const uint32_t all_levels = host->mip_count(f->layout.width, f->layout.height);
  f->layout.levels = (uint32_t)host->option(options, "levels");
  if (f->layout.levels == 0 || f->layout.levels > all_levels) f->layout.levels = all_levels;
  BTF_TRY(make_room(k));
  BTF_TRY(measure_all(k, &all_halves));
  f->layout.storage = all_halves ? PVPCA_F16 : PVPCA_F32;
  if (host->option_is_set(options, "storage")) f->layout.storage = (uint32_t)host->option(options, "storage");
  BTF_TRY(btfi_pvpca_reserve(f));
  BTF_TRY(write_views(k));
  BTF_TRY(btfi_pvpca_write_head(f));
  return host->progress(f->job, 1.0, "storing");
}

btf_status btfi_pvpca_from_factors(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                                   const btf_factors *given, const btf_options *options, const btf_job *job,
                                   btf_chunk_writer *payload) {
  keeping *k = host->alloc(ctx, 1, sizeof *k);
  if (k == NULL) return BTF_E_NOMEM;
  memset(k, 0, sizeof *k);
  k->given = given;
  btfi_pvpca_fit_job *f = &k->f;
  f->host = host;
  f->ctx = ctx;
  f->job = job;
  f->payload = payload;
  /* Colours are with the weights, as vectors of angles have them, and the mean is a component among others.
   */
  f->layout = (btfi_pvpca_layout){.channels = shape->channels,
                                  .lights = host->dirset_count(shape->lights),
                                  .views = host->dirset_count(shape->views),
                                  .width = shape->width,
                                  .height = shape->height,
                                  .color = PVPCA_COLOR_LIGHTS};
  f->texels = f->columns = (uint64_t)shape->width * shape->height;
  f->texel_columns = 1;
  f->rows = (uint64_t)f->layout.lights * shape->channels;
  const btf_status status = keep(k, options);
  host->free(ctx, f->textures);
  host->free(ctx, f->weights);
  host->free(ctx, f->level);
  host->free(ctx, f->view);
  host->free(ctx, k->values);
  host->free(ctx, k->terms);
  host->free(ctx, k);
  return status;
}

/* ---- factors of a state ---- */

static float table_value(uint32_t storage, const unsigned char *table, uint64_t i) {
  float value;
  int8_t byte;
  switch (storage) {
  case PVPCA_F16:
    return btf_half_at(table, i);
  case PVPCA_Q8:
    memcpy(&byte, table + i, sizeof byte);
    return (float)byte;
  default:
    memcpy(&value, table + 4 * i, sizeof value);
    return value;
  }
}

/* With colours in the texels, a column is a component for each channel. The mean's weights are its scale. */
static void state_column(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst) {
  const btfi_pvpca_state *s = user;
  const btfi_pvpca_layout *layout = &s->layout;
  const btfi_pvpca_view *view = &s->views[product];
  const uint32_t column = k / layout->h_channels, channel = k % layout->h_channels;
  const uint64_t texels = layout->level_texels[0], lights = layout->lights;
  const bool by_light = layout->color == PVPCA_COLOR_LIGHTS;
  if (column >= view->columns) { /* a view without any */
    memset(dst, 0, (size_t)(side == BTF_SIDE_TEXEL ? texels : lights * layout->channels) * sizeof *dst);
    return;
  }
  if (side == BTF_SIDE_TEXEL) {
    const unsigned char *h = s->h[0] + texels * view->h_before;
    for (uint64_t i = 0; i < texels; i++)
      dst[i] = table_value(layout->storage, h, (i * layout->h_channels + channel) * view->columns + column);
    return;
  }
  const uint32_t storage = btfi_pvpca_weight_storage(layout->storage);
  for (uint64_t l = 0; l < lights; l++)
    for (uint32_t c = 0; c < layout->channels; c++, dst++) {
      const uint64_t row = by_light ? l * layout->channels + c : l;
      const uint32_t term = column - layout->has_mean;
      if (!by_light && c != channel)
        *dst = 0.0f;
      else if (column < layout->has_mean)
        *dst = view->mean_scale;
      else
        *dst = table_value(storage, s->g + view->g_start, row * view->terms + term) *
               s->scales[view->padded_start + term];
    }
}

btf_status btfi_pvpca_factors_of(const void *state, btf_factors *out) {
  const btfi_pvpca_state *s = state;
  out->products = s->layout.views;
  out->value_bytes = s->layout.storage == PVPCA_F32 ? 4 : 2;
  out->components = s->components;
  out->column = state_column;
  out->user = s;
  return BTF_OK;
}
