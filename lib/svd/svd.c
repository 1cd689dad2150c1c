/* SPDX-License-Identifier: MIT */
/* svd.c: the truncated SVD as a whole: plan, passes until the estimate is met, result. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "svd/svd_state.h"

static const uint64_t default_working_set = (uint64_t)1 << 30;
static const double default_tolerance = 0.0005;
/* Below this part of the energy, a residual is not taken as a difference of float sums. */
static const double smallest_difference = 5e-6;

/* Float panels give a singular value to about this part of the largest: smaller changes mean nothing. */
static const double noise = 2e-7;
static const double float_rounding = 6e-8;
/* What is still to come is at least taken to fall by this factor from one half step to the next. */
static const double slowest_rate = 0.98;
/* A singular value below this part of the largest is not told from rounding. */
static const double float_resolution = 3e-7;

enum {
  BLOCK_BYTES = 20 << 20, /* met twice, so much of it should be in L3 still; wider ones read longer runs */
  SMALLEST_BLOCK = 64,
  LARGEST_BLOCK = 8192,
  RUN = 32,
  SAMPLE_MIN = 2048,
  SAMPLE_MAX = 8192,
  SAMPLE_PER_COLUMN = 112,
  FIRST_TARGET_RANK = 24,
  REFINE_GAIN = 10 /* what refining reduces an error by, or more */
};

static uint64_t round_up(uint64_t value, uint64_t grain) {
  return (value + grain - 1) / grain * grain;
}

/* ---- plan ---- */

static void shape_block(const btf_svd_desc *desc, svd_plan *plan, uint64_t items) {
  plan->block_items = (size_t)items;
  plan->block_count = (desc->items + items - 1) / items;
  const size_t padded = (size_t)round_up(items, BTFI_SLAB_GRAIN);
  if (desc->layout == BTF_LAYOUT_ITEM_ROWS) {
    plan->block_ld = plan->length_padded + 16;
    plan->block_floats = padded * plan->block_ld;
  } else {
    /* One more cache line, and never a power of two: rows would fall into the same sets of the cache. */
    plan->block_ld = (size_t)round_up(padded, 16) + 16;
    plan->block_floats = plan->length_padded * plan->block_ld;
  }
}

/* Bytes beside the result with `blocks` blocks held; false beyond 64 bits. */
static bool count_bytes(const btf_svd_desc *desc, const svd_plan *plan, uint64_t blocks, uint64_t *bytes) {
  const uint64_t width = plan->width, padded = round_up(plan->block_items, BTFI_SLAB_GRAIN);
  uint64_t held, surplus, panels;
  if (!btfi_mul((uint64_t)plan->block_floats * sizeof(float), blocks + 1, &held)) return false;
  if (!btfi_mul(desc->items, (width - plan->rank) * sizeof(float), &surplus)) return false;
  if (!btfi_mul(plan->length_padded, (3 * width + 1) * sizeof(float), &panels)) return false;
  const uint64_t both = 2 * width;
  uint64_t second = 0;
  if (plan->refine && !btfi_mul(desc->items + BTFI_SLAB_GRAIN, width * sizeof(float), &second)) return false;
  if (plan->refine && !btfi_add(second, (SVD_WIDE * both + 4) * both * sizeof(double), &second)) return false;
  if (!btfi_add(surplus, second, &surplus)) return false;
  const uint64_t small =
      (padded + BTFI_SLAB_GRAIN) * width * sizeof(float) + padded * sizeof(double) +
      (SVD_SMALL * width + 5 + BTFI_MAX((uint64_t)SVD_GRAM_ROWS, width)) * width * sizeof(double) + 16 * 128;
  return btfi_add(held, surplus, bytes) && btfi_add(*bytes, panels, bytes) && btfi_add(*bytes, small, bytes);
}

