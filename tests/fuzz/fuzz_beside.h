/* SPDX-License-Identifier: MIT */
/* fuzz_beside.h: an input as a file in a folder of pictures, for readers whose file names others. */
#ifndef BTF_FUZZ_BESIDE_H
#define BTF_FUZZ_BESIDE_H

#include "fuzz_file.h"

/* Writes the input as `name`. What follows its first NUL stands for the picture `changed`. The folder is made
 * once, with good pictures of 8 x 8 texels under the other names, and removed at exit, which libFuzzer skips.
 */
fuzz_file fuzz_beside_make(const char *name, const char *changed, const uint8_t *data, size_t size);

#endif
