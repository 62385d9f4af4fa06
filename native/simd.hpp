// Vectors of numbers that fill a register: compilers' vector extensions, by the register's bytes.

#pragma once

#include <cstddef>

namespace lfnav {

/// Written out one by one: GCC 12 does not take a size that depends on a template for a size.
template <std::size_t BYTES>
struct VectorTypes;

template <>
struct VectorTypes<16> {
    using Float = float __attribute__((vector_size(16)));
    using Double = double __attribute__((vector_size(16)));
};

template <>
struct VectorTypes<32> {
    using Float = float __attribute__((vector_size(32)));
    using Double = double __attribute__((vector_size(32)));
};

template <>
struct VectorTypes<64> {
    using Float = float __attribute__((vector_size(64)));
    using Double = double __attribute__((vector_size(64)));
};

template <std::size_t BYTES>
using FloatVector = typename VectorTypes<BYTES>::Float;
template <std::size_t BYTES>
using DoubleVector = typename VectorTypes<BYTES>::Double;

}  // namespace lfnav
