/* SPDX-License-Identifier: MIT */
#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "synth.h"

#define MOST_DIRECTIONS 65536u
#define LONGEST_LINE 512

/* 1 = a direction was read, 0 = nothing on the line, -1 = not a direction. */
static int parse_line(char *line, float xyz[3]) {
  char *at = line;
  at[strcspn(at, "#\r\n")] = '\0';
  for (int i = 0; i < 3; ++i) {
    char *after;
    while (isspace((unsigned char)*at) || *at == ',') ++at;
    if (*at == '\0') return i == 0 ? 0 : -1;
    xyz[i] = strtof(at, &after);
    if (after == at) return -1;
    at = after;
  }
  while (isspace((unsigned char)*at) || *at == ',') ++at;
  return *at == '\0' ? 1 : -1;
}

static btf_status read_directions(FILE *file, const char *path, float **directions, uint32_t *count) {
  char line[LONGEST_LINE];
  uint32_t room = 0;
  for (unsigned long number = 1; fgets(line, sizeof line, file) != NULL; ++number) {
    float xyz[3];
    const bool whole = strchr(line, '\n') != NULL || feof(file);
    const int kind = parse_line(line, xyz);
    if (!whole || kind < 0)
      return btf_source_error(BTF_E_CORRUPT, "%s: line %lu is not a direction; expected three numbers x y z",
                              path, number);
    if (kind == 0) continue;
    if (*count == MOST_DIRECTIONS)
      return btf_source_error(BTF_E_LIMIT, "%s: more than %u directions", path, MOST_DIRECTIONS);
    if (*count == room) {
      float *moved;
      room = room == 0 ? 256 : 2 * room;
      moved = realloc(*directions, (size_t)room * 3 * sizeof *moved);
      if (moved == NULL) return btf_source_error(BTF_E_NOMEM, "%s: out of memory", path);
      *directions = moved;
    }
    memcpy(*directions + 3 * (size_t)(*count)++, xyz, sizeof xyz);
  }
  if (ferror(file)) return btf_source_error(BTF_E_IO, "%s: %s", path, strerror(errno));
  if (*count == 0) return btf_source_error(BTF_E_CORRUPT, "%s: holds no directions", path);
  return BTF_OK;
}

btf_status synth_directions_load(btf_context *ctx, const char *path, btf_dirset **out) {
  float *directions = NULL;
  uint32_t count = 0;
  btf_status status;
  FILE *file = fopen(path, "r");
  *out = NULL;
  if (file == NULL) return btf_source_error(BTF_E_IO, "%s: %s", path, strerror(errno));
  status = read_directions(file, path, &directions, &count);
  fclose(file);
  if (status == BTF_OK) {
    status = btf_dirset_create(ctx, directions, count, out);
    if (status != BTF_OK) {
      /* A file is at fault here, not the caller. */
      char message[400];
      snprintf(message, sizeof message, "%s", btf_error_message());
      if (status == BTF_E_INVALID_ARG) status = BTF_E_CORRUPT;
      btf_source_error(status, "%s: %s", path, message);
    }
  }
  free(directions);
  return status;
}
