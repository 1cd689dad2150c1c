/* SPDX-License-Identifier: MIT */
#include "mesostructure.h"

#include <stdlib.h>
#include <string.h>

/* A ray almost along the plane may cross very many tiles before it leaves the structure; beyond this it
 * counts as gone. */
#define MAX_WRAPS 2000

static btf_status embree_failure(mesostructure *m) {
  const enum RTCError error = rtcGetDeviceError(m->device);
  return btf_source_error(error == RTC_ERROR_OUT_OF_MEMORY ? BTF_E_NOMEM : BTF_E_UNSUPPORTED,
                          "%s: Embree could not build the structure (error %d)", m->material->name,
                          (int)error);
}

void meso_free(mesostructure *m) {
  if (m == NULL) return;
  if (m->scene != NULL) rtcReleaseScene(m->scene);
  if (m->device != NULL) rtcReleaseDevice(m->device);
  for (uint32_t i = 0; i < MESO_MAX_PARTS; ++i) {
    free(m->parts[i].vertices);
    free(m->parts[i].triangles);
    free(m->parts[i].spheres);
  }
  free(m);
}

static void find_extent(mesostructure *m) {
  m->top = -1e30f;
  m->bottom = 1e30f;
  for (uint32_t i = 0; i < MESO_MAX_PARTS; ++i) {
    const meso_part *part = &m->parts[i];
    for (uint32_t j = 0; j < part->vertex_count; ++j) {
      m->top = fmaxf(m->top, part->vertices[j].p[2]);
      m->bottom = fminf(m->bottom, part->vertices[j].p[2]);
    }
    for (uint32_t j = 0; j < part->sphere_count; ++j) {
      m->top = fmaxf(m->top, part->spheres[j].z + part->spheres[j].radius);
      m->bottom = fminf(m->bottom, part->spheres[j].z - part->spheres[j].radius);
    }
  }
}

/* How many tiles a shape between lo and hi must be moved down or up to still touch the margin. */
static bool touches(const mesostructure *m, float lo, float hi, int tiles) {
  return hi + (float)tiles >= -m->margin && lo + (float)tiles <= 1.0f + m->margin;
}

typedef struct copies {
  meso_vertex *vertices;
  uint32_t *triangles, *renamed;
  uint32_t vertex_count, triangle_count;
} copies;

/* One pass over all copies of a part: counts them, and writes them where out has room. */
static void copy_triangles(const mesostructure *m, const meso_part *part, copies *out) {
  float lo[2] = {1e30f, 1e30f}, hi[2] = {-1e30f, -1e30f};
  int first[2], last[2];
  out->vertex_count = out->triangle_count = 0;
  for (uint32_t i = 0; i < part->vertex_count; ++i)
    for (int a = 0; a < 2; ++a) {
      lo[a] = fminf(lo[a], part->vertices[i].p[a]);
      hi[a] = fmaxf(hi[a], part->vertices[i].p[a]);
    }
  for (int a = 0; a < 2; ++a) {
    first[a] = (int)ceilf(-m->margin - hi[a]);
    last[a] = (int)floorf(1.0f + m->margin - lo[a]);
  }
  for (int ty = first[1]; ty <= last[1]; ++ty)
    for (int tx = first[0]; tx <= last[0] && !synth_watch_stops(m->watch); ++tx) {
      memset(out->renamed, 0xff, part->vertex_count * sizeof *out->renamed);
      for (uint32_t i = 0; i < part->triangle_count; ++i) {
        const uint32_t *corner = part->triangles + 3 * i;
        const float *a = part->vertices[corner[0]].p, *b = part->vertices[corner[1]].p;
        const float *c = part->vertices[corner[2]].p;
        if (!touches(m, fminf(a[0], fminf(b[0], c[0])), fmaxf(a[0], fmaxf(b[0], c[0])), tx) ||
            !touches(m, fminf(a[1], fminf(b[1], c[1])), fmaxf(a[1], fmaxf(b[1], c[1])), ty))
          continue;
        for (int k = 0; k < 3; ++k) {
          uint32_t *name = &out->renamed[corner[k]];
          if (*name == UINT32_MAX) {
            *name = out->vertex_count++;
            if (out->vertices != NULL) {
              out->vertices[*name] = part->vertices[corner[k]];
              out->vertices[*name].p[0] += (float)tx;
              out->vertices[*name].p[1] += (float)ty;
            }
          }
          if (out->triangles != NULL) out->triangles[3 * out->triangle_count + (uint32_t)k] = *name;
        }
        ++out->triangle_count;
      }
    }
}

