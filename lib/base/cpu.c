/* SPDX-License-Identifier: MIT */
#include "base/context.h"

#include <string.h>

#include <btf/btf_plugin.h>

#if defined(__x86_64__)
#include <cpuid.h>

/* The builtin of some compilers does not know this feature by name. */
static bool has_f16c(void) {
  unsigned eax, ebx, ecx, edx;
  return __get_cpuid(1, &eax, &ebx, &ecx, &edx) && (ecx >> 29 & 1u);
}

/* The builtin reports AVX features only if the operating system saves their registers. */
uint32_t btfi_isa_of_machine(void) {
  __builtin_cpu_init();
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") || !has_f16c()) return BTF_ISA_SCALAR;
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq"))
    return BTF_ISA_AVX512;
  return BTF_ISA_AVX2;
}
#elif defined(__aarch64__)
uint32_t btfi_isa_of_machine(void) {
  return BTF_ISA_NEON;
}
#else
uint32_t btfi_isa_of_machine(void) {
  return BTF_ISA_SCALAR;
}
#endif

static const struct {
  const char *name;
  uint32_t isa;
} known_isas[] = {
    {"scalar", BTF_ISA_SCALAR}, {"avx2", BTF_ISA_AVX2}, {"avx512", BTF_ISA_AVX512}, {"neon", BTF_ISA_NEON}};

const char *btfi_isa_name(uint32_t isa) {
  for (size_t i = 0; i < sizeof known_isas / sizeof known_isas[0]; i++)
    if (known_isas[i].isa == isa) return known_isas[i].name;
  return known_isas[0].name;
}

bool btfi_isa_cap(const char *name, uint32_t machine, uint32_t *out) {
  *out = machine;
  if (!name) return true;
  for (size_t i = 0; i < sizeof known_isas / sizeof known_isas[0]; i++) {
    if (strcmp(known_isas[i].name, name) != 0) continue;
    const uint32_t cap = known_isas[i].isa;
    /* A cap of the other processor family leaves plain code only. */
    const bool same_family = (cap >= BTF_ISA_NEON) == (machine >= BTF_ISA_NEON);
    *out = same_family ? BTFI_MIN(cap, machine) : BTF_ISA_SCALAR;
    return true;
  }
  return false;
}
