/* SPDX-License-Identifier: MIT */
/* write.c: an export as a folder. */
#include "gpu/gpu.h"

#include <stdio.h>
#include <string.h>

#include "dataset/manifest.h"
#include "io/new_folder.h"

#define MANIFEST_FILE "manifest.json"
#define SHADER_FILE "btf.glsl"
#define PAGE_FILE "index.html"
enum { MOST_MANIFEST_BYTES = 4 << 20 };

static void put_name(btfi_buffer *files, const char *name, const char *ending) {
  btfi_put_bytes(files, name, strlen(name));
  btfi_put_bytes(files, ending, strlen(ending) + 1);
}

/* Names in a manifest that could lead out of the folder are nobody's textures. */
static bool is_texture_name(const char *name) {
  return name != NULL && strncmp(name, "btf_", 4) == 0 && strlen(name) < BTFI_GPU_NAME &&
         strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789_") == strlen(name);
}

static btf_status list_files(const btfi_json *manifest, btfi_buffer *files) {
  const char *format = btfi_json_string(btfi_json_get(manifest, "format"));
  const btfi_json *textures = btfi_json_get(manifest, "textures");
  if (format == NULL || strcmp(format, BTFI_EXPORT_FORMAT) != 0) return BTF_E_INVALID_ARG;
  put_name(files, MANIFEST_FILE, "");
  put_name(files, SHADER_FILE, "");
  /* A page that the manifest does not name is somebody else's. */
  if (btfi_json_get(manifest, "page") != NULL) put_name(files, PAGE_FILE, "");
  for (uint64_t i = 0; i < btfi_json_length(textures); i++) {
    const char *name = btfi_json_string(btfi_json_get(btfi_json_at(textures, i), "name"));
    if (is_texture_name(name)) put_name(files, name, ".ktx2");
  }
  return BTF_OK;
}

static btf_status find_files(btf_context *ctx, const btfi_folder_kind *kind, const char *path,
                             btfi_buffer *files) {
  (void)kind;
  char *file = NULL, *text = NULL;
  uint64_t size = 0;
  btfi_json *root = NULL;
  BTFI_TRY(btfi_path_join(ctx, path, MANIFEST_FILE, &file));
  btf_status status = btfi_read_file(ctx, file, MOST_MANIFEST_BYTES, &text, &size);
  if (status == BTF_OK) status = btfi_json_parse(ctx, file, text, size, &root);
  if (status == BTF_OK) status = list_files(root, files);
  btfi_json_free(root);
  btfi_free(ctx, text);
  btfi_free(ctx, file);
  return status;
}

static const btfi_folder_kind folder_kind = {"GPU export", find_files};

static btf_status write_textures(const btf_gpu_export *e, btf_new_folder *folder, int32_t zstd_level) {
  char name[BTFI_GPU_NAME + 8];
  for (uint32_t i = 0; i < e->built->texture_count; i++) {
    void *data;
    size_t size;
    snprintf(name, sizeof name, "%s.ktx2", e->built->texture[i].name);
    BTFI_TRY(btf_gpu_texture_ktx2(e, i, zstd_level, &data, &size));
    const btf_status status = btfi_new_folder_put(folder, name, data, size);
    btfi_free(e->ctx, data);
    if (status != BTF_OK) return status;
  }
  return BTF_OK;
}

/* The manifest, and in it the page's name where there is one. */
static btf_status write_manifest(const btf_gpu_export *e, btf_new_folder *folder, bool has_page) {
  static const char start[] = "{\n", page[] = "{\n  \"page\": \"" PAGE_FILE "\",\n";
  btfi_buffer text;
  if (!has_page) return btfi_new_folder_put(folder, MANIFEST_FILE, e->manifest, strlen(e->manifest));
  btfi_buffer_init(&text, e->ctx);
  btfi_put_bytes(&text, page, sizeof page - 1);
  btfi_put_bytes(&text, e->manifest + sizeof start - 1, strlen(e->manifest) - (sizeof start - 1));
  btf_status status = btfi_buffer_status(&text);
  if (status == BTF_OK) status = btfi_new_folder_put(folder, MANIFEST_FILE, text.data, text.size);
  btfi_buffer_free(&text);
  return status;
}

static btf_status write_all(const btf_gpu_export *e, btf_new_folder *folder, int32_t zstd_level,
                            const void *page, size_t page_size) {
  BTFI_TRY(write_textures(e, folder, zstd_level));
  BTFI_TRY(btfi_new_folder_put(folder, SHADER_FILE, e->glsl, strlen(e->glsl)));
  if (page != NULL) BTFI_TRY(btfi_new_folder_put(folder, PAGE_FILE, page, page_size));
  return write_manifest(e, folder, page != NULL);
}

btf_status btf_gpu_export_write_page(const btf_gpu_export *e, const char *path, int32_t zstd_level,
                                     const void *page, size_t page_size) {
  btf_new_folder *folder;
  if (e == NULL || path == NULL || zstd_level < 0 || zstd_level > 22)
    return btfi_fail(NULL, BTF_E_INVALID_ARG,
                     "btf_gpu_export_write: export and path must not be NULL, zstd level 0 to 22");
  BTFI_TRY(btfi_new_folder_begin_kind(e->ctx, path, &folder_kind, &folder));
  const btf_status status = write_all(e, folder, zstd_level, page, page_size);
  const btf_status placed = btfi_new_folder_end(folder, status != BTF_OK);
  return status != BTF_OK ? status : placed;
}

btf_status btf_gpu_export_write(const btf_gpu_export *e, const char *path, int32_t zstd_level) {
  return btf_gpu_export_write_page(e, path, zstd_level, NULL, 0);
}
