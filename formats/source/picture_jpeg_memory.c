/* SPDX-License-Identifier: MIT */
/* picture_jpeg_memory.c: libjpeg's methods for memory over the host's. Its own take malloc and set all
 * coefficients of a picture with several scans to zero by its head alone. */
#include "picture_jpeg_memory.h"

#include <jerror.h>

struct jpeg_block {
  jpeg_block *next;
  uint64_t size;
};
enum { ALIGNMENT = 64 }; /* of the host's memory; vector code asks for 32 */
_Static_assert(sizeof(jpeg_block) <= ALIGNMENT, "the head of a block fits before its bytes");

/* Coefficients of a whole component, rows of blocks. */
struct jvirt_barray_control {
  struct jvirt_barray_control *next;
  JBLOCKARRAY rows; /* NULL until realized */
  JDIMENSION width, height;
  JDIMENSION defined; /* rows that have been set */
};

static jpeg_memory *memory_of(j_common_ptr info) {
  return info->client_data;
}

static void *take(j_common_ptr info, int pool, uint64_t count, uint64_t size) {
  jpeg_memory *memory = memory_of(info);
  const uint64_t most = (uint64_t)JPEG_MOST_MIB << 20;
  uint64_t bytes;
  jpeg_block *block = NULL;
  if (pool < 0 || pool >= JPOOL_NUMPOOLS) ERREXIT1(info, JERR_BAD_POOL_ID, pool);
  memory->over = __builtin_mul_overflow(count, size, &bytes) || bytes > most - memory->used;
  if (!memory->over) block = (memory->host->alloc)(memory->ctx, bytes + ALIGNMENT, 1);
  if (block == NULL) ERREXIT1(info, JERR_OUT_OF_MEMORY, 0);
  *block = (jpeg_block){memory->pools[pool], bytes};
  memory->pools[pool] = block;
  memory->used += bytes;
  return (char *)block + ALIGNMENT;
}

static void *alloc_object(j_common_ptr info, int pool, size_t size) {
  return take(info, pool, 1, size);
}

/* Rows of `width` bytes, each aligned. Vector code runs over the end of a row by less than two alignments. */
static void **take_rows(j_common_ptr info, int pool, uint64_t width, JDIMENSION height) {
  const uint64_t stride = (width + 2 * ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
  void **rows = take(info, pool, height, sizeof *rows);
  char *data = take(info, pool, height, stride);
  for (JDIMENSION i = 0; i < height; i++) rows[i] = data + i * stride;
  return rows;
}

static JSAMPARRAY alloc_samples(j_common_ptr info, int pool, JDIMENSION width, JDIMENSION height) {
  return (JSAMPARRAY)take_rows(info, pool, (uint64_t)width * sizeof(JSAMPLE), height);
}

static JBLOCKARRAY alloc_coefficients(j_common_ptr info, int pool, JDIMENSION width, JDIMENSION height) {
  return (JBLOCKARRAY)take_rows(info, pool, (uint64_t)width * sizeof(JBLOCK), height);
}

/* ---- coefficients of whole pictures ---- */

/* Decoders hold samples of a whole picture only to choose a palette. */
static jvirt_sarray_ptr request_samples(j_common_ptr info, int pool, boolean zero, JDIMENSION width,
                                        JDIMENSION height, JDIMENSION most_rows) {
  (void)pool, (void)zero, (void)width, (void)height, (void)most_rows;
  ERREXIT(info, JERR_NOT_COMPILED);
  return NULL;
}

static JSAMPARRAY access_samples(j_common_ptr info, jvirt_sarray_ptr array, JDIMENSION row, JDIMENSION rows,
                                 boolean writable) {
  (void)array, (void)row, (void)rows, (void)writable;
  ERREXIT(info, JERR_NOT_COMPILED);
  return NULL;
}

static jvirt_barray_ptr request_coefficients(j_common_ptr info, int pool, boolean zero, JDIMENSION width,
                                             JDIMENSION height, JDIMENSION most_rows) {
  jpeg_memory *memory = memory_of(info);
  (void)zero, (void)most_rows;
  if (pool != JPOOL_IMAGE) ERREXIT1(info, JERR_BAD_POOL_ID, pool);
  jvirt_barray_ptr array = take(info, pool, 1, sizeof *array);
  *array = (struct jvirt_barray_control){.next = memory->arrays, .width = width, .height = height};
  memory->arrays = array;
  return array;
}

static void realize(j_common_ptr info) {
  for (jvirt_barray_ptr array = memory_of(info)->arrays; array != NULL; array = array->next)
    if (array->rows == NULL) array->rows = alloc_coefficients(info, JPOOL_IMAGE, array->width, array->height);
}

/* Rows become zero when the data reaches them, so that a picture that ends early takes little memory. */
static JBLOCKARRAY access_coefficients(j_common_ptr info, jvirt_barray_ptr array, JDIMENSION row,
                                       JDIMENSION rows, boolean writable) {
  (void)writable;
  if (array->rows == NULL || row > array->height || rows > array->height - row)
    ERREXIT(info, JERR_BAD_VIRTUAL_ACCESS);
  for (; array->defined < row + rows; array->defined++)
    memset(array->rows[array->defined], 0, array->width * sizeof(JBLOCK));
  return array->rows + row;
}

/* ---- the end ---- */

static void drop_pool(jpeg_memory *memory, int pool) {
  for (jpeg_block *block = memory->pools[pool], *next; block != NULL; block = next) {
    next = block->next;
    memory->used -= block->size;
    (memory->host->free)(memory->ctx, block);
  }
  memory->pools[pool] = NULL;
  if (pool == JPOOL_IMAGE) memory->arrays = NULL;
}

static void free_pool(j_common_ptr info, int pool) {
  if (pool >= 0 && pool < JPOOL_NUMPOOLS) drop_pool(memory_of(info), pool);
  memory_of(info)->free_pool(info, pool);
}

static void self_destruct(j_common_ptr info) {
  for (int pool = JPOOL_NUMPOOLS; pool-- > 0;) drop_pool(memory_of(info), pool);
  memory_of(info)->self_destruct(info);
}

void jpeg_memory_use(struct jpeg_decompress_struct *info, jpeg_memory *memory) {
  struct jpeg_memory_mgr *methods = info->mem;
  memory->free_pool = methods->free_pool;
  memory->self_destruct = methods->self_destruct;
  methods->alloc_small = methods->alloc_large = alloc_object;
  methods->alloc_sarray = alloc_samples;
  methods->alloc_barray = alloc_coefficients;
  methods->request_virt_sarray = request_samples;
  methods->request_virt_barray = request_coefficients;
  methods->realize_virt_arrays = realize;
  methods->access_virt_sarray = access_samples;
  methods->access_virt_barray = access_coefficients;
  methods->free_pool = free_pool;
  methods->self_destruct = self_destruct;
}
