/* SPDX-License-Identifier: MIT */
/* Pictures against what can be computed by hand: radiance of diffuse surfaces, orientation of textures,
 * frames, lights. */
#include "btf_test.h"

#include "cli.h"
#include "render/render.h"
#include "trace/sampling.h"

static const double pi = 3.14159265358979;

/* A diffuse material whose albedo is given per texel, lights and views of the 81 set. */
static btf_model *diffuse_model(btf_context *ctx, uint32_t width, uint32_t height, const float *albedo) {
  static float samples[81 * 81 * 64];
  btf_dirset *directions;
  btf_dataset *dataset;
  btf_model *model;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  assert_true(width * height <= 64);
  for (uint32_t i = 0; i < 81 * 81 * width * height; i++)
    samples[i] = albedo[i % (width * height)] / (float)pi;
  assert_ok(btf_dirset_create_named(ctx, "ubo81", &directions));
  desc.lights = desc.views = directions;
  desc.width = width;
  desc.height = height;
  desc.channels = 1;
  desc.data = samples;
  desc.strides.channel = desc.strides.x = sizeof(float);
  desc.strides.y = (ptrdiff_t)(width * sizeof(float));
  desc.strides.light = (ptrdiff_t)(width * height * sizeof(float));
  desc.strides.view = 81 * desc.strides.light;
  assert_ok(btf_dataset_create(ctx, &desc, &dataset));
  assert_ok(btf_model_from_dataset(dataset, NULL, &model));
  btf_dataset_release(dataset);
  btf_dirset_release(directions);
  return model;
}

static void render(const btf_model *model, mesh *surface, render_desc *desc, float *rgb) {
  static cli quiet = {.quiet = true, .threads = 2};
  scene s;
  assert_int_equal(scene_create(surface, &s), EXIT_DONE);
  desc->model = model;
  desc->surface = &s;
  desc->threads = 2;
  if (desc->spp == 0) desc->spp = 1;
  assert_int_equal(render_picture(&quiet, desc, rgb), EXIT_DONE);
  scene_free(&s);
}

static render_camera from_above(void) {
  return render_camera_at(vec3_make(0, 0, 0), (float)(-pi / 2), (float)(pi / 2), 10.0f, 0.18f);
}

