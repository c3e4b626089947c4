// incise.Body: a mesh that can be cut.
#include <pybind11/stl.h>

#include <limits>

#include "server/app/body.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/python/arrays.hpp"
#include "server/app/python/module.hpp"
#include "server/mesh_io/phantom.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/tet_repair.hpp"

namespace incise::python {
namespace {

using core::MeshData;
using mesh_io::LoadedMesh;

// The module's own directory may hold incise-tetgen.
mesh_io::LoadOptions options_of(const app::Config& config) {
  mesh_io::LoadOptions options = app::load_options(config);
  const py::object file = py::module_::import("incise._core").attr("__file__");
  options.fields = true;
  options.fill.tetgen_directory = std::filesystem::path(file.cast<std::string>()).parent_path();
  return options;
}

Body from_arrays(const py::object& given_points, const py::object& given_tets,
                 const py::object& given_regions, const std::string& name, const py::object& vertex_fields,
                 const py::object& tet_fields) {
  auto loaded = std::make_shared<LoadedMesh>();
  MeshData& mesh = loaded->mesh;
  mesh.positions = points(given_points, "points");
  if (mesh.positions.size() >= std::numeric_limits<core::VertexId>::max())
    throw py::value_error("points: more than 2^32 - 2");
  const Integers tets =
      integers(given_tets, "tets", {-1, 4}, 0, static_cast<std::int64_t>(mesh.positions.size()) - 1);
  if (tets.shape(0) == 0) throw py::value_error("tets: found none; accepted are one or more");
  if (tets.shape(0) > static_cast<py::ssize_t>(mesh_io::kMaxTets))
    throw py::value_error("tets: found " + std::to_string(tets.shape(0)) + "; accepted are at most 2^28 - 2");
  mesh.tets.resize(static_cast<std::size_t>(tets.shape(0)));
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    for (std::size_t i = 0; i < 4; ++i) mesh.tets[t][i] = static_cast<core::VertexId>(tets.data()[4 * t + i]);
  }
  if (!given_regions.is_none()) {
    using Limits = std::numeric_limits<std::int32_t>;
    const Integers regions =
        integers(given_regions, "regions", {tets.shape(0)}, Limits::min(), Limits::max());
    for (py::ssize_t t = 0; t < regions.size(); ++t)
      mesh.regions.push_back(static_cast<std::int32_t>(regions.data()[t]));
  }
  using mesh_io::Field;
  add_fields(vertex_fields, "vertex_fields", Field::On::kVertices, mesh.positions.size(), loaded->fields);
  add_fields(tet_fields, "tet_fields", Field::On::kTets, mesh.tets.size(), loaded->fields);
  for (const Field& field : loaded->fields) {
    if (field.on == Field::On::kTets && mesh_io::is_own_array(field.name))
      throw py::value_error("tet_fields: \"" + field.name +
                            "\" is the name of an array that results have of their own; choose another name");
  }
  {
    const py::gil_scoped_release release;
    mesh_io::KeptElements kept;
    mesh_io::repair_tets(mesh, name, 0, loaded->warnings, &kept);
    for (Field& field : loaded->fields)
      field = core::rows_of(field, field.on == Field::On::kVertices ? kept.vertices : kept.tets);
    loaded->hash();
  }
  return {name, std::move(loaded)};
}

Body load(const std::filesystem::path& path, const app::Config& config) {
  const mesh_io::LoadOptions options = options_of(config);
  const py::gil_scoped_release release;
  return {path.string(), std::make_shared<const LoadedMesh>(mesh_io::load_mesh(path, options))};
}

Body phantom(const std::string& kind, std::int64_t tets) {
  const auto known = mesh_io::phantom_kind(kind);
  if (!known)
    throw py::value_error("kind: found \"" + kind + "\"; accepted is \"liver\", \"cylinder\" or \"slab\"");
  if (tets < static_cast<std::int64_t>(mesh_io::kMinPhantomTets) ||
      tets > static_cast<std::int64_t>(mesh_io::kMaxPhantomTets)) {
    throw py::value_error("tets: found " + std::to_string(tets) + "; accepted is " +
                          std::to_string(mesh_io::kMinPhantomTets) + " to " +
                          std::to_string(mesh_io::kMaxPhantomTets));
  }
  mesh_io::FillOptions fill = options_of({}).fill;
  fill.target_tets = static_cast<std::size_t>(tets);
  const py::gil_scoped_release release;
  auto loaded = std::make_shared<LoadedMesh>();
  loaded->mesh = mesh_io::make_phantom(*known, fill, loaded->warnings);
  loaded->hash();
  loaded->filled = true;
  return {kind, std::move(loaded)};
}

void save(const Body& body, const py::object& given) {
  const auto path = path_from(given, "path");
  app::require_mesh_output(path, "path");
  const MeshData& mesh = body.loaded->mesh;
  {
    const py::gil_scoped_release release;
    if (mesh_io::is_surface_file(path)) {
      mesh_io::write_surface(path, mesh_io::boundary_surface(mesh.positions, mesh.tets));
    } else if (path.has_extension() && !mesh_io::is_mesh_file(path)) {
      app::write_cut_mesh(path, core::TetMesh(mesh), body.loaded->surface.get());
    } else {
      mesh_io::write_mesh(path.has_extension() ? path : std::filesystem::path(path.string() + ".node"), mesh,
                          body.loaded->fields);
    }
  }
  warn(app::fields_left_out(path, body.loaded->fields));
}

py::array tets_of(const py::object& self) {
  const MeshData& mesh = self.cast<const Body&>().loaded->mesh;
  py::array array(py::dtype::of<core::VertexId>(), {mesh.tets.size(), std::size_t{4}},
                  {sizeof mesh.tets[0], sizeof(core::VertexId)}, mesh.tets.data(), self);
  py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}

py::array regions_of(const py::object& self) {
  const MeshData& mesh = self.cast<const Body&>().loaded->mesh;
  if (mesh.regions.empty()) return owned(std::vector<std::int32_t>(mesh.tets.size(), 0));
  return view(std::span<const std::int32_t>(mesh.regions), self);
}

}  // namespace

