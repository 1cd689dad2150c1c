/* SPDX-License-Identifier: MIT */
/* directions.h: parts of a direction set that upper layers share. */
#ifndef BTFI_DIRECTIONS_H
#define BTFI_DIRECTIONS_H

#include "base/base.h"
#include <btf/btf_dataset.h>

btf_context *btfi_dirset_context(const btf_dirset *set);
bool btfi_dirset_equal(const btf_dirset *a, const btf_dirset *b); /* same directions, bit for bit, in the same order */

#endif
