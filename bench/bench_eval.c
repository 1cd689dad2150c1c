/* SPDX-License-Identifier: MIT */
/* bench_eval: million queries a second of FMF models on one core, through btf_model_eval and btf_model_eval_n, beside
 * what the machine allows: converting the values that a query blends, multiplying and adding them, and fetching its rows
 * from tables of this size at random. All bounds are measured in the same run, rounds of all cases and bounds are
 * interleaved. Then the time of opening plain models of two sizes and answering a first query.
 *
 *   bench_eval [-r ROUNDS] [-i ISA] [-s STORAGE]...      default: f16, bf16, q8 and f32 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <unistd.h>

#include <btf/btf.h>

#include "codecs/fmf/fmf.h"
#include "crafted_model.h"
#include "lib/model/model.h"
#include "machine_bounds.h"

enum { QUERIES = 1 << 16, MAX_ROUNDS = 64, SIDE = 256 };

/* Light, view and uv of every query. */
typedef struct query_set {
  float at[8][QUERIES];
} query_set;

typedef struct bench_case {
  const char *name;
  const query_set *queries;
  bool batch, nearest, shared;
  double target; /* million queries a second */
  double seconds[MAX_ROUNDS];
} bench_case;

static query_set plane, sphere, scattered, tile;
static float results[3][QUERIES];

static int fail(const char *what) {
  fprintf(stderr, "bench_eval: %s: %s\n", what, btf_error_message());
  return 1;
}

/* ---- queries ---- */

static uint64_t random_state = 7;

static float random_unit(void) {
  random_state = random_state * 6364136223846793005u + 1442695040888963407u;
  return ((float)(random_state >> 40) + 0.5f) * (1.0f / (1 << 24));
}

static void normalise(float v[3]) {
  const float scale = 1.0f / sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  for (int k = 0; k < 3; k++) v[k] *= scale;
}

static void set_query(query_set *set, size_t i, const float light[3], const float view[3], float u, float v) {
  for (int k = 0; k < 3; k++) {
    set->at[k][i] = light[k];
    set->at[3 + k][i] = view[k];
  }
  set->at[6][i] = u;
  set->at[7][i] = v;
}

static void random_direction(float d[3]) {
  const float phi = 6.2831853f * random_unit();
  d[2] = random_unit();
  const float r = sqrtf(1.0f - d[2] * d[2]);
  d[0] = r * cosf(phi);
  d[1] = r * sinf(phi);
}

static float dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Pixels of a square picture, line by line: a plane seen by a camera above it and lit by a lamp, its texture twice across. */
static void make_plane(void) {
  for (size_t i = 0; i < QUERIES; i++) {
    const float x = ((float)(i % SIDE) + 0.5f) / SIDE * 2.0f - 1.0f, y = ((float)(i / SIDE) + 0.5f) / SIDE * 2.0f - 1.0f;
    float light[3] = {1.5f - x, 1.0f - y, 2.0f}, view[3] = {-x, -1.5f - y, 2.0f};
    normalise(light);
    normalise(view);
    set_query(&plane, i, light, view, x, y);
  }
}

/* A unit sphere seen and lit from afar; pixels that miss or that the light misses are left out and others repeat. */
static void make_sphere(void) {
  const float to_light[3] = {0.36f, 0.48f, 0.8f}, to_view[3] = {0.0f, 0.0f, 1.0f};
  size_t n = 0;
  while (n < QUERIES) {
    for (size_t i = 0; i < QUERIES && n < QUERIES; i++) {
      const float x = ((float)(i % SIDE) + 0.5f) / SIDE * 2.0f - 1.0f,
                  y = ((float)(i / SIDE) + 0.5f) / SIDE * 2.0f - 1.0f;
      if (x * x + y * y > 0.98f) continue;
      const float normal[3] = {x, y, sqrtf(1.0f - x * x - y * y)};
      float tangent[3] = {normal[2], 0.0f, -normal[0]};
      normalise(tangent);
      const float bitangent[3] = {normal[1] * tangent[2] - normal[2] * tangent[1],
                                  normal[2] * tangent[0] - normal[0] * tangent[2],
                                  normal[0] * tangent[1] - normal[1] * tangent[0]};
      const float light[3] = {dot(to_light, tangent), dot(to_light, bitangent), dot(to_light, normal)};
      const float view[3] = {dot(to_view, tangent), dot(to_view, bitangent), dot(to_view, normal)};
      if (light[2] <= 0.0f || view[2] <= 0.0f) continue;
      set_query(&sphere, n++, light, view, atan2f(normal[0], normal[2]), asinf(normal[1]));
    }
  }
}

static void make_queries(void) {
  float shared_light[3] = {0.2f, 0.3f, 0.9f}, shared_view[3] = {-0.4f, 0.1f, 0.8f};
  normalise(shared_light);
  normalise(shared_view);
  make_plane();
  make_sphere();
  for (size_t i = 0; i < QUERIES; i++) {
    float light[3], view[3];
    random_direction(light);
    random_direction(view);
    set_query(&scattered, i, light, view, random_unit(), random_unit());
    set_query(&tile, i, shared_light, shared_view, ((float)(i % SIDE) + 0.3f) / SIDE, ((float)(i / SIDE) + 0.6f) / SIDE);
  }
}

