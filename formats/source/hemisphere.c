/* SPDX-License-Identifier: MIT */
#include "source/hemisphere.h"

#include <math.h>

void hemisphere_terms(const double light[3], double out[HEMISPHERE_MOST_TERMS]) {
  const double pi = 3.14159265358979323846;
  /* A vector's length is 1 to a float's precision only. */
  const double c = fmin(fmax(light[2], 0), 1), q = c * c - c, s = sqrt(-q), k = 2 * c - 1;
  const double phi = atan2(light[1], light[0]);
  out[0] = 1 / sqrt(2 * pi);
  out[1] = sqrt(6 / pi) * cos(phi) * s;
  out[2] = sqrt(3 / (2 * pi)) * k;
  out[3] = sqrt(6 / pi) * sin(phi) * s;
  out[4] = sqrt(30 / pi) * cos(2 * phi) * q;
  out[5] = sqrt(30 / pi) * cos(phi) * k * s;
  out[6] = sqrt(5 / (2 * pi)) * (1 + 6 * q);
  out[7] = sqrt(30 / pi) * sin(phi) * k * s;
  out[8] = sqrt(30 / pi) * sin(2 * phi) * q;
  out[9] = 2 * sqrt(35 / pi) * cos(3 * phi) * s * s * s;
  out[10] = sqrt(210 / pi) * cos(2 * phi) * k * q;
  out[11] = 2 * sqrt(21 / pi) * cos(phi) * s * (1 + 5 * q);
  out[12] = sqrt(7 / (2 * pi)) * (-1 + 12 * c - 30 * c * c + 20 * c * c * c);
  out[13] = 2 * sqrt(21 / pi) * sin(phi) * s * (1 + 5 * q);
  out[14] = sqrt(210 / pi) * sin(2 * phi) * k * q;
  out[15] = 2 * sqrt(35 / pi) * sin(3 * phi) * s * s * s;
}
