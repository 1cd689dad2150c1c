/* SPDX-License-Identifier: MIT */
#include "dataset/folder_writer.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "dataset/dataset_parts.h"
#include "dataset/pieces.h"
#include "io/folder.h"
#include "io/system.h"

#define SAMPLES_FILE "samples.bin"
enum { scratch_bytes = 4 << 20 };

/* `path` lies in the temporary folder, but the caller knows only the folder it is to become. */
static btf_status fail_io(const btf_dataset_writer *w, const char *path, const char *problem) {
  const int code = errno;
  size_t folder = strlen(w->path);
  while (folder > 1 && w->path[folder - 1] == '/') --folder;
  return btfi_fail(w->ctx, BTF_E_IO, "%.*s%s: %s: %s", (int)folder, w->path, path + strlen(w->temporary),
                   problem, strerror(code));
}

btf_status btfi_writer_pwrite(const btf_dataset_writer *w, const void *src, uint64_t n, uint64_t offset) {
  const char *from = src;
  while (n > 0) {
    const int64_t written = btfi_sys_write(w->fd, from, (size_t)BTFI_MIN(n, (uint64_t)1 << 30), offset);
    if (written == 0) errno = ENOSPC;
    if (written <= 0) return fail_io(w, w->samples_path, "cannot be written");
    from += written;
    offset += (uint64_t)written;
    n -= (uint64_t)written;
  }
  return BTF_OK;
}

/* ---- the folder ---- */

static btf_status find_files(btf_context *ctx, const btfi_folder_kind *kind, const char *path,
                             btfi_buffer *files) {
  (void)kind;
  char *file = NULL, *text = NULL, samples[NAME_MAX + 1];
  uint64_t size = 0;
  BTFI_TRY(btfi_path_join(ctx, path, BTFI_MANIFEST_FILE, &file));
  btf_status status = btfi_read_file(ctx, file, btfi_manifest_most_bytes, &text, &size);
  if (status == BTF_OK) status = btfi_manifest_is_ours(ctx, file, text, size, samples, sizeof samples);
  btfi_free(ctx, text);
  btfi_free(ctx, file);
  if (status != BTF_OK) return status;
  btfi_put_bytes(files, BTFI_MANIFEST_FILE, sizeof BTFI_MANIFEST_FILE);
  btfi_put_bytes(files, samples, strlen(samples) + 1);
  return BTF_OK;
}

static const btfi_folder_kind folder_kind = {"data-set folder", find_files};

/* ---- life ---- */

static btf_status make_keys(btf_dataset_writer *w) {
  const uint32_t count[4] = {btf_dirset_count(w->desc.views), btf_dirset_count(w->desc.lights),
                             w->desc.height, w->desc.width};
  btfi_random random;
  btfi_random_seed(&random, 0x6b657973u);
  w->cells = 1;
  for (int k = 0; k < 4; ++k) {
    w->cells *= count[k];
    w->key_sums[k] = btfi_alloc(w->ctx, (uint64_t)count[k] + 1, sizeof **w->key_sums);
    if (!w->key_sums[k]) return btfi_alloc_status();
    w->key_sums[k][0] = 0;
    for (uint32_t i = 0; i < count[k]; ++i)
      w->key_sums[k][i + 1] = w->key_sums[k][i] + (btfi_random_u64(&random) | 1u);
  }
  return BTF_OK;
}

static uint64_t keys_of(const btf_dataset_writer *w, const btf_block *b) {
  return (w->key_sums[0][b->view0 + b->views] - w->key_sums[0][b->view0]) *
         (w->key_sums[1][b->light0 + b->lights] - w->key_sums[1][b->light0]) *
         (w->key_sums[2][b->y0 + b->height] - w->key_sums[2][b->y0]) *
         (w->key_sums[3][b->x0 + b->width] - w->key_sums[3][b->x0]);
}

