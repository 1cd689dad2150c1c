/* SPDX-License-Identifier: MIT */
/* damage.c: pictures that are damaged or unlike the others leave the list, so that their pairs are filled as
 * missing ones are. For that every picture is decoded once. */
#include "bonn_images/bonn_images.h"

typedef struct damage_search {
  images_file *file;
  picture_info *infos;    /* of each entry, from its head; NULL when pictures are decoded */
  unsigned char *damaged; /* of each entry, whether */
  pthread_mutex_t mutex;
  /* under the mutex: the first entries that are damaged, and that failed otherwise */
  uint64_t first, failed;
  picture_fault damage, fault;
} damage_search;

static void note(damage_search *search, uint64_t i, const picture_fault *fault) {
  const bool is_damage = fault->status == BTF_E_CORRUPT || fault->status == BTF_E_TRUNCATED;
  pthread_mutex_lock(&search->mutex);
  uint64_t *of = is_damage ? &search->first : &search->failed;
  if (i < *of) {
    *of = i;
    *(is_damage ? &search->damage : &search->fault) = *fault;
  }
  pthread_mutex_unlock(&search->mutex);
  search->damaged[i] = 1;
}

static void search_run(void *user, uint32_t index, uint32_t thread) {
  damage_search *search = user;
  images_file *file = search->file;
  const image_list *list = &file->list;
  image_bytes bytes = {0};
  void *samples = NULL;
  picture_fault fault = {BTF_OK, ""};
  (void)thread;
  const uint64_t begin = (uint64_t)index * IMAGES_RUN,
                 end = list->count - begin < IMAGES_RUN ? list->count : begin + IMAGES_RUN;
  if (search->infos == NULL) {
    samples = (file->host->alloc)(file->ctx, images_sample_count(file), file->rules.sample_size);
    if (samples == NULL) {
      picture_fail(&fault, BTF_E_NOMEM, "not enough memory to decode it");
      note(search, begin, &fault);
      return;
    }
  }
  for (uint64_t i = begin; i < end; i++) {
    const btf_status status = search->infos != NULL
                                  ? images_look(file, &list->entries[i], &bytes, &search->infos[i], &fault)
                                  : images_decode(file, &list->entries[i], &bytes, samples, &fault);
    if (status != BTF_OK) note(search, i, &fault);
  }
  images_bytes_free(file, &bytes);
  (file->host->free)(file->ctx, samples);
}

/* Boyer and Moore's vote: if more than half of the whole heads are alike, the winner is one of them. */
static void vote(damage_search *search) {
  uint64_t lead = 0;
  for (uint64_t i = 0; i < search->file->list.count; i++) {
    if (search->damaged[i]) continue;
    if (lead == 0) search->file->info = search->infos[i];
    lead += picture_alike(&search->infos[i], &search->file->info) ? 1 : UINT64_MAX;
  }
}

static btf_status mark_unlike(damage_search *search) {
  images_file *file = search->file;
  uint64_t alike = 0, whole = 0;
  vote(search);
  for (uint64_t i = 0; i < file->list.count; i++) {
    picture_fault fault;
    if (search->damaged[i]) continue;
    whole++;
    if (images_compare(&search->infos[i], &file->info, "most", &fault) == BTF_OK)
      alike++;
    else
      note(search, i, &fault);
  }
  if (2 * alike > whole || whole == 0) return BTF_OK;
  return (file->host->fail)(
      file->ctx, BTF_E_CORRUPT,
      "%s: the images have several sizes or kinds, and no more than half of them have one", file->path);
}

/* Takes the damaged ones out of the list and says so. */
static btf_status leave_out(damage_search *search) {
  images_file *file = search->file;
  image_list *list = &file->list;
  uint64_t kept = 0;
  if (search->failed != UINT64_MAX)
    return (file->host->fail)(file->ctx, search->fault.status, "%s: %s: %s", file->path,
                              images_entry_name(file, &list->entries[search->failed]), search->fault.why);
  if (search->first == UINT64_MAX) return BTF_OK;
  const char *first = images_entry_name(file, &list->entries[search->first]);
  for (uint64_t i = 0; i < list->count; i++)
    if (!search->damaged[i]) list->entries[kept++] = list->entries[i];
  const uint64_t damaged = list->count - kept;
  list->count = kept;
  file->damaged += damaged;
  if (kept == 0)
    return (file->host->fail)(file->ctx, search->damage.status, "%s: all images are damaged; %s: %s",
                              file->path, first, search->damage.why);
  (file->host->log)(file->ctx, BTF_LOG_WARNING, "%s: %llu image%s damaged and count%s missing%s %s: %s",
                    file->path, (unsigned long long)damaged, damaged == 1 ? " is" : "s are",
                    damaged == 1 ? "s as" : " as", damaged == 1 ? "," : "; the first is", first,
                    search->damage.why);
  return BTF_OK;
}

static btf_status search_all(images_file *file, bool heads) {
  const uint64_t count = file->list.count;
  damage_search search = {.file = file, .first = UINT64_MAX, .failed = UINT64_MAX};
  search.damaged = (file->host->alloc)(file->ctx, count, 1);
  if (heads) search.infos = (file->host->alloc)(file->ctx, count, sizeof *search.infos);
  btf_status status = search.damaged != NULL && (!heads || search.infos != NULL) ? BTF_OK : BTF_E_NOMEM;
  if (status == BTF_OK) {
    memset(search.damaged, 0, count);
    pthread_mutex_init(&search.mutex, NULL);
    status = (file->host->parallel)(file->ctx, (uint32_t)((count + IMAGES_RUN - 1) / IMAGES_RUN), search_run,
                                    &search);
    if (heads && status == BTF_OK && search.failed == UINT64_MAX) status = mark_unlike(&search);
    pthread_mutex_destroy(&search.mutex);
  }
  if (status == BTF_OK) status = leave_out(&search);
  (file->host->free)(file->ctx, search.damaged);
  (file->host->free)(file->ctx, search.infos);
  return status;
}

btf_status images_leave_out_heads(images_file *file) {
  return search_all(file, true);
}

btf_status images_leave_out_damaged(images_file *file) {
  return search_all(file, false);
}
