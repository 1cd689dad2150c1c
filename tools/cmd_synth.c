/* SPDX-License-Identifier: MIT */
/* cmd_synth.c: samples a synthetic mesostructure into a data-set folder. */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "commands.h"
#include "json_writer.h"
#include "synth/synth.h"

static const char *const type_words[] = {"u8", "u16", "f16", "f32", NULL};
static const uint32_t types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_U16, BTF_SAMPLE_F16, BTF_SAMPLE_F32};
static const char *const order_words[] = {"vlyxc", "yxvlc", NULL};
static const uint32_t orders[] = {BTF_ORDER_VLYXC, BTF_ORDER_YXVLC};
static const char *const sampling_words[] = {"area", "point", NULL};
static const uint32_t samplings[] = {SYNTH_SAMPLING_AREA, SYNTH_SAMPLING_POINT};

static int print_list(const cli *c) {
  if (cli_has(c, "json")) {
    json_writer j;
    json_begin(&j, stdout);
    json_array(&j, NULL);
    for (uint32_t i = 0; synth_name(i) != NULL; i++) {
      json_object(&j, NULL);
      json_string(&j, "name", synth_name(i));
      json_string(&j, "summary", synth_summary(i));
      json_close(&j, '}');
    }
    json_close(&j, ']');
    json_end(&j);
  } else {
    for (uint32_t i = 0; synth_name(i) != NULL; i++) printf("%-10s%s\n", synth_name(i), synth_summary(i));
  }
  return cli_flush();
}

/* A name that the library knows, otherwise a file. */
static int load_directions(cli *c, btf_context *ctx, const char *text, btf_dirset **out) {
  const bool named = strncmp(text, "ubo", 3) == 0 || strncmp(text, "grid:", 5) == 0;
  struct stat info;
  btf_status status;
  if (named && stat(text, &info) != 0) {
    status = btf_dirset_create_named(ctx, text, out);
    if (status == BTF_E_INVALID_ARG)
      return cli_usage(
          c, "--directions is \"%s\"; it takes ubo81, ubo151, grid:PxT or a file of unit vectors", text);
  } else {
    status = synth_directions_load(ctx, text, out);
  }
  return status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
}

/* Every parameter that decides the bytes, given or default, so that the command gives them again. */
static void record_command(const cli *c, const synth_desc *d, const char *directions, char *text,
                           size_t size) {
  const char *base = strrchr(directions, '/');
  const char *type = "f16", *order = "vlyxc", *sampling = "area";
  if (cli_has(c, "type")) type = cli_value(c, "type");
  if (cli_has(c, "order")) order = cli_value(c, "order");
  if (cli_has(c, "sampling")) sampling = cli_value(c, "sampling");
  snprintf(text, size,
           "btf synth %s --size %" PRIu32 "x%" PRIu32 " --directions %s --spp %" PRIu32 " --bounces %" PRIu32
           " --seed %" PRIu64 " --sampling %s --type %s --order %s",
           d->name, d->width, d->height, base != NULL ? base + 1 : directions, d->spp, d->bounces, d->seed,
           sampling, type, order);
}

static int print_json(const char *path, const synth_stats *s) {
  json_writer j;
  json_begin(&j, stdout);
  json_object(&j, NULL);
  json_string(&j, "file", path);
  json_integer(&j, "samples", s->samples);
  json_number(&j, "seconds", s->seconds);
  json_number(&j, "build_seconds", s->build_seconds);
  json_integer(&j, "triangles", s->triangles);
  json_integer(&j, "path_rays", s->path_rays);
  json_integer(&j, "shadow_rays", s->shadow_rays);
  json_number(&j, "embree_rays_per_second", s->embree_rays_per_second);
  json_close(&j, '}');
  json_end(&j);
  return cli_flush();
}

static int print_stats(const cli *c, const char *path, const synth_desc *d, const synth_stats *s) {
  const uint64_t rays = s->path_rays + s->shadow_rays;
  if (cli_has(c, "json")) return print_json(path, s);
  cli_note(c, "%s: %" PRIu64 " samples of %" PRIu32 "x%" PRIu32 " texels, %.2f s", path, s->samples, d->width,
           d->height, s->seconds);
  if (rays > 0)
    cli_note(c,
             "rays: %.1f million (%.1f shadow), %.2f million a second with shading; Embree alone on the same "
             "shadow "
             "rays: %.2f million a second (%" PRIu64 " triangles, %" PRIu32 " threads, built in %.2f s)",
             1e-6 * (double)rays, 1e-6 * (double)s->shadow_rays, 1e-6 * (double)rays / s->seconds,
             1e-6 * s->embree_rays_per_second, s->triangles, d->threads, s->build_seconds);
  return EXIT_DONE;
}

