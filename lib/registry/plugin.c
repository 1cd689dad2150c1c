/* SPDX-License-Identifier: MIT */
/* Loading codec modules: by absolute path, on request, all of a module's codecs or none. */
#include "registry/codec.h"

#include <dlfcn.h>
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

/* Codecs of one module, checked but not yet visible. */
static btf_status check_codecs(btf_context *ctx, const btf_plugin_info *info, btf_codec **codecs) {
  /* Codecs of this project may be built as modules and keep their short ids. */
  const bool own = info->name != NULL && strncmp(info->name, "libbtf ", 7) == 0;
  for (uint32_t i = 0; i < info->codec_count; i++) {
    if (info->codecs[i] == NULL)
      return btfi_fail(ctx, BTF_E_PLUGIN, "codec %u of the module is NULL", (unsigned)i);
    BTFI_TRY(btfi_codec_create(ctx, info->codecs[i], own, &codecs[i]));
    for (uint32_t k = 0; k < i; k++)
      if (strcmp(codecs[k]->vtbl.id, codecs[i]->vtbl.id) == 0)
        return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module has this codec twice", codecs[i]->vtbl.id);
  }
  return BTF_OK;
}

static btf_status check_info(btf_context *ctx, const char *path, const btf_plugin_info *info) {
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
  if (info->codecs == NULL || info->codec_count == 0 || info->codec_count > 1024)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the module offers %u codecs; expected 1 to 1024", path,
                     info->codecs != NULL ? (unsigned)info->codec_count : 0u);
  return BTF_OK;
}

static btf_status add_codecs(btf_context *ctx, const char *path, const btf_plugin_info *info) {
  btf_codec **codecs;
  btf_status status;
  BTFI_TRY(check_info(ctx, path, info));
  BTFI_TRY(btfi_registry_reserve_codecs(ctx, info->codec_count));
  codecs = btfi_calloc(ctx, info->codec_count, sizeof *codecs);
  if (codecs == NULL) return btfi_alloc_status();
  status = check_codecs(ctx, info, codecs);
  for (uint32_t i = 0; i < info->codec_count; i++) {
    if (status == BTF_OK)
      btfi_registry_add(ctx, codecs[i]);
    else
      btfi_codec_destroy(codecs[i]);
  }
  btfi_free(ctx, codecs);
  if (status == BTF_E_PLUGIN || status == BTF_E_ABI) {
    char reason[512];
    strncpy(reason, btf_error_message(), sizeof reason - 1);
    reason[sizeof reason - 1] = '\0';
    status = btfi_fail(ctx, BTF_E_PLUGIN, "%s: %s", path, reason);
  }
  return status;
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
    status = add_codecs(ctx, absolute_path, entry(LIBBTF_ABI));
  }
  if (status != BTF_OK) {
    dlclose(module);
    return status;
  }
  registry = btfi_context_registry(ctx);
  registry->modules[registry->module_count++] = module;
  return BTF_OK;
}
