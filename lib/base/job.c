/* SPDX-License-Identifier: MIT */
#include "base/base.h"

#include <string.h>
#include <time.h>

static const int64_t report_interval_ns = 100000000;

int64_t btfi_now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

btf_status btfi_job_begin(btf_context *ctx, const btf_job *user, btfi_job *out) {
  const btf_job defaults = BTF_JOB_INIT;
  memset(out, 0, sizeof *out);
  out->desc = defaults;
  out->ctx = ctx;
  out->last_fraction = -1.0;
  if (user)
    BTFI_TRY(btfi_copy_in(ctx, "btf_job", &out->desc, sizeof out->desc, BTFI_SIZE_TO(btf_job, seed), user));
  if (out->desc.running)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "btf_job: running is set; expected NULL, as BTF_JOB_INIT has it");
  out->desc.running = out;
  if (out->desc.max_working_set == 0) out->desc.max_working_set = (uint64_t)1 << 30;
  return BTF_OK;
}

btf_status btfi_progress(const btf_job *given, double fraction, const char *stage) {
  if (!given) return BTF_OK;
  if (given->struct_size < BTFI_SIZE_TO(btf_job, running) || !given->running)
    return btfi_fail(NULL, BTF_E_INVALID_ARG,
                     "btf_job: expected the job that `fit` was given, or a copy of it");
  btfi_job *job = given->running;
  if (job->cancelled) return btfi_fail(NULL, BTF_E_CANCELLED, "cancelled by the caller");
  if (!job->desc.progress) return BTF_OK;

  if (!stage) stage = "";
  fraction = fraction > 0.0 ? BTFI_MIN(fraction, 1.0) : 0.0; /* NaN becomes 0 */
  const int64_t now = btfi_now_ns();
  const bool new_stage =
      job->last_fraction < 0.0 || strncmp(stage, job->last_stage, sizeof job->last_stage - 1) != 0;
  const bool end_reached = (fraction == 0.0 || fraction == 1.0) && fraction != job->last_fraction;
  if (!new_stage && !end_reached && now - job->last_report_ns < report_interval_ns) return BTF_OK;

  if (new_stage) strncpy(job->last_stage, stage, sizeof job->last_stage - 1);
  job->last_fraction = fraction;
  job->last_report_ns = now;
  if (job->desc.progress(job->desc.user, fraction, stage) == 0) return BTF_OK;
  job->cancelled = true;
  return btfi_fail(job->ctx, BTF_E_CANCELLED, "cancelled by the caller at stage \"%s\"", stage);
}
