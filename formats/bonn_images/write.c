/* SPDX-License-Identifier: MIT */
/* write.c: a folder of 81 x 81 pictures from any samples, blended where their directions are others. */
#include <stdio.h>

#include "bonn_images/bonn_images.h"

static const char *const kinds[] = {"png8", "png16", "hdr", NULL};
static const char *const transfers[] = {"srgb", "linear", NULL};
BTF_PARAM(kind, BTF_PARAM_CHOICE, "PNG of 8 or 16 bits, or Radiance HDR", NULL, "png8", kinds, 0, 0);
BTF_PARAM(transfer, BTF_PARAM_CHOICE, "curve that codes of PNG are made with", NULL, "srgb", transfers, 0, 0);
const btf_param_desc *const images_write_params[] = {&kind, &transfer, NULL};

enum { WRITE_MOST_SIDE = 2048, LIBRARY_BYTES = 512 << 10 /* of libpng and zlib for each thread */ };
static const float angle_tolerance = 0.05F * 3.14159265F / 180; /* as of names that are read */

/* One of the pictures that are made at once. */
typedef struct made_image {
  image_bytes bytes;
  uint64_t clipped;
  picture_fault fault;
} made_image;

/* The lights or views in the order they are written. */
typedef struct written_axis {
  bool resampled;
  uint32_t of[IMAGES_DIRECTIONS];   /* which of the 81 it is */
  btf_interp at[IMAGES_DIRECTIONS]; /* the samples it is blended of, in ascending order */
  float farthest;                   /* largest chord from one of the 81 to its nearest sample */
} written_axis;

typedef struct writing {
  const btf_host *host;
  btf_context *ctx;
  const char *path;
  const btf_job *job;
  btf_dataset_desc desc;
  const btf_dataset *ds;
  image_encoding encoding; /* all but its factor */
  written_axis lights, views;
  float cosine[IMAGES_DIRECTIONS]; /* of each light written, or 1 where it is in the samples */
  uint64_t samples_each, most_bytes, row_bytes;
  uint32_t at_once, light0;
  float *samples;
  float *sources; /* lights source0 .. source0 + source_count - 1 of a view, where pictures are blended */
  uint32_t sources_at_once, source0, source_count;
  float source_weight; /* of their view */
  unsigned char *room, *rows;
  made_image *made;
  uint64_t clipped;
} writing;

/* ---- names ---- */

static const char *extension_of(image_kind image) {
  return image == IMAGE_HDR ? "hdr" : "png";
}

static void name_of(uint32_t pair, const char *extension, char name[64]) {
  char angles[32];
  const uint32_t view = pair / IMAGES_DIRECTIONS, light = pair % IMAGES_DIRECTIONS;
  images_pair_text(pair, angles);
  snprintf(name, 64, "%05u %s.%s", light * IMAGES_DIRECTIONS + view, angles, extension);
}

/* Whether a name is one that is written here, letter by letter. */
static int32_t is_own(const char *name) {
  uint32_t pair;
  bool differs;
  picture_fault fault = {BTF_OK, ""};
  char expected[2][64];
  if (images_parse_name(name, &pair, &differs, &fault) != IMAGE_NAME_PAIR) return 0;
  name_of(pair, "png", expected[0]);
  name_of(pair, "hdr", expected[1]);
  return strcmp(name, expected[0]) == 0 || strcmp(name, expected[1]) == 0;
}

/* ---- directions ---- */

/* From a direction to the nearest of a set, whose number is *nearest. */
static float nearest_chord(const btf_host *host, const btf_dirset *set, const float *a, uint32_t *nearest) {
  *nearest = (host->dirset_nearest)(set, a);
  const float *b = (host->dirset_directions)(set) + 3 * (size_t)*nearest;
  return hypotf(hypotf(a[0] - b[0], a[1] - b[1]), a[2] - b[2]);
}

/* Where each direction is among the 81; false unless each of them is there once. */
static bool match(const btf_host *host, const btf_dirset *set, const btf_dirset *table,
                  uint32_t of[IMAGES_DIRECTIONS]) {
  const float *given = (host->dirset_directions)(set);
  bool taken[IMAGES_DIRECTIONS] = {false};
  if ((host->dirset_count)(set) != IMAGES_DIRECTIONS) return false;
  for (size_t i = 0; i < IMAGES_DIRECTIONS; i++) {
    uint32_t nearest;
    const float chord = nearest_chord(host, table, given + 3 * i, &nearest);
    if (!(chord <= angle_tolerance) || taken[nearest]) return false;
    taken[nearest] = true;
    of[i] = nearest;
  }
  return true;
}

