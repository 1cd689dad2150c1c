/* SPDX-License-Identifier: MIT */
/* format.c: zips and folders of images as a format of libbtf. */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <unistd.h>

#include <btf/btf_half.h>

#include "source/srgb.h"

#include "bonn_images/bonn_images.h"

enum { TRANSFER_AUTO, TRANSFER_POWER, TRANSFER_SRGB, TRANSFER_LINEAR };
static const char *const transfer_choices[] = {"auto", "power", "srgb", "linear", NULL};
static const char *const type_choices[] = {"f16", "f32", NULL};
static const char *const axes_choices[] = {"database", "header", NULL};
static const char *const duplicate_choices[] = {"refuse", "first", NULL};
BTF_PARAM(allow_missing, BTF_PARAM_BOOL,
          "fill missing and damaged images from those of neighbouring directions; all are decoded once to "
          "find these",
          NULL, "false", NULL, 0, 0);
BTF_PARAM(duplicates, BTF_PARAM_CHOICE, "two images of one light and view: refuse them, or take the first",
          NULL, "refuse", duplicate_choices, 0, 0);
BTF_PARAM(transfer, BTF_PARAM_CHOICE,
          "curve that codes of JPEG and PNG were made with; auto: a power for JPEG, sRGB for PNG", NULL,
          "auto", transfer_choices, 0, 0);
BTF_PARAM(power, BTF_PARAM_FLOAT, "exponent of that power", NULL, "2.2", NULL, 0.1, 10);
BTF_PARAM(type, BTF_PARAM_CHOICE, "type of the samples read", NULL, "f16", type_choices, 0, 0);
BTF_PARAM(flip, BTF_PARAM_BOOL, "the first row of an image is the bottom of the material", NULL, "false",
          NULL, 0, 0);
BTF_PARAM(
    hdr_axes, BTF_PARAM_CHOICE,
    "square Radiance images stored by columns: turned as the database's readers do, or as their header says",
    NULL, "database", axes_choices, 0, 0);
static const btf_param_desc *const params[] = {&allow_missing, &duplicates, &transfer, &power,
                                               &type,          &flip,       &hdr_axes, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  static const unsigned char local_header[] = {'P', 'K', 3, 4};
  if (probe->is_folder) return images_folder_looks_right(probe->path) ? 70 : 0;
  if (probe->head_size < sizeof local_header || memcmp(probe->head, local_header, sizeof local_header) != 0)
    return 0;
  return images_archive_probe(host, ctx, probe->path);
}

static void release(void *user) {
  images_close(user);
}

/* ---- pairs ---- */

static btf_status index_pairs(images_file *file, const btf_options *options) {
  const bool take_first = (file->host->option)(options, "duplicates") == 1;
  for (uint32_t pair = 0; pair < IMAGES_PAIRS; pair++) file->of_pair[pair] = images_none;
  uint32_t differing = 0, repeated = 0;
  for (uint32_t i = 0; i < file->list.count; i++) {
    const image_entry *entry = &file->list.entries[i];
    uint32_t *of = &file->of_pair[entry->pair];
    differing += entry->counter_differs;
    if (*of == images_none) {
      *of = i;
      continue;
    }
    repeated++;
    if (!take_first)
      return (file->host->fail)(
          file->ctx, BTF_E_CORRUPT,
          "%s: %s and %s are of the same light and view; duplicates=first takes the former", file->path,
          images_entry_name(file, &file->list.entries[*of]), images_entry_name(file, entry));
  }
  if (differing > 0)
    (file->host->log)(file->ctx, BTF_LOG_WARNING,
                      "%s: the counters of %u names do not fit their angles, which count", file->path,
                      differing);
  if (repeated > 0)
    (file->host->log)(file->ctx, BTF_LOG_WARNING, "%s: %u image%s left out, of pairs that have one already",
                      file->path, repeated, repeated == 1 ? " is" : "s are");
  return BTF_OK;
}

