/* SPDX-License-Identifier: MIT */
/* Prints the paper's table 1 and figure 6 for data sets: `report_laplacian [--brief] FOLDER...`. For each
 * image the mean square and mean absolute error of Y, Cb and Cr in 0..1 of the data's 99.9th percentile; of
 * these the average, least and largest over all images. Then the average error of Y by number of components,
 * the filters, and evaluations per second by level of detail. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <btf/btf_plugin.h>

#define TRY(expression)                                                                                      \
  do {                                                                                                       \
    if ((expression) != BTF_OK) {                                                                            \
      fprintf(stderr, "report_laplacian: %s\n", btf_error_message());                                        \
      exit(4);                                                                                               \
    }                                                                                                        \
  } while (0)

typedef struct summary {
  double average[2][3], least[2][3], largest[2][3]; /* of square and absolute errors */
  double rmse;                                      /* of RGB, not scaled */
  uint64_t bytes;
} summary;

static btf_dataset_desc desc;
static uint32_t lights, views;
static size_t texels;
static double peak;

static void read_image(const btf_dataset *ds, uint32_t light, uint32_t view, float *rgb) {
  const ptrdiff_t line = (ptrdiff_t)(12 * desc.width);
  const btf_block block = {view, 1, light, 1, 0, 0, desc.width, desc.height};
  const btf_strides strides = {0, 0, line, 12, 4};
  TRY(btf_dataset_read(ds, &block, rgb, &strides));
}

