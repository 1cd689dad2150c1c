/* SPDX-License-Identifier: MIT */
/* cmd_compare.c: measures how far encodings are from a reference. */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "json_writer.h"
#include "metrics.h"
#include "safe_text.h"
#include "sheet.h"

typedef struct contestant {
  input in;
  sample_source source;
  metrics result;
  const char *codec;
} contestant;

/* What the raw bytes are counted in: the reference's sample type, or halves where the reference is compressed
 * itself. */
static uint32_t raw_type(const contestant *reference) {
  return reference->source.sample_type != 0 ? reference->source.sample_type : BTF_SAMPLE_F16;
}

static uint64_t raw_bytes(const contestant *reference) {
  const sample_source *s = &reference->source;
  return input_value_count(s->views, s->lights, s->width, s->height, s->channels) *
         input_sample_size(raw_type(reference));
}

static double ratio_of(const contestant *reference, const contestant *file) {
  return file->in.bytes > 0 ? (double)raw_bytes(reference) / (double)file->in.bytes : 0;
}

static void print_result(const contestant *reference, const contestant *file) {
  const metrics *m = &file->result;
  const sample_source *s = &reference->source;
  const float *l = btf_dirset_directions(s->light_set) + 3 * (size_t)m->worst_light;
  const float *v = btf_dirset_directions(s->view_set) + 3 * (size_t)m->worst_view;
  safe_text_put(stdout, file->in.path);
  fputs(": ", stdout);
  safe_text_put(stdout, file->codec);
  putchar('\n');
  printf("  values               %" PRIu64 ", %" PRIu64 " differ\n", m->values, m->different);
  printf("  peak                 %.9g (99.9th percentile of the reference)\n", m->peak);
  printf("  RMSE                 %.6g\n", m->rmse);
  printf("  relative RMSE        %.6g\n", m->relative_rmse);
  printf("  PSNR                 %.3f dB\n", m->psnr);
  printf("  mean relative error  %.6g\n", m->mean_relative_error);
  printf("  largest error        %.6g\n", m->largest_error);
  printf("  SSIM                 %.6f (mean of %" PRIu64 " images)\n", m->ssim, m->ssim_images);
  if (m->has_colour) printf("  RMSE of Y, Cb, Cr    %.6g, %.6g, %.6g\n", m->rmse_y, m->rmse_cb, m->rmse_cr);
  printf("  worst texel          x %" PRIu32 ", y %" PRIu32 " (RMSE %.6g)\n", m->worst_x, m->worst_y,
         m->worst_texel_rmse);
  printf("  worst pair           light %" PRIu32 " (%.3f %.3f %.3f), view %" PRIu32
         " (%.3f %.3f %.3f) (RMSE %.6g)\n",
         m->worst_light, (double)l[0], (double)l[1], (double)l[2], m->worst_view, (double)v[0], (double)v[1],
         (double)v[2], m->worst_pair_rmse);
  printf("  bytes                %" PRIu64 " (%.2f MiB)\n", file->in.bytes, (double)file->in.bytes / 1048576);
  printf("  ratio                %.2f to raw %s\n", ratio_of(reference, file),
         input_sample_type(raw_type(reference)));
}

static void write_direction(json_writer *j, const char *key, const btf_dirset *set, uint32_t index) {
  const float *d = btf_dirset_directions(set) + 3 * (size_t)index;
  json_flat_array(j, key);
  for (int k = 0; k < 3; k++) json_float(j, NULL, d[k]);
  json_close(j, ']');
}

