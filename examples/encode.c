/* SPDX-License-Identifier: MIT */
/*
 * Compresses a data-set folder with a codec and options, and saves the result.
 *   example_encode wool.btfd wool.btfz fmf components=16
 */
#include <btf/btf.h>

#include <stdio.h>
#include <string.h>

static int32_t show_progress(void *user, double fraction, const char *stage) {
  (void)user;
  fprintf(stderr, "\r%3.0f %% %-32s", 100.0 * fraction, stage);
  return 0; /* anything else cancels */
}

static int fail(void) {
  fprintf(stderr, "\n%s\n", btf_error_message());
  return 2;
}

int main(int argc, char **argv) {
  btf_context *ctx;
  btf_dataset *ds;
  btf_options *options;
  btf_model *model;
  if (argc < 4) {
    fprintf(stderr, "usage: %s IN.btfd OUT.btfz CODEC [key=value]...\n", argv[0]);
    return 1;
  }
  if (btf_context_create(NULL, &ctx) != BTF_OK) return fail();
  if (btf_dataset_open(ctx, argv[1], &ds) != BTF_OK) return fail();
  const btf_codec *codec = btf_codec_find(ctx, argv[3]);
  if (codec == NULL) {
    fprintf(stderr, "there is no codec \"%s\"\n", argv[3]);
    return 1;
  }
  if (btf_options_create(codec, &options) != BTF_OK) return fail();
  for (int i = 4; i < argc; i++) {
    char *equals = strchr(argv[i], '=');
    if (equals == NULL) {
      fprintf(stderr, "\"%s\" is not key=value\n", argv[i]);
      return 1;
    }
    *equals = '\0';
    if (btf_options_set(options, argv[i], equals + 1) != BTF_OK) return fail();
  }

  btf_job job = BTF_JOB_INIT;
  job.progress = show_progress;
  job.max_working_set = (uint64_t)512 << 20;
  if (btf_model_fit(ds, codec, options, &job, &model) != BTF_OK) return fail();
  if (btf_model_save(model, argv[2], 0, NULL, NULL) != BTF_OK) return fail();
  fprintf(stderr, "\n");

  btf_model_release(model);
  btf_options_release(options);
  btf_dataset_release(ds);
  btf_context_release(ctx);
  return 0;
}