static int compare_floats(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

/* 99.9th percentile, of some texels of every image. */
static double find_peak(const btf_dataset *ds) {
  enum { MOST = 2000000 };
  const size_t pairs = (size_t)lights * views, step = pairs * texels / MOST + 1;
  float *image = malloc(texels * 12), *all = malloc(pairs * (texels / step + 1) * 12);
  size_t n = 0;
  for (size_t pair = 0; pair < pairs; pair++) {
    read_image(ds, (uint32_t)(pair % lights), (uint32_t)(pair / lights), image);
    for (size_t t = pair % step; t < texels; t += step, n += 3) memcpy(all + n, image + 3 * t, 12);
  }
  qsort(all, n, sizeof *all, compare_floats);
  const double found = all[n - 1 - n / 1000];
  free(image);
  free(all);
  return found > 0.0 ? found : 1.0;
}

static void image_errors(const float *truth, const float *decoded, double square[3], double absolute[3]) {
  memset(square, 0, 3 * sizeof *square);
  memset(absolute, 0, 3 * sizeof *absolute);
  for (size_t t = 0; t < texels; t++) {
    double d[3];
    for (int c = 0; c < 3; c++) d[c] = ((double)decoded[3 * t + c] - truth[3 * t + c]) / peak;
    const double y = 0.299 * d[0] + 0.587 * d[1] + 0.114 * d[2];
    const double ycc[3] = {y, (d[2] - y) / 1.772, (d[0] - y) / 1.402};
    for (int c = 0; c < 3; c++) {
      square[c] += ycc[c] * ycc[c] / (double)texels;
      absolute[c] += fabs(ycc[c]) / (double)texels;
    }
  }
}

static btf_model *fit(btf_context *ctx, const btf_dataset *ds, const char *name, const char *value,
                      const char *filter) {
  btf_options *options;
  btf_model *model;
  const btf_codec *codec = btf_codec_find(ctx, "laplacian");
  TRY(btf_options_create(codec, &options));
  TRY(btf_options_set(options, name, value));
  TRY(btf_options_set(options, "filter", filter));
  TRY(btf_model_fit(ds, codec, options, NULL, &model));
  btf_options_release(options);
  return model;
}

static summary measure(const btf_dataset *ds, const btf_model *model, uint32_t step) {
  const uint32_t pairs = lights * views;
  float *truth = malloc(texels * 12), *decoded = malloc(texels * 12);
  summary s = {.rmse = 0.0};
  double images = 0.0;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  TRY(btf_model_describe(model, &info));
  s.bytes = info.resident_bytes;
  for (int c = 0; c < 3; c++) s.least[0][c] = s.least[1][c] = INFINITY;
  for (uint32_t pair = 0; pair < pairs; pair += step, images += 1.0) {
    double error[2][3];
    read_image(ds, pair % lights, pair / lights, truth);
    for (size_t t = 0; t < texels; t++)
      btf_model_texel(model, 0, (uint32_t)(t % desc.width), (uint32_t)(t / desc.width), pair % lights,
                      pair / lights, decoded + 3 * t);
    image_errors(truth, decoded, error[0], error[1]);
    for (size_t i = 0; i < 3 * texels; i++)
      s.rmse += pow((double)decoded[i] - truth[i], 2.0) / (3.0 * (double)texels);
    for (int kind = 0; kind < 2; kind++)
      for (int c = 0; c < 3; c++) {
        s.average[kind][c] += error[kind][c];
        s.least[kind][c] = fmin(s.least[kind][c], error[kind][c]);
        s.largest[kind][c] = fmax(s.largest[kind][c], error[kind][c]);
      }
  }
  for (int kind = 0; kind < 2; kind++)
    for (int c = 0; c < 3; c++) s.average[kind][c] /= images;
  s.rmse = sqrt(s.rmse / images);
  free(truth);
  free(decoded);
  return s;
}

static double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Coherent queries along a line of the texture, directions turning slowly. */
static double speed(const btf_model *model, float lod) {
  enum { QUERIES = 4096, TURNS = 60 };
  static float columns[9][QUERIES], results[3][QUERIES];
  float *out[3] = {results[0], results[1], results[2]};
  btf_batch batch = BTF_BATCH_INIT;
  for (int i = 0; i < QUERIES; i++) {
    const float a = 0.5f + 0.3f * (float)i / QUERIES, b = 0.4f - 0.2f * (float)i / QUERIES;
    const float values[9] = {
        sinf(a), 0.0f, cosf(a), 0.0f, sinf(b), cosf(b), (float)(i % 256) / 256.0f, (float)(i / 256) / 16.0f,
        lod};
    for (int k = 0; k < 9; k++) columns[k][i] = values[k];
  }
  batch.count = QUERIES;
  for (int k = 0; k < 3; k++) {
    batch.light[k] = columns[k];
    batch.view[k] = columns[3 + k];
  }
  batch.uv[0] = columns[6];
  batch.uv[1] = columns[7];
  batch.lod = columns[8];
  btf_model_eval_n(model, &batch, BTF_VALUE_STORED, out);
  const double start = seconds();
  for (int turn = 0; turn < TURNS; turn++) btf_model_eval_n(model, &batch, BTF_VALUE_STORED, out);
  return (double)QUERIES * TURNS / (seconds() - start) / 1e6;
}

int main(int argc, char **argv) {
  static const char *const channels[] = {"Y", "Cb", "Cr"}, *const filters[] = {"mean", "binomial", "paper"};
  const int brief = argc > 1 && strcmp(argv[1], "--brief") == 0; /* the default filter's table alone */
  btf_context *ctx;
  TRY(btf_context_create(NULL, &ctx));
  for (int i = 1 + brief; i < argc; i++) {
    btf_dataset *ds;
    TRY(btf_dataset_open(ctx, argv[i], &ds));
    desc = (btf_dataset_desc)BTF_DATASET_DESC_INIT;
    TRY(btf_dataset_describe(ds, &desc));
    lights = btf_dirset_count(desc.lights);
    views = btf_dirset_count(desc.views);
    texels = (size_t)desc.width * desc.height;
    peak = find_peak(ds);
    printf("%s: %u x %u texels, %u lights, %u views, peak %.4g\n", desc.name, desc.width, desc.height, lights,
           views, peak);
    printf("  filter    RMSE of RGB  channel  MSE average  least     largest   MAE average  least     "
           "largest\n");
    for (int f = 0; f < (brief ? 1 : 3); f++) {
      btf_model *model = fit(ctx, ds, "y", "8", filters[f]);
      const summary s = measure(ds, model, 1);
      for (int c = 0; c < 3; c++)
        printf("  %-9s %-12.5f %-8s %-12.2e %-9.2e %-9.2e %-12.5f %-9.5f %.5f\n", filters[f], s.rmse,
               channels[c], s.average[0][c], s.least[0][c], s.largest[0][c], s.average[1][c], s.least[1][c],
               s.largest[1][c]);
      printf("  %-9s million evaluations a second at lod 0 .. 4:", filters[f]);
      for (int lod = 0; lod < 5; lod++) printf(" %.2f", speed(model, (float)lod));
      printf("\n");
      btf_model_release(model);
    }
    if (!brief) printf("  components of Y: MSE, MAE of Y over every 7th image\n");
    for (int y = 1; y <= 32 && !brief; y *= 2) {
      char value[8];
      snprintf(value, sizeof value, "%d", y);
      btf_model *model = fit(ctx, ds, "y", value, "mean");
      const summary s = measure(ds, model, 7);
      printf("  %2d: %.2e %.5f, %llu bytes resident\n", y, s.average[0][0], s.average[1][0],
             (unsigned long long)s.bytes);
      btf_model_release(model);
    }
    fflush(stdout);
    btf_dataset_release(ds);
  }
  btf_context_release(ctx);
  return 0;
}
