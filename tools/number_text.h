/* SPDX-License-Identifier: MIT */
/* number_text.h: floats from and to text, exact and quick, whatever the locale. */
#ifndef BTF_TOOLS_NUMBER_TEXT_H
#define BTF_TOOLS_NUMBER_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Reads one number that starts at *p, correctly rounded, and moves *p behind it; false if there is none. The
 * text ends with a NUL somewhere. */
bool number_read(const char **p, float *out);
/* Reads a whole number up to 2^32 - 1, without sign. */
bool number_read_index(const char **p, uint32_t *out);
/* Writes "%.9g" without NUL, at most 24 bytes; returns the length. */
size_t number_write(char *dst, float value);

#endif
