/* SPDX-License-Identifier: MIT */
#include "crafted_model.h"

#include <math.h>
#include <stdio.h>

#include "codecs/fmf/fmf.h"

extern const btf_codec_vtbl btf_codec_fmf;

static uint64_t random_state = 1;

/* Uniform in -1 .. 1. */
static float random_value(void) {
  random_state = random_state * 6364136223846793005u + 1442695040888963407u;
  return (float)(random_state >> 40) * (1.0f / (1 << 23)) - 1.0f;
}

/* Singular values that fall as those of materials do; columns of about length 1. */
static void fill_factors(btfi_fmf_writing *f) {
  const double norm = sqrt((double)f->factors.length[0] * (double)f->factors.length[1]);
  for (uint32_t k = 0; k < f->factors.components; k++) {
    f->sigma[k] = norm / (1.0 + k);
    for (uint32_t side = 0; side < 2; side++) {
      const uint64_t length = f->factors.length[side];
      const float scale =
          (float)(sqrt(3.0 / (double)length) * (side == FMF_SIDE_V ? f->sigma[k] : 1.0));
      for (uint64_t i = 0; i < length; i++) f->values[side][k * length + i] = scale * random_value();
    }
  }
  f->residual[f->factors.components] = 0.0;
  for (uint32_t k = f->factors.components; k-- > 0;) {
    f->residual[k] = f->residual[k + 1] + f->sigma[k] * f->sigma[k];
    f->head.energy = f->residual[k];
  }
  /* As if data had been truncated at the last component. */
  for (uint32_t k = 0; k <= f->factors.components; k++)
    f->residual[k] += 10.0 * f->sigma[f->factors.components - 1] * f->sigma[f->factors.components - 1];
}

static btf_status craft(const btf_host *host, btf_context *ctx, const btf_dataset *ds, const btf_options *options,
                        const btf_job *job, btf_chunk_writer *payload) {
  btfi_fmf_writing f = {.host = host, .ctx = ctx, .payload = payload, .target = INFINITY};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_status status = host->dataset_describe(ds, &desc);
  (void)job;
  if (status != BTF_OK) return status;
  f.views = host->dirset_count(desc.views);
  f.lights = host->dirset_count(desc.lights);
  f.channels = desc.channels;
  f.width = desc.width;
  f.height = desc.height;
  f.loss = host->option(options, "loss");
  f.head.storage = (uint32_t)host->option(options, "storage");
  f.head.coding = (uint32_t)host->option(options, "coding");
  f.head.levels = host->mip_count(desc.width, desc.height);
  status = btfi_fmf_writing_alloc(&f, (uint32_t)host->option(options, "components"));
  if (status == BTF_OK) {
    fill_factors(&f);
    status = btfi_fmf_choose_components(&f);
  }
  if (status == BTF_OK) status = btfi_fmf_write(&f);
  btfi_fmf_writing_free(&f);
  return status;
}

btf_status crafted_register(btf_context *ctx) {
  btf_codec_vtbl codec = btf_codec_fmf;
  codec.id = "bench.crafted-fmf";
  codec.fit = craft;
  return btf_context_register(ctx, &codec);
}

static btf_status no_samples(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  (void)user;
  (void)block;
  (void)dst;
  (void)strides;
  return btf_source_error(BTF_E_STATE, "a crafted data set has a size and directions but no samples");
}

static btf_status fit_crafted(btf_context *ctx, const btf_dataset *ds, const crafted_size *size, const char *storage,
                              const char *coding, btf_model **out) {
  char components[16];
  btf_options *options;
  const btf_codec *codec = btf_codec_find(ctx, "bench.crafted-fmf");
  btf_status status = btf_options_create(codec, &options);
  if (status != BTF_OK) return status;
  snprintf(components, sizeof components, "%u", size->components);
  status = btf_options_set(options, "components", components);
  if (status == BTF_OK) status = btf_options_set(options, "storage", storage);
  if (status == BTF_OK) status = btf_options_set(options, "coding", coding);
  if (status == BTF_OK) status = btf_model_fit(ds, codec, options, NULL, out);
  btf_options_release(options);
  return status;
}

btf_status crafted_create(btf_context *ctx, const crafted_size *size, const char *storage, const char *coding,
                          btf_model **out) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *directions;
  btf_dataset *ds;
  btf_status status = btf_dirset_create_named(ctx, size->directions, &directions);
  *out = NULL;
  if (status != BTF_OK) return status;
  desc.lights = desc.views = directions;
  desc.width = size->width;
  desc.height = size->height;
  desc.channels = size->channels;
  desc.read = no_samples;
  random_state = 1;
  status = btf_dataset_create(ctx, &desc, &ds);
  btf_dirset_release(directions);
  if (status != BTF_OK) return status;
  status = fit_crafted(ctx, ds, size, storage, coding, out);
  btf_dataset_release(ds);
  return status;
}
