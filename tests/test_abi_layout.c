/* SPDX-License-Identifier: MIT */
/* The binary interface as programs and plug-ins have compiled it in. Compiling this file is most of the test:
 * a FROZEN struct must never differ from what stands here; a growable one changes its size of today only at
 * its end. */
#include "btf_test.h"

#include <stddef.h>

#include <btf/btf.h>
#include <btf/btf_plugin.h>
#include <btf/btf_sampling.h>

#include "base/base.h"

#define SIZE(type, bytes) _Static_assert(sizeof(type) == (bytes), "size of " #type)
#define AT(type, member, bytes) _Static_assert(offsetof(type, member) == (bytes), #member " of " #type)

/* ---- FROZEN structs without pointers: the same everywhere ---- */

SIZE(btf_query, 40);
AT(btf_query, light, 0);
AT(btf_query, view, 12);
AT(btf_query, uv, 24);
AT(btf_query, lod, 32);
AT(btf_query, flags, 36);

SIZE(btf_interp, 24);
AT(btf_interp, index, 0);
AT(btf_interp, weight, 12);

SIZE(btf_gpu_level, 32);
AT(btf_gpu_level, size, 8);
AT(btf_gpu_level, width, 16);
AT(btf_gpu_level, depth, 24);
SIZE(btf_gpu_uniform, 24);
AT(btf_gpu_uniform, type, 8);
AT(btf_gpu_uniform, offset, 12);
AT(btf_gpu_uniform, count, 16);
SIZE(btf_gpu_layout_desc, 16);

SIZE(btf_block, 32);
AT(btf_block, view0, 0);
AT(btf_block, views, 4);
AT(btf_block, light0, 8);
AT(btf_block, lights, 12);
AT(btf_block, x0, 16);
AT(btf_block, y0, 20);
AT(btf_block, width, 24);
AT(btf_block, height, 28);

SIZE(btf_bilinear, 32);
AT(btf_bilinear, x, 0);
AT(btf_bilinear, y, 8);
AT(btf_bilinear, wx, 16);
AT(btf_bilinear, wy, 24);

SIZE(btf_level_pair, 16);
AT(btf_level_pair, level, 0);
AT(btf_level_pair, weight, 8);

#if UINTPTR_MAX == UINT64_MAX

/* ---- FROZEN structs with pointers ---- */

SIZE(btf_strides, 40);
AT(btf_strides, view, 0);
AT(btf_strides, light, 8);
AT(btf_strides, y, 16);
AT(btf_strides, x, 24);
AT(btf_strides, channel, 32);

SIZE(btf_allocator, 24);
AT(btf_allocator, user, 0);
AT(btf_allocator, alloc, 8);
AT(btf_allocator, free, 16);

SIZE(btf_probe, 32);
AT(btf_probe, path, 0);
AT(btf_probe, is_folder, 8);
AT(btf_probe, head_size, 12);
AT(btf_probe, head, 16);
AT(btf_probe, size, 24);

SIZE(btf_model_shape, 40);
AT(btf_model_shape, lights, 0);
AT(btf_model_shape, views, 8);
AT(btf_model_shape, width, 16);
AT(btf_model_shape, height, 20);
AT(btf_model_shape, channels, 24);
AT(btf_model_shape, quantity, 28);
AT(btf_model_shape, wrap, 32);
AT(btf_model_shape, reserved, 36);

/* ---- growable structs: sizes of today, and the first released size, which holds for ever ---- */

#define GROWABLE(type, last_of_first, bytes_of_first, bytes)                                                 \
  SIZE(type, bytes);                                                                                         \
  AT(type, struct_size, 0);                                                                                  \
  _Static_assert(BTFI_SIZE_TO(type, last_of_first) == (bytes_of_first), "first version of " #type)

GROWABLE(btf_limits, max_channels, 40, 40);
GROWABLE(btf_context_desc, isa, 72, 72);
GROWABLE(btf_job, seed, 40, 48);
GROWABLE(btf_dataset_desc, view_lights, 184, 200);
GROWABLE(btf_factors, user, 40, 40);
GROWABLE(btf_io, name, 64, 64);
GROWABLE(btf_chunk_info, method, 64, 64);
GROWABLE(btf_param_desc, flags, 72, 72);
GROWABLE(btf_model_info, texels_per_mm, 136, 136);
GROWABLE(btf_batch, reserved, 96, 96);
GROWABLE(btf_svd_desc, reserved, 88, 88);
GROWABLE(btf_svd_result, residual, 56, 64);
GROWABLE(btf_statistics, peak, 32, 32);
GROWABLE(btf_codec_vtbl, texel, 120, 160);
GROWABLE(btf_eval_cost, flops, 40, 40);
GROWABLE(btf_gpu_texture, reserved, 80, 88);
GROWABLE(btf_gpu_target, max_textures, 32, 40);
GROWABLE(btf_gpu_cost, rounding, 40, 64);
GROWABLE(btf_gpu_table, reserved, 48, 48);
GROWABLE(btf_plugin_info, host_size_needed, 40, 56);
GROWABLE(btf_format_vtbl, open, 56, 72);
GROWABLE(btf_host, mip_filter, 224, 496);

AT(btf_codec_vtbl, abi, 4);
AT(btf_plugin_info, abi, 4);
AT(btf_plugin_info, host_size_needed, 36);
AT(btf_job, running, 40);
AT(btf_host, abi, 4);

#endif

/* The first released size stays good, and one byte less never was. */
static void first_sizes_are_accepted(void **state) {
  (void)state;
  btf_limits limits = BTF_LIMITS_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  desc.limits = &limits;
  for (int less = 0; less < 4; less++) {
    desc.struct_size = BTFI_SIZE_TO(btf_context_desc, isa) - (less & 1);
    limits.struct_size = BTFI_SIZE_TO(btf_limits, max_channels) - (less >> 1);
    assert_status(btf_context_create(&desc, &ctx), less ? BTF_E_ABI : BTF_OK);
    btf_context_release(ctx);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(first_sizes_are_accepted)};
  return btf_run("abi_layout", tests);
}
