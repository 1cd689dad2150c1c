/* SPDX-License-Identifier: MIT */
/* Modules that are wrong in one point each: REFUSED_<point> says which. */
#include <btf/btf_plugin.h>

#if defined(REFUSED_CODEC_ABI)
#define CODEC_ABI (LIBBTF_ABI + 1)
#else
#define CODEC_ABI LIBBTF_ABI
#endif
#if defined(REFUSED_BAD_ID)
#define FIRST_ID "org.Example.upper"
#elif defined(REFUSED_OWN_ID)
#define FIRST_ID "mine"
#elif defined(REFUSED_TAKEN_ID)
#define FIRST_ID "org.example.mean"
#else
#define FIRST_ID "org.example.first"
#endif
#if defined(REFUSED_TWICE)
#define SECOND_ID FIRST_ID
#else
#define SECOND_ID "org.example.second"
#endif
#if defined(REFUSED_DEFAULT)
#define DEFAULT "11"
#else
#define DEFAULT "10"
#endif
#if defined(REFUSED_SECOND)
#define SECOND_EVAL NULL
#else
#define SECOND_EVAL eval
#endif

static const btf_param_desc level = {sizeof level, "level", "A number.", NULL,          DEFAULT,
                                     NULL,         0.0,     10.0,        BTF_PARAM_INT, 0};
static const btf_param_desc *const params[] = {&level, NULL};

static btf_status load(const btf_host *host, btf_context *ctx, uint32_t format, const btf_model_shape *shape,
                       btf_chunk_reader *payload, void **state) {
  (void)format, (void)shape, (void)payload;
  *state = NULL;
  return host->fail(ctx, BTF_E_UNSUPPORTED, "this codec loads nothing");
}
static void destroy(const btf_host *host, btf_context *ctx, void *state) {
  host->free(ctx, state);
}
static uint32_t levels(const void *state) {
  return state != NULL;
}
static uint64_t resident_bytes(const void *state) {
  return state != NULL;
}
static void eval(const void *state, const btf_query *query, float *out) {
  out[0] = state != NULL ? query->lod : 0.0f;
}
static void texel(const void *state, uint32_t l, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                  float *out) {
  out[0] = state != NULL ? (float)(l + x + y + light + view) : 0.0f;
}

#define CODEC(id_, eval_)                                                                                    \
  {                                                                                                          \
    .struct_size = sizeof(btf_codec_vtbl), .abi = CODEC_ABI, .id = id_, .title = "Refused", .version = "1",  \
    .params = params, .format_read_min = 1, .format_write = 1, .load = load, .destroy = destroy,             \
    .levels = levels, .resident_bytes = resident_bytes, .eval = eval_, .texel = texel                        \
  }
static const btf_codec_vtbl first = CODEC(FIRST_ID, eval), second = CODEC(SECOND_ID, SECOND_EVAL);
static const btf_codec_vtbl *const codecs[] = {&first, &second};
#if defined(REFUSED_EMPTY)
#define CODEC_COUNT 0
#else
#define CODEC_COUNT 2
#endif
#if defined(REFUSED_NEWER_HOST)
#define HOST_SIZE (sizeof(btf_host) + 8)
#else
#define HOST_SIZE sizeof(btf_host)
#endif
static const btf_plugin_info info = {.struct_size = sizeof info,
                                     .abi = LIBBTF_ABI,
                                     .name = "refused",
                                     .license = "MIT",
                                     .codecs = codecs,
                                     .codec_count = CODEC_COUNT,
                                     .host_size_needed = HOST_SIZE};

#if defined(REFUSED_NO_ENTRY)
#define ENTRY btf_plugin_entry_0
#else
#define ENTRY BTF_PLUGIN_ENTRY
#endif
LIBBTF_API const btf_plugin_info *ENTRY(uint32_t host_abi);
const btf_plugin_info *ENTRY(uint32_t host_abi) {
#if defined(REFUSED_REFUSES)
  return host_abi == 0 ? &info : NULL;
#else
  return host_abi != 0 ? &info : NULL;
#endif
}