/* Texts or sizes that would make a manifest nobody can read are found before hours of work. */
static btf_status check_manifest(const btf_dataset_writer *w) {
  btfi_buffer text;
  btfi_manifest manifest;
  btfi_buffer_init(&text, w->ctx);
  btfi_manifest_put(&text, &w->desc, w->order, SAMPLES_FILE, w->texts, w->text_count);
  btf_status status = text.status;
  if (status == BTF_OK) {
    status = btfi_manifest_parse(w->ctx, w->path, (const char *)text.data, text.size, &manifest);
    if (status == BTF_OK) btfi_manifest_free(&manifest);
    if (status == BTF_E_CORRUPT) status = BTF_E_INVALID_ARG;
  }
  btfi_buffer_free(&text);
  return status;
}

static btf_status open_folder(btf_dataset_writer *w) {
  const uint64_t bytes = w->cells * w->desc.channels * w->kernels.sample_size;
  BTFI_TRY(btfi_folder_may_take(w->ctx, &folder_kind, w->path, NULL));
  BTFI_TRY(btfi_folder_make_beside(w->ctx, w->path, &w->temporary));
  BTFI_TRY(btfi_path_join(w->ctx, w->temporary, SAMPLES_FILE, &w->samples_path));
  w->fd = btfi_sys_open(AT_FDCWD, w->samples_path, O_RDWR | O_CREAT | O_EXCL, 0666);
  if (w->fd < 0) return fail_io(w, w->samples_path, "cannot be made");
  const int code = btfi_io_fault ? btfi_io_fault("ftruncate") : 0;
  if (code) errno = code;
  if (code || ftruncate(w->fd, (off_t)bytes) != 0)
    return fail_io(w, w->samples_path, "cannot be given its size");
  return BTF_OK;
}

static btf_status open_writer(btf_dataset_writer *w, const char *path, const btf_dataset_desc *desc) {
  btf_dataset_desc d = *desc;
  d.view_lights = NULL;
  BTFI_TRY(btfi_dataset_check_shape(w->ctx, path, &d));
  if (d.width > 65536 || d.height > 65536)
    return btfi_fail(w->ctx, BTF_E_LIMIT, "%s: %u x %u texels; a data-set folder holds 65536 along a side",
                     path, d.width, d.height);
  w->path = btfi_strdup(w->ctx, path);
  if (!w->path) return btfi_alloc_status();
  BTFI_TRY(btfi_dataset_copy_texts(w->ctx, &d));
  w->desc = d;
  w->kernels = btfi_convert_select(d.sample_type, btfi_isa(w->ctx));
  w->file = btfi_dense_strides(&d, w->order, (ptrdiff_t)w->kernels.sample_size);
  BTFI_TRY(make_keys(w));
  BTFI_TRY(check_manifest(w));
  BTFI_TRY(btfi_stage_create(w));
  return open_folder(w);
}

btf_status btf_dataset_writer_create(btf_context *ctx, const char *path, const btf_dataset_desc *desc,
                                     uint32_t order, btf_dataset_writer **out) {
  btf_dataset_desc own;
  if (out) *out = NULL;
  if (!ctx || !path || !path[0] || !desc || !out)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "btf_dataset_writer_create: context, path, description and result must not be NULL");
  BTFI_TRY(btfi_copy_in(ctx, "btf_dataset_desc", &own, sizeof own,
                        BTFI_SIZE_TO(btf_dataset_desc, view_lights), desc));
  if (order != BTF_ORDER_VLYXC && order != BTF_ORDER_YXVLC)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: order %u is unknown", path, order);
  btf_dataset_writer *w = btfi_calloc(ctx, 1, sizeof *w);
  if (!w) return btfi_alloc_status();
  w->ctx = ctx;
  w->order = order;
  w->fd = -1;
  atomic_init(&w->written_cells, 0);
  atomic_init(&w->written_keys, 0);
  btfi_context_retain(ctx);
  const btf_status status = open_writer(w, path, &own);
  if (status != BTF_OK) {
    btf_dataset_writer_abort(w);
    return status;
  }
  *out = w;
  return BTF_OK;
}

