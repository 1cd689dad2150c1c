/* SPDX-License-Identifier: MIT */
/* Making models: by a fit, from a payload, from a data set as it stands. */
#include "model/model.h"

#include <string.h>

/* A fresh model without vtbl and state. */
static btf_status create(btf_context *ctx, btf_model **out) {
  btf_model *model = btfi_calloc(ctx, 1, sizeof *model);
  *out = NULL;
  if (model == NULL) return btfi_alloc_status();
  atomic_init(&model->references, 1);
  model->ctx = ctx;
  btfi_context_retain(ctx);
  *out = model;
  return BTF_OK;
}

static void set_shape(btf_model *model, const btf_dirset *lights, const btf_dirset *views, uint32_t width,
                      uint32_t height, uint32_t channels, uint32_t quantity, uint32_t wrap) {
  model->shape = (btf_model_shape){lights, views, width, height, channels, quantity, wrap, 0};
  model->width = width;
  model->height = height;
  model->channels = channels;
  model->quantity = quantity;
}

/* What evaluation relies on without asking again. */
static btf_status check_levels(btf_model *model) {
  model->levels = model->vtbl->levels(model->state);
  if (model->levels < 1 || model->levels > 32)
    return btfi_fail(model->ctx, BTF_E_PLUGIN, "%s: its state has %u levels; expected 1 to 32",
                     model->vtbl->id, (unsigned)model->levels);
  return BTF_OK;
}

static btf_status check_format(btf_context *ctx, const btf_codec_vtbl *v, uint32_t format) {
  if (format > v->format_write)
    return btfi_fail(ctx, BTF_E_NEWER,
                     "%s: payload version %u is newer than this codec, which reads %u to %u", v->id,
                     (unsigned)format, (unsigned)v->format_read_min, (unsigned)v->format_write);
  if (format < v->format_read_min)
    return btfi_fail(ctx, BTF_E_UNSUPPORTED,
                     "%s: payload version %u is no longer read; this codec reads %u to %u", v->id,
                     (unsigned)format, (unsigned)v->format_read_min, (unsigned)v->format_write);
  return BTF_OK;
}

/* A codec sees only that it got no memory; whether a limit forbade it or there was none is known here. */
static btf_status allocation_status(btf_status of_codec) {
  return of_codec == BTF_E_NOMEM ? btfi_alloc_status() : of_codec;
}

btf_status btfi_model_from_payload(const btf_codec *codec, btfi_payload *payload, btf_model **out) {
  const btf_codec_vtbl *v = btfi_codec_vtbl(codec);
  const btfi_model_header *h = btfi_payload_header(payload);
  btf_context *ctx = btfi_codec_context(codec);
  btf_model *model;
  btf_status status;
  *out = NULL;
  BTFI_TRY(check_format(ctx, v, h->codec_format));
  BTFI_TRY(create(ctx, &model));
  btfi_payload_retain(payload);
  model->payload = payload;
  set_shape(model, h->lights, h->views, h->width, h->height, h->channels, h->quantity, h->wrap);
  status = allocation_status(
      v->load(btfi_host(), ctx, h->codec_format, &model->shape, btfi_payload_reader(payload), &model->state));
  if (status == BTF_OK) {
    model->vtbl = v;
    status = check_levels(model);
  }
  if (status != BTF_OK) {
    btf_model_release(model);
    return status;
  }
  *out = model;
  return BTF_OK;
}

/* `cannot` is NULL where the codec has the function that is wanted. */
static btf_status check_making(const btf_dataset *ds, const btf_codec *codec, const btf_options *options,
                               const char *cannot) {
  const btf_codec_vtbl *v = btfi_codec_vtbl(codec);
  const btf_dataset_desc *desc = btfi_dataset_desc(ds);
  btf_context *ctx = btfi_codec_context(codec);
  if (options != NULL && !btfi_options_are_of(options, codec))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the options are those of %s", v->id,
                     btfi_options_owner(options));
  if (cannot != NULL) return btfi_fail(ctx, BTF_E_UNSUPPORTED, "%s: %s", v->id, cannot);
  if ((v->caps & BTF_CAP_RGB_ONLY) != 0 && desc->channels != 3)
    return btfi_fail(ctx, BTF_E_UNSUPPORTED, "%s: takes data of 3 channels; this data set has %u", v->id,
                     (unsigned)desc->channels);
  return BTF_OK;
}

