/* SPDX-License-Identifier: MIT */
/* cmd_export.c: textures, numbers and a shader for renderers on a GPU. */
#include <inttypes.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "input.h"
#include "json_writer.h"
#include "safe_text.h"
#include "viewer_page.h"

#define PAGE_FILE "index.html" /* of btf_gpu_export_write_page */
enum {
  NOTHING_LOST = 999,    /* dB, by btf_gpu_cost */
  BROWSER_TEXTURES = 16, /* in a shader, promised by WebGL 2 */
};

static const char *dimension_word(uint32_t dimension) {
  return dimension == BTF_TEXTURE_3D         ? "3D"
         : dimension == BTF_TEXTURE_CUBE     ? "cube"
         : dimension == BTF_TEXTURE_2D_ARRAY ? "2D array"
                                             : "2D";
}

static uint64_t level_bytes(const btf_gpu_texture *t) {
  uint64_t bytes = 0;
  for (uint32_t l = 0; l < t->level_count; l++) bytes += t->levels[l].size;
  return bytes;
}

static int fail_dataset(const input *in) {
  return cli_fail(EXIT_UNSUPPORTED, "%s: a data set exports nothing; btf encode makes a model of it",
                  in->path);
}

/* Options for what would be written are mistakes. */
static int check_list(const cli *c) {
  for (const cli_option *o = c->command->options; o->name != NULL; o++)
    if (cli_has(c, o->name) && strcmp(o->name, "list") != 0 && strcmp(o->name, "json") != 0)
      return cli_usage(c, "--list writes nothing and takes no --%s", o->name);
  return EXIT_DONE;
}

static void print_layouts(const btf_codec *codec) {
  const char *name, *summary;
  for (uint32_t i = 0; (name = btf_codec_gpu_layout(codec, i, &summary)) != NULL; i++)
    printf("%-14s %s%s\n", name, summary, i == 0 ? " (default)" : "");
}

static void print_layouts_json(const btf_codec *codec) {
  const char *name, *summary;
  json_writer j;
  json_begin(&j, stdout);
  json_array(&j, NULL);
  for (uint32_t i = 0; (name = btf_codec_gpu_layout(codec, i, &summary)) != NULL; i++) {
    json_object(&j, NULL);
    json_string(&j, "name", name);
    json_string(&j, "summary", summary);
    json_close(&j, '}');
  }
  json_close(&j, ']');
  json_end(&j);
}

static int list_layouts(cli *c, const input *in) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  if (in->dataset != NULL) return fail_dataset(in);
  const btf_status status = btf_model_describe(in->model, &info);
  if (status != BTF_OK) return cli_fail_library(status);
  const btf_codec *codec = btf_codec_find(c->context, info.codec_id);
  if (btf_codec_gpu_layout(codec, 0, NULL) == NULL)
    return cli_fail(EXIT_UNSUPPORTED, "%s: codec %s exports nothing for a GPU", in->path, info.codec_id);
  if (cli_has(c, "json"))
    print_layouts_json(codec);
  else
    print_layouts(codec);
  return cli_flush();
}

static int print_text(const btf_gpu_export *e, const btf_gpu_cost *cost) {
  uint64_t total = 0;
  for (uint32_t i = 0; i < btf_gpu_texture_count(e); i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    const btf_status status = btf_gpu_texture_at(e, i, &t);
    if (status != BTF_OK) return cli_fail_library(status);
    const uint64_t bytes = level_bytes(&t);
    printf("%-24s %s, %" PRIu32 "x%" PRIu32 "x%" PRIu32 ", %" PRIu32 " level%s, %" PRIu64 " bytes", t.name,
           dimension_word(t.dimension), t.width, t.height, t.depth * t.layers, t.level_count,
           t.level_count == 1 ? "" : "s", bytes);
    if (t.psnr_db != 0.0) printf(", %s", t.texel == BTF_TEXEL_BC7_UNORM ? "BC7" : "BC6H");
    if (t.psnr_db >= NOTHING_LOST)
      printf(" without loss");
    else if (t.psnr_db != 0.0)
      printf(" at %.1f dB", t.psnr_db);
    printf("\n");
    total += bytes;
  }
  printf("%" PRIu64
         " bytes of texels; an evaluation reads %.0f texels (%.0f bytes) and takes %.0f operations\n",
         total, cost->fetches, cost->bytes, cost->flops);
  if (cost->psnr_db != 0.0) {
    printf("blocks save %.0f bytes (%.0f %%)", cost->saved_bytes,
           100.0 * cost->saved_bytes / (cost->saved_bytes + cost->texture_bytes));
    if (cost->psnr_db >= NOTHING_LOST)
      printf(" without loss\n");
    else
      printf("; their texels are kept at %.1f dB\n", cost->psnr_db);
  }
  return cli_flush();
}

static void print_page(const char *folder) {
  char page[PATH_MAX];
  int length = (int)strlen(folder);
  while (length > 1 && folder[length - 1] == '/') length--;
  snprintf(page, sizeof page, "%.*s/" PAGE_FILE, length, folder);
  printf("open ");
  safe_text_put(stdout, page);
  printf(" in a browser\n");
}

