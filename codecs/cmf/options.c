/* SPDX-License-Identifier: MIT */
/* options.c: the options of a fit, and what they exclude. */
#include "fit.h"

static btf_status read_chain(btfi_cmf_fitting *f, const btf_options *options) {
  const btf_host *host = f->host;
  const char *text = host->option_text(options, "chain"), *wrong;
  if (text == NULL || *text == '\0') text = host->option(options, "factors") < 4.0 ? "h,io" : "hd,io";
  wrong = btfi_cmf_parse_chain(text, &f->settings);
  if (wrong != NULL) return host->fail(f->ctx, BTF_E_INVALID_ARG, "cmf: chain \"%s\": %s", text, wrong);
  if (f->settings.method != CMF_HOMOMORPHIC) return BTF_OK;
  uint32_t maps = 0;
  for (uint32_t s = 0; s < f->settings.stage_count; s++) {
    if (f->settings.stage[s].terms > 1)
      return host->fail(f->ctx, BTF_E_INVALID_ARG,
                        "cmf: chain \"%s\": the homomorphic method has one term a stage", text);
    maps += f->settings.stage[s].mean ? 1 : 2;
  }
  if (maps > CMF_HF_MAX_MAPS)
    return host->fail(f->ctx, BTF_E_INVALID_ARG,
                      "cmf: chain \"%s\": the homomorphic method takes at most %d factors", text,
                      CMF_HF_MAX_MAPS);
  return BTF_OK;
}

/* Refuses what the method, the storage or the chain leaves without effect. */
static btf_status refuse_unused(const btfi_cmf_fitting *f, const btf_options *options) {
  static const char *const of_stages[] = {"residue", "sweeps",     "average",   "epsilon",
                                          "grid",    "resolution", "symmetric", NULL};
  static const char *const of_logarithms[] = {"lambda", "log_floor", NULL};
  const btf_host *host = f->host;
  const bool homomorphic = f->settings.method == CMF_HOMOMORPHIC;
  const char *const *const unused = homomorphic ? of_stages : of_logarithms;
  const char *const chain = host->option_text(options, "chain");
  for (size_t i = 0; unused[i] != NULL; i++)
    if (host->option_is_set(options, unused[i]))
      return host->fail(f->ctx, BTF_E_INVALID_ARG, "cmf: %s has no effect %s method=homomorphic", unused[i],
                        homomorphic ? "with" : "without");
  if (f->storage != CMF_U8 && host->option_is_set(options, "full_scale"))
    return host->fail(f->ctx, BTF_E_INVALID_ARG, "cmf: full_scale has no effect without storage=u8");
  if (chain != NULL && *chain != '\0' && host->option_is_set(options, "factors"))
    return host->fail(f->ctx, BTF_E_INVALID_ARG, "cmf: factors has no effect with a chain, \"%s\"", chain);
  return BTF_OK;
}

btf_status btfi_cmf_read_options(btfi_cmf_fitting *f, const btf_options *options) {
  const btf_host *host = f->host;
  btfi_cmf_settings *s = &f->settings;
  s->method = (uint32_t)host->option(options, "method");
  f->storage = (uint32_t)host->option(options, "storage");
  BTF_TRY(refuse_unused(f, options));
  s->residue = (uint32_t)host->option(options, "residue");
  s->average = (uint32_t)host->option(options, "average");
  s->symmetric = host->option(options, "symmetric") != 0.0;
  s->grid = (uint32_t)host->option(options, "grid");
  s->resolution = (uint32_t)host->option(options, "resolution");
  s->map = host->option(options, "map") == 0.0 ? CMF_PARABOLIC : CMF_CUBE;
  s->edge = (uint32_t)host->option(options, "edge");
  s->sweeps = (uint32_t)host->option(options, "sweeps");
  s->epsilon = host->option(options, "epsilon");
  f->entries = (uint32_t)host->option(options, "codebook");
  f->clustering = (uint32_t)host->option(options, "cluster");
  f->wanted_samples = (uint64_t)host->option(options, "samples");
  f->rotate = host->option(options, "rotate") != 0.0;
  f->lambda = host->option(options, "lambda");
  f->floor = host->option(options, "log_floor");
  f->full_is_largest = host->option(options, "full_scale") != 0.0;
  f->advise = host->option(options, "advise");
  f->levels = (uint32_t)host->option(options, "levels");
  if (f->wanted_samples == 0) f->wanted_samples = UINT32_MAX;
  f->has_target = host->option(options, "psnr") > 0.0 || host->option(options, "rmse") > 0.0;
  return read_chain(f, options);
}
