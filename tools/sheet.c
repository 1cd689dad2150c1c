/* SPDX-License-Identifier: MIT */
#include "sheet.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "image/image.h"

enum {
  lights_shown = 4,
  views_shown = 2,
  rows = lights_shown * views_shown,
  most_texels = 512, /* shown of a large texture along one side */
  few_columns = 9,   /* with more, cells and letters have half the size */
  gap = 6
};

static const float paper[3] = {0.83f, 0.83f, 0.83f}, ink[3] = {0.01f, 0.01f, 0.01f};
static const double degree = 3.14159265358979323846 / 180;

/* Elevation from the normal and azimuth in degrees; the nearest measured directions are shown. */
static const double light_angles[lights_shown][2] = {{0, 0}, {35, 45}, {55, 180}, {70, 300}};
static const double view_angles[views_shown][2] = {{0, 0}, {60, 270}};

static uint32_t nearest_index(const btf_dirset *set, const double angles[2]) {
  const double theta = angles[0] * degree, phi = angles[1] * degree;
  const float d[3] = {(float)(sin(theta) * cos(phi)), (float)(sin(theta) * sin(phi)), (float)cos(theta)};
  return btf_dirset_nearest(set, d);
}

static void angles_of(const btf_dirset *set, uint32_t index, double *theta, double *phi) {
  const float *d = btf_dirset_directions(set) + 3 * (size_t)index;
  *theta = acos(fmin(1, d[2])) / degree;
  *phi = atan2(d[1], d[0]) / degree;
  if (*phi < -0.5) *phi += 360;
}

typedef struct sheet {
  const sheet_column *columns;
  int count;
  uint32_t width, height; /* texels of a cell */
  uint32_t light[lights_shown], view[views_shown];
  uint32_t cell_side; /* texels are enlarged to about this */
  uint32_t label_scale, line_height, header_height, label_width;
  image *cells; /* count x rows, linear, as lit: with the cosine of the light */
} sheet;

static int column_count(const sheet *s) {
  return 2 * s->count - 1;
}

static void choose_sizes(sheet *s) {
  const bool few = column_count(s) <= few_columns;
  s->cell_side = few ? 256 : 128;
  s->label_scale = few ? 2 : 1;
  s->line_height = FONT_HEIGHT * s->label_scale + 4;
  s->label_width = 13 * FONT_WIDTH * s->label_scale;
}

static image *cell(const sheet *s, int column, int row) {
  return &s->cells[column * rows + row];
}

/* Reads one image and turns it upright. */
static int read_cell(const sheet *s, int column, int row, float *samples) {
  const sample_source *source = s->columns[column].source;
  const uint32_t light = s->light[row % lights_shown], view = s->view[row / lights_shown];
  const float cosine = source->quantity == BTF_QUANTITY_BRDF_COS
                           ? 1
                           : btf_dirset_directions(source->light_set)[3 * (size_t)light + 2];
  image *picture = cell(s, column, row);
  const btf_status status = sample_source_read(source, view, light, 1, samples);
  const int failed = status == BTF_OK ? image_create(picture, s->width, s->height) : cli_fail_library(status);
  if (failed) return failed;
  for (uint32_t y = 0; y < s->height; y++)
    for (uint32_t x = 0; x < s->width; x++) {
      const float *sample = samples + ((size_t)y * source->width + x) * source->channels;
      float *pixel = image_pixel(picture, x, s->height - 1 - y);
      for (uint32_t c = 0; c < 3; c++) pixel[c] = cosine * sample[source->channels >= 3 ? c : 0];
    }
  return EXIT_DONE;
}

/* All cells of one column beside each other, to take percentiles of. */
static int join_cells(const sheet *s, int column, image *out) {
  const int failed = image_create(out, s->width, s->height * rows);
  for (int row = 0; row < rows && !failed; row++)
    image_paste(out, cell(s, column, row), 0, s->height * (uint32_t)row);
  return failed;
}

static int find_exposure(const sheet *s, float *exposure) {
  image all;
  const int failed = join_cells(s, 0, &all);
  float bright;
  if (failed) return failed;
  bright = tone_percentile(&all, 0.98);
  *exposure = bright > 0 ? 0.8f / bright : 1;
  image_free(&all);
  return EXIT_DONE;
}

