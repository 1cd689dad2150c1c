/* SPDX-License-Identifier: MIT */
/* Synthetic mesostructures against answers known without them: analytic spheres, brute-force triangles, white
 * furnaces. */
#include "btf_test.h"

#include <dirent.h>
#include <errno.h>
#include <sys/stat.h>
#include <time.h>

#include "synth/mesostructure.h"
#include "synth/synth.h"
#include "synth/tracer.h"
#include "trace/sampling.h"

static const float pi = 3.14159265358979f;

static vec3 direction(float theta_degrees, float phi_degrees) {
  const float theta = theta_degrees * pi / 180.0f, phi = phi_degrees * pi / 180.0f;
  return vec3_make(sinf(theta) * cosf(phi), sinf(theta) * sinf(phi), cosf(theta));
}

static float draw(uint32_t *state) {
  *state = sampling_hash(*state, 1u);
  return sampling_unit(*state);
}

static btf_dirset *one_light(btf_context *ctx, vec3 light) {
  btf_dirset *set = NULL;
  float xyz[3];
  vec3_store(xyz, light);
  assert_ok(btf_dirset_create(ctx, xyz, 1, &set));
  return set;
}

static void sample_texel(synth_sampler *s, uint32_t x, uint32_t y, vec3 view, float *rgb) {
  float xyz[3];
  vec3_store(xyz, view);
  synth_sampler_texel(s, x, y, xyz, rgb);
}

static synth_desc describe(const char *name, const btf_dirset *set, uint32_t size) {
  synth_desc d = {
      .name = name, .lights = set, .views = set, .width = size, .height = size, .spp = 4, .threads = 2};
  d.sample_type = BTF_SAMPLE_F32;
  d.order = BTF_ORDER_VLYXC;
  d.bounces = 2;
  return d;
}

/* ---- SYA01, SYA04: every tile repeats ---- */

/* Straight down on both sides of the border: the tile near it, and the copy in the margin beyond the opposite
 * one. */
static void check_copies(const mesostructure *m) {
  const vec3 down = {0.0f, 0.0f, -1.0f};
  struct RTCRayHit a, b;
  uint32_t random = 7;
  for (int n = 0; n < 4000; n++) {
    const float u = (draw(&random) - 0.5f) * 2.0f * m->margin, v = draw(&random), top = m->top + 0.01f;
    const bool along_u = (n & 1) == 0;
    const vec3 p = along_u ? vec3_make(u, v, top) : vec3_make(v, u, top);
    const vec3 q = vec3_add(p, along_u ? vec3_make(1.0f, 0.0f, 0.0f) : vec3_make(0.0f, 1.0f, 0.0f));
    assert_true(trace_first_hit(m->scene, p, down, 0.0f, 10.0f, &a));
    assert_true(trace_first_hit(m->scene, q, down, 0.0f, 10.0f, &b));
    /* The copy's vertices are moved in single precision: half a unit of 2^-23 at most, which slopes up to 8
     * turn into 5e-7. Steeper places are the sides of tubes. */
    if (fabsf(a.hit.Ng_z) < 0.12f * vec3_length(vec3_make(a.hit.Ng_x, a.hit.Ng_y, a.hit.Ng_z))) continue;
    assert_int_equal(a.hit.geomID, b.hit.geomID);
    assert_near(a.ray.tfar, b.ray.tfar, 1e-6);
  }
}

/* A flat ray that leaves the tile must meet what it meets when it starts in the tile or copy that it crosses.
 */
static void check_wrapping(const mesostructure *m) {
  uint32_t random = 11, crossed = 0, differ = 0;
  for (int n = 0; n < 3000; n++) {
    const vec3 d = vec3_scale(direction(75.0f + 14.5f * draw(&random), 360.0f * draw(&random)), -1.0f);
    const vec3 o = vec3_make(draw(&random), draw(&random), m->top);
    surface_hit whole, rest;
    assert_true(meso_first_hit(m, o, d, &whole));
    const vec3 moved = vec3_along(o, 0.75f * (whole.position.z - o.z) / d.z, d);
    if (fabsf(moved.x - 0.5f) < 0.5f && fabsf(moved.y - 0.5f) < 0.5f) continue;
    crossed++;
    assert_true(meso_first_hit(m, moved, d, &rest));
    differ += fabsf(whole.position.z - rest.position.z) > 1e-4f;
  }
  assert_true(crossed > 50);
  /* Rounding of the moved origin, 1e-6 across a ray up to 20 tiles long, may pass a silhouette instead of
   * meeting it: none does with these seeds, one in a hundred is allowed. */
  assert_true(differ * 100 <= crossed);
}

