/* SPDX-License-Identifier: MIT */
/*
 * btf_io.h: the container file `.btfz` (docs/format.md), and byte sources of the host's own.
 */
#ifndef LIBBTF_BTF_IO_H
#define LIBBTF_BTF_IO_H

#include "btf_model.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Byte source or sink of the host. Members that do not apply may be NULL. */
typedef struct btf_io {
  size_t struct_size;
  void *user;
  /** Size in bytes, or -1 if unknown. */
  int64_t (*size)(void *user);
  /** Reads n bytes at an offset like pread; returns how many were read, -1 on error. Several threads at once. */
  int64_t (*read)(void *user, void *dst, size_t n, uint64_t offset);
  /** Writes n bytes at an offset like pwrite; returns how many were written, -1 on error. One thread. */
  int64_t (*write)(void *user, const void *src, size_t n, uint64_t offset);
  /** Optional: a pointer to n bytes at an offset that stays valid until close, or NULL. */
  const void *(*map)(void *user, uint64_t offset, size_t n);
  /** Ends the use; failed != 0 = remove what was written. Returns 0, or -1 if the data could not be made durable.
   *  Called exactly once, also when opening failed. */
  int32_t (*close)(void *user, int32_t failed);
  const char *name; /**< for messages; may be NULL */
} btf_io;
#define BTF_IO_INIT                                                                                          \
  { sizeof(btf_io), NULL, NULL, NULL, NULL, NULL, NULL, NULL }

enum { BTF_IO_READ = 0, BTF_IO_WRITE = 1 };
/** A file by path. Reading maps it. Writing goes to a temporary file in the same folder, renamed at close.
 *  io->struct_size is set by the caller. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_io_file(btf_context *ctx, const char *path, uint32_t mode, btf_io *io);
/** Reads bytes in memory, borrowed until close. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_io_memory(btf_context *ctx, const void *data, size_t size, btf_io *io);

/* ---- Reading ---- */

/** An open container. Opening parses header and directory only; const afterwards. */
typedef struct btf_file btf_file;

enum {
  /** Do not verify the checksums of chunks used in place from a mapping, so that opening a model takes the same
   *  time whatever its size. For files the caller trusts. Structure and small chunks are verified all the same. */
  BTF_OPEN_TRUST = 1u << 0
};

/** Opens a container; takes over io (it is closed with the file, also on failure).
 *  Errors: BTF_E_NOT_BTF, BTF_E_NEWER, BTF_E_CORRUPT, BTF_E_TRUNCATED, BTF_E_LIMIT, BTF_E_IO. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_file_open(btf_context *ctx, const btf_io *io, uint32_t flags,
                                                     btf_file **out);
/** The same by path. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_file_open_path(btf_context *ctx, const char *path, uint32_t flags,
                                                          btf_file **out);
/** Drops the file; models loaded from it keep what they need alive. NULL is fine. Threads: exclusive. */
LIBBTF_API void btf_file_close(btf_file *file);

LIBBTF_API uint32_t btf_file_model_count(const btf_file *file);
/** Codec id of model i, readable even if the codec is not installed; NULL if there is no such model. */
LIBBTF_API const char *btf_file_model_codec(const btf_file *file, uint32_t i);
/** Describes model i without its codec and without touching its payload (levels, caps and resident_bytes are 0).
 *  Pointers live as long as the file. */
LIBBTF_API btf_status btf_file_describe_model(const btf_file *file, uint32_t i, btf_model_info *io);
/** Loads model i. BTF_E_UNKNOWN_CODEC names the codec's id. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_file_load_model(const btf_file *file, uint32_t i, btf_model **out);

/** Metadata: value of a key ("btf.command", "btf.writer", the writer's own), or NULL; and by position. */
LIBBTF_API const char *btf_file_metadata(const btf_file *file, const char *key);
LIBBTF_API uint32_t btf_file_metadata_count(const btf_file *file);
LIBBTF_API btf_status btf_file_metadata_at(const btf_file *file, uint32_t i, const char **key, const char **value);

/** One entry of the chunk directory. `type` and `tag` are FourCCs, first letter in the low byte. */
typedef struct btf_chunk_info {
  size_t struct_size;
  uint64_t offset, stored, raw, checksum;
  uint32_t type, tag, index, flags, model, method;
} btf_chunk_info;
LIBBTF_API uint32_t btf_file_chunk_count(const btf_file *file);
LIBBTF_API btf_status btf_file_chunk(const btf_file *file, uint32_t i, btf_chunk_info *io);

/** Receives one finding: a stable number, a severity (BTF_LOG_*), the file offset and one line. */
typedef void (*btf_issue_fn)(void *user, uint32_t issue, int32_t severity, uint64_t offset, const char *text);
/** Verifies every checksum and unpacks every chunk once; `report` may be NULL. Returns the status of the first
 *  fault; its message names the chunk. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_file_validate(const btf_file *file, btf_issue_fn report, void *user);

/* ---- Writing ---- */

typedef struct btf_writer btf_writer;
/** Starts a container; takes over io. zstd_level 0 = default (3). Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_writer_open(btf_context *ctx, const btf_io *io, int32_t zstd_level,
                                                       btf_writer **out);
LIBBTF_API LIBBTF_NODISCARD btf_status btf_writer_metadata(btf_writer *w, const char *key, const char *value);
LIBBTF_API LIBBTF_NODISCARD btf_status btf_writer_model(btf_writer *w, const btf_model *model, const btf_job *job);
/** Copies all models, metadata and chunks of unknown kind of an open file, payloads as they are, also those of codecs that are
 *  not installed. Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_writer_copy(btf_writer *w, const btf_file *file);
/** Writes the directory, closes the sink and frees the writer, also on failure (then nothing is left behind). */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_writer_finish(btf_writer *w);
/** Removes what was written and frees the writer; NULL is fine. */
LIBBTF_API void btf_writer_abort(btf_writer *w);

/* ---- The two calls most programs need ---- */

/** Loads the first model of a container file, or a data-set folder as a "raw" model. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_model_load(btf_context *ctx, const char *path, btf_model **out);
/** Saves a model as a container file of its own, atomically. command may be NULL; it is kept as "btf.command".
 *  zstd_level as in btf_writer_open. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_model_save(const btf_model *model, const char *path, int32_t zstd_level,
                                                      const char *command, const btf_job *job);

#ifdef __cplusplus
}
#endif
#endif
