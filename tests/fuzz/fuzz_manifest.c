/* SPDX-License-Identifier: MIT */
/* The manifest of a data-set folder: any bytes are refused with one line that names the file, or read into
 * values within their ranges, which come back the same when they are written and read again. Around a
 * manifest of few samples a folder is made, which opens when its samples are as many as it says; they are
 * read and evaluated as they stand. An input is a manifest and, behind a NUL, the first bytes of the samples.
 */
#include "fuzz.h"

#include "dataset/manifest.h"

#include <ftw.h>
#include <math.h>
#include <sys/stat.h>
#include <unistd.h>

static void expect_directions(const btf_dirset *set) {
  const uint32_t count = btf_dirset_count(set);
  fuzz_expect(count >= 1);
  for (uint32_t i = 0; i < count; ++i) {
    const float *d = btf_dirset_directions(set) + 3 * (size_t)i;
    fuzz_expect(d[2] > 0.0f &&
                fabs((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2] - 1.0) < 3e-5);
  }
}

static void expect_ranges(const btfi_manifest *m) {
  fuzz_expect(m->width >= 1 && m->width <= 65536 && m->height >= 1 && m->height <= 65536);
  fuzz_expect(m->channels >= 1 && m->channels <= 64);
  for (uint32_t c = 0; c < m->channels; ++c) fuzz_expect(m->channel_names[c] != NULL);
  fuzz_expect(btfi_sample_size(m->sample_type) > 0);
  fuzz_expect(m->order == BTF_ORDER_VLYXC || m->order == BTF_ORDER_YXVLC);
  fuzz_expect(m->quantity == BTF_QUANTITY_BRDF || m->quantity == BTF_QUANTITY_BRDF_COS);
  fuzz_expect(m->scale <= BTF_SCALE_ABSOLUTE && m->wrap <= BTF_WRAP_CLAMP);
  fuzz_expect(m->texels_per_mm >= 0.0 && m->texels_per_mm <= 1e12);
  fuzz_expect(m->samples[0] != '\0' && !strchr(m->samples, '/') && strcmp(m->samples, "..") != 0);
  expect_directions(m->views);
  expect_directions(m->lights);
  const double bytes = (double)btf_dirset_count(m->views) * btf_dirset_count(m->lights) * m->width *
                       m->height * m->channels * btfi_sample_size(m->sample_type);
  fuzz_expect(fabs((double)m->bytes - bytes) <= bytes * 1e-9);
}

static void expect_text(const char *a, const char *b) {
  fuzz_expect((a == NULL) == (b == NULL));
  if (a) fuzz_expect(strcmp(a, b) == 0);
}

static void expect_same_again(btf_context *ctx, const btfi_manifest *m) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btfi_manifest again;
  btfi_buffer text;
  desc.lights = m->lights;
  desc.views = m->views;
  desc.width = m->width;
  desc.height = m->height;
  desc.channels = m->channels;
  desc.sample_type = m->sample_type;
  desc.quantity = m->quantity;
  desc.scale = m->scale;
  desc.wrap = m->wrap;
  desc.channel_names = m->channel_names;
  desc.color_space = m->color_space;
  desc.name = m->name;
  desc.source = m->source;
  desc.license = m->license;
  desc.texels_per_mm = m->texels_per_mm;
  btfi_buffer_init(&text, ctx);
  btfi_manifest_put(&text, &desc, m->order, m->samples, NULL, 0);
  fuzz_expect(btfi_buffer_status(&text) == BTF_OK);
  const btf_status status = btfi_manifest_parse(ctx, "copy", (const char *)text.data, text.size, &again);
  fuzz_expect(status == BTF_OK);
  fuzz_expect(again.width == m->width && again.height == m->height && again.channels == m->channels);
  fuzz_expect(again.sample_type == m->sample_type && again.order == m->order &&
              again.quantity == m->quantity);
  fuzz_expect(again.scale == m->scale && again.wrap == m->wrap && again.bytes == m->bytes);
  fuzz_expect(fabs(again.texels_per_mm - m->texels_per_mm) <= 1e-8 * m->texels_per_mm);
  for (uint32_t c = 0; c < m->channels; ++c) expect_text(again.channel_names[c], m->channel_names[c]);
  expect_text(again.name, m->name);
  expect_text(again.source, m->source);
  expect_text(again.license, m->license);
  expect_text(again.samples, m->samples);
  if (m->color_space && m->color_space[0]) expect_text(again.color_space, m->color_space);
  btfi_manifest_free(&again);
  btfi_buffer_free(&text);
}

/* ---- a folder around it ---- */

static char folder[64];

static int remove_entry(const char *path, const struct stat *entry, int kind, struct FTW *walk) {
  (void)entry;
  (void)kind;
  (void)walk;
  return remove(path);
}

static void remove_folder(void) {
  nftw(folder, remove_entry, 8, FTW_DEPTH | FTW_PHYS);
}

static void write_file(const char *path, const void *data, size_t size) {
  FILE *file = fopen(path, "wb");
  fuzz_expect(file && fwrite(data, 1, size, file) == size && fclose(file) == 0);
}

enum { MOST_SAMPLE_BYTES = 1 << 14 };