/* Finite, not negative and not all dark, for flat views and lights too. */
static void check_samples(const mesostructure *m, const btf_dirset *set) {
  const uint32_t lights = btf_dirset_count(set);
  const synth_desc d = describe(m->material->name, set, 16);
  float *f = malloc(3 * lights * sizeof *f);
  tracer_lights *from = NULL;
  tracer *t = NULL;
  double sum = 0.0;
  assert_non_null(f);
  assert_ok(tracer_lights_create(set, &from));
  assert_ok(tracer_create(m, from, &d, 0, &t));
  for (uint32_t n = 0; n < 96; n++) {
    const float *view = btf_dirset_directions(set) + 3 * (n % lights);
    tracer_texel(t, n % 16, 7 * n % 16, vec3_load(view), f, 3, 1);
    for (uint32_t k = 0; k < 3 * lights; k++) {
      assert_true(isfinite(f[k]) && f[k] >= 0.0f);
      sum += f[k];
    }
  }
  assert_true(sum > 0.0);
  tracer_free(t);
  tracer_lights_free(from);
  free(f);
}

static void test_materials(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = NULL;
  assert_ok(btf_dirset_create_named(ctx, "grid:8x20", &set));
  for (uint32_t i = 0; synth_name(i) != NULL; i++) {
    const synth_material *material = synth_find(synth_name(i));
    mesostructure *m = NULL;
    assert_true(strlen(synth_summary(i)) > 10);
    assert_non_null(material);
    if (material->build == NULL) continue;
    assert_ok(meso_create(material, 3, NULL, &m));
    check_copies(m);
    check_samples(m, set);
    /* The flat ones have nothing to cross. */
    if (m->top - m->bottom > 0.01f) check_wrapping(m);
    meso_free(m);
  }
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

static void test_checker_heights(void **state) {
  (void)state;
  mesostructure *m = NULL;
  uint32_t low = 0, middle = 0, high = 0;
  assert_ok(meso_create(synth_find("checker"), 0, NULL, &m));
  for (uint32_t y = 0; y < 64; y++)
    for (uint32_t x = 0; x < 64; x++) {
      surface_hit hit;
      const vec3 o = vec3_make(((float)x + 0.5f) / 64.0f, ((float)y + 0.5f) / 64.0f, m->top + 0.1f);
      const float range = m->top - m->bottom;
      assert_true(meso_first_hit(m, o, vec3_make(0.0f, 0.0f, -1.0f), &hit));
      if (hit.position.z < m->bottom + 0.2f * range)
        low++;
      else if (hit.position.z > m->top - 0.2f * range)
        high++;
      else
        middle++;
    }
  /* Two peaks of equal size; the middle 60 % of the range holds fewer than either end of 20 %. */
  assert_true(middle < low && middle < high);
  assert_true(abs((int)low - (int)high) <= 8);
  meso_free(m);
}

/* ---- SYA02, SYA03 ---- */

static void test_rings_mask_the_plane(void **state) {
  (void)state;
  mesostructure *m = NULL;
  uint32_t seen = 0, above = 0, rays = 0;
  assert_ok(meso_create(synth_find("rings"), 0, NULL, &m));
  for (uint32_t azimuth = 0; azimuth < 24; azimuth++)
    for (uint32_t i = 0; i < 1024; i++, rays++) {
      const float u = ((float)(i % 32) + 0.5f) / 32.0f, v = ((float)(i / 32) + 0.5f) / 32.0f;
      const vec3 view = direction(80.0f, 15.0f * (float)azimuth + 3.0f);
      surface_hit hit;
      assert_true(meso_first_hit(m, vec3_make(u, v, m->top), vec3_scale(view, -1.0f), &hit));
      seen += hit.part == 0;
      assert_true(meso_first_hit(m, vec3_make(u, v, m->top), vec3_make(0.0f, 0.0f, -1.0f), &hit));
      above += hit.part == 0;
    }
  if (seen * 100 >= rays) fail_msg("blue seen in %u of %u texels at 80 degrees", seen, rays);
  /* From above there is blue to be masked. */
  assert_true(above * 10 > rays);
  meso_free(m);
}

static void test_tissue_order(void **state) {
  (void)state;
  mesostructure *m = NULL;
  assert_ok(meso_create(synth_find("tissue"), 0, NULL, &m));
  for (uint32_t j = 0; j < 4; j++)
    for (uint32_t i = 0; i < 4; i++) {
      const float u = ((float)i + 0.5f) / 4.0f, v = ((float)j + 0.5f) / 4.0f;
      surface_hit over, under;
      assert_true(meso_first_hit(m, vec3_make(u, v, m->top), vec3_make(0.0f, 0.0f, -1.0f), &over));
      assert_true(meso_first_hit(m, vec3_make(u, v, m->bottom + 1e-4f), vec3_make(0.0f, 0.0f, 1.0f), &under));
      assert_int_equal(over.part, (i + j) % 2 == 0 ? 0 : 1);
      assert_int_equal(under.part, (i + j) % 2 == 0 ? 1 : 0);
    }
  meso_free(m);
}

/* ---- SYA05: known shapes ---- */

static void test_lambert_plane(void **state) {
  (void)state;
  static const double albedo[3] = {0.8, 0.5, 0.2};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = NULL;
  synth_sampler *exact = NULL, *plane = NULL;
  float f[3 * 128];
  assert_ok(btf_dirset_create_named(ctx, "grid:16x8", &set));
  synth_desc d = describe("lambert", set, 8);
  assert_ok(synth_sampler_create(&d, &exact));
  d.name = "plane";
  assert_ok(synth_sampler_create(&d, &plane));
  for (uint32_t v = 0; v < 128; v += 5) {
    const float *view = btf_dirset_directions(set) + 3 * v;
    synth_sampler_texel(exact, v % 8, v / 16, view, f);
    for (int i = 0; i < 3 * 128; i++) assert_true(f[i] == (float)(albedo[i % 3] / 3.14159265358979323846));
    synth_sampler_texel(plane, v % 8, v / 16, view, f);
    /* Five roundings of 2^-24, one of them of cos / cos. */
    for (int i = 0; i < 3 * 128; i++) assert_relative(f[i], albedo[i % 3] / 3.14159265358979323846, 6e-7);
  }
  synth_sampler_free(exact);
  synth_sampler_free(plane);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* The spheres of the material `sphere`, one for each tile, and the plane, in double precision: distance along
 * the ray, or -1; *clearance is how narrowly any sphere was hit or missed. */
static double sphere_distance(const double o[3], const double d[3], double *clearance) {
  const double radius = 0.2;
  double nearest = -1.0;
  for (int j = -9; j <= 9; j++)
    for (int i = -9; i <= 9; i++) {
      const double c[3] = {0.5 + i - o[0], 0.5 + j - o[1], radius - o[2]};
      const double along = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
      const double across = sqrt(fmax(c[0] * c[0] + c[1] * c[1] + c[2] * c[2] - along * along, 0.0));
      const double t = along - sqrt(fmax(radius * radius - across * across, 0.0));
      if (along <= 0.0) continue;
      *clearance = fmin(*clearance, fabs(across - radius));
      if (across < radius && t > 1e-9 && (nearest < 0.0 || t < nearest)) nearest = t;
    }
  return nearest;
}

static double expected_sphere(double u, double v, vec3 view, vec3 light, double *clearance) {
  const double down[3] = {-view.x, -view.y, -view.z}, up[3] = {light.x, light.y, light.z};
  double o[3] = {u, v, 0.4}, n[3] = {0.0, 0.0, 1.0}, rho = 0.5, cosine;
  double t = sphere_distance(o, down, clearance);
  const bool on_sphere = t >= 0.0;
  if (!on_sphere) t = 0.4 / view.z;
  for (int a = 0; a < 3; a++) o[a] += t * down[a];
  if (on_sphere) {
    const double c[3] = {floor(o[0]) + 0.5, floor(o[1]) + 0.5, 0.2};
    for (int a = 0; a < 3; a++) n[a] = (o[a] - c[a]) / 0.2;
    rho = 0.8;
  }
  cosine = n[0] * up[0] + n[1] * up[1] + n[2] * up[2];
  *clearance = fmin(*clearance, fabs(cosine));
  if (cosine <= 0.0) return 0.0;
  /* Its own sphere cannot shadow a point that faces the light; moving off it keeps it out of the search. */
  for (int a = 0; a < 3; a++) o[a] = o[a] - floor(o[a]) * (a < 2) + 1e-7 * n[a];
  double shadow_clearance = 1.0;
  const bool shadowed = sphere_distance(o, up, &shadow_clearance) >= 0.0;
  if (!on_sphere || shadowed) *clearance = fmin(*clearance, shadow_clearance);
  return shadowed ? 0.0 : rho / 3.14159265358979 * cosine / up[2];
}

static void test_sphere_shadow(void **state) {
  (void)state;
  static const float angles[][4] = {/* view theta, phi; light theta, phi */
                                    {0, 0, 45, 30},   {0, 0, 70, 200}, {50, 100, 60, 300},
                                    {75, 10, 20, 80}, {30, 0, 85, 45}, {84, 130, 40, 0}};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  for (int k = 0; k < 6; k++) {
    const vec3 view = direction(angles[k][0], angles[k][1]), light = direction(angles[k][2], angles[k][3]);
    btf_dirset *set = one_light(ctx, light);
    synth_desc d = describe("sphere", set, 96);
    synth_sampler *s = NULL;
    uint32_t lit = 0, dark = 0, skipped = 0;
    d.sampling = SYNTH_SAMPLING_POINT;
    d.spp = 1;
    d.bounces = 0;
    assert_ok(synth_sampler_create(&d, &s));
    for (uint32_t y = 0; y < 96; y++)
      for (uint32_t x = 0; x < 96; x++) {
        double clearance = 1.0;
        float f[3];
        const double expected = expected_sphere((x + 0.5) / 96.0, (y + 0.5) / 96.0, view, light, &clearance);
        /* Origins leave surfaces by 1e-5, and single precision resolves 1e-6 over the distances here. */
        if (clearance < 1e-4) {
          skipped++;
          continue;
        }
        sample_texel(s, x, y, view, f);
        assert_near(f[0], expected, 2e-3 * expected + 1e-6);
        if (expected > 0.0)
          lit++;
        else
          dark++;
      }
    assert_true(skipped < 96 * 96 / 50 && lit > 100 && dark > 100);
    synth_sampler_free(s);
    btf_dirset_release(set);
  }
  test_context_done(ctx, &memory);
}

/* ---- SYA06: energy ---- */

/* Reflected share of a uniform sky, an estimate from `count` random lights with density cos / pi. */
static double reflected_share(btf_context *ctx, uint32_t trial, uint32_t bounces) {
  enum { lights = 192, texels = 12 };
  float xyz[3 * lights], f[3 * lights];
  uint32_t random = 1000 + trial;
  double sum = 0.0;
  for (int i = 0; i < lights; i++) {
    vec3 l;
    do l = sampling_cosine(draw(&random), draw(&random));
    while (l.z < 1e-3f);
    vec3_store(xyz + 3 * i, vec3_normalize(l));
  }
  btf_dirset *set = NULL;
  synth_sampler *s = NULL;
  assert_ok(btf_dirset_create(ctx, xyz, lights, &set));
  synth_desc d = describe("furnace", set, 64);
  d.seed = trial;
  d.spp = 8;
  d.bounces = bounces;
  assert_ok(synth_sampler_create(&d, &s));
  for (int i = 0; i < texels; i++) {
    const vec3 view = direction(75.0f * draw(&random), 360.0f * draw(&random));
    sample_texel(s, (uint32_t)(64.0f * draw(&random)), (uint32_t)(64.0f * draw(&random)), view, f);
    /* f cos / (cos / pi) */
    for (int l = 0; l < lights; l++) sum += (double)f[3 * l] * pi / (lights * texels);
  }
  synth_sampler_free(s);
  btf_dirset_release(set);
  return sum;
}

static void test_white_furnace(void **state) {
  (void)state;
  enum { trials = 24 };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  double mean = 0.0, square = 0.0, direct = 0.0, sigma;
  for (uint32_t i = 0; i < trials; i++) {
    const double share = reflected_share(ctx, i, 60);
    mean += share / trials;
    square += share * share / trials;
    direct += reflected_share(ctx, i, 0) / trials;
  }
  sigma = sqrt(fmax(square - mean * mean, 0.0) / (trials - 1));
  print_message("furnace: %.4f +- %.4f, direct light alone %.4f\n", mean, sigma, direct);
  assert_near(mean, 1.0, 3.0 * sigma);
  /* The test has power: three sigma are less than what interreflection adds. */
  assert_true(3.0 * sigma < 0.05 && direct < 1.0 - 0.05);
  test_context_done(ctx, &memory);
}

/* Distance to the first triangle by brute force, or -1. */
static double brute_force(const mesostructure *m, const double o[3], const double d[3], double n[3]) {
  const meso_part *part = &m->parts[0];
  double nearest = -1.0;
  for (uint32_t i = 0; i < part->triangle_count; i++) {
    const float *a = part->vertices[part->triangles[3 * i]].p,
                *b = part->vertices[part->triangles[3 * i + 1]].p;
    const float *c = part->vertices[part->triangles[3 * i + 2]].p;
    const double e[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]},
                 g[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    const double p[3] = {d[1] * g[2] - d[2] * g[1], d[2] * g[0] - d[0] * g[2], d[0] * g[1] - d[1] * g[0]};
    const double det = e[0] * p[0] + e[1] * p[1] + e[2] * p[2],
                 s[3] = {o[0] - a[0], o[1] - a[1], o[2] - a[2]};
    const double u = (s[0] * p[0] + s[1] * p[1] + s[2] * p[2]) / det;
    const double q[3] = {s[1] * e[2] - s[2] * e[1], s[2] * e[0] - s[0] * e[2], s[0] * e[1] - s[1] * e[0]};
    const double v = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / det;
    const double t = (g[0] * q[0] + g[1] * q[1] + g[2] * q[2]) / det;
    if (u < 0.0 || v < 0.0 || u + v > 1.0 || t < 1e-9 || (nearest >= 0.0 && t >= nearest)) continue;
    nearest = t;
    n[0] = e[1] * g[2] - e[2] * g[1];
    n[1] = e[2] * g[0] - e[0] * g[2];
    n[2] = e[0] * g[1] - e[1] * g[0];
    const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int k = 0; k < 3; k++) n[k] /= length;
  }
  return nearest;
}

/* No bounces: direct light alone, computed here from the triangles without Embree. */
static void test_direct_light(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  mesostructure *m = NULL;
  synth_sampler *s = NULL, *deeper = NULL;
  btf_dirset *set = NULL;
  float f[3 * 21], g[3 * 21];
  uint32_t wrong = 0, shadowed = 0, checked = 0;
  float xyz[3 * 21];
  for (int i = 0; i < 21; i++)
    vec3_store(xyz + 3 * i, direction(25.0f * (float)(i / 7) + 22.0f, 51.0f * (float)i));
  assert_ok(btf_dirset_create(ctx, xyz, 21, &set));
  synth_desc d = describe("furnace", set, 17);
  d.sampling = SYNTH_SAMPLING_POINT;
  d.bounces = 0;
  assert_ok(synth_sampler_create(&d, &s));
  d.bounces = 1;
  assert_ok(synth_sampler_create(&d, &deeper));
  assert_ok(meso_create(synth_find("furnace"), 0, NULL, &m));
  for (uint32_t n = 0; n < 24; n++) {
    const uint32_t x = 5 * n % 17, y = 3 * n % 17;
    const vec3 view = direction(2.0f * (float)n, 77.0f * (float)n);
    const double down[3] = {-view.x, -view.y, -view.z};
    double o[3] = {(x + 0.5) / 17.0, (y + 0.5) / 17.0, m->top}, normal[3], spare[3];
    const double t = brute_force(m, o, down, normal);
    assert_true(t >= 0.0);
    const double side = normal[2] < 0.0 ? -1.0 : 1.0;
    for (int k = 0; k < 3; k++) {
      normal[k] *= side;
      o[k] += t * down[k] + 1e-6 * normal[k];
    }
    sample_texel(s, x, y, view, f);
    sample_texel(deeper, x, y, view, g);
    for (int l = 0; l < 21; l++) {
      const double to_light[3] = {xyz[3 * l], xyz[3 * l + 1], xyz[3 * l + 2]};
      const double cosine = normal[0] * to_light[0] + normal[1] * to_light[1] + normal[2] * to_light[2];
      const bool dark = cosine <= 0.0 || brute_force(m, o, to_light, spare) >= 0.0;
      const double expected = dark ? 0.0 : cosine / (3.14159265358979 * to_light[2]);
      shadowed += dark;
      checked++;
      wrong += fabs(f[3 * l] - expected) > 1e-4 * expected + 1e-6;
      assert_true(g[3 * l] >= f[3 * l]);
    }
  }
  /* A shadow's edge may pass within the 1e-5 by which origins leave the surface. */
  assert_true(wrong <= checked / 250);
  assert_true(shadowed > checked / 20);
  meso_free(m);
  synth_sampler_free(s);
  synth_sampler_free(deeper);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

static void test_reflectance(void **state) {
  (void)state;
  /* Rough to smooth, cloth to gold; the darkest and the brightest combinations that materials use, and
   * beyond. */
  static const surface_brdf cases[] = {{{1, 1, 1}, {0, 0, 0}, 0, 1},
                                       {{0.9f, 0.5f, 0.1f}, {0.04f, 0.04f, 0.04f}, 1, 0.3f},
                                       {{0.0f, 0.0f, 0.0f}, {1.0f, 0.7f, 0.28f}, 0.97f, 0.2f},
                                       {{1, 1, 1}, {0.08f, 0.2f, 0.5f}, 1, 0.6f},
                                       {{0.74f, 0.68f, 0.57f}, {0.04f, 0.04f, 0.04f}, 0.5f, 0.6f}};
  enum { side = 128, lights = side * side };
  float *x = malloc(6 * lights * sizeof *x), *y = x + lights, *z = y + lights, *r = z + lights,
        *g = r + lights, *b = g + lights;
  assert_non_null(x);
  for (uint32_t i = 0; i < lights; i++) {
    float p, q;
    sampling_pair(5u, i, &p, &q);
    const vec3 l = sampling_cosine(p, q);
    x[i] = l.x;
    y[i] = l.y;
    z[i] = l.z;
  }
  for (size_t k = 0; k < sizeof cases / sizeof *cases; k++)
    for (int angle = 0; angle < 80; angle += 11) {
      const vec3 up = vec3_make(0, 0, 1), view = direction((float)angle, 40.0f);
      double albedo = 0.0, drawn = 0.0;
      brdf_times_cosine(&cases[k], up, up, view, lights, x, y, z, r, g, b);
      for (uint32_t i = 0; i < lights; i++) {
        float f[3], swapped[3], weight[3], p, q, choice, spare;
        const vec3 l = vec3_make(x[i], y[i], z[i]);
        vec3 sampled;
        brdf_value(&cases[k], l, view, f);
        brdf_value(&cases[k], view, l, swapped);
        /* The vector and the scalar form differ by rounding; reciprocity by the guard of grazing angles. */
        assert_near(r[i], f[0] * z[i], 2e-5 * f[0] * z[i] + 1e-6);
        assert_near(b[i], f[2] * z[i], 2e-5 * f[2] * z[i] + 1e-6);
        if (z[i] > 1e-3f) assert_relative(f[1], swapped[1], 2e-5);
        albedo += (double)f[1] * pi / lights;
        sampling_pair(9u, i, &choice, &spare);
        sampling_pair(10u, i, &p, &q);
        if (brdf_sample(&cases[k], view, choice, p, q, &sampled, weight)) drawn += (double)weight[1] / lights;
      }
      /* Both are means over 16384 well spread samples of functions with peaks below 60. */
      assert_true(albedo <= 1.0 + 2e-3);
      assert_near(drawn, albedo, 0.02 * albedo + 2e-3);
    }
  free(x);
}

/* ---- SYA07: the driver ---- */

static uint8_t *read_all(const char *folder, const char *name, size_t *size) {
  char path[600];
  struct stat info;
  snprintf(path, sizeof path, "%s/%s", folder, name);
  assert_int_equal(stat(path, &info), 0);
  *size = (size_t)info.st_size;
  uint8_t *bytes = malloc(*size + 1);
  FILE *file = fopen(path, "rb");
  assert_non_null(bytes);
  assert_non_null(file);
  assert_int_equal(fread(bytes, 1, *size, file), *size);
  fclose(file);
  return bytes;
}

static void test_same_bytes(void **state) {
  (void)state;
  static const struct {
    const char *name;
    uint32_t width, order;
  } cases[] = {{"checker", 10, BTF_ORDER_VLYXC},
               {"tissue", 10, BTF_ORDER_YXVLC},
               {"bumps", 200, BTF_ORDER_VLYXC},
               {"bumps", 200, BTF_ORDER_YXVLC}};
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 16);
  btf_dirset *set = NULL;
  assert_ok(btf_dirset_create_named(ctx, "grid:6x3", &set));
  for (int i = 0; i < 4; i++) {
    synth_desc d = describe(cases[i].name, set, 7);
    const char *one = test_path("one.btfd"), *sixteen = test_path("sixteen.btfd");
    size_t size[4];
    uint8_t *bytes[4];
    d.width = cases[i].width;
    d.order = cases[i].order;
    d.sample_type = BTF_SAMPLE_F16;
    d.source = "btf synth";
    d.threads = 1;
    assert_ok(synth_run(ctx, &d, one, NULL, NULL));
    d.threads = 16;
    assert_ok(synth_run(ctx, &d, sixteen, NULL, NULL));
    bytes[0] = read_all(one, "samples.bin", &size[0]);
    bytes[1] = read_all(sixteen, "samples.bin", &size[1]);
    bytes[2] = read_all(one, "manifest.json", &size[2]);
    bytes[3] = read_all(sixteen, "manifest.json", &size[3]);
    assert_int_equal(size[0], (size_t)18 * 18 * d.width * d.height * 3 * 2);
    assert_int_equal(size[0], size[1]);
    assert_int_equal(size[2], size[3]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    assert_memory_equal(bytes[2], bytes[3], size[2]);
    for (int k = 0; k < 4; k++) free(bytes[k]);
  }
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* Both orders hold the same samples, those of the sampler; the description tells what was made. */
static void test_what_is_written(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = NULL;
  const char *names[] = {"rings", "bumps"};
  assert_ok(btf_dirset_create_named(ctx, "grid:5x2", &set));
  for (int n = 0; n < 2; n++)
    for (uint32_t order = BTF_ORDER_VLYXC; order <= BTF_ORDER_YXVLC; order++) {
      synth_desc d = describe(names[n], set, 9);
      btf_dataset *ds = NULL;
      btf_dataset_desc told = BTF_DATASET_DESC_INIT;
      synth_sampler *s = NULL;
      float stored[10 * 10 * 3], sampled[10 * 3];
      d.height = 5;
      d.order = order;
      d.seed = 12345678901234u;
      d.source = "btf synth rings --seed 12345678901234";
      assert_ok(synth_run(ctx, &d, test_path("both.btfd"), NULL, NULL));
      assert_ok(btf_dataset_open(ctx, test_path("both.btfd"), &ds));
      assert_ok(btf_dataset_describe(ds, &told));
      assert_int_equal(told.quantity, BTF_QUANTITY_BRDF);
      assert_int_equal(told.scale, BTF_SCALE_ABSOLUTE);
      assert_string_equal(told.name, names[n]);
      assert_string_equal(told.source, d.source);
      assert_near(told.texels_per_mm, 9.0 / 20.0, 1e-9);
      assert_ok(synth_sampler_create(&d, &s));
      for (uint32_t y = 0; y < 5; y++)
        for (uint32_t x = 0; x < 9; x++) {
          assert_ok(btf_dataset_read_abrdf(ds, x, y, 1, stored));
          for (uint32_t v = 0; v < 10; v++) {
            synth_sampler_texel(s, x, y, btf_dirset_directions(set) + 3 * v, sampled);
            assert_memory_equal(stored + 30 * v, sampled, sizeof sampled);
          }
        }
      synth_sampler_free(s);
      btf_dataset_release(ds);
    }
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* Lets a run go on until a stage, for some calls of it. */
typedef struct stopping {
  const char *stage; /* NULL = whichever comes */
  int calls_left;
  int calls;
  double stopped_at; /* seconds */
} stopping;

static double seconds_now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int32_t stop_in_stage(void *user, double fraction, const char *stage) {
  stopping *s = user;
  assert_true(fraction >= 0.0 && fraction <= 1.0);
  assert_true(s->stopped_at == 0.0); /* nobody asks again */
  s->calls++;
  if ((s->stage != NULL && strcmp(stage, s->stage) != 0) || s->calls_left-- > 0) return 0;
  s->stopped_at = seconds_now();
  return 1;
}

static void expect_stop(btf_context *ctx, const synth_desc *d, stopping s) {
  btf_job job = BTF_JOB_INIT;
  int entries = 0;
  char folder[600];
  snprintf(folder, sizeof folder, "%s", test_path("stopped"));
  assert_true(mkdir(folder, 0755) == 0 || errno == EEXIST);
  snprintf(folder + strlen(folder), 20, "/out.btfd");
  job.progress = stop_in_stage;
  job.user = &s;
  assert_status(synth_run(ctx, d, folder, &job, NULL), BTF_E_CANCELLED);
  assert_true(s.stopped_at > 0.0);
  /* What is being done when the wish comes: a row of a height field, a copy of the structure, a path. None
   * takes a hundredth of a second; the rest is for busy machines and sanitizers. */
  assert_true(seconds_now() - s.stopped_at < 3.0);
  *strrchr(folder, '/') = '\0';
  DIR *dir = opendir(folder);
  assert_non_null(dir);
  while (readdir(dir) != NULL) entries++;
  closedir(dir);
  assert_int_equal(entries, 2); /* . and .. */
}

/* A wish to stop is heard while the structure is built and within a single texel, and nothing stays behind.
 */
static void test_cancelled(void **state) {
  static const char *const names[] = {"checker", "leather", "carpet", "knit", "bumps"};
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = NULL, *one = one_light(ctx, direction(30, 0));
  assert_ok(btf_dirset_create_named(ctx, "ubo81", &set));
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    const bool traced = i < 4;
    synth_desc d = describe(names[i], set, 64);
    expect_stop(ctx, &d, (stopping){.stage = traced ? "building" : NULL});
    /* No texel of these would be done within minutes. With one view there is one block: a thread waits. */
    d.spp = 50000000;
    d.views = one;
    if (traced) expect_stop(ctx, &d, (stopping){.stage = "sampling", .calls_left = 2});
  }
  btf_dirset_release(one);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

static void test_refusals(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = one_light(ctx, direction(10, 0));
  synth_desc d = describe("velvet", set, 4);
  assert_status(synth_run(ctx, &d, test_path("no.btfd"), NULL, NULL), BTF_E_INVALID_ARG);
  assert_message_has("velvet");
  d.name = "checker";
  d.spp = 0;
  assert_status(synth_run(ctx, &d, test_path("no.btfd"), NULL, NULL), BTF_E_INVALID_ARG);
  d.spp = 1;
  assert_status(synth_run(ctx, &d, test_path("missing/folder/no.btfd"), NULL, NULL), BTF_E_IO);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* ---- SYA08: directions from a file ---- */

static void write_text(const char *path, const char *text) {
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  fputs(text, file);
  fclose(file);
}

static void test_direction_file(void **state) {
  (void)state;
  static const struct {
    const char *text;
    btf_status status;
    const char *message;
  } bad[] = {
      {"0 0 1\n0.6 0\n", BTF_E_CORRUPT, "line 2"},       {"0 0 1 5\n", BTF_E_CORRUPT, "line 1"},
      {"# nothing\n\n", BTF_E_CORRUPT, "no directions"}, {"0 0 one\n", BTF_E_CORRUPT, "line 1"},
      {"0 0 1\n0 0 -1\n", BTF_E_CORRUPT, "1"},           {"0 0 2\n", BTF_E_CORRUPT, "0"},
  };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = NULL;
  const char *path = test_path("directions.txt");
  write_text(path, "# three directions\r\n0 0 1\n\n  0.6, 0, 0.8 # leaning\n0 -0.6 0.8");
  assert_ok(synth_directions_load(ctx, path, &set));
  assert_int_equal(btf_dirset_count(set), 3);
  assert_near(btf_dirset_directions(set)[7], -0.6, 1e-6);
  btf_dirset_release(set);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    write_text(path, bad[i].text);
    assert_status(synth_directions_load(ctx, path, &set), bad[i].status);
    assert_null(set);
    assert_message_has(bad[i].message);
    assert_message_has("directions.txt");
  }
  assert_status(synth_directions_load(ctx, test_path("none.txt"), &set), BTF_E_IO);
  test_context_done(ctx, &memory);
}

/* ---- SYA09: apparent BRDFs are not reciprocal ---- */

static double asymmetry(synth_sampler *s, const btf_dirset *set, uint32_t x, uint32_t y) {
  const uint32_t n = btf_dirset_count(set);
  float *f = malloc((size_t)n * n * 3 * sizeof *f);
  double difference = 0.0, total = 0.0;
  assert_non_null(f);
  for (uint32_t v = 0; v < n; v++)
    synth_sampler_texel(s, x, y, btf_dirset_directions(set) + 3 * v, f + 3 * n * v);
  for (uint32_t v = 0; v < n; v++)
    for (uint32_t l = 0; l < n; l++)
      for (uint32_t c = 0; c < 3; c++) {
        const double a = f[3 * (n * v + l) + c], b = f[3 * (n * l + v) + c];
        difference += (a - b) * (a - b);
        total += a * a;
      }
  free(f);
  return sqrt(difference / total);
}

static void test_reciprocity(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = NULL;
  synth_sampler *s = NULL;
  assert_ok(btf_dirset_create_named(ctx, "ubo81", &set));
  synth_desc d = describe("checker", set, 64);
  d.sampling = SYNTH_SAMPLING_POINT;
  assert_ok(synth_sampler_create(&d, &s));
  /* The middle of a raised square is flat; a quarter of a tile further the slope is steepest. */
  const double flat = asymmetry(s, set, 16, 16), edge = asymmetry(s, set, 31, 16);
  print_message("asymmetry: flat %.2g, edge %.2g\n", flat, edge);
  assert_true(flat < 1e-3);
  assert_true(edge > 0.1);
  synth_sampler_free(s);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_materials),
      cmocka_unit_test(test_checker_heights),
      cmocka_unit_test(test_rings_mask_the_plane),
      cmocka_unit_test(test_tissue_order),
      cmocka_unit_test(test_lambert_plane),
      cmocka_unit_test(test_sphere_shadow),
      cmocka_unit_test(test_white_furnace),
      cmocka_unit_test(test_direct_light),
      cmocka_unit_test(test_reflectance),
      cmocka_unit_test(test_same_bytes),
      cmocka_unit_test(test_what_is_written),
      cmocka_unit_test(test_cancelled),
      cmocka_unit_test(test_refusals),
      cmocka_unit_test(test_direction_file),
      cmocka_unit_test(test_reciprocity),
  };
  return btf_run("synth", tests);
}
