/* SPDX-License-Identifier: MIT */
/* choose.c: how many terms each view gets. */
#include "pvpca.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <btf/btf_codec.h>

static double without_terms(const btfi_pvpca_fit_job *f) {
  double error = 0.0;
  for (uint32_t v = 0; v < f->layout.views; v++) error += f->centred[v] + f->mean_error[v];
  return error;
}

/* What is decoded meets the target although floats that are rounded again do not add up exactly. */
static double safe_target(const btfi_pvpca_fit_job *f) {
  return f->target * 0.999;
}

/* The smallest number that reaches the target, or the best there is. */
static double choose_fixed(btfi_pvpca_fit_job *f) {
  double error = without_terms(f), best = error;
  uint32_t terms = 0;
  for (uint32_t j = 0; j < f->keep && best > safe_target(f); j++) {
    for (uint32_t v = 0; v < f->layout.views; v++) {
      const btfi_pvpca_candidate *c = &f->candidates[(size_t)v * f->keep + j];
      error += c->error - c->gain;
    }
    if (error < best) {
      best = error;
      terms = j + 1;
    }
  }
  for (uint32_t v = 0; v < f->layout.views; v++) f->view[v].terms = terms;
  return best;
}

/* Most useful first; within a view in order, as their use is made to fall. */
static int by_use(const void *a, const void *b) {
  const btfi_pvpca_candidate *x = a, *y = b;
  if (x->gain != y->gain) return x->gain < y->gain ? 1 : -1;
  if (x->view != y->view) return x->view < y->view ? -1 : 1;
  return (x->term > y->term) - (x->term < y->term);
}

/* Every term of every view costs the same room: taking the most useful ones fills the room in the best way.
 */
static double choose_adaptive(btfi_pvpca_fit_job *f, btfi_pvpca_candidate *sorted) {
  const uint64_t count = (uint64_t)f->layout.views * f->keep;
  const uint64_t room = f->has_target ? count : (uint64_t)f->layout.views * f->components;
  double error = without_terms(f);
  for (uint64_t i = 0; i < count; i++) {
    sorted[i] = f->candidates[i];
    sorted[i].gain -= sorted[i].error;
    if (sorted[i].term > 0) sorted[i].gain = fmin(sorted[i].gain, sorted[i - 1].gain);
  }
  qsort(sorted, count, sizeof *sorted, by_use);
  for (uint32_t v = 0; v < f->layout.views; v++) f->view[v].terms = 0;
  for (uint64_t i = 0; i < count && i < room && sorted[i].gain > 0.0; i++) {
    const btfi_pvpca_candidate *c = &f->candidates[(size_t)sorted[i].view * f->keep + sorted[i].term];
    if (f->has_target && error <= safe_target(f)) break;
    f->view[sorted[i].view].terms++;
    error += c->error - c->gain;
  }
  return error;
}

btf_status btfi_pvpca_choose(btfi_pvpca_fit_job *f) {
  double error;
  if (f->budget == PVPCA_ADAPTIVE) {
    btfi_pvpca_candidate *sorted =
        f->host->alloc(f->ctx, (uint64_t)f->layout.views * f->keep, sizeof *sorted);
    if (sorted == NULL) return BTF_E_NOMEM;
    error = choose_adaptive(f, sorted);
    f->host->free(f->ctx, sorted);
  } else {
    error = choose_fixed(f);
  }
  /* A model without any value would have an empty chunk. */
  if (f->layout.has_mean == 0 && f->view[0].terms == 0) f->view[0].terms = 1;
  if (f->has_target && error > f->target) {
    const double samples = (double)f->layout.views * (double)f->rows * (double)f->columns;
    btf_warn_missed(f->host, f->ctx, "pvpca", f->keep, "components of a view", error, f->target, samples,
                    f->target_psnr);
  }
  return BTF_OK;
}