static btf_status make_plan(btf_context *ctx, const btf_svd_desc *desc, uint32_t rank, svd_plan *plan) {
  const uint64_t smaller = BTFI_MIN(desc->items, desc->length);
  /* Columns beyond the rank speed up convergence, and give strays room. */
  const uint32_t spare = BTFI_MAX(8u, rank / 4);
  memset(plan, 0, sizeof *plan);
  plan->rank = rank;
  plan->width = (uint32_t)round_up(BTFI_MIN(smaller, rank + spare), BTFI_PANEL_GRAIN);
  plan->length_padded = (size_t)round_up(desc->length, BTFI_SLAB_GRAIN);

  const uint64_t item_bytes = plan->length_padded * sizeof(float);
  uint64_t run = BTFI_MIN(desc->block_items > 0 ? desc->block_items : RUN, desc->items), bytes;
  uint64_t block =
      BTFI_MAX((uint64_t)SMALLEST_BLOCK, BTFI_MIN((uint64_t)LARGEST_BLOCK, BLOCK_BYTES / item_bytes));
  block = BTFI_MIN(BTFI_MAX(block / run, 1) * run, round_up(desc->items, run));
  bool fits;
  for (;;) {
    shape_block(desc, plan, block);
    fits = count_bytes(desc, plan, 0, &bytes) && bytes <= desc->max_working_set;
    if (fits || block == 1) break;
    /* Half the runs, and when one is left half the run. */
    if (block > run) {
      block = BTFI_MAX(block / run / 2, 1) * run;
    } else {
      run = (run + 1) / 2;
      block = run;
    }
  }
  if (!fits) {
    plan->least_bytes = bytes;
    return btfi_fail(ctx, BTF_E_LIMIT,
                     "svd: a working set of %" PRIu64 " bytes is too small for %u components of %" PRIu64
                     " x %" PRIu64 " values; at least %" PRIu64 " bytes are needed",
                     desc->max_working_set, rank, desc->items, desc->length, bytes);
  }
  plan->run_items = (uint32_t)run;
  /* The second image is worth its room where the sample keeps three quarters of it. */
  plan->refine = true;
  plan->refine = count_bytes(desc, plan, 0, &bytes) && bytes <= desc->max_working_set / 4;

  plan->held = count_bytes(desc, plan, plan->block_count, &bytes) && bytes <= desc->max_working_set;
  const uint64_t wanted =
      BTFI_MIN(BTFI_MAX((uint64_t)SAMPLE_PER_COLUMN * plan->width, SAMPLE_MIN), SAMPLE_MAX);
  uint64_t sample = (wanted + block - 1) / block;
  if (plan->held) {
    /* Whole blocks of a held matrix cost nothing, so take them all where that is hardly more work. */
    plan->sample_blocks = sample * 2 > plan->block_count ? plan->block_count : sample;
  } else {
    const uint64_t full_blocks = desc->items / block;
    sample = BTFI_MIN(sample, BTFI_MAX(full_blocks / 4, 1));
    sample = BTFI_MIN(sample, full_blocks);
    while (sample > 0 && !(count_bytes(desc, plan, sample, &bytes) && bytes <= desc->max_working_set))
      sample--;
    if (sample * block < plan->width + 16) sample = 0;
    plan->sample_blocks = sample;
  }
  return count_bytes(desc, plan, plan->held ? plan->block_count : plan->sample_blocks, &plan->bytes)
             ? BTF_OK
             : btfi_fail(ctx, BTF_E_LIMIT, "svd: the matrix is too large to address");
}

/* ---- state ---- */

