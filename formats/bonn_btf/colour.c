/* SPDX-License-Identifier: MIT */
/* colour.c: from stored channels to reflectance, in the order of Bonn's own reader: colour model, then
 * logarithm. The cosine stays inside; the data set says so. */
#include <float.h>
#include <math.h>

#include "bonn_btf/bonn_btf.h"

enum {
  RGB = 0,
  YUV = 1,
  LAB = 2,
  PCA = 3,
  YCOCG = 4,
  SPECTRAL = 5,
  SPECTRAL_LINEAR = 6,
  LOG_Y_UV = 9,
  LOG_YUV = 10,
  LOG_Y_RATIO_UV = 11,
  LOG_RGB = 12
};
/* A constant of the readers: logarithms are of the value plus this. */
static const float offset = 1e-5f;
static const float log_offset = -11.5129254649702284f;
/* Beyond it exp overflows. */
static const float largest_exponent = 88.0f;

btf_status bonn_check_colour(const bonn_file *bonn) {
  const btf_host *host = bonn->file.host;
  switch (bonn->colour_model) {
  case RGB:
  case SPECTRAL:
  case SPECTRAL_LINEAR:
  case LOG_RGB:
    return BTF_OK;
  case YUV:
  case PCA:
  case YCOCG:
  case LOG_Y_UV:
  case LOG_YUV:
  case LOG_Y_RATIO_UV:
    if (bonn->channels == 3) return BTF_OK;
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: colour model %u is for 3 channels; there are %u",
                        bonn->file.path, (unsigned)bonn->colour_model, (unsigned)bonn->channels);
  default:
    return (host->fail)(bonn->file.ctx, BTF_E_UNSUPPORTED, "%s: colour model %u is %s", bonn->file.path,
                        (unsigned)bonn->colour_model,
                        bonn->colour_model == LAB ? "Lab, which is not read" : "unknown");
  }
}

static float undo_log(float s) {
  return expf(fminf(s, largest_exponent)) - offset;
}

/* What a stored channel adds to red, green and blue. */
static const float of_yuv[3][3] = {{1, 1, 1}, {0, -0.39465f, 2.03211f}, {1.13983f, -0.5806f, 0}};
static const float of_ycocg[3][3] = {{1, 1, 1}, {1, 0, -1}, {-1, 1, -1}};

static void yuv_to_rgb(float y, float u, float v, float out[3]) {
  for (int j = 0; j < 3; j++) out[j] = y + of_yuv[1][j] * u + of_yuv[2][j] * v;
}

bool bonn_colour_weight(const bonn_file *bonn, uint32_t stored, uint32_t channel, float *weight) {
  switch (bonn->dynamic_range != 0 ? LOG_RGB : bonn->colour_model) {
  case RGB:
    *weight = stored == channel;
    return true;
  case YUV:
    *weight = of_yuv[stored][channel];
    return true;
  case PCA:
    *weight = bonn->colour_matrix[3 * stored + channel];
    return true;
  case YCOCG:
    *weight = of_ycocg[stored][channel];
    return true;
  default:
    return false;
  }
}

bool bonn_colour_has_mean(const bonn_file *bonn) {
  return bonn->colour_model == PCA &&
         (bonn->colour_mean[0] != 0 || bonn->colour_mean[1] != 0 || bonn->colour_mean[2] != 0);
}

static float undo_signed_log(float s) {
  return copysignf(expf(fminf(fabsf(s) + log_offset, largest_exponent)), s);
}

static void undo_three(const bonn_file *bonn, const float s[3], float out[3]) {
  const float y = undo_log(s[0]);
  switch (bonn->colour_model) {
  case YUV:
    yuv_to_rgb(s[0], s[1], s[2], out);
    break;
  case PCA:
    for (int j = 0; j < 3; j++)
      out[j] = s[0] * bonn->colour_matrix[j] + s[1] * bonn->colour_matrix[3 + j] +
               s[2] * bonn->colour_matrix[6 + j] + bonn->colour_mean[j];
    break;
  case YCOCG:
    for (int j = 0; j < 3; j++) out[j] = s[0] + of_ycocg[1][j] * s[1] + of_ycocg[2][j] * s[2];
    break;
  case LOG_Y_UV:
    yuv_to_rgb(y, s[1], s[2], out);
    break;
  case LOG_YUV:
    yuv_to_rgb(y, undo_signed_log(s[1]), undo_signed_log(s[2]), out);
    break;
  default: /* LOG_Y_RATIO_UV */
    yuv_to_rgb(y, s[1] * (y + offset), s[2] * (y + offset), out);
    break;
  }
}

/* The first channel holds the sum of all, or their mean. */
static void undo_spectral(const bonn_file *bonn, float *const *planes, size_t i) {
  const uint32_t n = bonn->channels;
  const bool linear = bonn->colour_model == SPECTRAL_LINEAR;
  const float f = linear ? planes[0][i] * (float)n : planes[0][i];
  float sum = 0;
  for (uint32_t c = 1; c < n; c++) {
    sum += planes[c][i];
    planes[c][i] = linear ? f + planes[c][i] * f : planes[c][i] * f;
  }
  planes[0][i] = linear ? f - sum / (float)n : f * (1 - sum);
}

void bonn_to_reflectance(const bonn_file *bonn, float *const *planes, size_t n) {
  const bool logarithms = bonn->colour_model == LOG_RGB || bonn->dynamic_range != 0;
  if (bonn->colour_model == SPECTRAL || bonn->colour_model == SPECTRAL_LINEAR) {
    for (size_t i = 0; i < n; i++) undo_spectral(bonn, planes, i);
  } else if (bonn->colour_model != RGB && bonn->colour_model != LOG_RGB) {
    for (size_t i = 0; i < n; i++) {
      const float s[3] = {planes[0][i], planes[1][i], planes[2][i]};
      float out[3];
      undo_three(bonn, s, out);
      for (int c = 0; c < 3; c++) planes[c][i] = out[c];
    }
  }
  if (!logarithms) return;
  for (uint32_t c = 0; c < bonn->channels; c++)
    for (size_t i = 0; i < n; i++) planes[c][i] = undo_log(planes[c][i]);
}
