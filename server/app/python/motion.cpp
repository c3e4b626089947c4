// incise.Motion: a recorded motion of a tool.
#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <utility>

#include "server/app/offline/open_capture.hpp"
#include "server/app/python/arrays.hpp"
#include "server/app/python/module.hpp"

namespace incise::python {
namespace {

using app::MotionEvent;
using app::RecordedMotion;

// What text motions accept, too (protocol/motion.cpp).
constexpr double kQuaternionTolerance = 0.1;
constexpr double kMaxSeconds = 9e9;
// How much the lengths of lines may differ, as a share: a blade is rigid.
constexpr double kLengthTolerance = 1e-6;
// Between lines without times: within the default limit of a gap, and long enough for 0.4 m at the default speed limit.
constexpr std::int64_t kBetweenLines_ns = 200'000'000;

std::int64_t nanoseconds(double seconds, const std::string& where) {
  if (std::abs(seconds) > kMaxSeconds)
    throw py::value_error(where + " is " + std::to_string(seconds) + " s; accepted is -9e9 to 9e9");
  return std::llround(seconds * 1e9);
}

void append(RecordedMotion& motion, const core::Pose& pose, const std::string& where) {
  if (!motion.events.empty() && motion.events.back().kind == MotionEvent::Kind::kPose &&
      pose.t_ns <= motion.events.back().pose.t_ns) {
    throw py::value_error(where + ": time " + protocol::seconds_text(pose.t_ns) + " after " +
                          protocol::seconds_text(motion.events.back().pose.t_ns) +
                          ", accepted are rising times");
  }
  motion.events.push_back({MotionEvent::Kind::kPose, 0, pose, pose.t_ns});
}

core::Quat unit(const core::Quat& q, const std::string& where) {
  const double length = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  if (!(std::abs(length - 1) <= kQuaternionTolerance)) {
    throw py::value_error(where + ": quaternion of length " + std::to_string(length) +
                          ", accepted are 0.9 to 1.1");
  }
  return {q.w / length, q.x / length, q.y / length, q.z / length};
}

Motion from_poses(const py::object& given, const py::object& given_buttons, const std::string& name) {
  auto motion = std::make_shared<RecordedMotion>();
  motion->format = "array";
  const py::array array = py::array::ensure(given);
  if (array && (array.ndim() != 2 || (array.shape(1) != 4 && array.shape(1) != 8))) {
    throw py::value_error(name + ": found shape " +
                          shape_text(std::vector<py::ssize_t>(array.shape(), array.shape() + array.ndim())) +
                          "; accepted is (n, 8) or (n, 4)");
  }
  const bool positions_only = array && array.shape(1) == 4;
  const Doubles poses = doubles(given, name, {-1, positions_only ? 4 : 8});
  motion->has_orientation = !positions_only;
  motion->has_buttons = !given_buttons.is_none();
  const auto columns = static_cast<std::size_t>(poses.shape(1));
  const auto n = static_cast<std::size_t>(poses.shape(0));
  Integers buttons;
  if (motion->has_buttons)
    buttons =
        integers(given_buttons, "buttons", {poses.shape(0)}, 0, std::numeric_limits<std::uint32_t>::max());
  for (std::size_t i = 0; i < n; ++i) {
    const double* const row = poses.data() + columns * i;
    const std::string where = name + "[" + std::to_string(i) + "]";
    core::Pose pose{nanoseconds(row[0], where), {row[1], row[2], row[3]}, {}, 0};
    if (columns == 8) pose.orientation = unit({row[7], row[4], row[5], row[6]}, where);
    if (motion->has_buttons) pose.buttons = static_cast<std::uint32_t>(buttons.data()[i]);
    append(*motion, pose, where);
  }
  return {name, std::move(motion)};
}

// The shortest turn that takes one unit vector to another; about any axis if they are opposite.
core::Quat turn(const core::Vec3& from, const core::Vec3& to) {
  const double cosine = core::dot(from, to);
  if (cosine < -1 + 1e-12) {
    const core::Vec3 other = std::abs(from.x) < 0.5 ? core::Vec3{1, 0, 0} : core::Vec3{0, 1, 0};
    const core::Vec3 axis = core::normalized(core::cross(from, other));
    return {0, axis.x, axis.y, axis.z};
  }
  const core::Vec3 axis = core::cross(from, to);
  const double w = 1 + cosine;
  const double length = std::sqrt(w * w + core::squared_length(axis));
  return {w / length, axis.x / length, axis.y / length, axis.z / length};
}

// The tool's origin is the heel, and the blade points along its -z.
Motion from_lines(const py::object& given, const py::object& given_t, const std::string& name) {
  const Doubles lines = doubles(given, "lines", {-1, 2, 3});
  const auto n = static_cast<std::size_t>(lines.shape(0));
  Doubles times;
  if (!given_t.is_none()) times = doubles(given_t, "t", {lines.shape(0)});
  auto motion = std::make_shared<RecordedMotion>();
  motion->format = "array";
  motion->has_buttons = false;
  double length = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double* const d = lines.data() + 6 * i;
    const core::Vec3 heel{d[0], d[1], d[2]}, tip{d[3], d[4], d[5]};
    const std::string where = "lines[" + std::to_string(i) + "]";
    const double here = core::distance(heel, tip);
    if (i == 0) {
      length = here;
      if (!(length > 0)) throw py::value_error(where + ": heel and tip are the same point");
      motion->events.push_back({MotionEvent::Kind::kOpened, 0, {}, 0, core::Blade{{}, {0, 0, -length}}});
    }
    if (!(std::abs(here - length) <= kLengthTolerance * length)) {
      throw py::value_error(where + " is " + std::to_string(here) + " m long, lines[0] " +
                            std::to_string(length) + "; accepted are lines of one length: a blade is rigid");
    }
    const std::int64_t t_ns = given_t.is_none()
                                  ? static_cast<std::int64_t>(i) * kBetweenLines_ns
                                  : nanoseconds(times.data()[i], "t[" + std::to_string(i) + "]");
    append(*motion, {t_ns, heel, turn({0, 0, -1}, core::normalized(tip - heel)), 0}, where);
  }
  return {name, std::move(motion)};
}

Motion load(const std::filesystem::path& path, bool strict) {
  const py::gil_scoped_release release;
  auto motion = std::make_shared<RecordedMotion>(
      app::read_recorded_motion(path, strict ? protocol::Times::kRefuse : protocol::Times::kSkip));
  app::warn_if_not_closed(*motion, path.string());
  return {path.string(), std::move(motion)};
}

template <class T, class Read>
std::vector<T> of_poses(const Motion& motion, const Read& read) {
  std::vector<T> all;
  for (const MotionEvent& event : motion.recorded->events) {
    if (event.kind == MotionEvent::Kind::kPose) all.push_back(read(event));
  }
  return all;
}

py::array poses_of(const Motion& motion) {
  const auto rows = of_poses<std::array<double, 8>>(motion, [](const MotionEvent& event) {
    const auto& [t_ns, p, q, buttons] = event.pose;
    return std::array<double, 8>{static_cast<double>(t_ns) * 1e-9, p.x, p.y, p.z, q.x, q.y, q.z, q.w};
  });
  py::array_t<double> array({rows.size(), std::size_t{8}});
  for (std::size_t i = 0; i < rows.size(); ++i)
    std::copy(rows[i].begin(), rows[i].end(), array.mutable_data(static_cast<py::ssize_t>(i), 0));
  return array;
}

}  // namespace

