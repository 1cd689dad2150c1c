/* SPDX-License-Identifier: MIT */
/* format.c: RGL's tensor files (`.bsdf`) as a format of libbtf. */
#include <stdio.h>

#include "rgl/rgl.h"

ONE_TEXEL_DIRECTIONS;
static const btf_param_desc *const params[] = {&directions, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && probe->head_size >= 12 && memcmp(probe->head, "tensor_file", 12) == 0 ? 90 : 0;
}

static void drop(one_texel *base) {
  rgl_brdf *brdf = (rgl_brdf *)base;
  (base->file.host->free)(base->file.ctx, brdf->row_sums);
  (base->file.host->free)(base->file.ctx, brdf->totals);
}

/* A field of a BRDF: its rank and the sizes that others decide (0 = any). */
static btf_status want(const rgl_brdf *brdf, const char *name, uint32_t type, uint32_t rank,
                       const uint64_t *shape, const rgl_field **out) {
  const source_file *file = &brdf->base.file;
  const rgl_field *field = rgl_find(brdf, name);
  if (field == NULL)
    return (file->host->fail)(file->ctx, BTF_E_UNSUPPORTED, "%s: has no field \"%s\", so it is not a BRDF",
                              file->path, name);
  bool fits = field->type == type && field->rank == rank;
  for (uint32_t i = 0; fits && i < rank; i++)
    fits = field->shape[i] > 0 && field->shape[i] < 0x80000000u &&
           (shape[i] == 0 || field->shape[i] == shape[i]);
  if (!fits)
    return (file->host->fail)(file->ctx, BTF_E_CORRUPT,
                              "%s: field \"%s\" has another type or shape than a BRDF's", file->path, name);
  *out = field;
  return BTF_OK;
}

static btf_status want_grid(const rgl_brdf *brdf, const char *name, uint32_t rank, const uint64_t *shape,
                            rgl_grid *out) {
  const source_file *file = &brdf->base.file;
  const rgl_field *field;
  BTF_TRY(want(brdf, name, RGL_F32, rank, shape, &field));
  if (field->shape[rank - 1] < 2 || field->shape[rank - 2] < 2)
    return (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: field \"%s\" has a single row or column",
                              file->path, name);
  *out = (rgl_grid){field->data, (uint32_t)field->shape[rank - 2], (uint32_t)field->shape[rank - 1]};
  return BTF_OK;
}

static btf_status want_nodes(const rgl_brdf *brdf, const char *name, const unsigned char **nodes,
                             uint32_t *count) {
  static const uint64_t any[1] = {0};
  const source_file *file = &brdf->base.file;
  const rgl_field *field;
  BTF_TRY(want(brdf, name, RGL_F32, 1, any, &field));
  for (uint64_t i = 0; i < field->shape[0]; i++) {
    const float value = btf_get_f32(field->data + 4 * i);
    if (!isfinite(value) || (i > 0 && !(value > btf_get_f32(field->data + 4 * (i - 1)))))
      return (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: field \"%s\" does not rise", file->path, name);
  }
  *nodes = field->data;
  *count = (uint32_t)field->shape[0];
  return BTF_OK;
}

/* What a first direction may be turned or mirrored to, since the material was not measured elsewhere. */
static void find_symmetry(rgl_brdf *brdf) {
  const double from = (double)btf_get_f32(brdf->phis),
               to = (double)btf_get_f32(brdf->phis + 4 * (size_t)(brdf->phi_count - 1));
  brdf->symmetry = 1;
  brdf->symmetry_middle = (from + to) / 2;
  if (brdf->phi_count <= 2) return;
  const double parts = 2 * 3.14159265358979323846 / (to - from);
  if (parts > 1.5 && parts < 2.5) brdf->symmetry = 2;
  if (parts > 3.5 && parts < 4.5) brdf->symmetry = 4;
}