static void end_state(svd_state *s) {
  btfi_free(s->ctx, s->blocks);
  btfi_free(s->ctx, s->window);
  btfi_free(s->ctx, s->projection);
  btfi_free(s->ctx, s->basis);
  btfi_free(s->ctx, s->image);
  btfi_free(s->ctx, s->second_projection);
  btfi_free(s->ctx, s->wide);
  btfi_free(s->ctx, s->packed_basis);
  btfi_free(s->ctx, s->packed_projection);
  btfi_free(s->ctx, s->direction);
  btfi_free(s->ctx, s->norms);
  btfi_free(s->ctx, s->small);
  btfi_free(s->ctx, s->rows);
  btfi_free(s->ctx, s->theta);
  s->blocks = s->window = s->projection = s->basis = s->image = NULL;
  s->second_projection = NULL;
  s->wide = NULL;
  s->packed_basis = s->packed_projection = s->direction = NULL;
  s->norms = s->small = s->rows = s->theta = NULL;
  s->loaded = false;
}

static btf_status begin_state(svd_state *s) {
  const svd_plan *plan = &s->plan;
  const uint64_t width = plan->width, padded = round_up(plan->block_items, BTFI_SLAB_GRAIN);
  const uint64_t panel = plan->length_padded * width * sizeof(float);
  const uint64_t kept_blocks = plan->held ? plan->block_count : plan->sample_blocks;
  if ((s->window = btfi_alloc(s->ctx, plan->block_floats, sizeof(float))) == NULL ||
      (s->blocks = btfi_alloc(s->ctx, plan->block_floats * sizeof(float), kept_blocks)) == NULL ||
      (s->projection = btfi_alloc(s->ctx, s->desc->items + BTFI_SLAB_GRAIN, width * sizeof(float))) == NULL ||
      (s->basis = btfi_alloc(s->ctx, panel, 1)) == NULL ||
      (s->image = btfi_alloc(s->ctx, panel, 1)) == NULL ||
      (s->packed_basis = btfi_alloc(s->ctx, panel, 1)) == NULL ||
      (s->packed_projection = btfi_alloc(s->ctx, padded * width, sizeof(float))) == NULL ||
      (s->direction = btfi_alloc(s->ctx, plan->length_padded, sizeof(float))) == NULL ||
      (s->norms = btfi_alloc(s->ctx, padded, sizeof(double))) == NULL ||
      (s->small = btfi_alloc(s->ctx, SVD_SMALL * width * width, sizeof(double))) == NULL ||
      (s->rows = btfi_alloc(s->ctx, BTFI_MAX((uint64_t)SVD_GRAM_ROWS, width) * width, sizeof(double))) ==
          NULL ||
      (s->theta = btfi_alloc(s->ctx, 5 * width, sizeof(double))) == NULL)
    return btfi_alloc_status();
  s->previous = s->theta + 4 * width;
  const uint64_t both = 2 * width;
  if (plan->refine && ((s->second_projection = btfi_alloc(s->ctx, s->desc->items + BTFI_SLAB_GRAIN,
                                                          width * sizeof(float))) == NULL ||
                       (s->wide = btfi_alloc(s->ctx, (SVD_WIDE * both + 4) * both, sizeof(double))) == NULL))
    return btfi_alloc_status();
  btfi_svd_clear_block(s, s->window);
  for (uint64_t b = 0; b < kept_blocks; b++) btfi_svd_clear_block(s, s->blocks + b * plan->block_floats);
  return BTF_OK;
}

/* ---- passes ---- */

/* What further passes would gain, from what the half step from P to C gained. The part of a right singular
 * vector that leaks to one of squared value mu loses the factor mu / ritz[i] with each half step, and what it
 * loses is gained: mu is at most that of the last column that is no stray's.
 *
 * That Ritz value is too small, though, until the last columns have converged. After a sample, P errs towards
 * all directions alike, most of them of far smaller mu: what remains is a tenth of the gain and more, the
 * more the larger the gain is beside the rest and the fewer items the sample has for each column. Later only
 * slow leaks are left: what counts is the factor between this gain and that of the pass before (*gained, 0
 * without), and a half at least. */
