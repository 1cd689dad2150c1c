/* SPDX-License-Identifier: MIT */
/*
 * btf_gpu.h: a model as textures, numbers and a shader. The library makes no GPU call: it describes what a renderer
 * uploads, and gives the GLSL that reads it. The shader and btf_model_eval() agree: the same nearest samples, the same
 * blend over three lights and three views, the same rule for levels of detail.
 */
#ifndef LIBBTF_BTF_GPU_H
#define LIBBTF_BTF_GPU_H

#include "btf_model.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { BTF_TEXTURE_2D = 1, BTF_TEXTURE_3D = 2, BTF_TEXTURE_CUBE = 3, BTF_TEXTURE_2D_ARRAY = 4 };
enum { BTF_FILTER_NEAREST = 1, BTF_FILTER_LINEAR = 2 };

/** Texel formats, by their numbers in Vulkan (VkFormat): no graphics header is needed. */
enum {
  BTF_TEXEL_R8_UNORM = 9,
  BTF_TEXEL_RG8_UNORM = 16,
  BTF_TEXEL_RGBA8_UNORM = 37,
  BTF_TEXEL_RGBA8_SNORM = 38,
  BTF_TEXEL_R16_FLOAT = 76,
  BTF_TEXEL_RG16_FLOAT = 83,
  BTF_TEXEL_RGBA16_FLOAT = 97,
  BTF_TEXEL_R32_FLOAT = 100,
  BTF_TEXEL_RG32_FLOAT = 103,
  BTF_TEXEL_RGBA32_FLOAT = 109,
  BTF_TEXEL_BC6H_UFLOAT = 143, /**< these three in blocks of 4 x 4 texels of 16 bytes */
  BTF_TEXEL_BC6H_SFLOAT = 144,
  BTF_TEXEL_BC7_UNORM = 145
};

/** One level of a texture: slices (layers, or depth) of rows of texels, or of rows of blocks, without gaps, row 0 the one
 *  of the smallest v. The blocks at the end of a size that is no multiple of 4 are whole. FROZEN. */
typedef struct btf_gpu_level {
  const void *data;
  uint64_t size;
  uint32_t width, height, depth, reserved;
} btf_gpu_level;

/** A texture as it is to be uploaded. Pointers belong to the export. */
typedef struct btf_gpu_texture {
  size_t struct_size;
  const char *name;            /**< of its sampler in the shader */
  const btf_gpu_level *levels; /**< level_count of them, the finest first */
  uint32_t dimension, texel;   /**< BTF_TEXTURE_*, BTF_TEXEL_* */
  uint32_t width, height, depth, layers, level_count;
  uint32_t min_filter, mag_filter; /**< BTF_FILTER_*; min_filter within a level and between levels */
  uint32_t wrap[3];                /**< BTF_WRAP_* */
  uint32_t binding, reserved;
  double psnr_db; /**< of compressed texels, as btf_gpu_cost has it for all; 0 = not compressed */
} btf_gpu_texture;
#define BTF_GPU_TEXTURE_INIT                                                                                 \
  { sizeof(btf_gpu_texture), NULL, NULL, 0, 0, 0, 0, 0, 0, 0, 0, 0, {0, 0, 0}, 0, 0, 0.0 }

enum {
  BTF_UNIFORM_FLOAT = 1,
  BTF_UNIFORM_VEC2 = 2,
  BTF_UNIFORM_VEC3 = 3,
  BTF_UNIFORM_VEC4 = 4,
  BTF_UNIFORM_INT = 5,
  BTF_UNIFORM_IVEC4 = 8
};
/** A member of the uniform block. FROZEN. */
typedef struct btf_gpu_uniform {
  const char *name;
  uint32_t type;   /**< BTF_UNIFORM_* */
  uint32_t offset; /**< bytes from the start of the block, by std140 */
  uint32_t count;  /**< elements of an array; 1 = not an array */
  uint32_t reserved;
} btf_gpu_uniform;

/** Block compression: BC7 for bytes and for summands, BC6H for halves and floats of a wide range, both of which the
 *  interface must have (OpenGL 4.2, EXT_texture_compression_bptc, Vulkan's textureCompressionBC). Only tables that bear
 *  it are compressed, and only where that saves bytes; directions, indices and scales stay as they are. */
enum { BTF_GPU_COMPRESS_NONE = 0, BTF_GPU_COMPRESS_BC = 1 };

/** What the graphics interface can take. All 0 = what desktop drivers and nearly all of WebGL 2 take: 8192, 2048, 256, 16. */
typedef struct btf_gpu_target {
  size_t struct_size;
  /** Name of a layout (btf_codec_gpu_layout); NULL = the codec's first. */
  const char *layout;
  uint32_t max_2d, max_3d, max_layers; /**< texels along a side of 2D and 3D textures, layers of an array */
  uint32_t max_textures;               /**< samplers in one shader */
  uint32_t compress;                   /**< BTF_GPU_COMPRESS_* */
  uint32_t reserved;                   /**< must be 0 */
} btf_gpu_target;
#define BTF_GPU_TARGET_INIT                                                                                  \
  { sizeof(btf_gpu_target), NULL, 0, 0, 0, 0, 0, 0 }

/** What one evaluation costs the shader: at a whole level of detail, with interpolation (Mueller et al. 2005, sect.
 *  5.6). */
