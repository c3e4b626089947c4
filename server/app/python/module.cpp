#include "server/app/python/module.hpp"

#include <pybind11/numpy.h>

#include "protocol/motion.hpp"
#include "server/app/config/config_key.hpp"
#include "server/app/python/arrays.hpp"
#include "server/app/version.hpp"
#include "server/mesh_io/mesh_error.hpp"

namespace incise::python {
namespace {

void set_key(app::Config& config, const std::string& key, const py::object& value) {
  if (value.is_none()) return;
  if (!py::isinstance<py::str>(value)) {
    throw py::type_error(key + ": found " + std::string(py::repr(value)) + "; accepted is a str");
  }
  for (const app::ConfigKey& row : app::config_keys()) {
    if (row.name != key) continue;
    const auto word = value.cast<std::string>();
    if (!row.set(config, word)) app::refuse("config", key, "\"" + word + "\"", row.accepted);
  }
}

}  // namespace

bool is_path(const py::object& value) {
  return py::isinstance<py::str>(value) || py::hasattr(value, "__fspath__");
}

std::filesystem::path path_from(const py::object& value, const std::string& name) {
  if (!is_path(value)) {
    throw py::type_error(name + ": found " + std::string(py::repr(py::type::of(value))) +
                         "; accepted is a path: str or os.PathLike");
  }
  const py::module_ os = py::module_::import("os");
  const py::object text = os.attr("fspath")(value);
  if (!py::isinstance<py::str>(text)) throw py::type_error(name + ": found a path of bytes; accepted is str");
  const auto bytes = os.attr("fsencode")(text).cast<std::string>();
  if (bytes.find('\0') != std::string::npos)
    throw py::value_error(name + ": found " + std::string(py::repr(text)) +
                          "; accepted is a path without \"\\0\", at which the system would end it");
  return bytes;
}

app::Config config_from(const py::object& value) {
  if (value.is_none()) return {};
  if (is_path(value)) return app::load_config(path_from(value, "config"));
  if (!py::isinstance<py::dict>(value)) {
    throw py::type_error("config: found " + std::string(py::repr(py::type::of(value))) +
                         "; accepted is a dict or a path");
  }
  const py::str text = py::module_::import("json").attr("dumps")(value);
  return app::parse_config(std::string(text), "config");
}

std::optional<core::Blade> choose(app::Config& config, const Choices& choices) {
  set_key(config, "cut.policy", choices.policy);
  set_key(config, "cut.prefer", choices.prefer);
  if (choices.blade.is_none()) return std::nullopt;
  const Doubles ends = doubles(choices.blade, "blade", {2, 3});
  const double* const d = ends.data();
  const core::Blade blade{{d[0], d[1], d[2]}, {d[3], d[4], d[5]}};
  if (blade.heel == blade.tip) throw py::value_error("blade: heel and tip are the same point");
  if (core::length(blade.heel) > core::kFarthest_m || core::length(blade.tip) > core::kFarthest_m)
    throw py::value_error("blade: an end is farther than 10000 m from the tool");
  config.cut.blade = blade;
  return blade;
}

void warn(const std::string& text) {
  if (!text.empty() && PyErr_WarnEx(PyExc_UserWarning, text.c_str(), 1) != 0) throw py::error_already_set();
}

void add_errors(py::module_& module) {
  // The text is what the command line prints after "incise: ".
  static const py::exception<std::runtime_error> error(module, "Error", PyExc_Exception);
  static const py::exception<mesh_io::MeshError> mesh_error(module, "MeshError", error);
  static const py::exception<app::ConfigError> config_error(module, "ConfigError", error);
  static const py::exception<protocol::MotionError> motion_error(module, "MotionError", error);
  py::register_local_exception_translator([](std::exception_ptr thrown) {
    const auto set = [](const py::handle& type, const std::exception& e) {
      PyErr_SetString(type.ptr(), e.what());
    };
    try {
      if (thrown) std::rethrow_exception(thrown);
    } catch (const py::builtin_exception&) {
      throw;
    } catch (const mesh_io::MeshError& e) {
      set(mesh_error, e);
    } catch (const core::MeshError& e) {
      set(mesh_error, e);
    } catch (const app::ConfigError& e) {
      set(config_error, e);
    } catch (const protocol::MotionError& e) {
      set(motion_error, e);
    } catch (const std::runtime_error& e) {
      set(error, e);
    }
  });
}

}  // namespace incise::python

PYBIND11_MODULE(_core, module) {
  using namespace incise::python;
  py::options options;
  options.disable_function_signatures();
  module.doc() = "The cut core of Incise; use the package incise.";
  module.attr("__version__") = incise::app::kVersion;
  add_errors(module);
  add_body(module);
  add_motion(module);
  add_delta(module);
  add_session(module);
}
