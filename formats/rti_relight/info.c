/* SPDX-License-Identifier: MIT */
/* info.c: what info.json says of the planes. */
#include "source/hemisphere.h"
#include "source/picture.h"

#include "rti_relight/relight.h"

/* A value of JSON takes about thirty times its two bytes when it is parsed. */
enum { MOST_INFO_BYTES = 4 << 20, PTM_TERMS = 6 };

static const btf_json *member(const relight_file *r, const btf_json *object, const char *name) {
  return (r->map.file.host->json_get)(object, name);
}

static btf_status fail_member(const relight_file *r, const char *name, const char *expected) {
  return (r->map.file.host->fail)(r->map.file.ctx, BTF_E_CORRUPT, "%s: \"%s\" is not %s", r->map.file.path,
                                  name, expected);
}

static btf_status fail_unsupported(const relight_file *r, const char *name, const char *expected) {
  return (r->map.file.host->fail)(r->map.file.ctx, BTF_E_UNSUPPORTED, "%s: \"%s\" is another than %s",
                                  r->map.file.path, name, expected);
}

static bool whole(const relight_file *r, const btf_json *value, double least, double most, uint32_t *out) {
  const btf_host *host = r->map.file.host;
  const double number = (host->json_number)(value);
  if ((host->json_type)(value) != BTF_JSON_NUMBER || !(number >= least && number <= most) ||
      number != floor(number))
    return false;
  *out = (uint32_t)number;
  return true;
}

/* The number of the text in the list, which ends with NULL; -1 if it is not there. */
static int choose(const relight_file *r, const btf_json *object, const char *name,
                  const char *const *choices) {
  const char *text = (r->map.file.host->json_string)(member(r, object, name));
  for (int i = 0; text != NULL && choices[i] != NULL; i++)
    if (strcmp(text, choices[i]) == 0) return i;
  return -1;
}

/* A list of `count` numbers. */
static bool numbers(const relight_file *r, const btf_json *list, uint64_t count, double *out) {
  const btf_host *host = r->map.file.host;
  if ((host->json_type)(list) != BTF_JSON_ARRAY || (host->json_length)(list) != count) return false;
  for (uint64_t i = 0; i < count; i++) {
    const btf_json *value = (host->json_at)(list, i);
    if ((host->json_type)(value) != BTF_JSON_NUMBER) return false;
    out[i] = (host->json_number)(value);
  }
  return true;
}

/* ---- parts ---- */

static btf_status read_kind(relight_file *r, const btf_json *info) {
  static const char *const types[] = {"ptm", "hsh", "rbf", "bilinear", NULL};
  static const char *const colours[] = {"rgb", "lrgb", "mrgb", "mycc", NULL};
  static const char *const formats[] = {"jpg", NULL};
  const int type = choose(r, info, "type", types), colour = choose(r, info, "colorspace", colours);
  if (type < 0) return fail_unsupported(r, "type", "ptm, hsh, rbf and bilinear");
  if (colour < 0) return fail_unsupported(r, "colorspace", "rgb, lrgb, mrgb and mycc");
  if (member(r, info, "format") != NULL && choose(r, info, "format", formats) < 0)
    return fail_unsupported(r, "format", "jpg");
  r->type = (relight_type)type;
  r->colour = (relight_colour)colour;
  const bool formula = r->type == RELIGHT_PTM || r->type == RELIGHT_HSH;
  if (formula != (r->colour == RELIGHT_RGB || r->colour == RELIGHT_LRGB))
    return fail_unsupported(r, "colorspace", formula ? "rgb and lrgb" : "mrgb and mycc");
  if (!whole(r, member(r, info, "width"), 1, PICTURE_MOST_SIDE, &r->map.width))
    return fail_member(r, "width", "a size from 1 to 8192");
  if (!whole(r, member(r, info, "height"), 1, PICTURE_MOST_SIDE, &r->map.height))
    return fail_member(r, "height", "a size from 1 to 8192");
  return BTF_OK;
}

static btf_status read_plane_count(relight_file *r, const btf_json *info) {
  if (r->colour == RELIGHT_MYCC) {
    double counts[3];
    if (!numbers(r, member(r, info, "yccplanes"), 3, counts) || !(counts[1] >= 1 && counts[0] >= counts[1]) ||
        counts[2] != counts[1] || counts[1] != floor(counts[1]) || counts[0] != floor(counts[0]) ||
        counts[0] + counts[1] + counts[2] > RELIGHT_MOST_PLANES)
      return fail_member(r, "yccplanes", "three numbers of planes, at least as many of Y as of each chroma");
    r->chroma = (uint32_t)counts[1];
    r->plane_count = (uint32_t)(counts[0] + 2 * counts[1]);
  } else if (!whole(r, member(r, info, "nplanes"), 1, RELIGHT_MOST_PLANES, &r->plane_count)) {
    return fail_member(r, "nplanes", "a number of planes from 1 to 128");
  }
  r->image_count = (r->plane_count + 2) / 3;
  if (r->type == RELIGHT_RBF || r->type == RELIGHT_BILINEAR) return BTF_OK;
  const uint32_t most = r->type == RELIGHT_PTM ? PTM_TERMS : HEMISPHERE_MOST_TERMS;
  r->terms = r->colour == RELIGHT_RGB ? r->plane_count / 3 : r->plane_count - 3;
  if (r->plane_count < 3 || (r->colour == RELIGHT_RGB && r->plane_count % 3 != 0) || r->terms < 1 ||
      r->terms > most)
    return fail_member(r, "nplanes", "a number of planes that its formula has terms for");
  return BTF_OK;
}