static btf_status repeat_triangles(mesostructure *m, meso_part *part) {
  copies all = {0};
  all.renamed = malloc(part->vertex_count * sizeof *all.renamed);
  if (all.renamed != NULL) {
    copy_triangles(m, part, &all);
    /* Embree reads vertices in steps of 16 bytes. */
    all.vertices = malloc(((size_t)all.vertex_count + 1) * sizeof *all.vertices);
    all.triangles = malloc((size_t)all.triangle_count * 3 * sizeof *all.triangles);
    if (all.vertices != NULL && all.triangles != NULL) copy_triangles(m, part, &all);
  }
  free(all.renamed);
  if (all.vertices == NULL || all.triangles == NULL) {
    free(all.vertices);
    free(all.triangles);
    return btf_source_error(BTF_E_NOMEM, "%s: out of memory for the structure", m->material->name);
  }
  free(part->vertices);
  free(part->triangles);
  part->vertices = all.vertices;
  part->triangles = all.triangles;
  part->vertex_count = part->vertex_room = all.vertex_count;
  part->triangle_count = part->triangle_room = all.triangle_count;
  return BTF_OK;
}

static void repeat_spheres(mesostructure *m, meso_part *part) {
  const uint32_t own = part->sphere_count;
  const int reach = 1 + (int)ceilf(m->margin);
  for (uint32_t i = 0; i < own; ++i)
    for (int ty = -reach; ty <= reach; ++ty)
      for (int tx = -reach; tx <= reach; ++tx) {
        const meso_sphere s = part->spheres[i];
        if ((tx == 0 && ty == 0) || !touches(m, s.x - s.radius, s.x + s.radius, tx) ||
            !touches(m, s.y - s.radius, s.y + s.radius, ty))
          continue;
        meso_add_sphere(m, (uint32_t)(part - m->parts), vec3_make(s.x + (float)tx, s.y + (float)ty, s.z),
                        s.radius);
      }
}

static bool embree_goes_on(void *watch, double done) {
  (void)done;
  return !synth_watch_stops(watch);
}

static btf_status hand_to_embree(mesostructure *m) {
  /* One thread: the tree, and with it the winner between triangles that share an edge, is the same in every
   * run. */
  m->device = rtcNewDevice("threads=1");
  if (m->device == NULL)
    return btf_source_error(BTF_E_UNSUPPORTED, "%s: Embree could not be started", m->material->name);
  m->scene = rtcNewScene(m->device);
  rtcSetSceneFlags(m->scene, RTC_SCENE_FLAG_ROBUST);
  for (uint32_t i = 0; i < MESO_MAX_PARTS; ++i) {
    meso_part *part = &m->parts[i];
    part->mesh_id = part->sphere_id = RTC_INVALID_GEOMETRY_ID;
    if (part->triangle_count > 0) {
      const RTCGeometry mesh = rtcNewGeometry(m->device, RTC_GEOMETRY_TYPE_TRIANGLE);
      rtcSetSharedGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, part->vertices, 0,
                                 sizeof *part->vertices, part->vertex_count);
      rtcSetSharedGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, part->triangles, 0,
                                 3 * sizeof *part->triangles, part->triangle_count);
      rtcCommitGeometry(mesh);
      part->mesh_id = rtcAttachGeometry(m->scene, mesh);
      rtcReleaseGeometry(mesh);
    }
    if (part->sphere_count > 0) {
      const RTCGeometry spheres = rtcNewGeometry(m->device, RTC_GEOMETRY_TYPE_SPHERE_POINT);
      rtcSetSharedGeometryBuffer(spheres, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4, part->spheres, 0,
                                 sizeof *part->spheres, part->sphere_count);
      rtcCommitGeometry(spheres);
      part->sphere_id = rtcAttachGeometry(m->scene, spheres);
      rtcReleaseGeometry(spheres);
    }
  }
  if (m->watch != NULL) rtcSetSceneProgressMonitorFunction(m->scene, embree_goes_on, m->watch);
  rtcCommitScene(m->scene);
  if (synth_watch_stops(m->watch)) return BTF_OK; /* what is missing is no failure */
  return rtcGetDeviceError(m->device) == RTC_ERROR_NONE ? BTF_OK : embree_failure(m);
}

/* Everything after the shapes: copies around the tile, and the tree. */
static btf_status finish(mesostructure *m) {
  btf_status status = BTF_OK;
  find_extent(m);
  /* Rays down to 15 degrees above the plane stay inside the margin; flatter ones wrap. */
  m->margin = fminf(fmaxf(3.8f * (m->top - m->bottom), 0.125f), 1.0f);
  for (uint32_t i = 0; i < MESO_MAX_PARTS && status == BTF_OK; ++i) {
    if (m->parts[i].triangle_count > 0) status = repeat_triangles(m, &m->parts[i]);
    repeat_spheres(m, &m->parts[i]);
  }
  if (status == BTF_OK && m->failed)
    status = btf_source_error(BTF_E_NOMEM, "%s: out of memory for the structure", m->material->name);
  return status == BTF_OK && !synth_watch_stops(m->watch) ? hand_to_embree(m) : status;
}

