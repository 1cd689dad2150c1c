/* SPDX-License-Identifier: MIT */
/* heads.c: all pictures must be of one kind and size. Their first bytes say so, and are cheap to look at. */
#include "bonn_images/bonn_images.h"

enum {
  HEAD_BYTES = 4096,
  LONG_HEAD_BYTES = 256 << 10, /* a JPEG may have a colour profile and a preview in front */
  MOST_SIDE = 2048,            /* several are decoded at once */
  SPARE_BYTES = 1 << 20        /* what a picture may hold beside its pixels */
};

typedef struct head_check {
  images_file *file;
  pthread_mutex_t mutex;
  /* under the mutex: the first that failed */
  uint64_t failed;
  picture_fault fault;
} head_check;

btf_status images_look(const images_file *file, const image_entry *entry, image_bytes *bytes,
                       picture_info *info, picture_fault *fault) {
  bool complete = false;
  for (uint64_t most = HEAD_BYTES; !complete; most = LONG_HEAD_BYTES) {
    BTF_TRY(images_fetch(file, entry, most, bytes, fault));
    BTF_TRY(picture_look(bytes->data, bytes->size, info, &complete, fault));
    if (!complete && (bytes->size == entry->size || most == LONG_HEAD_BYTES))
      return picture_fail(fault, BTF_E_TRUNCATED, "ends, or goes on for %d bytes, before it says its size",
                          LONG_HEAD_BYTES);
  }
  if (info->width > MOST_SIDE || info->height > MOST_SIDE)
    return picture_fail(fault, BTF_E_LIMIT, "a picture of %u x %u; at most %d a side are read", info->width,
                        info->height, MOST_SIDE);
  /* Twice what the pixels take unpacked: coders that fail make data a little longer. */
  const uint64_t pixels = (uint64_t)info->width * info->height * info->channels * (info->depth / 8);
  if (entry->size > 2 * pixels + SPARE_BYTES)
    return picture_fail(fault, BTF_E_LIMIT, "has %llu bytes, more than a picture of %u x %u can need",
                        (unsigned long long)entry->size, info->width, info->height);
  return BTF_OK;
}

btf_status images_compare(const picture_info *info, const picture_info *wanted, const char *whose,
                          picture_fault *fault) {
  if (picture_alike(info, wanted)) return BTF_OK;
  const bool same_size = info->width == wanted->width && info->height == wanted->height;
  return picture_fail(fault, BTF_E_CORRUPT,
                      "is %s of %u x %u, %u channels of %u bits%s, unlike %.80s: %s of %u x %u, %u of %u",
                      picture_kind_name(info->kind), info->width, info->height, info->channels, info->depth,
                      same_size && info->by_columns != wanted->by_columns ? " by columns" : "", whose,
                      picture_kind_name(wanted->kind), wanted->width, wanted->height, wanted->channels,
                      wanted->depth);
}

static btf_status check_one(const images_file *file, const image_entry *entry, image_bytes *bytes,
                            picture_fault *fault) {
  picture_info info;
  BTF_TRY(images_look(file, entry, bytes, &info, fault));
  return images_compare(&info, &file->info, images_entry_name(file, &file->list.entries[0]), fault);
}

static void check_run(void *user, uint32_t index, uint32_t thread) {
  head_check *check = user;
  const image_list *list = &check->file->list;
  image_bytes bytes = {0};
  picture_fault fault = {BTF_OK, ""};
  (void)thread;
  uint64_t i = (uint64_t)index * IMAGES_RUN;
  const uint64_t end = list->count - i < IMAGES_RUN ? list->count : i + IMAGES_RUN;
  while (i < end && check_one(check->file, &list->entries[i], &bytes, &fault) == BTF_OK) i++;
  images_bytes_free(check->file, &bytes);
  if (i == end) return;
  pthread_mutex_lock(&check->mutex);
  if (i < check->failed) {
    check->failed = i;
    check->fault = fault;
  }
  pthread_mutex_unlock(&check->mutex);
}

btf_status images_check_heads(images_file *file) {
  const image_list *list = &file->list;
  head_check check = {.file = file, .failed = UINT64_MAX};
  image_bytes bytes = {0};
  btf_status status = images_look(file, &list->entries[0], &bytes, &file->info, &check.fault);
  images_bytes_free(file, &bytes);
  if (status != BTF_OK) {
    check.failed = 0;
  } else {
    pthread_mutex_init(&check.mutex, NULL);
    status = (file->host->parallel)(file->ctx, (uint32_t)((list->count + IMAGES_RUN - 1) / IMAGES_RUN),
                                    check_run, &check);
    pthread_mutex_destroy(&check.mutex);
  }
  if (check.failed == UINT64_MAX) return status;
  return (file->host->fail)(file->ctx, check.fault.status, "%s: %s: %s", file->path,
                            images_entry_name(file, &list->entries[check.failed]), check.fault.why);
}
