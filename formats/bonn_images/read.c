/* SPDX-License-Identifier: MIT */
/* read.c: blocks of samples. A picture is decoded whole; a few decoded ones are kept, for readers that take
 * it in parts or at once from several threads. */
#include <btf/btf_half.h>

#include "bonn_images/bonn_images.h"

enum { SLOTS_PER_THREAD = 2 };

static btf_status fail_read(const images_file *file, uint32_t pair, const picture_fault *fault) {
  return (file->host->source_error)(fault->status, "%s: %s: %s", file->path,
                                    images_entry_name(file, &file->list.entries[file->of_pair[pair]]),
                                    fault->why);
}

btf_status images_decode(const images_file *file, const image_entry *entry, image_bytes *bytes, void *samples,
                         picture_fault *fault) {
  BTF_TRY(images_fetch(file, entry, UINT64_MAX, bytes, fault));
  const source_file picture = {
      .host = file->host, .ctx = file->ctx, .data = bytes->data, .size = bytes->size};
  return picture_decode(&picture, &file->info, &file->rules, samples, fault);
}

static btf_status decode_entry(const images_file *file, uint32_t pair, image_bytes *bytes, void *samples) {
  picture_fault fault = {BTF_OK, ""};
  const image_entry *entry = &file->list.entries[file->of_pair[pair]];
  const btf_status status = images_decode(file, entry, bytes, samples, &fault);
  return status == BTF_OK ? BTF_OK : fail_read(file, pair, &fault);
}

static const image_fill *find_fill(const images_file *file, uint32_t pair) {
  uint32_t low = 0, high = file->fill_count;
  while (high - low > 1) {
    const uint32_t middle = low + (high - low) / 2;
    if (file->fills[middle].pair <= pair)
      low = middle;
    else
      high = middle;
  }
  return &file->fills[low];
}

static btf_status decode_fill(const images_file *file, uint32_t pair, image_bytes *bytes, void *samples) {
  const image_fill *fill = find_fill(file, pair);
  const uint64_t count = images_sample_count(file);
  const bool half = file->rules.sample_size == 2;
  float *sum = (file->host->alloc)(file->ctx, count, sizeof *sum);
  if (sum == NULL) return BTF_E_NOMEM;
  memset(sum, 0, count * sizeof *sum);
  btf_status status = BTF_OK;
  for (int k = 0; k < 3 && status == BTF_OK; k++) {
    if (!(fill->weight[k] > 0)) continue;
    status = decode_entry(file, fill->from[k], bytes, samples);
    for (uint64_t i = 0; i < count && status == BTF_OK; i++)
      sum[i] += fill->weight[k] *
                (half ? btf_half_to_float(((const uint16_t *)samples)[i]) : ((const float *)samples)[i]);
  }
  if (half)
    for (uint64_t i = 0; i < count; i++) ((uint16_t *)samples)[i] = btf_float_to_half(sum[i]);
  else
    memcpy(samples, sum, count * sizeof *sum);
  (file->host->free)(file->ctx, sum);
  return status;
}

static btf_status decode_pair(const images_file *file, uint32_t pair, void *samples) {
  image_bytes bytes = {0};
  const btf_status status = file->of_pair[pair] != images_none ? decode_entry(file, pair, &bytes, samples)
                                                               : decode_fill(file, pair, &bytes, samples);
  images_bytes_free(file, &bytes);
  return status;
}

/* ---- decoded pictures ---- */

static image_slot *find_slot(const images_file *file, uint32_t pair) {
  for (image_slot *slot = file->slots; slot != NULL; slot = slot->next)
    if (slot->pair == pair && (slot->ready || slot->decoding)) return slot;
  return NULL;
}

/* The one unused for longest; a new one while there are few or all are in use. NULL without memory. */
static image_slot *free_slot(images_file *file) {
  image_slot *oldest = NULL;
  for (image_slot *slot = file->slots; slot != NULL; slot = slot->next)
    if (slot->users == 0 && (oldest == NULL || slot->last_used < oldest->last_used)) oldest = slot;
  const uint32_t most = SLOTS_PER_THREAD * (file->host->thread_count)(file->ctx);
  if (oldest != NULL && (file->slot_count >= most || !oldest->ready)) return oldest;
  image_slot *slot = (file->host->alloc)(file->ctx, 1, sizeof *slot);
  void *samples = (file->host->alloc)(file->ctx, images_sample_count(file), file->rules.sample_size);
  if (slot == NULL || samples == NULL) {
    (file->host->free)(file->ctx, slot);
    (file->host->free)(file->ctx, samples);
    return NULL;
  }
  *slot = (image_slot){.next = file->slots, .samples = samples};
  file->slots = slot;
  file->slot_count++;
  return slot;
}

