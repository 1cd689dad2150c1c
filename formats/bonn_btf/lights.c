/* SPDX-License-Identifier: MIT */
/* lights.c: files whose views have lights of their own, as a data set whose views share one list: samples at
 * its lights are interpolated by the library between those of the view. */
#include <math.h>
#include <stdio.h>

#include "bonn_btf/bonn_btf.h"

/* Weights are kept for each view and common light, and a set of some 50 KiB for each list. */
enum { MOST_PAIRS = 1 << 18, MOST_LISTS = 1024 };

const btf_param_desc bonn_param_lights = {sizeof(btf_param_desc),
                                          "lights",
                                          "where views have lights of their own, those that all are "
                                          "resampled at: longest or first list of the file, "
                                          "or a set such as ubo151",
                                          NULL,
                                          "longest",
                                          NULL,
                                          0,
                                          0,
                                          BTF_PARAM_STRING,
                                          0};

static btf_status make_set(const bonn_file *bonn, uint32_t view, btf_dirset **out) {
  const btf_host *host = bonn->file.host;
  const bonn_lights *list = &bonn->lights[view];
  float *xyz = (host->alloc)(bonn->file.ctx, list->count, 3 * sizeof *xyz);
  if (xyz == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < list->count; i++)
    bonn_direction(list->angles + (size_t)i * 8, xyz + 3 * (size_t)i);
  const btf_status status = (host->dirset_create)(bonn->file.ctx, xyz, list->count, out);
  (host->free)(bonn->file.ctx, xyz);
  return status;
}

/* The list of the file that the option names; view_count for a named set. */
static uint32_t choose_list(const bonn_file *bonn, const char *wanted) {
  uint32_t longest = 0;
  if (strcmp(wanted, "first") == 0) return 0;
  if (strcmp(wanted, "longest") != 0) return bonn->view_count;
  for (uint32_t v = 1; v < bonn->view_count; v++)
    if (bonn->lights[v].count > bonn->lights[longest].count) longest = v;
  return longest;
}

static btf_status too_many(const bonn_file *bonn) {
  return (bonn->file.host->fail)(
      bonn->file.ctx, BTF_E_LIMIT,
      "%s: its views have lights of their own; at most %d pairs of view and light and %d "
      "changes from one view's list to the next's are resampled",
      bonn->file.path, MOST_PAIRS, MOST_LISTS);
}

/* Views share what is the same: the common set, or that of the view before, if its list is that of the view
 * which made the set; lists that drift slowly become sets of their own. */
static btf_status make_sets(const bonn_file *bonn, uint32_t list, bonn_common *common) {
  const btf_host *host = bonn->file.host;
  uint32_t made = 0, maker = UINT32_MAX;
  common->of_views = (host->alloc)(bonn->file.ctx, bonn->view_count, sizeof *common->of_views);
  if (common->of_views == NULL) return BTF_E_NOMEM;
  for (; common->views < bonn->view_count; common->views++) {
    const uint32_t v = common->views;
    btf_dirset **set = &common->of_views[v];
    if (list < bonn->view_count && bonn_same_lights(&bonn->lights[v], &bonn->lights[list])) {
      *set = common->lights;
      maker = UINT32_MAX;
    } else if (maker != UINT32_MAX && bonn_same_lights(&bonn->lights[v], &bonn->lights[maker])) {
      *set = common->of_views[maker];
    } else {
      if (made++ == MOST_LISTS) return too_many(bonn);
      BTF_TRY(make_set(bonn, v, set));
      maker = v;
    }
  }
  return BTF_OK;
}

/* Degrees between two unit vectors. */
static double angle_between(const float *a, const float *b) {
  const double x = (double)a[0] - b[0], y = (double)a[1] - b[1], z = (double)a[2] - b[2];
  return 2 * asin(fmin(1, sqrt(x * x + y * y + z * z) / 2)) * 180 / acos(-1.0);
}

static void describe(const bonn_file *bonn, uint32_t list, const char *name, bonn_common *common) {
  const btf_host *host = bonn->file.host;
  const uint32_t lights = (host->dirset_count)(common->lights);
  const float *xyz = (host->dirset_directions)(common->lights);
  uint32_t resampled = 0;
  double largest = 0;
  for (uint32_t v = 0; v < bonn->view_count; v++) {
    const btf_dirset *own = common->of_views[v];
    if (own == common->lights) continue;
    resampled++;
    for (uint32_t l = 0; l < lights; l++) {
      const uint32_t nearest = (host->dirset_nearest)(own, xyz + 3 * (size_t)l);
      const double angle =
          angle_between(xyz + 3 * (size_t)l, (host->dirset_directions)(own) + 3 * (size_t)nearest);
      if (angle > largest) largest = angle;
    }
  }
  const int length =
      list < bonn->view_count
          ? snprintf(common->note, sizeof common->note, "at the %u of view %u", (unsigned)lights,
                     (unsigned)list)
          : snprintf(common->note, sizeof common->note, "at the %u of %.60s", (unsigned)lights, name);
  snprintf(common->note + length, sizeof common->note - (size_t)length,
           ", in %u of %u views; the nearest measured light is up to %.3g degrees away", (unsigned)resampled,
           (unsigned)bonn->view_count, largest);
}

static btf_status resample(const bonn_file *bonn, uint32_t list, const char *name, bonn_common *common) {
  const btf_host *host = bonn->file.host;
  const uint64_t pairs = (uint64_t)(host->dirset_count)(common->lights) * bonn->view_count;
  if (pairs > MOST_PAIRS || bonn->pairs > MOST_PAIRS) return too_many(bonn);
  BTF_TRY(make_sets(bonn, list, common));
  describe(bonn, list, name, common);
  return BTF_OK;
}

btf_status bonn_common_lights(const bonn_file *bonn, const btf_options *options, bonn_common *out) {
  const btf_host *host = bonn->file.host;
  const char *name = (host->option_text)(options, "lights");
  const uint32_t list = choose_list(bonn, name);
  *out = (bonn_common){.lights = NULL};
  if (list < bonn->view_count)
    BTF_TRY(make_set(bonn, list, &out->lights));
  else
    BTF_TRY((host->dirset_create_named)(bonn->file.ctx, name, &out->lights));
  return bonn->lights_differ || list == bonn->view_count ? resample(bonn, list, name, out) : BTF_OK;
}

void bonn_common_release(const btf_host *host, btf_context *ctx, bonn_common *common) {
  for (uint32_t v = 0; v < common->views; v++) {
    btf_dirset *set = common->of_views[v];
    if (set != common->lights && (v == 0 || set != common->of_views[v - 1])) (host->dirset_release)(set);
  }
  (host->free)(ctx, common->of_views);
  (host->dirset_release)(common->lights);
}