/* Sums then do not depend on how many samples are in memory at once. */
static void sort_interp(btf_interp *at) {
  for (int i = 1; i < 3; i++)
    for (int k = i; k > 0 && at->index[k] < at->index[k - 1]; k--) {
      const uint32_t index = at->index[k];
      const float weight = at->weight[k];
      at->index[k] = at->index[k - 1];
      at->weight[k] = at->weight[k - 1];
      at->index[k - 1] = index;
      at->weight[k - 1] = weight;
    }
}

static void plan_axis(const btf_host *host, const btf_dirset *set, const btf_dirset *table,
                      written_axis *axis) {
  const float *wanted = (host->dirset_directions)(table);
  axis->resampled = !match(host, set, table, axis->of);
  for (uint32_t i = 0; i < IMAGES_DIRECTIONS; i++) {
    axis->at[i] = (btf_interp){.index = {i, i, i}, .weight = {1, 0, 0}};
    if (!axis->resampled) continue;
    uint32_t nearest;
    axis->of[i] = i;
    (host->dirset_locate)(set, wanted + 3 * (size_t)i, &axis->at[i]);
    sort_interp(&axis->at[i]);
    axis->farthest = fmaxf(axis->farthest, nearest_chord(host, set, wanted + 3 * (size_t)i, &nearest));
  }
}

static btf_status plan_directions(writing *w) {
  const btf_host *host = w->host;
  btf_dirset *table = NULL;
  BTF_TRY((host->dirset_create_named)(w->ctx, "ubo81", &table));
  plan_axis(host, w->desc.lights, table, &w->lights);
  plan_axis(host, w->desc.views, table, &w->views);
  const float *lights = (host->dirset_directions)(w->lights.resampled ? table : w->desc.lights);
  for (size_t l = 0; l < IMAGES_DIRECTIONS; l++)
    w->cosine[l] = w->desc.quantity == BTF_QUANTITY_BRDF_COS ? 1 : lights[3 * l + 2];
  (host->dirset_release)(table);
  return BTF_OK;
}

static bool is_resampled(const writing *w) {
  return w->lights.resampled || w->views.resampled;
}

/* ---- what can be written ---- */

static btf_status check_shape(writing *w) {
  const image_encoding *e = &w->encoding;
  if (e->width > WRITE_MOST_SIDE || e->height > WRITE_MOST_SIDE)
    return (w->host->fail)(w->ctx, BTF_E_LIMIT, "%s: images of %u x %u texels; sides go up to %d", w->path,
                           e->width, e->height, WRITE_MOST_SIDE);
  if (e->channels != 3 && (e->channels != 1 || e->kind == IMAGE_HDR))
    return (w->host->fail)(w->ctx, BTF_E_UNSUPPORTED, "%s: %u channels; %s has %s", w->path, e->channels,
                           e->kind == IMAGE_HDR ? "Radiance HDR" : "PNG",
                           e->kind == IMAGE_HDR ? "3" : "1 or 3");
  return BTF_OK;
}

static btf_status prepare(writing *w, const btf_options *options, const btf_dataset *ds) {
  const btf_host *host = w->host;
  BTF_TRY((host->dataset_describe)(ds, &w->desc));
  w->encoding = (image_encoding){.host = host,
                                 .ctx = w->ctx,
                                 .kind = (image_kind)(host->option)(options, "kind"),
                                 .srgb = (host->option)(options, "transfer") == 0,
                                 .width = w->desc.width,
                                 .height = w->desc.height,
                                 .channels = w->desc.channels};
  if (w->encoding.kind == IMAGE_HDR && w->encoding.srgb && (host->option_is_set)(options, "transfer"))
    return (host->fail)(w->ctx, BTF_E_INVALID_ARG, "%s: Radiance images are linear; transfer=srgb is for PNG",
                        w->path);
  BTF_TRY(check_shape(w));
  BTF_TRY(plan_directions(w));
  w->samples_each = (uint64_t)w->desc.width * w->desc.height * w->desc.channels;
  w->most_bytes = images_encoded_most(&w->encoding);
  w->row_bytes = images_row_bytes(&w->encoding);
  return BTF_OK;
}