static double remaining_gain(const svd_state *s, bool sampled, double rest, double *gained) {
  const svd_plan *plan = &s->plan;
  const uint32_t rank = BTFI_MIN(s->found, plan->rank);
  const uint32_t regular = s->found > s->partial_count ? s->found - s->partial_count : 0;
  double all = 0, sum = 0;
  for (uint32_t i = 0; i < rank; i++) all += fmax(0, s->ritz[i] - s->ritz_before[i]);
  const double slowest = sampled ? 0 : *gained > 0 ? fmax(0.5, sqrt(all / *gained)) : 0.5;
  for (uint32_t i = 0; i < rank; i++) {
    const double rate = fmax(slowest, s->ritz[BTFI_MAX(rank, regular) - 1] / s->ritz[i]);
    sum += fmax(0, s->ritz[i] - s->ritz_before[i]) / (1 / fmin(rate, slowest_rate) - 1);
  }
  *gained = all;
  if (!sampled) return 1.25 * sum;
  const double share = rest > 0 ? all / rest : 0;
  const double items = fmax(1, (double)plan->sample_blocks * (double)plan->block_items);
  return fmax(0.75 * sum, all * (0.12 + 3 * share * share + 0.5 * plan->width / items));
}

static btf_status converge(svd_state *s) {
  const uint64_t smaller = BTFI_MIN(s->desc->items, s->desc->length);
  const double tolerance = s->desc->tolerance, allowed = tolerance * (2 + tolerance);
  if (s->plan.held) {
    for (uint64_t b = 0; b < s->plan.block_count; b++) {
      btfi_slab slab;
      BTFI_TRY(btfi_svd_report(s, 0.1 * (double)b / (double)s->plan.block_count));
      BTFI_TRY(btfi_svd_fetch(s, b, &slab));
    }
    s->loaded = true;
  } else if (s->plan.sample_blocks > 0) {
    BTFI_TRY(btfi_svd_read_sample(s));
  }
  BTFI_TRY(btfi_svd_start(s));
  const double target = s->desc->target_residual;
  if (target > 0 && s->sample_rest > 1.05 * target && s->plan.rank < s->largest_rank) return BTF_OK;

  double first = 0.2, estimate = 0, missed = 0, before = 0, after = 0, gained = 0;
  /* A sample of the whole matrix has left slow leaks only. */
  bool refined = true, sampled = !s->plan.held || s->plan.sample_blocks < s->plan.block_count;
  for (int pass = 0; pass < SVD_MAX_PASSES; pass++) {
    const double last = first + 0.6 * (0.98 - first), rest_before = fmax(0, s->energy - after);
    double *previous = s->previous;
    const uint32_t rank = s->plan.rank;
    if (pass > 0) memcpy(previous, s->ritz, rank * sizeof(double));
    /* A pass finds a better basis; where little is missing, the two bases together are worth more than
     * another pass, and their images cost half of one. */
    refined = s->plan.refine && !refined && missed <= 0.5 * allowed * rest_before &&
              estimate <= REFINE_GAIN * allowed * rest_before;
    if (refined) {
      BTFI_TRY(btfi_svd_refine(s, first, last));
    } else {
      BTFI_TRY(btfi_svd_pass(s, first, last, &missed));
      memcpy(previous, s->ritz_before, rank * sizeof(double));
    }
    first = last;
    double captured = 0, captured_before = 0;
    bool grows = missed > 0;
    for (uint32_t i = 0; i < BTFI_MIN(s->found, rank); i++) {
      captured += s->ritz[i];
      captured_before += previous[i];
      grows |= s->ritz[i] - previous[i] > noise * (s->ritz[i] + sqrt(s->ritz[0] * s->ritz[i]));
    }
    const double rest = fmax(0, s->energy - captured);
    if (refined) {
      /* As if errors fell geometrically from one half step to the next, and twice that. */
      const double gain = fmax(0, captured - after), gain_before = captured - before;
      estimate = gain_before > gain ? gain * gain / gain_before : gain;
      estimate = 2 * estimate + missed;
      gained = 0;
    } else {
      estimate = remaining_gain(s, sampled, rest, &gained);
      /* Sums of many equal values err one way, and what a half step seems to gain may be that: it then comes
       * again in each pass, but from pass to pass nothing grows. */
      if (pass > 0) estimate = fmin(estimate, fmax(0, captured - after) * slowest_rate / (1 - slowest_rate));
      estimate += missed;
      before = captured_before;
      sampled = false;
    }
    after = captured;
    btfi_log(s->ctx, BTF_LOG_INFO,
             "svd: %s %d: residual %.4g of the energy, about %.2g of it to gain, %.2g missed",
             refined ? "refined by reading" : "pass", pass + 1, s->energy > 0 ? rest / s->energy : 0,
             rest > 0 ? estimate / rest : 0, rest > 0 ? missed / rest : 0);
    /* Nothing is beyond the panel. */
    if (s->plan.width >= smaller && pass > 0) return BTF_OK;
    /* A basis far from singular vectors makes the columns of C nearly dependent, and float's rounding is
     * magnified in what they are separated into. */
    const double blur =
        s->found > 0 ? s->plan.width * float_rounding * float_rounding * s->spread * s->ritz[0] : 0;
    /* What float panels hold of a direction that is none: no gain below it means anything. */
    const double rounding = s->found > 0 ? float_resolution * float_resolution * s->ritz[0] : 0;
    const bool clear = (s->plan.sample_blocks > 0 || pass > 1) &&
                       blur <= fmax(0.25 * allowed * rest, s->plan.width * rounding);
    if ((pass > 0 || clear) && (estimate <= fmax(0.9 * allowed * rest, rounding) || !grows) &&
        (clear || !grows))
      return BTF_OK;
  }
  btfi_log(s->ctx, BTF_LOG_WARNING, "svd: %d readings did not reach the tolerance %g", SVD_MAX_PASSES,
           tolerance);
  return BTF_OK;
}

