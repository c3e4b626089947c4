#pragma once

#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <iosfwd>
#include <string>
#include <vector>

#include "server/app/offline/cut_surface.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/carried_fields.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {

// Throws std::runtime_error if `path` cannot become a file: its directory is missing, or it is a directory. Call it before
// the work whose result goes there. `option` names the path in the message.
void require_writable(const std::filesystem::path& path, const std::string& option);
// Throws UsageError if `out` is one of the files that are read (a TetGen mesh can also be named by its base).
void require_not_read(const std::filesystem::path& out, std::initializer_list<std::filesystem::path> read,
                      const std::string& option);
// As require_writable; also throws UsageError if write_cut_mesh cannot write this ending: a mesh's, a surface's or none (TetGen).
void require_mesh_output(const std::filesystem::path& path, const std::string& option);

// Whether write_cut_mesh() writes fields to a file of this name.
bool keeps_fields(const std::filesystem::path& path);

// Whether write_cut_mesh() writes materials to a file of this name.
bool keeps_materials(const std::filesystem::path& path);

// Writes a cut mesh, ids renumbered in their order: .vtu and .vtk with, for each tetrahedron, its id (`tet_id`),
// region, piece (numbered by lowest tetrahedron), which of its faces were cut (`cut_mask`, bit f: opposite to vertex
// f) and how many (`cut_faces`), smallest dihedral angle (`min_dihedral_deg`) and volume; .msh, .msh2, .mesh and TetGen .node/.ele with regions; or the
// boundary as a surface (.stl .ply .off .obj .vtp), or with pieces, materials and textures (.glb). `from`: the surface that the body was filled from: then .vtu
// and .vtk have the origin of each face (`origin_0` to `origin_3`; 4294967295: none), and .obj, .ply and .vtp its texture coordinates. `fields` go into .vtu and .vtk. Either may
// be null. .glb and .obj (with a .mtl and its images beside it) show `regions`; null: as viewers do where nothing is configured. Throws MeshError.
void write_cut_mesh(const std::filesystem::path& path, const core::TetMesh& mesh,
                    const mesh_io::Surface* from = nullptr, const core::CarriedFields* fields = nullptr,
                    const std::vector<RegionMaterials>* regions = nullptr);

// Closes a file of text. If something could not be written, removes what is there. Throws std::runtime_error.
void finish_writing(std::ofstream& out, const std::filesystem::path& path);
// Removes a file that could not be written to its end. A pipe or device stays.
void remove_unfinished(const std::filesystem::path& path);
// Writes a text file. Throws std::runtime_error.
void write_text(const std::filesystem::path& path, const std::string& text);

}  // namespace incise::app