static int unknown_material(const cli *c, const char *name) {
  const char *words[64];
  uint32_t count = 0;
  const char *nearest;
  if (synth_needs_rays(name))
    return cli_fail(EXIT_UNSUPPORTED, "synth: %s: this build has no Embree and makes analytic materials only",
                    name);
  while (count < 63 && synth_name(count) != NULL) {
    words[count] = synth_name(count);
    count++;
  }
  words[count] = NULL;
  nearest = cli_near_miss(name, words);
  if (nearest != NULL) return cli_usage(c, "unknown material \"%s\"; did you mean %s?", name, nearest);
  return cli_usage(c, "unknown material \"%s\"; btf synth --list lists them", name);
}

static bool known_material(const char *name) {
  for (uint32_t i = 0; synth_name(i) != NULL; i++)
    if (strcmp(synth_name(i), name) == 0) return true;
  return false;
}

static int read_options(const cli *c, synth_desc *d) {
  int type = 2, order = 0, sampling = 0;
  int failed = cli_size(c, "size", 65536, &d->width, &d->height);
  if (!failed) failed = cli_uint32(c, "spp", 1, 65536, &d->spp);
  if (!failed) failed = cli_uint32(c, "bounces", 0, 1000, &d->bounces);
  if (!failed) failed = cli_uint64(c, "seed", &d->seed);
  if (!failed) failed = cli_choice(c, "type", type_words, &type);
  if (!failed) failed = cli_choice(c, "order", order_words, &order);
  if (!failed) failed = cli_choice(c, "sampling", sampling_words, &sampling);
  d->sample_type = types[type];
  d->order = orders[order];
  d->sampling = samplings[sampling];
  return failed;
}

static int synthesise(cli *c, synth_desc *d, const char *path) {
  btf_job job = BTF_JOB_INIT;
  synth_stats stats;
  btf_status status;
  cli_job(c, &job);
  cli_hold_interrupts();
  status = synth_run(c->context, d, path, &job, &stats);
  cli_release_interrupts();
  cli_progress_done(c);
  if (status == BTF_E_CANCELLED && cli_interrupted()) return cli_fail_interrupted();
  if (status != BTF_OK) return cli_fail_library(status);
  return print_stats(c, path, d, &stats);
}

static int run(cli *c) {
  synth_desc d = {.width = 64, .height = 64, .spp = 16, .bounces = 3};
  const char *path, *directions = "ubo81";
  char command[512];
  btf_context *ctx;
  btf_dirset *set = NULL;
  int failed;
  if (cli_has(c, "list")) return print_list(c);
  if (c->operand_count != 1) return cli_usage(c, "expected the name of a material");
  d.name = c->operands[0];
  if (!known_material(d.name)) return unknown_material(c, d.name);
  failed = cli_required(c, "output", &path);
  if (!failed) failed = read_options(c, &d);
  if (!failed) failed = cli_context(c, &ctx);
  if (failed) return failed;
  if (cli_has(c, "directions")) directions = cli_value(c, "directions");
  failed = load_directions(c, ctx, directions, &set);
  if (failed) return failed;
  d.lights = d.views = set;
  d.threads = c->threads;
  record_command(c, &d, directions, command, sizeof command);
  d.source = command;
  failed = synthesise(c, &d, path);
  btf_dirset_release(set);
  return failed;
}

static const cli_option options_table[] = {
    CLI_OPTION_OUTPUT("data-set folder to write (.btfd)"),
    {"list", 'l', NULL, "list the materials and stop", CLI_OPTION_UNRECORDED},
    {"size", 's', "WxH", "texels of the square tile (default 64x64)", 0},
    {"directions", 'd', "D",
     "lights and views: ubo81 (default), ubo151, grid:PxT (azimuths x elevations),\n"
     "or a file with three numbers a line",
     CLI_OPTION_PATH},
    {"spp", 0, "N", "samples for each texel and view (default 16)", 0},
    {"bounces", 0, "N", "interreflections (default 3; 0 = direct light only)", 0},
    {"sampling", 0, "MODE", "area (default): samples spread over the texel; point: its centre", 0},
    {"seed", 0, "N", "seed of sampling and of the structure (default 0)", 0},
    {"type", 0, "T", "sample type: u8, u16, f16 (default) or f32", 0},
    {"order", 0, "O", "order of the samples: vlyxc (default, image by image) or yxvlc (texel by texel)", 0},
    CLI_OPTION_JSON,
    CLI_OPTIONS_END};

const cli_command cmd_synth = {"synth",
                               "makes a data set from a synthetic material",
                               "NAME -o OUT.btfd [options]\n--list [--json]",
                               "The values are apparent BRDFs without cosine, on an absolute scale. The same "
                               "options give the same bytes with any\n"
                               "number of threads. Named after cloths and the like, the materials are "
                               "stand-ins and measure nothing. At the end the\n"
                               "rays traced a second are printed beside those of Embree without shading. u8 "
                               "and u16 hold values up to 1; brighter\n"
                               "ones are clamped.",
                               options_table,
                               0,
                               1,
                               run};
