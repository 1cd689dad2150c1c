/* SPDX-License-Identifier: MIT */
/* format.c: UTIA's anisotropic BRDF tables (`.bin`) as a format of libbtf. They have no header. */
#include "source/one_texel.h"

enum {
  ELEVATIONS = 6, /* every 15 degrees from the normal */
  AZIMUTHS = 48,  /* every 7.5 degrees */
  SIDE = ELEVATIONS * AZIMUTHS,
  PLANE = SIDE * SIDE,
  FILE_SIZE = 3 * 8 * PLANE
};
static const double degrees = 180 / 3.14159265358979323846;

static const char *const cosine_choices[] = {"outside", "inside", NULL};
ONE_TEXEL_DIRECTIONS;
BTF_PARAM(cosine, BTF_PARAM_CHOICE,
          "whether values have the cosine of the light in them, which the files do not say", NULL, "outside",
          cosine_choices, 0, 0);
static const btf_param_desc *const params[] = {&directions, &cosine, NULL};

/* Size, and numbers that a reflectance could be: other bytes taken as doubles have exponents all over. */
static uint32_t probe(const btf_host *host, btf_context *ctx, const btf_probe *probe) {
  (void)host, (void)ctx;
  if (probe->is_folder || probe->size != FILE_SIZE) return 0;
  for (uint32_t at = 0; at + 8 <= probe->head_size; at += 8) {
    const double value = fabs(btf_get_f64(probe->head + at));
    if (!(value == 0 || (value > 1e-12 && value < 1e6))) return 0;
  }
  return 40;
}

/* The four samples around a direction and their weights, which add up to 1. Beyond the last ring the
 * elevation goes on in a straight line. */
typedef struct around {
  uint32_t sample[4];
  double weight[4];
} around;

static around locate(const double d[3]) {
  around a;
  const double elevation = atan2(hypot(d[0], d[1]), d[2]) * degrees / 15;
  const double turned = atan2(d[1], d[0]) * degrees / 7.5;
  const double azimuth = turned < 0 ? turned + AZIMUTHS : turned;
  const uint32_t ring = elevation < ELEVATIONS - 2 ? (uint32_t)elevation : ELEVATIONS - 2,
                 step = (uint32_t)azimuth;
  const double up = elevation - ring, on = azimuth - step;
  for (uint32_t i = 0; i < 4; i++) {
    a.sample[i] = AZIMUTHS * (ring + (i >> 1)) + (step + (i & 1)) % AZIMUTHS;
    a.weight[i] = (i >> 1 ? up : 1 - up) * (i & 1 ? on : 1 - on);
  }
  return a;
}

static void eval(const one_texel *brdf, const double light[3], const double view[3], double *out) {
  const around l = locate(light), v = locate(view);
  for (uint32_t c = 0; c < 3; c++) {
    double sum = 0;
    for (int i = 0; i < 4; i++)
      for (int k = 0; k < 4; k++) {
        const double weight = l.weight[i] * v.weight[k];
        if (weight != 0)
          sum += weight * btf_get_f64(brdf->file.data +
                                      8 * (PLANE * (size_t)c + SIDE * (size_t)l.sample[i] + v.sample[k]));
      }
    out[c] = sum < 0 && isfinite(sum) ? 0 : sum;
  }
}

static btf_status open_file(const btf_host *host, btf_context *ctx, const char *path,
                            const btf_options *options, btf_dataset **out) {
  static const char *const notes[] = {"reader", "utia-brdf", NULL};
  btf_dataset_desc about = BTF_DATASET_DESC_INIT;
  one_texel *brdf;
  BTF_TRY(one_texel_open(host, ctx, path, sizeof *brdf, &brdf));
  if (brdf->file.size != FILE_SIZE) {
    const btf_status status = (host->fail)(ctx, brdf->file.size < FILE_SIZE ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                                           "%s: has %llu bytes; a UTIA BRDF has %d", path,
                                           (unsigned long long)brdf->file.size, FILE_SIZE);
    one_texel_close(brdf);
    return status;
  }
  brdf->channels = 3;
  brdf->eval = eval;
  about.quantity = (int)(host->option)(options, "cosine") == 1 ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
  about.notes = notes;
  return one_texel_create(brdf, options, &about, out);
}

const btf_format_vtbl btf_format_utia_brdf = {.struct_size = sizeof(btf_format_vtbl),
                                              .abi = LIBBTF_ABI,
                                              .id = "utia-brdf",
                                              .title =
                                                  "UTIA BRDF .bin: anisotropic BRDFs, 288 x 288 directions",
                                              .version = "1",
                                              .params = params,
                                              .probe = probe,
                                              .open = open_file};
