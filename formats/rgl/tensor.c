/* SPDX-License-Identifier: MIT */
/* tensor.c: the list of named arrays at the beginning of a tensor file. */
#include "rgl/rgl.h"

static const uint32_t type_sizes[] = {0, 1, 1, 2, 2, 4, 4, 8, 8, 2, 4, 8};

static uint32_t take_u16(cursor *c) {
  const uint32_t low = cursor_u8(c);
  return low | (uint32_t)cursor_u8(c) << 8;
}

static uint64_t take_u64(cursor *c) {
  const uint64_t low = cursor_u32(c);
  return low | (uint64_t)cursor_u32(c) << 32;
}

static bool same_name(const rgl_field *field, const void *name, size_t length) {
  return field->name_length == length && memcmp(field->name, name, length) == 0;
}

const rgl_field *rgl_find(const rgl_brdf *brdf, const char *name) {
  for (uint32_t i = 0; i < brdf->field_count; i++)
    if (same_name(&brdf->fields[i], name, strlen(name))) return &brdf->fields[i];
  return NULL;
}

static btf_status fail_field(const source_file *file, btf_status status, uint32_t i, const char *what) {
  return (file->host->fail)(file->ctx, status, "%s: field %u of the tensor file %s", file->path, i, what);
}

static btf_status read_field(rgl_brdf *brdf, cursor *c, uint32_t i) {
  const source_file *file = &brdf->base.file;
  rgl_field *field = &brdf->fields[i];
  field->name_length = take_u16(c);
  field->name = cursor_take(c, field->name_length, 1);
  field->rank = take_u16(c);
  field->type = cursor_u8(c);
  const uint64_t offset = take_u64(c);
  if (c->ended) return fail_field(file, BTF_E_TRUNCATED, i, "ends with the file");
  if (field->rank > RGL_MOST_RANK) return fail_field(file, BTF_E_CORRUPT, i, "has more than 8 dimensions");
  if (field->type == 0 || field->type >= sizeof type_sizes / sizeof *type_sizes)
    return fail_field(file, BTF_E_CORRUPT, i, "has an unknown type");
  for (uint32_t k = 0; k < i; k++)
    if (same_name(&brdf->fields[k], field->name, field->name_length))
      return fail_field(file, BTF_E_CORRUPT, i, "has the name of another");
  uint64_t bytes = type_sizes[field->type];
  field->elements = 1;
  for (uint32_t k = 0; k < field->rank; k++) {
    field->shape[k] = take_u64(c);
    if (__builtin_mul_overflow(field->elements, field->shape[k], &field->elements) ||
        __builtin_mul_overflow(bytes, field->shape[k], &bytes))
      return fail_field(file, BTF_E_CORRUPT, i, "is larger than any file");
  }
  if (c->ended) return fail_field(file, BTF_E_TRUNCATED, i, "ends with the file");
  if (offset > file->size || bytes > file->size - offset)
    return fail_field(file, BTF_E_TRUNCATED, i, "has data beyond the end of the file");
  field->data = file->data + offset;
  return BTF_OK;
}

btf_status rgl_read_fields(rgl_brdf *brdf) {
  const source_file *file = &brdf->base.file;
  cursor c = {.file = file};
  const unsigned char *signature = cursor_take(&c, 12, 1);
  if (signature == NULL || memcmp(signature, "tensor_file", 12) != 0)
    return (file->host->fail)(file->ctx, BTF_E_NOT_BTF, "%s: is not a tensor file", file->path);
  const uint32_t major = cursor_u8(&c), minor = cursor_u8(&c), count = cursor_u32(&c);
  if (c.ended)
    return (file->host->fail)(file->ctx, BTF_E_TRUNCATED, "%s: ends within its header", file->path);
  if (major != 1 || minor != 0)
    return (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED,
                              "%s: is a tensor file of version %u.%u; 1.0 is read", file->path, major, minor);
  if (count > RGL_MOST_FIELDS)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT, "%s: has %u fields; at most %d are read", file->path,
                              count, RGL_MOST_FIELDS);
  for (uint32_t i = 0; i < count; i++) {
    BTF_TRY(read_field(brdf, &c, i));
    brdf->field_count = i + 1;
  }
  return BTF_OK;
}