static void write_result(json_writer *j, const contestant *reference, const contestant *file) {
  const metrics *m = &file->result;
  json_string(j, "file", file->in.path);
  json_string(j, "codec", file->codec);
  json_integer(j, "values", m->values);
  json_integer(j, "different", m->different);
  json_number(j, "peak", m->peak);
  json_number(j, "rmse", m->rmse);
  json_number(j, "relative_rmse", m->relative_rmse);
  json_number(j, "psnr", m->psnr);
  json_number(j, "mean_relative_error", m->mean_relative_error);
  json_number(j, "largest_error", m->largest_error);
  json_number(j, "ssim", m->ssim);
  json_integer(j, "ssim_images", m->ssim_images);
  json_number(j, "rmse_y", m->has_colour ? m->rmse_y : NAN);
  json_number(j, "rmse_cb", m->has_colour ? m->rmse_cb : NAN);
  json_number(j, "rmse_cr", m->has_colour ? m->rmse_cr : NAN);
  json_flat_object(j, "worst_texel");
  json_integer(j, "x", m->worst_x);
  json_integer(j, "y", m->worst_y);
  json_number(j, "rmse", m->worst_texel_rmse);
  json_close(j, '}');
  json_object(j, "worst_pair");
  json_integer(j, "light", m->worst_light);
  json_integer(j, "view", m->worst_view);
  write_direction(j, "light_direction", reference->source.light_set, m->worst_light);
  write_direction(j, "view_direction", reference->source.view_set, m->worst_view);
  json_number(j, "rmse", m->worst_pair_rmse);
  json_close(j, '}');
  json_integer(j, "bytes", file->in.bytes);
  json_integer(j, "raw_bytes", raw_bytes(reference));
  json_string(j, "raw_type", input_sample_type(raw_type(reference)));
  json_number(j, "ratio", ratio_of(reference, file));
}

/* One file: its figures stand at the top; several: in the array "files". */
static void write_results(const contestant *all, int files) {
  json_writer j;
  json_begin(&j, stdout);
  json_object(&j, NULL);
  json_string(&j, "reference", all[0].in.path);
  if (files == 1) {
    write_result(&j, &all[0], &all[1]);
  } else {
    json_array(&j, "files");
    for (int i = 1; i <= files; i++) {
      json_object(&j, NULL);
      write_result(&j, &all[0], &all[i]);
      json_close(&j, '}');
    }
    json_close(&j, ']');
  }
  json_close(&j, '}');
  json_end(&j);
}

static int open_contestant(cli *c, const char *path, contestant *out) {
  int failed = input_open(c, path, &out->in);
  if (!failed) failed = sample_source_open(&out->in, &out->source);
  out->codec = out->in.file != NULL ? btf_file_model_codec(out->in.file, 0) : "data set";
  return failed;
}

static int draw_sheet(const cli *c, const contestant *all, int files) {
  const char *path = cli_value(c, "sheet");
  sheet_column *columns = calloc((size_t)files + 1, sizeof *columns);
  int failed;
  if (columns == NULL) return cli_out_of_memory();
  for (int i = 0; i <= files; i++) {
    columns[i].source = &all[i].source;
    columns[i].name = all[i].in.path;
    columns[i].codec = all[i].codec;
    columns[i].bytes = all[i].in.bytes;
    columns[i].result = i > 0 ? &all[i].result : NULL;
  }
  failed = sheet_write(path, columns, files + 1);
  free(columns);
  return failed;
}

static int check_bounds(const cli *c, const contestant *all, int files, double most_rmse, double least_psnr) {
  for (int i = 1; i <= files; i++) {
    const metrics *m = &all[i].result;
    if (m->rmse > most_rmse)
      return cli_fail(EXIT_DIFFERS, "%s: RMSE is %.6g; at most %g was asked for", all[i].in.path, m->rmse,
                      most_rmse);
    if (m->psnr < least_psnr)
      return cli_fail(EXIT_DIFFERS, "%s: PSNR is %.3f dB; at least %g was asked for", all[i].in.path, m->psnr,
                      least_psnr);
    if (cli_has(c, "exact") && m->different > 0)
      return cli_fail(EXIT_DIFFERS, "%s: %" PRIu64 " of %" PRIu64 " values differ from %s", all[i].in.path,
                      m->different, m->values, all[0].in.path);
  }
  return EXIT_DONE;
}

