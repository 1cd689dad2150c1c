/* SPDX-License-Identifier: MIT */
#include "dataset/dataset_parts.h"
#include "dataset/pieces.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum {
  most_piece_bytes = 1 << 20, /* caches hold it from the source's writing to our reading */
  message_bytes = 512
};

static _Thread_local bool source_said_why;

btf_status btf_source_error(btf_status code, const char *format, ...) {
  char message[message_bytes];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(message, sizeof message, format, arguments);
  va_end(arguments);
  source_said_why = true;
  return btfi_fail(NULL, code, "%s", message);
}

btf_status btfi_fail_not_finite(btf_context *ctx, const char *label, uint32_t sample_type,
                                const btf_block *block, uint32_t channels, const void *src,
                                const btf_strides *s, char *message, size_t message_size) {
  for (uint32_t v = 0; v < block->views; ++v)
    for (uint32_t l = 0; l < block->lights; ++l)
      for (uint32_t y = 0; y < block->height; ++y)
        for (uint32_t x = 0; x < block->width; ++x)
          for (uint32_t c = 0; c < channels; ++c) {
            const char *sample = (const char *)src + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light +
                                 (ptrdiff_t)y * s->y + (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel;
            const float value = btfi_sample_to_float(sample_type, sample);
            if (value - value == 0.0f) continue;
            snprintf(message, message_size,
                     "%s: sample at view %u, light %u, row %u, column %u, channel %u is not finite", label,
                     block->view0 + v, block->light0 + l, block->y0 + y, block->x0 + x, c);
            return ctx ? btfi_fail(ctx, BTF_E_CORRUPT, "%s", message) : BTF_E_CORRUPT;
          }
  /* Only a source that changes under the reader comes here. */
  snprintf(message, message_size, "%s: a sample is not finite", label);
  return ctx ? btfi_fail(ctx, BTF_E_CORRUPT, "%s", message) : BTF_E_CORRUPT;
}

static void block_axes(const btf_dataset *ds, const btf_block *b, const btf_strides *src,
                       const btf_strides *dst, btfi_axis axes[btfi_axes_most]) {
  axes[0] = (btfi_axis){ds->desc.channels, src->channel, dst->channel};
  axes[1] = (btfi_axis){b->width, src->x, dst->x};
  axes[2] = (btfi_axis){b->height, src->y, dst->y};
  axes[3] = (btfi_axis){b->lights, src->light, dst->light};
  axes[4] = (btfi_axis){b->views, src->view, dst->view};
}

/* ---- resident and mapped samples ---- */

static btf_status read_resident(const btf_dataset *ds, const btf_block *b, float *dst,
                                const btf_strides *strides) {
  const btf_strides *s = &ds->desc.strides;
  const char *src = (const char *)ds->desc.data + (ptrdiff_t)b->view0 * s->view +
                    (ptrdiff_t)b->light0 * s->light + (ptrdiff_t)b->y0 * s->y + (ptrdiff_t)b->x0 * s->x;
  btfi_axis axes[btfi_axes_most];
  bool finite = true;
  block_axes(ds, b, s, strides, axes);
  BTFI_TRY(btfi_unpack_block(ds->ctx, &ds->kernels, axes, btfi_axes_most, src, dst, &finite));
  char message[message_bytes];
  return finite ? BTF_OK
                : btfi_fail_not_finite(ds->ctx, ds->label, ds->desc.sample_type, b, ds->desc.channels, src, s,
                                       message, sizeof message);
}

/* ---- samples of a source or a file ---- */

/* Each piece is read through a scratch buffer in the source's own order. */
typedef struct stream_job {
  const btf_dataset *ds;
  const btf_strides *dst_strides;
  btfi_pieces pieces;
  uint32_t order;
  char *dst, *scratch;
  uint64_t piece_size; /* bytes of scratch for each thread */
  pthread_mutex_t mutex;
  /* under the mutex: the first piece that failed */
  uint64_t failed_piece;
  btf_status status;
  char message[message_bytes];
} stream_job;

static btf_status call_source(const btf_dataset *ds, const btf_block *b, void *scratch, const btf_strides *s,
                              char *message) {
  const bool alone = !(ds->desc.flags & BTF_DATASET_CONCURRENT_READ);
  const btf_dataset *owner = ds->whole ? ds->whole : ds;
  pthread_mutex_t *mutex = (pthread_mutex_t *)(uintptr_t)&owner->one_reader;
  if (alone) pthread_mutex_lock(mutex);
  source_said_why = false;
  const btf_status status =
      ds->desc.data ? btfi_read_runs(ds, b, scratch) : ds->desc.read(ds->desc.user, b, scratch, s);
  if (alone) pthread_mutex_unlock(mutex);
  if (status == BTF_OK) return BTF_OK;
  if (source_said_why)
    snprintf(message, message_bytes, "%s", btf_error_message());
  else
    snprintf(message, message_bytes,
             "%s: the source failed with %s on a block from view %u, light %u, row %u, column %u", ds->label,
             btf_status_name(status), b->view0, b->light0, b->y0, b->x0);
  return status;
}

static btf_status read_piece(const stream_job *job, uint64_t index, char *scratch, char *message) {
  const btf_dataset *ds = job->ds;
  const btf_dataset_desc *d = &ds->desc;
  const btf_block b = btfi_pieces_at(&job->pieces, index);
  const btf_strides s = btfi_block_strides(&b, d->channels, job->order, btfi_sample_size(d->sample_type));
  BTFI_TRY(call_source(ds, &b, scratch, &s, message));
  btfi_axis axes[btfi_axes_most];
  bool finite = true;
  block_axes(ds, &b, &s, job->dst_strides, axes);
  const btf_status status =
      btfi_unpack_block(ds->ctx, &ds->kernels, axes, btfi_axes_most, scratch,
                        job->dst + btfi_block_offset(&job->pieces.whole, &b, job->dst_strides), &finite);
  if (status != BTF_OK) snprintf(message, message_bytes, "%s", btf_error_message());
  if (status != BTF_OK || finite) return status;
  return btfi_fail_not_finite(NULL, ds->label, d->sample_type, &b, d->channels, scratch, &s, message,
                              message_bytes);
}

static void stream_task(void *user, uint32_t index, uint32_t thread) {
  stream_job *job = user;
  char message[message_bytes];
  pthread_mutex_lock(&job->mutex);
  const bool needed = job->status == BTF_OK || index < job->failed_piece;
  pthread_mutex_unlock(&job->mutex);
  if (!needed) return;
  const btf_status status = read_piece(job, index, job->scratch + thread * job->piece_size, message);
  if (status == BTF_OK) return;
  pthread_mutex_lock(&job->mutex);
  if (job->status == BTF_OK || index < job->failed_piece) {
    job->status = status;
    job->failed_piece = index;
    memcpy(job->message, message, sizeof message);
  }
  pthread_mutex_unlock(&job->mutex);
}

static btf_status read_streamed(const btf_dataset *ds, const btf_block *b, float *dst,
                                const btf_strides *strides) {
  const btf_dataset_desc *d = &ds->desc;
  const uint64_t cell = btfi_sample_size(d->sample_type) * d->channels;
  const bool one_view = d->view_lights != NULL;
  const uint64_t scratch_bytes = ds->scratch_bytes != 0 ? ds->scratch_bytes : BTFI_SOURCE_SCRATCH_BYTES;
  stream_job job = {.ds = ds, .dst_strides = strides, .dst = (char *)dst};
  job.order = d->flags & BTF_DATASET_IMAGE_MAJOR ? BTF_ORDER_VLYXC : BTF_ORDER_YXVLC;
  uint32_t threads = d->flags & BTF_DATASET_CONCURRENT_READ ? btfi_thread_count(ds->ctx) : 1;
  btfi_pieces_cut(&job.pieces, b, job.order, BTFI_MIN(scratch_bytes, most_piece_bytes) / cell, one_view);
  if (job.pieces.total == 1) threads = 1;
  if (threads > 1)
    btfi_pieces_cut(&job.pieces, b, job.order, BTFI_MIN(scratch_bytes / threads, most_piece_bytes) / cell,
                    one_view);
  if (job.pieces.total > UINT32_MAX)
    return btfi_fail(ds->ctx, BTF_E_LIMIT, "%s: the block is too large to be read at once", ds->label);
  job.piece_size = job.pieces.cells * cell;
  job.scratch = btfi_alloc(ds->ctx, threads, job.piece_size);
  if (!job.scratch) return btfi_alloc_status();
  pthread_mutex_init(&job.mutex, NULL);
  btf_status status = BTF_OK;
  if (threads > 1)
    status = btfi_parallel(ds->ctx, (uint32_t)job.pieces.total, stream_task, &job);
  else
    for (uint32_t i = 0; i < job.pieces.total && job.status == BTF_OK; ++i) stream_task(&job, i, 0);
  pthread_mutex_destroy(&job.mutex);
  btfi_free(ds->ctx, job.scratch);
  return status == BTF_OK && job.status != BTF_OK ? btfi_fail(ds->ctx, job.status, "%s", job.message)
                                                  : status;
}

/* ---- entry ---- */

btf_status btfi_read_samples(const btf_dataset *ds, const btf_block *block, float *dst,
                             const btf_strides *strides) {
  return ds->desc.data && !ds->reads_file ? read_resident(ds, block, dst, strides)
                                          : read_streamed(ds, block, dst, strides);
}

static btf_status check_range(btf_context *ctx, const char *label, const char *axis, uint32_t first,
                              uint32_t count, uint32_t size, ptrdiff_t stride, bool writes_floats) {
  if (count > size || first > size - count)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the block has %s %u to %lld; expected 0 to %u", label, axis,
                     first, (long long)first + count - 1, size - 1);
  if (stride % (ptrdiff_t)sizeof(float) != 0 || (writes_floats && stride == 0 && count > 1))
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "%s: stride of %lld bytes between %s; expected a multiple of 4%s", label,
                     (long long)stride, axis, writes_floats ? " other than 0" : "");
  return BTF_OK;
}