static float display(float linear, float exposure) {
  return tone_to_srgb(linear * exposure);
}

/* The power of two that brings the differences of the worst encoding to about half of the range. */
static int find_gain(const sheet *s, float exposure, float *gain) {
  float worst = 0;
  for (int column = 1; column < s->count; column++) {
    image all, reference = {0};
    int failed = join_cells(s, column, &all);
    if (!failed) failed = join_cells(s, 0, &reference);
    for (size_t i = 0; !failed && i < (size_t)all.width * all.height * 3; i++)
      all.rgb[i] = fabsf(display(all.rgb[i], exposure) - display(reference.rgb[i], exposure));
    if (!failed) worst = fmaxf(worst, tone_percentile(&all, 0.99));
    image_free(&all);
    image_free(&reference);
    if (failed) return failed;
  }
  *gain = 1;
  while (*gain < 1024 && worst * *gain < 0.35f) *gain *= 2;
  return EXIT_DONE;
}

static int paste_enlarged(image *page, const image *picture, uint32_t times, uint32_t x, uint32_t y) {
  image large;
  const int failed = image_enlarge(picture, times, &large);
  if (failed) return failed;
  image_paste(page, &large, x, y);
  image_free(&large);
  return EXIT_DONE;
}

static int draw_cell(const sheet *s, image *page, int column, int row, float exposure, float gain,
                     uint32_t times) {
  const bool difference = column >= s->count;
  const image *shown = cell(s, difference ? column - s->count + 1 : column, row);
  const image *reference = cell(s, 0, row);
  const uint32_t x = s->label_width + (uint32_t)column * (s->width * times + gap);
  const uint32_t y =
      s->header_height + (uint32_t)row * (s->height * times + gap) + (uint32_t)(row / lights_shown) * 2 * gap;
  image toned;
  int failed = image_create(&toned, s->width, s->height);
  if (failed) return failed;
  for (size_t i = 0; i < (size_t)s->width * s->height * 3; i++) {
    toned.rgb[i] = shown->rgb[i] * exposure;
    if (difference)
      toned.rgb[i] = tone_from_srgb(
          1 - gain * fabsf(display(shown->rgb[i], exposure) - display(reference->rgb[i], exposure)));
  }
  failed = paste_enlarged(page, &toned, times, x, y);
  image_free(&toned);
  return failed;
}

/* ---- headings ---- */

enum { heading_lines = 3, heading_room = 300 };
typedef char heading[heading_lines][heading_room];

static void heading_of(const sheet *s, int column, float gain, heading lines) {
  const bool difference = column >= s->count;
  const sheet_column *k = &s->columns[difference ? column - s->count + 1 : column];
  const char *base = strrchr(k->name, '/') != NULL ? strrchr(k->name, '/') + 1 : k->name;
  snprintf(lines[0], heading_room, "%s", base[0] != '\0' ? base : k->name);
  snprintf(lines[1], heading_room, "%s %.2f MiB", k->codec, (double)k->bytes / 1048576);
  lines[2][0] = '\0';
  if (difference)
    snprintf(lines[1], heading_room, "difference x %g", (double)gain);
  else if (k->result != NULL)
    snprintf(lines[2], heading_room, "%.1f dB SSIM %.3f", k->result->psnr, k->result->ssim);
  else
    snprintf(lines[2], heading_room, "reference");
}

/* Draws a column's heading, with lines that are too long going on below; without a page it only counts them.
 */
static uint32_t draw_heading(const sheet *s, image *page, int column, float gain, uint32_t times) {
  const int64_t x = s->label_width + (int64_t)column * (s->width * times + gap);
  const size_t room = s->width * times / (FONT_WIDTH * s->label_scale);
  heading lines;
  uint32_t used = 0;
  heading_of(s, column, gain, lines);
  for (int i = 0; i < heading_lines; i++) {
    char part[heading_room];
    const char *rest = lines[i];
    do {
      const size_t length = font_break(rest, room);
      snprintf(part, sizeof part, "%.*s", (int)length, rest);
      if (page != NULL) font_draw(page, x, gap + used * (int64_t)s->line_height, s->label_scale, ink, part);
      rest += length;
      used++;
    } while (*rest != '\0');
  }
  return used;
}

