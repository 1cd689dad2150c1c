/* SPDX-License-Identifier: MIT */
/* format.c: Bonn's `.btf` containers as a format of libbtf. */
#include <stdio.h>

#include "bonn_btf/bonn_btf.h"

static const char *const cosine_choices[] = {"file", "inside", "outside", NULL};
BTF_PARAM(cosine, BTF_PARAM_CHOICE,
          "whether samples have the cosine of the light in them: as the file says, or against it", NULL,
          "file", cosine_choices, 0, 0);
static const btf_param_desc *const params[] = {&cosine, &bonn_param_lights, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && bonn_is_signature(probe->head, probe->head_size) ? 100 : 0;
}

static void release(void *user) {
  bonn_file *bonn = user;
  const btf_host *host = bonn->file.host;
  btf_context *ctx = bonn->file.ctx;
  bonn_file_close(bonn);
  (host->free)(ctx, bonn);
}

static bool is_text(const char *text) {
  for (; *text != '\0'; text++)
    if ((unsigned char)*text < 32 || (unsigned char)*text > 126) return false;
  return true;
}

/* Key and text, room for both in `list`, which ends with NULL. */
typedef struct note_list {
  const char *list[32];
  char numbers[8][64];
  uint32_t used, numbers_used;
} note_list;

static void note(note_list *notes, const char *key, const char *text) {
  if (text[0] == '\0' || !is_text(text)) return;
  notes->list[notes->used++] = key;
  notes->list[notes->used++] = text;
}

static void note_number(note_list *notes, const char *key, double value) {
  char *text = notes->numbers[notes->numbers_used++];
  snprintf(text, sizeof notes->numbers[0], "%.9g", value);
  note(notes, key, text);
}

static void fill_notes(const bonn_file *bonn, const char *resampled, note_list *notes) {
  static const char *const families[] = {"DFMF", "FMF", "PVF", "BDI"};
  uint32_t most = 0;
  for (uint32_t i = 0; i < bonn->factor_count; i++)
    if (bonn->factors[i].k > most) most = bonn->factors[i].k;
  note(notes, "reader", "bonn-btf");
  note(notes, "bonn_family", families[bonn->family]);
  note(notes, "bonn_setup", bonn->setup);
  note(notes, "bonn_sensor", bonn->sensor);
  note(notes, "bonn_light_source", bonn->light_source);
  note_number(notes, "bonn_version", bonn->version);
  note_number(notes, "bonn_cosine_flag", bonn->cosine);
  if (most > 0) note_number(notes, "bonn_components", most);
  if (bonn->family == BONN_DFMF) note_number(notes, "bonn_colour_model", bonn->colour_model);
  if (bonn->dynamic_range != 0) note_number(notes, "bonn_dynamic_range", bonn->dynamic_range);
  if (bonn->rotations != 0) note_number(notes, "bonn_rotations", bonn->rotations);
  note(notes, "lights_resampled", resampled);
}

static btf_status make(const btf_host *host, bonn_file *bonn, const btf_options *options, btf_dataset **out) {
  static const char *const rgb[] = {"R", "G", "B"};
  btf_context *ctx = bonn->file.ctx;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  note_list notes = {.used = 0};
  bonn_common common;
  btf_dirset *views = NULL;
  const int choice = (int)(host->option)(options, "cosine");
  const bool inside = choice == 1 || (choice == 0 && bonn->cosine != 0);
  char name[SOURCE_NAME_BYTES];
  btf_status status = bonn_common_lights(bonn, options, &common);
  if (status == BTF_OK) status = (host->dirset_create)(ctx, bonn->views, bonn->view_count, &views);
  if (status == BTF_OK) status = bonn_products_prepare(bonn);
  if (status == BTF_OK) {
    fill_notes(bonn, common.note, &notes);
    desc.lights = common.lights;
    desc.view_lights = (const btf_dirset *const *)common.of_views;
    desc.views = views;
    desc.width = bonn->width;
    desc.height = bonn->height;
    desc.channels = bonn->channels;
    /* Interpolated samples are none of the file's halves. */
    bonn->gives_halves = bonn->family == BONN_BDI && common.of_views == NULL;
    desc.sample_type = bonn->gives_halves ? BTF_SAMPLE_F16 : BTF_SAMPLE_F32;
    desc.quantity = inside ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
    desc.flags = BTF_DATASET_CONCURRENT_READ;
    desc.channel_names = bonn->channel_names != NULL ? (const char *const *)bonn->channel_names : rgb;
    source_name(bonn->file.path, name);
    desc.name = name;
    desc.texels_per_mm = bonn->texels_per_mm > 0 && bonn->texels_per_mm < 1e12f ? bonn->texels_per_mm : 0;
    desc.read = bonn_read;
    desc.user = bonn;
    desc.release = release;
    desc.notes = notes.list;
    desc.factors = common.of_views == NULL ? bonn_products : NULL;
    if (common.of_views != NULL)
      (host->log)(ctx, BTF_LOG_WARNING, "%s: its views have lights of their own, resampled %s",
                  bonn->file.path, common.note);
    status = (host->dataset_create)(ctx, &desc, out);
  } else {
    release(bonn);
  }
  bonn_common_release(host, ctx, &common);
  (host->dirset_release)(views);
  return status;
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  bonn_file *bonn = (host->alloc)(ctx, 1, sizeof *bonn);
  if (bonn == NULL) return BTF_E_NOMEM;
  *bonn = (bonn_file){.family = BONN_DFMF};
  btf_status status = source_file_open(host, ctx, path, &bonn->file);
  if (status != BTF_OK) {
    (host->free)(ctx, bonn);
    return status;
  }
  status = bonn_file_parse(bonn);
  if (status == BTF_OK) return make(host, bonn, options, out);
  release(bonn);
  return status;
}

const btf_format_vtbl btf_format_bonn_btf = {.struct_size = sizeof(btf_format_vtbl),
                                             .abi = LIBBTF_ABI,
                                             .id = "bonn-btf",
                                             .title = "Bonn .btf containers (UBO2014): DFMF, FMF, PVF, BDI",
                                             .version = "1",
                                             .params = params,
                                             .probe = probe,
                                             .open = open_file,
                                             .write_params = bonn_write_params,
                                             .write = bonn_write};
