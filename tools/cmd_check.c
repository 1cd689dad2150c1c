/* SPDX-License-Identifier: MIT */
/* cmd_check.c: a physical and data audit of the samples. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "audit.h"
#include "commands.h"
#include "image/image.h"
#include "json_writer.h"
#include "output_file.h"
#include "safe_text.h"

/* Values at the largest one are a sign of saturation when they are more than this part of all. */
static const double saturated_part = 1e-4;
/* A direction that differs from its neighbours by more than this |log|, and by so many times what others do,
 * was exposed or registered otherwise. */
static const double flicker_limit = 0.2, flicker_over_usual = 4;
/* Interpolated and of a finite set of lights, an albedo of 1 may seem a little more. */
static const double albedo_limit = 1.05;

typedef struct finding {
  bool there;
  const char *key, *text;
} finding;

enum { FINDINGS = 11 };

static bool flickers(double worst, double usual) {
  return worst > flicker_limit && worst > flicker_over_usual * usual;
}

static const char *find_note(const btf_dataset_desc *d, const char *key) {
  for (size_t i = 0; d->notes != NULL && d->notes[i] != NULL; i += 2)
    if (strcmp(d->notes[i], key) == 0) return d->notes[i + 1];
  return NULL;
}

/* `d` says what is known of a data set beside its samples. */
static void judge(const sample_source *s, const audit *a, const btf_dataset_desc *d, bool absolute,
                  finding out[FINDINGS]) {
  const bool inside = s->quantity == BTF_QUANTITY_BRDF_COS;
  const finding list[FINDINGS] = {
      {a->not_finite > 0, "not_finite", "values that are not finite"},
      {a->negative > 0, "negative", "negative values"},
      {a->cut_off && (double)a->at_most > saturated_part * (double)a->values && a->at_most > 1, "saturated",
       "many values are the largest one: highlights are cut off"},
      {a->missing > 0, "missing", "pictures that are black all over"},
      {find_note(d, "images_filled") != NULL, "filled", "pictures that were missing and have been filled in"},
      {find_note(d, "lights_resampled") != NULL, "resampled",
       "lights that differ between views and have been interpolated"},
      {a->dead > 0 && a->dead < (uint64_t)s->width * s->height, "dead",
       "texels that never change, among others that do"},
      {a->cosine == AUDIT_COSINE_INSIDE && !inside, "cosine_inside",
       "the cosine of the light seems to be in the values, though they are said to be brdf"},
      {a->cosine == AUDIT_COSINE_OUTSIDE && inside, "cosine_outside",
       "the cosine of the light seems not to be in the values, though they are said to be brdf_cos"},
      {absolute && a->albedo_but_one > albedo_limit, "albedo", "more light leaves than arrives"},
      {flickers(a->flicker_light, a->flicker_light_usual) || flickers(a->flicker_view, a->flicker_view_usual),
       "flicker", "a direction is much brighter or darker than its neighbours"},
  };
  for (int i = 0; i < FINDINGS; i++) out[i] = list[i];
}

static const char *cosine_word(audit_cosine cosine) {
  return cosine == AUDIT_COSINE_INSIDE ? "inside" : cosine == AUDIT_COSINE_OUTSIDE ? "outside" : "unknown";
}

static void print_place(const char *what, uint64_t count, const audit_place *p, bool directions) {
  printf("  %-22s %" PRIu64, what, count);
  if (count > 0 && directions)
    printf(", first at x %" PRIu32 ", y %" PRIu32 ", light %" PRIu32 ", view %" PRIu32, p->x, p->y, p->light,
           p->view);
  else if (count > 0)
    printf(", first at x %" PRIu32 ", y %" PRIu32, p->x, p->y);
  putchar('\n');
}

static void print_text(const sample_source *s, const audit *a, const finding *findings) {
  int problems = 0;
  safe_text_put(stdout, s->path);
  if (a->most >= a->least)
    printf(": %" PRIu64 " values from %.6g to %.6g\n", a->values, a->least, a->most);
  else
    printf(": %" PRIu64 " values, none of them finite\n", a->values);
  print_place("not finite", a->not_finite, &a->first_not_finite, true);
  print_place("negative", a->negative, &a->first_negative, true);
  printf("  %-22s %" PRIu64 " (%.4f %%)\n", "at the largest value", a->at_most,
         100 * (double)a->at_most / (double)a->values);
  printf("  %-22s %" PRIu32, "black pictures", a->missing);
  if (a->missing > 0)
    printf(", first light %" PRIu32 ", view %" PRIu32, a->first_missing.light, a->first_missing.view);
  putchar('\n');
  print_place("texels that never vary", a->dead, &a->first_dead, false);
  if (a->pairs > 0)
    printf("  %-22s %.4f as stored, %.4f with the cosine divided out, %.4f with it multiplied in (median "
           "|log|, %" PRIu32 " pairs)\n",
           "reciprocity error", a->reciprocity, a->reciprocity_divided, a->reciprocity_multiplied, a->pairs);
  else
    printf("  %-22s no pairs of directions to compare\n", "reciprocity error");
  printf("  %-22s %s, stored as %s\n", "cosine of the light", cosine_word(a->cosine),
         input_quantity(s->quantity));
  printf("  %-22s %.4f at most, seen from view %" PRIu32 "; %.4f at x %" PRIu32 ", y %" PRIu32 "\n",
         "directional albedo", a->albedo, a->albedo_view, a->worst_albedo, a->worst_texel.x,
         a->worst_texel.y);
  printf("  %-22s %.4f at light %" PRIu32 " (others %.4f), %.4f at view %" PRIu32
         " (others %.4f; |log| to the neighbours' mean)\n",
         "flicker", a->flicker_light, a->flicker_light_index, a->flicker_light_usual, a->flicker_view,
         a->flicker_view_index, a->flicker_view_usual);
  for (int i = 0; i < FINDINGS; i++) {
    if (!findings[i].there) continue;
    printf("problem: %s\n", findings[i].text);
    problems++;
  }
  if (problems == 0) puts("no problems found");
}

