#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "server/mesh_io/surface.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {

// What names in a surface's file refer to. A file that somebody else made may name anything: only files in the folder of the file that names
// them are read, and of images only what begins as one.

// The present line from this field on, blanks included.
std::string rest_of_line(const LineReader& in, std::size_t first);

// The file of that name in the folder of `of`, or below it, links resolved. Throws MeshError where the name is absolute, leads out of the
// folder, or names no file or one that is too large.
std::filesystem::path file_beside(const std::filesystem::path& of, std::string name,
                                  std::uintmax_t max_bytes);

// "image/png", "image/jpeg" or "image/webp", by its first bytes; empty for anything else.
std::string_view image_type(std::string_view bytes);

// Why an image of one of these types cannot be shown, as far as its structure tells without decoding it: it ends too early, or a part of it is
// damaged. Empty: nothing is seen. O(n).
std::string image_fault(std::string_view bytes);

// Reads the image `name`, as the file `of` gives it. A line in `warnings` where it cannot be used.
void read_texture(const std::filesystem::path& of, const std::string& name, Material& material,
                  std::vector<std::string>& warnings);

// Gives the material the image with these bytes. A line in `warnings`, with the `name` of the image, where they are none that is known or too many.
void use_image(const std::filesystem::path& of, const std::string& name, std::string_view bytes,
               Material& material, std::vector<std::string>& warnings);

// Fills in those of `materials` that the library `name` (.mtl: newmtl, Kd, map_Kd) has. Lines in `warnings` for what cannot be used.
void read_material_library(const std::filesystem::path& of, const std::string& name,
                           std::vector<Material>& materials, std::vector<std::string>& warnings);

}  // namespace incise::mesh_io
