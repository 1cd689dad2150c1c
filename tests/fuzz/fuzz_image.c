/* SPDX-License-Identifier: MIT */
/* Pictures: any bytes are read as OpenEXR or Radiance or refused; what was read is finite and not negative.
 */
#include "fuzz_file.h"

#include <math.h>

#include "cli.h"
#include "image/image.h"

/* Stands before image_create: a few bytes may truly code a large picture, which would take long here. */
int __wrap_image_create(image *out, uint32_t width, uint32_t height);
int __real_image_create(image *out, uint32_t width, uint32_t height);

int __wrap_image_create(image *out, uint32_t width, uint32_t height) {
  if ((uint64_t)width * height > 1 << 18) return EXIT_LIMIT;
  return __real_image_create(out, width, height);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_file file = fuzz_file_make(data, size);
  image picture;
  uint64_t repaired = 0;
  const int failed = image_read(file.path, &picture, &repaired);
  fuzz_file_drop(&file);
  if (failed != EXIT_DONE) {
    fuzz_expect(picture.rgb == NULL);
    return 0;
  }
  const size_t values = (size_t)picture.width * picture.height * 3;
  fuzz_expect(picture.width >= 1 && picture.height >= 1 && repaired <= values);
  for (size_t i = 0; i < values; i++) fuzz_expect(isfinite(picture.rgb[i]) && picture.rgb[i] >= 0.0f);
  image_free(&picture);
  return 0;
}
