/* SPDX-License-Identifier: MIT */
/* Loading modules: by absolute path, on request, all of a module's codecs and formats or none. */
#include "registry/codec.h"

#include <dlfcn.h>
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

/* What this project builds as modules keeps its short ids. */
static bool is_own(const btf_plugin_info *info) {
  return info->name != NULL && strncmp(info->name, "libbtf ", 7) == 0;
}

/* Codecs of one module, checked but not yet visible. */
static btf_status check_codecs(btf_context *ctx, const btf_plugin_info *info, btf_codec **codecs) {
  for (uint32_t i = 0; i < info->codec_count; i++) {
    if (info->codecs[i] == NULL)
      return btfi_fail(ctx, BTF_E_PLUGIN, "codec %u of the module is NULL", (unsigned)i);
    BTFI_TRY(btfi_codec_create(ctx, info->codecs[i], is_own(info), &codecs[i]));
    for (uint32_t k = 0; k < i; k++)
      if (strcmp(codecs[k]->vtbl.id, codecs[i]->vtbl.id) == 0)
        return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module has this codec twice", codecs[i]->vtbl.id);
  }
  return BTF_OK;
}

static btf_status check_formats(btf_context *ctx, const btf_plugin_info *info, btf_format **formats) {
  for (uint32_t i = 0; i < info->format_count; i++) {
    if (info->formats[i] == NULL)
      return btfi_fail(ctx, BTF_E_PLUGIN, "format %u of the module is NULL", (unsigned)i);
    BTFI_TRY(btfi_format_create(ctx, info->formats[i], is_own(info), &formats[i]));
    for (uint32_t k = 0; k < i; k++)
      if (strcmp(formats[k]->vtbl.id, formats[i]->vtbl.id) == 0)
        return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module has this format twice", formats[i]->vtbl.id);
  }
  return BTF_OK;
}

/* `known` becomes what this library knows of it. */
static btf_status check_info(btf_context *ctx, const char *path, const btf_plugin_info *info,
                             btf_plugin_info *known) {
  if (info == NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module refuses this library (ABI %u)", path, LIBBTF_ABI);
  if (info->abi != LIBBTF_ABI)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module was built for ABI %u; this library has ABI %u", path,
                     (unsigned)info->abi, LIBBTF_ABI);
  if (info->struct_size < BTFI_SIZE_TO(btf_plugin_info, host_size_needed))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the description of the module has %u bytes; expected %u", path,
                     (unsigned)info->struct_size, (unsigned)BTFI_SIZE_TO(btf_plugin_info, host_size_needed));
  if (info->host_size_needed > sizeof(btf_host))
    return btfi_fail(ctx, BTF_E_PLUGIN,
                     "%s: the module needs a newer libbtf: %u bytes of the host table; this library has %u",
                     path, (unsigned)info->host_size_needed, (unsigned)sizeof(btf_host));
  memcpy(known, info, BTFI_MIN(info->struct_size, sizeof *known));
  info = known;
  if (info->reserved != 0)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the reserved field of the module's description is not 0", path);
  if ((info->codecs == NULL) != (info->codec_count == 0) ||
      (info->formats == NULL) != (info->format_count == 0) || info->codec_count > 1024 ||
      info->format_count > 1024 || (info->codecs == NULL && info->formats == NULL))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module offers %u codecs and %u formats; expected 1 to 1024",
                     path, info->codecs != NULL ? (unsigned)info->codec_count : 0u,
                     info->formats != NULL ? (unsigned)info->format_count : 0u);
  return BTF_OK;
}

static btf_status add_all(btf_context *ctx, const btf_plugin_info *info, btf_codec **codecs,
                          btf_format **formats) {
  BTFI_TRY(btfi_registry_reserve_codecs(ctx, info->codec_count));
  BTFI_TRY(btfi_registry_reserve_formats(ctx, info->format_count));
  BTFI_TRY(check_codecs(ctx, info, codecs));
  BTFI_TRY(check_formats(ctx, info, formats));
  for (uint32_t i = 0; i < info->codec_count; i++) btfi_registry_add(ctx, codecs[i]);
  for (uint32_t i = 0; i < info->format_count; i++) btfi_registry_add_format(ctx, formats[i]);
  return BTF_OK;
}

