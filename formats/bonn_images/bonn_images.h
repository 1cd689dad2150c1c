/* SPDX-License-Identifier: MIT */
/* bonn_images.h: one picture for each pair of 81 lights and 81 views, in a zip archive or a folder, as of
 * Bonn's UBO2003 and ATRIUM and of UTIA. The four angles in a picture's name say which pair it is of. */
#ifndef BTF_FORMATS_BONN_IMAGES_H
#define BTF_FORMATS_BONN_IMAGES_H

#include "source/picture.h"

#include <btf/btf_codec.h>
#include <pthread.h>

enum {
  IMAGES_DIRECTIONS = 81,
  IMAGES_PAIRS = IMAGES_DIRECTIONS * IMAGES_DIRECTIONS,
  IMAGES_NAME_BYTES = 1024,
  IMAGES_RUN = 64 /* pictures that a task looks at */
};
static const uint32_t images_none = UINT32_MAX;

/* A picture in the container. */
typedef struct image_entry {
  uint64_t name;         /* where it begins in the list's text */
  uint64_t offset;       /* of its bytes in the archive */
  uint64_t packed, size; /* bytes there, and what they unpack to; equal in a folder */
  uint32_t crc, pair;    /* pair = view * 81 + light */
  bool deflated, counter_differs;
} image_entry;

typedef struct image_list {
  image_entry *entries;
  char *text;
  uint64_t count, room, text_used, text_room;
  uint64_t skipped; /* members that are no pictures of a pair */
} image_list;

/* A pair without picture: the weighted sum of three that have one. */
typedef struct image_fill {
  uint32_t pair;
  uint32_t from[3];
  float weight[3];
} image_fill;

/* A decoded picture, rows from the bottom. */
typedef struct image_slot {
  struct image_slot *next;
  uint32_t pair, users;
  uint64_t last_used;
  bool decoding, ready;
  void *samples;
} image_slot;

typedef struct images_file {
  const btf_host *host;
  btf_context *ctx;
  char *path;
  int descriptor; /* of the archive or the folder */
  bool is_archive;
  image_list list;
  uint32_t of_pair[IMAGES_PAIRS]; /* number in the list, or images_none */
  image_fill *fills;              /* ascending pairs */
  uint32_t fill_count;
  uint64_t damaged;  /* pictures left out of the list */
  picture_info info; /* what every picture is */
  picture_rules rules;
  void *table; /* sample of each code */
  pthread_mutex_t mutex;
  pthread_cond_t decoded;
  /* under the mutex */
  image_slot *slots;
  uint32_t slot_count;
  uint64_t clock;
} images_file;

/* ---- names ---- */

typedef enum image_name { IMAGE_NAME_OTHER, IMAGE_NAME_PAIR, IMAGE_NAME_BAD } image_name;
/* Whether the last part of a path is the name of a picture: an extension of pictures and the four angles,
 * each once and among the 81 directions. */
image_name images_parse_name(const char *path, uint32_t *pair, bool *counter_differs, picture_fault *fault);
/* A pair as the four angles, for messages. */
void images_pair_text(uint32_t pair, char text[32]);

/* ---- the container ---- */

const char *images_entry_name(const images_file *file, const image_entry *entry);
btf_status images_list_add(images_file *file, const char *name, const image_entry *entry);
btf_status images_list_archive(images_file *file);
btf_status images_list_folder(images_file *file);
/* Whether there is a picture's name among the first few members. */
uint32_t images_archive_probe(const btf_host *host, btf_context *ctx, const char *path);
bool images_folder_looks_right(const char *path);

/* Room that grows, for one picture's bytes. */
typedef struct image_bytes {
  unsigned char *packed, *data;
  uint64_t packed_room, room;
  uint64_t size;
} image_bytes;
/* The first `most` bytes of a picture, or all; all are checked against the archive's checksum. */
btf_status images_fetch(const images_file *file, const image_entry *entry, uint64_t most, image_bytes *bytes,
                        picture_fault *fault);
void images_bytes_free(const images_file *file, image_bytes *bytes);

/* ---- pictures ---- */

static inline uint64_t images_sample_count(const images_file *file) {
  return (uint64_t)file->info.width * file->info.height * file->info.channels;
}
/* What the head of a picture says. */
btf_status images_look(const images_file *file, const image_entry *entry, image_bytes *bytes,
                       picture_info *info, picture_fault *fault);
/* A fault unless it is as wanted; `whose` says who else is, in the message. */
btf_status images_compare(const picture_info *info, const picture_info *wanted, const char *whose,
                          picture_fault *fault);
btf_status images_decode(const images_file *file, const image_entry *entry, image_bytes *bytes, void *samples,
                         picture_fault *fault);
/* Looks at the head of every picture; all must be like the first. */
btf_status images_check_heads(images_file *file);
/* Instead: damaged heads and those unlike most leave the list; then pictures that cannot be decoded. */
btf_status images_leave_out_heads(images_file *file);
btf_status images_leave_out_damaged(images_file *file);
/* Finds how each missing pair is interpolated. */
btf_status images_plan_fills(images_file *file);
btf_status images_read(void *user, const btf_block *block, void *dst, const btf_strides *strides);
void images_close(images_file *file);

/* ---- writing ---- */

typedef enum image_kind { IMAGE_PNG8, IMAGE_PNG16, IMAGE_HDR } image_kind;
typedef struct image_encoding {
  const btf_host *host;
  btf_context *ctx;
  image_kind kind;
  bool srgb; /* PNG: codes are of this curve, not linear */
  uint32_t width, height, channels;
  float factor; /* of the samples */
} image_encoding;
/* No file of such a picture has more bytes. */
uint64_t images_encoded_most(const image_encoding *encoding);
uint64_t images_row_bytes(const image_encoding *encoding);
/* Dense samples, rows from the bottom, as a file in `bytes`, whose room is as above; `row` has room for a
 * row. */
void images_encode(const image_encoding *encoding, const float *samples, unsigned char *row,
                   image_bytes *bytes, uint64_t *clipped, picture_fault *fault);
extern const btf_param_desc *const images_write_params[];
btf_status images_write(const btf_host *host, btf_context *ctx, const char *path, const btf_dataset *ds,
                        const btf_options *options, const btf_job *job);

#endif
