/* SPDX-License-Identifier: MIT */
#include "io/io.h"

#include <errno.h>
#include <inttypes.h>
#include <string.h>

/* One call moves at most this much, so that a count fits any host's int64_t and progress shows in a debugger.
 */
static const uint64_t largest_transfer = (uint64_t)1 << 30;

const char *btfi_io_name(const btf_io *io) {
  return io->name ? io->name : "(unnamed)";
}

/* What the host left in errno, or a general word. */
static const char *reason(void) {
  return errno ? strerror(errno) : "the source reported an error";
}

btf_status btfi_io_copy(btf_context *ctx, const btf_io *user, bool writing, btf_io *out) {
  memset(out, 0, sizeof *out);
  BTFI_TRY(btfi_copy_in(ctx, "btf_io", out, sizeof *out, BTFI_SIZE_TO(btf_io, name), user));
  if (writing ? out->write != NULL : out->read != NULL) return BTF_OK;
  const btf_status status = btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: btf_io has no %s function",
                                      btfi_io_name(out), writing ? "write" : "read");
  btfi_io_close(ctx, out, true);
  return status;
}

btf_status btfi_io_close(btf_context *ctx, btf_io *io, bool failed) {
  int32_t (*const close_io)(void *, int32_t) = io->close;
  if (!close_io) return BTF_OK;
  io->close = NULL;
  errno = 0;
  /* The name may go with the user's state, so a message about it must use a copy. */
  char name[512];
  strncpy(name, btfi_io_name(io), sizeof name - 1);
  name[sizeof name - 1] = '\0';
  const int32_t closed = close_io(io->user, failed);
  if (failed || closed == 0) return BTF_OK;
  return btfi_fail(ctx, BTF_E_IO, "%s: could not be written: %s", name, reason());
}

btf_status btfi_io_read(btf_context *ctx, const btf_io *io, void *dst, uint64_t n, uint64_t offset) {
  unsigned char *p = dst;
  uint64_t end, done = 0;
  if (!btfi_add(offset, n, &end) || end > INT64_MAX)
    return btfi_fail(ctx, BTF_E_TRUNCATED,
                     "%s: %" PRIu64 " bytes expected at offset %" PRIu64 ", beyond any file",
                     btfi_io_name(io), n, offset);
  while (done < n) {
    const uint64_t asked = BTFI_MIN(n - done, largest_transfer);
    errno = 0;
    const int64_t got = io->read(io->user, p + done, (size_t)asked, offset + done);
    if (got < 0 || (uint64_t)got > asked)
      return btfi_fail(ctx, BTF_E_IO, "%s: cannot read at offset %" PRIu64 ": %s", btfi_io_name(io),
                       offset + done, got < 0 ? reason() : "the source returned more than was asked for");
    if (got == 0)
      return btfi_fail(ctx, BTF_E_TRUNCATED,
                       "%s: ends at byte %" PRIu64 "; expected %" PRIu64 " bytes at offset %" PRIu64,
                       btfi_io_name(io), offset + done, n, offset);
    done += (uint64_t)got;
  }
  return BTF_OK;
}

btf_status btfi_io_write(btf_context *ctx, const btf_io *io, const void *src, uint64_t n, uint64_t offset) {
  const unsigned char *p = src;
  uint64_t end, done = 0;
  if (!btfi_add(offset, n, &end) || end > INT64_MAX)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %" PRIu64 " bytes at offset %" PRIu64 " are beyond any file",
                     btfi_io_name(io), n, offset);
  while (done < n) {
    const uint64_t offered = BTFI_MIN(n - done, largest_transfer);
    errno = 0;
    const int64_t written = io->write(io->user, p + done, (size_t)offered, offset + done);
    if (written <= 0 || (uint64_t)written > offered)
      return btfi_fail(ctx, BTF_E_IO, "%s: cannot write at offset %" PRIu64 ": %s", btfi_io_name(io),
                       offset + done, written <= 0 ? reason() : "the sink took more than it was given");
    done += (uint64_t)written;
  }
  return BTF_OK;
}
