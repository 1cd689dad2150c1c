/* SPDX-License-Identifier: MIT */
/* cmd_info.c: describes a container file or a data-set folder without decoding it. */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "input.h"
#include "json_writer.h"
#include "safe_text.h"

enum { label_width = 15 };

static void fourcc(uint32_t code, char out[5]) {
  for (int i = 0; i < 4; i++) {
    const char c = (char)(code >> (8 * i) & 0xff);
    out[i] = c == 0 ? ' ' : c < 0x20 || c > 0x7e ? '?' : c;
  }
  out[4] = '\0';
  for (int i = 3; i >= 0 && out[i] == ' '; i--) out[i] = '\0';
}

/* ---- text ---- */

/* Names of metadata are the file's own words, and may be longer than the column. */
static void label(const char *name) {
  int width;
  fputs("  ", stdout);
  width = safe_text_put(stdout, name);
  printf("%*s ", width < label_width ? label_width - width : 0, "");
}

static void text_line(const char *name, const char *value) {
  if (value == NULL || value[0] == '\0') return;
  label(name);
  safe_text_put(stdout, value);
  putchar('\n');
}

static void size_line(const char *name, uint64_t bytes) {
  label(name);
  printf("%" PRIu64 " bytes (%.2f MiB)\n", bytes, (double)bytes / 1048576);
}

static void directions_line(const char *name, const btf_dirset *set) {
  const uint32_t count = btf_dirset_count(set);
  const float *xyz = btf_dirset_directions(set);
  uint32_t triangles = 0;
  double least = 90, most = 0;
  btf_dirset_triangles(set, &triangles);
  for (uint32_t i = 0; i < count; i++) {
    const double z = xyz[3 * i + 2];
    const double theta = acos(z < 1 ? z : 1) * (180 / 3.14159265358979323846);
    if (theta < least) least = theta;
    if (theta > most) most = theta;
  }
  label(name);
  printf("%" PRIu32 " directions, %.1f to %.1f degrees from the normal, %" PRIu32 " triangles\n", count,
         least, most, triangles);
}

static void channels_line(uint32_t count, const char *const *names) {
  label("channels");
  printf("%" PRIu32, count);
  for (uint32_t i = 0; i < count && names != NULL && names[i] != NULL; i++) {
    fputs(i == 0 ? " (" : ", ", stdout);
    safe_text_put(stdout, names[i]);
    if (i + 1 == count) putchar(')');
  }
  putchar('\n');
}

static void model_text(const btf_model_info *m) {
  text_line("codec", m->codec_id);
  label("texels");
  printf("%" PRIu32 " x %" PRIu32 "\n", m->width, m->height);
  channels_line(m->channels, m->channel_names);
  directions_line("lights", m->lights);
  directions_line("views", m->views);
  text_line("quantity", input_quantity(m->quantity));
  text_line("scale", input_scale(m->scale));
  text_line("wrap", m->wrap == BTF_WRAP_CLAMP ? "clamp" : "periodic");
  text_line("colour space", m->color_space);
  text_line("name", m->name);
  text_line("source", m->source);
  text_line("license", m->license);
  if (m->texels_per_mm > 0) {
    label("texels per mm");
    printf("%.9g\n", m->texels_per_mm);
  }
  if (m->stored_bytes > 0) size_line("stored", m->stored_bytes);
}

static void chunks_text(const btf_file *file) {
  const uint32_t count = btf_file_chunk_count(file);
  printf("chunks %" PRIu32 "\n", count);
  if (count > 0)
    printf("  %-4s %-4s %6s %5s %14s %14s %14s %6s %8s  %s\n", "type", "tag", "index", "model", "offset",
           "stored", "raw", "method", "flags", "checksum");
  for (uint32_t i = 0; i < count; i++) {
    btf_chunk_info k = {0};
    char type[5], tag[5], model[12];
    k.struct_size = sizeof k;
    if (btf_file_chunk(file, i, &k) != BTF_OK) continue;
    fourcc(k.type, type);
    fourcc(k.tag, tag);
    if (k.model == UINT32_MAX)
      strcpy(model, "-");
    else
      snprintf(model, sizeof model, "%" PRIu32, k.model);
    printf("  %-4s %-4s %6" PRIu32 " %5s %14" PRIu64 " %14" PRIu64 " %14" PRIu64 " %6" PRIu32 " %8" PRIx32
           "  %016" PRIx64 "\n",
           type, tag, k.index, model, k.offset, k.stored, k.raw, k.method, k.flags, k.checksum);
  }
}

/* The model after the first that a key of metadata is a note of, and how the note is called there; otherwise
 * 0. */