/* Samples are finite numbers or the block is refused. */
static void expect_samples(const btf_dataset *ds, const btfi_manifest *m) {
  const btf_block all = {0,        btf_dirset_count(m->views), 0, btf_dirset_count(m->lights), 0, 0, m->width,
                         m->height};
  const size_t channels = m->channels, pixels = (size_t)m->width * m->height;
  const btf_strides strides = {(ptrdiff_t)(4 * channels * pixels * all.lights),
                               (ptrdiff_t)(4 * channels * pixels), (ptrdiff_t)(4 * channels * m->width),
                               (ptrdiff_t)(4 * channels), 4};
  const size_t count = channels * pixels * all.lights * all.views;
  float *values = malloc(count * sizeof *values); /* exactly so many: a sanitizer sees a write past the end */
  fuzz_expect(values != NULL);
  const btf_status status = btf_dataset_read(ds, &all, values, &strides);
  fuzz_expect(status == BTF_OK || status == BTF_E_CORRUPT);
  for (size_t i = 0; i < count && status == BTF_OK; i++) fuzz_expect(isfinite(values[i]));
  const size_t abrdf = channels * all.lights * all.views;
  const btf_status texel = btf_dataset_read_abrdf(ds, m->width - 1, m->height - 1, 1, values);
  fuzz_expect(texel == BTF_OK || (texel == BTF_E_CORRUPT && status != BTF_OK));
  for (size_t i = 0; i < abrdf && texel == BTF_OK; i++) fuzz_expect(isfinite(values[i]));
  free(values);
}

static void expect_evaluation(const btf_dataset *ds, const btfi_manifest *m) {
  static const btf_query queries[] = {
      {{0.0f, 0.6f, 0.8f}, {0.6f, 0.0f, 0.8f}, {0.3f, 0.7f}, 0.0f, 0},
      {{0.0f, 0.0f, 1.0f}, {0.99f, 0.0f, 0.01f}, {-7.1f, 1e9f}, 2.5f, 0},
      {{-0.5f, 0.5f, 0.7f}, {0.1f, 0.9f, 0.4f}, {0.999f, 0.001f}, 40.0f, BTF_QUERY_NEAREST},
      {{NAN, 0.0f, 1.0f}, {0.0f, 0.0f, INFINITY}, {INFINITY, 0.5f}, NAN, 0},
  };
  btf_model *model;
  float out[64];
  const btf_status status = btf_model_from_dataset(ds, NULL, &model);
  fuzz_expect(status == BTF_OK || status == BTF_E_CORRUPT);
  if (status != BTF_OK) return;
  for (size_t i = 0; i < sizeof queries / sizeof *queries; i++) {
    btf_model_eval(model, &queries[i], out);
    for (uint32_t c = 0; c < m->channels; c++) fuzz_expect(isfinite(out[c]));
  }
  btf_model_texel(model, 0, m->width - 1, m->height - 1, btf_dirset_count(m->lights) - 1,
                  btf_dirset_count(m->views) - 1, out);
  for (uint32_t c = 0; c < m->channels; c++) fuzz_expect(isfinite(out[c]));
  btf_model_release(model);
}

static void expect_folder(btf_context *ctx, const btfi_manifest *m, const uint8_t *text, size_t text_size,
                          const uint8_t *tail, size_t tail_size) {
  static uint8_t samples[MOST_SAMPLE_BYTES + 1];
  char path[512];
  btf_dataset *ds = NULL;
  if (m->bytes > MOST_SAMPLE_BYTES || strlen(m->samples) > 255) return; /* no longer names exist anywhere */
  if (!folder[0]) {
    strcpy(folder, "/tmp/btf-fuzz-XXXXXX");
    fuzz_expect(mkdtemp(folder) != NULL);
    atexit(remove_folder);
  }
  memset(samples, 0, sizeof samples);
  if (tail_size > 0) memcpy(samples, tail, tail_size < sizeof samples ? tail_size : sizeof samples);
  snprintf(path, sizeof path, "%s/manifest.json", folder);
  write_file(path, text, text_size);
  snprintf(path, sizeof path, "%s/%s", folder, m->samples);
  for (int more = -1; more < 2; more++) {
    write_file(path, samples, (size_t)((int64_t)m->bytes + more));
    const btf_status status = btf_dataset_open(ctx, folder, &ds);
    fuzz_expect(status == (more < 0 ? BTF_E_TRUNCATED : more > 0 ? BTF_E_CORRUPT : BTF_OK));
    if (more != 0) continue;
    expect_samples(ds, m);
    expect_evaluation(ds, m);
    btf_dataset_release(ds);
  }
  unlink(path);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  btf_context *ctx = fuzz_context((uint64_t)256 << 20);
  btfi_manifest manifest;
  uint64_t before, now;
  const uint8_t *end = size > 0 ? memchr(data, 0, size) : NULL;
  const size_t text = end ? (size_t)(end - data) : size;
  btf_context_memory(ctx, &before, NULL);
  const btf_status status = btfi_manifest_parse(ctx, "input", (const char *)data, text, &manifest);
  if (status == BTF_OK) {
    expect_ranges(&manifest);
    expect_same_again(ctx, &manifest);
    expect_folder(ctx, &manifest, data, text, end ? end + 1 : data, end ? size - text - 1 : 0);
    btfi_manifest_free(&manifest);
  } else {
    fuzz_expect(status == BTF_E_CORRUPT || status == BTF_E_NOT_BTF || status == BTF_E_NEWER ||
                status == BTF_E_LIMIT);
    fuzz_expect(strncmp(btf_error_message(), "input: ", 7) == 0 || status == BTF_E_LIMIT);
    fuzz_expect(!strchr(btf_error_message(), '\n'));
  }
  btf_context_memory(ctx, &now, NULL);
  fuzz_expect(now == before);
  btf_context_release(ctx);
  return 0;
}