static btf_status check_missing(images_file *file, const btf_options *options) {
  enum { NAMED = 4 };
  char names[NAMED][32] = {{0}};
  uint32_t missing = 0;
  for (uint32_t pair = 0; pair < IMAGES_PAIRS; pair++) {
    if (file->of_pair[pair] != images_none) continue;
    if (missing < NAMED) images_pair_text(pair, names[missing]);
    missing++;
  }
  if (missing == 0) return BTF_OK;
  if ((file->host->option)(options, "allow_missing") == 0)
    return (file->host->fail)(file->ctx, BTF_E_CORRUPT,
                              "%s: %u of %d images are missing: %s%s%s%s%s%s%s%s; the parameter "
                              "allow_missing fills them (--allow-missing)",
                              file->path, missing, IMAGES_PAIRS, names[0], missing > 1 ? ", " : "", names[1],
                              missing > 2 ? ", " : "", names[2], missing > 3 ? ", " : "", names[3],
                              missing > NAMED ? " ..." : "");
  (file->host->log)(file->ctx, BTF_LOG_WARNING,
                    "%s: %u of %d images are missing and filled in; the first is %s", file->path, missing,
                    IMAGES_PAIRS, names[0]);
  return images_plan_fills(file);
}

/* ---- codes ---- */

static double linear_of(int curve, double exponent, double code) {
  if (curve == TRANSFER_POWER) return pow(code, exponent);
  if (curve == TRANSFER_SRGB) return srgb_linear(code);
  return code;
}

/* The table of samples, and what curve it has in words. */
static btf_status make_table(images_file *file, const btf_options *options, char words[64]) {
  const btf_host *host = file->host;
  int curve = (int)(host->option)(options, "transfer");
  const double exponent = (host->option)(options, "power");
  if (curve == TRANSFER_AUTO && (host->option_is_set)(options, "power")) curve = TRANSFER_POWER;
  if (file->info.kind == PICTURE_HDR) {
    if (curve != TRANSFER_AUTO && curve != TRANSFER_LINEAR)
      return (host->fail)(file->ctx, BTF_E_INVALID_ARG,
                          "%s: Radiance images are linear; transfer=%s is for others", file->path,
                          transfer_choices[curve]);
    snprintf(words, 64, "linear");
    return BTF_OK;
  }
  if (curve == TRANSFER_AUTO) curve = file->info.kind == PICTURE_JPEG ? TRANSFER_POWER : TRANSFER_SRGB;
  if (curve == TRANSFER_POWER)
    snprintf(words, 64, "power %.9g", exponent);
  else
    snprintf(words, 64, "%s", transfer_choices[curve]);
  const uint32_t codes = 1u << file->info.depth, size = file->rules.sample_size;
  file->table = (host->alloc)(file->ctx, codes, size);
  if (file->table == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < codes; i++) {
    const float value = (float)linear_of(curve, exponent, i / (codes - 1.0));
    if (size == 2)
      ((uint16_t *)file->table)[i] = btf_float_to_half(value);
    else
      ((float *)file->table)[i] = value;
  }
  file->rules.table = file->table;
  return BTF_OK;
}

/* ---- opening ---- */

/* What every picture is, and the list of those that are good. */
static btf_status check_pictures(images_file *file, const btf_options *options, char words[64]) {
  const btf_host *host = file->host;
  const bool leave_out = (host->option)(options, "allow_missing") != 0;
  if (!leave_out) BTF_TRY(index_pairs(file, options));
  BTF_TRY(leave_out ? images_leave_out_heads(file) : images_check_heads(file));
  file->rules.sample_size = (host->option)(options, "type") == 0 ? 2 : 4;
  file->rules.upside_down = (host->option)(options, "flip") != 0;
  file->rules.columns_as_rows = file->info.by_columns && file->info.width == file->info.height &&
                                (host->option)(options, "hdr_axes") == 0;
  BTF_TRY(make_table(file, options, words));
  if (!leave_out) return BTF_OK;
  BTF_TRY(images_leave_out_damaged(file));
  return index_pairs(file, options);
}

