// Vectors of numbers that fill a register: compilers' vector extensions.

#pragma once

#ifdef __AVX2__
#include <immintrin.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Pixels that plain loops work on together; arrays are as much longer as that takes.
constexpr std::size_t TOGETHER = 16;

using FloatVector = float __attribute__((vector_size(BYTES)));
using DoubleVector = double __attribute__((vector_size(BYTES)));
using IntegerVector = std::int32_t __attribute__((vector_size(BYTES)));

/// The vector at an address, which need not be aligned.
template <typename Vector, typename Number>
LFNAV_INLINE Vector loaded(const Number* from) {
    Vector result;
    std::memcpy(&result, from, sizeof result);
    return result;
}

template <typename Vector, typename Number>
LFNAV_INLINE void store(const Vector& vector, Number* to) {
    std::memcpy(to, &vector, sizeof vector);
}

/// The first so many numbers at an address, at most as many as the vector has, and zeros.
LFNAV_INLINE FloatVector loaded(const float* from, std::size_t count) {
    FloatVector result = {};
    std::memcpy(&result, from, std::min(count * sizeof(float), sizeof result));
    return result;
}

/// Of pixels of four channels one channel in all of them.
template <std::int32_t CHANNEL>
LFNAV_INLINE FloatVector spread(const FloatVector& pixels) {
    [[maybe_unused]] constexpr std::int32_t A = CHANNEL, B = A + 4, C = A + 8, D = A + 12;
#if defined(__AVX512F__)
    return __builtin_shufflevector(pixels, pixels, A, A, A, A, B, B, B, B, C, C, C, C, D, D, D, D);
#elif defined(__AVX2__)
    return __builtin_shufflevector(pixels, pixels, A, A, A, A, B, B, B, B);
#else
    return __builtin_shufflevector(pixels, pixels, A, A, A, A);
#endif
}

/// Numbers at indices of an array. GCC 12 makes of a loop one read after the other.
LFNAV_INLINE FloatVector gathered(const float* numbers, const IntegerVector& indices) {
#if defined(__AVX512F__)
    // Without a mask GCC 12 warns of its own header.
    return FloatVector(_mm512_mask_i32gather_ps(_mm512_setzero_ps(), __mmask16(0xffff),
                                                __m512i(indices), numbers, sizeof(float)));
#elif defined(__AVX2__)
    return FloatVector(_mm256_i32gather_ps(numbers, __m256i(indices), sizeof(float)));
#else
    FloatVector result = {};
    for (std::size_t i = 0; i < BYTES / sizeof(float); ++i) {
        result[i] = numbers[indices[i]];
    }
    return result;
#endif
}

template <typename Vector>
LFNAV_INLINE Vector square_root(const Vector& vector) {
    constexpr std::size_t FLOATS = sizeof(Vector) / sizeof(float);
    alignas(64) float values[FLOATS];
    store(vector, values);
#pragma omp simd
    for (std::size_t i = 0; i < FLOATS; ++i) {
        values[i] = std::sqrt(values[i]);
    }
    return loaded<Vector>(values);
}

template <typename Vector>
LFNAV_INLINE Vector smaller(const Vector& a, const Vector& b) {
    return a < b ? a : b;
}

template <typename Vector>
LFNAV_INLINE Vector larger(const Vector& a, const Vector& b) {
    return a > b ? a : b;
}

/// Whether a comparison of vectors holds anywhere.
template <typename Mask>
LFNAV_INLINE bool any_of(const Mask& mask) {
    std::uint64_t words[sizeof(Mask) / sizeof(std::uint64_t)], together = 0;
    std::memcpy(words, &mask, sizeof mask);
    for (const std::uint64_t word : words) {
        together |= word;
    }
    return together != 0;
}

}  // namespace lfnav::LFNAV_LEVEL
