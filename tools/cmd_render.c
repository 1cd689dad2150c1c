/* SPDX-License-Identifier: MIT */
/* btf render: a picture of a material on a surface. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "commands.h"
#include "image/image.h"
#include "input.h"
#include "output_file.h"
#include "render/render.h"

static const cli_option options[] = {
    CLI_OPTION_OUTPUT("the picture: .png, or .exr for linear floats"),
    {"scene", 0, "SCENE", "plane, sphere (default), cloth, or the path of an OBJ file", CLI_OPTION_PATH},
    {"light", 0, "AZ,EL", "distant light: azimuth from +x toward +y and elevation, degrees (default -130,50)",
     0},
    {"env", 0, "MAP", "light from all around: studio, sky, or a .hdr or .exr latitude-longitude map",
     CLI_OPTION_PATH},
    {"rotate", 0, "DEG", "turns the environment (--env) about the vertical", 0},
    {"camera", 0, "AZ,EL", "where the camera stands, degrees (default -90,20; the plane's -90,50)", 0},
    {"distance", 0, "X", "of the camera from the centre; subjects have radius about 1 (default 3.6)", 0},
    {"size", 's', "WxH", "pixels (default 512x512)", 0},
    {"spp", 0, "N", "samples a pixel (default 16)", 0},
    {"repeat", 0, "X", "tiles across the subject (default 3); texels are square: X * W / H tiles go up", 0},
    {"exposure", 0, "STOPS", "brighter or darker by powers of two (default 0), for PNG", 0},
    {"tone", 0, "CURVE", "clip, or filmic (default with --env), for PNG", 0},
    {"background", 0, "R,G,B",
     "linear colour behind the subject (default 0.18,0.18,0.18; with --env the map)", 0},
    {"finest", 0, NULL, "always evaluate the finest level instead of the footprint's", 0},
    {"seed", 0, "N", "of the samples (default 1)", 0},
    INPUT_OPTIONS,
    CLI_OPTIONS_END};

static float radians(double degrees) {
  return (float)(degrees * (3.14159265358979 / 180.0));
}

/* What the options say, before anything is loaded. */
typedef struct render_settings {
  const char *output, *scene_name;
  double light[2], camera[2], background[3];
  double rotate, distance, repeat, exposure;
  uint32_t width, height, spp, seed;
  int tone;
} render_settings;

/* Anything that is no scene's name is the path of an OBJ file; a bare word that names no file is a wrong
 * word. */
static int check_scene(const cli *c, const char *name) {
  static const char *const scenes[] = {"plane", "sphere", "cloth", NULL};
  const char *nearest;
  for (int i = 0; scenes[i] != NULL; i++)
    if (strcmp(name, scenes[i]) == 0) return EXIT_DONE;
  if (strchr(name, '/') != NULL || strchr(name, '.') != NULL || access(name, F_OK) == 0) return EXIT_DONE;
  nearest = cli_near_miss(name, scenes);
  if (nearest != NULL) return cli_usage(c, "no scene \"%s\"; did you mean %s?", name, nearest);
  return cli_usage(c, "no scene \"%s\"; it takes plane, sphere, cloth or the path of an OBJ file", name);
}

/* Options that would have no effect are mistakes. */
static int check_combination(const cli *c, const char *output) {
  static const char *const of_pictures[] = {"exposure", "tone", NULL};
  if (cli_has(c, "light") && cli_has(c, "env")) return cli_usage(c, "--light and --env exclude each other");
  if (cli_has(c, "rotate") && !cli_has(c, "env"))
    return cli_usage(c, "--rotate turns the environment; it goes with --env");
  for (int i = 0; of_pictures[i] != NULL; i++)
    if (cli_has(c, of_pictures[i]) && output_ends_with(output, ".exr"))
      return cli_usage(c, "--%s is for PNG; an .exr file gets linear floats as they are", of_pictures[i]);
  return EXIT_DONE;
}

