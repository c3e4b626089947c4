// incise.Session, incise.Cut and incise.cut().
#include "server/app/python/session.hpp"

#include <pybind11/stl.h>

#include <algorithm>
#include <array>

#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/cut_surface.hpp"
#include "server/app/offline/motion_run.hpp"
#include "server/app/python/arrays.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/session/piece_numbers.hpp"

namespace incise::python {
namespace {

using mesh_io::Field;

// A face of the boundary.
struct Face {
  core::TetId tet;
  std::array<core::VertexId, 3> vertices;
  bool cut;
};

std::shared_ptr<Session> make_session(const py::object& body, const py::object& config,
                                      const Choices& choices, bool forces) {
  auto session = std::make_shared<Session>();
  session->config = config_from(config);
  if (const auto blade = choose(session->config, choices)) session->config.sources.clear();
  session->body = body_from(body, session->config);
  const py::gil_scoped_release release;
  const core::MeshData& mesh = session->body->loaded->mesh;
  session->blade_fault =
      app::blade_fault(session->config.cut.blade, session->config, app::box_of(mesh).diagonal());
  session->core =
      std::make_unique<core::CutSession>(mesh, session->config.cut, session->body->loaded->fields);
  if (forces) session->forces = std::make_unique<ForceTrace>(session->config, mesh);
  return session;
}

// Runs `work` on the core without the GIL.
template <class Work>
auto with_core(Session& session, const Work& work) {
  const Use use(session);
  const py::gil_scoped_release release;
  return work(use.core());
}

std::uint32_t checked_source(std::int64_t source) {
  if (source >= 0 && source < static_cast<std::int64_t>(core::kMaxSources))
    return static_cast<std::uint32_t>(source);
  throw py::value_error("source: found " + std::to_string(source) + "; accepted is 0 to " +
                        std::to_string(core::kMaxSources - 1));
}

std::string push(Session& session, const py::object& given, std::uint32_t buttons, std::int64_t source) {
  const Doubles row = doubles(given, "pose", {8});
  const double* const d = row.data();
  if (!(std::abs(d[0]) <= 9e9)) throw py::value_error("pose: t is beyond 9e9 s");
  const core::Pose pose{std::llround(d[0] * 1e9), {d[1], d[2], d[3]}, {d[7], d[4], d[5], d[6]}, buttons};
  const std::uint32_t number = checked_source(source);
  if (!session.blade_fault.empty()) throw std::runtime_error("the blade " + session.blade_fault);
  return with_core(session, [&](core::CutSession& core) -> std::string {
    const core::PoseVerdict verdict = core.push(number, pose);
    if (session.forces)
      session.forces->event(session.config, {app::MotionEvent::Kind::kPose, number, pose, pose.t_ns});
    return app::explained(verdict);
  });
}

std::shared_ptr<core::Delta> advance(Session& session) {
  return with_core(session, [&](core::CutSession& core) -> std::shared_ptr<core::Delta> {
    auto delta = std::make_shared<core::Delta>();
    core::WorkBudget budget = core::WorkBudget::unlimited();
    if (core.advance(budget, *delta) != core::CutSession::Progress::kCommitted) return nullptr;
    if (session.forces) session.forces->commit(core, *delta);
    return delta;
  });
}

std::vector<std::shared_ptr<core::Delta>> deform(Session& session, const py::object& given_positions,
                                                 const py::object& given_ids) {
  auto positions = std::make_shared<core::VertexPositions>();
  positions->positions = points(given_positions, "positions");
  const auto n = static_cast<py::ssize_t>(positions->positions.size());
  std::vector<std::shared_ptr<core::Delta>> deltas;
  {
    const Use use(session);
    const auto slots = static_cast<std::int64_t>(use.core().mesh().vertex_slots());
    positions->revision = use.core().revision();
    if (given_ids.is_none()) {
      if (n != slots) {
        throw py::value_error("positions: found " + std::to_string(n) + " rows; accepted are " +
                              std::to_string(slots) + ", one for each vertex id, or ids");
      }
    } else {
      const Integers ids = integers(given_ids, "ids", {n}, 0, slots - 1);
      for (py::ssize_t i = 0; i < n; ++i) {
        if (i > 0 && ids.data()[i] <= ids.data()[i - 1])
          throw py::value_error("ids[" + std::to_string(i) +
                                "] is not above the one before; accepted are ascending ids");
        positions->ids.push_back(static_cast<core::VertexId>(ids.data()[i]));
      }
    }
    if (n == 0) return deltas;
    use.core().deform(std::move(positions));
  }
  while (auto delta = advance(session)) deltas.push_back(std::move(delta));
  return deltas;
}

py::array positions_of(Session& session, bool rest) {
  return owned(with_core(session, [rest](const core::CutSession& core) {
    const core::TetMesh& mesh = core.mesh();
    std::vector<core::Vec3> all(mesh.vertex_slots());
    for (core::VertexId v = 0; v < all.size(); ++v) all[v] = rest ? mesh.rest_position(v) : mesh.position(v);
    return all;
  }));
}

// Calls `each` for every living tetrahedron, by id.
template <class Each>
void for_each_tet(const core::TetMesh& mesh, const Each& each) {
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t)) each(t);
  }
}

