/* SPDX-License-Identifier: MIT */
/* source.h: what a material of a description is sampled from. */
#ifndef BTF_TOOLS_SYNTH_SOURCE_H
#define BTF_TOOLS_SYNTH_SOURCE_H

#include "material.h"
#include "watch.h"
#ifdef BTF_EMBREE_MAJOR
#include "tracer.h"
#endif

/* What one material needs to give samples: a structure to trace or an analytic state. */
typedef struct synth_source {
  const synth_material *material;
  void *state;
#ifdef BTF_EMBREE_MAJOR
  mesostructure *meso;
  tracer_lights *lights;
#endif
} synth_source;

/* The material of a description whose sizes make sense. */
btf_status synth_source_find(const synth_desc *desc, const synth_material **out);
/* BTF_E_CANCELLED when the watch, which may be NULL, stops the building. */
btf_status synth_source_open(const synth_desc *desc, const synth_material *material, synth_watch *watch,
                             synth_source *s);
void synth_source_close(synth_source *s);

#endif
