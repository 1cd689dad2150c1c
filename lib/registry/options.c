/* SPDX-License-Identifier: MIT */
/* Options of a codec or a format: text in, checked at once, numbers out. */
#include "registry/codec.h"

#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct btf_options {
  const btfi_params *params;
  btfi_value *values;     /* one for each parameter */
  btfi_wrong_name *wrong; /* during a fit or an opening */
};

/* ---- reading one value ---- */

static bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

/* A decimal number by the grammar below, whatever the locale: [+-] digits [. digits] [e [+-] digits]. */
static bool parse_number(const char *text, bool whole, double *out) {
  const char *p = text;
  locale_t c_locale;
  bool digits = false;
  if (*p == '+' || *p == '-') p++;
  for (; is_digit(*p); p++) digits = true;
  if (!whole && *p == '.')
    for (p++; is_digit(*p); p++) digits = true;
  if (!digits) return false;
  if (!whole && (*p == 'e' || *p == 'E')) {
    p++;
    if (*p == '+' || *p == '-') p++;
    if (!is_digit(*p)) return false;
    while (is_digit(*p)) p++;
  }
  if (*p != '\0') return false;
  c_locale = newlocale(LC_ALL_MASK, "C", (locale_t)0);
  if (c_locale == (locale_t)0) return false;
  *out = strtod_l(text, NULL, c_locale);
  freelocale(c_locale);
  return isfinite(*out) && (!whole || fabs(*out) <= 9007199254740992.0);
}

int32_t btfi_number(const char *text, double *out) {
  double value;
  if (!parse_number(text, false, &value)) return 0;
  *out = value;
  return 1;
}

/* A number as people write it, whatever the locale. */
static void number_text(double value, char out[32]) {
  snprintf(out, 32, "%.10g", value);
  for (char *p = out; *p != '\0'; p++)
    if (*p == ',') *p = '.';
}

/* "1 to 1024", "at least 0", "a number". */
static void range_text(const btf_param_desc *p, char out[128]) {
  char low[32], high[32];
  number_text(p->minimum, low);
  number_text(p->maximum, high);
  if (isfinite(p->minimum) && isfinite(p->maximum))
    snprintf(out, 128, "%s to %s", low, high);
  else if (isfinite(p->minimum))
    snprintf(out, 128, "%s and more", low);
  else if (isfinite(p->maximum))
    snprintf(out, 128, "%s and less", high);
  else
    snprintf(out, 128, "any");
  if (p->unit != NULL && *p->unit != '\0') snprintf(out + strlen(out), 128 - strlen(out), " %.40s", p->unit);
}

static btf_status refuse_number(btf_context *ctx, const btf_param_desc *p, const char *text, bool is_number) {
  char range[128];
  range_text(p, range);
  if (is_number) return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: %.80s is outside %s", p->name, text, range);
  return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: \"%.80s\" is not a %s; it takes %s", p->name, text,
                   p->type == BTF_PARAM_INT ? "whole number" : "number", range);
}

/* Appends as much as fits. */
static void append(char *out, size_t size, const char *text) {
  const size_t used = strlen(out);
  snprintf(out + used, size - used, "%s", text);
}

static btf_status parse_choice(btf_context *ctx, const btf_param_desc *p, const char *text, double *number) {
  char list[256] = "";
  for (uint32_t i = 0; p->choices[i] != NULL; i++) {
    if (strcmp(p->choices[i], text) == 0) {
      *number = i;
      return BTF_OK;
    }
    if (i != 0) append(list, sizeof list, ", ");
    append(list, sizeof list, p->choices[i]);
  }
  return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: \"%.80s\" is not one of %s", p->name, text, list);
}

static btf_status parse_bool(btf_context *ctx, const btf_param_desc *p, const char *text, double *number) {
  static const char *const words[2][4] = {{"0", "false", "no", "off"}, {"1", "true", "yes", "on"}};
  for (int value = 0; value < 2; value++)
    for (int i = 0; i < 4; i++)
      if (strcmp(words[value][i], text) == 0) {
        *number = value;
        return BTF_OK;
      }
  return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: \"%.80s\" is neither true nor false", p->name, text);
}

