// The level that a file with kernels is compiled for.
//
// Everything in such a file, and in headers for such files, is in the namespace lfnav::LFNAV_LEVEL:
// what has one name is one function to the linker, and that for AVX-512 may not be taken for the
// one that every processor can run. See CMakeLists.txt for what has no namespace of ours.

#pragma once

#include <cstddef>

#ifndef LFNAV_LEVEL
#define LFNAV_LEVEL baseline
#endif
#define LFNAV_INLINE inline __attribute__((always_inline))

namespace lfnav::LFNAV_LEVEL {

/// Of a register.
#if defined(__AVX512F__)
constexpr std::size_t BYTES = 64;
#elif defined(__AVX2__)
constexpr std::size_t BYTES = 32;
#else
constexpr std::size_t BYTES = 16;
#endif

}  // namespace lfnav::LFNAV_LEVEL
