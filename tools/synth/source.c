/* SPDX-License-Identifier: MIT */
#include "source.h"

#include <string.h>

void synth_source_close(synth_source *s) {
  if (s->material != NULL && s->material->end != NULL && s->state != NULL) s->material->end(s->state);
#ifdef BTF_EMBREE_MAJOR
  meso_free(s->meso);
  tracer_lights_free(s->lights);
#endif
  memset(s, 0, sizeof *s);
}

btf_status synth_source_find(const synth_desc *desc, const synth_material **out) {
  *out = synth_find(desc->name);
  if (*out == NULL)
    return synth_needs_rays(desc->name)
               ? btf_source_error(BTF_E_UNSUPPORTED,
                                  "%s: this build has no Embree and makes analytic materials only",
                                  desc->name)
               : btf_source_error(BTF_E_INVALID_ARG, "%s: no such material", desc->name);
  if (desc->width == 0 || desc->height == 0 || desc->spp == 0)
    return btf_source_error(BTF_E_INVALID_ARG, "%s: width, height and samples must be at least 1",
                            desc->name);
  return BTF_OK;
}

btf_status synth_source_open(const synth_desc *desc, const synth_material *material, synth_watch *watch,
                             synth_source *s) {
  btf_status status = BTF_OK;
  memset(s, 0, sizeof *s);
  s->material = material;
  if (s->material->fill != NULL)
    status = s->material->prepare(desc->width, desc->height, desc->seed, &s->state);
#ifdef BTF_EMBREE_MAJOR
  if (s->material->fill == NULL) {
    status = tracer_lights_create(desc->lights, &s->lights);
    if (status == BTF_OK) status = meso_create(s->material, desc->seed, watch, &s->meso);
  }
#else
  (void)watch;
#endif
  if (status != BTF_OK) synth_source_close(s);
  return status;
}
