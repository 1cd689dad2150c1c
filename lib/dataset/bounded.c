/* SPDX-License-Identifier: MIT */
/* bounded.c: reading within a memory budget.
 *
 * Pages of a mapping count as memory of the process once touched, and the system decides how many it maps
 * around one: up to 2 MiB. Within a budget that the mapping exceeds, the file is read instead, through a
 * buffer that caches hold, which makes none resident. */
#include "dataset/dataset_parts.h"

#include <errno.h>
#include <inttypes.h>
#include <string.h>

enum {
  least_scratch_bytes = 1 << 16, /* below this, calling the source costs more than the memory is worth */
  budget_over_scratch = 32,
  block_axes = 4
};

/* Axes of a block as they lie in the source, innermost first. */
typedef struct source_axis {
  uint64_t count, stride;
} source_axis;

static void source_axes(const btf_dataset *ds, const btf_block *b, source_axis axes[block_axes]) {
  const btf_strides *s = &ds->desc.strides;
  const bool images = (ds->desc.flags & BTF_DATASET_IMAGE_MAJOR) != 0;
  const int texel = images ? 0 : 2, pair = images ? 2 : 0;
  axes[texel] = (source_axis){b->width, (uint64_t)s->x};
  axes[texel + 1] = (source_axis){b->height, (uint64_t)s->y};
  axes[pair] = (source_axis){b->lights, (uint64_t)s->light};
  axes[pair + 1] = (source_axis){b->views, (uint64_t)s->view};
}

btf_status btfi_read_runs(const btf_dataset *ds, const btf_block *b, void *dst) {
  const btf_strides *s = &ds->desc.strides;
  source_axis axes[block_axes];
  uint64_t run = (uint64_t)ds->desc.channels * btfi_sample_size(ds->desc.sample_type), runs = 1,
           index[block_axes] = {0};
  int outer = 0;
  uint64_t offset = (uint64_t)((const char *)ds->desc.data - (const char *)ds->mapping.data) +
                    b->view0 * (uint64_t)s->view + b->light0 * (uint64_t)s->light + b->y0 * (uint64_t)s->y +
                    b->x0 * (uint64_t)s->x;
  source_axes(ds, b, axes);
  while (outer < block_axes && axes[outer].stride == run) run *= axes[outer++].count;
  for (int k = outer; k < block_axes; k++) runs *= axes[k].count;
  for (char *to = dst; runs > 0; runs--, to += run) {
    if (!btfi_mapping_read(&ds->mapping, to, run, offset))
      return btf_source_error(errno == 0 ? BTF_E_TRUNCATED : BTF_E_IO,
                              "%s: %" PRIu64 " bytes at %" PRIu64 " of the samples cannot be read: %s",
                              ds->label, run, offset,
                              errno == 0 ? "the file has become shorter" : strerror(errno));
    for (int k = outer; k < block_axes; k++) {
      offset += axes[k].stride;
      if (++index[k] < axes[k].count) break;
      offset -= axes[k].stride * axes[k].count;
      index[k] = 0;
    }
  }
  return BTF_OK;
}

btf_status btfi_dataset_within(const btf_dataset *ds, uint64_t bytes, btf_dataset **out) {
  *out = NULL;
  if (bytes == 0) {
    *out = btf_dataset_retain(ds);
    return BTF_OK;
  }
  btf_dataset *reader = btfi_calloc(ds->ctx, 1, sizeof *reader);
  if (!reader) return btfi_alloc_status();
  reader->ctx = ds->ctx;
  btfi_context_retain(ds->ctx);
  pthread_mutex_init(&reader->one_reader, NULL);
  atomic_init(&reader->references, 1);
  reader->whole = btf_dataset_retain(ds->whole ? ds->whole : ds);
  reader->desc = ds->desc;
  reader->desc.release = NULL; /* that is the owner's to call */
  reader->kernels = ds->kernels;
  reader->label = ds->label;
  reader->light_weights = ds->light_weights;
  reader->mapping = ds->mapping;
  const uint64_t share = BTFI_MAX(bytes / budget_over_scratch, (uint64_t)least_scratch_bytes);
  reader->scratch_bytes = BTFI_MIN(share, BTFI_SOURCE_SCRATCH_BYTES);
  reader->reads_file = ds->mapping.size > bytes;
  btfi_mapping_let_go(&ds->mapping);
  *out = reader;
  return BTF_OK;
}