btf_status btfi_param_parse(btf_context *ctx, const btf_param_desc *param, const char *text, double *number) {
  bool is_number;
  *number = 0.0;
  switch (param->type) {
  case BTF_PARAM_INT:
  case BTF_PARAM_FLOAT:
    is_number = parse_number(text, param->type == BTF_PARAM_INT, number);
    if (is_number && *number >= param->minimum && *number <= param->maximum) return BTF_OK;
    return refuse_number(ctx, param, text, is_number);
  case BTF_PARAM_BOOL:
    return parse_bool(ctx, param, text, number);
  case BTF_PARAM_CHOICE:
    return parse_choice(ctx, param, text, number);
  default:
    return BTF_OK;
  }
}

/* ---- option sets ---- */

static const btf_param_desc *find(const btf_options *options, const char *name, uint32_t *i) {
  if (name == NULL) return NULL;
  for (*i = 0; *i < options->params->count; ++*i)
    if (strcmp(options->params->list[*i].name, name) == 0) return &options->params->list[*i];
  return NULL;
}

static btf_status refuse_name(const btfi_params *params, const char *name) {
  char list[512] = "";
  for (uint32_t i = 0; i < params->count; i++) {
    if (i != 0) append(list, sizeof list, ", ");
    append(list, sizeof list, params->list[i].name);
  }
  return btfi_fail(params->ctx, BTF_E_INVALID_ARG, "%s has no parameter \"%.80s\"; it has %s", params->owner,
                   name != NULL ? name : "", *list != '\0' ? list : "none");
}

btf_status btfi_options_create(const btfi_params *params, btf_options **out) {
  btf_context *ctx = params->ctx;
  btf_options *o = btfi_calloc(ctx, 1, sizeof *o);
  if (o == NULL) return btfi_alloc_status();
  o->params = params;
  o->values = btfi_calloc(ctx, params->count, sizeof *o->values);
  if (o->values == NULL) {
    btfi_free(ctx, o);
    return btfi_alloc_status();
  }
  for (uint32_t i = 0; i < params->count; i++) {
    const btf_status status =
        btfi_param_parse(ctx, &params->list[i], params->list[i].default_text, &o->values[i].number);
    if (status != BTF_OK) {
      btfi_free(ctx, o->values);
      btfi_free(ctx, o);
      return status;
    }
  }
  btfi_context_retain(ctx);
  *out = o;
  return BTF_OK;
}

