/* SPDX-License-Identifier: MIT */
/* clones.h: inner loops compiled for several vector widths, chosen when the program starts. All give the same
 * values, since the build contracts no multiply and add. */
#ifndef BTF_TOOLS_SYNTH_CLONES_H
#define BTF_TOOLS_SYNTH_CLONES_H

#if defined(__has_feature)
#if __has_feature(thread_sanitizer) || __has_feature(address_sanitizer) || __has_feature(memory_sanitizer)
#define CLONES_SANITIZED 1
#endif
#endif
/* The chooser runs before a sanitizer is ready. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__) &&             \
    !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__) && !defined(CLONES_SANITIZED)
#define VECTOR_CLONES __attribute__((target_clones("default", "avx2", "arch=skylake-avx512")))
#else
#define VECTOR_CLONES
#endif

#endif
