/* SPDX-License-Identifier: MIT */
#include "base/context.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { message_capacity = 1024 };
static _Thread_local char last_message[message_capacity];

const char *btf_status_name(btf_status status) {
#define NAME(code)                                                                                           \
  case code:                                                                                                 \
    return #code
  switch (status) {
    NAME(BTF_OK);
    NAME(BTF_E_INVALID_ARG);
    NAME(BTF_E_STATE);
    NAME(BTF_E_ABI);
    NAME(BTF_E_NOMEM);
    NAME(BTF_E_IO);
    NAME(BTF_E_LIMIT);
    NAME(BTF_E_NOT_BTF);
    NAME(BTF_E_CORRUPT);
    NAME(BTF_E_TRUNCATED);
    NAME(BTF_E_NEWER);
    NAME(BTF_E_UNKNOWN_CODEC);
    NAME(BTF_E_UNSUPPORTED);
    NAME(BTF_E_CANCELLED);
    NAME(BTF_E_NUMERIC);
    NAME(BTF_E_PLUGIN);
  default:
    return "unknown status";
  }
#undef NAME
}

const char *btf_error_message(void) {
  return last_message;
}

uint32_t btf_version(void) {
  return (uint32_t)LIBBTF_VERSION_MAJOR << 16 | (uint32_t)LIBBTF_VERSION_MINOR << 8 |
         (uint32_t)LIBBTF_VERSION_PATCH;
}

/* Formats one line. Names taken from files may hold control characters, which must not reach a terminal, and
 * cutting a long line must not leave half a UTF-8 sequence. */
static void format_line(char line[message_capacity], const char *format, va_list arguments) {
  const int length = vsnprintf(line, message_capacity, format, arguments);
  if (length < 0) line[0] = '\0';
  if (length >= message_capacity) {
    size_t end = message_capacity - 4;
    while (end > 0 && ((unsigned char)line[end] & 0xc0u) == 0x80u) end--;
    memcpy(line + end, "...", 4);
  }
  for (char *c = line; *c; c++)
    if ((unsigned char)*c < 0x20u || *c == 0x7f) *c = '?';
}

btf_status btfi_fail(btf_context *ctx, btf_status code, const char *format, ...) {
  char line[message_capacity]; /* the arguments may point into last_message */
  va_list arguments;
  va_start(arguments, format);
  format_line(line, format, arguments);
  va_end(arguments);
  memcpy(last_message, line, strlen(line) + 1);
  if (ctx && ctx->log) ctx->log(ctx->log_user, BTF_LOG_ERROR, code, last_message);
  return code;
}

void btfi_log(btf_context *ctx, int32_t level, const char *format, ...) {
  char line[message_capacity];
  va_list arguments;
  if (!ctx || !ctx->log) return;
  va_start(arguments, format);
  format_line(line, format, arguments);
  va_end(arguments);
  ctx->log(ctx->log_user, level, BTF_OK, line);
}