py::array tets_of(Session& session) {
  return owned(with_core(session, [](const core::CutSession& core) {
    std::vector<core::TetState> all;
    const core::TetMesh& mesh = core.mesh();
    all.reserve(mesh.live_tets());
    for_each_tet(mesh, [&](core::TetId t) {
      all.push_back({t, mesh.vertices(t), mesh.region(t), mesh.cut_mask(t), mesh.boundary_mask(t)});
    });
    return all;
  }));
}

// Copies, a row for each id of a vertex, or for each row of tets().
py::dict fields_of(Session& session, Field::On on) {
  std::vector<Field> fields;
  with_core(session, [&](const core::CutSession& core) {
    std::vector<std::uint32_t> living;
    for_each_tet(core.mesh(), [&](core::TetId t) { living.push_back(t); });
    for (const Field& field : core.fields().all()) {
      if (field.on == on) fields.push_back(on == Field::On::kVertices ? field : core::rows_of(field, living));
    }
  });
  return dict_of(fields, on);
}

py::array pieces_of(Session& session) {
  return owned(with_core(session, [](const core::CutSession& core) {
    const std::vector<std::uint32_t> numbers = core::piece_numbers(core);
    std::vector<std::uint32_t> all;
    all.reserve(core.mesh().live_tets());
    for_each_tet(core.mesh(), [&](core::TetId t) { all.push_back(numbers[t]); });
    return all;
  }));
}

py::array faces_of(Session& session) {
  return owned(with_core(session, [](const core::CutSession& core) {
    std::vector<Face> all;
    const core::TetMesh& mesh = core.mesh();
    for_each_tet(mesh, [&](core::TetId t) {
      for (int f = 0; f < 4; ++f) {
        if ((mesh.boundary_mask(t) >> f & 1u) == 0) continue;
        all.push_back({t, mesh.face_vertices(core::half_face(t, f)), (mesh.cut_mask(t) >> f & 1u) != 0});
      }
    });
    return all;
  }));
}

const mesh_io::Surface& surface_of(const Session& session) {
  const auto& surface = session.body->loaded->surface;
  if (!surface) throw py::value_error(session.body->name + ": was not filled from a surface");
  return *surface;
}

py::array origins_of(Session& session) {
  const mesh_io::Surface& from = surface_of(session);
  auto origins =
      with_core(session, [&](const core::CutSession& core) { return app::face_origins(core.mesh(), from); });
  py::array_t<std::uint32_t> out({origins.size(), std::size_t{4}});
  for (std::size_t i = 0; i < origins.size(); ++i)
    std::copy(origins[i].begin(), origins[i].end(), out.mutable_data(static_cast<py::ssize_t>(i), 0));
  return out;
}

