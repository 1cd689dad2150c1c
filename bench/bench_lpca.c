/* SPDX-License-Identifier: MIT */
/* bench_lpca: the local PCA codec on a part of a mapped data-set folder of halves, beside scikit-learn's
 * k-means with a PCA for each cluster on the same samples. Processor seconds are of all threads: what a busy
 * machine does not change. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <btf/btf.h>
#include <btf/btf_sampling.h>

static double clock_seconds(clockid_t clock) {
  struct timespec t;
  clock_gettime(clock, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int fail(const char *what) {
  fprintf(stderr, "bench_lpca: %s: %s\n", what, btf_error_message());
  return 1;
}

/* The first rows of the textures, in place. */
static btf_status open_part(btf_context *ctx, const btf_dataset *whole, uint32_t texels, btf_dataset **out) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const btf_status status = btf_dataset_describe(whole, &desc);
  if (status != BTF_OK) return status;
  if (texels / desc.width < desc.height) desc.height = texels / desc.width > 0 ? texels / desc.width : 1;
  desc.release = NULL;
  return btf_dataset_create(ctx, &desc, out);
}

/* Relative error over all samples of `most` texels of a level. */
static double relative_error(const btf_model *model, const btf_model *raw, const btf_dataset_desc *shape,
                             uint32_t level, uint32_t most) {
  const uint32_t lights = btf_dirset_count(shape->lights), views = btf_dirset_count(shape->views);
  const uint32_t width = btf_sampling_level_size(shape->width, level),
                 height = btf_sampling_level_size(shape->height, level);
  const uint32_t texels = width * height, step = texels / most > 0 ? texels / most : 1;
  double squared = 0.0, energy = 0.0;
  for (uint32_t t = 0; t < texels; t += step)
    for (uint32_t view = 0; view < views; view++)
      for (uint32_t light = 0; light < lights; light++) {
        float a[64], b[64];
        btf_model_texel(model, level, t % width, t / width, light, view, a);
        btf_model_texel(raw, level, t % width, t / width, light, view, b);
        for (uint32_t c = 0; c < shape->channels; c++) {
          squared += ((double)a[c] - b[c]) * ((double)a[c] - b[c]);
          energy += (double)b[c] * b[c];
        }
      }
  return sqrt(squared / energy);
}

static int run_peer(const char *peer, const char *folder, const btf_dataset_desc *whole,
                    const btf_dataset_desc *part, const char *clusters, const char *components) {
  char command[9000], line[512];
  snprintf(command, sizeof command, "%s \"%s/samples.bin\" %u %u %u %u %s %s", peer, folder,
           btf_dirset_count(whole->lights) * btf_dirset_count(whole->views), whole->width * whole->height,
           whole->channels, part->width * part->height, clusters, components);
  FILE *pipe = popen(command, "r");
  if (pipe == NULL) return 1;
  while (fgets(line, sizeof line, pipe) != NULL) printf("scikit-learn  %s", line);
  return pclose(pipe) != 0;
}

int main(int argc, char **argv) {
  const char *folder = argc > 1 ? argv[1] : NULL, *texels = argc > 2 ? argv[2] : "16384";
  const char *clusters = argc > 3 ? argv[3] : "32", *components = argc > 4 ? argv[4] : "8";
  const char *peer = argc > 5 ? argv[5] : NULL;
  btf_context *ctx = NULL;
  btf_dataset *whole = NULL, *part = NULL;
  btf_options *options = NULL;
  btf_model *model = NULL, *raw = NULL;
  btf_dataset_desc all = BTF_DATASET_DESC_INIT, some = BTF_DATASET_DESC_INIT;
  btf_model_info levels = BTF_MODEL_INFO_INIT;
  uint64_t peak = 0;
  if (folder == NULL) {
    fprintf(
        stderr,
        "usage: bench_lpca FOLDER.btfd [TEXELS [CLUSTERS [COMPONENTS [\"python3 bench/peer_lpca.py\"]]]]\n");
    return 2;
  }
  if (btf_context_create(NULL, &ctx) != BTF_OK) return fail("context");
  if (btf_dataset_open(ctx, folder, &whole) != BTF_OK || btf_dataset_describe(whole, &all) != BTF_OK)
    return fail(folder);
  if (open_part(ctx, whole, (uint32_t)strtoul(texels, NULL, 10), &part) != BTF_OK ||
      btf_dataset_describe(part, &some) != BTF_OK)
    return fail("part of the data set");
  const btf_codec *codec = btf_codec_find(ctx, "lpca");
  if (btf_options_create(codec, &options) != BTF_OK ||
      btf_options_set(options, "clusters", clusters) != BTF_OK ||
      btf_options_set(options, "components", components) != BTF_OK)
    return fail("options");
  const double start = clock_seconds(CLOCK_MONOTONIC), processor = clock_seconds(CLOCK_PROCESS_CPUTIME_ID);
  if (btf_model_fit(part, codec, options, NULL, &model) != BTF_OK) return fail("fit");
  const double seconds = clock_seconds(CLOCK_MONOTONIC) - start,
               used = clock_seconds(CLOCK_PROCESS_CPUTIME_ID) - processor;
  btf_context_memory(ctx, NULL, &peak);
  if (btf_model_from_dataset(part, NULL, &raw) != BTF_OK) return fail("reference");
  printf("%u x %u texels, %s clusters of %s components\n", some.width, some.height, clusters, components);
  printf("lpca          seconds %.4f processor %.4f error %.8f peak %.1f MiB\n", seconds, used,
         relative_error(model, raw, &some, 0, 512), (double)peak / 1048576.0);
  if (btf_model_describe(model, &levels) != BTF_OK) return fail("levels");
  for (uint32_t level = 0; level < levels.levels; level++)
    printf("lpca          level %u error %.5f\n", level, relative_error(model, raw, &some, level, 4096));
  fflush(stdout);
  const int failed = peer != NULL ? run_peer(peer, folder, &all, &some, clusters, components) : 0;
  btf_model_release(raw);
  btf_model_release(model);
  btf_options_release(options);
  btf_dataset_release(part);
  btf_dataset_release(whole);
  btf_context_release(ctx);
  return failed;
}