btf_status btf_options_create(const btf_codec *codec, btf_options **out) {
  if (out != NULL) *out = NULL;
  if (codec == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_options_create: codec and out must not be NULL");
  return btfi_options_create(&codec->params, out);
}

btf_status btf_format_options_create(const btf_format *format, btf_options **out) {
  if (out != NULL) *out = NULL;
  if (format == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_format_options_create: format and out must not be NULL");
  return btfi_options_create(&format->params, out);
}

btf_status btf_options_set(btf_options *options, const char *name, const char *value) {
  const btf_param_desc *p;
  uint32_t i;
  double number;
  char *copy;
  if (options == NULL || value == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_options_set: options and value must not be NULL");
  p = find(options, name, &i);
  if (p == NULL) return refuse_name(options->params, name);
  BTFI_TRY(btfi_param_parse(options->params->ctx, p, value, &number));
  copy = btfi_strdup(options->params->ctx, value);
  if (copy == NULL) return btfi_alloc_status();
  btfi_free(options->params->ctx, options->values[i].text);
  options->values[i].text = copy;
  options->values[i].number = number;
  return BTF_OK;
}

btf_status btf_options_get(const btf_options *options, const char *name, char *buf, size_t size) {
  const btf_param_desc *p;
  const char *text;
  uint32_t i;
  if (buf != NULL && size > 0) buf[0] = '\0';
  if (options == NULL || buf == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_options_get: options and buf must not be NULL");
  p = find(options, name, &i);
  if (p == NULL) return refuse_name(options->params, name);
  text = options->values[i].text != NULL ? options->values[i].text : p->default_text;
  if (strlen(text) >= size)
    return btfi_fail(options->params->ctx, BTF_E_LIMIT, "%s: its value needs %llu bytes, the buffer has %llu",
                     p->name, (unsigned long long)strlen(text) + 1, (unsigned long long)size);
  memcpy(buf, text, strlen(text) + 1);
  return BTF_OK;
}

void btf_options_release(btf_options *options) {
  btf_context *ctx;
  if (options == NULL) return;
  ctx = options->params->ctx;
  for (uint32_t i = 0; i < options->params->count; i++) btfi_free(ctx, options->values[i].text);
  btfi_free(ctx, options->values);
  btfi_free(ctx, options);
  btf_context_release(ctx);
}

bool btfi_options_are_of_params(const btf_options *options, const btfi_params *params) {
  return options->params == params;
}
bool btfi_options_are_of(const btf_options *options, const btf_codec *codec) {
  return btfi_options_are_of_params(options, &codec->params);
}
const char *btfi_options_owner(const btf_options *options) {
  return options->params->owner;
}

/* The same for a codec or format at work: a wrong name is its mistake and ends the work. */
static const btf_param_desc *find_asked(const btf_options *options, const char *name, uint32_t *i) {
  const btf_param_desc *p = find(options, name, i);
  if (p == NULL && options->wrong != NULL && !atomic_flag_test_and_set(&options->wrong->taken))
    snprintf(options->wrong->text, sizeof options->wrong->text, "%s", name != NULL ? name : "");
  return p;
}

static btf_status wrong_name(const btfi_params *params, btfi_wrong_name *wrong, btf_status status) {
  if (!atomic_flag_test_and_set(&wrong->taken)) return status;
  return btfi_fail(params->ctx, BTF_E_INVALID_ARG,
                   "%s: it asks for an option \"%s\", which is none of its parameters", params->owner,
                   wrong->text);
}

btf_status btfi_codec_fit(const btf_codec *codec, const btf_dataset *ds, const btf_options *options,
                          const btf_job *job, btf_chunk_writer *payload) {
  btf_options asked = *options;
  btfi_wrong_name wrong = {.taken = ATOMIC_FLAG_INIT};
  asked.wrong = &wrong;
  const btf_status status = codec->vtbl.fit(btfi_host(), codec->ctx, ds, &asked, job, payload);
  return wrong_name(&codec->params, &wrong, status);
}

btf_status btfi_codec_from_factors(const btf_codec *codec, const btf_model_shape *shape,
                                   const btf_factors *factors, const btf_options *options, const btf_job *job,
                                   btf_chunk_writer *payload) {
  btf_options asked = *options;
  btfi_wrong_name wrong = {.taken = ATOMIC_FLAG_INIT};
  asked.wrong = &wrong;
  const btf_status status =
      codec->vtbl.from_factors(btfi_host(), codec->ctx, shape, factors, &asked, job, payload);
  return wrong_name(&codec->params, &wrong, status);
}

btf_status btfi_format_open_with(const btf_format *format, const char *path, const btf_options *options,
                                 btf_dataset **out) {
  btf_options asked = *options;
  btfi_wrong_name wrong = {.taken = ATOMIC_FLAG_INIT};
  asked.wrong = &wrong;
  const btf_status status =
      wrong_name(&format->params, &wrong, format->vtbl.open(btfi_host(), format->ctx, path, &asked, out));
  if (status == BTF_OK) return BTF_OK;
  btf_dataset_release(*out);
  *out = NULL;
  return status;
}

btf_status btfi_format_write_with(const btf_format *format, const char *path, const btf_dataset *ds,
                                  const btf_options *options, const btf_job *job) {
  btf_options asked = *options;
  btfi_wrong_name wrong = {.taken = ATOMIC_FLAG_INIT};
  asked.wrong = &wrong;
  const btf_status status = format->vtbl.write(btfi_host(), format->ctx, path, ds, &asked, job);
  return wrong_name(&format->write_params, &wrong, status);
}

double btfi_option(const btf_options *options, const char *name) {
  uint32_t i;
  return find_asked(options, name, &i) != NULL ? options->values[i].number : 0.0;
}

const char *btfi_option_text(const btf_options *options, const char *name) {
  uint32_t i;
  const btf_param_desc *p = find_asked(options, name, &i);
  if (p == NULL) return NULL;
  return options->values[i].text != NULL ? options->values[i].text : p->default_text;
}

int32_t btfi_option_is_set(const btf_options *options, const char *name) {
  uint32_t i;
  return find_asked(options, name, &i) != NULL && options->values[i].text != NULL ? 1 : 0;
}