/* As it is in the folder. */
static void print_manifest(const btf_gpu_export *e, bool has_page) {
  const char *after_bracket = btf_gpu_manifest(e) + 1;
  printf("{%s%s", has_page ? "\n  \"page\": \"" PAGE_FILE "\"," : "", after_bracket);
}

static int print_result(cli *c, const btf_gpu_export *e, const char *path) {
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  const uint32_t textures = btf_gpu_texture_count(e);
  const btf_status status = btf_gpu_export_cost(e, &cost);
  if (status != BTF_OK) return cli_fail_library(status);
  if (cli_has(c, "compress") && cost.psnr_db == 0.0)
    cli_note(c, "no texture is smaller in blocks, or none may lose what they lose; all stay as they are");
  if (cli_has(c, "viewer") && textures > BROWSER_TEXTURES)
    cli_note(c, "the page needs a browser that takes %u textures; %d are sure", (unsigned)textures,
             BROWSER_TEXTURES);
  if (cli_has(c, "json")) {
    print_manifest(e, cli_has(c, "viewer"));
    return cli_flush();
  }
  if (c->quiet) return EXIT_DONE;
  const int failed = print_text(e, &cost);
  if (failed || !cli_has(c, "viewer")) return failed;
  print_page(path);
  return cli_flush();
}

static int export_model(cli *c, const input *in, const char *path, const btf_gpu_target *target,
                        int32_t zstd) {
  btf_gpu_export *e;
  btf_status status = btf_gpu_export_create(in->model, target, &e);
  char *page = NULL;
  size_t page_size = 0;
  int failed = EXIT_DONE;
  if (status == BTF_E_UNSUPPORTED && in->dataset != NULL) return fail_dataset(in);
  if (status != BTF_OK) return cli_fail_library(status);
  if (cli_has(c, "viewer")) failed = viewer_page_create(e, zstd, &page, &page_size);
  if (!failed) {
    cli_hold_interrupts();
    status = btf_gpu_export_write_page(e, path, zstd, page, page_size);
    cli_release_interrupts();
    failed = status == BTF_OK ? print_result(c, e, path) : cli_fail_library(status);
  }
  free(page);
  btf_gpu_export_release(e);
  return failed;
}

static int take_compression(const cli *c, btf_gpu_target *target) {
  const char *word = cli_value(c, "compress");
  if (word == NULL) return EXIT_DONE;
  target->compress = BTF_GPU_COMPRESS_BC;
  return strcmp(word, "bc") == 0 ? EXIT_DONE
                                 : cli_fail(EXIT_USAGE, "--compress takes bc, not \"%.80s\"", word);
}

static int run(cli *c) {
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  const char *path = NULL;
  uint32_t zstd = 0;
  input in;
  int failed = cli_has(c, "list") ? check_list(c) : cli_required(c, "output", &path);
  if (!failed) failed = cli_uint32(c, "max-size", 16, 1u << 20, &target.max_2d);
  if (!failed) failed = cli_uint32(c, "max-3d", 16, 1u << 16, &target.max_3d);
  if (!failed) failed = cli_uint32(c, "max-layers", 1, 1u << 16, &target.max_layers);
  if (!failed) failed = cli_uint32(c, "max-textures", 1, 64, &target.max_textures);
  if (!failed) failed = cli_uint32(c, "zstd", 0, 22, &zstd);
  target.layout = cli_value(c, "layout");
  if (!failed) failed = take_compression(c, &target);
  if (!failed) failed = input_open_model(c, c->operands[0], &in);
  if (failed) return failed;
  failed = cli_has(c, "list") ? list_layouts(c, &in) : export_model(c, &in, path, &target, (int32_t)zstd);
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    CLI_OPTION_OUTPUT("folder to write"),
    {"layout", 0, "NAME", "one of the codec's layouts, instead of its first", 0},
    {"list", 'l', NULL, "list the layouts of the file's codec and stop", CLI_OPTION_UNRECORDED},
    {"viewer", 0, NULL, "write index.html too: a viewer that holds the export and needs no server", 0},
    {"compress", 0, "bc", "compress textures in blocks, BC7 and BC6H, and say what is lost", 0},
    {"zstd", 0, "N", "compress the texture files at this zstd level (default 0 = not at all)", 0},
    {"max-size", 0, "N", "most texels along a side of a 2D texture (default 8192)", 0},
    {"max-3d", 0, "N", "most texels along a side of a 3D texture (default 2048)", 0},
    {"max-layers", 0, "N", "most layers of an array (default 256)", 0},
    {"max-textures", 0, "N", "most textures (default 16)", 0},
    CLI_OPTION_JSON,
    CLI_OPTIONS_END};

const cli_command cmd_export = {
    "export",
    "writes GPU textures and the shader that reads them",
    "FILE -o DIR [options]\nFILE --list [--json]",
    "The folder gets manifest.json, btf.glsl with a function btf_eval(light, view, uv, "
    "lod), and a KTX 2.0 file for each\n"
    "texture. The shader is GLSL ES 3.00, GLSL 3.30 and GLSL 4.50 for Vulkan alike.",
    options,
    1,
    1,
    run};