/* L = f cos E with f = 0.6 / pi and E = pi. */
static void diffuse_plane_under_a_distant_light(void **state) {
  test_memory memory = {0};
  btf_context *ctx = test_context(&memory);
  const float albedo = 0.6f;
  btf_model *model = diffuse_model(ctx, 1, 1, &albedo);
  mesh plane;
  float rgb[8 * 8 * 3];
  (void)state;
  assert_int_equal(mesh_plane(3.0f, &plane), EXIT_DONE);
  for (int degrees = 5; degrees < 90; degrees += 10) {
    const double elevation = degrees * pi / 180.0;
    render_desc desc = {.camera = from_above(), .width = 8, .height = 8, .light_irradiance = (float)pi};
    desc.light = vec3_make((float)cos(elevation), 0.0f, (float)sin(elevation));
    render(model, &plane, &desc, rgb);
    /* a dozen float operations on the way: 12 * 2^-24 < 1e-6 */
    for (int i = 0; i < 8 * 8 * 3; i++) assert_relative(rgb[i], 0.6 * sin(elevation), 1e-5);
  }
  mesh_free(&plane);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* Under a constant sky of radiance 1 a diffuse surface shows its albedo, whatever the sampling. */
static void diffuse_plane_under_a_constant_sky(void **state) {
  enum { SIZE = 16, SPP = 256 };
  test_memory memory = {0};
  btf_context *ctx = test_context(&memory);
  const float albedo = 0.6f;
  btf_model *model = diffuse_model(ctx, 1, 1, &albedo);
  environment map;
  mesh plane;
  static float rgb[SIZE * SIZE * 3];
  double sum = 0.0;
  (void)state;
  assert_int_equal(environment_load("sky", &map), EXIT_DONE);
  for (size_t i = 0; i < 3 * (size_t)map.width * map.height; i++) map.radiance[i] = 1.0f;
  assert_int_equal(mesh_plane(1.0f, &plane), EXIT_DONE);
  render_desc desc = {.camera = from_above(), .width = SIZE, .height = SIZE, .spp = SPP, .environment = &map};
  render(model, &plane, &desc, rgb);
  for (int i = 0; i < SIZE * SIZE * 3; i++) sum += (double)rgb[i];
  /* Two strategies of bounded weight (each term at most pi f = albedo, times at most 2): a standard deviation
   * below 0.6 a sample, below 0.6 / sqrt(65536) = 0.0023 of the mean; four of those. */
  assert_near(sum / (SIZE * SIZE * 3), 0.6, 0.0094);
  mesh_free(&plane);
  environment_free(&map);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* Seen from above with +x to the right: texel (0, 0) at the lower left, (3, 0) at the lower right. */
static void texture_is_the_right_way_up(void **state) {
  test_memory memory = {0};
  btf_context *ctx = test_context(&memory);
  float albedo[16];
  float rgb[4 * 4 * 3];
  mesh plane;
  (void)state;
  for (int i = 0; i < 16; i++) albedo[i] = 0.05f + 0.05f * (float)i;
  btf_model *model = diffuse_model(ctx, 4, 4, albedo);
  assert_int_equal(mesh_plane(1.0f, &plane), EXIT_DONE);
  render_desc desc = {
      .width = 4, .height = 4, .light_irradiance = (float)pi, .light = {0, 0, 1}, .finest_level = true};
  desc.camera =
      render_camera_at(vec3_make(0, 0, 0), (float)(-pi / 2), (float)(pi / 2), 10.0f, 2.0f * atanf(0.1f));
  render(model, &plane, &desc, rgb);
  /* Pixel centres fall on texel centres to 1e-6 of the plane, that is 4e-6 texels of steps of at most 0.6. */
  for (uint32_t row = 0; row < 4; row++)
    for (uint32_t x = 0; x < 4; x++) assert_near(rgb[3 * (4 * row + x)], albedo[4 * (3 - row) + x], 1e-4);
  mesh_free(&plane);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void expect_frame(const scene_point *p) {
  assert_near(vec3_dot(p->tangent, p->tangent), 1.0, 1e-6);
  assert_near(vec3_dot(p->bitangent, p->bitangent), 1.0, 1e-6);
  assert_near(vec3_dot(p->normal, p->normal), 1.0, 1e-6);
  assert_near(vec3_dot(p->tangent, p->bitangent), 0.0, 1e-6);
  assert_near(vec3_dot(p->tangent, p->normal), 0.0, 1e-6);
  assert_near(vec3_dot(p->bitangent, p->normal), 0.0, 1e-6);
  assert_true(vec3_dot(p->tangent, p->dpdu) >= 0.0f && vec3_dot(p->bitangent, p->dpdv) >= 0.0f);
}

/* Derivatives of the sphere's position by its own u and v, against differences of neighbouring hits. */
static void sphere_frames(void **state) {
  mesh sphere;
  scene s;
  (void)state;
  assert_int_equal(mesh_sphere(3.0f, &sphere), EXIT_DONE);
  assert_int_equal(scene_create(&sphere, &s), EXIT_DONE);
  for (uint32_t i = 0; i < 500; i++) {
    float x, y;
    scene_point p, q;
    sampling_pair(7, i, &x, &y);
    const float azimuth = 6.28f * x, elevation = 2.6f * (y - 0.5f);
    const vec3 out =
        vec3_make(cosf(elevation) * cosf(azimuth), cosf(elevation) * sinf(azimuth), sinf(elevation));
    assert_true(scene_hit(&s, vec3_scale(out, 3.0f), vec3_scale(out, -1.0f), &p));
    expect_frame(&p);
    assert_near(vec3_dot(p.normal, out), 1.0, 1e-6);
    assert_true(vec3_dot(vec3_cross(p.tangent, p.bitangent), p.normal) > 0.99f); /* not mirrored */
    assert_true(p.tangent.z < 1e-6f && p.tangent.z > -1e-6f && p.bitangent.z > 0.0f);
    const float turn = 1e-3f;
    const vec3 beside = vec3_make(cosf(elevation) * cosf(azimuth + turn),
                                  cosf(elevation) * sinf(azimuth + turn), sinf(elevation));
    assert_true(scene_hit(&s, vec3_scale(beside, 3.0f), vec3_scale(beside, -1.0f), &q));
    if (fabsf(q.u - p.u) < 1.0f) { /* not across the seam */
      const vec3 predicted = vec3_scale(p.dpdu, q.u - p.u), moved = vec3_sub(q.position, p.position);
      /* curvature bends by half the step squared, floats by 3e-7 of the radius on a step of 1e-3 cos */
      assert_near(vec3_length(vec3_sub(predicted, moved)), 0.0, 4e-6);
    }
  }
  scene_free(&s);
  mesh_free(&sphere);
}

/* A sheet seen from behind and mirrored texture coordinates: the bitangent still follows v. */
static void mirrored_and_back_frames(void **state) {
  (void)state;
  for (int mirrored = 0; mirrored < 2; mirrored++)
    for (int behind = 0; behind < 2; behind++) {
      mesh plane;
      scene s;
      scene_point p;
      assert_int_equal(mesh_plane(2.0f, &plane), EXIT_DONE);
      if (mirrored)
        for (uint32_t i = 0; i < plane.vertex_count; i++) plane.vertices[i].u *= -1.0f;
      assert_int_equal(scene_create(&plane, &s), EXIT_DONE);
      const float side = behind ? -1.0f : 1.0f;
      assert_true(scene_hit(&s, vec3_make(0.3f, 0.2f, 2.0f * side), vec3_make(0.1f, 0.0f, -side), &p));
      expect_frame(&p);
      assert_near(p.normal.z, side, 1e-6);
      assert_near(p.tangent.x, mirrored ? -1.0 : 1.0, 1e-6);
      assert_near(p.bitangent.y, 1.0, 1e-6);
      scene_free(&s);
      mesh_free(&plane);
    }
}

/* The density integrates to 1, and samples fall with it: means of x, y, z and of one octant against
 * quadrature. */
static void environment_sampling(void **state) {
  enum { ACROSS = 512, DOWN = 256, SAMPLES = 1 << 16 };
  static const char *const names[] = {"studio", "sky"};
  (void)state;
  for (int m = 0; m < 2; m++) {
    environment map;
    double total = 0.0, expected[4] = {0}, got[4] = {0};
    assert_int_equal(environment_load(names[m], &map), EXIT_DONE);
    map.rotation = 0.7f;
    for (int j = 0; j < 2 * DOWN; j++)
      for (int i = 0; i < 2 * ACROSS; i++) {
        const double z = 1.0 - 2.0 * (j + 0.5) / (2 * DOWN), a = 2.0 * pi * (i + 0.5) / (2 * ACROSS),
                     r = sqrt(1 - z * z);
        const vec3 d = vec3_make((float)(r * cos(a)), (float)(r * sin(a)), (float)z);
        const double share = (double)environment_density(&map, d) * 4.0 * pi / (4.0 * ACROSS * DOWN);
        const double moments[4] = {(double)d.x, (double)d.y, (double)d.z, d.x > 0 && d.y < 0 && d.z > 0};
        total += share;
        for (int k = 0; k < 4; k++) expected[k] += share * moments[k];
      }
    for (uint32_t i = 0; i < SAMPLES; i++) {
      float x, y;
      vec3 d;
      sampling_pair(3, i, &x, &y);
      const float density = environment_sample(&map, x, y, &d);
      assert_near(vec3_length(d), 1.0, 1e-5);
      assert_true(density > 0.0f);
      const double moments[4] = {(double)d.x, (double)d.y, (double)d.z, d.x > 0 && d.y < 0 && d.z > 0};
      for (int k = 0; k < 4; k++) got[k] += moments[k] / SAMPLES;
    }
    /* The sky's sun covers a handful of quadrature cells: 1 % of its share; the samples' own noise is below
     * 1/256. */
    assert_near(total, 1.0, m == 0 ? 0.005 : 0.03);
    for (int k = 0; k < 4; k++) assert_near(got[k], expected[k] / total, m == 0 ? 0.01 : 0.03);
    environment_free(&map);
  }
}

/* Made once: it takes seconds to fall. */
static mesh cloth;
static mesh *fallen_cloth(void) {
  if (cloth.vertex_count == 0) assert_int_equal(mesh_cloth(3.0f, &cloth), EXIT_DONE);
  return &cloth;
}

static void shadows_fall(void **state) {
  scene s;
  scene_point p;
  (void)state;
  assert_int_equal(scene_create(fallen_cloth(), &s), EXIT_DONE);
  assert_true(scene_hit(&s, vec3_make(0, 0, 3), vec3_make(0, 0, -1), &p));
  assert_false(scene_blocked(&s, &p, vec3_make(0, 0, 1)));
  assert_near(p.position.z, 0.55, 0.02);                                             /* on top of the ball */
  p.lifted.z -= 0.01f;                                                               /* below the cloth */
  assert_true(scene_blocked(&s, &p, vec3_normalize(vec3_make(1.0f, 0.0f, -0.02f)))); /* out through a side */
  scene_free(&s);
}

/* Half a cylinder of radius 1 around y with few facets, and the exact normals at their corners. */
static void half_cylinder(uint32_t facets, mesh *out) {
  *out = (mesh){0};
  assert_true(mesh_reserve(out, 2 * (facets + 1), 2 * facets));
  for (uint32_t i = 0; i <= facets; i++) {
    const double turn = pi * i / facets;
    const vec3 normal = vec3_make((float)cos(turn), 0.0f, (float)sin(turn));
    for (uint32_t end = 0; end < 2; end++)
      out->vertices[2 * i + end] = (mesh_vertex){
          {normal.x, end == 0 ? -2.0f : 2.0f, normal.z}, normal, (float)i / (float)facets, (float)end};
  }
  for (uint32_t i = 0; i < facets; i++) {
    const uint32_t a = 2 * i, quad[6] = {a, a + 2, a + 3, a, a + 3, a + 1};
    for (int k = 0; k < 6; k++) out->triangles[6 * i + (uint32_t)k] = quad[k];
  }
}

/* A coarse mesh with smooth normals is lit as the smooth surface: nothing of its facets is seen where the
 * light grazes. */
static void coarse_cylinder_is_lit_smoothly(void **state) {
  enum { FACETS = 16, WIDE = 96, HIGH = 24 };
  test_memory memory = {0};
  btf_context *ctx = test_context(&memory);
  const float albedo = 0.6f;
  btf_model *model = diffuse_model(ctx, 1, 1, &albedo);
  mesh cylinder;
  static float rgb[WIDE * HIGH * 3];
  (void)state;
  half_cylinder(FACETS, &cylinder);
  /* Seen from the distance 10, picture 1.8 wide: rays lean by less than 0.09. */
  const float half_height = 0.9f * HIGH / WIDE;
  render_desc desc = {.width = WIDE, .height = HIGH, .light_irradiance = (float)pi};
  desc.camera = render_camera_at(vec3_make(0, 0, 0), (float)(-pi / 2), (float)(pi / 2), 10.0f,
                                 2 * atanf(half_height / 10));
  for (int azimuth = -60; azimuth <= 240; azimuth += 60)
    for (int elevation = 4; elevation <= 64; elevation += 12) {
      const double a = azimuth * pi / 180, e = elevation * pi / 180;
      desc.light = vec3_make((float)(cos(e) * cos(a)), (float)(cos(e) * sin(a)), (float)sin(e));
      render(model, &cylinder, &desc, rgb);
      for (int i = 0; i < WIDE * HIGH; i++) {
        /* where the pixel's ray meets the true cylinder */
        const double slope = ((i % WIDE + 0.5) / WIDE - 0.5) * 0.18;
        const double b = 10 / (1 + slope * slope), t = b - sqrt(b * b - 99 / (1 + slope * slope));
        const double x = slope * t, z = 10 - t;
        const double cosine = x * (double)desc.light.x + z * (double)desc.light.z;
        /* A facet lies at most s = 1 - cos(pi / 32) = 0.0049 below, and normals across it are those of its
         * points seen from the axis. So the x of a normal is off by s on the way along the ray (times 0.09)
         * and by s in length; with x below 0.9, where an angle is 1 / sin = 2.3 times its cosine, by 2.3
         * * 1.09 * 0.9 s = 0.011 in angle, which the cosine follows. */
        assert_near(rgb[3 * i], 0.6 * fmax(cosine, 0.0), 0.6 * 0.011);
      }
    }
  mesh_free(&cylinder);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* Where the cloth lies over the ball nothing stands in the way of a low light: it is lit by the cosine of its
 * smooth normal right to the edge of its own shadow, and a facet there turns from that by no more than a step
 * of shading that one sees. */
static void cloth_is_lit_smoothly(void **state) {
  scene s;
  uint32_t grazed = 0;
  (void)state;
  assert_int_equal(scene_create(fallen_cloth(), &s), EXIT_DONE);
  for (uint32_t i = 0; i < 20000; i++) {
    float x, y;
    scene_point p;
    sampling_pair(5, i, &x, &y);
    assert_true(
        scene_hit(&s, vec3_make(0.5f * (x - 0.5f), 0.5f * (y - 0.5f), 3.0f), vec3_make(0, 0, -1), &p));
    assert_true(vec3_dot(p.normal, p.facet_normal) > cosf(1.5f * (float)pi / 180.0f));
    for (int light = 0; light < 8; light++) {
      const float a = (float)(light * pi / 4), e = (float)(12 * pi / 180);
      const vec3 toward = vec3_make(cosf(e) * cosf(a), cosf(e) * sinf(a), sinf(e));
      const float cosine = vec3_dot(p.normal, toward);
      if (cosine <= 0.0f) continue;
      grazed += cosine < 0.03f;
      assert_false(scene_blocked(&s, &p, toward));
    }
  }
  assert_true(grazed > 500);
  scene_free(&s);
}

/* A texel is as long along u as along v, whatever the counts of the material. */
static void texels_are_square(void **state) {
  static int (*const makers[])(float, mesh *) = {mesh_plane, mesh_sphere};
  const float width = 64.0f, height = 24.0f;
  (void)state;
  for (int m = 0; m < 2; m++) {
    mesh surface;
    scene s;
    scene_point p;
    assert_int_equal(makers[m](2.0f, &surface), EXIT_DONE);
    mesh_scale_v(&surface, width / height);
    assert_int_equal(scene_create(&surface, &s), EXIT_DONE);
    const vec3 from = m == 1 ? vec3_make(0.01f, -3.0f, 0.01f) : vec3_make(0.01f, 0.02f, 3.0f);
    assert_true(scene_hit(&s, from, vec3_scale(from, -1.0f / vec3_length(from)), &p));
    const float across = vec3_length(p.dpdu) / width, up = vec3_length(p.dpdv) / height;
    /* A hundredth off the equator: 1 - cos 0.01 = 5e-5; the rest is floats. */
    assert_relative(across, up, 1e-4);
    scene_free(&s);
    mesh_free(&surface);
  }
}

static void obj_files(void **state) {
  mesh m;
  const char *good = test_path("good.obj");
  static const char quad[] = "# a quad\nv 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
                             "f 1/1 2/2 3/3 -1/-1\n";
  static const char *const bad[] = {"f 1/1 2/2 3/3\n",
                                    "v 0 0 x\n",
                                    "v 0 0 0\nvt 0 0\nf 1/1 1/1\n",
                                    "v 0 0 0\nvt 0 0\nf 1 1 1\n",
                                    "",
                                    "v 0 0 0\nvt 0 0\nf 1/1 1/1 9/1\n"};
  (void)state;
  test_write_bytes(good, quad, sizeof quad - 1);
  assert_int_equal(mesh_obj(good, 2.0f, &m), EXIT_DONE);
  assert_int_equal(m.triangle_count, 2);
  assert_near(m.vertices[2].u, 2.0, 0.0);
  assert_near(m.vertices[0].normal.z, 1.0, 1e-6);
  mesh_free(&m);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    test_write_bytes(test_path("bad.obj"), bad[i], strlen(bad[i]));
    assert_int_equal(mesh_obj(test_path("bad.obj"), 1.0f, &m), EXIT_MALFORMED);
  }
  assert_int_equal(mesh_obj(test_path("absent.obj"), 1.0f, &m), EXIT_IO);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(diffuse_plane_under_a_distant_light),
      cmocka_unit_test(diffuse_plane_under_a_constant_sky),
      cmocka_unit_test(texture_is_the_right_way_up),
      cmocka_unit_test(sphere_frames),
      cmocka_unit_test(mirrored_and_back_frames),
      cmocka_unit_test(environment_sampling),
      cmocka_unit_test(shadows_fall),
      cmocka_unit_test(coarse_cylinder_is_lit_smoothly),
      cmocka_unit_test(cloth_is_lit_smoothly),
      cmocka_unit_test(texels_are_square),
      cmocka_unit_test(obj_files),
  };
  const int status = btf_run("render", tests);
  mesh_free(&cloth);
  return status;
}
