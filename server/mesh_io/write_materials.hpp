#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// Names for files of lines: no control characters or blanks at an end, none empty, no two alike.
std::vector<std::string> material_names(const std::vector<Material>& materials);

// The .mtl beside an .obj.
std::filesystem::path material_library_of(const std::filesystem::path& obj);

// Writes into it the materials that are used, and beside it their images. Throws MeshError, and writes nothing, where it would overwrite what is not of
// its own making.
void write_material_library(const std::filesystem::path& obj, const SurfaceLook& look,
                            const std::vector<std::string>& names);

}  // namespace incise::mesh_io
