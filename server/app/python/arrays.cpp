#include "server/app/python/arrays.hpp"

#include <cmath>
#include <limits>

#include "server/mesh_io/mesh_error.hpp"

namespace incise::python {
namespace {

std::string type_text(py::handle value) {
  return py::str(py::type::handle_of(value).attr("__name__"));
}

// Any array of the kinds of numbers in `kinds` (NumPy's letters).
py::array array_of(py::handle value, const std::string& name, const char* kinds, const char* accepted) {
  refuse_masked(value, name);
  auto array = py::array::ensure(value);
  if (!array)
    throw py::type_error(name + ": found " + type_text(value) + "; accepted is an array of " + accepted);
  // An empty list is of float64 whatever was meant.
  if (std::string(kinds).find(array.dtype().kind()) == std::string::npos && array.size() > 0) {
    throw py::type_error(name + ": found an array of " + std::string(py::str(array.dtype())) +
                         "; accepted are " + accepted);
  }
  return array;
}

void check_shape(const py::array& array, const std::string& name, const std::vector<py::ssize_t>& shape) {
  bool same = array.ndim() == static_cast<py::ssize_t>(shape.size());
  for (std::size_t i = 0; same && i < shape.size(); ++i) {
    same = shape[i] < 0 || array.shape(static_cast<py::ssize_t>(i)) == shape[i];
  }
  if (same) return;
  const std::vector<py::ssize_t> found(array.shape(), array.shape() + array.ndim());
  throw py::value_error(name + ": found shape " + shape_text(found) + "; accepted is " + shape_text(shape));
}

// Where a number lies: "points[7, 2]".
std::string place(const py::array& array, const std::string& name, py::ssize_t index) {
  std::string text;
  for (py::ssize_t axis = array.ndim(); axis-- > 0;) {
    text = std::to_string(index % array.shape(axis)) + (text.empty() ? "" : ", " + text);
    index /= array.shape(axis);
  }
  return name + "[" + text + "]";
}

}  // namespace

void refuse_masked(py::handle value, const std::string& name) {
  if (!py::hasattr(value, "mask")) return;
  const py::object masks = py::module_::import("numpy").attr("ma");
  if (!masks.attr("is_masked")(value).cast<bool>()) return;
  throw py::value_error(name + ": found an array with " +
                        std::string(py::str(masks.attr("count_masked")(value))) +
                        " masked numbers; accepted are arrays in which all numbers count");
}

std::string shape_text(const std::vector<py::ssize_t>& shape) {
  std::string text;
  for (const py::ssize_t length : shape) {
    text += (text.empty() ? "" : ", ") + (length < 0 ? std::string("n") : std::to_string(length));
  }
  return "(" + text + (shape.size() == 1 ? ",)" : ")");
}

Doubles doubles(py::handle value, const std::string& name, const std::vector<py::ssize_t>& shape) {
  const py::array given = array_of(value, name, "fiu", "real numbers");
  check_shape(given, name, shape);
  auto array = Doubles::ensure(given);
  if (!array) throw py::type_error(name + ": cannot be read as float64");
  for (py::ssize_t i = 0; i < array.size(); ++i) {
    if (!std::isfinite(array.data()[i])) {
      throw py::value_error(place(array, name, i) + " is " + mesh_io::to_text(array.data()[i]) +
                            "; accepted are finite numbers");
    }
  }
  return array;
}

Integers integers(py::handle value, const std::string& name, const std::vector<py::ssize_t>& shape,
                  std::int64_t least, std::int64_t most) {
  const py::array given = array_of(value, name, "iu", "whole numbers");
  check_shape(given, name, shape);
  auto array = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>::ensure(given);
  if (!array) throw py::type_error(name + ": cannot be read as int64");
  const bool is_unsigned = given.dtype().kind() == 'u';
  for (py::ssize_t i = 0; i < array.size(); ++i) {
    const std::int64_t found = array.data()[i];
    // A uint64 beyond int64 has become negative.
    const bool beyond = is_unsigned && found < 0;
    if (!beyond && found >= least && found <= most) continue;
    throw py::value_error(
        place(array, name, i) + " is " +
        (beyond ? std::to_string(static_cast<std::uint64_t>(found)) : std::to_string(found)) +
        "; accepted is " + std::to_string(least) + " to " + std::to_string(most));
  }
  return array;
}

void add_fields(py::handle given, const std::string& name, mesh_io::Field::On on, std::size_t rows,
                std::vector<mesh_io::Field>& fields) {
  if (given.is_none()) return;
  if (!py::isinstance<py::dict>(given))
    throw py::type_error(name + ": found " + type_text(given) + "; accepted is a dict of arrays by name");
  for (const auto& [key, value] : given.cast<py::dict>()) {
    if (!py::isinstance<py::str>(key))
      throw py::type_error(name + ": found a key of the type " + type_text(key) + "; accepted is str");
    const std::string what = name + "[" + std::string(py::repr(key)) + "]";
    mesh_io::Field field{"", on, 1, {}};
    try {
      field.name = key.cast<std::string>();
    } catch (const py::cast_error&) {
      throw py::value_error(what + ": the name cannot be written as UTF-8");
    }
    if (mesh_io::has_control_character(field.name))
      throw py::value_error(what + ": the name has a control character; mesh files cannot have one");
    if (field.name.empty() || field.name.size() > core::kMaxFieldName)
      throw py::value_error(what + ": found a name of " + std::to_string(field.name.size()) +
                            " bytes; accepted are 1 to " + std::to_string(core::kMaxFieldName));
    const py::array array = array_of(value, what, "fiu", "real numbers");
    const bool shaped = array.ndim() == 1 || array.ndim() == 2;
    const py::ssize_t components = array.ndim() == 2 ? array.shape(1) : 1;
    if (!shaped || array.shape(0) != static_cast<py::ssize_t>(rows) || components < 1 ||
        components > static_cast<py::ssize_t>(core::kMaxFieldComponents)) {
      throw py::value_error(
          what + ": found shape " +
          shape_text(std::vector<py::ssize_t>(array.shape(), array.shape() + array.ndim())) +
          "; accepted is (" + std::to_string(rows) + ",) or (" + std::to_string(rows) + ", k) with 1 to " +
          std::to_string(core::kMaxFieldComponents) + " components");
    }
    field.components = static_cast<std::size_t>(components);
    if (array.dtype().kind() == 'f') {
      const py::array_t<double, py::array::c_style | py::array::forcecast> numbers(array);
      auto& values = field.values.emplace<std::vector<float>>();
      for (py::ssize_t i = 0; i < numbers.size(); ++i) {
        const double wide = numbers.data()[i];
        if (std::isfinite(wide) && std::abs(wide) > std::numeric_limits<float>::max())
          throw py::value_error(place(numbers, what, i) + " is " + mesh_io::to_text(wide) +
                                "; accepted are numbers that a float32 can hold");
        values.push_back(static_cast<float>(wide));
      }
    } else {
      using Limits = std::numeric_limits<std::int32_t>;
      const std::vector<py::ssize_t> shape(array.shape(), array.shape() + array.ndim());
      const Integers numbers = integers(array, what, shape, Limits::min(), Limits::max());
      auto& values = field.values.emplace<std::vector<std::int32_t>>();
      for (py::ssize_t i = 0; i < numbers.size(); ++i)
        values.push_back(static_cast<std::int32_t>(numbers.data()[i]));
    }
    fields.push_back(std::move(field));
  }
}

py::dict dict_of(std::span<const mesh_io::Field> fields, mesh_io::Field::On on) {
  py::dict out;
  for (const mesh_io::Field& field : fields) {
    if (field.on != on) continue;
    py::object values = std::visit([](const auto& v) -> py::object { return owned(v); }, field.values);
    if (field.components > 1) values = values.attr("reshape")(field.rows(), field.components);
    out[py::str(field.name)] = values;
  }
  return out;
}

std::vector<core::Vec3> points(py::handle value, const std::string& name) {
  const Doubles array = doubles(value, name, {-1, 3});
  const double* const data = array.data();
  std::vector<core::Vec3> out(static_cast<std::size_t>(array.shape(0)));
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = {data[3 * i], data[3 * i + 1], data[3 * i + 2]};
  return out;
}

core::Vec3 point(py::handle value, const std::string& name) {
  const Doubles array = doubles(value, name, {3});
  return {array.data()[0], array.data()[1], array.data()[2]};
}

py::array view(std::span<const core::Vec3> points, const py::object& owner) {
  static_assert(sizeof(core::Vec3) == 3 * sizeof(double));
  py::array array(py::dtype::of<double>(), {points.size(), std::size_t{3}},
                  {sizeof(core::Vec3), sizeof(double)}, points.data(), owner);
  py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}

py::array owned(std::vector<core::Vec3> points) {
  auto* const kept = new std::vector<core::Vec3>(std::move(points));
  const py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<core::Vec3>*>(p); });
  return py::array(py::dtype::of<double>(), {kept->size(), std::size_t{3}},
                   {sizeof(core::Vec3), sizeof(double)}, kept->data(), owner);
}

}  // namespace incise::python