static int compare_all(cli *c, contestant *all, int files, uint64_t ssim_images) {
  double peak = 0;
  int failed = EXIT_DONE;
  bool has_settings = false;
  for (int i = 0; i <= files && !failed; i++) {
    failed = open_contestant(c, c->operands[i], &all[i]);
    if (all[i].in.has_settings) has_settings = true;
  }
  if (!failed && !has_settings) failed = input_refuse_settings(c, c->operands[0]);
  for (int i = 1; i <= files && !failed; i++) {
    const char *difference = metrics_shape_difference(&all[0].source, &all[i].source);
    if (difference != NULL)
      failed = cli_fail(EXIT_DIFFERS, "%s: cannot be compared with %s: %s", all[i].in.path, all[0].in.path,
                        difference);
  }
  if (!failed) failed = metrics_peak(c, &all[0].source, &peak);
  for (int i = 1; i <= files && !failed; i++)
    failed = metrics_compare(c, &all[0].source, &all[i].source, peak, ssim_images, &all[i].result);
  cli_progress_done(c);
  return failed;
}

/* Before hours of comparing: the sheet is a PNG file, and no other name may say otherwise. */
static int check_sheet(const cli *c) {
  const char *path = cli_value(c, "sheet");
  const size_t length = path != NULL ? strlen(path) : 0;
  if (path == NULL || (length > 4 && strcmp(path + length - 4, ".png") == 0)) return EXIT_DONE;
  return cli_usage(c, "--sheet is \"%s\"; a contact sheet is a PNG file and its name ends in .png", path);
}

static int run(cli *c) {
  const int files = c->operand_count - 1;
  double most_rmse = INFINITY, least_psnr = -INFINITY;
  int64_t ssim_images = 1024;
  contestant *all;
  int failed = cli_number(c, "max-rmse", 0, INFINITY, &most_rmse);
  if (!failed) failed = cli_number(c, "min-psnr", -INFINITY, INFINITY, &least_psnr);
  if (!failed) failed = cli_integer(c, "ssim-images", 0, INT64_MAX, &ssim_images);
  if (!failed) failed = check_sheet(c);
  if (failed) return failed;
  all = calloc((size_t)files + 1, sizeof *all);
  if (all == NULL) return cli_out_of_memory();
  failed = compare_all(c, all, files, (uint64_t)ssim_images);
  if (!failed && cli_has(c, "sheet")) failed = draw_sheet(c, all, files);
  if (!failed) {
    if (cli_has(c, "json"))
      write_results(all, files);
    else
      for (int i = 1; i <= files; i++) print_result(&all[0], &all[i]);
    failed = check_bounds(c, all, files, most_rmse, least_psnr);
  }
  for (int i = 0; i <= files; i++) input_close(&all[i].in);
  free(all);
  return failed;
}

static const cli_option options[] = {
    CLI_OPTION_JSON,
    {"sheet", 0, "OUT.png", "write a contact sheet: reference, encodings, differences", CLI_OPTION_PATH},
    {"ssim-images", 0, "N", "images SSIM is averaged over (default 1024, evenly spread)", 0},
    {"max-rmse", 0, "X", "status 7 if the RMSE is above X", 0},
    {"min-psnr", 0, "DB", "status 7 if the PSNR is below DB", 0},
    {"exact", 0, NULL, "status 7 if any value differs", 0},
    INPUT_OPTIONS,
    CLI_OPTIONS_END};

const cli_command cmd_compare = {"compare",
                                 "measures how far encodings are from a reference",
                                 "REFERENCE FILE... [options]",
                                 "Decodes every sample of each FILE and prints RMSE, PSNR (peak: the "
                                 "reference's 99.9th percentile), mean relative\n"
                                 "error, SSIM, RMSE of Y, Cb and Cr, the worst texel and pair of directions, "
                                 "bytes and ratio. Status 7 if the shapes\n"
                                 "differ or a bound that was asked for is broken. REFERENCE and FILE\nare "
                                 "data-set folders, container files or measured data.",
                                 options,
                                 2,
                                 -1,
                                 run};