static uint32_t model_of_note(const btf_file *file, const char **key) {
  static const char prefix[] = "btf.note.";
  const char *digits = *key + strlen(prefix);
  if (strncmp(*key, prefix, strlen(prefix)) != 0 || *digits < '1' || *digits > '9') return 0;
  char *end;
  const unsigned long long model = strtoull(digits, &end, 10);
  if (model >= btf_file_model_count(file) || end[0] != '.' || end[1] == '\0') return 0;
  *key = end + 1;
  return (uint32_t)model;
}

/* Pair i of the metadata if it is a note of that model, or with model 0 any that is not of a later one. */
static bool note_of(const btf_file *file, uint32_t i, uint32_t model, const char **key, const char **value) {
  return btf_file_metadata_at(file, i, key, value) == BTF_OK && model_of_note(file, key) == model;
}

static void notes_text(const btf_file *file, uint32_t model) {
  for (uint32_t i = 0; i < btf_file_metadata_count(file); i++) {
    const char *key, *value;
    if (note_of(file, i, model, &key, &value)) text_line(key, value);
  }
}

static void container_text(const cli *c, const input *in) {
  const uint32_t models = btf_file_model_count(in->file);
  safe_text_put(stdout, in->path);
  printf(": container\n");
  size_line("on disk", in->bytes);
  notes_text(in->file, 0);
  for (uint32_t i = 0; i < models; i++) {
    btf_model_info m = BTF_MODEL_INFO_INIT;
    printf("model %" PRIu32 "\n", i);
    if (btf_file_describe_model(in->file, i, &m) == BTF_OK) model_text(&m);
    if (i > 0) notes_text(in->file, i);
    if (btf_codec_find(c->context, btf_file_model_codec(in->file, i)) == NULL)
      text_line("note", "this build has no such codec");
  }
  chunks_text(in->file);
}

static void dataset_text(const input *in) {
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  btf_dataset_describe(in->dataset, &d);
  safe_text_put(stdout, in->path);
  printf(": data set\n");
  if (in->format != NULL) text_line("format", btf_format_title(in->format));
  size_line("on disk", in->bytes);
  label("texels");
  printf("%" PRIu32 " x %" PRIu32 "\n", d.width, d.height);
  channels_line(d.channels, d.channel_names);
  directions_line("lights", d.lights);
  directions_line("views", d.views);
  text_line("sample type", input_sample_type(d.sample_type));
  if (d.data != NULL)
    text_line("order", d.flags & BTF_DATASET_IMAGE_MAJOR ? "vlyxc (images)" : "yxvlc (apparent BRDFs)");
  text_line("quantity", input_quantity(d.quantity));
  text_line("scale", input_scale(d.scale));
  text_line("wrap", d.wrap == BTF_WRAP_CLAMP ? "clamp" : "periodic");
  text_line("colour space", d.color_space);
  text_line("name", d.name);
  text_line("source", d.source);
  text_line("license", d.license);
  if (d.texels_per_mm > 0) {
    label("texels per mm");
    printf("%.9g\n", d.texels_per_mm);
  }
  for (uint32_t i = 0; d.notes != NULL && d.notes[i] != NULL; i += 2) text_line(d.notes[i], d.notes[i + 1]);
}

/* ---- JSON ---- */

static void write_directions(json_writer *j, const char *key, const btf_dirset *set) {
  const uint32_t count = btf_dirset_count(set);
  const float *xyz = btf_dirset_directions(set);
  json_array(j, key);
  for (uint32_t i = 0; i < count; i++) {
    json_flat_array(j, NULL);
    for (int k = 0; k < 3; k++) json_float(j, NULL, xyz[3 * i + (uint32_t)k]);
    json_close(j, ']');
  }
  json_close(j, ']');
}

typedef struct description {
  uint32_t width, height, channels, quantity, scale, wrap;
  const char *const *channel_names;
  const char *color_space, *name, *source, *license;
  double texels_per_mm;
  const btf_dirset *lights, *views;
} description;

static void write_description(json_writer *j, const description *d) {
  json_integer(j, "width", d->width);
  json_integer(j, "height", d->height);
  json_flat_array(j, "channels");
  for (uint32_t i = 0; i < d->channels; i++)
    json_string(j, NULL, d->channel_names != NULL ? d->channel_names[i] : NULL);
  json_close(j, ']');
  json_string(j, "quantity", input_quantity(d->quantity));
  json_string(j, "scale", input_scale(d->scale));
  json_string(j, "wrap", d->wrap == BTF_WRAP_CLAMP ? "clamp" : "periodic");
  json_string(j, "color_space", d->color_space);
  json_string(j, "name", d->name);
  json_string(j, "source", d->source);
  json_string(j, "license", d->license);
  if (d->texels_per_mm > 0)
    json_number(j, "texels_per_mm", d->texels_per_mm);
  else
    json_null(j, "texels_per_mm");
  write_directions(j, "lights", d->lights);
  write_directions(j, "views", d->views);
}