static btf_status bind(rgl_brdf *brdf, const unsigned char **wavelengths) {
  static const uint64_t any[2] = {0, 0}, one[1] = {1};
  const rgl_field *field;
  BTF_TRY(want_nodes(brdf, "theta_i", &brdf->thetas, &brdf->theta_count));
  BTF_TRY(want_nodes(brdf, "phi_i", &brdf->phis, &brdf->phi_count));
  const uint64_t visible[4] = {brdf->phi_count, brdf->theta_count, 0, 0};
  BTF_TRY(want(brdf, "jacobian", RGL_U8, 1, one, &field));
  brdf->jacobian = field->data[0] != 0;
  BTF_TRY(want_grid(brdf, "ndf", 2, any, &brdf->ndf));
  BTF_TRY(want_grid(brdf, "sigma", 2, any, &brdf->sigma));
  BTF_TRY(want_grid(brdf, "vndf", 4, visible, &brdf->vndf));
  brdf->bands = 3;
  *wavelengths = NULL;
  const bool colour = rgl_find(brdf, "rgb") != NULL;
  if (!colour) BTF_TRY(want_nodes(brdf, "wavelengths", wavelengths, &brdf->bands));
  const uint64_t values[5] = {brdf->phi_count, brdf->theta_count, brdf->bands, 0, 0};
  BTF_TRY(want_grid(brdf, colour ? "rgb" : "spectra", 5, values, &brdf->values));
  brdf->step = (brdf->bands - 1) / RGL_MOST_CHANNELS + 1;
  brdf->base.channels = (brdf->bands - 1) / brdf->step + 1;
  find_symmetry(brdf);
  return rgl_prepare(brdf);
}

/* The description as a note, if it is a line of plain text. */
static bool describe(const rgl_brdf *brdf, char text[256]) {
  const rgl_field *field = rgl_find(brdf, "description");
  if (field == NULL || field->type != RGL_U8 || field->elements == 0 || field->elements > 255) return false;
  for (uint64_t i = 0; i < field->elements; i++)
    if (field->data[i] < 32 || field->data[i] > 126) return false;
  memcpy(text, field->data, field->elements);
  text[field->elements] = '\0';
  return true;
}

static btf_status make(rgl_brdf *brdf, const unsigned char *wavelengths, const btf_options *options,
                       btf_dataset **out) {
  btf_dataset_desc about = BTF_DATASET_DESC_INIT;
  char names[RGL_MOST_CHANNELS][32], text[256], step[16];
  const char *channels[RGL_MOST_CHANNELS], *notes[12] = {"reader", "rgl", "rgl_kind"};
  uint32_t used = 3;
  notes[used++] = brdf->phi_count <= 2 ? "isotropic" : "anisotropic";
  if (describe(brdf, text)) {
    notes[used++] = "rgl_description";
    notes[used++] = text;
  }
  if (brdf->step > 1) {
    snprintf(step, sizeof step, "%u", brdf->step);
    notes[used++] = "rgl_wavelength_step";
    notes[used++] = step;
  }
  for (uint32_t c = 0; wavelengths != NULL && c < brdf->base.channels; c++) {
    snprintf(names[c], sizeof names[c], "%.6g",
             (double)btf_get_f32(wavelengths + 4 * (size_t)c * brdf->step));
    channels[c] = names[c];
  }
  about.channel_names = wavelengths != NULL ? channels : NULL;
  about.color_space = wavelengths != NULL ? "" : NULL;
  about.quantity = BTF_QUANTITY_BRDF_COS;
  about.scale = BTF_SCALE_ABSOLUTE;
  about.notes = notes;
  brdf->base.eval = rgl_eval;
  return one_texel_create(&brdf->base, options, &about, out);
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  const unsigned char *wavelengths;
  one_texel *base;
  BTF_TRY(one_texel_open(host, ctx, path, sizeof(rgl_brdf), &base));
  rgl_brdf *brdf = (rgl_brdf *)base;
  base->drop = drop;
  btf_status status = rgl_read_fields(brdf);
  if (status == BTF_OK) status = bind(brdf, &wavelengths);
  if (status == BTF_OK) return make(brdf, wavelengths, options, out);
  one_texel_close(base);
  return status;
}

const btf_format_vtbl btf_format_rgl = {.struct_size = sizeof(btf_format_vtbl),
                                        .abi = LIBBTF_ABI,
                                        .id = "rgl",
                                        .title = "RGL .bsdf tensor files: BRDFs, RGB or spectral",
                                        .version = "1",
                                        .params = params,
                                        .probe = probe,
                                        .open = open_file};
