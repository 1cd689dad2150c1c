/* SPDX-License-Identifier: MIT */
/* Key and value texts of a container. */
#include "container/format.h"

#include <stdio.h>
#include <string.h>

static int64_t position_of(const btfi_metadata *m, const char *key) {
  for (uint32_t i = 0; i < m->count; i++)
    if (strcmp(m->keys[i], key) == 0) return i;
  return -1;
}

const char *btfi_metadata_find(const btfi_metadata *m, const char *key) {
  const int64_t i = key != NULL ? position_of(m, key) : -1;
  return i >= 0 ? m->values[i] : NULL;
}

static btf_status grow(btfi_metadata *m) {
  const uint32_t capacity = m->capacity != 0 ? 2 * m->capacity : 8;
  char **keys = btfi_alloc(m->ctx, capacity, sizeof *keys), **values;
  if (keys == NULL) return btfi_alloc_status();
  values = btfi_alloc(m->ctx, capacity, sizeof *values);
  if (values == NULL) {
    btfi_free(m->ctx, keys);
    return btfi_alloc_status();
  }
  if (m->count != 0) {
    memcpy(keys, m->keys, m->count * sizeof *keys);
    memcpy(values, m->values, m->count * sizeof *values);
  }
  btfi_free(m->ctx, m->keys);
  btfi_free(m->ctx, m->values);
  m->keys = keys;
  m->values = values;
  m->capacity = capacity;
  return BTF_OK;
}

static btf_status check(const btfi_metadata *m, const char *key, uint64_t key_size, const char *value,
                        uint64_t value_size) {
  if (key_size == 0 || key_size > 255 || !btfi_text_valid(key, key_size))
    return btfi_fail(m->ctx, BTF_E_INVALID_ARG, "metadata: a key is 1 to 255 bytes of UTF-8 text");
  if (value_size > BTFI_METADATA_LIMIT / 2 || !btfi_text_valid(value, value_size))
    return btfi_fail(m->ctx, BTF_E_INVALID_ARG,
                     "metadata: the value of \"%s\" is not UTF-8 text of at most 8 MiB", key);
  return BTF_OK;
}

btf_status btfi_metadata_set(btfi_metadata *m, const char *key, const char *value) {
  int64_t at;
  char *copy;
  if (key == NULL || value == NULL)
    return btfi_fail(m->ctx, BTF_E_INVALID_ARG, "metadata: key and value must not be NULL");
  BTFI_TRY(check(m, key, strlen(key), value, strlen(value)));
  at = position_of(m, key);
  if (at < 0 && m->count == BTFI_METADATA_PAIRS)
    return btfi_fail(m->ctx, BTF_E_LIMIT, "metadata: a container holds at most %u pairs",
                     (unsigned)BTFI_METADATA_PAIRS);
  copy = btfi_strdup(m->ctx, value);
  if (copy == NULL) return btfi_alloc_status();
  if (at < 0) {
    btf_status status = m->count == m->capacity ? grow(m) : BTF_OK;
    char *name = status == BTF_OK ? btfi_strdup(m->ctx, key) : NULL;
    if (name == NULL) {
      if (status == BTF_OK) status = btfi_alloc_status();
      btfi_free(m->ctx, copy);
      return status;
    }
    at = m->count++;
    m->keys[at] = name;
  } else {
    btfi_free(m->ctx, m->values[at]);
  }
  m->values[at] = copy;
  return BTF_OK;
}

btf_status btfi_metadata_decode(btfi_metadata *m, const char *name, const void *data, uint64_t size) {
  btfi_cursor c = {data, size, 0, false};
  const uint32_t count = btfi_get_u32(&c);
  btf_status status = BTF_OK;
  if (count > BTFI_METADATA_PAIRS)
    return btfi_fail(m->ctx, BTF_E_LIMIT, "%s: %u metadata pairs; at most %u are read", name, (unsigned)count,
                     (unsigned)BTFI_METADATA_PAIRS);
  for (uint32_t i = 0; i < count && !c.overrun && status == BTF_OK; i++) {
    const uint32_t key_size = btfi_get_u32(&c), value_size = btfi_get_u32(&c);
    const char *key = btfi_get_bytes(&c, key_size), *value = btfi_get_bytes(&c, value_size);
    char *key_text, *value_text;
    if (c.overrun) break;
    if (key_size == 0 || key_size > 255 || !btfi_text_valid(key, key_size) ||
        !btfi_text_valid(value, value_size))
      return btfi_fail(m->ctx, BTF_E_CORRUPT, "%s: metadata pair %u is not valid text", name, (unsigned)i);
    key_text = btfi_alloc(m->ctx, (uint64_t)key_size + 1, 1);
    if (key_text == NULL) return btfi_alloc_status();
    value_text = btfi_alloc(m->ctx, (uint64_t)value_size + 1, 1);
    if (value_text == NULL) {
      btfi_free(m->ctx, key_text);
      return btfi_alloc_status();
    }
    memcpy(key_text, key, key_size);
    memcpy(value_text, value, value_size);
    key_text[key_size] = value_text[value_size] = '\0';
    if (position_of(m, key_text) >= 0)
      status = btfi_fail(m->ctx, BTF_E_CORRUPT, "%s: metadata key \"%s\" occurs twice", name, key_text);
    else if (m->count == m->capacity)
      status = grow(m);
    if (status == BTF_OK) {
      m->keys[m->count] = key_text;
      m->values[m->count++] = value_text;
    } else {
      btfi_free(m->ctx, key_text);
      btfi_free(m->ctx, value_text);
    }
  }
  if (status == BTF_OK && c.overrun)
    status = btfi_fail(m->ctx, BTF_E_CORRUPT, "%s: the metadata chunk ends within pair %u", name,
                       (unsigned)m->count);
  return status;
}

void btfi_metadata_encode(const btfi_metadata *m, btfi_buffer *out) {
  btfi_put_u32(out, m->count);
  for (uint32_t i = 0; i < m->count; i++) {
    const size_t key_size = strlen(m->keys[i]), value_size = strlen(m->values[i]);
    btfi_put_u32(out, (uint32_t)key_size);
    btfi_put_u32(out, (uint32_t)value_size);
    btfi_put_bytes(out, m->keys[i], key_size);
    btfi_put_bytes(out, m->values[i], value_size);
  }
}

void btfi_metadata_free(btfi_metadata *m) {
  for (uint32_t i = 0; i < m->count; i++) {
    btfi_free(m->ctx, m->keys[i]);
    btfi_free(m->ctx, m->values[i]);
  }
  btfi_free(m->ctx, m->keys);
  btfi_free(m->ctx, m->values);
  m->keys = m->values = NULL;
  m->count = m->capacity = 0;
}

static const char note_prefix[] = "btf.note.";

bool btfi_note_key_put(uint32_t model, const char *key, char out[256]) {
  const int length =
      model == 0 ? snprintf(out, 256, "%s", key) : snprintf(out, 256, "%s%u.%s", note_prefix, model, key);
  return length > 0 && length < 256;
}

uint32_t btfi_note_model_of(const char *key, const char **rest) {
  uint64_t model = 0;
  *rest = key;
  if (strncmp(key, note_prefix, sizeof note_prefix - 1) != 0) return 0;
  const char *p = key + sizeof note_prefix - 1;
  if (*p == '0') return 0;
  for (; *p >= '0' && *p <= '9' && model <= UINT32_MAX; p++) model = 10 * model + (uint64_t)(*p - '0');
  if (model == 0 || model > UINT32_MAX || *p != '.' || p[1] == '\0') return 0;
  *rest = p + 1;
  return (uint32_t)model;
}