static void release_slot(images_file *file, image_slot *slot) {
  pthread_mutex_lock(&file->mutex);
  slot->users--;
  slot->last_used = ++file->clock;
  pthread_mutex_unlock(&file->mutex);
}

/* The decoded picture of a pair, held until release_slot. */
static btf_status take_slot(images_file *file, uint32_t pair, image_slot **out) {
  pthread_mutex_lock(&file->mutex);
  image_slot *slot;
  /* One thread decodes, the others wait; if it fails, they try and fail with a message of their own. */
  while ((slot = find_slot(file, pair)) != NULL && slot->decoding)
    pthread_cond_wait(&file->decoded, &file->mutex);
  if (slot != NULL) {
    slot->users++;
    pthread_mutex_unlock(&file->mutex);
    *out = slot;
    return BTF_OK;
  }
  slot = free_slot(file);
  if (slot != NULL) {
    slot->users = 1;
    slot->pair = pair;
    slot->ready = false;
    slot->decoding = true;
  }
  pthread_mutex_unlock(&file->mutex);
  if (slot == NULL) return BTF_E_NOMEM;
  const btf_status status = decode_pair(file, pair, slot->samples);
  pthread_mutex_lock(&file->mutex);
  slot->decoding = false;
  slot->ready = status == BTF_OK;
  pthread_cond_broadcast(&file->decoded);
  pthread_mutex_unlock(&file->mutex);
  if (status != BTF_OK) release_slot(file, slot);
  *out = slot;
  return status;
}

static void copy_picture(const images_file *file, const void *samples, const btf_block *block, char *dst,
                         const btf_strides *strides) {
  const size_t cell = file->rules.sample_size, texel = cell * file->info.channels;
  const bool dense = strides->x == (ptrdiff_t)texel && strides->channel == (ptrdiff_t)cell;
  for (uint32_t y = 0; y < block->height; y++) {
    const char *src =
        (const char *)samples + ((size_t)(block->y0 + y) * file->info.width + block->x0) * texel;
    char *row = dst + (ptrdiff_t)y * strides->y;
    if (dense) {
      memcpy(row, src, block->width * texel);
      continue;
    }
    for (uint32_t x = 0; x < block->width; x++)
      for (uint32_t c = 0; c < file->info.channels; c++)
        memcpy(row + (ptrdiff_t)x * strides->x + (ptrdiff_t)c * strides->channel, src + x * texel + c * cell,
               cell);
  }
}

/* Whether the block is of whole pictures that lie in dst as they are decoded. */
static bool takes_whole(const images_file *file, const btf_block *block, const btf_strides *strides) {
  const ptrdiff_t cell = (ptrdiff_t)file->rules.sample_size, texel = cell * (ptrdiff_t)file->info.channels;
  return block->x0 == 0 && block->y0 == 0 && block->width == file->info.width &&
         block->height == file->info.height && strides->channel == cell && strides->x == texel &&
         strides->y == texel * (ptrdiff_t)file->info.width;
}

btf_status images_read(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  images_file *file = user;
  const bool whole = takes_whole(file, block, strides);
  for (uint32_t v = 0; v < block->views; v++)
    for (uint32_t l = 0; l < block->lights; l++) {
      const uint32_t pair = (block->view0 + v) * IMAGES_DIRECTIONS + block->light0 + l;
      char *at = (char *)dst + (ptrdiff_t)v * strides->view + (ptrdiff_t)l * strides->light;
      image_slot *slot;
      if (whole) {
        BTF_TRY(decode_pair(file, pair, at));
        continue;
      }
      BTF_TRY(take_slot(file, pair, &slot));
      copy_picture(file, slot->samples, block, at, strides);
      release_slot(file, slot);
    }
  return BTF_OK;
}
