/* SPDX-License-Identifier: MIT */
/* fill.c: pairs without picture are interpolated: between the lights that their view has around theirs, or,
 * for a view without any picture, between the views that their light has. */
#include "bonn_images/bonn_images.h"

/* One line of the table of pairs: the lights of a view, or the views of a light. */
typedef struct pair_line {
  uint32_t first, step;
} pair_line;

typedef struct line_weights {
  btf_dirset *set;
  uint32_t there[IMAGES_DIRECTIONS]; /* directions that have a picture */
  uint32_t count;
} line_weights;

static btf_status line_open(const images_file *file, const float *directions, pair_line line,
                            line_weights *out) {
  float xyz[3 * IMAGES_DIRECTIONS];
  *out = (line_weights){.count = 0};
  for (uint32_t i = 0; i < IMAGES_DIRECTIONS; i++) {
    if (file->of_pair[line.first + i * line.step] == images_none) continue;
    memcpy(xyz + 3 * (size_t)out->count, directions + 3 * (size_t)i, 3 * sizeof *xyz);
    out->there[out->count++] = i;
  }
  return out->count > 0 ? (file->host->dirset_create)(file->ctx, xyz, out->count, &out->set) : BTF_OK;
}

static void line_weigh(const images_file *file, const line_weights *weights, const float direction[3],
                       pair_line line, image_fill *fill) {
  btf_interp at;
  (file->host->dirset_locate)(weights->set, direction, &at);
  for (int k = 0; k < 3; k++) {
    fill->from[k] = line.first + line.step * weights->there[at.index[k]];
    fill->weight[k] = at.weight[k];
  }
}

static btf_status plan(images_file *file, const float *directions) {
  line_weights weights;
  for (uint32_t view = 0, next = 0; view < IMAGES_DIRECTIONS; view++) {
    const uint32_t first = view * IMAGES_DIRECTIONS, begin = next;
    for (; next < file->fill_count && file->fills[next].pair < first + IMAGES_DIRECTIONS; next++) continue;
    if (begin == next) continue;
    const pair_line lights = {first, 1};
    BTF_TRY(line_open(file, directions, lights, &weights));
    const bool has_lights = weights.count > 0;
    for (uint32_t i = begin; i < next && has_lights; i++)
      line_weigh(file, &weights, directions + 3 * (size_t)(file->fills[i].pair - first), lights,
                 &file->fills[i]);
    (file->host->dirset_release)(weights.set);
    for (uint32_t i = begin; i < next && !has_lights; i++) {
      const uint32_t light = file->fills[i].pair - first;
      const pair_line views = {light, IMAGES_DIRECTIONS};
      BTF_TRY(line_open(file, directions, views, &weights));
      if (weights.count == 0) {
        char text[32];
        images_pair_text(file->fills[i].pair, text);
        return (file->host->fail)(file->ctx, BTF_E_CORRUPT,
                                  "%s: too many images are missing: none has the light or the view of %s",
                                  file->path, text);
      }
      line_weigh(file, &weights, directions + 3 * (size_t)view, views, &file->fills[i]);
      (file->host->dirset_release)(weights.set);
    }
  }
  return BTF_OK;
}

btf_status images_plan_fills(images_file *file) {
  btf_dirset *set;
  uint32_t missing = 0;
  for (uint32_t pair = 0; pair < IMAGES_PAIRS; pair++) missing += file->of_pair[pair] == images_none;
  if (missing == 0) return BTF_OK;
  file->fills = (file->host->alloc)(file->ctx, missing, sizeof *file->fills);
  if (file->fills == NULL) return BTF_E_NOMEM;
  for (uint32_t pair = 0; pair < IMAGES_PAIRS; pair++)
    if (file->of_pair[pair] == images_none) file->fills[file->fill_count++] = (image_fill){.pair = pair};
  BTF_TRY((file->host->dirset_create_named)(file->ctx, "ubo81", &set));
  const btf_status status = plan(file, (file->host->dirset_directions)(set));
  (file->host->dirset_release)(set);
  return status;
}