static void write_place(json_writer *j, const char *key, uint64_t count, const audit_place *p) {
  json_flat_object(j, key);
  json_integer(j, "count", count);
  if (count > 0) {
    json_integer(j, "x", p->x);
    json_integer(j, "y", p->y);
    json_integer(j, "light", p->light);
    json_integer(j, "view", p->view);
  }
  json_close(j, '}');
}

static void print_json(const sample_source *s, const audit *a, const finding *findings) {
  json_writer j;
  json_begin(&j, stdout);
  json_object(&j, NULL);
  json_string(&j, "file", s->path);
  json_integer(&j, "values", a->values);
  json_number(&j, "least", a->least);
  json_number(&j, "most", a->most);
  json_integer(&j, "at_most", a->at_most);
  write_place(&j, "not_finite", a->not_finite, &a->first_not_finite);
  write_place(&j, "negative", a->negative, &a->first_negative);
  write_place(&j, "missing", a->missing, &a->first_missing);
  write_place(&j, "dead", a->dead, &a->first_dead);
  json_integer(&j, "reciprocity_pairs", a->pairs);
  json_number(&j, "reciprocity", a->reciprocity);
  json_number(&j, "reciprocity_divided", a->reciprocity_divided);
  json_number(&j, "reciprocity_multiplied", a->reciprocity_multiplied);
  json_string(&j, "cosine", cosine_word(a->cosine));
  json_string(&j, "quantity", input_quantity(s->quantity));
  json_number(&j, "albedo", a->albedo);
  json_integer(&j, "albedo_view", a->albedo_view);
  json_number(&j, "albedo_but_one", a->albedo_but_one);
  json_number(&j, "worst_albedo", a->worst_albedo);
  json_integer(&j, "worst_x", a->worst_texel.x);
  json_integer(&j, "worst_y", a->worst_texel.y);
  json_number(&j, "flicker_light", a->flicker_light);
  json_integer(&j, "flicker_light_index", a->flicker_light_index);
  json_number(&j, "flicker_light_usual", a->flicker_light_usual);
  json_number(&j, "flicker_view", a->flicker_view);
  json_integer(&j, "flicker_view_index", a->flicker_view_index);
  json_number(&j, "flicker_view_usual", a->flicker_view_usual);
  json_flat_array(&j, "problems");
  for (int i = 0; i < FINDINGS; i++)
    if (findings[i].there) json_string(&j, NULL, findings[i].key);
  json_close(&j, ']');
  json_close(&j, '}');
  json_end(&j);
}

static bool is_absolute(const input *in, const btf_dataset_desc *d) {
  if (in->dataset != NULL) return d->scale == BTF_SCALE_ABSOLUTE;
  btf_model_info m = BTF_MODEL_INFO_INIT;
  btf_model_describe(in->model, &m);
  return m.scale == BTF_SCALE_ABSOLUTE;
}

static int run(cli *c) {
  input in;
  sample_source source;
  audit result = {0};
  finding findings[FINDINGS];
  const char *sheet = cli_value(c, "sheet");
  if (sheet != NULL && !image_path_is_known(sheet))
    return cli_usage(c, "--sheet is \"%s\"; a picture ends with .png or .exr", sheet);
  int failed = sheet != NULL ? output_try(sheet) : EXIT_DONE;
  if (!failed) failed = input_open(c, c->operands[0], &in);
  if (failed) return failed;
  failed = sample_source_open(&in, &source);
  source.marks_defects = true;
  if (!failed) failed = audit_run(c, &source, &result);
  if (!failed) {
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    if (in.dataset != NULL) btf_dataset_describe(in.dataset, &d);
    judge(&source, &result, &d, is_absolute(&in, &d), findings);
    if (sheet != NULL) failed = audit_write_sheet(&source, &result, sheet);
    if (cli_has(c, "json"))
      print_json(&source, &result, findings);
    else
      print_text(&source, &result, findings);
  }
  audit_free(&result);
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    {"sheet", 0, "PATH", "write a picture of the means and of the reciprocity errors (.png or .exr)",
     CLI_OPTION_PATH | CLI_OPTION_UNRECORDED},
    INPUT_OPTIONS,
    CLI_OPTION_JSON,
    CLI_OPTIONS_END};

const cli_command cmd_check = {"check",
                               "audits the samples: values, directions, reciprocity, energy",
                               "FILE [options]",
                               "Takes data sets, measured data and containers. Looks for values that are not "
                               "finite, negative or cut off, black\n"
                               "pictures, texels that never vary, light and view directions that differ from "
                               "their neighbours, and energy that\n"
                               "comes from nowhere, and tells from reciprocity whether the cosine of the "
                               "light is in the values. What it finds is\n"
                               "printed; the status is 0 all the same.",
                               options,
                               1,
                               1,
                               run};
