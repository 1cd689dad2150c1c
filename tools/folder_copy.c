/* SPDX-License-Identifier: MIT */
#include "folder_copy.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "sample_walk.h"

enum { MESSAGE_BYTES = 512 };

typedef struct copying {
  btf_dataset_writer *writer;
  const sample_source *source;
  atomic_flag failed;
  btf_status status; /* of the thread that took the flag */
  char message[MESSAGE_BYTES];
} copying;

static void put_block(void *user, const sample_visit *visit) {
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
  const btf_status status = btf_dataset_writer_put(copy->writer, &block, visit->a, &strides);
  if (status == BTF_OK || atomic_flag_test_and_set(&copy->failed)) return;
  copy->status = status;
  snprintf(copy->message, sizeof copy->message, "%s", btf_error_message());
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

int folder_copy(cli *c, input *in, const char *path, uint32_t sample_type) {
  sample_source source;
  copying copy = {.source = &source, .failed = ATOMIC_FLAG_INIT};
  const sample_walk walk = {.a = &source, .visit = put_block, .user = &copy, .stage = "copying", .to = 1};
  int failed = sample_source_open(in, &source);
  if (failed) return failed;
  btf_status status = start(c, in, path, sample_type, &copy.writer);
  if (status == BTF_OK) {
    failed = sample_walk_run(c, &walk);
    if (!failed && copy.status != BTF_OK) failed = cli_fail(cli_exit_of(copy.status), "%s", copy.message);
    if (!failed) {
      status = btf_dataset_writer_finish(copy.writer);
      copy.writer = NULL;
    }
  }
  cli_progress_done(c);
  if (status != BTF_OK) failed = cli_fail_library(status);
  btf_dataset_writer_abort(copy.writer);
  return failed;
}

int folder_copy_type(const cli *c, uint32_t *sample_type) {
  static const char *const words[] = {"u8", "u16", "f16", "f32", NULL};
  static const uint32_t types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_U16, BTF_SAMPLE_F16, BTF_SAMPLE_F32};
  int type = 2;
  const int failed = cli_choice(c, "type", words, &type);
  *sample_type = types[type];
  return failed;
}
