/* SPDX-License-Identifier: MIT */
#include "images_hostile.h"

#include "images_case.h"
#include "../source/test_format.h"

#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const char first_name[] = "tv000_pv000/tl000_pl000_tv000_pv000.img.png";
static const char second_name[] = "tv000_pv000/tl015_pl000_tv000_pv000.img.png";
static const char long_name[1200] = "long";
static const char hdr_pixel[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\x40\x50\x60\x80";

/* A context that may hold 256 MiB at once. */
static btf_context *bounded_context(test_memory *memory) {
  btf_limits limits = BTF_LIMITS_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  *memory = (test_memory){0};
  const btf_allocator allocator = test_allocator(memory);
  limits.max_memory = 256u << 20;
  desc.limits = &limits;
  desc.allocator = &allocator;
  desc.max_threads = 2;
  assert_ok(btf_context_create(&desc, &ctx));
  assert_ok(btf_formats_register(ctx));
  return ctx;
}

static unsigned refusals, truncations;

static void check_refusal(const char *label, btf_status got, btf_status wanted, const char *part,
                          clock_t began) {
  const char *message = btf_error_message();
  if (got != wanted)
    fail_msg("%s: %s instead of %s: %s", label, btf_status_name(got), btf_status_name(wanted), message);
  if (strstr(message, part) == NULL || strchr(message, '\n') != NULL)
    fail_msg("%s: message \"%s\" lacks \"%s\"", label, message, part);
  if (clock() - began > 2 * CLOCKS_PER_SEC) fail_msg("%s: refused too late", label);
  refusals++;
}

/* ---- archives of one or two members ---- */

typedef struct hostile_case {
  const char *label;
  zip_member first, second;
  btf_status status;
  const char *part; /* of the message */
} hostile_case;

#define DATA(text) .data = text, .size = sizeof(text) - 1
#define HDR(lines) DATA("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" lines "\n\x40\x50\x60\x80")
#define PNG_HEAD(size, kind) DATA("\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR" size kind "\0\0\0____")
#define JPEG_HEAD(sizes) DATA("\xff\xd8\xff\xe0\0\x04__\xff\xc0\0\x11\x08" sizes "\x01\x11\0____________")
#define GOOD .name = first_name, DATA(hdr_pixel)

/* clang-format off */
static const hostile_case archives[] = {
    {"encrypted", {GOOD, .flags = 1}, {0}, BTF_E_UNSUPPORTED, "encrypted"},
    {"bzip2", {GOOD, .method_lie = 12}, {0}, BTF_E_UNSUPPORTED, "deflate"},
    {"method 99", {GOOD, .method_lie = 99}, {0}, BTF_E_UNSUPPORTED, "deflate"},
    {"huge size", {GOOD, .deflated = true, .size_lie = 0xfffffff0u}, {0}, BTF_E_CORRUPT, "unpack"},
    {"size of 2^31", {GOOD, .deflated = true, .size_lie = 0x80000000u}, {0}, BTF_E_CORRUPT, "unpack"},
    {"stored of two sizes", {GOOD, .size_lie = 3}, {0}, BTF_E_CORRUPT, "unpack"},
    {"too many packed bytes", {GOOD, .packed_lie = 0x7fffffff, .size_lie = 0x7fffffff}, {0}, BTF_E_TRUNCATED, "beyond the end"},
    {"2^32 - 2 packed bytes", {GOOD, .packed_lie = 0xfffffffe, .size_lie = 0xfffffffe}, {0}, BTF_E_TRUNCATED, "beyond the end"},
    {"size of 2^63", {GOOD, .zip64 = true, .size64_lie = UINT64_C(1) << 63}, {0}, BTF_E_CORRUPT, "unpack"},
    {"size of 2^64 - 1", {GOOD, .zip64 = true, .deflated = true, .size64_lie = UINT64_MAX}, {0}, BTF_E_CORRUPT, "unpack"},
    {"packed size of 2^63", {GOOD, .zip64 = true, .packed64_lie = UINT64_C(1) << 63}, {0}, BTF_E_CORRUPT, "unpack"},
    {"both sizes of 2^63", {GOOD, .zip64 = true, .packed64_lie = UINT64_C(1) << 63, .size64_lie = UINT64_C(1) << 63}, {0}, BTF_E_TRUNCATED, "beyond the end"},
    {"both sizes of 2^64 - 1", {GOOD, .zip64 = true, .packed64_lie = UINT64_MAX, .size64_lie = UINT64_MAX}, {0}, BTF_E_TRUNCATED, "beyond the end"},
    {"deflated, both sizes of 2^64 - 1", {GOOD, .zip64 = true, .deflated = true, .packed64_lie = UINT64_MAX, .size64_lie = UINT64_MAX}, {0}, BTF_E_CORRUPT, "unpack"},
    {"packed size of 2^64 - 1", {GOOD, .zip64 = true, .deflated = true, .packed64_lie = UINT64_MAX}, {0}, BTF_E_CORRUPT, "unpack"},
    {"size of 2^32 - 1 in zip64", {GOOD, .zip64 = true, .deflated = true, .size64_lie = UINT32_MAX}, {0}, BTF_E_CORRUPT, "unpack"},
    {"offset of 2^31 in zip64", {GOOD, .zip64 = true, .offset64_lie = UINT64_C(1) << 31}, {0}, BTF_E_CORRUPT, "header"},
    {"offset of 2^63", {GOOD, .zip64 = true, .offset64_lie = UINT64_C(1) << 63}, {0}, BTF_E_CORRUPT, "header"},
    {"offset of 2^64 - 1", {GOOD, .zip64 = true, .offset64_lie = UINT64_MAX}, {0}, BTF_E_CORRUPT, "header"},
    {"bytes that go on into the directory", {GOOD, .size_lie = 100, .packed_lie = 100}, {0}, BTF_E_CORRUPT, "checksum"},
    {"the same name twice", {GOOD}, {GOOD}, BTF_E_CORRUPT, "same light and view"},
    {"the same pair twice", {GOOD}, {.name = "TV0 PV0 TL0 PL0.png", DATA(hdr_pixel)}, BTF_E_CORRUPT, "same light and view"},
    {"path upward at the end", {.name = "tl000_pl000_tv000_pv000.png/..", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "leaves"},
    {"absolute path with a backslash", {.name = "\\tl000_pl000_tv000_pv000.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "leaves"},
    {"offset beyond the end", {GOOD, .offset_lie = 0x7fffffff}, {0}, BTF_E_CORRUPT, "header"},
    {"offset into the data", {GOOD, .offset_lie = 40}, {0}, BTF_E_CORRUPT, "header"},
    {"no local header", {GOOD, .local_signature_lie = 0x04034b51}, {0}, BTF_E_CORRUPT, "header"},
    {"zip64 without its field", {GOOD, .size_lie = 0xffffffff, .packed_lie = 0xffffffff}, {0}, BTF_E_CORRUPT, "directory"},
    {"offset of 2^32 - 1 without zip64", {GOOD, .offset_lie = 0xffffffff}, {0}, BTF_E_CORRUPT, "directory"},
    {"second disk", {GOOD, .disk_lie = 1}, {0}, BTF_E_UNSUPPORTED, "split"},
    {"path upward", {.name = "a/../../tl000_pl000_tv000_pv000.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "leaves"},
    {"path upward of another file", {GOOD}, {.name = "..", DATA("x")}, BTF_E_CORRUPT, "leaves"},
    {"path upward, backslashes", {.name = "a\\..\\tl000_pl000_tv000_pv000.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "leaves"},
    {"absolute path", {.name = "/tmp/tl000_pl000_tv000_pv000.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "leaves"},
    {"path with a drive", {.name = "C:tl000_pl000_tv000_pv000.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "leaves"},
    {"zero in the name", {.name = "tl000_pl000_tv000_pv000.png\0.exe", .name_size = 32, DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "zero"},
    {"name longer than the directory", {GOOD, .name_size_lie = 0xffff}, {0}, BTF_E_CORRUPT, "directory"},
    {"name of 1200 bytes", {GOOD}, {.name = long_name, .name_size = sizeof long_name, DATA(hdr_pixel)}, BTF_E_LIMIT, "1200"},
    {"empty image", {.name = first_name, .data = "", .size = 0}, {0}, BTF_E_CORRUPT, "empty"},
    {"an archive in it", {.name = first_name, DATA("PK\3\4 and so on")}, {0}, BTF_E_CORRUPT, "neither"},
    {"OpenEXR", {.name = first_name, DATA("\x76\x2f\x31\x01 and so on")}, {0}, BTF_E_UNSUPPORTED, "OpenEXR"},
    {"overlapping members", {GOOD}, {.name = second_name, DATA(hdr_pixel), .offset_lie = 0x80000000u}, BTF_E_CORRUPT, "header"},
    {"angle missing", {.name = "tl000_pl000_tv000.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "pv"},
    {"angle twice", {.name = "tl000_pl000_tv000_pv000_pv015.png", DATA(hdr_pixel)}, {0}, BTF_E_CORRUPT, "pv"},
    {"no such direction", {.name = "tl089_pl000_tv000_pv000.png", DATA(hdr_pixel)}, {0}, BTF_E_UNSUPPORTED, "81"},
    {"other size", {GOOD}, {.name = second_name, HDR("-Y 1 +X 2")}, BTF_E_CORRUPT, "tl015_pl000"},
    {"other axes", {GOOD}, {.name = second_name, HDR("+X 1 -Y 1")}, BTF_E_CORRUPT, "by columns"},
    {"other kind", {GOOD}, {.name = second_name, PNG_HEAD("\0\0\0\1\0\0\0\1", "\x08\2")}, BTF_E_CORRUPT, "PNG"},
    {"huge hdr", {.name = first_name, HDR("-Y 70000 +X 70000")}, {0}, BTF_E_LIMIT, "70000"},
    {"hdr of 2^32", {.name = first_name, HDR("-Y 4294967296 +X 1")}, {0}, BTF_E_UNSUPPORTED, "-Y H"},
    {"negative hdr", {.name = first_name, HDR("-Y -1 +X 1")}, {0}, BTF_E_LIMIT, "a side"},
    {"hdr without rows", {.name = first_name, HDR("-Y 0 +X 1")}, {0}, BTF_E_CORRUPT, "1 x 0"},
    {"hdr of one axis", {.name = first_name, HDR("-Y 1 +Y 1")}, {0}, BTF_E_UNSUPPORTED, "-Y H"},
    {"mirrored hdr", {.name = first_name, HDR("-Y 1 -X 1")}, {0}, BTF_E_UNSUPPORTED, "-Y H"},
    {"hdr without sizes", {.name = first_name, HDR("nothing")}, {0}, BTF_E_CORRUPT, "sizes"},
    {"hdr that ends", {.name = first_name, DATA("#?RADIANCE\n")}, {0}, BTF_E_TRUNCATED, "size"},
    {"hdr of XYZ", {.name = first_name, DATA("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n____")}, {0}, BTF_E_UNSUPPORTED, "xyze"},
    {"png of 2^31", {.name = first_name, PNG_HEAD("\x80\0\0\0\0\0\0\1", "\x08\2")}, {0}, BTF_E_LIMIT, "2147483648"},
    {"png of 2^32 - 1", {.name = first_name, PNG_HEAD("\xff\xff\xff\xff\xff\xff\xff\xff", "\x08\2")}, {0}, BTF_E_LIMIT, "4294967295"},
    {"png of nothing", {.name = first_name, PNG_HEAD("\0\0\0\0\0\0\0\0", "\x08\2")}, {0}, BTF_E_CORRUPT, "0 x 0"},
    {"png that ends", {.name = first_name, DATA("\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0")}, {0}, BTF_E_TRUNCATED, "size"},
    {"jpeg of four channels", {.name = first_name, JPEG_HEAD("\0\1\0\1\4")}, {0}, BTF_E_UNSUPPORTED, "4 channels"},
    {"jpeg of 65535", {.name = first_name, JPEG_HEAD("\xff\xff\xff\xff\3")}, {0}, BTF_E_LIMIT, "65535"},
    {"jpeg without rows", {.name = first_name, JPEG_HEAD("\0\0\0\1\3")}, {0}, BTF_E_CORRUPT, "1 x 0"},
    {"jpeg without frame", {.name = first_name, DATA("\xff\xd8\xff\xda\0\x04______")}, {0}, BTF_E_CORRUPT, "frame"},
    {"jpeg that ends", {.name = first_name, DATA("\xff\xd8\xff\xe0\x7f\xff______")}, {0}, BTF_E_TRUNCATED, "size"},
    {"jpeg of 12 bits", {.name = first_name, DATA("\xff\xd8\xff\xc1\0\x11\x0c\0\1\0\1\1\1\x11\0____")}, {0}, BTF_E_UNSUPPORTED, "12 bits"},
};
/* clang-format on */

static void refuse_archive(const char *label, const case_bytes *bytes, btf_status status, const char *part) {
  test_memory memory;
  btf_context *ctx = bounded_context(&memory);
  btf_dataset *ds;
  const char *path = test_path("hostile.zip");
  test_write_bytes(path, bytes->data, bytes->size);
  const clock_t began = clock();
  const btf_status got = format_try(ctx, path, "bonn-images", NULL, &ds);
  assert_null(ds);
  check_refusal(label, got, status, part, began);
  format_keep_refused(path, status, false);
  test_context_done(ctx, &memory);
}

/* Small archives that claim much. */
static void refuse_bombs(void) {
  enum { BOMB_BYTES = 64 << 20 };
  zip_writer zip = {.count = 0};
  char *bomb = calloc(1, BOMB_BYTES);
  assert_non_null(bomb);
  memcpy(bomb, hdr_pixel, sizeof hdr_pixel);
  zip_add(&zip, &(zip_member){.name = first_name, .data = bomb, .size = BOMB_BYTES, .deflated = true});
  zip_end(&zip, false);
  assert_true(zip.bytes.size < 1 << 17);
  refuse_archive("bomb", &zip.bytes, BTF_E_LIMIT, "can need");
  zip_free(&zip);
  free(bomb);
}

static void refuse_overlaps(void) {
  zip_writer inner = {.count = 0}, zip = {.count = 0};
  zip_member second = {.name = second_name, DATA(hdr_pixel)};
  /* The second member lies, header and all, in the bytes of the first. */
  zip_add(&inner, &second);
  zip_add(&zip, &(zip_member){.name = first_name, .data = inner.bytes.data, .size = inner.bytes.size});
  second.offset_lie = 30 + sizeof first_name - 1;
  zip_add(&zip, &second);
  zip_end(&zip, false);
  refuse_archive("a member in another", &zip.bytes, BTF_E_CORRUPT, "overlap");
  zip_free(&zip);
  zip_free(&inner);
  /* Two entries of the directory for the same bytes. */
  zip_add(&zip, &(zip_member){.name = "a", DATA("b")});
  const uint32_t offset = (uint32_t)zip.bytes.size;
  zip_add(&zip, &(zip_member){GOOD});
  zip_add(&zip, &(zip_member){GOOD, .offset_lie = offset});
  zip_end(&zip, false);
  refuse_archive("bytes used twice", &zip.bytes, BTF_E_CORRUPT, "overlap");
  zip_free(&zip);
}

/* Numbers of the end of an archive of one member. */
static void refuse_ends(void) {
  static const struct {
    const char *label;
    zip_writer lies;
    btf_status status;
    const char *part;
  } ends[] = {
      {"2^31 members", {.count64_lie = UINT64_C(1) << 31}, BTF_E_LIMIT, "members"},
      {"2^32 - 1 members", {.count64_lie = UINT32_MAX}, BTF_E_LIMIT, "members"},
      {"2^64 - 1 members", {.count64_lie = UINT64_MAX}, BTF_E_LIMIT, "members"},
      {"directory of 2^31 bytes", {.directory_size64_lie = UINT64_C(1) << 31}, BTF_E_CORRUPT, "directory"},
      {"directory of 2^63 bytes", {.directory_size64_lie = UINT64_C(1) << 63}, BTF_E_CORRUPT, "directory"},
      {"directory of 2^64 - 1 bytes", {.directory_size64_lie = UINT64_MAX}, BTF_E_CORRUPT, "directory"},
      {"directory at 2^32 - 1", {.directory_offset64_lie = UINT32_MAX}, BTF_E_CORRUPT, "directory"},
      {"directory at 2^63", {.directory_offset64_lie = UINT64_C(1) << 63}, BTF_E_CORRUPT, "directory"},
      {"directory at 2^64 - 1", {.directory_offset64_lie = UINT64_MAX}, BTF_E_CORRUPT, "directory"},
      {"directory whose end wraps round",
       {.directory_size64_lie = UINT64_MAX - 8, .directory_offset64_lie = 40},
       BTF_E_CORRUPT,
       "directory"},
      {"directory in the first member", {.directory_offset64_lie = 1}, BTF_E_CORRUPT, "directory"},
      {"record of zip64 beyond the end", {.record64_lie = UINT64_C(1) << 40}, BTF_E_CORRUPT, "directory"},
      {"record of zip64 at 2^64 - 1", {.record64_lie = UINT64_MAX}, BTF_E_CORRUPT, "directory"},
      {"record of zip64 in the first member", {.record64_lie = 1}, BTF_E_CORRUPT, "directory"},
  };
  for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) {
    zip_writer zip = ends[i].lies;
    zip_add(&zip, &(zip_member){GOOD});
    zip_end(&zip, true);
    refuse_archive(ends[i].label, &zip.bytes, ends[i].status, ends[i].part);
    zip_free(&zip);
  }
}

static void refuse_counts(void) {
  zip_writer zip = {.count = 0};
  zip_add(&zip, &(zip_member){GOOD});
  zip.count = 70000;
  zip_end(&zip, true);
  refuse_archive("too many members", &zip.bytes, BTF_E_LIMIT, "members");
  zip_free(&zip);
  zip_add(&zip, &(zip_member){GOOD});
  zip.count = 3;
  zip_end(&zip, false);
  refuse_archive("more members than there are", &zip.bytes, BTF_E_CORRUPT, "directory");
  zip_free(&zip);
  zip_end(&zip, false);
  refuse_archive("no members", &zip.bytes, BTF_E_CORRUPT, "no directory");
  zip_free(&zip);
  zip_add(&zip, &(zip_member){.name = "readme.txt", DATA("x")});
  zip_end(&zip, false);
  refuse_archive("no images", &zip.bytes, BTF_E_NOT_BTF, "tl, pl, tv and pv");
  zip_free(&zip);
}

void test_hostile_archives(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof archives / sizeof *archives; i++) {
    const hostile_case *c = &archives[i];
    zip_writer zip = {.count = 0};
    zip_add(&zip, &c->first);
    if (c->second.name != NULL) zip_add(&zip, &c->second);
    zip_end(&zip, c->first.zip64);
    refuse_archive(c->label, &zip.bytes, c->status, c->part);
    zip_free(&zip);
  }
  refuse_bombs();
  refuse_overlaps();
  refuse_counts();
  refuse_ends();
}

/* An archive that ends early is not taken, wherever it ends; nor recognised, without a word. */
void test_truncation(void **state) {
  (void)state;
  zip_writer zip = {.count = 0};
  test_memory memory;
  btf_context *ctx = bounded_context(&memory);
  const char *path = test_path("short.zip");
  zip_add(&zip, &(zip_member){GOOD, .deflated = true});
  zip_add(&zip, &(zip_member){.name = second_name, DATA(hdr_pixel), .zip64 = true});
  zip_end(&zip, true);
  for (size_t size = 0; size < zip.bytes.size; size++) {
    btf_dataset *ds;
    const btf_format *format;
    test_write_bytes(path, zip.bytes.data, size);
    const btf_status status = format_try(ctx, path, "bonn-images", NULL, &ds);
    if (status == BTF_OK) fail_msg("opened with %zu of %zu bytes", size, zip.bytes.size);
    assert_true(status >= BTF_E_LIMIT && status < BTF_E_CANCELLED);
    assert_true(strlen(btf_error_message()) > 0 && strchr(btf_error_message(), '\n') == NULL);
    (void)!btf_format_detect(ctx, path, &format);
    truncations++;
  }
  zip_free(&zip);
  test_context_done(ctx, &memory);
}

/* ---- complete archives with one damaged picture ---- */

enum { MIDDLE = 40 * 81 + 7 };

/* All pairs but the middle one, which comes last. */
static void add_others(zip_writer *zip, const picture_case *c) {
  for (uint32_t pair = 0; pair < CASE_PAIRS; pair++) {
    char name[128];
    case_bytes picture = {0};
    if (pair == MIDDLE) continue;
    case_picture(c, pair / 81, pair % 81, &picture);
    case_name(CASE_UTIA, "png", pair / 81, pair % 81, name);
    zip_add(zip, &(zip_member){.name = name, .data = picture.data, .size = picture.size});
    case_free(&picture);
  }
}

/* A damaged picture is filled if that is asked for; one with values that the chosen type does not hold is
 * not. */
static void fill_picture(btf_context *ctx, const char *label, const char *path, btf_status refused) {
  static const char *const settings[] = {"allow_missing", "true", NULL};
  const btf_block block = {40, 1, 7, 1, 0, 0, 1, 1};
  const btf_strides strides = {.view = 12, .light = 12, .y = 12, .x = 12, .channel = 4};
  float samples[3];
  btf_dataset *ds;
  const btf_status status = format_try(ctx, path, "bonn-images", settings, &ds);
  if (status != (refused == BTF_E_LIMIT ? refused : BTF_OK))
    fail_msg("%s: with gaps allowed %s", label, btf_status_name(status));
  if (status == BTF_OK) assert_ok(btf_dataset_read(ds, &block, samples, &strides));
  btf_dataset_release(ds);
}

static void refuse_picture(const char *label, const zip_writer *others, zip_member middle, bool found_late,
                           btf_status status, const char *part) {
  test_memory memory;
  btf_context *ctx = bounded_context(&memory);
  zip_writer zip = {.count = others->count};
  btf_dataset *ds;
  char name[128];
  float samples[64 * 3];
  const char *path = test_path("damaged.zip");
  const btf_block before = {40, 1, 6, 1, 0, 0, 1, 1}, block = {40, 1, 6, 3, 0, 0, 1, 1};
  const btf_strides strides = {.view = 12, .light = 12, .y = 12, .x = 12, .channel = 4};
  case_name(CASE_UTIA, "png", 40, 7, name);
  middle.name = name;
  case_append(&zip.bytes, others->bytes.data, others->bytes.size);
  case_append(&zip.directory, others->directory.data, others->directory.size);
  zip_add(&zip, &middle);
  zip_end(&zip, false);
  test_write_bytes(path, zip.bytes.data, zip.bytes.size);
  zip_free(&zip);
  const clock_t began = clock();
  const btf_status opened = format_try(ctx, path, "bonn-images", NULL, &ds);
  if (opened != BTF_OK) { /* what is short is looked at whole when the archive is opened */
    check_refusal(label, opened, status, part, began);
    assert_message_has(name);
    assert_true(middle.size <= 4096 && !found_late);
    format_keep_refused(path, status, false);
    fill_picture(ctx, label, path, status);
    test_context_done(ctx, &memory);
    return;
  }
  assert_true(found_late);
  assert_ok(btf_dataset_read(ds, &before, samples, &strides));
  for (int i = 0; i < 2; i++) { /* a failure is not remembered as a picture */
    const btf_status got = btf_dataset_read(ds, &block, samples, &strides);
    check_refusal(label, got, status, part, began);
    assert_message_has(name);
  }
  btf_dataset_release(ds);
  format_keep_refused(path, status, true);
  fill_picture(ctx, label, path, status);
  test_context_done(ctx, &memory);
}

/* As it was, with one byte changed from the end, or cut. */
static zip_member changed(case_bytes *picture, size_t cut, size_t back) {
  picture->size -= cut;
  if (back > 0) picture->data[picture->size - back] ^= 0x55;
  return (zip_member){.data = picture->data, .size = picture->size};
}

void test_hostile_pictures(void **state) {
  static const picture_case jpeg = {CASE_JPEG, 16, 12, 3, case_code}, png = {CASE_PNG, 3, 2, 3, case_code},
                            hdr = {CASE_HDR, 8, 2, 3, case_code};
  (void)state;
  zip_writer others = {.count = 0};
  case_bytes picture = {0};
  add_others(&others, &jpeg);
  case_picture(&jpeg, 40, 7, &picture);
  for (int late = 0; late < 2; late++) {
    static const char padding[5000];
    if (late) case_append(&picture, padding, sizeof padding);
    zip_member m = changed(&picture, 0, 0);
    m.crc_lie = 1;
    refuse_picture("checksum", &others, m, late, BTF_E_CORRUPT, "checksum");
    m = changed(&picture, 0, 0);
    m.deflated = true;
    m.size_lie = (uint32_t)m.size - 1;
    refuse_picture("one byte more than said", &others, m, late, BTF_E_CORRUPT, "unpack");
    m.size_lie = (uint32_t)m.size + 1;
    refuse_picture("one byte less than said", &others, m, late, BTF_E_CORRUPT, "unpack");
  }
  case_free(&picture);
  case_picture(&jpeg, 40, 7, &picture);
  for (uint32_t i = 0; i < 4; i++) {
    static const picture_case sizes[] = {{CASE_JPEG, 17, 12, 3, case_code},
                                         {CASE_JPEG, 12, 16, 3, case_code},
                                         {CASE_JPEG, 16, 12, 1, case_code},
                                         {CASE_PNG, 16, 12, 3, case_code}};
    static const char *const parts[] = {"17 x 12", "12 x 16", "1 channels", "PNG of 16 x 12"};
    case_bytes other = {0};
    case_picture(&sizes[i], 40, 7, &other);
    refuse_picture(parts[i], &others, changed(&other, 0, 0), false, BTF_E_CORRUPT, parts[i]);
    case_free(&other);
  }
  refuse_picture("jpeg without end", &others, changed(&picture, 2, 0), true, BTF_E_CORRUPT, "JPEG");
  refuse_picture("jpeg cut", &others, changed(&picture, 150, 0), true, BTF_E_CORRUPT, "JPEG");
  case_free(&picture);
  /* A second frame header that is larger than the one that was looked at. */
  case_picture(&jpeg, 40, 7, &picture);
  for (size_t i = 2; i + 9 < picture.size; i++)
    if (picture.data[i] == 0xff && picture.data[i + 1] == 0xc0) {
      case_bytes two = {0};
      unsigned char larger[19];
      memcpy(larger, picture.data + i, sizeof larger);
      larger[5] = larger[7] = 4;
      case_append(&two, picture.data, i + sizeof larger);
      case_append(&two, larger, sizeof larger);
      case_append(&two, picture.data + i + sizeof larger, picture.size - i - sizeof larger);
      refuse_picture("jpeg of two frames", &others, changed(&two, 0, 0), true, BTF_E_CORRUPT, "JPEG");
      case_free(&two);
      break;
    }
  case_free(&picture);
  zip_free(&others);

  add_others(&others, &png);
  case_picture(&png, 40, 7, &picture);
  refuse_picture("png cut", &others, changed(&picture, 14, 0), true, BTF_E_CORRUPT, "PNG");
  case_free(&picture);
  case_picture(&png, 40, 7, &picture);
  refuse_picture("png with a wrong byte", &others, changed(&picture, 0, 20), true, BTF_E_CORRUPT, "PNG");
  case_free(&picture);
  case_picture(&png, 40, 7, &picture);
  picture.data[25] = 7; /* colour type */
  refuse_picture("png of no colours", &others, changed(&picture, 0, 0), true, BTF_E_CORRUPT, "PNG");
  case_free(&picture);
  zip_free(&others);

  add_others(&others, &hdr);
  case_picture(&hdr, 40, 7, &picture);
  refuse_picture("hdr cut", &others, changed(&picture, 1, 0), true, BTF_E_CORRUPT, "line 1");
  case_free(&picture);
  case_picture(&hdr, 40, 7, &picture);
  picture.data[picture.size - 2] = 255; /* the last run, which should have 8 */
  refuse_picture("hdr whose run leaves the line", &others, changed(&picture, 0, 0), true, BTF_E_CORRUPT,
                 "line 1");
  picture.data[picture.size - 2] = 128 + 8;
  picture.data[picture.size - 1] = 255;
  refuse_picture("hdr beyond half floats", &others, changed(&picture, 0, 0), true, BTF_E_LIMIT, "type=f32");
  case_free(&picture);
  zip_free(&others);
}

/* ---- duplicates, folders ---- */

void test_duplicates(void **state) {
  static const picture_case hdr = {CASE_HDR, 8, 2, 3, case_code};
  static const char *const take_first[] = {"duplicates", "first", NULL};
  (void)state;
  test_memory memory;
  btf_context *ctx = bounded_context(&memory);
  zip_writer zip = {.count = 0};
  case_bytes picture = {0}, other = {0};
  btf_dataset *ds;
  float sample[3];
  const char *path = test_path("twice.zip");
  const btf_block block = {40, 1, 7, 1, 0, 0, 1, 1};
  const btf_strides strides = {.view = 12, .light = 12, .y = 12, .x = 12, .channel = 4};
  add_others(&zip, &hdr);
  case_picture(&hdr, 40, 7, &picture);
  case_picture(&hdr, 41, 8, &other);
  zip_add(&zip,
          &(zip_member){.name = "z_tl030_pl000_tv060_pv054.png", .data = picture.data, .size = picture.size});
  zip_add(&zip, &(zip_member){.name = "a_tl30_pl0_tv60_pv54.png", .data = other.data, .size = other.size});
  zip_end(&zip, false);
  test_write_bytes(path, zip.bytes.data, zip.bytes.size);
  case_free(&picture);
  case_free(&other);
  zip_free(&zip);
  assert_status(format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_CORRUPT);
  assert_message_has("z_tl030_pl000_tv060_pv054.png and a_tl30_pl0_tv60_pv54.png");
  assert_message_has("duplicates=first");
  assert_ok(format_try(ctx, path, "bonn-images", take_first, &ds));
  assert_ok(btf_dataset_read(ds, &block, sample, &strides));
  assert_near(sample[0], (case_code(40, 7, 0, 1, 0) + 0.5) / 256, 0);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

/* Links that go in circles, and what only looks like pictures. */
void test_odd_folders(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = bounded_context(&memory);
  char inner[512];
  btf_dataset *ds;
  const char *path = test_path("odd");
  const btf_format *format;
  const clock_t began = clock();
  assert_int_equal(mkdir(path, 0700), 0);
  assert_status(btf_format_detect(ctx, path, &format), BTF_E_NOT_BTF);
  check_refusal("empty folder", format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_NOT_BTF,
                "tl, pl, tv and pv", began);
  snprintf(inner, sizeof inner, "%s/loop", path);
  assert_int_equal(symlink(path, inner), 0);
  check_refusal("circle", format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_NOT_BTF, "tl, pl, tv and pv",
                began);
  snprintf(inner, sizeof inner, "%s/tl000_pl000_tv000_pv000.png", path);
  assert_int_equal(mkfifo(inner, 0600), 0);
  check_refusal("pipe", format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_IO, "not a file", began);
  assert_int_equal(unlink(inner), 0);
  assert_int_equal(symlink("nowhere", inner), 0);
  check_refusal("link to nothing", format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_IO, "not a file",
                began);
  assert_int_equal(unlink(inner), 0);
  test_write_bytes(inner, "", 0);
  check_refusal("empty file", format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_CORRUPT, "empty", began);
  assert_int_equal(truncate(inner, 5000), 0);
  check_refusal("zeros", format_try(ctx, path, "bonn-images", NULL, &ds), BTF_E_CORRUPT, "neither", began);
  test_context_done(ctx, &memory);
}

/* At least as many as all formats together are to have. */
void test_count_refusals(void **state) {
  (void)state;
  print_message("%u damaged or absurd variants and %u truncations were refused\n", refusals, truncations);
  assert_true(refusals >= 100 && truncations >= 400);
}
