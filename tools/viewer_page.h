/* SPDX-License-Identifier: MIT */
/* viewer_page.h: the viewer (viewer/) as one page that holds an export. */
#ifndef BTF_TOOLS_VIEWER_PAGE_H
#define BTF_TOOLS_VIEWER_PAGE_H

#include <stddef.h>
#include <stdint.h>

#include <btf/btf.h>

/* The page without an export, ended by a zero; made by viewer/join.cmake. */
extern const unsigned char viewer_template[];

/* The caller frees the page. */
int viewer_page_create(const btf_gpu_export *e, int32_t zstd_level, char **page, size_t *size);

#endif
