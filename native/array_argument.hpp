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

/// An array of Python's, kept alive as long as this is there.
///
/// @throws nanobind::type_error if it is no array of such elements in the memory of the CPU.
/// @throws nanobind::value_error if it has another shape, is not in C order, or is not aligned.
template <typename Element>
class ArrayArgument {
  public:
    /// @param shape: what is wanted; ANY for an axis of any length.
    ArrayArgument(nanobind::handle array, const char* name,
                  std::initializer_list<std::size_t> shape);

    const Element* data() const { return static_cast<const Element*>(array_.data()); }
    std::size_t shape(std::size_t axis) const { return array_.shape(axis); }
    std::span<const Element> span() const { return {data(), array_.size()}; }

  private:
    nanobind::ndarray<nanobind::ro> array_;
};

/// An image (H, W, 4), see MaskedImage.
class MaskedImageArgument {
  public:
    MaskedImageArgument(nanobind::handle array, const char* name);
    /// One that has to be as large as another.
    MaskedImageArgument(nanobind::handle array, const char* name, const MaskedImage& like);

    operator MaskedImage() const { return {array_.data(), array_.shape(0), array_.shape(1)}; }

  private:
    ArrayArgument<float> array_;
};

/// A finite number.
///
/// @throws nanobind::type_error if it is no number.
/// @throws nanobind::value_error if it is not finite.
double finite_number(nanobind::handle number, const char* name);

/// A finite number of at least so much.
double number_from(double least, nanobind::handle number, const char* name);

/// A finite number above zero.
double positive_number(nanobind::handle number, const char* name);

/// An integer within limits, both included.
std::size_t integer_between(std::size_t least, std::size_t most, nanobind::handle number,
                            const char* name);

/// Refuses an array in which a number is below the least or not below the end.
void check_range(std::span<const std::int32_t> values, std::int64_t least, std::size_t end,
                 const char* name);

/// A new NumPy array, all of its elements zero, and where they are.
template <typename Element>
struct NewArray {
    explicit NewArray(std::initializer_list<std::size_t> shape);

    nanobind::ndarray<nanobind::numpy, Element> array;
    std::span<Element> values;
};

}  // namespace lfnav
