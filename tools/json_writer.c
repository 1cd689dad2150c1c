/* SPDX-License-Identifier: MIT */
#include "json_writer.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "safe_text.h"

/* Names of files may hold any bytes: those that are no UTF-8 become U+FFFD. Controls are escaped, for whoever
 * looks at the output in a terminal. */
static void put_text(json_writer *j, const char *text) {
  fputc('"', j->out);
  while (*text != '\0') {
    uint32_t code = 0;
    const int length = safe_text_character(text, &code);
    if (*text == '"' || *text == '\\')
      fprintf(j->out, "\\%c", *text);
    else if (length == 0)
      fputs("\\ufffd", j->out);
    else if (safe_text_is_control(code)) /* all below U+10000 */
      fprintf(j->out, "\\u%04" PRIx32, code);
    else
      fwrite(text, 1, (size_t)length, j->out);
    text += length > 0 ? length : 1;
  }
  fputc('"', j->out);
}

/* Comma, line break and key before a value. */
static void begin_value(json_writer *j, const char *key) {
  if (!j->first) fputc(',', j->out);
  if (j->depth > 0 && !j->flat[j->depth])
    fprintf(j->out, "\n%*s", (int)(2 * j->depth), "");
  else if (!j->first)
    fputc(' ', j->out);
  j->first = false;
  if (key == NULL) return;
  put_text(j, key);
  fputs(": ", j->out);
}

void json_begin(json_writer *j, FILE *out) {
  memset(j, 0, sizeof *j);
  j->out = out;
  j->first = true;
}

void json_end(json_writer *j) {
  fputc('\n', j->out);
}

static void open_bracket(json_writer *j, const char *key, char bracket, bool flat) {
  const bool inside_flat = j->depth > 0 && j->flat[j->depth];
  begin_value(j, key);
  fputc(bracket, j->out);
  if (j->depth + 1 < sizeof j->flat / sizeof *j->flat) j->depth++;
  j->flat[j->depth] = flat || inside_flat;
  j->first = true;
}

void json_object(json_writer *j, const char *key) {
  open_bracket(j, key, '{', false);
}
void json_array(json_writer *j, const char *key) {
  open_bracket(j, key, '[', false);
}
void json_flat_object(json_writer *j, const char *key) {
  open_bracket(j, key, '{', true);
}
void json_flat_array(json_writer *j, const char *key) {
  open_bracket(j, key, '[', true);
}

void json_close(json_writer *j, char bracket) {
  const bool flat = j->flat[j->depth];
  if (j->depth > 0) j->depth--;
  if (!flat && !j->first) fprintf(j->out, "\n%*s", (int)(2 * j->depth), "");
  fputc(bracket, j->out);
  j->first = false;
}

void json_null(json_writer *j, const char *key) {
  begin_value(j, key);
  fputs("null", j->out);
}

void json_string(json_writer *j, const char *key, const char *value) {
  if (value == NULL) {
    json_null(j, key);
    return;
  }
  begin_value(j, key);
  put_text(j, value);
}

void json_number(json_writer *j, const char *key, double value) {
  char text[40];
  if (!isfinite(value)) {
    json_null(j, key);
    return;
  }
  for (int digits = 9; digits <= 17; digits += 4) {
    snprintf(text, sizeof text, "%.*g", digits, value);
    if (strtod(text, NULL) == value) break;
  }
  begin_value(j, key);
  fputs(text, j->out);
}

void json_float(json_writer *j, const char *key, float value) {
  if (!isfinite(value)) {
    json_null(j, key);
    return;
  }
  begin_value(j, key);
  fprintf(j->out, "%.9g", (double)value);
}

void json_integer(json_writer *j, const char *key, uint64_t value) {
  begin_value(j, key);
  fprintf(j->out, "%" PRIu64, value);
}

void json_bool(json_writer *j, const char *key, bool value) {
  begin_value(j, key);
  fputs(value ? "true" : "false", j->out);
}
