/* SPDX-License-Identifier: MIT */
#include "dataset/dataset_parts.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <btf/btf_plugin.h>

btf_context *btfi_dataset_context(const btf_dataset *ds) {
  return ds->ctx;
}
const btf_dataset_desc *btfi_dataset_desc(const btf_dataset *ds) {
  return &ds->desc;
}
const btf_interp *btfi_dataset_light_weights(const btf_dataset *ds) {
  return ds->light_weights;
}

/* ---- checks ---- */

btf_status btfi_dataset_check_shape(btf_context *ctx, const char *label, const btf_dataset_desc *d) {
  const btf_limits *limits = btfi_limits(ctx);
  if (!d->lights || !d->views)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: %s directions are missing", label,
                     d->lights ? "view" : "light");
  if (d->width == 0 || d->height == 0 || d->channels == 0)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: %u x %u texels of %u channels; expected at least 1 of each",
                     label, d->width, d->height, d->channels);
  const uint32_t most_texels = BTFI_MIN(limits->max_dimension, 1u << 24);
  const uint32_t most_channels = BTFI_MIN(limits->max_channels, 64u);
  if (d->width > most_texels || d->height > most_texels)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %u x %u texels; the limit is %u along a side", label, d->width,
                     d->height, most_texels);
  if (d->channels > most_channels)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %u channels; the limit is %u", label, d->channels, most_channels);
  if (btfi_sample_size(d->sample_type) == 0)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: sample type %u is unknown", label, d->sample_type);
  if (d->quantity != BTF_QUANTITY_BRDF && d->quantity != BTF_QUANTITY_BRDF_COS)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: quantity %u is unknown", label, d->quantity);
  if (d->scale != BTF_SCALE_RELATIVE && d->scale != BTF_SCALE_ABSOLUTE)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: scale %u is unknown", label, d->scale);
  if (d->wrap != BTF_WRAP_PERIODIC && d->wrap != BTF_WRAP_CLAMP)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: wrap %u is unknown", label, d->wrap);
  if (d->flags & ~(uint32_t)(BTF_DATASET_CONCURRENT_READ | BTF_DATASET_IMAGE_MAJOR))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: flags 0x%x are unknown", label, d->flags);
  if (!(d->texels_per_mm >= 0.0 && d->texels_per_mm <= 1e12))
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "%s: %g texels per mm; expected a number above 0, or 0 for unknown", label,
                     d->texels_per_mm);
  if (d->channel_names)
    for (uint32_t c = 0; c < d->channels; ++c)
      if (!d->channel_names[c])
        return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: name of channel %u is NULL", label, c);
  uint64_t bytes = btfi_sample_size(d->sample_type);
  const uint64_t factors[] = {d->channels, d->width, d->height, btf_dirset_count(d->lights),
                              btf_dirset_count(d->views)};
  for (size_t i = 0; i < sizeof factors / sizeof factors[0]; ++i)
    if (!btfi_mul(bytes, factors[i], &bytes) || bytes > INT64_MAX)
      return btfi_fail(ctx, BTF_E_LIMIT, "%s: more than 2^63 bytes of samples", label);
  return BTF_OK;
}

/* Every sample must lie within the address range of a ptrdiff_t from the first. */
static btf_status check_strides(btf_context *ctx, const char *label, const btf_dataset_desc *d,
                                uint32_t most_lights) {
  const btf_strides *s = &d->strides;
  const ptrdiff_t stride[] = {s->view, s->light, s->y, s->x, s->channel};
  const uint32_t count[] = {btf_dirset_count(d->views), most_lights, d->height, d->width, d->channels};
  ptrdiff_t low = 0, high = 0;
  for (int k = 0; k < 5; ++k) {
    ptrdiff_t reach;
    ptrdiff_t *end = stride[k] < 0 ? &low : &high;
    if (__builtin_mul_overflow(stride[k], (ptrdiff_t)(count[k] - 1), &reach) ||
        __builtin_add_overflow(*end, reach, end))
      return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the strides reach beyond the address space", label);
  }
  return BTF_OK;
}

/* ---- texts and directions ---- */

static const char *default_channel_name(uint32_t channels, uint32_t c, char text[8]) {
  if (channels == 1) return "Y";
  if (channels == 3) return c == 0 ? "R" : c == 1 ? "G" : "B";
  snprintf(text, 8, "C%u", c % 1000);
  return text;
}

