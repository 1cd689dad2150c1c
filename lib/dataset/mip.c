/* SPDX-License-Identifier: MIT */
#include "dataset/dataset.h"

#include <btf/btf_sampling.h>

uint32_t btfi_mip_count(uint32_t width, uint32_t height) {
  uint32_t levels = 1;
  for (uint32_t side = BTFI_MAX(width, height); side > 1; side >>= 1) ++levels;
  return levels;
}

void btfi_mip_span_of(uint32_t size, uint32_t level_size, uint32_t i, btfi_mip_span *out) {
  const uint64_t begin = (uint64_t)i * size, end = begin + size; /* in finest texels times level_size */
  const uint64_t first = begin / level_size, last = (end - 1) / level_size;
  out->first = (uint32_t)first;
  out->count = (uint32_t)(last - first + 1);
  if (out->count == 1) {
    out->first_weight = out->last_weight = (double)size / level_size;
  } else {
    out->first_weight = (double)((first + 1) * level_size - begin) / level_size;
    out->last_weight = (double)(end - last * level_size) / level_size;
  }
}

enum { filter_lanes = 32 };

typedef struct mip_job {
  const float *src;
  float *dst;
  size_t src_ld, dst_ld;
  uint32_t width, height, level_width, level_height, n;
} mip_job;

/* One texel of the level, components c0 .. c0 + lanes - 1. */
static void filter_texel(const mip_job *job, const btfi_mip_span *sx, const btfi_mip_span *sy, uint32_t c0,
                         uint32_t lanes, float *dst) {
  double sum[filter_lanes] = {0.0};
  const double area = (double)job->width / job->level_width * ((double)job->height / job->level_height);
  for (uint32_t ky = 0; ky < sy->count; ++ky) {
    const float *src = job->src + ((size_t)(sy->first + ky) * job->width + sx->first) * job->src_ld + c0;
    double row[filter_lanes] = {0.0};
    for (uint32_t kx = 0; kx < sx->count; ++kx, src += job->src_ld) {
      const double weight = btfi_mip_weight(sx, kx);
      if (lanes == filter_lanes)
        for (uint32_t c = 0; c < filter_lanes; ++c) row[c] += weight * (double)src[c];
      else
        for (uint32_t c = 0; c < lanes; ++c) row[c] += weight * (double)src[c];
    }
    const double weight = btfi_mip_weight(sy, ky);
    for (uint32_t c = 0; c < filter_lanes; ++c) sum[c] += weight * row[c];
  }
  for (uint32_t c = 0; c < lanes; ++c) dst[c0 + c] = (float)(sum[c] / area);
}

static void filter_row(void *user, uint32_t y, uint32_t thread) {
  (void)thread;
  const mip_job *job = user;
  btfi_mip_span sx, sy;
  btfi_mip_span_of(job->height, job->level_height, y, &sy);
  for (uint32_t x = 0; x < job->level_width; ++x) {
    float *dst = job->dst + ((size_t)y * job->level_width + x) * job->dst_ld;
    btfi_mip_span_of(job->width, job->level_width, x, &sx);
    for (uint32_t c0 = 0; c0 < job->n; c0 += filter_lanes)
      filter_texel(job, &sx, &sy, c0, BTFI_MIN((uint32_t)filter_lanes, job->n - c0), dst);
  }
}

btf_status btfi_mip_filter(btf_context *ctx, const float *src, size_t src_ld, uint32_t width, uint32_t height,
                           uint32_t n, uint32_t level, float *dst, size_t dst_ld) {
  if (!src || !dst || width == 0 || height == 0 || src_ld < n || dst_ld < n)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "mip filter: expected texels, and distances of at least %u floats", n);
  mip_job job = {src,
                 dst,
                 src_ld,
                 dst_ld,
                 width,
                 height,
                 btf_sampling_level_size(width, level),
                 btf_sampling_level_size(height, level),
                 n};
  return btfi_parallel(ctx, job.level_height, filter_row, &job);
}
