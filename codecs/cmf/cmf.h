/* SPDX-License-Identifier: MIT */
/* cmf.h: inside of the chained matrix factorisation codec (docs/codecs/cmf.md).
 *
 * f(x, l, v) = S(x) * product over stages of sum over terms of ratio * P(p1(l, v)) * Q(p2(l, v)). Factors are
 * maps with values within -1 .. 1, all channels of a texel of a map side by side. Each factor of a texel x is
 * an entry of that factor's codebook, or of a table with one entry for each x. */
#ifndef BTFI_CMF_H
#define BTFI_CMF_H

#include <btf/btf_codec.h>
#include <btf/btf_plugin.h>
#include <btf/btf_sampling.h>

#include "factor.h"

enum { CMF_U8 = 0, CMF_F16 = 1, CMF_F32 = 2, CMF_STORAGES };
enum {
  CMF_MAX_LEVELS = 32,
  CMF_MAX_CHANNELS = 64,
  CMF_MAX_EDGE = 256,
  CMF_MIN_EDGE = 4,
  CMF_MAX_CODEBOOK = 65536
};
/* S and the ratios of terms after the first of each stage. */
enum { CMF_MAX_SCALES = 1 + CMF_MAX_STAGES * (CMF_MAX_TERMS - 1) };
enum { CMF_FORMAT = 1 /* of the payload */ };
enum { CMF_TURN = 256 /* angles of a rotated ABRDF in a full turn */ };

/* Payload chunks. */
#define CMF_TAG_HEAD BTF_TAG('H', 'E', 'A', 'D')
#define CMF_TAG_GLOBAL BTF_TAG('G', 'L', 'O', 'B')
#define CMF_TAG_MAPS BTF_TAG('M', 'A', 'P', 'S')
#define CMF_TAG_INDEX BTF_TAG('I', 'N', 'D', 'X')
#define CMF_TAG_SCALE BTF_TAG('S', 'C', 'A', 'L')
#define CMF_TAG_ANGLE BTF_TAG('A', 'N', 'G', 'L')

/* ---- payload (layout.c) ---- */

enum {
  CMF_FLAG_CODEBOOK = 1,
  CMF_FLAG_ROTATED = 2,
  CMF_FLAG_SIGNED = 4 /* terms after the first */,
  CMF_FLAG_CUBE = 8
};

typedef struct btfi_cmf_head {
  uint32_t storage, edge, levels, flags, stages;
  struct {
    uint32_t projection[2], terms;
  } stage[CMF_MAX_STAGES];
} btfi_cmf_head;
enum { CMF_HEAD_BYTES = 4 * (5 + 3 * CMF_MAX_STAGES) };

void btfi_cmf_put_head(const btfi_cmf_head *head, unsigned char bytes[CMF_HEAD_BYTES]);
void btfi_cmf_get_head(const unsigned char bytes[CMF_HEAD_BYTES], btfi_cmf_head *head);
uint32_t btfi_cmf_value_bytes(uint32_t storage);
/* Writes n values within 0 .. 1, or with `has_sign` within -1 .. 1. */
void btfi_cmf_store(uint32_t storage, bool has_sign, const float *values, uint64_t n, unsigned char *dst);
/* The stored values, as evaluation sees them. */
void btfi_cmf_restore(uint32_t storage, bool has_sign, const unsigned char *src, uint64_t n, float *values);
/* What byte 255 of a scale should stand for: the largest of `texels` values, or less if cutting the few above
 * it and storing the others more finely loses less of the energy of the texels. */
float btfi_cmf_full_byte(uint64_t texels, const float *scale, uint32_t stride, const double *energy,
                         uint32_t energy_stride);
/* u8 b stands for b * gain + offset. */
void btfi_cmf_decoding(uint32_t storage, bool has_sign, float *gain, float *offset);

/* ---- state (load.c) ---- */

