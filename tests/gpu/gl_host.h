/* SPDX-License-Identifier: MIT */
/* gl_host.h: a renderer that evaluates queries in a fragment shader of software GL. */
#ifndef GL_HOST_H
#define GL_HOST_H

#include "gpu_folder.h"

typedef enum gl_dialect { GL_ES_300, GL_CORE_330, GL_CORE_450, GL_DIALECTS } gl_dialect;
const char *gl_dialect_name(gl_dialect dialect);

/* NULL where there is no EGL or no such context; *why says which. */
gpu_host *gl_host_open(gl_dialect dialect, const char **why);

#endif