/* As many pictures of one view at once as fit. */
static btf_status make_room(writing *w) {
  const btf_host *host = w->host;
  const uint64_t threads = (host->thread_count)(w->ctx), picture = w->samples_each * sizeof(float);
  const uint64_t fixed = threads * (w->row_bytes + LIBRARY_BYTES) + (is_resampled(w) ? picture : 0);
  const uint64_t each = picture + w->most_bytes + sizeof(made_image);
  const uint64_t budget = w->job->max_working_set;
  if (budget < fixed + each)
    return (host->fail)(w->ctx, BTF_E_LIMIT,
                        "%s: a working set of %.1f MiB is too small for these images; %.1f MiB would do",
                        w->path, (double)budget / 1048576, ceil((double)(fixed + each) / 104857.6) / 10);
  const uint64_t fitting = (budget - fixed) / each;
  w->at_once = fitting < IMAGES_DIRECTIONS ? (uint32_t)fitting : IMAGES_DIRECTIONS;
  w->samples = (host->alloc)(w->ctx, w->samples_each * w->at_once, sizeof *w->samples);
  w->room = (host->alloc)(w->ctx, w->at_once, w->most_bytes);
  w->rows = (host->alloc)(w->ctx, threads, w->row_bytes);
  w->made = (host->alloc)(w->ctx, w->at_once, sizeof *w->made);
  if (w->samples == NULL || w->room == NULL || w->rows == NULL || w->made == NULL) return BTF_E_NOMEM;
  if (!is_resampled(w)) return BTF_OK;
  const uint64_t sources = 1 + (budget - fixed - w->at_once * each) / picture;
  const uint32_t lights = (host->dirset_count)(w->desc.lights);
  w->sources_at_once = sources < lights ? (uint32_t)sources : lights;
  w->sources = (host->alloc)(w->ctx, w->sources_at_once, picture);
  return w->sources == NULL ? BTF_E_NOMEM : BTF_OK;
}

/* ---- pictures ---- */

static void encode_one(void *job, uint32_t i, uint32_t thread) {
  const writing *w = job;
  image_encoding encoding = w->encoding;
  made_image *made = &w->made[i];
  encoding.factor = w->cosine[w->light0 + i];
  *made = (made_image){.bytes = {.data = w->room + i * w->most_bytes, .room = w->most_bytes}};
  images_encode(&encoding, w->samples + i * w->samples_each, w->rows + thread * w->row_bytes, &made->bytes,
                &made->clipped, &made->fault);
}

static btf_status read_pictures(const writing *w, uint32_t view, uint32_t light0, uint32_t lights,
                                float *samples) {
  const ptrdiff_t channel = sizeof(float), x = channel * (ptrdiff_t)w->desc.channels,
                  y = x * (ptrdiff_t)w->desc.width, light = y * (ptrdiff_t)w->desc.height;
  const btf_strides strides = {
      .view = light * (ptrdiff_t)lights, .light = light, .y = y, .x = x, .channel = channel};
  const btf_block block = {.view0 = view,
                           .views = 1,
                           .light0 = light0,
                           .lights = lights,
                           .width = w->desc.width,
                           .height = w->desc.height};
  return (w->host->dataset_read)(w->ds, &block, samples, &strides);
}

static void add_sources(void *job, uint32_t i, uint32_t thread) {
  const writing *w = job;
  const btf_interp *at = &w->lights.at[w->light0 + i];
  float *sum = w->samples + i * w->samples_each;
  (void)thread;
  for (int k = 0; k < 3; k++) {
    const float weight = w->source_weight * at->weight[k];
    if (!(weight > 0) || at->index[k] < w->source0 || at->index[k] - w->source0 >= w->source_count) continue;
    const float *source = w->sources + (at->index[k] - w->source0) * w->samples_each;
    for (uint64_t s = 0; s < w->samples_each; s++) sum[s] += weight * source[s];
  }
}

/* The first light from `from` on that the next `count` pictures need; images_none: there is none. */
static uint32_t next_source(const writing *w, uint32_t count, uint32_t from) {
  uint32_t next = images_none;
  for (uint32_t i = w->light0; i < w->light0 + count; i++)
    for (int k = 0; k < 3; k++) {
      const uint32_t light = w->lights.at[i].index[k];
      if (w->lights.at[i].weight[k] > 0 && light >= from && light < next) next = light;
    }
  return next;
}