/* Fills the payload by a fit, or with the factors where there are any. */
static btf_status make_payload(const btf_dataset *ds, const btf_codec *codec, const btf_factors *factors,
                               const btf_options *options, const btf_job *job, btfi_payload *payload) {
  const btf_dataset_desc *desc = btfi_dataset_desc(ds);
  const btf_model_shape shape = {desc->lights,   desc->views,    desc->width, desc->height,
                                 desc->channels, desc->quantity, desc->wrap,  0};
  btf_chunk_writer *writer = btfi_payload_writer(payload);
  btf_options *defaults = NULL;
  btfi_job running;
  btf_status status;
  BTFI_TRY(btfi_job_begin(btfi_codec_context(codec), job, &running));
  if (options == NULL) {
    BTFI_TRY(btf_options_create(codec, &defaults));
    options = defaults;
  }
  status = allocation_status(
      factors == NULL ? btfi_codec_fit(codec, ds, options, &running.desc, writer)
                      : btfi_codec_from_factors(codec, &shape, factors, options, &running.desc, writer));
  btf_options_release(defaults);
  btfi_payload_seal(payload);
  return status;
}

btf_status btf_model_fit(const btf_dataset *ds, const btf_codec *codec, const btf_options *options,
                         const btf_job *job, btf_model **out) {
  uint64_t budget = 0;
  btf_dataset *reader;
  btfi_payload *payload;
  btf_context *ctx;
  btf_status status;
  if (out != NULL) *out = NULL;
  if (ds == NULL || codec == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_model_fit: data set, codec and out must not be NULL");
  ctx = btfi_codec_context(codec);
  BTFI_TRY(
      check_making(ds, codec, options,
                   btfi_codec_vtbl(codec)->fit == NULL ? "this codec only reads; it cannot compress" : NULL));
  if (job != NULL && job->struct_size >= BTFI_SIZE_TO(btf_job, max_working_set))
    budget = job->max_working_set;
  BTFI_TRY(btfi_payload_create(ctx, ds, btf_codec_id(codec), btfi_codec_vtbl(codec)->format_write, &payload));
  /* A small budget of the caller's holds for reading the data as well, and for this fit alone. */
  status = btfi_dataset_within(ds, budget < UINT64_C(1) << 30 ? budget : 0, &reader);
  if (status == BTF_OK) status = make_payload(reader, codec, NULL, options, job, payload);
  btf_dataset_release(reader);
  /* Loading what a file would hold makes the fresh model and the stored one the same. */
  if (status == BTF_OK) status = btfi_model_from_payload(codec, payload, out);
  btfi_payload_release(payload);
  return status;
}

btf_status btf_model_from_factors(const btf_dataset *ds, const btf_codec *codec, const btf_options *options,
                                  const btf_job *job, btf_model **out) {
  btf_factors factors = BTF_FACTORS_INIT;
  btfi_payload *payload;
  btf_status status;
  if (out != NULL) *out = NULL;
  if (ds == NULL || codec == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG,
                     "btf_model_from_factors: data set, codec and out must not be NULL");
  BTFI_TRY(check_making(ds, codec, options,
                        btfi_codec_vtbl(codec)->from_factors == NULL ? "this codec cannot hold given factors"
                                                                     : NULL));
  BTFI_TRY(btf_dataset_factors(ds, &factors));
  BTFI_TRY(btfi_payload_create(btfi_codec_context(codec), ds, btf_codec_id(codec),
                               btfi_codec_vtbl(codec)->format_write, &payload));
  status = make_payload(ds, codec, &factors, options, job, payload);
  if (status == BTF_OK) status = btfi_model_from_payload(codec, payload, out);
  btfi_payload_release(payload);
  return status;
}

btf_status btf_model_from_dataset(const btf_dataset *ds, const btf_job *job, btf_model **out) {
  const btf_dataset_desc *desc;
  btf_context *ctx;
  btfi_job running;
  btf_model *model;
  btf_status status;
  if (out != NULL) *out = NULL;
  if (ds == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_model_from_dataset: data set and out must not be NULL");
  ctx = btfi_dataset_context(ds);
  desc = btfi_dataset_desc(ds);
  BTFI_TRY(btfi_job_begin(ctx, job, &running));
  BTFI_TRY(create(ctx, &model));
  model->dataset = btf_dataset_retain(ds);
  set_shape(model, desc->lights, desc->views, desc->width, desc->height, desc->channels, desc->quantity,
            desc->wrap);
  status = btfi_raw_state(ds, &running.desc, &model->state);
  if (status == BTF_OK) {
    model->vtbl = &btfi_raw_codec;
    status = check_levels(model);
  }
  if (status != BTF_OK) {
    btf_model_release(model);
    return status;
  }
  *out = model;
  return BTF_OK;
}

btf_model *btf_model_retain(const btf_model *model) {
  btf_model *counted = (btf_model *)(uintptr_t)model; /* only the count changes */
  if (counted != NULL) atomic_fetch_add_explicit(&counted->references, 1, memory_order_relaxed);
  return counted;
}

void btf_model_release(btf_model *model) {
  btf_context *ctx;
  if (model == NULL || atomic_fetch_sub_explicit(&model->references, 1, memory_order_acq_rel) != 1) return;
  ctx = model->ctx;
  /* No vtbl: loading failed and the codec has freed what it had. */
  if (model->vtbl != NULL) model->vtbl->destroy(btfi_host(), ctx, model->state);
  btfi_payload_release(model->payload);
  btf_dataset_release(model->dataset);
  btfi_free(ctx, model);
  btf_context_release(ctx);
}

static void describe_payload(const btfi_payload *payload, btf_model_info *info) {
  const btfi_model_header *h = btfi_payload_header(payload);
  info->stored_bytes = btfi_payload_stored_bytes(payload);
  info->color_space = h->color_space;
  info->scale = h->scale;
  info->channel_names = (const char *const *)h->channel_names;
  info->name = h->name;
  info->source = h->source;
  info->license = h->license;
  info->texels_per_mm = h->texels_per_mm;
}

static void describe_dataset(const btf_dataset_desc *desc, btf_model_info *info) {
  info->color_space = desc->color_space;
  info->scale = desc->scale;
  info->channel_names = desc->channel_names;
  info->name = desc->name;
  info->source = desc->source;
  info->license = desc->license;
  info->texels_per_mm = desc->texels_per_mm;
}

btf_status btf_model_describe(const btf_model *model, btf_model_info *io) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  if (model == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_model_describe: the model must not be NULL");
  info.codec_id = model->vtbl->id;
  info.lights = model->shape.lights;
  info.views = model->shape.views;
  info.resident_bytes = model->vtbl->resident_bytes(model->state);
  info.caps = model->vtbl->caps;
  info.width = model->width;
  info.height = model->height;
  info.channels = model->channels;
  info.levels = model->levels;
  info.quantity = model->quantity;
  info.wrap = model->shape.wrap;
  if (model->payload != NULL)
    describe_payload(model->payload, &info);
  else
    describe_dataset(btfi_dataset_desc(model->dataset), &info);
  return btfi_copy_out(model->ctx, "btf_model_info", io, BTFI_SIZE_TO(btf_model_info, texels_per_mm), &info,
                       sizeof info);
}

btf_status btf_model_cost(const btf_model *model, uint32_t flags, btf_eval_cost *io) {
  btf_eval_cost cost = BTF_EVAL_COST_INIT;
  if (model == NULL) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_model_cost: the model must not be NULL");
  if (flags & ~(uint32_t)(BTF_QUERY_NEAREST | BTF_COST_SHARED_DIRECTIONS))
    return btfi_fail(model->ctx, BTF_E_INVALID_ARG, "btf_model_cost: unknown flags %#x", flags);
  if (model->vtbl->cost != NULL) model->vtbl->cost(model->state, flags, &cost);
  return btfi_copy_out(model->ctx, "btf_eval_cost", io, BTFI_SIZE_TO(btf_eval_cost, flops), &cost,
                       sizeof cost);
}