py::array corner_uvs_of(Session& session) {
  const mesh_io::Surface& from = surface_of(session);
  auto uvs =
      with_core(session, [&](const core::CutSession& core) { return app::face_uvs(core.mesh(), from); });
  py::array_t<float> out({uvs.size(), std::size_t{3}, std::size_t{2}});
  for (std::size_t i = 0; i < uvs.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k)
      std::copy(uvs[i][k].begin(), uvs[i][k].end(),
                out.mutable_data(static_cast<py::ssize_t>(i), static_cast<py::ssize_t>(k), 0));
  }
  return out;
}

py::dict measure(Session& session) {
  const core::CutReport report =
      with_core(session, [](const core::CutSession& core) { return core::measure(core.mesh()); });
  py::dict out;
  out["vertices"] = report.vertices;
  out["tets"] = report.tets;
  out["pieces"] = report.pieces;
  out["islands"] = report.islands;
  out["largest_piece"] = report.largest_piece;
  out["boundary_faces"] = report.boundary_faces;
  out["cut_faces"] = report.cut_faces;
  out["cut_area"] = report.cut_area;
  out["volume"] = report.volume;
  out["inverted"] = report.inverted;
  out["min_dihedral_deg"] = report.min_dihedral_deg;
  return out;
}

void save(Session& session, const py::object& given) {
  const auto path = path_from(given, "path");
  app::require_mesh_output(path, "path");
  warn(with_core(session, [&](const core::CutSession& core) {
    app::write_cut_mesh(path, core, session.body->loaded->surface.get());
    return app::fields_left_out(path, core.fields().all());
  }));
}

Body current_body(Session& session) {
  auto loaded = std::make_shared<mesh_io::LoadedMesh>();
  with_core(session, [&](const core::CutSession& core) {
    loaded->mesh = core.export_data();
    loaded->fields = app::saved_fields(core);
    loaded->hash();
  });
  return {session.body->name + " (cut)", std::move(loaded)};
}

void add_methods(py::class_<Session, std::shared_ptr<Session>>& type) {
  type.def(
          "cut",
          [](const std::shared_ptr<Session>& self, const py::object& motion, bool deltas) {
            return cut_session(self, *motion_from(motion, false), deltas);
          },
          py::arg("motion"), py::kw_only(), py::arg("deltas") = true, R"(cut(motion, *, deltas=True) -> Cut

Cuts by a motion (a Motion, the path of one, or an array as Motion takes it), then ends its strokes. Each call begins with a
clock of its own, so times may begin at 0 again. As in a server, a step faster than cut.speed_limit_m_s or longer
than cut.gap_limit_s in the configuration begins a new stroke, and Cut.warnings says so. Ctrl-C ends it between two batches.)")
      .def("push", &push, py::arg("pose"), py::arg("buttons") = 1, py::arg("source") = 0,
           R"(push(pose, buttons=1, source=0) -> str

Takes one pose: t, x, y, z, qx, qy, qz, qw (seconds, metres, unit quaternion) of a blade (source 0 to 7). Returns "accepted", or
why a new stroke began or the pose was rejected ("not finite or more than 10 km from the origin", "time not increasing"). Times
rise from one pose to the next; after cut() they may start at 0 again. Nothing is cut before advance().)")
      .def(
          "end_stroke",
          [](Session& self, std::int64_t source) {
            const std::uint32_t number = checked_source(source);
            with_core(self, [number](core::CutSession& core) { core.end_stroke(number); });
          },
          py::arg("source") = 0, R"(end_stroke(source=0)

Ends the stroke of a blade, so that its last part is cut. No effect between strokes.)")
      .def("advance", &advance, R"(advance() -> Delta or None

Cuts the oldest batch that waits. None: there is none; more poses or end_stroke() are needed.)")
      .def("deform", &deform, py::arg("positions"), py::arg("ids") = py::none(),
           R"(deform(positions, ids=None) -> list of Delta

Moves vertices, as a simulation does; the next cut is made there. positions: (n, 3) real numbers, metres, for every vertex id
(n = len(session.positions())), or for `ids`: (n,) whole numbers, ascending. The mesh stays valid: vertices that would invert a
tetrahedron go half the way or stay (Delta.held). Batches that wait are cut first; the last delta is the deformation. save() and
current_body() give the shape as deformed.)");
}

