#include "arguments.hpp"

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>
#include <type_traits>

namespace nb = nanobind;

namespace lfnav {

namespace {

/// As NumPy calls it.
template <typename Element>
std::string element_name() {
    if (std::is_same_v<Element, bool>) {
        return "bool";
    }
    const std::string kind = std::is_floating_point_v<Element> ? "float"
                             : std::is_signed_v<Element>       ? "int"
                                                               : "uint";
    return kind + std::to_string(8 * sizeof(Element));
}

std::string text(nb::handle object) { return nb::str(object).c_str(); }

std::string class_name(nb::handle object) { return text(object.type().attr("__name__")); }

std::string number_text(double value) {
    char buffer[32];
    std::snprintf(buffer, sizeof buffer, "%g", value);
    return buffer;
}

/// "(H, W, 4)" would be nicer, but what axes are called only the documentation knows.
template <typename LengthAt>
std::string shape_text(std::size_t axes, LengthAt length) {
    std::string result = "(";
    for (std::size_t axis = 0; axis < axes; ++axis) {
        const std::size_t own = length(axis);
        result += (axis > 0 ? ", " : "") + (own == ANY ? "*" : std::to_string(own));
    }
    return result + (axes == 1 ? ",)" : ")");
}

bool is_in_c_order(const nb::ndarray<nb::ro>& array) {
    std::int64_t step = 1;
    for (std::size_t axis = array.ndim(); axis-- > 0;) {
        if (array.shape(axis) > 1 && array.stride(axis) != step) {
            return false;
        }
        step *= static_cast<std::int64_t>(array.shape(axis));
    }
    return true;
}

}  // namespace

void refuse_value(const char* name, const std::string& reason) {
    throw nb::value_error((name + (": " + reason)).c_str());
}

void refuse_type(const char* name, const std::string& reason) {
    throw nb::type_error((name + (": " + reason)).c_str());
}

nb::object NamedArguments::take(const char* name) {
    if (!left_.contains(name)) {
        refuse_type(name, "an argument of this name expected");
    }
    nb::object value = left_[name];
    nb::del(left_[name]);
    return value;
}

void NamedArguments::end() const {
    for (const auto [name, value] : left_) {
        refuse_type(text(name).c_str(), "no argument of this name expected");
    }
}

template <typename Element>
ArrayArgument<Element>::ArrayArgument(nb::handle array, const char* name, Shape shape) {
    const bool is_array = nb::ndarray_check(array);
    if (!is_array || !nb::try_cast(array, array_) || array_.dtype() != nb::dtype<Element>()) {
        const bool has_type = is_array && nb::hasattr(array, "dtype");
        refuse_type(name, "an array of " + element_name<Element>() + " expected, got " +
                              (has_type ? text(array.attr("dtype")) : class_name(array)));
    }
    const auto length = [&](std::size_t axis) { return shape.begin()[axis]; };
    const auto given = [&](std::size_t axis) { return array_.shape(axis); };
    bool fits = array_.ndim() == shape.size();
    for (std::size_t axis = 0; fits && axis < shape.size(); ++axis) {
        fits = length(axis) == ANY || given(axis) == length(axis);
    }
    if (!fits) {
        refuse_value(name, "shape " + shape_text(shape.size(), length) + " expected, got " +
                               shape_text(array_.ndim(), given));
    }
    if (array_.size() == 0) {
        return;
    }
    if (!is_in_c_order(array_)) {
        refuse_value(name, "an array in C order expected; np.ascontiguousarray makes one");
    }
    if (reinterpret_cast<std::uintptr_t>(array_.data()) % alignof(Element) != 0) {
        refuse_value(name, "an aligned array expected; a copy is one");
    }
}

template class ArrayArgument<float>;
template class ArrayArgument<double>;
template class ArrayArgument<bool>;
template class ArrayArgument<std::uint8_t>;
template class ArrayArgument<std::int32_t>;
template class ArrayArgument<std::int64_t>;

double finite_number(nb::handle number, const char* name) {
    const double value = PyFloat_AsDouble(number.ptr());
    if (value == -1.0 && PyErr_Occurred()) {
        PyErr_Clear();
        refuse_type(name, "a number expected, got " + class_name(number));
    }
    if (!std::isfinite(value)) {
        refuse_value(name, "a finite number expected, got " + number_text(value));
    }
    return value;
}

double number_between(double least, double most, nb::handle number, const char* name) {
    const double value = finite_number(number, name);
    if (value < least || value > most) {
        const std::string limit =
            value < least ? "at least " + number_text(least) : "at most " + number_text(most);
        refuse_value(name, limit + " expected, got " + number_text(value));
    }
    return value;
}

double positive_number(nb::handle number, const char* name) {
    const double value = finite_number(number, name);
    if (value <= 0.0) {
        refuse_value(name, "a number above 0 expected, got " + number_text(value));
    }
    return value;
}

bool truth(nb::handle value, const char* name) {
    if (!PyBool_Check(value.ptr())) {
        refuse_type(name, "True or False expected, got " + class_name(value));
    }
    return value.is(Py_True);
}

std::size_t integer_between(std::size_t least, std::size_t most, nb::handle number,
                            const char* name) {
    const nb::object integer = nb::steal(PyNumber_Index(number.ptr()));
    if (!integer.is_valid()) {
        PyErr_Clear();
        refuse_type(name, "an integer expected, got " + class_name(number));
    }
    int overflow = 0;
    const long long value = PyLong_AsLongLongAndOverflow(integer.ptr(), &overflow);
    if (overflow != 0 || value < static_cast<long long>(least) ||
        value > static_cast<long long>(most)) {
        refuse_value(name, "an integer from " + std::to_string(least) + " to " +
                               std::to_string(most) + " expected, got " + text(number));
    }
    return static_cast<std::size_t>(value);
}

template <typename Element>
NewArray<Element>::NewArray(std::initializer_list<std::size_t> shape) {
    std::size_t size = 1;
    for (const std::size_t length : shape) {
        size *= length;
    }
    auto* const data = new Element[size]();
    const nb::capsule owner(data,
                            [](void* memory) noexcept { delete[] static_cast<Element*>(memory); });
    array = nb::ndarray<nb::numpy, Element>(data, shape.size(), shape.begin(), owner);
    values = {data, size};
}

template struct NewArray<std::int32_t>;
template struct NewArray<float>;
template struct NewArray<std::uint8_t>;
template struct NewArray<double>;

}  // namespace lfnav