/* Where a direction falls into maps: the first value of its four texels, whose neighbours are `channels` and
 * `channels * edge` values away, and the weight of each, four times. */
typedef struct btfi_cmf_at {
  uint32_t offset;
  float weight[16];
} btfi_cmf_at;

typedef struct btfi_cmf_state btfi_cmf_state;

/* Adds the value of one texel times `weight` to out. `entry` has one map a factor; `scale` has S and then the
 * ratios of the later terms, `channels` of each. Kernels may touch three values of scale and out beyond the
 * channels. */
typedef void (*btfi_cmf_blend_fn)(const btfi_cmf_state *s, const unsigned char *const *entry,
                                  const float *scale, float weight, const btfi_cmf_at at[CMF_PROJECTIONS],
                                  float *out);

typedef struct btfi_cmf_state_factor {
  uint32_t projection, stage, term;
  uint32_t ratio; /* 0, or the place of this term's ratio; of its first side */
  bool opens_stage, opens_term, ends_term, ends_stage;
  float gain, offset;
} btfi_cmf_state_factor;

struct btfi_cmf_state {
  const btf_host *host;
  const btf_dirset *light_set, *view_set;
  uint32_t width, height, channels, wrap;
  uint32_t levels, storage, edge, factors, scales; /* scales: 1 + ratios of a texel */
  uint32_t projections;                            /* bit set of those that factors use */
  bool cube;                                       /* cube maps, not parabolic ones */
  uint32_t row_values;                             /* channels * edge */
  uint64_t entry_bytes;
  btfi_cmf_state_factor factor[CMF_MAX_FACTORS];
  btfi_cmf_blend_fn blend;
  float global[CMF_MAX_SCALES * CMF_MAX_CHANNELS];             /* largest of each scale */
  const unsigned char *codebook[CMF_MAX_FACTORS];              /* NULL without codebooks */
  const unsigned char *table[CMF_MAX_LEVELS][CMF_MAX_FACTORS]; /* without */
  const unsigned char *index[CMF_MAX_LEVELS];                  /* factors of a texel side by side */
  uint32_t index_bytes;                                        /* 1 or 2 */
  uint32_t entries[CMF_MAX_FACTORS];
  const unsigned char *scale[CMF_MAX_LEVELS];
  const unsigned char *angle[CMF_MAX_LEVELS]; /* NULL unless rotated */
  float cosine[CMF_TURN], sine[CMF_TURN];
  uint64_t resident;
};

btf_status btfi_cmf_load(const btf_host *host, btf_context *ctx, uint32_t format,
                         const btf_model_shape *shape, btf_chunk_reader *payload, void **state);
void btfi_cmf_destroy(const btf_host *host, btf_context *ctx, void *state);

/* ---- evaluation (eval.c, kernel_*.c) ---- */

void btfi_cmf_eval(const void *state, const btf_query *query, float *out);
void btfi_cmf_eval_n(const void *state, const btf_batch *batch, float *const *out);
void btfi_cmf_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                    float *out);
/* The kernel for maps of a model. */
btfi_cmf_blend_fn btfi_cmf_blend_of(uint32_t isa, uint32_t storage, uint32_t channels, uint32_t edge);

#if defined(__x86_64__)
/* NULL where the scalar one serves. */
btfi_cmf_blend_fn btfi_cmf_blend_avx2(uint32_t storage, uint32_t channels, uint32_t edge);
#endif

/* ---- export for a GPU (gpu.c) ---- */

extern const btf_gpu_layout_desc *const btfi_cmf_gpu_layouts[];
btf_status btfi_cmf_gpu(const btf_host *host, btf_context *ctx, const void *state,
                        const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                        btf_gpu_builder *out);

/* ---- fit (fit.c, texels.c, write.c, target.c) ---- */

btf_status btfi_cmf_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                        const btf_options *options, const btf_job *job, btf_chunk_writer *payload);

#endif