btf_status btfi_dataset_check_block(btf_context *ctx, const char *label, const btf_dataset_desc *d,
                                    const btf_block *b, const btf_strides *s, bool writes_floats) {
  const uint32_t views = btf_dirset_count(d->views), lights = btf_dirset_count(d->lights);
  BTFI_TRY(check_range(ctx, label, "views", b->view0, b->views, views, s->view, writes_floats));
  BTFI_TRY(check_range(ctx, label, "lights", b->light0, b->lights, lights, s->light, writes_floats));
  BTFI_TRY(check_range(ctx, label, "rows", b->y0, b->height, d->height, s->y, writes_floats));
  BTFI_TRY(check_range(ctx, label, "columns", b->x0, b->width, d->width, s->x, writes_floats));
  return check_range(ctx, label, "channels", 0, d->channels, d->channels, s->channel, writes_floats);
}

btf_status btf_dataset_read(const btf_dataset *ds, const btf_block *block, float *dst,
                            const btf_strides *strides) {
  if (!ds || !block || !dst || !strides)
    return btfi_fail(ds ? ds->ctx : NULL, BTF_E_INVALID_ARG,
                     "btf_dataset_read: data set, block, destination and strides must not be NULL");
  BTFI_TRY(btfi_dataset_check_block(ds->ctx, ds->label, &ds->desc, block, strides, true));
  if (block->views == 0 || block->lights == 0 || block->width == 0 || block->height == 0) return BTF_OK;
  return ds->light_weights ? btfi_per_view_read(ds, block, dst, strides)
                           : btfi_read_samples(ds, block, dst, strides);
}

btf_status btf_dataset_read_abrdf(const btf_dataset *ds, uint32_t x, uint32_t y, uint32_t texels,
                                  float *dst) {
  if (!ds) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_dataset_read_abrdf: the data set must not be NULL");
  const uint32_t lights = btf_dirset_count(ds->desc.lights), views = btf_dirset_count(ds->desc.views);
  const btf_block block = {0, views, 0, lights, x, y, texels, 1};
  btf_strides s = btfi_dense_strides(&ds->desc, BTF_ORDER_YXVLC, (ptrdiff_t)sizeof(float));
  return btf_dataset_read(ds, &block, dst, &s);
}
