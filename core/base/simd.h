#pragma once

// Marks a hot function for compilation at several x86-64 levels, the best one chosen at run time.
// The function must contain its whole loop: what it calls has to be inlined. ARM64 has NEON in its
// baseline and needs none of this. Off under sanitizers, whose runtime is not up when the choice is
// made.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define OMNIHDR_SIMD_CLONES \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define OMNIHDR_SIMD_CLONES
#endif

#define OMNIHDR_ALWAYS_INLINE inline __attribute__((always_inline))
