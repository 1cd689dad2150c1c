/* SPDX-License-Identifier: MIT */
/* format_open.c: which format a path is of, and opening it. */
#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "registry/codec.h"

enum { HEAD_BYTES = 4096 };

static btf_status fail_system(btf_context *ctx, const char *path) {
  return btfi_fail(ctx, BTF_E_IO, "%s: could not be opened: %s", path, strerror(errno));
}

/* The beginning of a file; what is neither file nor folder has none. */
static btf_status look(btf_context *ctx, const char *path, unsigned char head[HEAD_BYTES], btf_probe *probe) {
  struct stat info;
  *probe = (btf_probe){.path = path};
  if (stat(path, &info) != 0) return fail_system(ctx, path);
  probe->is_folder = S_ISDIR(info.st_mode);
  if (probe->is_folder) return BTF_OK;
  if (!S_ISREG(info.st_mode))
    return btfi_fail(ctx, BTF_E_UNSUPPORTED, "%s: is neither a regular file nor a folder", path);
  const int file = open(path, O_RDONLY | O_CLOEXEC);
  if (file < 0) return fail_system(ctx, path);
  ssize_t got = 0;
  while (probe->head_size < HEAD_BYTES) {
    got = read(file, head + probe->head_size, HEAD_BYTES - probe->head_size);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) break;
    probe->head_size += (uint32_t)got;
  }
  const btf_status status = got < 0 ? fail_system(ctx, path) : BTF_OK;
  close(file);
  probe->head = head;
  probe->size = (uint64_t)info.st_size;
  return status;
}

btf_status btf_format_detect(btf_context *ctx, const char *path, const btf_format **out) {
  unsigned char head[HEAD_BYTES];
  btf_probe probe;
  uint32_t most = 0;
  if (out != NULL) *out = NULL;
  if (ctx == NULL || path == NULL || out == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_format_detect: context, path and out must not be NULL");
  BTFI_TRY(look(ctx, path, head, &probe));
  for (uint32_t i = 0; i < btf_format_count(ctx); i++) {
    const btf_format *format = btf_format_at(ctx, i);
    const uint32_t sure = format->vtbl.probe(btfi_host(), ctx, &probe);
    if (sure <= most) continue;
    most = sure;
    *out = format;
  }
  if (*out != NULL) return BTF_OK;
  return btfi_fail(ctx, BTF_E_NOT_BTF, "%s: none of the formats known here", path);
}

btf_status btf_format_open(btf_context *ctx, const char *path, const btf_format *format,
                           const btf_options *options, btf_dataset **out) {
  btf_options *defaults = NULL;
  if (out != NULL) *out = NULL;
  if (ctx == NULL || path == NULL || out == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_format_open: context, path and out must not be NULL");
  if (format == NULL) BTFI_TRY(btf_format_detect(ctx, path, &format));
  if (format->ctx != ctx)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the format is of another context", format->vtbl.id);
  if (options != NULL && !btfi_options_are_of_params(options, &format->params))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the options are those of %s", format->vtbl.id,
                     btfi_options_owner(options));
  if (options == NULL) {
    BTFI_TRY(btf_format_options_create(format, &defaults));
    options = defaults;
  }
  const btf_status status = btfi_format_open_with(format, path, options, out);
  btf_options_release(defaults);
  return status;
}

/* ---- the data-set folder ---- */

static uint32_t probe_folder(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  char manifest[4096];
  (void)host, (void)ctx;
  if (!probe->is_folder || strlen(probe->path) + sizeof "/manifest.json" > sizeof manifest) return 0;
  strcpy(manifest, probe->path);
  strcat(manifest, "/manifest.json");
  return access(manifest, F_OK) == 0 ? 90 : 0;
}

static btf_status open_folder(const btf_host *host, btf_context *ctx, const char *path,
                              const btf_options *options, btf_dataset **out) {
  (void)host, (void)options;
  return btf_dataset_open(ctx, path, out);
}

const btf_format_vtbl btfi_format_folder = {.struct_size = sizeof(btf_format_vtbl),
                                            .abi = LIBBTF_ABI,
                                            .id = "folder",
                                            .title = "data-set folder of libbtf",
                                            .version = "1",
                                            .probe = probe_folder,
                                            .open = open_folder};
