// For which processors a kernel is compiled, and which of them this one is.

#pragma once

#include <string_view>

// A function that is marked LFNAV_DISPATCHED is compiled once for each level of x86-64, and the
// loader takes what fits the processor: one build runs everywhere and uses AVX-512 where it is.
// What such a function calls has to be marked LFNAV_INLINE, or it stays at the lowest level.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(LFNAV_ONE_LEVEL)
#define LFNAV_DISPATCHED \
    __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define LFNAV_DISPATCHED
#endif
#define LFNAV_INLINE inline __attribute__((always_inline))

namespace lfnav {

/// Name of the processor's level, of those that kernels are compiled for: "x86-64-v3", for example,
/// and "baseline" where there is no other.
std::string_view instruction_set();

}  // namespace lfnav
