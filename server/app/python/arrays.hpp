#pragma once

// NumPy arrays in and out of the module `incise`.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "server/core/geometry/vec3.hpp"
#include "server/mesh_io/field.hpp"

namespace incise::python {

namespace py = pybind11;

// Arrays that a caller gives: copied to C order. `name` is the argument in messages, `shape` what is accepted, -1 for any
// length. Throws TypeError for what is no array of numbers, ValueError for another shape or numbers that are not finite.
using Doubles = py::array_t<double, py::array::c_style>;
using Integers = py::array_t<std::int64_t, py::array::c_style>;
Doubles doubles(py::handle value, const std::string& name, const std::vector<py::ssize_t>& shape);
// Whole numbers from `least` to `most`; booleans and floating-point numbers are refused.
Integers integers(py::handle value, const std::string& name, const std::vector<py::ssize_t>& shape,
                  std::int64_t least, std::int64_t most);
// (n, 3).
std::vector<core::Vec3> points(py::handle value, const std::string& name);
// One point of three numbers.
core::Vec3 point(py::handle value, const std::string& name);

// Throws ValueError for a masked array with masked numbers: what is behind a mask is no number that the caller means.
void refuse_masked(py::handle value, const std::string& name);

// A field for each name of a dict, or of None: (rows,) or (rows, components) numbers. Whole numbers become int32, others float32, which
// may be NaN. Throws TypeError or ValueError.
void add_fields(py::handle given, const std::string& name, mesh_io::Field::On on, std::size_t rows,
                std::vector<mesh_io::Field>& fields);
// The fields on one of the two, by name: new arrays.
py::dict dict_of(std::span<const mesh_io::Field> fields, mesh_io::Field::On on);

// "(3, 2)"
std::string shape_text(const std::vector<py::ssize_t>& shape);

// A read-only view of values that `owner` keeps alive and never changes; nothing is copied.
template <class T>
py::array view(std::span<const T> values, const py::object& owner) {
  py::array array(py::dtype::of<T>(), {values.size()}, {sizeof(T)}, values.data(), owner);
  py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}
// The same as (n, 3) numbers.
py::array view(std::span<const core::Vec3> points, const py::object& owner);

// An array that takes the values over.
template <class T>
py::array owned(std::vector<T> values) {
  auto* const kept = new std::vector<T>(std::move(values));
  const py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return py::array(py::dtype::of<T>(), {kept->size()}, {sizeof(T)}, kept->data(), owner);
}
py::array owned(std::vector<core::Vec3> points);

}  // namespace incise::python
