#pragma once

#include <filesystem>
#include <span>

#include "server/mesh_io/field.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// Writes a VTK XML unstructured grid (.vtu): only tetrahedra, so that a reader finds as many cells as
// tetrahedra; coordinates as doubles, metres; `cell_data` and fields on tetrahedra as cell data, fields on vertices as point data, `cut_memory`, where there is any, as field data. Raw appended data, little-endian,
// 64-bit lengths ("VTK File Formats", XML formats): what ParaView and VTK >= 6 read. Each array is as long as
// `tets`.
void write_vtu(const std::filesystem::path& path, std::span<const core::Vec3> positions,
               std::span<const std::array<core::VertexId, 4>> tets, std::span<const CellArray> cell_data,
               std::span<const Field> fields = {}, std::span<const std::byte> cut_memory = {});

// Writes VTK XML polygonal data (.vtp): the triangles of a surface, `cell_data` one value for each.
void write_vtp(const std::filesystem::path& path, const Surface& surface,
               std::span<const CellArray> cell_data);

}  // namespace incise::mesh_io