static btf_status blend_pictures(writing *w, uint32_t view, uint32_t count) {
  const btf_interp *views = &w->views.at[view];
  memset(w->samples, 0, (size_t)(w->samples_each * count) * sizeof(float));
  for (int k = 0; k < 3; k++) {
    if (!(views->weight[k] > 0)) continue;
    w->source_weight = views->weight[k];
    w->source0 = next_source(w, count, 0);
    while (w->source0 != images_none) {
      uint32_t end = w->source0 + 1;
      while (end - w->source0 < w->sources_at_once && next_source(w, count, end) == end) end++;
      w->source_count = end - w->source0;
      BTF_TRY(read_pictures(w, views->index[k], w->source0, w->source_count, w->sources));
      BTF_TRY((w->host->parallel)(w->ctx, count, add_sources, w));
      w->source0 = next_source(w, count, end);
    }
  }
  return BTF_OK;
}

static btf_status put_block(writing *w, btf_new_folder *folder, uint32_t view, uint32_t count) {
  const btf_host *host = w->host;
  BTF_TRY(is_resampled(w) ? blend_pictures(w, view, count)
                          : read_pictures(w, view, w->light0, count, w->samples));
  BTF_TRY((host->parallel)(w->ctx, count, encode_one, w));
  for (uint32_t i = 0; i < count; i++) {
    const made_image *made = &w->made[i];
    char name[64];
    name_of(w->views.of[view] * IMAGES_DIRECTIONS + w->lights.of[w->light0 + i],
            extension_of(w->encoding.kind), name);
    if (made->fault.status == BTF_E_NOMEM) return BTF_E_NOMEM;
    if (made->fault.status != BTF_OK)
      return (host->fail)(w->ctx, made->fault.status, "%s: %s: %s", w->path, name, made->fault.why);
    w->clipped += made->clipped;
    BTF_TRY((host->folder_put)(folder, name, made->bytes.data, made->bytes.size));
  }
  return BTF_OK;
}

static btf_status put_all(writing *w, btf_new_folder *folder) {
  BTF_TRY((w->host->progress)(w->job, 0, "writing"));
  for (uint32_t view = 0; view < IMAGES_DIRECTIONS; view++)
    for (w->light0 = 0; w->light0 < IMAGES_DIRECTIONS;) {
      const uint32_t left = IMAGES_DIRECTIONS - w->light0, count = left < w->at_once ? left : w->at_once;
      BTF_TRY(put_block(w, folder, view, count));
      w->light0 += count;
      BTF_TRY((w->host->progress)(w->job, (view * IMAGES_DIRECTIONS + w->light0) / (double)IMAGES_PAIRS,
                                  "writing"));
    }
  return BTF_OK;
}

static btf_status write_prepared(writing *w) {
  btf_new_folder *folder;
  BTF_TRY(make_room(w));
  BTF_TRY(
      (w->host->folder_begin)(w->ctx, w->path, "folder of images that was written here", is_own, &folder));
  btf_status status = put_all(w, folder);
  const btf_status ended = (w->host->folder_end)(folder, status != BTF_OK);
  if (status == BTF_OK) status = ended;
  if (status == BTF_OK && is_resampled(w))
    (w->host->log)(w->ctx, BTF_LOG_WARNING,
                   "%s: interpolated at the 81 directions of ubo81 from %u lights and %u views; the nearest "
                   "sample is up to %.3g degrees away",
                   w->path, (w->host->dirset_count)(w->desc.lights), (w->host->dirset_count)(w->desc.views),
                   2 * asin(fmin(1, (double)fmaxf(w->lights.farthest, w->views.farthest) / 2)) * 180 /
                       acos(-1.0));
  if (status == BTF_OK && w->clipped > 0)
    (w->host->log)(w->ctx, BTF_LOG_WARNING,
                   "%s: %llu of %.0f samples were beyond what the images hold, %s, "
                   "and were clipped",
                   w->path, (unsigned long long)w->clipped, (double)w->samples_each * IMAGES_PAIRS,
                   w->encoding.kind == IMAGE_HDR ? "0 to 1.7e38" : "0 to 1");
  return status;
}

btf_status images_write(const btf_host *host, btf_context *ctx, const char *path, const btf_dataset *ds,
                        const btf_options *options, const btf_job *job) {
  writing *w = (host->alloc)(ctx, 1, sizeof *w);
  if (w == NULL) return BTF_E_NOMEM;
  *w = (writing){.host = host, .ctx = ctx, .path = path, .job = job, .ds = ds, .desc = BTF_DATASET_DESC_INIT};
  btf_status status = prepare(w, options, ds);
  if (status == BTF_OK) status = write_prepared(w);
  (host->free)(ctx, w->samples);
  (host->free)(ctx, w->sources);
  (host->free)(ctx, w->room);
  (host->free)(ctx, w->rows);
  (host->free)(ctx, w->made);
  (host->free)(ctx, w);
  return status;
}