btf_status meso_create(const synth_material *material, uint64_t seed, synth_watch *watch,
                       mesostructure **out) {
  btf_status status;
  mesostructure *m = calloc(1, sizeof *m);
  *out = NULL;
  if (m == NULL) return btf_source_error(BTF_E_NOMEM, "%s: out of memory", material->name);
  m->material = material;
  m->seed = seed;
  m->watch = watch;
  status = material->build(m);
  if (status == BTF_OK && m->failed)
    status = btf_source_error(BTF_E_NOMEM, "%s: out of memory for the structure", material->name);
  if (status == BTF_OK && !synth_watch_stops(watch)) status = finish(m);
  if (synth_watch_stops(watch)) status = btf_source_error(BTF_E_CANCELLED, "cancelled");
  m->watch = NULL;
  if (status != BTF_OK) {
    meso_free(m);
    return status;
  }
  *out = m;
  return BTF_OK;
}

/* Distance along the ray to where it leaves the margin sideways, and to where it leaves the structure up or
 * down. */
static void distances(const mesostructure *m, vec3 o, vec3 d, float *sideways, float *vertical) {
  const float lo = -m->margin, hi = 1.0f + m->margin;
  float t = 1e30f;
  if (d.x != 0.0f) t = fminf(t, ((d.x > 0.0f ? hi : lo) - o.x) / d.x);
  if (d.y != 0.0f) t = fminf(t, ((d.y > 0.0f ? hi : lo) - o.y) / d.y);
  *sideways = t;
  *vertical = 1e30f;
  if (d.z > 0.0f) *vertical = (m->top - o.z) / d.z;
  if (d.z < 0.0f) *vertical = (m->bottom - 2.0f * MESO_OFFSET - o.z) / d.z;
}

static void describe(const mesostructure *m, const struct RTCRayHit *found, vec3 direction,
                     surface_hit *hit) {
  const float u = found->hit.u, v = found->hit.v, w = 1.0f - u - v, t = found->ray.tfar;
  const meso_part *part = m->parts;
  while (part->mesh_id != found->hit.geomID && part->sphere_id != found->hit.geomID) ++part;
  hit->part = (uint32_t)(part - m->parts);
  hit->facet = vec3_normalize(vec3_make(found->hit.Ng_x, found->hit.Ng_y, found->hit.Ng_z));
  if (part->sphere_id == found->hit.geomID) {
    hit->position = vec3_along(vec3_make(found->ray.org_x, found->ray.org_y, found->ray.org_z), t, direction);
    hit->normal = hit->facet;
    hit->tangent = vec3_make(1.0f, 0.0f, 0.0f);
    hit->s = hit->t = 0.0f;
    hit->object = found->hit.primID;
  } else {
    const uint32_t *corner = part->triangles + 3 * (size_t)found->hit.primID;
    const meso_vertex *a = &part->vertices[corner[0]], *b = &part->vertices[corner[1]];
    const meso_vertex *c = &part->vertices[corner[2]];
#define BLEND(member) (w * a->member + u * b->member + v * c->member)
    hit->position = vec3_make(BLEND(p[0]), BLEND(p[1]), BLEND(p[2]));
    hit->normal =
        part->faceted ? hit->facet : vec3_normalize(vec3_make(BLEND(n[0]), BLEND(n[1]), BLEND(n[2])));
    hit->tangent = vec3_make(BLEND(tangent[0]), BLEND(tangent[1]), BLEND(tangent[2]));
    hit->s = BLEND(s);
    hit->t = BLEND(t);
#undef BLEND
    hit->object = a->object;
  }
  hit->position.x = meso_wrap(hit->position.x);
  hit->position.y = meso_wrap(hit->position.y);
  if (vec3_dot(hit->facet, direction) > 0.0f) hit->facet = vec3_scale(hit->facet, -1.0f);
  if (vec3_dot(hit->normal, hit->facet) < 0.0f) hit->normal = vec3_scale(hit->normal, -1.0f);
}

bool meso_first_hit(const mesostructure *m, vec3 origin, vec3 direction, surface_hit *hit) {
  struct RTCRayHit found;
  for (int wraps = 0; wraps < MAX_WRAPS; ++wraps) {
    float sideways, vertical;
    origin.x = meso_wrap(origin.x);
    origin.y = meso_wrap(origin.y);
    distances(m, origin, direction, &sideways, &vertical);
    if (!(vertical > 0.0f)) return false;
    if (trace_first_hit(m->scene, origin, direction, 0.0f, fminf(sideways, vertical), &found)) {
      describe(m, &found, direction, hit);
      return true;
    }
    if (vertical <= sideways) return false;
    origin = vec3_along(origin, sideways, direction);
  }
  return false;
}

bool meso_occluded(const mesostructure *m, vec3 origin, vec3 direction) {
  for (int wraps = 0; wraps < MAX_WRAPS; ++wraps) {
    float sideways, vertical;
    origin.x = meso_wrap(origin.x);
    origin.y = meso_wrap(origin.y);
    distances(m, origin, direction, &sideways, &vertical);
    if (!(vertical > 0.0f)) return false;
    if (trace_is_occluded(m->scene, origin, direction, 0.0f, fminf(sideways, vertical))) return true;
    if (vertical <= sideways) return false;
    origin = vec3_along(origin, sideways, direction);
  }
  return false;
}
