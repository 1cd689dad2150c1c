/* SPDX-License-Identifier: MIT */
/* format.c: MERL `.binary` files as a format of libbtf. */
#include "merl/merl.h"

static const char *const lookups[] = {"nearest", "linear", NULL};
ONE_TEXEL_DIRECTIONS;
BTF_PARAM(
    lookup, BTF_PARAM_CHOICE,
    "nearest takes the bin, as the database's own reader does; linear interpolates between measured bins",
    NULL, "nearest", lookups, 0, 0);
static const btf_param_desc *const params[] = {&directions, &lookup, NULL};

static bool has_header(const unsigned char *data) {
  return btf_get_u32(data) == MERL_THETA_H && btf_get_u32(data + 4) == MERL_THETA_D &&
         btf_get_u32(data + 8) == MERL_PHI_D;
}

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && probe->head_size >= MERL_HEADER && has_header(probe->head) ? 90 : 0;
}

static btf_status check(const source_file *file) {
  if (file->size < MERL_HEADER || !has_header(file->data))
    return (file->host->fail)(file->ctx, BTF_E_NOT_BTF,
                              "%s: does not begin with the numbers of bins of a MERL file, %d, %d and %d",
                              file->path, MERL_THETA_H, MERL_THETA_D, MERL_PHI_D);
  if (file->size != MERL_SIZE)
    return (file->host->fail)(file->ctx, file->size < MERL_SIZE ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                              "%s: has %llu bytes; a MERL file has %d", file->path,
                              (unsigned long long)file->size, MERL_SIZE);
  return BTF_OK;
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  const int choice = (int)(host->option)(options, "lookup");
  const char *const notes[] = {"reader", "merl", "merl_lookup", lookups[choice], NULL};
  btf_dataset_desc about = BTF_DATASET_DESC_INIT;
  one_texel *brdf;
  BTF_TRY(one_texel_open(host, ctx, path, sizeof *brdf, &brdf));
  const btf_status status = check(&brdf->file);
  if (status != BTF_OK) {
    one_texel_close(brdf);
    return status;
  }
  brdf->channels = 3;
  brdf->eval = choice == 1 ? merl_linear : merl_nearest;
  about.quantity = BTF_QUANTITY_BRDF;
  about.scale = BTF_SCALE_ABSOLUTE;
  about.notes = notes;
  return one_texel_create(brdf, options, &about, out);
}

const btf_format_vtbl btf_format_merl = {.struct_size = sizeof(btf_format_vtbl),
                                         .abi = LIBBTF_ABI,
                                         .id = "merl",
                                         .title =
                                             "MERL .binary: isotropic BRDFs over half and difference angles",
                                         .version = "1",
                                         .params = params,
                                         .probe = probe,
                                         .open = open_file};