static btf_status check(images_file *file, const btf_options *options, char words[64]) {
  BTF_TRY(file->is_archive ? images_list_archive(file) : images_list_folder(file));
  if (file->list.count == 0)
    return (file->host->fail)(file->ctx, BTF_E_NOT_BTF,
                              "%s: no image in it has the angles tl, pl, tv and pv in its name", file->path);
  BTF_TRY(check_pictures(file, options, words));
  return check_missing(file, options);
}

static btf_status make(images_file *file, const char *curve, btf_dataset **out) {
  const btf_host *host = file->host;
  btf_context *ctx = file->ctx;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *directions = NULL;
  char filled[16], damaged[16], name[SOURCE_NAME_BYTES];
  const char *notes[18] = {
      "reader", "bonn-images", "images_kind", picture_kind_name(file->info.kind), "images_transfer", curve};
  uint32_t used = 6;
  if (file->fill_count > 0) {
    snprintf(filled, sizeof filled, "%u", file->fill_count);
    notes[used++] = "images_filled";
    notes[used++] = filled;
  }
  if (file->damaged > 0) {
    snprintf(damaged, sizeof damaged, "%u", (unsigned)file->damaged);
    notes[used++] = "images_damaged";
    notes[used++] = damaged;
  }
  if (file->info.by_columns) {
    notes[used++] = "images_hdr_axes";
    notes[used++] = axes_choices[file->rules.columns_as_rows ? 0 : 1];
  }
  if (file->rules.upside_down) {
    notes[used++] = "images_flipped";
    notes[used++] = "true";
  }
  const btf_status status = (host->dirset_create_named)(ctx, "ubo81", &directions);
  if (status != BTF_OK) {
    images_close(file);
    return status;
  }
  source_name(file->path, name);
  desc.lights = desc.views = directions;
  desc.width = file->info.width;
  desc.height = file->info.height;
  desc.channels = file->info.channels;
  desc.sample_type = file->rules.sample_size == 2 ? BTF_SAMPLE_F16 : BTF_SAMPLE_F32;
  desc.quantity = BTF_QUANTITY_BRDF_COS;
  desc.flags = BTF_DATASET_CONCURRENT_READ | BTF_DATASET_IMAGE_MAJOR;
  desc.name = name;
  desc.read = images_read;
  desc.user = file;
  desc.release = release;
  desc.notes = notes;
  const btf_status created = (host->dataset_create)(ctx, &desc, out);
  (host->dirset_release)(directions);
  return created;
}

static btf_status open_images(const btf_host *host, btf_context *ctx, const char *path,
                              const btf_options *options, btf_dataset **out) {
  char curve[64];
  images_file *file = (host->alloc)(ctx, 1, sizeof *file);
  if (file == NULL) return BTF_E_NOMEM;
  memset(file, 0, sizeof *file);
  file->host = host;
  file->ctx = ctx;
  pthread_mutex_init(&file->mutex, NULL);
  pthread_cond_init(&file->decoded, NULL);
  file->descriptor = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (file->descriptor < 0 && errno == ENOTDIR) {
    file->is_archive = true;
    file->descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  }
  const size_t length = strlen(path) + 1;
  file->path = (host->alloc)(ctx, length, 1);
  btf_status status = file->path != NULL ? BTF_OK : BTF_E_NOMEM;
  if (status == BTF_OK) memcpy(file->path, path, length);
  if (status == BTF_OK && file->descriptor < 0)
    status = (host->fail)(ctx, BTF_E_IO, "%s: could not be opened: %s", path, strerror(errno));
  if (status == BTF_OK) status = check(file, options, curve);
  if (status == BTF_OK) return make(file, curve, out);
  images_close(file);
  return status;
}

const btf_format_vtbl btf_format_bonn_images = {.struct_size = sizeof(btf_format_vtbl),
                                                .abi = LIBBTF_ABI,
                                                .id = "bonn-images",
                                                .title =
                                                    "images of 81 lights and 81 views in a zip or folder "
                                                    "(UBO2003, ATRIUM, UTIA): JPEG, PNG, Radiance HDR",
                                                .version = "1",
                                                .params = params,
                                                .probe = probe,
                                                .open = open_images,
                                                .write_params = images_write_params,
                                                .write = images_write};