std::shared_ptr<const Body> body_from(const py::object& value, const app::Config& config) {
  if (py::isinstance<Body>(value)) return value.cast<std::shared_ptr<Body>>();
  if (!is_path(value)) {
    throw py::type_error("body: found " + std::string(py::repr(py::type::of(value))) +
                         "; accepted is an incise.Body or the path of a mesh");
  }
  return std::make_shared<const Body>(load(path_from(value, "body"), config));
}

void add_body(py::module_& module) {
  py::class_<Body, std::shared_ptr<Body>>(
      module, "Body",
      R"(Body(points, tets, regions=None, *, name="arrays", vertex_fields=None, tet_fields=None)

A tetrahedral mesh that can be cut. Immutable: a Session works on a copy.

points: (n, 3) real numbers, metres. tets: (m, 4) indices into points, from 0. regions: (m,) whole numbers, the material of
each tetrahedron (default: all 0). vertex_fields, tet_fields: dicts of (n,) or (n, k) and (m,) or (m, k) numbers, k 1 to 9,
that go with the material when it is cut; whole numbers become int32, others float32. The arrays are copied.

The mesh is checked and repaired as a file's is: left-handed tetrahedra are turned over, flat ones fixed or removed, points
without a tetrahedron dropped (so `points` may have fewer rows than were given); `warnings` says what was done.

Raises TypeError or ValueError for arrays of another type or shape, NaN, infinities and indices out of range; MeshError for a
mesh that cannot be cut, such as a face of three tetrahedra.)")
      .def(py::init(&from_arrays), py::arg("points"), py::arg("tets"), py::arg("regions") = py::none(),
           py::kw_only(), py::arg("name") = "arrays", py::arg("vertex_fields") = py::none(),
           py::arg("tet_fields") = py::none())
      .def_static(
          "load",
          [](const py::object& path, const py::object& config) {
            return load(path_from(path, "path"), config_from(config));
          },
          py::arg("path"), py::arg("config") = py::none(), R"(load(path, config=None) -> Body

Reads what `incise cut --mesh` reads: tetrahedra (.node/.ele or their common name, .msh, .vtk, .vtu, .mesh, .veg) or a closed
surface to fill (.stl, .ply, .off, .obj, .glb), which takes seconds and needs the program incise-tetgen. config: a dict or a
file; its section mesh counts (scale_to_metres, target_tets, tetgen_switches, ...). Raises MeshError or ConfigError.)")
      .def_static("phantom", &phantom, py::arg("kind"), py::arg("tets") = 60'000,
                  R"(phantom(kind, tets=60000) -> Body

A test body of about so many tetrahedra (500 to 20 million): "liver" (0.19 m long), "cylinder" (radius 25 mm, height 100 mm
along z) or "slab" (100 x 60 x 20 mm). The same arguments give the same bits. Needs the program incise-tetgen.)")
      .def_property_readonly(
          "name", [](const Body& body) { return body.name; },
          "str: the file as given, the phantom's kind, or what the caller chose.")
      .def_property_readonly(
          "points",
          [](const py::object& self) {
            return view(std::span<const core::Vec3>(self.cast<const Body&>().loaded->mesh.positions), self);
          },
          "(n, 3) float64, metres; a read-only view.")
      .def_property_readonly(
          "tets", &tets_of, "(m, 4) uint32, right-handed: (p1-p0) x (p2-p0) . (p3-p0) > 0; a read-only view.")
      .def_property_readonly("regions", &regions_of, "(m,) int32: the material of each tetrahedron.")
      .def_property_readonly(
          "vertex_fields",
          [](const Body& body) { return dict_of(body.loaded->fields, mesh_io::Field::On::kVertices); },
          "dict of str to (n,) or (n, components) float32 or int32: fields on the points; copies.")
      .def_property_readonly(
          "tet_fields",
          [](const Body& body) { return dict_of(body.loaded->fields, mesh_io::Field::On::kTets); },
          "dict likewise: fields on the tetrahedra.")
      .def_property_readonly(
          "content_hash", [](const Body& body) { return body.loaded->content_hash; },
          "str: SHA-256 of points, tetrahedra and regions, 64 hexadecimal digits.")
      .def_property_readonly(
          "warnings", [](const Body& body) { return body.loaded->warnings; },
          "list of str: what was repaired or tolerated, and the first place.")
      .def("save", &save, py::arg("path"), R"(save(path)

Writes the mesh by the ending of path: .vtu, .vtk, .msh, .msh2, .mesh, .node, or its surface as .stl, .ply, .off, .obj, .vtp. Only .vtu
and .vtk have its fields: a UserWarning says which are left out.)")
      .def("__repr__", [](const Body& body) {
        return "<incise.Body " + body.name + ": " + std::to_string(body.loaded->mesh.positions.size()) +
               " points, " + std::to_string(body.loaded->mesh.tets.size()) + " tetrahedra>";
      });
}

}  // namespace incise::python