/* ---- result ---- */

/* Squared residual at each rank: what lies beyond the panel, and the squared singular values within. */
static btf_status residuals(svd_state *s, double *residual) {
  double captured = 0, tail = 0;
  for (uint32_t i = 0; i < s->found; i++) captured += s->ritz[i];
  for (uint32_t i = s->plan.rank; i < s->found; i++) tail += s->ritz[i];
  double rest = fmax(0, s->energy - captured);
  if (s->energy > 0 && rest + tail < smallest_difference * s->energy)
    BTFI_TRY(btfi_svd_explicit_rest(s, 0.9, 0.99, &rest));
  residual[s->found] = rest;
  for (uint32_t i = s->found; i-- > 0;) residual[i] = residual[i + 1] + s->ritz[i];
  return BTF_OK;
}

/* Columns whose sum is negative turn round, so that a pair has one sign however it was found. */
static void fix_signs(svd_state *s, uint32_t rank) {
  const size_t width = s->plan.width;
  for (uint32_t k = 0; k < rank; k++) {
    double sum = 0;
    for (uint64_t j = 0; j < s->desc->length; j++) sum += s->basis[j * width + k];
    if (sum >= 0) continue;
    for (uint64_t j = 0; j < s->desc->length; j++) s->basis[j * width + k] = -s->basis[j * width + k];
    for (uint64_t i = 0; i < s->desc->items; i++)
      s->projection[i * width + k] = -s->projection[i * width + k];
  }
}