static int read_settings(const cli *c, render_settings *s) {
  *s = (render_settings){.scene_name = "sphere",
                         .light = {-130.0, 50.0},
                         .camera = {-90.0, 20.0},
                         .background = {0.18, 0.18, 0.18},
                         .distance = 3.6,
                         .repeat = 3.0,
                         .width = 512,
                         .height = 512,
                         .spp = 16,
                         .seed = 1};
  int status = cli_required(c, "output", &s->output);
  if (status != EXIT_DONE) return status;
  if (!image_path_is_known(s->output)) return cli_usage(c, "%s: a picture ends in .png or .exr", s->output);
  if (cli_value(c, "scene") != NULL) s->scene_name = cli_value(c, "scene");
  if (strcmp(s->scene_name, "plane") == 0) s->camera[1] = 50.0;
  if (strcmp(s->scene_name, "cloth") == 0) {
    s->camera[1] = 32.0;
    s->distance = 3.0;
  }
  status = check_scene(c, s->scene_name);
  if (status == EXIT_DONE) status = check_combination(c, s->output);
  if (status == EXIT_DONE) status = cli_numbers(c, "light", 2, s->light);
  if (status == EXIT_DONE) status = cli_numbers(c, "camera", 2, s->camera);
  if (status == EXIT_DONE) status = cli_numbers(c, "background", 3, s->background);
  if (status == EXIT_DONE) status = cli_number(c, "rotate", -3600.0, 3600.0, &s->rotate);
  if (status == EXIT_DONE) status = cli_number(c, "distance", 1.05, 1000.0, &s->distance);
  if (status == EXIT_DONE) status = cli_number(c, "repeat", 0.001, 10000.0, &s->repeat);
  if (status == EXIT_DONE) status = cli_number(c, "exposure", -30.0, 30.0, &s->exposure);
  static const char *const curves[] = {"clip", "filmic", NULL};
  s->tone = cli_has(c, "env") ? TONE_FILMIC : TONE_CLIP;
  if (status == EXIT_DONE) status = cli_choice(c, "tone", curves, &s->tone);
  if (status == EXIT_DONE) status = cli_size(c, "size", 16384, &s->width, &s->height);
  if (status == EXIT_DONE) status = cli_uint32(c, "spp", 1, 65536, &s->spp);
  if (status == EXIT_DONE) status = cli_uint32(c, "seed", 0, UINT32_MAX, &s->seed);
  return status;
}

static int make_surface(const render_settings *s, const btf_model *model, mesh *out) {
  const float repeat = (float)s->repeat;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  int status;
  if (strcmp(s->scene_name, "plane") == 0)
    status = mesh_plane(repeat, out);
  else if (strcmp(s->scene_name, "sphere") == 0) /* a seam shows unless whole tiles go around */
    status = mesh_sphere(fmaxf(roundf(2.0f * repeat), 1.0f) / 2.0f, out);
  else if (strcmp(s->scene_name, "cloth") == 0)
    status = mesh_cloth(repeat, out);
  else
    status = mesh_obj(s->scene_name, repeat, out);
  btf_model_describe(model, &info);
  if (status == EXIT_DONE) mesh_scale_v(out, (float)info.width / (float)info.height);
  return status;
}

static int write_picture(const render_settings *s, image *picture) {
  if (!output_ends_with(s->output, ".exr")) tone_map(picture, s->exposure, s->tone);
  return image_write(picture, s->output);
}

static int draw(cli *c, const render_settings *s, const btf_model *model, const scene *surface,
                const environment *map) {
  image picture = {0};
  int status = image_create(&picture, s->width, s->height);
  if (status != EXIT_DONE) return status;
  const float azimuth = radians(s->light[0]), elevation = radians(s->light[1]);
  const render_desc desc = {
      .model = model,
      .surface = surface,
      .camera =
          render_camera_at(vec3_make(0.0f, 0.0f, strcmp(s->scene_name, "cloth") == 0 ? -0.15f : 0.0f),
                           radians(s->camera[0]), radians(s->camera[1]), (float)s->distance, radians(36.0)),
      .width = s->width,
      .height = s->height,
      .spp = s->spp,
      .light = vec3_make(cosf(elevation) * cosf(azimuth), cosf(elevation) * sinf(azimuth), sinf(elevation)),
      .light_irradiance = map == NULL ? 3.14159265f : 0.0f,
      .environment = map,
      .background = vec3_make((float)s->background[0], (float)s->background[1], (float)s->background[2]),
      .show_environment = map != NULL && !cli_has(c, "background"),
      .finest_level = cli_has(c, "finest"),
      .seed = s->seed,
      .threads = c->threads};
  cli_hold_interrupts();
  status = render_picture(c, &desc, picture.rgb);
  if (status == EXIT_DONE) status = write_picture(s, &picture);
  cli_release_interrupts();
  image_free(&picture);
  return status;
}

static int run(cli *c) {
  render_settings s;
  input in;
  mesh subject = {0};
  scene surface = {0};
  environment map = {0};
  const char *environment_name = cli_value(c, "env");
  int status = read_settings(c, &s);
  if (status == EXIT_DONE) status = input_open_model(c, c->operands[0], &in);
  if (status != EXIT_DONE) return status;
  if (environment_name != NULL) status = environment_load(environment_name, &map);
  map.rotation = radians(s.rotate);
  if (status == EXIT_DONE) status = make_surface(&s, in.model, &subject);
  if (status == EXIT_DONE) status = scene_create(&subject, &surface);
  if (status == EXIT_DONE) status = draw(c, &s, in.model, &surface, environment_name != NULL ? &map : NULL);
  scene_free(&surface);
  mesh_free(&subject);
  environment_free(&map);
  input_close(&in);
  return status;
}

const cli_command cmd_render = {
    "render",
    "renders a picture of a material",
    "FILE -o OUT.png [--scene plane|sphere|cloth|OBJ] [--light AZ,EL | --env MAP] [--size WxH] [--spp N]",
    "The world has z up and the camera stands at -y. A distant light has an irradiance of pi, so that a "
    "white diffuse\n"
    "surface facing it renders as 1. The level of detail follows each pixel's footprint on the surface.",
    options,
    1,
    1,
    run};
