/* SPDX-License-Identifier: MIT */
/* lights.c: the lines of a list. A name may have blanks in it, so the numbers are a line's last three words.
 */
#include "rti_lp/lp.h"

enum { MOST_LIST_BYTES = 1 << 20 };

typedef struct text_line {
  const unsigned char *text;
  size_t size;
} text_line;

/* The next line that is not blank, without the blanks around it; false at the end. */
static bool next_line(const unsigned char **at, const unsigned char *end, text_line *line) {
  while (*at < end && is_blank(**at)) (*at)++;
  if (*at == end) return false;
  const unsigned char *stop = memchr(*at, '\n', (size_t)(end - *at));
  if (stop == NULL) stop = end;
  line->text = *at;
  *at = stop;
  while (is_blank(stop[-1])) stop--;
  line->size = (size_t)(stop - line->text);
  return true;
}

/* Takes the last word off a line, which must be a number. */
static bool take_last_number(const btf_host *host, text_line *line, double *out) {
  char word[CURSOR_WORD_BYTES];
  size_t size = 0;
  while (size < line->size && !is_blank(line->text[line->size - 1 - size])) size++;
  if (size == 0 || size >= sizeof word) return false;
  memcpy(word, line->text + line->size - size, size);
  word[size] = '\0';
  line->size -= size;
  while (line->size > 0 && is_blank(line->text[line->size - 1])) line->size--;
  return (host->number)(word, out);
}

/* A name, which stays in the line, and a position; of a path only the last part, whatever its system. */
static bool parse_line(const btf_host *host, text_line *line, double position[3]) {
  for (int i = 3; i-- > 0;)
    if (!take_last_number(host, line, &position[i])) return false;
  for (size_t i = line->size; i-- > 0;)
    if (line->text[i] == '/' || line->text[i] == '\\') {
      line->text += i + 1;
      line->size -= i + 1;
      break;
    }
  const bool is_folder = line->size <= 2 && memcmp(line->text, "..", line->size) == 0;
  return line->size > 0 && !is_folder;
}

static bool is_count(const btf_host *host, text_line line, double *out) {
  return take_last_number(host, &line, out) && line.size == 0;
}

bool lp_looks_right(const btf_host *host, const unsigned char *text, size_t size) {
  const unsigned char *at = text, *end = text + size;
  text_line line;
  double count, position[3];
  if (memchr(text, '\0', size) != NULL || !next_line(&at, end, &line)) return false;
  if (is_count(host, line, &count) && !next_line(&at, end, &line)) return false;
  return parse_line(host, &line, position) && memchr(line.text, '.', line.size) != NULL;
}

/* ---- the whole ---- */

static btf_status fail_light(const lp_file *lp, uint32_t index, const char *what) {
  return (lp->file.host->fail)(lp->file.ctx, BTF_E_CORRUPT, "%s: light %u %s", lp->file.path, index + 1,
                               what);
}

static btf_status add_light(lp_file *lp, uint32_t index, text_line *line) {
  double position[3], length = 0;
  if (!parse_line(lp->file.host, line, position))
    return fail_light(lp, index, "is not a name and three numbers");
  for (size_t i = 0; i < line->size; i++)
    if (line->text[i] < ' ' || line->text[i] == 0x7f)
      return fail_light(lp, index, "has control characters in its name");
  /* Far ones overflow when they are squared. */
  for (int i = 0; i < 3; i++) length = fmax(length, fabs(position[i]));
  if (!(length > 0)) return fail_light(lp, index, "has no direction");
  double square = 0;
  for (int i = 0; i < 3; i++) {
    position[i] /= length;
    square += position[i] * position[i];
  }
  for (int i = 0; i < 3; i++) lp->directions[3 * (size_t)index + i] = (float)(position[i] / sqrt(square));
  if (!(lp->directions[3 * (size_t)index + 2] > 0)) return fail_light(lp, index, "is not above the horizon");
  const size_t begin = (size_t)(line->text - lp->file.data);
  lp->names[index] = (uint32_t)begin;
  lp->text[begin + line->size] = '\0'; /* a blank stood there */
  return BTF_OK;
}

static btf_status count_lines(lp_file *lp, const unsigned char **first) {
  const source_file *file = &lp->file;
  const unsigned char *at = file->data, *end = at + file->size;
  text_line line;
  double stated = 0;
  bool states = false;
  uint64_t lines = 0;
  *first = at;
  while (next_line(&at, end, &line)) {
    if (lines == 0 && !states && is_count(file->host, line, &stated)) {
      states = true;
      *first = at;
    } else {
      lines++;
    }
  }
  if (lines == 0)
    return (file->host->fail)(file->ctx, BTF_E_TRUNCATED, "%s: lists no photographs", file->path);
  if (states && stated != (double)lines)
    return (file->host->fail)(file->ctx, stated > (double)lines ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                              "%s: lists %llu photographs and says that they are %.0f", file->path,
                              (unsigned long long)lines, fmin(stated, 1e15));
  if (lines > LP_MOST_LIGHTS)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT, "%s: lists more than %d photographs", file->path,
                              LP_MOST_LIGHTS);
  lp->count = (uint32_t)lines;
  return BTF_OK;
}

btf_status lp_read_lights(lp_file *lp) {
  const source_file *file = &lp->file;
  const btf_host *host = file->host;
  const unsigned char *at;
  text_line line;
  if (file->size == 0 || memchr(file->data, '\0', file->size) != NULL)
    return (host->fail)(file->ctx, BTF_E_NOT_BTF, "%s: is not a list of photographs", file->path);
  if (file->size > MOST_LIST_BYTES)
    return (host->fail)(file->ctx, BTF_E_LIMIT, "%s: has more than 1 MiB", file->path);
  BTF_TRY(count_lines(lp, &at));
  lp->text = (host->alloc)(file->ctx, file->size + 1, 1);
  lp->names = (host->alloc)(file->ctx, lp->count, sizeof *lp->names);
  lp->directions = (host->alloc)(file->ctx, lp->count, 3 * sizeof *lp->directions);
  if (lp->text == NULL || lp->names == NULL || lp->directions == NULL) return BTF_E_NOMEM;
  memcpy(lp->text, file->data, file->size);
  for (uint32_t i = 0; i < lp->count && next_line(&at, file->data + file->size, &line); i++)
    BTF_TRY(add_light(lp, i, &line));
  return BTF_OK;
}