void add_state(py::class_<Session, std::shared_ptr<Session>>& type) {
  type.def(
          "positions", [](Session& self) { return positions_of(self, false); },
          "positions() -> (n, 3) float64, metres; row i is vertex id i. A copy. Ids that no tetrahedron uses "
          "any more keep a row.")
      .def(
          "rest_positions", [](Session& self) { return positions_of(self, true); },
          "rest_positions() -> (n, 3) float64, metres: where the material is in the body at rest.")
      .def(
          "vertex_fields", [](Session& self) { return fields_of(self, Field::On::kVertices); },
          "vertex_fields() -> dict of str to (n,) or (n, components) float32 or int32: the body's vertex "
          "fields in "
          "the material as it is cut; row i is vertex id i. Copies.")
      .def(
          "tet_fields", [](Session& self) { return fields_of(self, Field::On::kTets); },
          "tet_fields() -> dict likewise: the tetrahedron fields, a row for each row of tets(). Copies.")
      .def("tets", &tets_of,
           "tets() -> (m,) of (id, vertices[4], region, cut_mask, boundary_mask), as Delta.upserted: all "
           "tetrahedra by id. "
           "tets()[\"vertices\"] is (m, 4).")
      .def("pieces", &pieces_of,
           "pieces() -> (m,) uint32: the piece of each row of tets(), a number for each part that hangs "
           "together, as in what save() writes: "
           "the id that Delta.pieces names, 0 for what was never cut off. Of the parts that the body came "
           "with, which are all piece 0 until a cut "
           "touches them, the largest is 0 and the others are numbered behind the highest id, so theirs may "
           "change with a cut. O(mesh).")
      .def("faces", &faces_of,
           "faces() -> (k,) of (tet, vertices[3], cut): the boundary, outward; cut: a cut opened the face.")
      .def("origins", &origins_of,
           "origins() -> (m, 4) uint32: for each row of tets(), the triangle of the surface that the body "
           "was filled from "
           "(as in its file, from 0) in which the face opposite to vertex f lies; 4294967295: none, as a cut "
           "face. Raises "
           "ValueError where the body was not filled from a surface. O(mesh log surface).")
      .def("corner_uvs", &corner_uvs_of,
           "corner_uvs() -> (k, 3, 2) float32: texture coordinates of the corners of each row of faces(), "
           "from that surface; NaN "
           "for cut faces. Raises ValueError as origins(). O(mesh log surface).")
      .def("measure", &measure,
           "measure() -> dict: vertices, tets, pieces, islands, largest_piece, boundary_faces, cut_faces, "
           "cut_area (m^2, one side), "
           "volume (m^3), inverted, min_dihedral_deg. O(mesh).")
      .def("save", &save, py::arg("path"), R"(save(path)

Writes the mesh as `incise cut --out` does, by the ending of path; .vtu and .vtk have piece (numbered as pieces()), cut faces,
angles and more, and the fields (of other endings a UserWarning says which are left out); .glb has a node piece_N for each piece N. After deform() that is the deformed shape, which is at rest where
the file is loaded; .vtu and .vtk then have the vertex field "rest_position" too, (n, 3) float32: rest_positions() of what is saved. A body
that has a vertex field of that name keeps its own.)")
      .def("current_body", &current_body,
           "current_body() -> Body: the mesh as it is now, renumbered without gaps in the order of ids. "
           "After deform() it has the deformed "
           "shape, at rest, and the vertex field \"rest_position\" as in what save() writes.")
      .def_property_readonly(
          "state_hash",
          [](Session& self) {
            return with_core(self, [](const core::CutSession& c) { return c.mesh().state_hash(); });
          },
          "int: of the whole mesh; format(h, \"016x\") is what the command line prints.")
      .def_property_readonly(
          "revision",
          [](Session& self) {
            return with_core(self, [](const core::CutSession& c) { return c.revision(); });
          },
          "int: the number of steps so far.")
      .def_property_readonly(
          "h",
          [](Session& self) {
            return with_core(self, [](const core::CutSession& c) { return c.mesh().mean_edge_length(); });
          },
          "float: the mean edge length of the body as loaded, metres.")
      .def_property_readonly(
          "body", [](const Session& self) { return std::make_shared<Body>(*self.body); }, "Body: as loaded.")
      .def_property_readonly(
          "config",
          [](const Session& self) {
            return py::module_::import("json").attr("loads")(app::compact(self.config));
          },
          "dict: the whole configuration.");
}

}  // namespace

