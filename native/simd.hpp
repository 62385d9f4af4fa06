// Vectors of numbers that fill a register: compilers' vector extensions.

#pragma once

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