static btf_status add_module(btf_context *ctx, const char *path, const btf_plugin_info *given) {
  btf_plugin_info known = {0};
  const btf_plugin_info *const info = &known;
  BTFI_TRY(check_info(ctx, path, given, &known));
  btf_codec **codecs = btfi_calloc(ctx, info->codec_count, sizeof *codecs);
  btf_format **formats = btfi_calloc(ctx, info->format_count, sizeof *formats);
  btf_status status =
      codecs != NULL && formats != NULL ? add_all(ctx, info, codecs, formats) : btfi_alloc_status();
  if (status != BTF_OK) {
    for (uint32_t i = 0; codecs != NULL && i < info->codec_count; i++) btfi_codec_destroy(codecs[i]);
    for (uint32_t i = 0; formats != NULL && i < info->format_count; i++) btfi_format_destroy(formats[i]);
  }
  btfi_free(ctx, codecs);
  btfi_free(ctx, formats);
  if (status == BTF_E_PLUGIN || status == BTF_E_ABI) {
    char reason[512];
    strncpy(reason, btf_error_message(), sizeof reason - 1);
    reason[sizeof reason - 1] = '\0';
    status = btfi_fail(ctx, BTF_E_PLUGIN, "%s: %s", path, reason);
  }
  return status;
}

btf_status btf_context_register_plugin(btf_context *ctx, const btf_plugin_info *plugin) {
  if (ctx == NULL || plugin == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "btf_context_register_plugin: context and plug-in must not be NULL");
  return add_module(ctx, "plug-in", plugin);
}

static btf_status open_module(btf_context *ctx, const char *path, void **module) {
  struct stat info;
  if (path[0] != '/')
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: a plug-in is loaded by its absolute path only", path);
  if (stat(path, &info) != 0) return btfi_fail(ctx, BTF_E_PLUGIN, "%s: %s", path, strerror(errno));
  if (!S_ISREG(info.st_mode)) return btfi_fail(ctx, BTF_E_PLUGIN, "%s: not a regular file", path);
  *module = dlopen(path, RTLD_NOW | RTLD_LOCAL);
  if (*module == NULL) {
    const char *reason = dlerror();
    return btfi_fail(ctx, BTF_E_PLUGIN, "cannot load the plug-in: %s", reason != NULL ? reason : path);
  }
  return BTF_OK;
}

btf_status btf_context_load_plugin(btf_context *ctx, const char *absolute_path) {
  btfi_registry *registry;
  void *module = NULL, *symbol;
  btf_plugin_entry_fn entry;
  btf_status status;
  if (ctx == NULL || absolute_path == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_context_load_plugin: context and path must not be NULL");
  BTFI_TRY(btfi_registry_reserve_module(ctx));
  BTFI_TRY(open_module(ctx, absolute_path, &module));
  symbol = dlsym(module, BTF_PLUGIN_ENTRY_NAME);
  if (symbol == NULL) {
    status =
        btfi_fail(ctx, BTF_E_PLUGIN, "%s: has no entry point %s; it is no libbtf plug-in of this generation",
                  absolute_path, BTF_PLUGIN_ENTRY_NAME);
  } else {
    memcpy(&entry, &symbol, sizeof entry); /* the way POSIX means a symbol to become a function */
    status = add_module(ctx, absolute_path, entry(LIBBTF_ABI));
  }
  if (status != BTF_OK) {
    dlclose(module);
    return status;
  }
  registry = btfi_context_registry(ctx);
  registry->modules[registry->module_count++] = module;
  return BTF_OK;
}