static btf_status make_result(svd_state *s, btf_svd_result *out) {
  const uint32_t width = s->plan.width;
  double *residual = btfi_alloc(s->ctx, (uint64_t)width + 1, sizeof(double));
  if (residual == NULL) return btfi_alloc_status();
  btfi_svd_apply(s, s->projection, (size_t)s->desc->items, s->left, s->found);
  btf_status status = residuals(s, residual);
  uint32_t rank = BTFI_MIN(s->plan.rank, s->found);
  if (status == BTF_OK && s->desc->target_residual > 0) {
    uint32_t enough = 0;
    while (enough < rank && residual[enough] > s->desc->target_residual) enough++;
    rank = enough;
  }
  if (status == BTF_OK) {
    out->rank = rank;
    out->energy = s->energy;
    out->residual = residual[rank];
  }
  btfi_free(s->ctx, residual);
  BTFI_TRY(status);
  /* A target of the whole energy or more is met by no component at all; the rank may be 0. */
  BTFI_TRY(btfi_svd_straighten(s, s->projection, (size_t)s->desc->items, rank));
  fix_signs(s, rank);
  out->sigma = btfi_alloc(s->ctx, rank, sizeof(double));
  out->element_vectors = btfi_alloc(s->ctx, s->desc->length, (uint64_t)rank * sizeof(float));
  if (out->sigma == NULL || out->element_vectors == NULL) return btfi_alloc_status();
  for (uint32_t k = 0; k < rank; k++) out->sigma[k] = sqrt(s->ritz[k]);
  for (uint64_t j = 0; j < s->desc->length; j++)
    memcpy(out->element_vectors + j * rank, s->basis + j * width, rank * sizeof(float));
  /* The projection has room for wider rows; they close up in place. */
  for (uint64_t i = 0; i < s->desc->items; i++)
    memmove(s->projection + i * rank, s->projection + i * width, rank * sizeof(float));
  out->item_vectors = s->projection;
  s->projection = NULL;
  return BTF_OK;
}

static btf_status decompose(svd_state *s, btf_svd_result *out) {
  const double target = s->desc->target_residual;
  uint32_t rank = target > 0 ? BTFI_MIN(s->largest_rank, (uint32_t)FIRST_TARGET_RANK) : s->largest_rank;
  for (;;) {
    const btf_status planned = make_plan(s->ctx, s->desc, rank, &s->plan);
    if (planned != BTF_OK) {
      /* With what this rank needs a target might fail at the next one: tell what is enough for all. */
      if (rank < s->largest_rank) (void)make_plan(s->ctx, s->desc, s->largest_rank, &s->plan);
      return planned;
    }
    BTFI_TRY(begin_state(s));
    btfi_random_seed(&s->random, s->desc->seed);
    const uint32_t passes = s->passes;
    BTFI_TRY(converge(s));
    if (s->plan.held) s->passes = passes + 1;
    const bool promised = s->sample_rest <= 1.05 * target || rank == s->largest_rank;
    if (target > 0 && !promised) {
      end_state(s);
      rank = BTFI_MIN(s->largest_rank, rank * 2);
      continue;
    }
    BTFI_TRY(make_result(s, out));
    if (!(target > 0) || out->residual <= target || rank == s->largest_rank || out->rank < rank) break;
    btfi_svd_free(s->ctx, out);
    end_state(s);
    rank = BTFI_MIN(s->largest_rank, rank + rank / 2 + 8);
  }
  out->passes = s->passes;
  return btfi_progress(s->job, s->to, "svd");
}

/* Squares of values below this, on average, would come near the lower end of float's range. */
static const double smallest_mean_square = 1e-30;

/* The decomposition of values whose squares float cannot hold, by a power of two, which rounds nothing. Only
 * such a matrix is read once more for it. */
static btf_status decompose_scaled(svd_state *s, btf_svd_desc *desc, btf_svd_result *out) {
  const btf_status status = decompose(s, out);
  const double values = (double)desc->items * (double)desc->length;
  const bool small = status == BTF_OK && out->energy < smallest_mean_square * values;
  float largest;
  if (status != BTF_E_NUMERIC && !small) return status;
  BTFI_TRY(btfi_svd_find_largest(s, &largest));
  if (largest == 0) return status;
  frexpf(largest, &s->exponent);
  btfi_svd_free(s->ctx, out);
  end_state(s);
  s->from = s->to; /* progress never goes back */
  desc->target_residual = ldexp(desc->target_residual, -2 * s->exponent);
  BTFI_TRY(decompose(s, out));
  for (uint32_t k = 0; k < out->rank; k++) out->sigma[k] = ldexp(out->sigma[k], s->exponent);
  out->energy = ldexp(out->energy, 2 * s->exponent);
  out->residual = ldexp(out->residual, 2 * s->exponent);
  return BTF_OK;
}