static btf_status read_material(relight_file *r, const btf_json *info) {
  const btf_host *host = r->map.file.host;
  const btf_json *material = (host->json_at)(member(r, info, "materials"), 0);
  if (!numbers(r, member(r, material, "scale"), r->plane_count, r->scale))
    return fail_member(r, "scale", "a number for each plane");
  if (!numbers(r, member(r, material, "bias"), r->plane_count, r->bias))
    return fail_member(r, "bias", "a number for each plane");
  if (r->type == RELIGHT_PTM || r->type == RELIGHT_HSH) return BTF_OK;
  bool sound = numbers(r, member(r, material, "range"), r->plane_count, r->range);
  for (uint32_t i = 0; sound && i < r->plane_count; i++) sound = r->range[i] > 0;
  return sound ? BTF_OK : fail_member(r, "range", "a number above 0 for each plane");
}

static btf_status read_lights(relight_file *r, const btf_json *info) {
  const btf_host *host = r->map.file.host;
  const btf_json *list = member(r, info, "lights");
  const uint64_t count = (host->json_length)(list);
  if (count < 3 || count % 3 != 0 || count / 3 > RELIGHT_MOST_SAMPLES)
    return fail_member(r, "lights", "a list of x, y and z of 1 to 4096 lights");
  r->sigma = (host->json_number)(member(r, info, "sigma"));
  if (!(r->sigma >= 1e-6 && r->sigma <= 1e6)) return fail_member(r, "sigma", "a width from 1e-6 to 1e6");
  r->samples = (uint32_t)(count / 3);
  r->lights = (host->alloc)(r->map.file.ctx, count, sizeof *r->lights);
  if (r->lights == NULL) return BTF_E_NOMEM;
  if (!numbers(r, list, count, r->lights)) return fail_member(r, "lights", "a list of numbers");
  for (uint64_t i = 0; i < count; i++)
    if (!(fabs(r->lights[i]) <= 2)) return fail_member(r, "lights", "of unit vectors");
  return BTF_OK;
}

/* A list of bytes, or in older folders a file of the same. */
static btf_status read_basis(relight_file *r, const btf_json *info) {
  const btf_host *host = r->map.file.host;
  const uint64_t size = (uint64_t)(r->plane_count + 1) * r->samples * 3;
  const btf_json *list = member(r, info, "basis");
  r->basis = (host->alloc)(r->map.file.ctx, size, 1);
  if (r->basis == NULL) return BTF_E_NOMEM;
  if (list != NULL) {
    bool sound = (host->json_length)(list) == size;
    for (uint64_t i = 0; sound && i < size; i++) {
      uint32_t value = 0;
      sound = whole(r, (host->json_at)(list, i), 0, 255, &value);
      r->basis[i] = (unsigned char)value;
    }
    return sound ? BTF_OK
                 : fail_member(r, "basis", "a list of three bytes for each plane, the mean and light");
  }
  source_file file;
  BTF_TRY(source_file_open_beside(&r->map.file, "materials.bin", &file));
  const bool sound = file.size == size;
  if (sound) memcpy(r->basis, file.data, size);
  source_file_close(&file);
  if (sound) return BTF_OK;
  return (host->fail)(r->map.file.ctx, BTF_E_CORRUPT, "%s: materials.bin has not the %llu bytes of a basis",
                      r->map.file.path, (unsigned long long)size);
}

static btf_status read_all(relight_file *r, const btf_json *info) {
  BTF_TRY(read_kind(r, info));
  BTF_TRY(read_plane_count(r, info));
  BTF_TRY(read_material(r, info));
  if (r->type == RELIGHT_PTM || r->type == RELIGHT_HSH) return BTF_OK;
  if (r->type == RELIGHT_RBF) {
    BTF_TRY(read_lights(r, info));
  } else {
    if (!whole(r, member(r, info, "resolution"), 2, 64, &r->resolution))
      return fail_member(r, "resolution", "a size of the grid from 2 to 64");
    r->samples = r->resolution * r->resolution;
  }
  return read_basis(r, info);
}

btf_status relight_read_info(relight_file *r) {
  const source_file *file = &r->map.file;
  btf_json *info;
  if (file->size > MOST_INFO_BYTES)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT, "%s: has more than 4 MiB", file->path);
  BTF_TRY((file->host->json_parse)(file->ctx, file->path, (const char *)file->data, file->size, &info));
  const btf_status status = (file->host->json_type)(info) == BTF_JSON_OBJECT
                                ? read_all(r, info)
                                : (file->host->fail)(file->ctx, BTF_E_NOT_BTF,
                                                     "%s: does not describe relighting planes", file->path);
  (file->host->json_free)(info);
  return status;
}
