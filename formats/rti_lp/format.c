/* SPDX-License-Identifier: MIT */
/* format.c: photographs of one view and the list of their lights as a data set. */
#include <dirent.h>
#include <fcntl.h>
#include <stdio.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include <btf/btf_half.h>

#include "source/one_view.h"
#include "source/srgb.h"

#include "rti_lp/lp.h"

/* A photograph is decoded whole, beside what its coder takes. */
enum { MOST_PIXELS = 1 << 25, MOST_MEMBERS = 65536 };

ONE_VIEW_TRANSFER;
static const btf_param_desc *const params[] = {&transfer, NULL};

/* ---- recognising ---- */

/* The one file of a folder whose name ends in .lp; false if there is none or more than one. */
static bool find_list(const char *folder_path, char name[256]) {
  DIR *folder = opendir(folder_path);
  uint32_t found = 0, seen = 0;
  if (folder == NULL) return false;
  for (struct dirent *member; seen++ < MOST_MEMBERS && (member = readdir(folder)) != NULL;) {
    const size_t length = strlen(member->d_name);
    if (length < 4 || length > 255 || member->d_name[0] == '.' ||
        strcasecmp(member->d_name + length - 3, ".lp") != 0)
      continue;
    found++;
    memcpy(name, member->d_name, length + 1);
  }
  closedir(folder);
  return found == 1;
}

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  unsigned char head[4096];
  char name[256];
  struct stat about;
  (void)ctx;
  if (!probe->is_folder)
    return probe->head_size > 0 && lp_looks_right(host, probe->head, probe->head_size) ? 60 : 0;
  if (!find_list(probe->path, name)) return 0;
  const int folder = open(probe->path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder < 0) return 0;
  const int file = openat(folder, name, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  close(folder);
  if (file < 0) return 0;
  ssize_t got = 0;
  if (fstat(file, &about) == 0 && S_ISREG(about.st_mode)) got = read(file, head, sizeof head);
  close(file);
  return got > 0 && lp_looks_right(host, head, (size_t)got) ? 60 : 0;
}

/* ---- photographs ---- */

static const char *name_of(const lp_file *lp, uint32_t index) {
  return lp->text + lp->names[index];
}

static btf_status look(lp_file *lp, uint32_t index, picture_info *info) {
  const source_file *list = &lp->file;
  source_file file;
  picture_fault fault = {BTF_OK, ""};
  bool complete;
  BTF_TRY(source_file_open_beside(list, name_of(lp, index), &file));
  btf_status status = picture_look(file.data, file.size, info, &complete, &fault);
  source_file_close(&file);
  if (status == BTF_OK && !complete)
    status = picture_fail(&fault, BTF_E_TRUNCATED, "ends before it says its size");
  if (status == BTF_OK && (uint64_t)info->width * info->height > MOST_PIXELS)
    status = picture_fail(&fault, BTF_E_LIMIT, "has more than %d pixels", MOST_PIXELS);
  if (status == BTF_OK && index > 0 && !picture_alike(info, &lp->info))
    status = picture_fail(&fault, BTF_E_CORRUPT, "is not of the kind and size of %.80s", name_of(lp, 0));
  if (status == BTF_OK) return BTF_OK;
  return (list->host->fail)(list->ctx, status, "%s: %s: %s", list->path, name_of(lp, index), fault.why);
}

static btf_status decode(lp_file *lp, uint32_t index) {
  const source_file *list = &lp->file;
  source_file file;
  picture_fault fault = {BTF_OK, ""};
  if (lp->decoded == index) return BTF_OK;
  lp->decoded = UINT32_MAX;
  btf_status status = source_file_open_beside(list, name_of(lp, index), &file);
  if (status != BTF_OK)
    return (list->host->source_error)(status, "%s: %s could not be read", list->path, name_of(lp, index));
  status = picture_decode(&file, &lp->info, &lp->rules, lp->pixels, &fault);
  source_file_close(&file);
  if (status != BTF_OK)
    return (list->host->source_error)(status, "%s: %s: %s", list->path, name_of(lp, index), fault.why);
  lp->decoded = index;
  return BTF_OK;
}

/* Never called twice at once, so that the photograph decoded last can be kept. */
static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  lp_file *lp = user;
  const size_t channels = lp->info.channels;
  for (uint32_t l = 0; l < block->lights; l++) {
    BTF_TRY(decode(lp, block->light0 + l));
    for (uint32_t y = 0; y < block->height; y++)
      for (uint32_t x = 0; x < block->width; x++) {
        const uint16_t *texel =
            lp->pixels + ((uint64_t)(block->y0 + y) * lp->info.width + block->x0 + x) * channels;
        for (size_t c = 0; c < channels; c++)
          memcpy((char *)dst + (ptrdiff_t)l * strides->light + (ptrdiff_t)y * strides->y +
                     (ptrdiff_t)x * strides->x + (ptrdiff_t)c * strides->channel,
                 &texel[c], sizeof *texel);
      }
  }
  return BTF_OK;
}

/* ---- opening ---- */