static btf_status copy_text(btf_context *ctx, const char **text) {
  if (!*text) return BTF_OK;
  *text = btfi_strdup(ctx, *text);
  return *text ? BTF_OK : btfi_alloc_status();
}

static btf_status copy_channel_names(btf_context *ctx, btf_dataset_desc *d, const char *const *names) {
  char **copy = btfi_calloc(ctx, d->channels, sizeof *copy);
  if (!copy) return btfi_alloc_status();
  d->channel_names = (const char *const *)copy;
  for (uint32_t c = 0; c < d->channels; ++c) {
    char text[8];
    copy[c] = btfi_strdup(ctx, names ? names[c] : default_channel_name(d->channels, c, text));
    if (!copy[c]) return btfi_alloc_status();
  }
  return BTF_OK;
}

static btf_status copy_view_lights(btf_context *ctx, btf_dataset_desc *d, const btf_dirset *const *sets) {
  if (!sets) return BTF_OK;
  const uint32_t views = btf_dirset_count(d->views);
  const btf_dirset **copy = btfi_calloc(ctx, views, sizeof *copy);
  if (!copy) return btfi_alloc_status();
  d->view_lights = copy;
  for (uint32_t v = 0; v < views; ++v) copy[v] = btf_dirset_retain(sets[v]);
  return BTF_OK;
}

static btf_status copy_notes(btf_context *ctx, btf_dataset_desc *d, const char *const *notes) {
  uint32_t count = 0;
  if (!notes) return BTF_OK;
  while (notes[count]) count++;
  char **copy = btfi_calloc(ctx, (uint64_t)count + 1, sizeof *copy);
  if (!copy) return btfi_alloc_status();
  d->notes = (const char *const *)copy;
  for (uint32_t i = 0; i < count; ++i)
    if (!(copy[i] = btfi_strdup(ctx, notes[i]))) return btfi_alloc_status();
  return BTF_OK;
}

btf_status btfi_dataset_copy_texts(btf_context *ctx, btf_dataset_desc *d) {
  const btf_dataset_desc user = *d;
  d->channel_names = NULL;
  d->color_space = d->name = d->source = d->license = NULL;
  d->view_lights = NULL;
  d->notes = NULL;
  d->lights = btf_dirset_retain(user.lights);
  d->views = btf_dirset_retain(user.views);
  btf_status status = copy_channel_names(ctx, d, user.channel_names);
  const char *color_space = user.color_space;
  if (!color_space) color_space = d->channels == 3 && !user.channel_names ? "lin_rec709" : "";
  if (!user.color_space && d->channels == 3 && user.channel_names && !strcmp(user.channel_names[0], "R") &&
      !strcmp(user.channel_names[1], "G") && !strcmp(user.channel_names[2], "B"))
    color_space = "lin_rec709";
  const char *const from[] = {color_space, user.name, user.source, user.license};
  const char **const to[] = {&d->color_space, &d->name, &d->source, &d->license};
  for (int i = 0; i < 4 && status == BTF_OK; ++i) {
    const char *text = from[i];
    status = copy_text(ctx, &text);
    if (status == BTF_OK) *to[i] = text;
  }
  if (status == BTF_OK) status = copy_view_lights(ctx, d, user.view_lights);
  if (status == BTF_OK) status = copy_notes(ctx, d, user.notes);
  if (status != BTF_OK) btfi_dataset_free_texts(ctx, d);
  return status;
}

void btfi_dataset_free_texts(btf_context *ctx, btf_dataset_desc *d) {
  if (d->channel_names)
    for (uint32_t c = 0; c < d->channels; ++c) btfi_free(ctx, (char *)(uintptr_t)d->channel_names[c]);
  btfi_free(ctx, (void *)(uintptr_t)d->channel_names);
  const char *const texts[] = {d->color_space, d->name, d->source, d->license};
  for (int i = 0; i < 4; ++i) btfi_free(ctx, (char *)(uintptr_t)texts[i]);
  for (uint32_t i = 0; d->notes && d->notes[i]; ++i) btfi_free(ctx, (char *)(uintptr_t)d->notes[i]);
  btfi_free(ctx, (void *)(uintptr_t)d->notes);
  if (d->view_lights)
    for (uint32_t v = 0, views = btf_dirset_count(d->views); v < views; ++v)
      btf_dirset_release((btf_dirset *)(uintptr_t)d->view_lights[v]);
  btfi_free(ctx, (void *)(uintptr_t)d->view_lights);
  btf_dirset_release((btf_dirset *)(uintptr_t)d->lights);
  btf_dirset_release((btf_dirset *)(uintptr_t)d->views);
}