static void free_writer(btf_dataset_writer *w) {
  btf_context *ctx = w->ctx;
  if (w->fd >= 0) close(w->fd);
  btfi_stage_free(w);
  for (uint32_t i = 0; i < w->text_count; ++i) {
    btfi_free(ctx, w->texts[i].key);
    btfi_free(ctx, w->texts[i].value);
  }
  btfi_free(ctx, w->texts);
  for (int k = 0; k < 4; ++k) btfi_free(ctx, w->key_sums[k]);
  if (w->desc.lights) btfi_dataset_free_texts(ctx, &w->desc);
  btfi_free(ctx, w->samples_path);
  btfi_free(ctx, w->temporary);
  btfi_free(ctx, w->path);
  btfi_free(ctx, w);
  btf_context_release(ctx);
}

void btf_dataset_writer_abort(btf_dataset_writer *w) {
  static const char files[] = SAMPLES_FILE "\0" BTFI_MANIFEST_FILE;
  if (!w) return;
  if (w->temporary) btfi_folder_remove(w->ctx, w->temporary, files, sizeof files);
  free_writer(w);
}

/* ---- blocks ---- */

btf_status btfi_writer_fail_value(const btf_dataset_writer *w, const btf_block *b, const float *src,
                                  const btf_strides *s) {
  for (uint32_t v = 0; v < b->views; ++v)
    for (uint32_t l = 0; l < b->lights; ++l)
      for (uint32_t y = 0; y < b->height; ++y)
        for (uint32_t x = 0; x < b->width; ++x)
          for (uint32_t c = 0; c < w->desc.channels; ++c) {
            float value;
            memcpy(&value,
                   (const char *)src + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light +
                       (ptrdiff_t)y * s->y + (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel,
                   sizeof value);
            const bool finite = value - value == 0.0f;
            if (finite &&
                !(w->desc.sample_type == BTF_SAMPLE_F16 && (value >= 65520.0f || value <= -65520.0f)))
              continue;
            return btfi_fail(
                w->ctx, BTF_E_INVALID_ARG,
                "%s: sample at view %u, light %u, row %u, column %u, channel %u is %g; expected a %s",
                w->path, b->view0 + v, b->light0 + l, b->y0 + y, b->x0 + x, c, (double)value,
                finite ? "half float, which ends at 65504" : "finite number");
          }
  return btfi_fail(w->ctx, BTF_E_INVALID_ARG, "%s: the samples changed while they were written", w->path);
}

/* Writes a piece that is dense in the file's order, run by run. */
static btf_status write_runs(const btf_dataset_writer *w, const btf_block *b, const char *packed) {
  const uint32_t whole[4] = {btf_dirset_count(w->desc.views), btf_dirset_count(w->desc.lights),
                             w->desc.height, w->desc.width};
  const uint32_t first[4] = {b->view0, b->light0, b->y0, b->x0},
                 n[4] = {b->views, b->lights, b->height, b->width};
  const ptrdiff_t stride[4] = {w->file.view, w->file.light, w->file.y, w->file.x};
  static const int image_major[4] = {3, 2, 1, 0}, texel_major[4] = {1, 0, 3, 2};
  const int *axis = w->order == BTF_ORDER_YXVLC ? texel_major : image_major;
  uint64_t run = (uint64_t)w->desc.channels * w->kernels.sample_size, runs = 1, start = 0;
  int inner = 0;
  for (bool complete = true; inner < 4 && complete; ++inner) {
    run *= n[axis[inner]];
    complete = n[axis[inner]] == whole[axis[inner]];
  }
  for (int i = inner; i < 4; ++i) runs *= n[axis[i]];
  for (int k = 0; k < 4; ++k) start += (uint64_t)first[k] * (uint64_t)stride[k];
  for (uint64_t r = 0; r < runs; ++r, packed += run) {
    uint64_t offset = start, index = r;
    for (int i = inner; i < 4; ++i) {
      offset += index % n[axis[i]] * (uint64_t)stride[axis[i]];
      index /= n[axis[i]];
    }
    BTFI_TRY(btfi_writer_pwrite(w, packed, run, offset));
  }
  return BTF_OK;
}

static btf_status put_directly(const btf_dataset_writer *w, const btf_block *block, const float *src,
                               const btf_strides *s) {
  const uint64_t cell = (uint64_t)w->desc.channels * w->kernels.sample_size;
  btfi_pieces pieces;
  btfi_pieces_cut(&pieces, block, w->order, scratch_bytes / cell, false);
  char *packed = btfi_alloc(w->ctx, pieces.cells, cell);
  if (!packed) return btfi_alloc_status();
  btf_status status = BTF_OK;
  for (uint64_t i = 0; i < pieces.total && status == BTF_OK; ++i) {
    const btf_block b = btfi_pieces_at(&pieces, i);
    const btf_strides d = btfi_block_strides(&b, w->desc.channels, w->order, w->kernels.sample_size);
    const btfi_axis axes[btfi_axes_most] = {{w->desc.channels, s->channel, d.channel},
                                            {b.width, s->x, d.x},
                                            {b.height, s->y, d.y},
                                            {b.lights, s->light, d.light},
                                            {b.views, s->view, d.view}};
    const char *from = (const char *)src + btfi_block_offset(block, &b, s);
    if (btfi_pack_block(&w->kernels, axes, btfi_axes_most, from, packed))
      status = write_runs(w, &b, packed);
    else
      status = btfi_writer_fail_value(w, block, src, s);
  }
  btfi_free(w->ctx, packed);
  return status;
}

btf_status btf_dataset_writer_put(btf_dataset_writer *w, const btf_block *block, const float *src,
                                  const btf_strides *strides) {
  if (!w || !block || !src || !strides)
    return btfi_fail(w ? w->ctx : NULL, BTF_E_INVALID_ARG,
                     "btf_dataset_writer_put: writer, block, samples and strides must not be NULL");
  BTFI_TRY(btfi_dataset_check_block(w->ctx, w->path, &w->desc, block, strides, false));
  const uint64_t cells = (uint64_t)block->views * block->lights * block->width * block->height;
  if (cells == 0) return BTF_OK;
  const uint64_t before = atomic_fetch_add(&w->written_cells, cells);
  btf_status status;
  if (cells > w->cells || before > w->cells - cells)
    status = btfi_fail(w->ctx, BTF_E_INVALID_ARG,
                       "%s: more samples than the data set has; each may be written once", w->path);
  else if (btfi_stage_wants(w, block))
    status = btfi_stage_put(w, block, src, strides);
  else
    status = put_directly(w, block, src, strides);
  if (status != BTF_OK)
    atomic_fetch_sub(&w->written_cells, cells);
  else
    atomic_fetch_add(&w->written_keys, keys_of(w, block));
  return status;
}

/* ---- texts ---- */

btf_status btf_dataset_writer_text(btf_dataset_writer *w, const char *key, const char *value) {
  if (!w || !key || !key[0] || !value)
    return btfi_fail(w ? w->ctx : NULL, BTF_E_INVALID_ARG,
                     "btf_dataset_writer_text: writer, key and value must not be NULL");
  if (btfi_manifest_key_is_taken(key))
    return btfi_fail(w->ctx, BTF_E_INVALID_ARG, "%s: \"%s\" is a key of the format; expected one of your own",
                     w->path, key);
  for (uint32_t i = 0; i < w->text_count; ++i)
    if (strcmp(w->texts[i].key, key) == 0)
      return btfi_fail(w->ctx, BTF_E_INVALID_ARG, "%s: the text \"%s\" was given before", w->path, key);
  btfi_manifest_text *texts = btfi_calloc(w->ctx, (uint64_t)w->text_count + 1, sizeof *texts);
  if (!texts) return btfi_alloc_status();
  if (w->text_count > 0) memcpy(texts, w->texts, w->text_count * sizeof *texts);
  btfi_manifest_text *added = &texts[w->text_count];
  added->key = btfi_strdup(w->ctx, key);
  if (added->key) added->value = btfi_strdup(w->ctx, value);
  btf_status status = added->value ? BTF_OK : btfi_alloc_status();
  btfi_manifest_text *previous = w->texts;
  w->texts = texts;
  w->text_count++;
  if (status == BTF_OK) status = check_manifest(w);
  if (status == BTF_OK) {
    btfi_free(w->ctx, previous);
    return BTF_OK;
  }
  btfi_free(w->ctx, added->key);
  btfi_free(w->ctx, added->value);
  w->texts = previous;
  w->text_count--;
  btfi_free(w->ctx, texts);
  return status;
}

/* ---- the end ---- */

static btf_status check_complete(const btf_dataset_writer *w) {
  const btf_block all = {0,
                         btf_dirset_count(w->desc.views),
                         0,
                         btf_dirset_count(w->desc.lights),
                         0,
                         0,
                         w->desc.width,
                         w->desc.height};
  const uint64_t written = atomic_load(&w->written_cells);
  if (written < w->cells)
    return btfi_fail(w->ctx, BTF_E_STATE, "%s: %" PRIu64 " of %" PRIu64 " samples are missing", w->path,
                     (w->cells - written) * w->desc.channels, w->cells * w->desc.channels);
  if (atomic_load(&w->written_keys) != keys_of(w, &all))
    return btfi_fail(w->ctx, BTF_E_STATE, "%s: some samples were written twice and others never", w->path);
  return BTF_OK;
}

static btf_status sync_and_close(btf_dataset_writer *w, const char *path, int fd) {
  btf_status status = BTF_OK;
  if (btfi_sys_fsync(fd) != 0) status = fail_io(w, path, "cannot be written out");
  if (btfi_sys_close(fd) != 0 && status == BTF_OK) status = fail_io(w, path, "cannot be closed");
  return status;
}

static btf_status write_file(btf_dataset_writer *w, const char *path, const btfi_buffer *text) {
  const int fd = btfi_sys_open(AT_FDCWD, path, O_WRONLY | O_CREAT | O_EXCL, 0666);
  if (fd < 0) return fail_io(w, path, "cannot be made");
  for (uint64_t done = 0; done < text->size;) {
    const int64_t written = btfi_sys_write(fd, text->data + done, text->size - done, done);
    if (written == 0) errno = ENOSPC;
    if (written <= 0) {
      const btf_status status = fail_io(w, path, "cannot be written");
      close(fd);
      return status;
    }
    done += (uint64_t)written;
  }
  return sync_and_close(w, path, fd);
}

static btf_status write_manifest(btf_dataset_writer *w) {
  btfi_buffer text;
  char *path = NULL;
  btfi_buffer_init(&text, w->ctx);
  btfi_manifest_put(&text, &w->desc, w->order, SAMPLES_FILE, w->texts, w->text_count);
  btf_status status = text.status;
  if (status == BTF_OK) status = btfi_path_join(w->ctx, w->temporary, BTFI_MANIFEST_FILE, &path);
  if (status == BTF_OK) status = write_file(w, path, &text);
  btfi_free(w->ctx, path);
  btfi_buffer_free(&text);
  return status;
}

static btf_status finish(btf_dataset_writer *w) {
  BTFI_TRY(check_complete(w));
  BTFI_TRY(btfi_stage_flush(w));
  const int fd = w->fd;
  w->fd = -1;
  BTFI_TRY(sync_and_close(w, w->samples_path, fd));
  BTFI_TRY(write_manifest(w));
  const int folder = btfi_sys_open(AT_FDCWD, w->temporary, O_RDONLY | O_DIRECTORY, 0);
  if (folder < 0) return fail_io(w, w->temporary, "cannot be opened");
  BTFI_TRY(sync_and_close(w, w->temporary, folder));
  return btfi_folder_place(w->ctx, &folder_kind, w->temporary, w->path);
}

btf_status btf_dataset_writer_finish(btf_dataset_writer *w) {
  if (!w) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_dataset_writer_finish: the writer must not be NULL");
  const btf_status status = finish(w);
  if (status != BTF_OK)
    btf_dataset_writer_abort(w);
  else
    free_writer(w);
  return status;
}
