/* SPDX-License-Identifier: MIT */
#include "folder_copy.h"

#include <inttypes.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "sample_walk.h"

typedef struct copying {
  btf_dataset_writer *writer;
  const sample_source *source;
  bool clips; /* the samples written are of 0..1 */
  atomic_uint_least64_t clipped;
} copying;

static uint64_t count_outside(const float *values, uint64_t count) {
  uint64_t outside = 0;
  for (uint64_t i = 0; i < count; i++) outside += values[i] < 0 || values[i] > 1;
  return outside;
}

static btf_status put_block(void *user, const sample_visit *visit) {
  copying *copy = user;
  const sample_source *s = copy->source;
  const btf_block block = {.view0 = visit->view,
                           .views = 1,
                           .light0 = visit->light0,
                           .lights = visit->lights,
                           .width = s->width,
                           .height = s->height};
  const ptrdiff_t x = (ptrdiff_t)(s->channels * sizeof(float)), y = x * (ptrdiff_t)s->width;
  const btf_strides strides = {.light = y * (ptrdiff_t)s->height, .y = y, .x = x, .channel = sizeof(float)};
  if (copy->clips)
    atomic_fetch_add(&copy->clipped, count_outside(visit->a, visit->image_values * visit->lights));
  return btf_dataset_writer_put(copy->writer, &block, visit->a, &strides);
}

/* A key that the manifest has for something else, which metadata of a container may bear, is left out. */
static btf_status put_text(btf_dataset_writer *writer, const char *key, const char *text) {
  const btf_status status = btf_dataset_writer_text(writer, key, text);
  return status == BTF_E_INVALID_ARG ? BTF_OK : status;
}

static btf_status start(cli *c, const input *in, const char *path, uint32_t sample_type,
                        btf_dataset_writer **out) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  char *command = cli_recorded_command(c);
  btf_status status = btf_dataset_describe(in->dataset, &desc);
  const char *const *notes = desc.notes;
  desc.sample_type = sample_type;
  if (status == BTF_OK) status = btf_dataset_writer_create(c->context, path, &desc, BTF_ORDER_VLYXC, out);
  for (uint32_t i = 0; status == BTF_OK && notes != NULL && notes[i] != NULL; i += 2)
    status = put_text(*out, notes[i], notes[i + 1]);
  if (status == BTF_OK && command != NULL) status = put_text(*out, "command", command);
  free(command);
  return status;
}

static void warn_of_clipped(cli *c, copying *copy, const char *path, uint32_t sample_type) {
  const sample_source *s = copy->source;
  const uint64_t clipped = atomic_load(&copy->clipped);
  const uint64_t values = sample_source_image_values(s) * s->lights * s->views;
  if (clipped == 0) return;
  cli_warn(c,
           "%s: %" PRIu64 " of %" PRIu64
           " values (%.3g %%) are below 0 or above 1, which %s does not hold, and were clipped",
           path, clipped, values, 100 * (double)clipped / (double)values, input_sample_type(sample_type));
}

int folder_copy(cli *c, input *in, const char *path, uint32_t sample_type) {
  sample_source source;
  copying copy = {.source = &source, .clips = sample_type == BTF_SAMPLE_U8 || sample_type == BTF_SAMPLE_U16};
  const sample_walk walk = {.a = &source, .visit = put_block, .user = &copy, .stage = "copying", .to = 1};
  int failed = sample_source_open(in, &source);
  if (failed) return failed;
  btf_status status = start(c, in, path, sample_type, &copy.writer);
  if (status == BTF_OK) {
    failed = sample_walk_run(c, &walk);
    if (!failed) {
      status = btf_dataset_writer_finish(copy.writer);
      copy.writer = NULL;
    }
  }
  cli_progress_done(c);
  if (status != BTF_OK) failed = cli_fail_library(status);
  btf_dataset_writer_abort(copy.writer);
  if (!failed) warn_of_clipped(c, &copy, path, sample_type);
  return failed;
}

int folder_copy_type(const cli *c, const input *in, bool keeps_floats, uint32_t *sample_type) {
  static const char *const words[] = {"u8", "u16", "f16", "f32", NULL};
  static const uint32_t types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_U16, BTF_SAMPLE_F16, BTF_SAMPLE_F32};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  int type = -1;
  const int failed = cli_choice(c, "type", words, &type);
  if (failed) return failed;
  const btf_status status = btf_dataset_describe(in->dataset, &desc);
  if (status != BTF_OK) return cli_fail_library(status);
  *sample_type = desc.sample_type == BTF_SAMPLE_F32 && !keeps_floats ? BTF_SAMPLE_F16 : desc.sample_type;
  if (type >= 0) *sample_type = types[type];
  return EXIT_DONE;
}
