/* SPDX-License-Identifier: MIT */
/* manifest.h: manifest.json of a data-set folder (docs/dataset-folder.md). */
#ifndef BTFI_MANIFEST_H
#define BTFI_MANIFEST_H

#include "base/base.h"
#include "dataset/dataset.h"

#define BTFI_MANIFEST_FORMAT "btf-dataset"
#define BTFI_EXPORT_FORMAT "btf-gpu" /* of a GPU export's manifest */
#define BTFI_MANIFEST_FILE "manifest.json"
enum { btfi_manifest_version = 1, btfi_manifest_most_bytes = 256 << 20 };

enum { btfi_manifest_most_notes = 256 };

typedef struct btfi_manifest {
  btfi_json *document; /* owner of all texts here */
  const char *channel_names[64];
  uint32_t width, height, channels, sample_type, order, quantity, scale, wrap;
  btf_dirset *views, *lights;
  const char *name, *source, *license, *color_space;   /* NULL = absent */
  const char *samples;                                 /* file name */
  const char *notes[2 * btfi_manifest_most_notes + 1]; /* texts of other keys: key, text, ..., NULL */
  double texels_per_mm;
  uint64_t bytes; /* of the samples */
} btfi_manifest;

/* Parses and checks a whole manifest; `label` (the path of the file) begins every message. Nothing to free on
 * failure. */
btf_status btfi_manifest_parse(btf_context *ctx, const char *label, const char *text, uint64_t size,
                               btfi_manifest *out);
void btfi_manifest_free(btfi_manifest *m);
/* BTF_OK if a text is the manifest of some version of this format; what its samples file is called. */
btf_status btfi_manifest_is_ours(btf_context *ctx, const char *label, const char *text, uint64_t size,
                                 char *samples, size_t samples_size);

/* A custom text of the manifest that is being written. */
typedef struct btfi_manifest_text {
  char *key, *value;
} btfi_manifest_text;
/* Appends the manifest of a description. */
void btfi_manifest_put(btfi_buffer *b, const btf_dataset_desc *desc, uint32_t order, const char *samples,
                       const btfi_manifest_text *texts, uint32_t text_count);
/* Whether readers of this format give a key a meaning, so that it cannot be used for something else. */
bool btfi_manifest_key_is_taken(const char *key);

#endif
