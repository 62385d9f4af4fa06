// Arguments that Python hands over, checked: each mistake is one line that names the argument.

#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <span>
#include <string>

#include "image.hpp"

namespace lfnav {

/// Of an array's axis that may have any length.
constexpr std::size_t ANY = std::numeric_limits<std::size_t>::max();
/// Of images, pixels: all of them are told apart by 32 bits.
constexpr std::size_t LONGEST_SIDE = 1 << 15;

/// An argument that a function takes whatever it is, and checks itself.
inline auto argument(const char* name) { return nanobind::arg(name).none(); }

/// Throws nanobind::value_error with one line about an argument.
[[noreturn]] void refuse_value(const char* name, const std::string& reason);
/// Throws nanobind::type_error with one line about an argument.
[[noreturn]] void refuse_type(const char* name, const std::string& reason);

/// The arguments of a call that has many of them, each given by its name.
class NamedArguments {
  public:
    explicit NamedArguments(const nanobind::kwargs& given) : left_(given) {}

    /// @throws nanobind::type_error if it is missing.
    nanobind::object take(const char* name);
    /// @throws nanobind::type_error if any has not been taken.
    void end() const;

  private:
    nanobind::dict left_;
};

/// An array of Python's, kept alive as long as this is there.
///
/// @throws nanobind::type_error if it is no array of such elements in the memory of the CPU.
/// @throws nanobind::value_error if it has another shape, is not in C order, or is not aligned.
template <typename Element>
class ArrayArgument {
  public:
    using Shape = std::initializer_list<std::size_t>;

    /// @param shape: what is wanted; ANY for an axis of any length.
    ArrayArgument(nanobind::handle array, const char* name, Shape shape);
    ArrayArgument(NamedArguments& given, const char* name, Shape shape)
        : ArrayArgument(given.take(name), name, shape) {}

    const Element* data() const { return static_cast<const Element*>(array_.data()); }
    std::size_t shape(std::size_t axis) const { return array_.shape(axis); }
    std::span<const Element> span() const { return {data(), array_.size()}; }

    /// As kernels take an image (H, W) or (H, W, CHANNELS).
    template <std::size_t CHANNELS>
    operator Image<Element, CHANNELS>() const {
        return {data(), shape(0), shape(1)};
    }

  private:
    nanobind::ndarray<nanobind::ro> array_;
};

/// A finite number.
///
/// @throws nanobind::type_error if it is no number.
/// @throws nanobind::value_error if it is not finite.
double finite_number(nanobind::handle number, const char* name);

/// A finite number within limits, both included.
double number_between(double least, double most, nanobind::handle number, const char* name);

/// A finite number of at least so much.
inline double number_from(double least, nanobind::handle number, const char* name) {
    return number_between(least, std::numeric_limits<double>::max(), number, name);
}

/// A finite number above zero.
double positive_number(nanobind::handle number, const char* name);

/// True or False.
bool truth(nanobind::handle value, const char* name);

/// An integer within limits, both included.
std::size_t integer_between(std::size_t least, std::size_t most, nanobind::handle number,
                            const char* name);

/// Refuses an array in which a number is below the least or not below the end.
template <typename Integer>
void check_range(std::span<const Integer> values, std::int64_t least, std::size_t end,
                 const char* name) {
    for (const Integer value : values) {
        if (value < least || value >= static_cast<std::int64_t>(end)) {
            refuse_value(name, "numbers from " + std::to_string(least) + " to " +
                                   std::to_string(static_cast<std::int64_t>(end) - 1) +
                                   " expected, got " + std::to_string(value));
        }
    }
}

/// A new NumPy array, all of its elements zero, and where they are.
template <typename Element>
struct NewArray {
    explicit NewArray(std::initializer_list<std::size_t> shape);

    nanobind::ndarray<nanobind::numpy, Element> array;
    std::span<Element> values;
};

}  // namespace lfnav
