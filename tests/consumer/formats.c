/* Readers of measured data from an installed library. */
#include <btf/btf.h>
#include <btf/btf_formats.h>
#include <stdio.h>

int main(void) {
  btf_context *context = NULL;
  const btf_format *format = NULL;
  if (btf_context_create(NULL, &context) != BTF_OK || btf_formats_register(context) != BTF_OK) return 1;
  if (btf_format_count(context) < 2 || btf_format_detect(context, "/dev/null", &format) == BTF_OK) return 1;
  puts(btf_format_title(btf_format_at(context, 1)));
  btf_context_release(context);
  return 0;
}