typedef struct btf_gpu_cost {
  size_t struct_size;
  double fetches; /**< texels read, a filtered read counting as one */
  double bytes;   /**< of these texels, a filtered read counting the texels that it blends */
  double flops;
  /** Largest difference from btf_model_eval that rounding to the layout's texels can make, in stored values; 0 where the
   *  texels hold what the model holds. */
  double rounding;
  /** Of all textures and levels, and what compression took off. */
  double texture_bytes, saved_bytes;
  /** What compression costs, measured: -10 log10 of the mean, over the components of all compressed tables, of a
   *  component's mean squared error by the square of its largest magnitude. 0 = nothing is compressed, 999 = nothing is
   *  lost. `rounding` does not count it; fetches, bytes and flops are those without compression. */
  double psnr_db;
} btf_gpu_cost;
#define BTF_GPU_COST_INIT                                                                                    \
  { sizeof(btf_gpu_cost), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 }

/** Layouts that a codec exports; i from 0. Name and summary live as long as the codec; NULL where there is none. The
 *  first is the default. Threads: const. */
LIBBTF_API const char *btf_codec_gpu_layout(const btf_codec *codec, uint32_t i, const char **summary);

/** A model made ready for a GPU. Immutable; needs the model no longer. */
typedef struct btf_gpu_export btf_gpu_export;

/** target NULL = the defaults. Errors: BTF_E_UNSUPPORTED (the codec exports nothing), BTF_E_INVALID_ARG (model or out
 *  is NULL, no such layout or compression), BTF_E_ABI, BTF_E_LIMIT (beyond the target, the 64 textures or the numbers
 *  of an export, or the context's memory; the message says which limit, and what would do), BTF_E_PLUGIN (a codec's
 *  tables or numbers make no sense), BTF_E_NOMEM; whatever else a plug-in's codec returns. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_gpu_export_create(const btf_model *model, const btf_gpu_target *target,
                                                             btf_gpu_export **out);
LIBBTF_API void btf_gpu_export_release(btf_gpu_export *e);
LIBBTF_API uint32_t btf_gpu_texture_count(const btf_gpu_export *e);
/** Fills io; the caller sets struct_size. Errors: BTF_E_INVALID_ARG (no such texture, io is NULL), BTF_E_ABI. Threads:
 *  const. */
LIBBTF_API btf_status btf_gpu_texture_at(const btf_gpu_export *e, uint32_t i, btf_gpu_texture *io);
/** The shader: GLSL ES 3.00, GLSL 3.30 and GLSL 4.50 for Vulkan alike, for after the host's #version and precision
 *  lines. Every name in it begins with btf_ (macros: BTF_). It declares the samplers and the uniform block btf_uniforms
 *  and defines
 *      vec3 btf_eval(vec3 light, vec3 view, vec2 uv, float lod)
 *  which is f in 1/sr without the cosine, 0 at and below the horizon. A model of other than three channels gives its
 *  first three (a single one in all three). Threads: const. */
LIBBTF_API const char *btf_gpu_glsl(const btf_gpu_export *e);
/** The uniform block's bytes, ready to upload. Threads: const. */
LIBBTF_API const void *btf_gpu_uniforms(const btf_gpu_export *e, size_t *size);
LIBBTF_API const btf_gpu_uniform *btf_gpu_uniform_fields(const btf_gpu_export *e, uint32_t *count);
/** Fills io; the caller sets struct_size. Errors: BTF_E_INVALID_ARG (io is NULL), BTF_E_ABI. Threads: const. */
LIBBTF_API btf_status btf_gpu_export_cost(const btf_gpu_export *e, btf_gpu_cost *io);
/** The manifest of the export as JSON (docs/gpu-export.md). Threads: const. */
LIBBTF_API const char *btf_gpu_manifest(const btf_gpu_export *e);

/** A texture as a KTX 2.0 file. zstd_level 0 = not compressed, 1 to 22 = each level is a zstd frame of its own.
 *  The bytes belong to the caller, who frees them with btf_gpu_free. Errors: BTF_E_INVALID_ARG (no such texture or zstd
 *  level), BTF_E_NOMEM, BTF_E_LIMIT (the context's memory, a level too large for zstd). Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_gpu_texture_ktx2(const btf_gpu_export *e, uint32_t i, int32_t zstd_level,
                                                            void **data, size_t *size);
LIBBTF_API void btf_gpu_free(const btf_gpu_export *e, void *data);

/** Writes a folder of manifest.json, btf.glsl and a .ktx2 file for each texture. It appears as a whole or not at all;
 *  an earlier export at the path is replaced, anything else is not. Errors: BTF_E_INVALID_ARG (e or path is NULL, no
 *  such zstd level), BTF_E_IO (also where the path holds something else), BTF_E_NOMEM, BTF_E_LIMIT (as of
 *  btf_gpu_texture_ktx2). Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_gpu_export_write(const btf_gpu_export *e, const char *path,
                                                            int32_t zstd_level);
/** The same with a page beside it, index.html, which the manifest then names; page NULL = none. An index.html that no
 *  manifest names is kept, as is all that is not the export's. Errors: as above. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_gpu_export_write_page(const btf_gpu_export *e, const char *path,
                                                                 int32_t zstd_level, const void *page,
                                                                 size_t page_size);

#ifdef __cplusplus
}
#endif
#endif
