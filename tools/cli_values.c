/* SPDX-License-Identifier: MIT */
/* cli_values.c: typed values of options. */
#include "cli.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

int cli_count(const cli *c, const char *name) {
  int count = 0;
  for (int i = 0; i < c->given_count; i++) count += strcmp(c->given[i].option->name, name) == 0;
  return count;
}

const char *cli_value_at(const cli *c, const char *name, int i) {
  for (int g = 0; g < c->given_count; g++)
    if (strcmp(c->given[g].option->name, name) == 0 && i-- == 0) return c->given[g].value;
  return NULL;
}

const char *cli_value(const cli *c, const char *name) {
  return cli_value_at(c, name, cli_count(c, name) - 1);
}

int cli_required(const cli *c, const char *name, const char **out) {
  *out = cli_value(c, name);
  if (*out != NULL && **out != '\0') return EXIT_DONE;
  if (*out != NULL) return cli_usage(c, "--%s needs a value", name);
  return cli_usage(c, "--%s is missing", name);
}

static bool integer_of(const char *text, int64_t *out) {
  char *end;
  errno = 0;
  *out = strtoll(text, &end, 10);
  return *text != '\0' && *text != ' ' && *end == '\0' && errno == 0;
}

int cli_integer(const cli *c, const char *name, int64_t minimum, int64_t maximum, int64_t *out) {
  const char *text = cli_value(c, name);
  int64_t value;
  if (text == NULL) return EXIT_DONE;
  if (!integer_of(text, &value) || value < minimum || value > maximum)
    return cli_usage(c, "--%s is \"%s\"; it takes a whole number from %" PRId64 " to %" PRId64, name, text,
                     minimum, maximum);
  *out = value;
  return EXIT_DONE;
}

int cli_uint32(const cli *c, const char *name, uint32_t minimum, uint32_t maximum, uint32_t *out) {
  int64_t value = *out;
  const int status = cli_integer(c, name, minimum, maximum, &value);
  if (status == EXIT_DONE) *out = (uint32_t)value;
  return status;
}

int cli_uint64(const cli *c, const char *name, uint64_t *out) {
  const char *text = cli_value(c, name);
  char *end;
  uint64_t value;
  if (text == NULL) return EXIT_DONE;
  errno = 0;
  value = strtoull(text, &end, 10);
  if (*text < '0' || *text > '9' || *end != '\0' || errno != 0)
    return cli_usage(c, "--%s is \"%s\"; it takes a whole number from 0 to 18446744073709551615", name, text);
  *out = value;
  return EXIT_DONE;
}

int cli_number(const cli *c, const char *name, double minimum, double maximum, double *out) {
  const char *text = cli_value(c, name);
  char *end;
  double value;
  if (text == NULL) return EXIT_DONE;
  value = strtod(text, &end);
  if (end == text || *end != '\0' || !isfinite(value) || value < minimum || value > maximum) {
    if (isinf(minimum) && isinf(maximum))
      return cli_usage(c, "--%s is \"%s\"; it takes a number", name, text);
    if (isinf(maximum))
      return cli_usage(c, "--%s is \"%s\"; it takes a number of at least %g", name, text, minimum);
    return cli_usage(c, "--%s is \"%s\"; it takes a number from %g to %g", name, text, minimum, maximum);
  }
  *out = value;
  return EXIT_DONE;
}

int cli_size(const cli *c, const char *name, uint32_t maximum, uint32_t *width, uint32_t *height) {
  const char *text = cli_value(c, name);
  char *end;
  unsigned long w, h;
  if (text == NULL) return EXIT_DONE;
  errno = 0;
  w = h = strtoul(text, &end, 10);
  if (*text < '0' || *text > '9') end = NULL;
  if (end != NULL && (*end == 'x' || *end == 'X')) {
    const char *second = end + 1;
    h = strtoul(second, &end, 10);
    if (*second < '0' || *second > '9') end = NULL;
  }
  if (end == NULL || *end != '\0' || errno != 0 || w < 1 || h < 1 || w > maximum || h > maximum)
    return cli_usage(c, "--%s is \"%s\"; it takes WxH with both from 1 to %" PRIu32, name, text, maximum);
  *width = (uint32_t)w;
  *height = (uint32_t)h;
  return EXIT_DONE;
}

int cli_numbers(const cli *c, const char *name, int count, double *out) {
  const char *text = cli_value(c, name);
  const char *rest = text;
  if (text == NULL) return EXIT_DONE;
  for (int i = 0; i < count; i++) {
    char *end;
    const double value = strtod(rest, &end);
    if (end == rest || !isfinite(value) || *end != (i + 1 < count ? ',' : '\0'))
      return cli_usage(c, "--%s is \"%s\"; it takes %d numbers separated by commas", name, text, count);
    out[i] = value;
    rest = end + 1;
  }
  return EXIT_DONE;
}

int cli_choice(const cli *c, const char *name, const char *const *choices, int *out) {
  const char *text = cli_value(c, name);
  char list[256];
  size_t used = 0;
  if (text == NULL) return EXIT_DONE;
  list[0] = '\0';
  for (int i = 0; choices[i] != NULL; i++) {
    if (strcmp(text, choices[i]) == 0) {
      *out = i;
      return EXIT_DONE;
    }
    if (used < sizeof list)
      used += (size_t)snprintf(list + used, sizeof list - used, "%s%s",
                               i == 0                   ? ""
                               : choices[i + 1] != NULL ? ", "
                                                        : " or ",
                               choices[i]);
  }
  return cli_usage(c, "--%s is \"%s\"; it takes %s", name, text, list);
}
