/* SPDX-License-Identifier: MIT */
/* svd_state.h: what the steps of one decomposition share. docs/svd.md has the equations and the names. */
#ifndef BTFI_SVD_STATE_H
#define BTFI_SVD_STATE_H

#include "svd/panel.h"
#include "svd/svd.h"

/* Sizes that follow from the matrix, the rank and the byte budget. */
typedef struct svd_plan {
  uint32_t rank, width; /* triplets to converge; columns of the panels */
  size_t length_padded; /* elements, a multiple of BTFI_SLAB_GRAIN */
  size_t block_items;   /* items per block */
  uint64_t block_count;
  size_t block_ld, block_floats;
  uint32_t run_items;     /* items read at once for the sample */
  uint64_t sample_blocks; /* blocks of the sample; of the whole matrix when it is held */
  bool held;              /* the whole matrix stays in memory after the first reading */
  bool refine;            /* there is room for the images of two bases */
  uint64_t bytes;         /* all of it, beside the result */
  uint64_t least_bytes;   /* 0, or the least that would do where the budget does not */
} svd_plan;

typedef struct svd_state {
  btf_context *ctx;
  const btf_svd_desc *desc;
  const btf_job *job;
  bool quiet;      /* the log hears nothing of a budget that is too small */
  double from, to; /* progress of the attempt at hand */
  double reached;  /* the last that was reported */
  btfi_random random;
  svd_plan plan;
  uint32_t largest_rank; /* wanted, as far as the matrix can have it */
  int exponent;          /* values are read times 2^-exponent */
  bool overflowed;       /* values, or their squares, were beyond float's range */
  bool lost;             /* singular vectors were not orthogonal, as where squares fall below float's range */

  float *blocks;            /* the held matrix or the sample */
  float *window;            /* the block last read, unless the matrix is held */
  bool loaded;              /* the held matrix has been read */
  float *projection;        /* (items + padding) x width: C */
  float *basis;             /* length_padded x width: P, orthonormal columns */
  float *image;             /* length_padded x width: Y */
  float *second_projection; /* like projection, where the plan refines */
  float *packed_basis, *packed_projection;
  float *direction; /* length_padded */
  double *norms;    /* squared norm of each item of the block at hand */
  double *small;    /* SVD_SMALL matrices of width x width */
  double *wide;     /* SVD_WIDE matrices of twice the width, and four rows of it; where the plan refines */
  double *rows;     /* scratch: max(SVD_GRAM_ROWS, width) x width, and for LAPACK */
  double *theta;    /* 5 x width */
  double *previous; /* the last part of it: Ritz values before the step at hand */

  double energy;
  double kept_energy; /* squared singular value number `rank`, as far as known before the pass */
  double sample_rest; /* squared residual that the sample promises at `rank`; 0 without a sample */
  double mean_rest;   /* squared distance of an item from the basis, on average, as far as known */
  uint32_t passes;
  uint32_t readings;                     /* the same, of the attempt at hand */
  uint32_t partial_first, partial_count; /* columns of C that strays took up on the way */

  /* Outcome of the last Rayleigh-Ritz step. */
  uint32_t found;       /* Ritz values above rounding */
  double *ritz;         /* theta + 0: of the projection on both sides, descending */
  double *ritz_before;  /* theta + width: of the basis it came from */
  double spread;        /* condition of C's Gram matrix, its columns scaled to one length */
  double *left, *right; /* small matrices: U = C left, V = Y right (width x found) */
} svd_state;

enum {
  SVD_GRAM_ROWS = 512, /* rows taken at once where a panel is met in double */
  SVD_SMALL = 8,
  SVD_WIDE = 5,
  SVD_STRAY_COLUMNS = 32,
  SVD_MAX_PASSES = 40
};

/* ---- svd_plan.c ---- */

/* A quiet refusal of the budget sets the message but does not reach the log. */
btf_status btfi_svd_plan(btf_context *ctx, const btf_svd_desc *desc, uint32_t rank, bool quiet,
                         svd_plan *plan);
/* Allocates what the plan says; the end frees it, also after a failure. */
btf_status btfi_svd_begin_state(svd_state *s);
void btfi_svd_end_state(svd_state *s);

/* ---- svd_blocks.c ---- */