/* ---- running ---- */

static double run_case(const btf_model *model, const bench_case *c) {
  const uint32_t flags = c->nearest ? BTF_QUERY_NEAREST : 0;
  const query_set *q = c->queries;
  const double start = machine_cpu_time();
  if (c->batch) {
    float *const out[3] = {results[0], results[1], results[2]};
    btf_batch batch = BTF_BATCH_INIT;
    batch.count = QUERIES;
    for (int k = 0; k < 3; k++) {
      batch.light[k] = q->at[k];
      batch.view[k] = q->at[3 + k];
    }
    batch.uv[0] = q->at[6];
    batch.uv[1] = q->at[7];
    batch.flags = flags;
    btf_model_eval_n(model, &batch, BTF_VALUE_BRDF, out);
  } else {
    for (size_t i = 0; i < QUERIES; i++) {
      const btf_query query = {{q->at[0][i], q->at[1][i], q->at[2][i]},
                               {q->at[3][i], q->at[4][i], q->at[5][i]},
                               {q->at[6][i], q->at[7][i]},
                               0.0f,
                               flags};
      float out[3];
      btf_model_eval(model, &query, out);
      for (int k = 0; k < 3; k++) results[k][i] = out[k];
    }
  }
  return machine_cpu_time() - start;
}

static int compare_doubles(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

static double convert_rate(const machine_bounds *bounds, uint32_t storage) {
  return storage == FMF_F16 ? bounds->convert_f16
         : storage == FMF_BF16 ? bounds->convert_bf16
         : storage == FMF_Q8 ? bounds->convert_q8
                             : bounds->fma_values;
}

static void print_case(bench_case *c, const btfi_fmf_state *state, const machine_bounds *bounds, double fetch_u,
                       double fetch_v, int rounds) {
  const btfi_fmf_layout *layout = &state->layout;
  const double u_values = (c->shared ? 0.0 : c->nearest ? 1.0 : 9.0) * layout->channels * layout->columns;
  const double v_values = (c->nearest ? 1.0 : 4.0) * layout->columns;
  const double convert = convert_rate(bounds, layout->storage) / (u_values + v_values) * 1e-6;
  const double arithmetic =
      bounds->fma_values / (u_values + v_values + (double)layout->channels * layout->columns) * 1e-6;
  const double fetch = 1e-6 / ((c->nearest ? 1.0 : 9.0) * fetch_u + (c->nearest ? 1.0 : 4.0) * fetch_v);
  const bool scattered_rows = c->queries == &scattered;
  double tightest = convert < arithmetic ? convert : arithmetic;
  if (scattered_rows && fetch < tightest) tightest = fetch;
  qsort(c->seconds, (size_t)rounds, sizeof *c->seconds, compare_doubles);
  const double best = QUERIES / c->seconds[0] * 1e-6, median = QUERIES / c->seconds[rounds / 2] * 1e-6;
  printf("  %-28s %7.2f %7.2f", c->name, median, best);
  if (c->target > 0.0) printf(" %7.1f", c->target);
  else printf("       -");
  printf("  %8.1f %8.1f ", convert, arithmetic);
  if (scattered_rows) printf("%8.1f", fetch);
  else printf("       -");
  printf("  %5.2f\n", best / tightest);
}

static void run_model(const btf_model *model, bench_case *cases, int count, const char *isa, int rounds) {
  const btfi_fmf_state *state = model->state;
  const btfi_fmf_layout *layout = &state->layout;
  machine_bounds bounds = {0};
  double fetch_u = INFINITY, fetch_v = INFINITY;
  for (int round = 0; round < rounds; round++) {
    machine_measure(isa, &bounds);
    fetch_u = fmin(fetch_u, machine_fetch(state->u, (uint64_t)layout->lights * layout->views, layout->u_row_bytes,
                                          layout->u_data_bytes));
    fetch_v = fmin(fetch_v, machine_fetch(state->v[0], (uint64_t)layout->width * layout->height,
                                          layout->v_texel_bytes, layout->v_texel_bytes));
    for (int i = 0; i < count; i++) cases[i].seconds[round] = run_case(model, &cases[i]);
  }
  printf("  bounds of one core: %.1f Gvalues/s %s, %.1f GFLOP/s, row of U %.0f ns, row of V %.0f ns\n",
         convert_rate(&bounds, layout->storage) * 1e-9,
         layout->storage == FMF_F32 ? "multiplied and added" : "converted, multiplied and added",
         2e-9 * bounds.fma_values, fetch_u * 1e9, fetch_v * 1e9);
  printf("  million queries a second      median    best  target   convert    flops    fetch  of bound\n");
  for (int i = 0; i < count; i++) print_case(&cases[i], state, &bounds, fetch_u, fetch_v, rounds);
}

static int bench_storage(btf_context *ctx, const char *storage, int rounds) {
  const bool f16 = strcmp(storage, "f16") == 0;
  const crafted_size large = {"ubo151", 256, 256, 3, 100}, small = {"ubo81", 64, 64, 3, 32};
  static bench_case large_cases[] = {{"plane, batch", &plane, true, false, false, 4.3, {0}},
                                     {"sphere, batch", &sphere, true, false, false, 4.3, {0}},
                                     {"plane, single", &plane, false, false, false, 0, {0}},
                                     {"random, single", &scattered, false, false, false, 0.9, {0}},
                                     {"random, batch", &scattered, true, false, false, 1.6, {0}},
                                     {"one direction pair, batch", &tile, true, false, true, 8.5, {0}},
                                     {"nearest, plane, batch", &plane, true, true, false, 20, {0}},
                                     {"nearest, random, batch", &scattered, true, true, false, 7, {0}},
                                     {"nearest, random, single", &scattered, false, true, false, 0, {0}}};
  static bench_case small_cases[] = {{"plane, batch", &plane, true, false, false, 12, {0}},
                                     {"sphere, batch", &sphere, true, false, false, 12, {0}},
                                     {"random, batch", &scattered, true, false, false, 0, {0}}};
  const struct {
    const crafted_size *size;
    bench_case *cases;
    int count;
  } sets[] = {{&large, large_cases, 9}, {&small, small_cases, 3}};
  for (size_t i = 0; i < 2; i++) {
    btf_model *model;
    if (crafted_create(ctx, sets[i].size, storage, "packed", &model) != BTF_OK) return fail("crafted model");
    printf("%s, %u components, %s directions, %u x %u texels%s\n", storage, sets[i].size->components,
           sets[i].size->directions, sets[i].size->width, sets[i].size->height,
           f16 ? "" : " (targets are those of f16)");
    run_model(model, sets[i].cases, sets[i].count, btf_context_isa(ctx), rounds);
    btf_model_release(model);
  }
  return 0;
}

/* ---- opening ---- */

static int open_once(btf_context *ctx, const char *path, uint32_t flags, double *seconds) {
  const btf_query query = {{0.1f, 0.2f, 0.97f}, {-0.3f, 0.1f, 0.94f}, {0.3f, 0.6f}, 0.0f, 0};
  float out[3];
  btf_file *file;
  btf_model *model = NULL;
  const double start = machine_now();
  if (btf_file_open_path(ctx, path, flags, &file) != BTF_OK) return fail(path);
  const btf_status status = btf_file_load_model(file, 0, &model);
  if (status == BTF_OK) btf_model_eval(model, &query, out);
  const double took = machine_now() - start;
  if (took < *seconds) *seconds = took;
  btf_model_release(model);
  btf_file_close(file);
  return status == BTF_OK ? 0 : fail(path);
}

static int bench_opening(btf_context *ctx, int rounds) {
  const crafted_size sizes[] = {{"ubo81", 64, 64, 3, 32}, {"ubo151", 256, 256, 3, 100}};
  char path[] = "bench_eval_XXXXXX";
  const int descriptor = mkstemp(path);
  int failed = 0;
  if (descriptor < 0) return fail("cannot make a file here");
  close(descriptor);
  printf("opening a plain model and answering one query, pages in the cache: trusted, and with checksums verified\n");
  for (size_t i = 0; i < 2 && !failed; i++) {
    double trusted = INFINITY, verified = INFINITY;
    btf_model_info info = BTF_MODEL_INFO_INIT;
    btf_model *model;
    if (crafted_create(ctx, &sizes[i], "f16", "plain", &model) != BTF_OK ||
        btf_model_save(model, path, 0, NULL, NULL) != BTF_OK) {
      failed = fail("crafted model");
      break;
    }
    (void)btf_model_describe(model, &info);
    btf_model_release(model);
    for (int round = 0; round < rounds && !failed; round++)
      failed = open_once(ctx, path, BTF_OPEN_TRUST, &trusted) || open_once(ctx, path, 0, &verified);
    printf("  %6.1f MiB  %8.3f ms  %8.3f ms\n", (double)info.resident_bytes / 1048576.0, trusted * 1e3, verified * 1e3);
  }
  remove(path);
  return failed;
}

int main(int argc, char **argv) {
  const char *storages[8] = {"f16", "bf16", "q8", "f32"};
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  int rounds = 11, given = 0, storage_count = 4, failed = 0, option;
  while ((option = getopt(argc, argv, "r:i:s:")) != -1) {
    if (option == 'r') rounds = atoi(optarg);
    else if (option == 'i') desc.isa = optarg;
    else if (option == 's' && given < 8) storages[given++] = optarg;
    else return 1;
  }
  if (given > 0) storage_count = given;
  if (rounds < 1 || rounds > MAX_ROUNDS) rounds = 11;
  if (btf_context_create(&desc, &ctx) != BTF_OK) return fail("context");
  if (crafted_register(ctx) != BTF_OK) return fail("codec");
  make_queries();
  printf("instructions: %s\n", btf_context_isa(ctx));
  for (int i = 0; i < storage_count && !failed; i++) failed = bench_storage(ctx, storages[i], rounds);
  if (!failed) failed = bench_opening(ctx, rounds);
  btf_context_release(ctx);
  return failed;
}