btf_strides btfi_dense_strides(const btf_dataset_desc *d, uint32_t order, ptrdiff_t size) {
  btf_strides s;
  const ptrdiff_t lights = (ptrdiff_t)btf_dirset_count(d->lights),
                  views = (ptrdiff_t)btf_dirset_count(d->views);
  s.channel = size;
  if (order == BTF_ORDER_YXVLC) {
    s.light = s.channel * (ptrdiff_t)d->channels;
    s.view = s.light * lights;
    s.x = s.view * views;
    s.y = s.x * (ptrdiff_t)d->width;
  } else {
    s.x = s.channel * (ptrdiff_t)d->channels;
    s.y = s.x * (ptrdiff_t)d->width;
    s.light = s.y * (ptrdiff_t)d->height;
    s.view = s.light * lights;
  }
  return s;
}

/* ---- life ---- */

/* Keys of notes become keys of a manifest and of a container's metadata. */
static btf_status check_notes(btf_context *ctx, const char *label, const char *const *notes) {
  for (uint32_t i = 0; notes && notes[i]; i += 2) {
    if (i >= 512) return btfi_fail(ctx, BTF_E_LIMIT, "%s: more than 256 notes", label);
    if (!notes[i + 1])
      return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the note %.80s has no text", label, notes[i]);
  }
  return BTF_OK;
}

static btf_status check_source(btf_context *ctx, const char *label, btf_dataset_desc *d) {
  static const btf_strides none = {0, 0, 0, 0, 0};
  uint32_t most_lights = btf_dirset_count(d->lights);
  if (!d->data == !d->read)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: expected either resident samples or a source to read from",
                     label);
  if (d->view_lights)
    for (uint32_t v = 0, views = btf_dirset_count(d->views); v < views; ++v) {
      if (!d->view_lights[v])
        return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the light directions of view %u are missing", label, v);
      most_lights = BTFI_MAX(most_lights, btf_dirset_count(d->view_lights[v]));
    }
  if (d->factors && (d->data || d->view_lights))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: factors are for a source whose views have the same lights",
                     label);
  if (!d->data) return BTF_OK;
  if (memcmp(&d->strides, &none, sizeof none) == 0) {
    if (d->view_lights)
      return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: resident samples with lights per view need strides",
                       label);
    d->strides = btfi_dense_strides(d, BTF_ORDER_VLYXC, (ptrdiff_t)btfi_sample_size(d->sample_type));
  }
  const ptrdiff_t x = d->strides.x, light = d->strides.light;
  d->flags |= BTF_DATASET_CONCURRENT_READ;
  if ((x < 0 ? -x : x) < (light < 0 ? -light : light)) d->flags |= BTF_DATASET_IMAGE_MAJOR;
  return check_strides(ctx, label, d, most_lights);
}

static btf_status fill(btf_dataset *ds, const btf_dataset_desc *desc, const char *label) {
  btf_context *ctx = ds->ctx;
  btf_dataset_desc d = *desc;
  BTFI_TRY(btfi_dataset_check_shape(ctx, label, &d));
  BTFI_TRY(check_source(ctx, label, &d));
  BTFI_TRY(check_notes(ctx, label, d.notes));
  ds->label = btfi_strdup(ctx, label);
  if (!ds->label) return btfi_alloc_status();
  ds->kernels = btfi_convert_select(d.sample_type, btfi_isa(ctx));
  BTFI_TRY(btfi_dataset_copy_texts(ctx, &d));
  ds->desc = d;
  return d.view_lights ? btfi_per_view_prepare(ds) : BTF_OK;
}

static void drop(btf_dataset *ds) {
  btf_context *ctx = ds->ctx;
  if (ds->whole) {
    btf_dataset_release(ds->whole);
  } else {
    if (ds->desc.lights) btfi_dataset_free_texts(ctx, &ds->desc);
    btfi_free(ctx, ds->light_weights);
    btfi_free(ctx, ds->label);
    btfi_unmap(&ds->mapping);
  }
  pthread_mutex_destroy(&ds->one_reader);
  btfi_free(ctx, ds);
  btf_context_release(ctx);
}

