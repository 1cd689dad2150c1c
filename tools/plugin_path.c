/* SPDX-License-Identifier: MIT */
#include "plugin_path.h"

#include <dirent.h>
#include <stdlib.h>
#include <string.h>

#include <btf/btf_plugin.h>

static int is_module(const struct dirent *entry) {
  const size_t length = strlen(entry->d_name);
  return length > 3 && entry->d_name[0] != '.' && strcmp(entry->d_name + length - 3, ".so") == 0;
}

static bool given_already(const cli *c, const char *path) {
  for (int i = 0; i < cli_count(c, "plugin"); i++)
    if (strcmp(cli_value_at(c, "plugin", i), path) == 0) return true;
  return false;
}

static void load_folder(cli *c, const char *folder, size_t length) {
  struct dirent **entries = NULL;
  char path[4096];
  int count;
  if (length == 0 || length >= sizeof path) return;
  if (folder[0] != '/') {
    cli_note(c, "warning: BTF_PLUGIN_PATH: \"%.*s\" is not an absolute path; skipped", (int)length, folder);
    return;
  }
  snprintf(path, sizeof path, "%.*s", (int)length, folder);
  count = scandir(path, &entries, is_module, alphasort);
  for (int i = 0; i < count; i++) {
    const int written = snprintf(path, sizeof path, "%.*s/%s", (int)length, folder, entries[i]->d_name);
    if (written > 0 && (size_t)written < sizeof path && !given_already(c, path) &&
        btf_context_load_plugin(c->context, path) != BTF_OK)
      cli_note(c, "warning: plug-in left out: %s", btf_error_message());
    free(entries[i]);
  }
  free(entries);
}

void plugin_path_load(cli *c) {
  const char *list = secure_getenv("BTF_PLUGIN_PATH");
#ifdef BTF_TOOL_PLUGIN_DIR
  if (list == NULL) list = BTF_TOOL_PLUGIN_DIR;
#endif
  while (list != NULL) {
    const size_t length = strcspn(list, ":");
    load_folder(c, list, length);
    list = list[length] == ':' ? list + length + 1 : NULL;
  }
}