std::shared_ptr<const Motion> motion_from(const py::object& value, bool strict) {
  if (py::isinstance<Motion>(value)) return value.cast<std::shared_ptr<Motion>>();
  if (is_path(value)) return std::make_shared<const Motion>(load(path_from(value, "poses"), strict));
  return std::make_shared<const Motion>(from_poses(value, py::none(), "poses"));
}

void add_motion(py::module_& module) {
  py::class_<Motion, std::shared_ptr<Motion>>(module, "Motion",
                                              R"(Motion(poses, *, buttons=None, name="poses")

A motion of a tool: world_from_tool at moments of its own clock. Immutable.

poses: (n, 8) real numbers: t, x, y, z, qx, qy, qz, qw, the columns of a TUM trajectory: seconds, rising; metres; a unit
quaternion (off by 10 % at most; it is normalised). Or (n, 4): t, x, y, z, and the tool does not turn. buttons: (n,) whole
numbers, bit i: button i is held. Without buttons the blade cuts throughout.

Raises TypeError or ValueError for another shape or type, NaN, infinities, and times that do not rise.)")
      .def(py::init(&from_poses), py::arg("poses"), py::kw_only(), py::arg("buttons") = py::none(),
           py::arg("name") = "poses")
      .def_static("lines", &from_lines, py::arg("lines"), py::arg("t") = py::none(), py::kw_only(),
                  py::arg("name") = "lines", R"(lines(lines, t=None, *, name="lines") -> Motion

The motion of a blade's edge: lines is (n, 2, 3), heel and tip in the world, metres, all of one length (to a millionth): the
motion brings its own blade. t: (n,) seconds, rising; default: 0.2 s apart. Raises as Motion().)")
      .def_static(
          "load", [](const py::object& path, bool strict) { return load(path_from(path, "path"), strict); },
          py::arg("path"), py::arg("strict") = false, R"(load(path, strict=False) -> Motion

Reads what `incise cut --poses` reads: a TUM trajectory, CSV with a header (t_s, x_m, y_m, z_m, qw, qx, qy, qz, button), or a
capture of incised. strict: refuse times that do not rise instead of skipping poses. Raises MotionError or Error.)")
      .def_property_readonly(
          "name", [](const Motion& motion) { return motion.name; }, "str: the file as given.")
      .def_property_readonly("poses", &poses_of, "(n, 8) float64: t, x, y, z, qx, qy, qz, qw; a copy.")
      .def_property_readonly(
          "buttons",
          [](const Motion& motion) {
            return owned(
                of_poses<std::uint32_t>(motion, [](const MotionEvent& e) { return e.pose.buttons; }));
          },
          "(n,) uint32: the buttons that are held at each pose.")
      .def_property_readonly(
          "sources",
          [](const Motion& motion) {
            return owned(of_poses<std::uint32_t>(motion, [](const MotionEvent& e) { return e.source; }));
          },
          "(n,) uint32: which blade each pose is of; a capture can have several.")
      .def_property_readonly(
          "warnings", [](const Motion& motion) { return motion.recorded->warnings; },
          "list of str: what was skipped or is missing.")
      .def("__len__", [](const Motion& motion) { return motion.recorded->poses(); })
      .def("__repr__", [](const Motion& motion) {
        return "<incise.Motion " + motion.name + ": " + std::to_string(motion.recorded->poses()) + " poses>";
      });
}

}  // namespace incise::python
