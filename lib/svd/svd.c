/* SPDX-License-Identifier: MIT */
/* svd.c: the truncated SVD as a whole: passes until the estimate is met, and the result. */
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
  FIRST_TARGET_RANK = 24,
  REFINE_GAIN = 10 /* what refining reduces an error by, or more */
};

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
    const double last = first + 0.6 * (0.9 - first), rest_before = fmax(0, s->energy - after);
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
  const double end = s->to;
  for (;;) {
    /* An attempt that may not be the last leaves half of the way to the others. */
    s->to = target > 0 && rank < s->largest_rank ? 0.5 * (s->from + end) : end;
    const btf_status planned = btfi_svd_plan(s->ctx, s->desc, rank, s->quiet, &s->plan);
    if (planned != BTF_OK) {
      /* With what this rank needs a target might fail at the next one: tell what is enough for all. */
      if (rank < s->largest_rank) (void)btfi_svd_plan(s->ctx, s->desc, s->largest_rank, s->quiet, &s->plan);
      return planned;
    }
    BTFI_TRY(btfi_svd_begin_state(s));
    btfi_random_seed(&s->random, s->desc->seed);
    const uint32_t passes = s->passes;
    BTFI_TRY(converge(s));
    if (s->plan.held) s->passes = passes + 1;
    const bool promised = s->sample_rest <= 1.05 * target || rank == s->largest_rank;
    if (target > 0 && !promised) {
      btfi_svd_end_state(s);
      s->from = s->reached;
      rank = BTFI_MIN(s->largest_rank, rank * 2);
      continue;
    }
    BTFI_TRY(make_result(s, out));
    if (!(target > 0) || out->residual <= target || rank == s->largest_rank || out->rank < rank) break;
    btfi_svd_free(s->ctx, out);
    btfi_svd_end_state(s);
    s->from = s->reached;
    rank = BTFI_MIN(s->largest_rank, rank + rank / 2 + 8);
  }
  out->passes = s->passes;
  s->to = end;
  return btfi_svd_report(s, 1);
}

/* Squares of values below this, on average, would come near the lower end of float's range. */
static const double smallest_mean_square = 1e-30;

/* The decomposition of values whose squares float cannot hold, by a power of two, which rounds nothing. Only
 * such a matrix is read once more for it. */
static btf_status decompose_scaled(svd_state *s, btf_svd_desc *desc, btf_svd_result *out) {
  const double to = s->to;
  const btf_status status = decompose(s, out);
  const double values = (double)desc->items * (double)desc->length;
  const bool small = (status == BTF_OK || s->lost) && s->energy < smallest_mean_square * values;
  float largest;
  if (!s->overflowed && !small) return status;
  BTFI_TRY(btfi_svd_find_largest(s, &largest));
  if (largest == 0) return status;
  frexpf(largest, &s->exponent);
  btfi_svd_free(s->ctx, out);
  btfi_svd_end_state(s);
  s->overflowed = false;
  s->from = s->reached; /* progress never goes back */
  s->to = to;
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
  if (desc->reserved != 0)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "svd: reserved is %u; expected 0", desc->reserved);
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

static btf_status run(btf_context *ctx, bool quiet, const btf_svd_desc *user, const btf_job *job, double from,
                      double to, btf_svd_result *out) {
  btf_svd_desc desc;
  btf_svd_result result = {0}, nothing = {0};
  result.struct_size = sizeof result;
  BTFI_TRY(btfi_copy_out(ctx, "btf_svd_result", out, BTFI_SIZE_TO(btf_svd_result, residual), &nothing,
                         sizeof nothing));
  BTFI_TRY(btfi_copy_in(ctx, "btf_svd_desc", &desc, sizeof desc, BTFI_SIZE_TO(btf_svd_desc, reserved), user));
  BTFI_TRY(check(ctx, &desc));
  if (desc.max_working_set == 0) desc.max_working_set = default_working_set;
  if (desc.tolerance == 0) desc.tolerance = default_tolerance;

  svd_state s = {.ctx = ctx, .desc = &desc, .job = job, .quiet = quiet};
  s.from = s.reached = from;
  s.to = to;
  s.largest_rank = (uint32_t)BTFI_MIN((uint64_t)desc.rank, BTFI_MIN(desc.items, desc.length));
  btf_status status = decompose_scaled(&s, &desc, &result);
  btfi_svd_end_state(&s);
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

btf_status btfi_svd(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from, double to,
                    btf_svd_result *out) {
  return run(ctx, false, desc, job, from, to, out);
}

btf_status btfi_svd_try(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from,
                        double to, btf_svd_result *out) {
  return run(ctx, true, desc, job, from, to, out);
}