/* ---- entry ---- */

static btf_status check(btf_context *ctx, const btf_svd_desc *desc) {
  if (desc->read == NULL) return btfi_fail(ctx, BTF_E_INVALID_ARG, "svd: read is NULL; expected a function");
  if (desc->items == 0 || desc->length == 0 || desc->rank == 0)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "svd: %" PRIu64 " items of %" PRIu64 " elements and rank %u; expected at least one each",
                     desc->items, desc->length, desc->rank);
  if (desc->layout > BTF_LAYOUT_ITEM_COLUMNS)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "svd: layout %u is unknown", desc->layout);
  if (!(desc->tolerance >= 0 && desc->tolerance <= 1) || !(desc->target_residual >= 0) ||
      !isfinite(desc->target_residual))
    return btfi_fail(
        ctx, BTF_E_INVALID_ARG,
        "svd: tolerance %g and target residual %g; expected 0 to 1 and a finite number of at least 0",
        desc->tolerance, desc->target_residual);
  /* BLAS counts in int, and a block's rows may be this long. */
  if (desc->length > INT32_MAX / 2 || desc->items > INT64_MAX / 65536)
    return btfi_fail(ctx, BTF_E_LIMIT, "svd: %" PRIu64 " items of %" PRIu64 " elements are too many",
                     desc->items, desc->length);
  return BTF_OK;
}

void btfi_svd_free(btf_context *ctx, btf_svd_result *result) {
  if (result == NULL) return;
  btfi_free(ctx, result->item_vectors);
  btfi_free(ctx, result->element_vectors);
  btfi_free(ctx, result->sigma);
  const size_t size = result->struct_size;
  memset(result, 0, BTFI_MIN(size, sizeof *result));
  result->struct_size = size;
}

btf_status btfi_svd(btf_context *ctx, const btf_svd_desc *user, const btf_job *job, double from, double to,
                    btf_svd_result *out) {
  btf_svd_desc desc;
  btf_svd_result result = {0}, nothing = {0};
  result.struct_size = sizeof result;
  BTFI_TRY(btfi_copy_out(ctx, "btf_svd_result", out, BTFI_SIZE_TO(btf_svd_result, residual), &nothing,
                         sizeof nothing));
  BTFI_TRY(btfi_copy_in(ctx, "btf_svd_desc", &desc, sizeof desc, BTFI_SIZE_TO(btf_svd_desc, reserved), user));
  BTFI_TRY(check(ctx, &desc));
  if (desc.max_working_set == 0) desc.max_working_set = default_working_set;
  if (desc.tolerance == 0) desc.tolerance = default_tolerance;

  svd_state s = {.ctx = ctx, .desc = &desc, .job = job, .from = from, .to = to};
  s.largest_rank = (uint32_t)BTFI_MIN((uint64_t)desc.rank, BTFI_MIN(desc.items, desc.length));
  btf_status status = decompose_scaled(&s, &desc, &result);
  end_state(&s);
  if (status == BTF_OK)
    status = btfi_copy_out(ctx, "btf_svd_result", out, BTFI_SIZE_TO(btf_svd_result, residual), &result,
                           sizeof result);
  if (status == BTF_OK) return BTF_OK;
  btfi_svd_free(ctx, &result);
  nothing.least_working_set = s.plan.least_bytes;
  (void)btfi_copy_out(ctx, "btf_svd_result", out, BTFI_SIZE_TO(btf_svd_result, residual), &nothing,
                      sizeof nothing);
  return status;
}
