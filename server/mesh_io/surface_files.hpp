#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// Readers of triangle surfaces. Each gives the triangles in the file's order (a polygon becomes a fan, so it
// stands for several) with indices that exist and finite coordinates, in the file's units, and throws
// MeshError for anything else; check_surface decides whether the surface is closed and so on. Vertices at
// exactly the same place become one (STL cannot express shared vertices); unused ones are dropped.

// ASCII or binary, decided by the file's size; several solids become one surface. Normals are ignored.
Surface read_stl(const std::filesystem::path& path, std::vector<std::string>& warnings);
// PLY 1.0, ASCII or binary of either byte order: elements `vertex` (x, y, z; nx, ny, nz; red, green, blue, alpha; texture coordinates as u, v or
// s, t or texture_u, texture_v) and `face` (vertex_indices or vertex_index; texcoord), and the comment TextureFile; all else is skipped.
Surface read_ply(const std::filesystem::path& path, std::vector<std::string>& warnings);
// OFF and its variants with colours, normals and texture coordinates (which are skipped); ASCII.
Surface read_off(const std::filesystem::path& path);
// Wavefront OBJ: v (with colours or not), vt, vn, f (v, v/vt, v/vt/vn, v//vn, negative indices), usemtl and mtllib (Kd, map_Kd); all else is
// skipped. A corner without vt or vn, where others have one, has zeros.
Surface read_obj(const std::filesystem::path& path, std::vector<std::string>& warnings);
// Binary glTF 2.0: the triangles of the default scene, in its metres but z upwards, as write_glb (server/app) turns it; POSITION, NORMAL,
// TEXCOORD_n, COLOR_0; of materials the name, baseColorFactor and baseColorTexture. Compressed, sparse or skinned meshes are refused.
// Vertices on open edges that differ by a rounding become one, too, with a warning.
Surface read_glb(const std::filesystem::path& path, std::vector<std::string>& warnings);

// Writers; see write_surface in mesh_io.hpp.
void write_stl(const std::filesystem::path& path, const Surface& surface);
void write_ply(const std::filesystem::path& path, const Surface& surface,
               std::span<const CellArray> cell_data);
void write_off(const std::filesystem::path& path, const Surface& surface);
void write_obj(const std::filesystem::path& path, const Surface& surface);

}  // namespace incise::mesh_io
