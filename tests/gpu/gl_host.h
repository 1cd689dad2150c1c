/* SPDX-License-Identifier: MIT */
/* gl_host.h: a renderer without a window that knows exports from their folder alone: it reads manifest,
 * shader and textures, and evaluates queries in a fragment shader of software GL. */
#ifndef GL_HOST_H
#define GL_HOST_H

#include <stdbool.h>
#include <stddef.h>

typedef enum gl_dialect { GL_ES_300, GL_CORE_330, GL_CORE_450, GL_DIALECTS } gl_dialect;
const char *gl_dialect_name(gl_dialect dialect);

typedef struct gl_host gl_host;
/* NULL where there is no EGL or no such context; *why says which. */
gl_host *gl_host_open(gl_dialect dialect, const char **why);
void gl_host_close(gl_host *host);
const char *gl_host_renderer(const gl_host *host);

/* Uploads the export in a folder. NULL = done, otherwise what is wrong. `edit` (may be NULL) changes the
 * shader's text from malloc before it is compiled, to show that a fault is noticed. */
const char *gl_host_load(gl_host *host, const char *folder, char *(*edit)(char *glsl));
/* Evaluates `count` queries of 9 floats (light, view, u, v, lod) to 3 floats each. */
const char *gl_host_eval(gl_host *host, const float *queries, size_t count, float *out);

#endif
