/* SPDX-License-Identifier: MIT */
/* factors.c: a payload of factors that are given, and the factors of a state. */
#include "fmf.h"

#include <math.h>
#include <string.h>

#include <btf/btf_half.h>

/* ---- given factors ---- */

/* Norms beyond it would not fit the loader's bounds. */
#define LARGEST_NORM 1e30

typedef struct measured {
  double square[2];
  bool finite;
} measured;

typedef struct keeping {
  btfi_fmf_writing out;
  const btf_factors *given;
  uint64_t longest;
  float *values; /* of each thread */
  measured *measured;
  uint32_t *component; /* of the given ones, for each that is kept */
  double *norm;        /* that its U is divided by */
} keeping;

static void measure(void *job, uint32_t k, uint32_t thread) {
  const keeping *f = job;
  float *values = f->values + thread * f->longest;
  measured *m = &f->measured[k];
  m->finite = true;
  for (uint32_t side = 0; side < 2; side++) {
    m->square[side] = 0.0;
    f->given->column(f->given->user, 0, side, k, values);
    for (uint64_t i = 0; i < f->out.factors.length[side]; i++)
      m->square[side] += (double)values[i] * values[i];
    m->finite = m->finite && isfinite(m->square[side]);
  }
}

static void kept_column(const void *user, uint32_t side, uint32_t k, float *dst) {
  const keeping *f = user;
  const double norm = side == FMF_SIDE_U ? 1.0 / f->norm[k] : f->norm[k];
  f->given->column(f->given->user, 0, side, f->component[k], dst);
  if (norm == 1.0) return;
  for (uint64_t i = 0; i < f->out.factors.length[side]; i++) dst[i] = (float)(dst[i] * norm);
}

/* Tables take the vectors as they are; packing wants the columns of U of length 1. */
static btf_status take_components(keeping *f) {
  const btf_host *host = f->out.host;
  uint32_t kept = 0;
  for (uint32_t k = 0; k < f->given->components[0]; k++) {
    const measured *m = &f->measured[k];
    const double u = sqrt(m->square[0]), v = sqrt(m->square[1]);
    if (!m->finite)
      return host->fail(f->out.ctx, BTF_E_CORRUPT, "fmf: component %u of the factors is not finite", k);
    if (u * v > LARGEST_NORM)
      return host->fail(f->out.ctx, BTF_E_NUMERIC, "fmf: component %u of the factors has values beyond 1e30",
                        k);
    if (u * v == 0.0) continue;
    f->component[kept] = k;
    f->norm[kept] = f->out.head.coding == FMF_PACKED ? u : 1.0;
    f->out.sigma[kept++] = u * v;
    f->out.head.energy += u * v * (u * v);
  }
  if (kept == 0) { /* all samples are 0 */
    f->component[0] = 0;
    f->norm[0] = f->out.sigma[0] = 1.0;
    kept = 1;
  }
  f->out.factors.components = kept;
  return BTF_OK;
}

/* Without a word about it, an option of the fit would seem to have an effect. */
static btf_status refuse_options(const keeping *f, const btf_options *options) {
  static const char *const of_fit[] = {"components", "psnr", "rmse", "max_components", "mean", "accuracy"};
  for (size_t i = 0; i < sizeof of_fit / sizeof *of_fit; i++)
    if (f->out.host->option_is_set(options, of_fit[i]))
      return f->out.host->fail(f->out.ctx, BTF_E_INVALID_ARG,
                               "fmf: %s has no effect on factors that are kept as they are", of_fit[i]);
  return BTF_OK;
}

/* As the source has them and used from a mapping, unless something else is asked for. */
static void choose_storage(keeping *f, const btf_options *options) {
  btfi_fmf_read_storage(&f->out, options);
  if (!f->out.host->option_is_set(options, "storage"))
    f->out.head.storage = f->given->value_bytes == 2 ? FMF_F16 : FMF_F32;
  if (!f->out.host->option_is_set(options, "coding")) f->out.head.coding = FMF_PLAIN;
}

/* A column and its integers for each thread, and a slice of columns with its first coarser level. */
static btf_status check_budget(const keeping *f, const btf_job *job) {
  const double bytes = 4.0 * (double)f->longest * (2.0 * f->out.host->thread_count(f->out.ctx) + 20);
  if (bytes <= (double)job->max_working_set) return BTF_OK;
  return f->out.host->fail(f->out.ctx, BTF_E_LIMIT,
                           "fmf: a working set of %.0f MiB is too small for these factors; %.0f MiB would do",
                           (double)job->max_working_set / 1048576.0, ceil(bytes / 1048576.0));
}

