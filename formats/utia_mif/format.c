/* SPDX-License-Identifier: MIT */
/* format.c: UTIA's `.mif` containers as a format of libbtf. */
#include <btf/btf_half.h>

#include "utia_mif/mif.h"

static const char *const colours[] = {"xyz", "rgb", NULL};
static const char *const cosine_choices[] = {"inside", "outside", NULL};
BTF_PARAM(colour, BTF_PARAM_CHOICE,
          "what three planes are: CIE XYZ, converted to linear Rec. 709, or that already", NULL, "xyz",
          colours, 0, 0);
BTF_PARAM(cosine, BTF_PARAM_CHOICE,
          "whether samples have the cosine of the light in them, which the files do not say", NULL, "inside",
          cosine_choices, 0, 0);
static const btf_param_desc *const params[] = {&colour, &cosine, NULL};

static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  return !probe->is_folder && mif_is_signature(probe->head, probe->head_size) ? 100 : 0;
}

static void release(void *user) {
  mif_file *mif = user;
  const btf_host *host = mif->file.host;
  btf_context *ctx = mif->file.ctx;
  (host->dirset_release)(mif->lights);
  (host->dirset_release)(mif->views);
  (host->free)(ctx, mif->images);
  source_file_close(&mif->file);
  (host->free)(ctx, mif);
}

static double number(const unsigned char *p, uint32_t type) {
  if (type == 9) return (double)btf_half_to_float((uint16_t)(p[0] | p[1] << 8));
  return type == 10 ? (double)btf_get_f32(p) : btf_get_f64(p);
}

/* White is 100. */
static void pixel(const mif_file *mif, const unsigned char *p, float *out) {
  static const double from_xyz[3][3] = {{3.2404542, -1.5371385, -0.4985314},
                                        {-0.9692660, 1.8760108, 0.0415560},
                                        {0.0556434, -0.2040259, 1.0572252}};
  const size_t size = mif->type == 9 ? 2 : mif->type == 10 ? 4 : 8;
  double values[3] = {0, 0, 0};
  for (uint32_t c = 0; c < mif->channels; c++) values[c] = number(p + c * size, mif->type) / 100;
  for (uint32_t c = 0; c < mif->channels; c++)
    out[c] =
        (float)(mif->xyz && mif->channels == 3
                    ? from_xyz[c][0] * values[0] + from_xyz[c][1] * values[1] + from_xyz[c][2] * values[2]
                    : values[c]);
}

static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const mif_file *mif = user;
  const size_t size = (mif->type == 9 ? 2 : mif->type == 10 ? 4 : 8) * (size_t)mif->channels;
  for (uint32_t v = 0; v < block->views; v++)
    for (uint32_t l = 0; l < block->lights; l++) {
      const unsigned char *image =
          mif->images[(size_t)(block->view0 + v) * mif->light_count + block->light0 + l];
      for (uint32_t y = 0; y < block->height; y++) {
        /* The first row of a picture is the top one. */
        const unsigned char *row = image + size * mif->width * (mif->height - 1 - block->y0 - y);
        for (uint32_t x = 0; x < block->width; x++) {
          float values[3];
          pixel(mif, row + size * (block->x0 + x), values);
          for (uint32_t c = 0; c < mif->channels; c++)
            memcpy((char *)dst + (ptrdiff_t)v * strides->view + (ptrdiff_t)l * strides->light +
                       (ptrdiff_t)y * strides->y + (ptrdiff_t)x * strides->x +
                       (ptrdiff_t)c * strides->channel,
                   &values[c], sizeof values[c]);
        }
      }
    }
  return BTF_OK;
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  static const char *const notes[] = {"reader", "utia-mif", NULL};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  mif_file *mif = (host->alloc)(ctx, 1, sizeof *mif);
  if (mif == NULL) return BTF_E_NOMEM;
  *mif = (mif_file){.xyz = (int)(host->option)(options, "colour") == 0};
  btf_status status = source_file_open(host, ctx, path, &mif->file);
  if (status != BTF_OK) {
    (host->free)(ctx, mif);
    return status;
  }
  status = mif_parse(mif);
  if (status != BTF_OK) {
    release(mif);
    return status;
  }
  char name[SOURCE_NAME_BYTES];
  source_name(path, name);
  desc.lights = mif->lights;
  desc.views = mif->views;
  desc.width = mif->width;
  desc.height = mif->height;
  desc.channels = mif->channels;
  desc.quantity = (int)(host->option)(options, "cosine") == 0 ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
  desc.flags = BTF_DATASET_CONCURRENT_READ | BTF_DATASET_IMAGE_MAJOR;
  desc.name = name;
  desc.read = read_block;
  desc.user = mif;
  desc.release = release;
  desc.notes = notes;
  return (host->dataset_create)(ctx, &desc, out);
}

const btf_format_vtbl btf_format_utia_mif = {.struct_size = sizeof(btf_format_vtbl),
                                             .abi = LIBBTF_ABI,
                                             .id = "utia-mif",
                                             .title = "UTIA .mif: containers of BTF images",
                                             .version = "1",
                                             .params = params,
                                             .probe = probe,
                                             .open = open_file};
