/* SPDX-License-Identifier: MIT */
/* bonn_btf.h: inside of the reader of Bonn's `.btf` containers (UBO2014 and relatives). */
#ifndef BTF_FORMATS_BONN_BTF_H
#define BTF_FORMATS_BONN_BTF_H

#include <btf/btf_half.h>

#include "source/source_file.h"

typedef enum bonn_family { BONN_DFMF, BONN_FMF, BONN_PVF, BONN_BDI } bonn_family;

/* One side of a factorisation: rows of k scalars, of which every step-th from an offset on is of one channel.
 */
typedef struct bonn_side {
  const unsigned char *rows;
  const unsigned char *mean; /* one scalar for each row, added to what is made of it; NULL = none */
} bonn_side;

/* value = dot(angular row, texel row); the channel is part of the row number on the side where there are
 * more. */
typedef struct bonn_factor {
  uint32_t scalar_size, k;
  bool channels_by_texel; /* the transposed form of FMF and PVF */
  bonn_side angular, texel;
} bonn_factor;

/* Raw samples (BDI): the field of a texel. */
typedef struct bonn_fields {
  uint32_t chunk_rows; /* rows of texels in a chunk */
  const unsigned char **chunks;
  uint32_t *rank; /* of a texel among those of its chunk that are there; NULL = all are */
} bonn_fields;

/* The list of lights of one view. */
typedef struct bonn_lights {
  const unsigned char *angles; /* two floats for each */
  uint32_t count;
  uint64_t before; /* pairs of the views before */
} bonn_lights;

typedef struct bonn_file {
  source_file file;
  bonn_family family;
  uint32_t version;
  char setup[81], sensor[81], light_source[81];
  float texels_per_mm;
  uint32_t cosine;
  uint32_t channels;
  char **channel_names; /* NULL = R, G, B */
  uint32_t view_count;
  float *views;        /* unit vectors */
  bonn_lights *lights; /* of each view */
  bool lights_differ;  /* between views */
  uint64_t pairs;      /* of a view and one of its lights */
  uint32_t width, height;
  uint32_t rotations;
  uint32_t colour_model;
  float colour_mean[3], colour_matrix[9];
  uint32_t dynamic_range;
  bonn_factor *factors; /* DFMF: one a channel; FMF: one; PVF: one a view */
  uint32_t factor_count;
  bonn_fields fields;
  bool gives_halves;    /* samples are read as they are stored (BDI) */
  uint32_t *components; /* of the products that the factors are for others (products.c) */
} bonn_file;

/* header.c: everything but the samples, checked. On failure bonn_file_close is still due. */
btf_status bonn_file_parse(bonn_file *bonn);
void bonn_file_close(bonn_file *bonn);
/* The unit vector of two angles. */
void bonn_direction(const unsigned char *angles, float xyz[3]);
bool bonn_same_lights(const bonn_lights *a, const bonn_lights *b);
bool bonn_is_signature(const unsigned char *head, uint64_t size);

/* factors.c, fields.c: what follows the directions and sizes, up to the end of the file. */
btf_status bonn_parse_factors(bonn_file *bonn, cursor *c);
btf_status bonn_parse_fields(bonn_file *bonn, cursor *c);
btf_status bonn_truncated(const bonn_file *bonn, const char *within);

/* colour.c: whether the model is one that is known for this many channels; and stored channels, planes of n
 * values, to reflectance. */
btf_status bonn_check_colour(const bonn_file *bonn);
void bonn_to_reflectance(const bonn_file *bonn, float *const *planes, size_t n);
/* Where that is linear, what a stored channel adds to a channel of reflectance, beside the mean colour;
 * otherwise false. */
bool bonn_colour_weight(const bonn_file *bonn, uint32_t stored, uint32_t channel, float *weight);
bool bonn_colour_has_mean(const bonn_file *bonn);

static inline float bonn_scalar(const unsigned char *p, uint32_t size) {
  if (size == 2) return btf_half_to_float((uint16_t)(p[0] | p[1] << 8));
  return size == 4 ? btf_get_f32(p) : (float)btf_get_f64(p);
}

/* products.c: the factorisations as others see them (btf_factors). prepare comes before the data set. */
btf_status bonn_products_prepare(bonn_file *bonn);
btf_status bonn_products(void *user, btf_factors *out);

/* lights.c: the lights that the data set shows and, where those of a view are others, the sets of all views.
 */
typedef struct bonn_common {
  btf_dirset *lights;
  btf_dirset **of_views; /* NULL: all views have `lights` */
  uint32_t views;
  char note[160]; /* what was resampled; empty: nothing */
} bonn_common;
extern const btf_param_desc bonn_param_lights;
btf_status bonn_common_lights(const bonn_file *bonn, const btf_options *options, bonn_common *out);
void bonn_common_release(const btf_host *host, btf_context *ctx, bonn_common *common);

/* write.c */
extern const btf_param_desc *const bonn_write_params[];
btf_status bonn_write(const btf_host *host, btf_context *ctx, const char *path, const btf_dataset *ds,
                      const btf_options *options, const btf_job *job);

/* read.c: the data set's source. */
btf_status bonn_read(void *user, const btf_block *block, void *dst, const btf_strides *strides);

#endif
