/* SPDX-License-Identifier: MIT */
/* sampler.c: one texel at a time. */
#include <stdlib.h>

#include "source.h"

struct synth_sampler {
  synth_source source;
  synth_desc desc;
#ifdef BTF_EMBREE_MAJOR
  tracer *tracer;
#endif
};

btf_status synth_sampler_create(const synth_desc *desc, synth_sampler **out) {
  synth_sampler *s = calloc(1, sizeof *s);
  const synth_material *material;
  btf_status status;
  *out = NULL;
  if (s == NULL) return btf_source_error(BTF_E_NOMEM, "%s: out of memory", desc->name);
  s->desc = *desc;
  status = synth_source_find(desc, &material);
  if (status == BTF_OK) status = synth_source_open(desc, material, NULL, &s->source);
#ifdef BTF_EMBREE_MAJOR
  if (status == BTF_OK && s->source.meso != NULL)
    status = tracer_create(s->source.meso, s->source.lights, desc, 0, &s->tracer);
#endif
  if (status != BTF_OK) {
    synth_sampler_free(s);
    return status;
  }
  *out = s;
  return BTF_OK;
}

void synth_sampler_texel(synth_sampler *s, uint32_t x, uint32_t y, const float view[3], float *rgb) {
  if (s->source.material->fill != NULL) {
    const analytic_block block = {
        x, y, 1, 1, view, btf_dirset_directions(s->desc.lights), btf_dirset_count(s->desc.lights), 3, 3, 3};
    s->source.material->fill(s->source.state, &block, rgb);
  }
#ifdef BTF_EMBREE_MAJOR
  else {
    tracer_texel(s->tracer, x, y, vec3_load(view), rgb, 3, 1);
  }
#endif
}

bool synth_sampler_hit(synth_sampler *s, uint32_t x, uint32_t y, const float view[3], uint32_t *part,
                       float position[3]) {
#ifdef BTF_EMBREE_MAJOR
  surface_hit hit;
  const float u = ((float)x + 0.5f) / (float)s->desc.width, v = ((float)y + 0.5f) / (float)s->desc.height;
  if (s->tracer != NULL && tracer_first_hit(s->tracer, u, v, vec3_load(view), &hit)) {
    *part = hit.part;
    vec3_store(position, hit.position);
    position[2] -= s->source.meso->top;
    return true;
  }
#else
  (void)s, (void)x, (void)y, (void)view, (void)part, (void)position;
#endif
  return false;
}

void synth_sampler_free(synth_sampler *s) {
  if (s == NULL) return;
#ifdef BTF_EMBREE_MAJOR
  tracer_free(s->tracer);
#endif
  synth_source_close(&s->source);
  free(s);
}
