/* SPDX-License-Identifier: MIT */
/* list.c: the pictures of a container, and closing it. */
#include <unistd.h>

#include "bonn_images/bonn_images.h"

/* Makes room for `more` behind `used`, at least doubling it. */
static btf_status grow(images_file *file, void **data, uint64_t used, uint64_t more, uint64_t *room,
                       uint64_t size) {
  if (more <= *room - used) return BTF_OK;
  const uint64_t wanted = used + more > 2 * *room ? used + more : 2 * *room;
  void *larger = (file->host->alloc)(file->ctx, wanted, size);
  if (larger == NULL) return BTF_E_NOMEM;
  if (used > 0) memcpy(larger, *data, used * size);
  (file->host->free)(file->ctx, *data);
  *data = larger;
  *room = wanted;
  return BTF_OK;
}

btf_status images_list_add(images_file *file, const char *name, const image_entry *entry) {
  image_list *list = &file->list;
  const size_t length = strlen(name) + 1;
  void *entries = list->entries, *text = list->text;
  btf_status status = grow(file, &entries, list->count, 1, &list->room, sizeof *entry);
  list->entries = entries;
  if (status == BTF_OK) status = grow(file, &text, list->text_used, length, &list->text_room, 1);
  list->text = text;
  if (status != BTF_OK) return status;
  memcpy(list->text + list->text_used, name, length);
  list->entries[list->count] = *entry;
  list->entries[list->count++].name = list->text_used;
  list->text_used += length;
  return BTF_OK;
}

const char *images_entry_name(const images_file *file, const image_entry *entry) {
  return file->list.text + entry->name;
}

void images_close(images_file *file) {
  const btf_host *host = file->host;
  btf_context *ctx = file->ctx;
  for (image_slot *slot = file->slots, *next; slot != NULL; slot = next) {
    next = slot->next;
    (host->free)(ctx, slot->samples);
    (host->free)(ctx, slot);
  }
  if (file->descriptor >= 0) close(file->descriptor);
  pthread_mutex_destroy(&file->mutex);
  pthread_cond_destroy(&file->decoded);
  (host->free)(ctx, file->list.entries);
  (host->free)(ctx, file->list.text);
  (host->free)(ctx, file->fills);
  (host->free)(ctx, file->table);
  (host->free)(ctx, file->path);
  (host->free)(ctx, file);
}