static void release(void *user) {
  lp_file *lp = user;
  const btf_host *host = lp->file.host;
  btf_context *ctx = lp->file.ctx;
  (host->dirset_release)(lp->lights);
  (host->dirset_release)(lp->views);
  (host->free)(ctx, lp->text);
  (host->free)(ctx, lp->names);
  (host->free)(ctx, lp->directions);
  (host->free)(ctx, lp->table);
  (host->free)(ctx, lp->pixels);
  source_file_close(&lp->file);
  (host->free)(ctx, lp);
}

static btf_status make_directions(lp_file *lp) {
  static const float above[3] = {0, 0, 1};
  const source_file *list = &lp->file;
  const btf_status status = (list->host->dirset_create)(list->ctx, lp->directions, lp->count, &lp->lights);
  if (status != BTF_OK && status != BTF_E_NOMEM)
    return (list->host->fail)(list->ctx, BTF_E_CORRUPT,
                              "%s: two of its lights are closer than 0.0001 rad, without being equal",
                              list->path);
  BTF_TRY(status);
  return (list->host->dirset_create)(list->ctx, above, 1, &lp->views);
}

static btf_status make_samples(lp_file *lp, const btf_options *options, bool *srgb) {
  const source_file *list = &lp->file;
  const btf_host *host = list->host;
  *srgb = (int)(host->option)(options, "transfer") == 0;
  if (lp->info.kind == PICTURE_HDR && *srgb) {
    if ((host->option_is_set)(options, "transfer"))
      return (host->fail)(list->ctx, BTF_E_INVALID_ARG,
                          "%s: Radiance images are linear; transfer=srgb is for others", list->path);
    *srgb = false;
  }
  lp->rules = (picture_rules){.sample_size = 2};
  lp->pixels = (host->alloc)(list->ctx, (uint64_t)lp->info.width * lp->info.height,
                             lp->info.channels * sizeof *lp->pixels);
  if (lp->pixels == NULL) return BTF_E_NOMEM;
  if (lp->info.kind == PICTURE_HDR) return BTF_OK;
  const uint32_t codes = 1u << lp->info.depth;
  lp->table = (host->alloc)(list->ctx, codes, sizeof *lp->table);
  if (lp->table == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < codes; i++) {
    const double value = i / (codes - 1.0);
    lp->table[i] = btf_float_to_half((float)(*srgb ? srgb_linear(value) : value));
  }
  lp->rules.table = lp->table;
  return BTF_OK;
}

static btf_status prepare(lp_file *lp, const btf_options *options, bool *srgb) {
  picture_info info;
  lp->decoded = UINT32_MAX;
  BTF_TRY(lp_read_lights(lp));
  BTF_TRY(make_directions(lp));
  BTF_TRY(look(lp, 0, &lp->info));
  for (uint32_t i = 1; i < lp->count; i++) BTF_TRY(look(lp, i, &info));
  return make_samples(lp, options, srgb);
}

/* Opens the list that is meant by a file or a folder. */
static btf_status open_list(const btf_host *host, btf_context *ctx, const char *path, source_file *out) {
  struct stat about;
  char name[256];
  if (stat(path, &about) != 0 || !S_ISDIR(about.st_mode)) return source_file_open(host, ctx, path, out);
  if (!find_list(path, name))
    return (host->fail)(ctx, BTF_E_NOT_BTF, "%s: has not one file whose name ends in .lp", path);
  const size_t size = strlen(path) + strlen(name) + 2;
  char *joined = (host->alloc)(ctx, size, 1);
  if (joined == NULL) return BTF_E_NOMEM;
  snprintf(joined, size, "%s/%s", path, name);
  const btf_status status = source_file_open(host, ctx, joined, out);
  (host->free)(ctx, joined);
  return status;
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  bool srgb = false;
  lp_file *lp = (host->alloc)(ctx, 1, sizeof *lp);
  if (lp == NULL) return BTF_E_NOMEM;
  memset(lp, 0, sizeof *lp);
  btf_status status = open_list(host, ctx, path, &lp->file);
  if (status != BTF_OK) {
    (host->free)(ctx, lp);
    return status;
  }
  status = prepare(lp, options, &srgb);
  if (status != BTF_OK) {
    release(lp);
    return status;
  }
  const char *const notes[] = {
      "reader", "rti-lp", "transfer", srgb ? "srgb" : "linear", "rti_kind", picture_kind_name(lp->info.kind),
      NULL};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  char name[SOURCE_NAME_BYTES];
  source_name(path, name);
  desc.lights = lp->lights;
  desc.views = lp->views;
  desc.width = lp->info.width;
  desc.height = lp->info.height;
  desc.channels = lp->info.channels;
  desc.wrap = BTF_WRAP_CLAMP;
  desc.sample_type = BTF_SAMPLE_F16;
  desc.quantity = BTF_QUANTITY_BRDF_COS;
  desc.flags = BTF_DATASET_IMAGE_MAJOR;
  desc.name = name;
  desc.read = read_block;
  desc.user = lp;
  desc.release = release;
  desc.notes = notes;
  return (host->dataset_create)(ctx, &desc, out);
}

const btf_format_vtbl btf_format_rti_lp = {
    .struct_size = sizeof(btf_format_vtbl),
    .abi = LIBBTF_ABI,
    .id = "rti-lp",
    .title = "photographs of one view with a list of their lights (.lp): JPEG, PNG, Radiance HDR",
    .version = "1",
    .params = params,
    .probe = probe,
    .open = open_file};
