// incise.Delta: one committed step.
#include <pybind11/stl.h>

#include <algorithm>

#include "server/app/python/arrays.hpp"
#include "server/app/python/module.hpp"
#include "server/core/mesh/field.hpp"

namespace incise::python {
namespace {

using core::Delta;

// A property that is a read-only view of an array of the delta.
template <class Class, class T>
void def_view(Class& type, const char* name, std::vector<T> Delta::*member, const char* doc) {
  type.def_property_readonly(
      name,
      [member](const py::object& self) {
        return view(std::span<const T>(self.cast<const Delta&>().*member), self);
      },
      doc);
}

py::tuple line_of(const core::BladeLine& line) {
  return py::make_tuple(py::make_tuple(line.heel.x, line.heel.y, line.heel.z),
                        py::make_tuple(line.tip.x, line.tip.y, line.tip.z));
}

// The values of a field after a delta, in C order.
template <class T>
py::array carried(const Delta& delta, const py::array& values, bool of_tets) {
  const py::array_t<T, py::array::c_style | py::array::forcecast> given(values);
  std::vector<T> numbers(given.data(), given.data() + given.size());
  std::vector<py::ssize_t> shape(values.shape(), values.shape() + values.ndim());
  std::size_t columns = 1;
  for (std::size_t k = 1; k < shape.size(); ++k) columns *= static_cast<std::size_t>(shape[k]);
  if (columns == 0) throw py::value_error("values: found rows of no numbers; accepted is one or more");
  if (of_tets) {
    core::carry_tets(delta, columns, numbers);
  } else {
    core::carry(delta, columns, numbers);
  }
  shape[0] = static_cast<py::ssize_t>(numbers.size() / columns);
  return owned(std::move(numbers)).attr("reshape")(shape).attr("astype")(values.dtype());
}

py::array carry(const Delta& delta, const py::handle value, bool of_tets) {
  refuse_masked(value, "values");
  const py::array values = py::array::ensure(value);
  const char kind = values ? values.dtype().kind() : '?';
  const bool whole = kind == 'i' || kind == 'u' || kind == 'b';
  if (!whole && kind != 'f')
    throw py::type_error("values: accepted is an array of integers or floating-point numbers");
  const bool fits =
      values.ndim() >= 1 && (of_tets || values.shape(0) == static_cast<py::ssize_t>(delta.first_added));
  if (!fits) {
    throw py::value_error(
        "values: found shape " +
        shape_text(std::vector<py::ssize_t>(values.shape(), values.shape() + values.ndim())) +
        ", accepted is one row for each " +
        (of_tets ? "id of a tetrahedron"
                 : "of the " + std::to_string(delta.first_added) + " vertices before"));
  }
  if (of_tets && !delta.elders.empty()) {
    const core::TetId last = *std::max_element(delta.elders.begin(), delta.elders.end());
    if (values.shape(0) <= static_cast<py::ssize_t>(last)) {
      throw py::value_error("values: found " + std::to_string(values.shape(0)) +
                            " rows; a new tetrahedron has the values of tetrahedron " + std::to_string(last));
    }
  }
  return whole ? carried<std::int64_t>(delta, values, of_tets) : carried<double>(delta, values, of_tets);
}

void add_arrays(py::class_<Delta, std::shared_ptr<Delta>>& type) {
  def_view(type, "moved", &Delta::moved,
           "(n,) uint32: ids of vertices that were there and now lie elsewhere, ascending.");
  def_view(type, "moved_positions", &Delta::moved_positions, "(n, 3) float64, metres: where they are now.");
  def_view(type, "added_positions", &Delta::added_positions,
           "(n, 3) float64, metres: of the new vertices, whose ids are first_added, first_added + 1, ...");
  def_view(type, "provenance", &Delta::provenance,
           "(n,) of (a uint32, b uint32, t float64): the fields of each new vertex are (1 - t) of vertex a + "
           "t of vertex b; these are older, or new with lower ids.");
  def_view(type, "blends", &Delta::blends,
           "(n,) of (vertex uint32, from[4] uint32, weights[4] float64): vertices that stand for other "
           "material now: their "
           "fields are the sum of the weights times those that the vertices `from` had before; ascending. "
           "carry() applies them.");
  def_view(
      type, "moved_rest", &Delta::moved_rest,
      "(n, 3) or empty: rest positions of `moved`, if a cut moved them in a body that is deformed, metres.");
  def_view(type, "added_rest", &Delta::added_rest, "(n, 3) or empty: likewise of the new vertices.");
  def_view(type, "upserted", &Delta::upserted,
           "(n,) of (id, vertices[4], region, cut_mask, boundary_mask): new and changed tetrahedra, ids "
           "ascending. Bit f of a mask "
           "is the face opposite to vertex f: opened by a cut; on the boundary.");
  def_view(type, "removed", &Delta::removed, "(n,) uint32: ids of tetrahedra that are gone, ascending.");
  def_view(
      type, "elders", &Delta::elders,
      "(n,) uint32: of each new tetrahedron (they are the last of `upserted`) one from before the step, in "
      "whose place it is: it has its region, and its fields.");
  def_view(type, "boundary_upserted", &Delta::boundary_upserted,
           "(n,) uint32: boundary faces that are new or changed, as 4 * tetrahedron + face.");
  def_view(type, "boundary_removed", &Delta::boundary_removed, "(n,) uint32: boundary faces that are gone.");
  def_view(type, "pieces", &Delta::pieces,
           "(n,) of (id, tet, tets) uint32: pieces that came off or changed their name: the id, one of the "
           "tetrahedra, and how many "
           "hang together with that. The largest part keeps its id; what was never cut off is piece 0. "
           "Session.pieces() and files have the same ids.");
}

}  // namespace

void add_delta(py::module_& module) {
  PYBIND11_NUMPY_DTYPE(core::Provenance, a, b, t);
  PYBIND11_NUMPY_DTYPE(core::Blend, vertex, from, weights);
  PYBIND11_NUMPY_DTYPE(core::TetState, id, vertices, region, cut_mask, boundary_mask);
  PYBIND11_NUMPY_DTYPE(Delta::Piece, id, tet, tets);
  py::class_<Delta, std::shared_ptr<Delta>> type(module, "Delta",
                                                 R"(One committed step: it takes revision - 1 to revision.

Its arrays are read-only views: nothing is copied, and they stay valid after the session is gone. Ids of vertices and
tetrahedra are never used again. A step is a batch of a stroke, or a deformation (stroke 0).)");
  add_arrays(type);
  const auto number = [&type](const char* name, auto member, const char* doc) {
    type.def_readonly(name, member, doc);
  };
  number("revision", &Delta::revision,
         "int: the number of steps since the body was loaded, this one included.");
  number("source", &Delta::source, "int: which blade.");
  number("stroke", &Delta::stroke, "int: counts the strokes of all blades from 1; 0: the body deformed.");
  number("batch", &Delta::batch, "int: within the stroke, from 1; a long one comes in several deltas.");
  number("stroke_ended", &Delta::stroke_ended, "bool: nothing more of this stroke will come.");
  number("first_added", &Delta::first_added, "int: the id of the first new vertex.");
  number("cut_faces", &Delta::cut_faces, "int: faces laid open, one side of them.");
  number("cut_area", &Delta::cut_area, "float: their area, m^2.");
  number("snaps", &Delta::snaps, "int: vertices that moved onto the cut.");
  number("splits", &Delta::splits, "int: edges that were split.");
  number("min_dihedral_deg", &Delta::min_dihedral_deg,
         "float: the smallest dihedral angle at what changed, degrees.");
  number("max_deviation_h", &Delta::max_deviation_h,
         "float: the largest distance of the new cut faces' vertices from the swept surface, in mean edge "
         "lengths.");
  number("state_hash", &Delta::state_hash,
         "int: of the whole mesh after this step; what incise_client's replicas and captures have for this "
         "revision.");
  type.def_property_readonly(
          "from_line", [](const Delta& delta) { return line_of(delta.from); },
          "((x, y, z), (x, y, z)): heel and tip of the blade where the batch begins, metres.")
      .def_property_readonly(
          "to_line", [](const Delta& delta) { return line_of(delta.to); },
          "((x, y, z), (x, y, z)): where it ends.")
      .def_readonly("from_t_ns", &Delta::from_t_ns, "int: the motion's time there, ns.")
      .def_readonly("to_t_ns", &Delta::to_t_ns, "int: likewise where it ends.")
      .def_property_readonly(
          "held",
          [](const py::object& self) {
            return view(std::span<const core::VertexId>(self.cast<const Delta&>().deformation.held), self);
          },
          "(n,) uint32: of a deformation: vertices that stayed or went half the way, since a tetrahedron "
          "would have inverted "
          "or a blade is at work there.")
      .def(
          "carry", [](const Delta& delta, const py::object& values) { return carry(delta, values, false); },
          py::arg("values"), R"(The values of a field on the vertices after this step.

values: (first_added,) or (first_added, ...), the field before it: a row for each vertex, of any number type. Returns an array of the same
type with rows for the new vertices, too. Numbers with a fraction are interpolated, in double precision; a whole number is
that of the vertex with the largest weight. Raises TypeError for what is no array of numbers, ValueError for another number of rows. O(vertices), for the
copy.)")
      .def(
          "carry_tets",
          [](const Delta& delta, const py::object& values) { return carry(delta, values, true); },
          py::arg("values"), R"(The same for a field on the tetrahedra.

values: a row for each id up to the largest before this step. Returns an array with rows for the new ids: what is new has the values
of its elder. Rows of ids without a tetrahedron are meaningless. Raises TypeError, ValueError. O(ids), for the copy.)")
      .def("__repr__", [](const Delta& delta) {
        return "<incise.Delta revision " + std::to_string(delta.revision) + ": " +
               std::to_string(delta.cut_faces) + " cut faces>";
      });
}

}  // namespace incise::python