void add_session(py::module_& module) {
  PYBIND11_NUMPY_DTYPE(Face, tet, vertices, cut);
  py::class_<Session, std::shared_ptr<Session>> session(
      module, "Session", R"(Session(body, config=None, *, blade=None, policy=None, prefer=None, forces=False)

A body and the blades that cut it, as in a server. The state depends on the body, the configuration and the calls in their order
alone: not on the machine, nor on time.

body: a Body or the path of a mesh. config: a dict or a file, as `incised --config` takes it; the sections cut, blade and haptics
count. blade: ((x, y, z), (x, y, z)), heel and tip in the tool's frame, metres (default: 5 cm below the tool). policy:
"conforming" or "croll". prefer: "no-growth", "balanced" or "exact". forces: Cut.forces is wanted.

The blade cuts while button 0 is held (cut.engage), and throughout in motions without buttons. A session belongs to one thread at a
time: a second one gets Error. Raises ConfigError, MeshError, TypeError or ValueError.)");
  session.def(py::init([](const py::object& body, const py::object& config, const py::object& blade,
                          const py::object& policy, const py::object& prefer, bool forces) {
                return make_session(body, config, {blade, policy, prefer}, forces);
              }),
              py::arg("body"), py::arg("config") = py::none(), py::kw_only(), py::arg("blade") = py::none(),
              py::arg("policy") = py::none(), py::arg("prefer") = py::none(), py::arg("forces") = false);
  add_methods(session);
  add_state(session);

  py::class_<Cut>(module, "Cut", "What a motion has done: the result of cut() and Session.cut().")
      .def_readonly("session", &Cut::session, "Session: the body after the cut.")
      .def_readonly("deltas", &Cut::deltas, "list of Delta, one a step; empty if they were not wanted.")
      .def_readonly("forces", &Cut::forces,
                    "(n, 3) float64: the contact model's force on the hand at the tool's origin for each "
                    "pose, N, without the server's "
                    "limits; None if not wanted.")
      .def_readonly("report", &Cut::report,
                    "dict: what `incise cut --report` writes; None for Session.cut().")
      .def_readonly("warnings", &Cut::warnings, "list of str: what `incise cut` warns of.");

  module.def(
      "cut",
      [](const py::object& body, const py::object& poses, const py::object& config, const py::object& blade,
         const py::object& policy, const py::object& prefer, bool strict, bool deltas, bool forces) {
        return cut_body(body, poses, config, {blade, policy, prefer}, strict, deltas, forces);
      },
      py::arg("body"), py::arg("poses"), py::kw_only(), py::arg("config") = py::none(),
      py::arg("blade") = py::none(), py::arg("policy") = py::none(), py::arg("prefer") = py::none(),
      py::arg("strict") = false, py::arg("deltas") = false, py::arg("forces") = false,
      R"(cut(body, poses, *, config=None, blade=None, policy=None, prefer=None, strict=False, deltas=False, forces=False) -> Cut

What `incise cut` does, in process and with the same result to the bit: cuts a body by a motion, with the blade engaged throughout.

body: a Body, or the path of a mesh. poses: a Motion, the path of one, or an array (n, 8) of t, x, y, z, qx, qy, qz, qw (seconds,
metres, unit quaternion) or (n, 4) of t, x, y, z. config: a dict or a file; a capture's own if poses are one. blade:
((x, y, z), (x, y, z)), heel and tip in the tool's frame, metres. policy: "conforming" or "croll". prefer: "no-growth",
"balanced" or "exact". strict: refuse times that do not rise. deltas, forces: fill these in the result.

Limits beyond which a step counts as a jump are raised to suit the motion (report["raised_limits"]). Raises ConfigError, MeshError,
MotionError, Error, TypeError or ValueError.)");
}

}  // namespace incise::python