/* Items of block b, and the slab over it as it lies at `data`. */
uint64_t btfi_svd_block_size(const svd_state *s, uint64_t block);
btfi_slab btfi_svd_slab(const svd_state *s, const float *data, uint64_t items);
/* Zeroes the padding that no read ever touches. */
void btfi_svd_clear_block(const svd_state *s, float *data);
/* Reads block b to where it belongs unless it is held and loaded. */
btf_status btfi_svd_fetch(svd_state *s, uint64_t block, btfi_slab *slab);
/* Finds the largest magnitude in the matrix as it is read, or fails where a value is not finite. */
btf_status btfi_svd_find_largest(svd_state *s, float *largest);
/* Reads runs of items from all over the matrix into the sample's blocks. */
btf_status btfi_svd_read_sample(svd_state *s);

/* ---- svd_ritz.c ---- */

/* Fails for values, or squares of them, that float does not hold. */
btf_status btfi_svd_not_finite(svd_state *s);
/* gram (columns x columns, row-major) = panel^T panel in double. */
void btfi_svd_gram(svd_state *s, const float *panel, size_t rows, double *gram);
/* Makes the columns of a panel orthonormal; those without a direction of their own become zero and move
 * behind the others. *kept is the number of the rest. */
btf_status btfi_svd_orthonormalise(svd_state *s, float *panel, size_t rows, uint32_t *kept);
/* panel (rows x width) = panel * map (width x columns), zero behind. */
void btfi_svd_apply(svd_state *s, float *panel, size_t rows, const double *map, uint32_t columns);
/* Ritz values and maps from C in `projection` (rows of it) and Y = M^T C in `image`. */
btf_status btfi_svd_ritz(svd_state *s, size_t rows);

/* Ritz values in the span of the basis and of the one before it (left in `image`), from the images of both in
 * `second_projection` and `projection`. The best become the basis. */
btf_status btfi_svd_ritz_pair(svd_state *s);
/* Makes columns that are nearly orthonormal, strongest first, so to rounding. */
btf_status btfi_svd_straighten(svd_state *s, float *panel, size_t rows, uint32_t columns);

/* ---- svd_start.c ---- */

/* Finds a basis from the sample, or a random one without a sample. */
btf_status btfi_svd_start(svd_state *s);
/* Makes `direction` (length_padded floats) orthogonal to the basis and of length 1, and puts it in column
 * `slot`. False if nothing is left of it. */
bool btfi_svd_set_direction(svd_state *s, float *direction, uint32_t slot);

/* ---- svd_strays.c ---- */

/* Columns of the basis beyond the rank that are given away during a pass. */
typedef struct svd_strays {
  bool watch;
  uint32_t first, count;  /* columns that may be taken */
  uint32_t filled, next;  /* in use; where the search for one to give up starts */
  uint32_t taken, trials; /* strays, and items of the crowd, taken up so far */
  bool refused;           /* a trial found no column */
  double stray_floor;     /* rest that makes an item a stray */
  double crowd_floor;     /* rest that makes it one of the crowd */
  double missed;          /* rest of strays that found no column */
  double crowd, tried;    /* rest of the crowd so far; as much of it as trials answer for */
  bool trial[SVD_STRAY_COLUMNS];
  double energy[SVD_STRAY_COLUMNS]; /* captured along each */
  double before[SVD_STRAY_COLUMNS]; /* rest of the crowd in the blocks before */
} svd_strays;

void btfi_svd_strays_begin(const svd_state *s, svd_strays *strays);
/* Takes up what stands out of a block whose rows of C and norms are known. */
void btfi_svd_strays_take(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row,
                          uint64_t items);
/* Energy that unforeseen directions may have beside what the Ritz values have of them. */
double btfi_svd_strays_missed(const svd_state *s, const svd_strays *strays);

/* ---- svd_pass.c ---- */

/* One reading of the matrix: C = M P with strays taken up, Y = M^T C, Ritz values, and the next basis.
 * *missed is what strays may have that found no column or found it late. Progress goes from first to last,
 * within 0..1. */
btf_status btfi_svd_pass(svd_state *s, double first, double last, double *missed);
/* One reading after a pass: the image of the new basis, and Ritz values in both bases together. */
btf_status btfi_svd_refine(svd_state *s, double first, double last);
/* Squared residual of the triplets found, whose left vectors are in `projection`, summed from the differences
 * themselves. */
btf_status btfi_svd_explicit_rest(svd_state *s, double first, double last, double *rest);
/* Packs rows row .. row + items - 1 of C for the product with a slab. */
void btfi_svd_pack_projection(svd_state *s, uint64_t row, uint64_t items, const btfi_slab *slab);
/* Turns Y into the right Ritz vectors, which become the basis. */
btf_status btfi_svd_next_basis(svd_state *s);
/* Progress within the attempt at hand, 0..1. */
btf_status btfi_svd_report(svd_state *s, double fraction);

#endif
