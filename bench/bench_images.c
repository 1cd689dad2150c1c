/* SPDX-License-Identifier: MIT */
/* bench_images: seconds to read all 81 x 81 JPEGs of an archive through the reader bonn-images, against
 * libjpeg alone decoding the same bytes from memory to rows of codes, on as many threads; and what opening
 * takes. Rounds of both are interleaved and the median of the ratios is printed, beside that of processor
 * time, which a busy machine disturbs less. The archive is made in the current folder and removed. Usage:
 * bench_images [SIDE [THREADS]] */
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <jpeglib.h>

#include <btf/btf_formats.h>

#include "bonn_images/images_case.h"

enum { ROUNDS = 5, MOST_THREADS = 64, QUALITY = 90 };
static const char archive[] = "bench_images.tmp.zip";

typedef struct jpeg_file {
  unsigned char *data;
  unsigned long size;
} jpeg_file;

typedef struct decoding {
  const jpeg_file *files;
  uint32_t side;
  atomic_uint next;
} decoding;

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int by_value(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* A woven pattern with noise, 4:2:0 as cameras write it. */
static jpeg_file make_jpeg(uint32_t pair, uint32_t side, unsigned char *codes) {
  struct jpeg_compress_struct jpeg;
  struct jpeg_error_mgr errors;
  jpeg_file out = {NULL, 0};
  uint32_t noise = pair;
  for (uint32_t y = 0; y < side; y++)
    for (uint32_t x = 0; x < side; x++) {
      noise = noise * 1664525u + 1013904223u;
      const double weave = 90 + 40 * sin(0.3 * x + 0.05 * (pair % 81)) * cos(0.2 * y + 0.04 * (pair / 81));
      for (uint32_t c = 0; c < 3; c++)
        codes[3 * ((size_t)y * side + x) + c] = (unsigned char)(weave + (noise >> 24) % 24 + 10 * c);
    }
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_compress(&jpeg);
  jpeg_mem_dest(&jpeg, &out.data, &out.size);
  jpeg.image_width = jpeg.image_height = side;
  jpeg.input_components = 3;
  jpeg.in_color_space = JCS_RGB;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, QUALITY, TRUE);
  jpeg_start_compress(&jpeg, TRUE);
  for (uint32_t row = 0; row < side; row++) {
    JSAMPROW line = codes + 3 * (size_t)row * side;
    (void)jpeg_write_scanlines(&jpeg, &line, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  return out;
}

static void *decode_some(void *user) {
  decoding *d = user;
  unsigned char *line = malloc(3 * (size_t)d->side);
  for (uint32_t i; line != NULL && (i = atomic_fetch_add(&d->next, 1)) < CASE_PAIRS;) {
    struct jpeg_decompress_struct jpeg;
    struct jpeg_error_mgr errors;
    JSAMPROW lines = line;
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_decompress(&jpeg);
    jpeg_mem_src(&jpeg, d->files[i].data, d->files[i].size);
    (void)jpeg_read_header(&jpeg, TRUE);
    (void)jpeg_start_decompress(&jpeg);
    while (jpeg.output_scanline < jpeg.output_height) (void)jpeg_read_scanlines(&jpeg, &lines, 1);
    (void)jpeg_finish_decompress(&jpeg);
    jpeg_destroy_decompress(&jpeg);
  }
  free(line);
  return NULL;
}

static double decode_alone(const jpeg_file *files, uint32_t side, uint32_t threads) {
  decoding d = {.files = files, .side = side};
  pthread_t ids[MOST_THREADS];
  const double start = now();
  for (uint32_t i = 0; i < threads; i++)
    if (pthread_create(&ids[i], NULL, decode_some, &d) != 0) abort();
  for (uint32_t i = 0; i < threads; i++) pthread_join(ids[i], NULL);
  return now() - start;
}

typedef struct reading {
  btf_dataset *ds;
  uint32_t side;
  atomic_uint next;
  atomic_bool failed;
} reading;

/* A picture at a time by every thread, as `btf import` does. */
static void *read_some(void *user) {
  reading *r = user;
  const ptrdiff_t y = 12 * (ptrdiff_t)r->side, light = y * (ptrdiff_t)r->side;
  const btf_strides strides = {.view = light, .light = light, .y = y, .x = 12, .channel = 4};
  float *samples = malloc((size_t)light);
  if (samples == NULL) atomic_store(&r->failed, true);
  for (uint32_t i; !atomic_load(&r->failed) && (i = atomic_fetch_add(&r->next, 1)) < CASE_PAIRS;) {
    const btf_block block = {i / CASE_DIRECTIONS, 1, i % CASE_DIRECTIONS, 1, 0, 0, r->side, r->side};
    if (btf_dataset_read(r->ds, &block, samples, &strides) == BTF_OK) continue;
    fprintf(stderr, "bench_images: %s\n", btf_error_message());
    atomic_store(&r->failed, true);
  }
  free(samples);
  return NULL;
}

static int read_all(uint32_t side, uint32_t threads, double *opening, double *seconds) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  reading r = {.side = side};
  pthread_t ids[MOST_THREADS];
  desc.max_threads = threads;
  btf_status status = btf_context_create(&desc, &ctx);
  if (status == BTF_OK) status = btf_formats_register(ctx);
  double start = now();
  if (status == BTF_OK) status = btf_format_open(ctx, archive, NULL, NULL, &r.ds);
  *opening = now() - start;
  if (status != BTF_OK) fprintf(stderr, "bench_images: %s\n", btf_error_message());
  atomic_store(&r.failed, status != BTF_OK);
  start = now();
  for (uint32_t i = 0; i < threads; i++)
    if (pthread_create(&ids[i], NULL, read_some, &r) != 0) abort();
  for (uint32_t i = 0; i < threads; i++) pthread_join(ids[i], NULL);
  *seconds = now() - start;
  btf_dataset_release(r.ds);
  btf_context_release(ctx);
  return atomic_load(&r.failed);
}

static int make_archive(jpeg_file *files, uint32_t side) {
  zip_writer zip = {.count = 0};
  unsigned char *codes = malloc(3 * (size_t)side * side);
  FILE *file = fopen(archive, "wb");
  if (codes == NULL || file == NULL) return 1;
  for (uint32_t pair = 0; pair < CASE_PAIRS; pair++) {
    char name[128];
    files[pair] = make_jpeg(pair, side, codes);
    case_name(CASE_UBO, "jpg", pair / CASE_DIRECTIONS, pair % CASE_DIRECTIONS, name);
    zip_add(&zip, &(zip_member){.name = name, .data = files[pair].data, .size = files[pair].size});
  }
  zip_end(&zip, false);
  const bool written = fwrite(zip.bytes.data, 1, zip.bytes.size, file) == zip.bytes.size;
  zip_free(&zip);
  free(codes);
  return fclose(file) == 0 && written ? 0 : 1;
}

int main(int argc, char **argv) {
  static jpeg_file files[CASE_PAIRS];
  const uint32_t side = argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 10) : 256;
  const uint32_t threads = argc > 2 ? (uint32_t)strtoul(argv[2], NULL, 10) : 2;
  double ratios[ROUNDS];
  if (side < 1 || side > 1024 || threads < 1 || threads > MOST_THREADS) {
    fprintf(stderr, "usage: bench_images [SIDE up to 1024 [THREADS up to %d]]\n", MOST_THREADS);
    return 2;
  }
  int failed = make_archive(files, side);
  for (int r = 0; r < ROUNDS && !failed; r++) {
    double opening, seconds;
    const clock_t begin = clock();
    const double alone = decode_alone(files, side, threads);
    const clock_t middle = clock();
    failed = read_all(side, threads, &opening, &seconds);
    ratios[r] = (opening + seconds) / alone;
    printf("libjpeg alone %.3f s, opening %.3f s, reading %.3f s, ratio %.3f; of processor time %.3f\n",
           alone, opening, seconds, ratios[r], (double)(clock() - middle) / (double)(middle - begin));
    fflush(stdout);
  }
  if (!failed) {
    qsort(ratios, ROUNDS, sizeof *ratios, by_value);
    printf("%u x %u, %u threads: median ratio %.3f (at most 1.3)\n", side, side, threads, ratios[ROUNDS / 2]);
  }
  for (uint32_t i = 0; i < CASE_PAIRS; i++) free(files[i].data);
  remove(archive);
  return failed;
}