btf_status btfi_dataset_make(btf_context *ctx, const btf_dataset_desc *desc, const char *label,
                             const btfi_mapping *mapping, btf_dataset **out) {
  btf_dataset *ds = btfi_calloc(ctx, 1, sizeof *ds);
  btf_status status = ds ? BTF_OK : btfi_alloc_status();
  if (ds) {
    ds->ctx = ctx;
    btfi_context_retain(ctx);
    pthread_mutex_init(&ds->one_reader, NULL);
    atomic_init(&ds->references, 1);
    if (mapping) ds->mapping = *mapping;
    if (!label) label = desc->name && desc->name[0] ? desc->name : "data set";
    status = fill(ds, desc, label);
  } else if (mapping) {
    btfi_mapping unused = *mapping;
    btfi_unmap(&unused);
  }
  if (status != BTF_OK) {
    if (ds) drop(ds);
    if (desc->release) desc->release(desc->user);
    return status;
  }
  *out = ds;
  return BTF_OK;
}

btf_status btf_dataset_create(btf_context *ctx, const btf_dataset_desc *desc, btf_dataset **out) {
  btf_dataset_desc own;
  if (out) *out = NULL;
  if (!ctx || !desc || !out) {
    /* What the description owns passes to the library whatever fails. */
    if (desc &&
        btfi_copy_in(ctx, "btf_dataset_desc", &own, sizeof own, BTFI_SIZE_TO(btf_dataset_desc, view_lights),
                     desc) == BTF_OK &&
        own.release)
      own.release(own.user);
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "btf_dataset_create: context, description and result must not be NULL");
  }
  BTFI_TRY(btfi_copy_in(ctx, "btf_dataset_desc", &own, sizeof own,
                        BTFI_SIZE_TO(btf_dataset_desc, view_lights), desc));
  return btfi_dataset_make(ctx, &own, NULL, NULL, out);
}

btf_dataset *btf_dataset_retain(const btf_dataset *ds) {
  btf_dataset *own = (btf_dataset *)(uintptr_t)ds;
  if (own) atomic_fetch_add_explicit(&own->references, 1, memory_order_relaxed);
  return own;
}

void btf_dataset_release(btf_dataset *ds) {
  if (!ds || atomic_fetch_sub_explicit(&ds->references, 1, memory_order_acq_rel) != 1) return;
  void (*release)(void *user) = ds->desc.release;
  void *user = ds->desc.user;
  drop(ds);
  if (release) release(user);
}

btf_status btf_dataset_describe(const btf_dataset *ds, btf_dataset_desc *io) {
  if (!ds || !io)
    return btfi_fail(NULL, BTF_E_INVALID_ARG,
                     "btf_dataset_describe: data set and description must not be NULL");
  btf_dataset_desc shown = ds->desc;
  /* The source belongs to this data set; a second one made from the description must not release it again. */
  shown.read = NULL;
  shown.release = NULL;
  shown.user = NULL;
  shown.factors = NULL;
  return btfi_copy_out(ds->ctx, "btf_dataset_desc", io, BTFI_SIZE_TO(btf_dataset_desc, view_lights), &shown,
                       sizeof shown);
}

btf_status btf_dataset_factors(const btf_dataset *ds, btf_factors *io) {
  btf_factors factors = BTF_FACTORS_INIT;
  if (!ds) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_dataset_factors: the data set must not be NULL");
  if (ds->desc.view_lights)
    return btfi_fail(ds->ctx, BTF_E_UNSUPPORTED,
                     "%s: its views have lights of their own, and no factors are of the samples between them",
                     ds->label);
  if (!ds->desc.factors)
    return btfi_fail(ds->ctx, BTF_E_UNSUPPORTED, "%s: holds samples and no factors", ds->label);
  BTFI_TRY(ds->desc.factors(ds->desc.user, &factors));
  const uint32_t views = btf_dirset_count(ds->desc.views);
  if ((factors.products != 1 && factors.products != views) || !factors.components || !factors.column ||
      (factors.value_bytes != 2 && factors.value_bytes != 4))
    return btfi_fail(ds->ctx, BTF_E_INVALID_ARG,
                     "%s: %u products of values of %u bytes; expected 1 or %u, of 2 or 4", ds->label,
                     factors.products, factors.value_bytes, views);
  for (uint32_t p = 0; p < factors.products; ++p)
    if (factors.components[p] == 0)
      return btfi_fail(ds->ctx, BTF_E_INVALID_ARG, "%s: product %u has no components", ds->label, p);
  return btfi_copy_out(ds->ctx, "btf_factors", io, BTFI_SIZE_TO(btf_factors, user), &factors, sizeof factors);
}