static uint32_t header_height(const sheet *s, float gain, uint32_t times) {
  uint32_t most = 0;
  for (int column = 0; column < column_count(s); column++) {
    const uint32_t used = draw_heading(s, NULL, column, gain, times);
    if (used > most) most = used;
  }
  return most * s->line_height + gap;
}

static void draw_row_label(const sheet *s, image *page, int row, uint32_t times) {
  const sample_source *reference = s->columns[0].source;
  const int64_t y =
      s->header_height + (int64_t)row * (s->height * times + gap) + (int64_t)(row / lights_shown) * 2 * gap;
  char text[32];
  double theta, phi;
  angles_of(reference->light_set, s->light[row % lights_shown], &theta, &phi);
  font_draw(page, gap, y, s->label_scale, ink, "light");
  snprintf(text, sizeof text, "%3.0f, %3.0f", theta, phi);
  font_draw(page, gap, y + s->line_height, s->label_scale, ink, text);
  angles_of(reference->view_set, s->view[row / lights_shown], &theta, &phi);
  font_draw(page, gap, y + 3 * s->line_height, s->label_scale, ink, "view");
  snprintf(text, sizeof text, "%3.0f, %3.0f", theta, phi);
  font_draw(page, gap, y + 4 * s->line_height, s->label_scale, ink, text);
}

static int draw(sheet *s, const char *path) {
  const uint32_t times = s->width >= s->cell_side ? 1 : (s->cell_side + s->width / 2) / s->width;
  const int columns = column_count(s);
  const uint64_t width = s->label_width + (uint64_t)columns * (s->width * times + gap);
  uint64_t height;
  image page = {0};
  float exposure, gain;
  int failed = find_exposure(s, &exposure);
  if (!failed) failed = find_gain(s, exposure, &gain);
  if (failed) return failed;
  s->header_height = header_height(s, gain, times);
  height = s->header_height + (uint64_t)rows * (s->height * times + gap) + 2 * (views_shown - 1) * gap;
  if ((width > 65535 || height > 65535))
    failed = cli_fail(EXIT_LIMIT, "%s: the sheet would be larger than 65535 pixels", path);
  if (!failed) failed = image_create(&page, (uint32_t)width, (uint32_t)height);
  if (failed) return failed;
  image_fill(&page, paper);
  for (int column = 0; column < columns; column++) (void)draw_heading(s, &page, column, gain, times);
  for (int row = 0; row < rows && !failed; row++) {
    draw_row_label(s, &page, row, times);
    for (int column = 0; column < columns && !failed; column++)
      failed = draw_cell(s, &page, column, row, exposure, gain, times);
  }
  if (!failed) failed = image_write(&page, path);
  image_free(&page);
  return failed;
}

int sheet_write(const char *path, const sheet_column *columns, int count) {
  const sample_source *reference = columns[0].source;
  sheet s = {0};
  float *samples = malloc(sample_source_image_values(reference) * sizeof *samples);
  int failed = EXIT_DONE;
  s.columns = columns;
  s.count = count;
  choose_sizes(&s);
  s.width = reference->width < most_texels ? reference->width : most_texels;
  s.height = reference->height < most_texels ? reference->height : most_texels;
  for (int i = 0; i < lights_shown; i++) s.light[i] = nearest_index(reference->light_set, light_angles[i]);
  for (int i = 0; i < views_shown; i++) s.view[i] = nearest_index(reference->view_set, view_angles[i]);
  s.cells = calloc((size_t)count * rows, sizeof *s.cells);
  if (s.cells == NULL || samples == NULL) failed = cli_out_of_memory();
  for (int column = 0; column < count && !failed; column++)
    for (int row = 0; row < rows && !failed; row++) failed = read_cell(&s, column, row, samples);
  if (!failed) failed = draw(&s, path);
  for (int i = 0; s.cells != NULL && i < count * rows; i++) image_free(&s.cells[i]);
  free(s.cells);
  free(samples);
  return failed;
}
