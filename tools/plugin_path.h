/* SPDX-License-Identifier: MIT */
/* plugin_path.h: codec modules that are there for every run. */
#ifndef BTF_TOOLS_PLUGIN_PATH_H
#define BTF_TOOLS_PLUGIN_PATH_H

#include "cli.h"

/* Loads every *.so, in the order of names, of the folders of BTF_PLUGIN_PATH (absolute, separated by ':';
 * ignored in a set-user-id process), or of the installed folder when that is unset. A module that does not
 * load is noted and left out. */
void plugin_path_load(cli *c);

#endif
