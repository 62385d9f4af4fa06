// Vectors of numbers that fill a register: compilers' vector extensions.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

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

/// Of pixels of four channels the fourth in all of them.
LFNAV_INLINE FloatVector fourth_channels(const FloatVector& pixels) {
#if defined(__AVX512F__)
    return __builtin_shufflevector(pixels, pixels, 3, 3, 3, 3, 7, 7, 7, 7, 11, 11, 11, 11, 15, 15,
                                   15, 15);
#elif defined(__AVX2__)
    return __builtin_shufflevector(pixels, pixels, 3, 3, 3, 3, 7, 7, 7, 7);
#else
    return __builtin_shufflevector(pixels, pixels, 3, 3, 3, 3);
#endif
}

/// Of pixels of four channels the sum of the first three, and of the fourth.
struct ChannelSums {
    double colours = 0.0, fourth = 0.0;

    LFNAV_INLINE void add(const FloatVector& pixels) {
        for (std::size_t i = 0; i < sizeof pixels / sizeof(float); i += 4) {
            colours += static_cast<double>(pixels[i] + pixels[i + 1] + pixels[i + 2]);
            fourth += static_cast<double>(pixels[i + 3]);
        }
    }
};

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

}  // namespace lfnav::LFNAV_LEVEL
