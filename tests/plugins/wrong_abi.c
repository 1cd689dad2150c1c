/* SPDX-License-Identifier: MIT */
/* The twin of the example plug-in from another generation: the same entry point, another ABI number. Must be
 * refused before any of its codecs is looked at. */
#include <btf/btf_plugin.h>

static const btf_plugin_info info = {.struct_size = sizeof info,
                                     .abi = LIBBTF_ABI + 1,
                                     .name = "wrong abi",
                                     .license = "MIT",
                                     .codecs = NULL,
                                     .codec_count = 0,
                                     .host_size_needed = 0};

LIBBTF_API const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi);
const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi) {
  return host_abi != 0 ? &info : NULL;
}
