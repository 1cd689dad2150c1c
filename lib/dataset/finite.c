/* SPDX-License-Identifier: MIT */
/* Looks at every sample once for those that are not finite, as fast as memory gives them and without
 * converting them. */
#include "dataset/dataset_parts.h"
#include "dataset/pieces.h"

#include <string.h>

#include <btf/btf_plugin.h>

/* Pieces do not depend on the number of threads, so that the same sample is named with any. */
enum { piece_bytes = 1 << 20, pieces_at_once = 256, message_bytes = 512, axes = 5 };

/* One axis in memory; the stride is positive, for the order of the samples does not matter here. */
typedef struct memory_axis {
  size_t count;
  ptrdiff_t stride;
} memory_axis;

/* An exponent of all ones carries into the bit above it. */
static bool finite_f32(const char *src, size_t n) {
  uint32_t carry = 0;
  for (size_t i = 0; i < n; ++i) {
    uint32_t bits;
    memcpy(&bits, src + 4 * i, sizeof bits);
    carry |= (bits & 0x7f800000u) + 0x00800000u;
  }
  return (carry & 0x80000000u) == 0;
}

static bool finite_f16(const char *src, size_t n) {
  uint16_t carry = 0;
  for (size_t i = 0; i < n; ++i) {
    uint16_t bits;
    memcpy(&bits, src + 2 * i, sizeof bits);
    carry = (uint16_t)(carry | ((bits & 0x7c00u) + 0x0400u));
  }
  return (carry & 0x8000u) == 0;
}

static bool finite_samples(uint32_t sample_type, const memory_axis *axis, int level, const char *src,
                           size_t run) {
  bool fine = true;
  if (level == 0) return sample_type == BTF_SAMPLE_F32 ? finite_f32(src, run) : finite_f16(src, run);
  for (size_t i = 0; i < axis[level - 1].count; ++i, src += axis[level - 1].stride)
    fine &= finite_samples(sample_type, axis, level - 1, src, run);
  return fine;
}

static bool finite_block(const btf_dataset_desc *d, const btf_block *b, const char *src) {
  const btf_strides *s = &d->strides;
  const memory_axis all[axes] = {{d->channels, s->channel},
                                 {b->width, s->x},
                                 {b->height, s->y},
                                 {b->lights, s->light},
                                 {b->views, s->view}};
  memory_axis axis[axes];
  int count = 0, runs = 0;
  size_t run = 1;
  for (int k = 0; k < axes; ++k) {
    memory_axis a = all[k];
    int at = count;
    if (a.count == 1 || a.stride == 0) continue;
    if (a.stride < 0) {
      src += a.stride * (ptrdiff_t)(a.count - 1);
      a.stride = -a.stride;
    }
    for (; at > 0 && axis[at - 1].stride > a.stride; --at) axis[at] = axis[at - 1];
    axis[at] = a;
    ++count;
  }
  for (; runs < count && axis[runs].stride == (ptrdiff_t)(run * btfi_sample_size(d->sample_type)); ++runs)
    run *= axis[runs].count;
  return finite_samples(d->sample_type, axis + runs, count - runs, src, run);
}

typedef struct finite_scan {
  const btf_dataset *ds;
  btfi_pieces pieces;
  uint64_t first; /* piece of task 0 */
  atomic_ullong bad;
} finite_scan;

static const char *piece_samples(const finite_scan *scan, const btf_block *b) {
  static const btf_block corner = {0, 0, 0, 0, 0, 0, 0, 0};
  const btf_dataset_desc *d = &scan->ds->desc;
  return (const char *)d->data + btfi_block_offset(&corner, b, &d->strides);
}

static void scan_piece(void *user, uint32_t index, uint32_t thread) {
  finite_scan *scan = user;
  const unsigned long long piece = scan->first + index;
  const btf_block b = btfi_pieces_at(&scan->pieces, piece);
  unsigned long long bad = atomic_load(&scan->bad);
  (void)thread;
  if (bad < piece || finite_block(&scan->ds->desc, &b, piece_samples(scan, &b))) return;
  while (piece < bad && !atomic_compare_exchange_weak(&scan->bad, &bad, piece))
    ;
}

static btf_status fail_in_piece(const finite_scan *scan) {
  const btf_dataset_desc *d = &scan->ds->desc;
  const btf_block b = btfi_pieces_at(&scan->pieces, atomic_load(&scan->bad));
  char message[message_bytes];
  return btfi_fail_not_finite(scan->ds->ctx, scan->ds->label, d->sample_type, &b, d->channels,
                              piece_samples(scan, &b), &d->strides, message, sizeof message);
}

/* Reports fractions from `start` on, of `share` in all. */
static btf_status scan_block(const btf_dataset *ds, const btf_block *whole, const btf_job *job, double start,
                             double share) {
  const uint64_t cell = (uint64_t)btfi_sample_size(ds->desc.sample_type) * ds->desc.channels;
  finite_scan scan = {.ds = ds};
  atomic_init(&scan.bad, UINT64_MAX);
  btfi_pieces_cut(&scan.pieces, whole,
                  ds->desc.flags & BTF_DATASET_IMAGE_MAJOR ? BTF_ORDER_VLYXC : BTF_ORDER_YXVLC,
                  piece_bytes / cell, false);
  const uint64_t total = scan.pieces.total;
  for (; scan.first < total; scan.first += pieces_at_once) {
    const uint32_t tasks = (uint32_t)BTFI_MIN(total - scan.first, (uint64_t)pieces_at_once);
    BTFI_TRY(btfi_parallel(ds->ctx, tasks, scan_piece, &scan));
    if (atomic_load(&scan.bad) != UINT64_MAX) return fail_in_piece(&scan);
    /* What was looked at is still in the system's cache; pages of a large mapping need not count as ours. */
    if (ds->mapping.size > (uint64_t)piece_bytes * pieces_at_once) btfi_mapping_let_go(&ds->mapping);
    BTFI_TRY(btfi_progress(job, start + share * (double)(scan.first + tasks) / (double)total, "checking"));
  }
  return BTF_OK;
}

btf_status btfi_dataset_check_finite(const btf_dataset *ds, const btf_job *job) {
  const btf_dataset_desc *d = &ds->desc;
  const uint32_t views = btf_dirset_count(d->views);
  btf_block all = {0, views, 0, btf_dirset_count(d->lights), 0, 0, d->width, d->height};
  if (!d->data || d->sample_type == BTF_SAMPLE_U8 || d->sample_type == BTF_SAMPLE_U16) return BTF_OK;
  if (!d->view_lights) return scan_block(ds, &all, job, 0.0, 1.0);
  all.views = 1;
  for (; all.view0 < views; ++all.view0) {
    all.lights = btf_dirset_count(d->view_lights[all.view0]);
    BTFI_TRY(scan_block(ds, &all, job, (double)all.view0 / views, 1.0 / views));
  }
  return BTF_OK;
}
