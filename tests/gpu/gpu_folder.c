/* SPDX-License-Identifier: MIT */
#include "gpu_folder.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../btf_test.h"
#include "base/base.h"

static unsigned char *read_file(const char *folder, const char *name, size_t *size) {
  char path[1024];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  return test_read_bytes(path, size);
}

static uint32_t whole(const btfi_json *object, const char *key) {
  return (uint32_t)btfi_json_number(btfi_json_get(object, key));
}

static bool is_word(const btfi_json *value, const char *word) {
  const char *text = btfi_json_string(value);
  return text != NULL && strcmp(text, word) == 0;
}

static uint32_t dimension_of(const btfi_json *entry) {
  const btfi_json *value = btfi_json_get(entry, "dimension");
  return is_word(value, "2d")         ? BTF_TEXTURE_2D
         : is_word(value, "3d")       ? BTF_TEXTURE_3D
         : is_word(value, "2d_array") ? BTF_TEXTURE_2D_ARRAY
                                      : 0;
}

static const char *read_texture(const char *folder, const btfi_json *entry, folder_texture *t) {
  const char *file = btfi_json_string(btfi_json_get(entry, "file"));
  const char *name = btfi_json_string(btfi_json_get(entry, "name"));
  const btfi_json *wrap = btfi_json_get(entry, "wrap");
  size_t size = 0;
  if (file == NULL || name == NULL || strlen(name) >= sizeof t->name) return "an entry without file or name";
  strcpy(t->name, name);
  t->dimension = dimension_of(entry);
  const bool is_3d = t->dimension == BTF_TEXTURE_3D, is_array = t->dimension == BTF_TEXTURE_2D_ARRAY;
  t->slices = is_3d ? whole(entry, "depth") : is_array ? whole(entry, "layers") : 1;
  t->binding = whole(entry, "binding");
  t->filtered = is_word(btfi_json_get(entry, "min_filter"), "linear");
  for (uint64_t k = 0; k < 2; k++) t->repeat[k] = is_word(btfi_json_at(wrap, k), "repeat");
  unsigned char *bytes = read_file(folder, file, &size);
  const char *wrong = ktx2_read(bytes, size, &t->file);
  free(bytes);
  if (wrong != NULL) return wrong;
  if (t->dimension == 0 || t->file.vk_format != whole(entry, "vk_format") ||
      t->file.width != whole(entry, "width") || t->file.height != whole(entry, "height") ||
      t->file.levels != whole(entry, "levels") || t->file.depth != (is_3d ? t->slices : 0) ||
      t->file.layers != (is_array ? t->slices : 0))
    return "manifest and texture disagree";
  return NULL;
}

/* The block from the values of the manifest, by their offsets: arrays have 16 bytes an element. */
static const char *read_block(const btfi_json *manifest, gpu_folder *f) {
  const btfi_json *fields = btfi_json_get(manifest, "uniforms");
  f->block_size = whole(btfi_json_get(manifest, "uniform_block"), "size");
  if (f->block_size > sizeof f->block) return "the block is too large";
  for (uint64_t i = 0; i < btfi_json_length(fields); i++) {
    const btfi_json *field = btfi_json_at(fields, i), *values = btfi_json_get(field, "value");
    const btfi_json *type = btfi_json_get(field, "type");
    const uint64_t count = whole(field, "count"), components = btfi_json_length(values) / (count ? count : 1);
    const bool integer = is_word(type, "int") || is_word(type, "ivec4");
    for (uint64_t k = 0; k < btfi_json_length(values); k++) {
      const uint64_t at = whole(field, "offset") + k / components * 16 + k % components * 4;
      const double value = btfi_json_number(btfi_json_at(values, k));
      const float real = (float)value;
      const int32_t number = (int32_t)value;
      if (at + 4 > f->block_size) return "a uniform lies outside of the block";
      memcpy(f->block + at, integer ? (const void *)&number : (const void *)&real, 4);
    }
  }
  return NULL;
}

static const char *read_manifest(const char *path, const btfi_json *manifest, gpu_folder *f) {
  const btfi_json *textures = btfi_json_get(manifest, "textures");
  const char *wrong = NULL;
  if (!is_word(btfi_json_get(manifest, "format"), "btf-gpu") || whole(manifest, "version") != 1)
    return "the manifest is of something else";
  if (btfi_json_length(textures) > FOLDER_MOST_TEXTURES) return "too many textures";
  f->texture_count = (uint32_t)btfi_json_length(textures);
  for (uint32_t i = 0; wrong == NULL && i < f->texture_count; i++)
    wrong = read_texture(path, btfi_json_at(textures, i), &f->textures[i]);
  return wrong != NULL ? wrong : read_block(manifest, f);
}

const char *gpu_folder_read(const char *path, gpu_folder *out) {
  size_t size = 0;
  btf_context *ctx;
  btfi_json *manifest = NULL;
  const char *wrong = "the manifest is not JSON";
  memset(out, 0, sizeof *out);
  unsigned char *glsl = read_file(path, "btf.glsl", &size);
  out->glsl = calloc(size + 1, 1);
  assert_non_null(out->glsl);
  memcpy(out->glsl, glsl, size);
  free(glsl);
  unsigned char *text = read_file(path, "manifest.json", &size);
  assert_ok(btf_context_create(NULL, &ctx));
  if (btfi_json_parse(ctx, path, (const char *)text, size, &manifest) == BTF_OK)
    wrong = read_manifest(path, manifest, out);
  btfi_json_free(manifest);
  btf_context_release(ctx);
  free(text);
  return wrong;
}

void gpu_folder_free(gpu_folder *f) {
  for (uint32_t i = 0; i < f->texture_count; i++) ktx2_free(&f->textures[i].file);
  free(f->glsl);
  memset(f, 0, sizeof *f);
}

void gpu_host_run(gpu_host *host, const btf_gpu_export *e, int32_t zstd_level, gpu_edit edit,
                  const void *user, const float *queries, size_t count, float *out) {
  static gpu_folder folder;
  const char *path = test_path("export");
  assert_ok(btf_gpu_export_write(e, path, zstd_level));
  const char *wrong = gpu_folder_read(path, &folder);
  if (wrong == NULL && edit != NULL) folder.glsl = edit(folder.glsl, user);
  if (wrong == NULL) wrong = host->load(host, &folder);
  if (wrong == NULL) wrong = host->eval(host, queries, count, out);
  gpu_folder_free(&folder);
  if (wrong != NULL) fail_msg("%s", wrong);
}