static btf_status keep(keeping *f, const btf_options *options, const btf_job *job) {
  const btf_host *host = f->out.host;
  btf_context *ctx = f->out.ctx;
  const uint32_t components = f->given->components[0];
  if (f->given->products != 1)
    return host->fail(ctx, BTF_E_UNSUPPORTED,
                      "fmf: these are factors of each view by itself, which pvpca holds; fmf holds those of "
                      "all views in one");
  if (components > FMF_MAX_COMPONENTS)
    return host->fail(ctx, BTF_E_UNSUPPORTED, "fmf: %u components; it holds up to %d", components,
                      FMF_MAX_COMPONENTS);
  BTF_TRY(refuse_options(f, options));
  choose_storage(f, options);
  BTF_TRY(btfi_fmf_writing_open(&f->out, components));
  f->out.factors.column = kept_column;
  f->out.factors.user = f;
  f->out.factors.by_powers = true;
  memset(f->out.residual, 0, (components + 1ull) * sizeof *f->out.residual);
  f->longest = f->out.factors.length[0] > f->out.factors.length[1] ? f->out.factors.length[0]
                                                                   : f->out.factors.length[1];
  BTF_TRY(check_budget(f, job));
  f->values = host->alloc(ctx, f->longest * host->thread_count(ctx), sizeof *f->values);
  f->measured = host->alloc(ctx, components, sizeof *f->measured);
  f->component = host->alloc(ctx, components, sizeof *f->component);
  f->norm = host->alloc(ctx, components, sizeof *f->norm);
  if (f->values == NULL || f->measured == NULL || f->component == NULL || f->norm == NULL) return BTF_E_NOMEM;
  BTF_TRY(host->progress(job, 0.0, "factors"));
  BTF_TRY(host->parallel(ctx, components, measure, f));
  BTF_TRY(take_components(f));
  host->free(ctx, f->values); /* what follows has room of its own */
  f->values = NULL;
  BTF_TRY(host->progress(job, 0.2, "storing"));
  BTF_TRY(btfi_fmf_choose_components(&f->out));
  BTF_TRY(host->progress(job, 0.5, "storing"));
  BTF_TRY(btfi_fmf_write(&f->out));
  return host->progress(job, 1.0, "storing");
}

btf_status btfi_fmf_from_factors(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                                 const btf_factors *given, const btf_options *options, const btf_job *job,
                                 btf_chunk_writer *payload) {
  keeping *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->given = given;
  f->out = (btfi_fmf_writing){.host = host,
                              .ctx = ctx,
                              .payload = payload,
                              .views = host->dirset_count(shape->views),
                              .lights = host->dirset_count(shape->lights),
                              .channels = shape->channels,
                              .width = shape->width,
                              .height = shape->height,
                              .target = INFINITY};
  const btf_status status = keep(f, options, job);
  btfi_fmf_writing_free(&f->out);
  host->free(ctx, f->values);
  host->free(ctx, f->measured);
  host->free(ctx, f->component);
  host->free(ctx, f->norm);
  host->free(ctx, f);
  return status;
}

/* ---- factors of a state ---- */

/* A value of a table, before its column's scale. */
static float table_value(uint32_t storage, const unsigned char *p) {
  uint16_t half;
  uint32_t bits;
  float value;
  switch (storage) {
  case FMF_F16:
    return btf_half_at(p, 0);
  case FMF_BF16:
    memcpy(&half, p, sizeof half);
    bits = (uint32_t)half << 16;
    memcpy(&value, &bits, sizeof value);
    return value;
  case FMF_Q8:
    return (float)(*p < 128 ? *p : *p - 256);
  default:
    memcpy(&value, p, sizeof value);
    return value;
  }
}

static void state_column(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst) {
  const btfi_fmf_state *s = user;
  const btfi_fmf_layout *layout = &s->layout;
  const uint64_t at = k * (uint64_t)btfi_fmf_value_bytes(layout->storage);
  (void)product;
  if (side == BTF_SIDE_ANGULAR) {
    const uint64_t pairs = (uint64_t)layout->views * layout->lights;
    for (uint64_t i = 0; i < pairs; i++)
      for (uint32_t c = 0; c < layout->channels; c++)
        *dst++ = table_value(layout->storage, s->u + i * layout->u_row_bytes + c * s->channel_bytes + at) *
                 s->side_scale[FMF_SIDE_U][k];
    return;
  }
  for (uint32_t y = 0; y < layout->height; y++)
    for (uint32_t x = 0; x < layout->width; x++)
      *dst++ = table_value(layout->storage,
                           s->v[0] + y * layout->v_line_bytes[0] + x * layout->v_texel_bytes + at) *
               s->side_scale[FMF_SIDE_V][k];
}

btf_status btfi_fmf_factors_of(const void *state, btf_factors *out) {
  const btfi_fmf_state *s = state;
  out->products = 1;
  out->value_bytes = s->layout.storage == FMF_F16 || s->layout.storage == FMF_Q8 ? 2 : 4;
  out->components = &s->layout.columns;
  out->column = state_column;
  out->user = s;
  return BTF_OK;
}
