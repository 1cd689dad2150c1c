/* SPDX-License-Identifier: MIT */
/* fuzz_codec.h: how an input of fuzz_codec.c is written, for programs that write them. */
#ifndef FUZZ_CODEC_H
#define FUZZ_CODEC_H

#include <stdint.h>

/* An input is the number of a model, and changes until STOP or its end; the rest are queries. A change is its
 * kind and, but for SHAPE and STOP, the number of a chunk and a place in it (16 bits, little-endian), then:
 */
enum {
  EDIT_BYTE,           /* the byte */
  EDIT_FLIP,           /* number of the bit */
  EDIT_WORD,           /* 32 bits, at a multiple of 4 as all below */
  EDIT_SPECIAL_WORD,   /* number of a word that loaders get wrong */
  EDIT_SPECIAL_DOUBLE, /* the same of doubles */
  EDIT_NUDGE,          /* odd: one more, even: one less */
  EDIT_RESIZE,         /* 16 bits: bytes of the chunk */
  EDIT_NUDGE_SIZE,     /* below 128: so many more, and one; else so many less than 127 below */
  EDIT_FILL,           /* 16 bits: how many bytes become the byte that follows */
  EDIT_DROP,           /* the chunk */
  EDIT_SWAP,           /* number of the chunk that takes this one's bytes */
  EDIT_RENAME,         /* index of the chunk */
  EDIT_SHAPE,          /* two bytes, no chunk nor place: what of the shape, and how */
  EDIT_STOP,
  EDITS,
  SPECIALS = 16
};

/* Chunks of a model; 0 if there is no such model. */
uint32_t fuzz_codec_chunks(uint32_t model);

#endif
