#pragma once

// The extension module incise._core, in parts. client/python/incise is the package around it, and its _core.pyi has
// the types.

#include <pybind11/pybind11.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "server/app/config.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/python/made.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::python {

namespace py = pybind11;

// A mesh that can be cut. Immutable.
struct Body {
  std::string name;  // in messages: the file as given
  std::shared_ptr<const mesh_io::LoadedMesh> loaded;
};

// A motion of a tool. Immutable.
struct Motion {
  std::string name;
  std::shared_ptr<const app::RecordedMotion> recorded;
};

// Text for std::filesystem::path, of str or os.PathLike. Throws TypeError naming the argument.
std::filesystem::path path_from(const py::object& value, const std::string& name);
bool is_path(const py::object& value);

// None: the defaults; a dict: the file's content; a path: a file.
app::Config config_from(const py::object& value);
struct Choices {
  py::object blade, policy, prefer;  // None: as configured
};
// Sets what is given. Returns the blade.
std::optional<core::Blade> choose(app::Config& config, const Choices& choices);

// A Body, or the path of one.
std::shared_ptr<const Body> body_from(const py::object& value, const app::Config& config);
// A Motion, the path of one, or an array of poses. `strict` counts for a path.
std::shared_ptr<const Motion> motion_from(const py::object& value, bool strict);

// A UserWarning; nothing where there is no text. Throws what a program has made of such warnings.
void warn(const std::string& text);

void add_errors(py::module_& module);
void add_body(py::module_& module);
void add_motion(py::module_& module);
void add_delta(py::module_& module);
void add_session(py::module_& module);

}  // namespace incise::python
