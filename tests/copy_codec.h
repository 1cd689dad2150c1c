/* SPDX-License-Identifier: MIT */
/* copy_codec.h: a codec for tests that keeps every sample and evaluates the nearest one. */
#ifndef COPY_CODEC_H
#define COPY_CODEC_H

#include <btf/btf_plugin.h>

/* "org.libbtf.copy" with a batch evaluation, "org.libbtf.copy1" without. Parameters: gain (FLOAT, 0 to 10,
 * default 1), rounds (INT, 1 to 1024, default 3), blocked (BOOL), storage (CHOICE plain, packed), note
 * (STRING). With storage `packed` the samples are not for use in place and go through zstd. */
extern const btf_codec_vtbl copy_codec, copy_codec_single;

/* A data set of `channels` channels over a small phi x theta grid for tests: smooth, positive, different
 * everywhere. */
btf_dataset *copy_codec_dataset(btf_context *ctx, uint32_t width, uint32_t height, uint32_t channels,
                                uint32_t quantity);
/* The value at one sample of it. */
float copy_codec_sample(uint32_t view, uint32_t light, uint32_t x, uint32_t y, uint32_t channel);

/* Where the state of a model of this codec has its samples. */
const float *copy_codec_samples(const void *state);

#endif