static void write_chunks(json_writer *j, const btf_file *file) {
  json_array(j, "chunks");
  for (uint32_t i = 0; i < btf_file_chunk_count(file); i++) {
    btf_chunk_info k = {0};
    char text[20];
    k.struct_size = sizeof k;
    if (btf_file_chunk(file, i, &k) != BTF_OK) continue;
    json_flat_object(j, NULL);
    fourcc(k.type, text);
    json_string(j, "type", text);
    fourcc(k.tag, text);
    json_string(j, "tag", text);
    json_integer(j, "index", k.index);
    if (k.model == UINT32_MAX)
      json_null(j, "model");
    else
      json_integer(j, "model", k.model);
    json_integer(j, "offset", k.offset);
    json_integer(j, "stored", k.stored);
    json_integer(j, "raw", k.raw);
    json_integer(j, "method", k.method);
    json_integer(j, "flags", k.flags);
    snprintf(text, sizeof text, "%016" PRIx64, k.checksum);
    json_string(j, "checksum", text);
    json_close(j, '}');
  }
  json_close(j, ']');
}

static void write_notes(json_writer *j, const char *name, const btf_file *file, uint32_t model) {
  json_object(j, name);
  for (uint32_t i = 0; i < btf_file_metadata_count(file); i++) {
    const char *key, *value;
    if (note_of(file, i, model, &key, &value)) json_string(j, key, value);
  }
  json_close(j, '}');
}

static void container_json(const cli *c, const input *in, json_writer *j) {
  json_string(j, "kind", "container");
  json_integer(j, "bytes", in->bytes);
  write_notes(j, "metadata", in->file, 0);
  json_array(j, "models");
  for (uint32_t i = 0; i < btf_file_model_count(in->file); i++) {
    btf_model_info m = BTF_MODEL_INFO_INIT;
    description d = {0};
    json_object(j, NULL);
    json_string(j, "codec", btf_file_model_codec(in->file, i));
    json_bool(j, "codec_available", btf_codec_find(c->context, btf_file_model_codec(in->file, i)) != NULL);
    if (btf_file_describe_model(in->file, i, &m) == BTF_OK) {
      d = (description){m.width,   m.height,        m.channels,    m.quantity, m.scale,
                        m.wrap,    m.channel_names, m.color_space, m.name,     m.source,
                        m.license, m.texels_per_mm, m.lights,      m.views};
      json_integer(j, "stored_bytes", m.stored_bytes);
      write_description(j, &d);
    }
    if (i > 0) write_notes(j, "notes", in->file, i);
    json_close(j, '}');
  }
  json_close(j, ']');
  write_chunks(j, in->file);
}

static void dataset_json(const input *in, json_writer *j) {
  btf_dataset_desc s = BTF_DATASET_DESC_INIT;
  description d = {0};
  btf_dataset_describe(in->dataset, &s);
  json_string(j, "kind", "dataset");
  json_string(j, "format", in->format != NULL ? btf_format_id(in->format) : NULL);
  json_integer(j, "bytes", in->bytes);
  json_string(j, "sample_type", input_sample_type(s.sample_type));
  json_string(j, "order", s.flags & BTF_DATASET_IMAGE_MAJOR ? "vlyxc" : "yxvlc");
  d = (description){s.width,   s.height,        s.channels,    s.quantity, s.scale,
                    s.wrap,    s.channel_names, s.color_space, s.name,     s.source,
                    s.license, s.texels_per_mm, s.lights,      s.views};
  write_description(j, &d);
  json_object(j, "notes");
  for (uint32_t i = 0; s.notes != NULL && s.notes[i] != NULL; i += 2)
    json_string(j, s.notes[i], s.notes[i + 1]);
  json_close(j, '}');
}

static int run(cli *c) {
  input in = {0};
  const int failed = input_open(c, c->operands[0], &in);
  if (failed) return failed;
  if (cli_has(c, "json")) {
    json_writer j;
    json_begin(&j, stdout);
    json_object(&j, NULL);
    json_string(&j, "file", in.path);
    if (in.file != NULL)
      container_json(c, &in, &j);
    else
      dataset_json(&in, &j);
    json_close(&j, '}');
    json_end(&j);
  } else if (in.file != NULL) {
    container_text(c, &in);
  } else {
    dataset_text(&in);
  }
  input_close(&in);
  return EXIT_DONE;
}

static const cli_option options[] = {CLI_OPTION_JSON, INPUT_OPTIONS, CLI_OPTIONS_END};

const cli_command cmd_info = {"info",
                              "describes a container file, a data set or measured data",
                              "FILE [options]",
                              "Codec, sizes, directions, channels, metadata and the list of chunks with "
                              "their checksums. Works without the codec;\n"
                              "--json adds the directions themselves.",
                              options,
                              1,
                              1,
                              run};
