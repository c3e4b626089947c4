#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <span>
#include <string>
#include <vector>

#include "server/app/offline/cut_surface.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {

// What a command writes.
struct Output {
  enum class Kind : std::uint8_t {
    kText,  // may be a pipe or a device
    kFile,  // replaced when it is whole
    kMesh   // by write_cut_mesh()
  };
  std::filesystem::path path;  // empty: nothing
  std::string option;          // names it in messages
  Kind kind = Kind::kText;
};
// Call it before the work whose results go there. Throws std::runtime_error if one cannot become a file: its directory is
// missing, or it is something else; UsageError if write_cut_mesh() cannot write its ending, or if it would overwrite one of the files that are
// read, or another output.
void require_outputs(const std::vector<Output>& outputs, const std::vector<std::filesystem::path>& read);
// The part of it about what is read: for files that only the first ones name.
void require_not_read(const Output& out, const std::vector<std::filesystem::path>& read);
// As require_outputs for one mesh.
void require_mesh_output(const std::filesystem::path& path, const std::string& option);
// The files that write_cut_mesh() makes of that path, but for the images of an .obj: a TetGen mesh is two.
std::vector<std::filesystem::path> files_of_mesh(const std::filesystem::path& path);
// The row "written" on stdout for these.
void print_written(const std::vector<std::filesystem::path>& files);

// Whether write_cut_mesh() writes fields to a file of this name.
bool keeps_fields(const std::filesystem::path& path);
// The warning that a file of this name is without these fields; empty where it has them, or there are none.
std::string fields_left_out(const std::filesystem::path& path, std::span<const mesh_io::Field> fields);
// The warning that a file of this name does not say which faces are cuts, as a further cut needs it; empty where it does, where it is only a surface,
// or where the mesh has no cuts.
std::string cuts_left_out(const std::filesystem::path& path, const core::TetMesh& mesh);

// Whether write_cut_mesh() writes materials to a file of this name.
bool keeps_materials(const std::filesystem::path& path);

// The fields of a session's body as its files have them: rows as export_data() has vertices and tetrahedra. Where the body is deformed, with
// mesh_io::kRestPosition (3 floats, m) unless it has a vertex field of that name, as one that was saved deformed has: that is where the
// material was before. O(mesh).
std::vector<mesh_io::Field> saved_fields(const core::CutSession& session);

// Writes a session's mesh in its present shape, ids renumbered in their order: .vtu and .vtk with, for each tetrahedron, its id (`tet_id`),
// region, piece (core::piece_numbers()), which of its faces were cut (`cut_mask`, bit f: opposite to vertex
// f) and how many (`cut_faces`), smallest dihedral angle (`min_dihedral_deg`) and volume, and with saved_fields(); .msh, .msh2, .mesh and TetGen .node/.ele with regions; or the
// boundary as a surface (.stl .ply .off .obj .vtp), or with pieces, materials and textures (.glb). `from`: the surface that the body was filled from: then .vtu
// and .vtk have the origin of each face (`origin_0` to `origin_3`; 4294967295: none), and .obj, .ply and .vtp its texture coordinates; may be null.
// .glb and .obj (with a .mtl and its images beside it) show `regions`; null: as viewers do where nothing is configured. Throws MeshError.
void write_cut_mesh(const std::filesystem::path& path, const core::CutSession& session,
                    const mesh_io::Surface* from = nullptr,
                    const std::vector<RegionMaterials>* regions = nullptr);
// The same of a mesh that no session cuts, without fields.
void write_cut_mesh(const std::filesystem::path& path, const core::TetMesh& mesh,
                    const mesh_io::Surface* from = nullptr);

// Closes a file of text. If something could not be written, removes what is there. Throws std::runtime_error.
void finish_writing(std::ofstream& out, const std::filesystem::path& path);
// Writes a text file. Throws std::runtime_error.
void write_text(const std::filesystem::path& path, const std::string& text);

}  // namespace incise::app
