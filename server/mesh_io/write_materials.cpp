// Wavefront MTL.
#include "server/mesh_io/write_materials.hpp"

#include <cmath>
#include <fstream>
#include <iterator>
#include <map>
#include <set>
#include <string_view>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kFirstLine = "# materials, written by Incise\n";

std::string start_of(const fs::path& path, std::size_t size) {
  std::ifstream in(path, std::ios::binary);
  std::string bytes(size, '\0');
  in.read(bytes.data(), static_cast<std::streamsize>(size));
  bytes.resize(static_cast<std::size_t>(in.gcount()));
  return bytes;
}

bool is_own(const fs::path& library) {
  return start_of(library, kFirstLine.size()) == kFirstLine;
}

[[noreturn]] void refuse(const fs::path& path) {
  throw MeshError(path.string() +
                  ": would be overwritten, and was not written by Incise; choose another name");
}

std::string name_of_image(const fs::path& obj, std::size_t number, const std::string& type) {
  return obj.stem().string() + "_" + std::to_string(number) + "." + type.substr(type.find('/') + 1);
}

}  // namespace

std::vector<std::string> material_names(const std::vector<Material>& materials) {
  std::vector<std::string> names;
  std::set<std::string> taken;
  for (const Material& material : materials) {
    std::string name;
    for (const char c : material.name) name += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? '_' : c;
    const std::size_t first = name.find_first_not_of(' ');
    name = first == name.npos ? "material" : name.substr(first, name.find_last_not_of(' ') + 1 - first);
    std::string unique = name;
    for (int i = 2; !taken.insert(unique).second; ++i) unique = name + "_" + std::to_string(i);
    names.push_back(unique);
  }
  return names;
}

fs::path material_library_of(const fs::path& obj) {
  return fs::path(obj).replace_extension(".mtl");
}

void require_own_materials(const fs::path& obj) {
  const fs::path library = material_library_of(obj);
  std::error_code error;
  if (fs::exists(library, error) && !is_own(library)) refuse(library);
}

void write_material_library(const fs::path& obj, const SurfaceLook& look,
                            const std::vector<std::string>& names) {
  require_own_materials(obj);
  const fs::path library = material_library_of(obj);
  const bool again = is_own(library);
  std::string text(kFirstLine);
  std::map<const std::string*, std::string> images;
  for (const std::uint32_t i : std::set<std::uint32_t>(look.material_of.begin(), look.material_of.end())) {
    const Material& material = look.materials[i];
    text += "newmtl " + names[i] + "\nKd";
    for (const float x : material.diffuse) {
      text += ' ';
      append_number(text, static_cast<double>(x));
    }
    // Roughness as Blender takes it from a shininess, and as the extension of MTL for physically based rendering has it.
    const double rough = static_cast<double>(material.roughness);
    text += "\nNs " + std::to_string(std::lround(1000 * (1 - rough) * (1 - rough))) + "\nPr ";
    append_number(text, rough);
    text += "\n";
    if (!material.image) continue;
    const auto [image, is_new] = images.try_emplace(material.image.get());
    if (is_new) {
      image->second = name_of_image(obj, images.size() - 1, material.image_type);
      const fs::path path = library.parent_path() / image->second;
      std::error_code error;
      if (fs::exists(path, error) && !again && start_of(path, material.image->size() + 1) != *material.image)
        refuse(path);
    }
    text += "map_Kd " + image->second + "\n";
  }
  for (const auto& [bytes, name] : images) write_whole_file(library.parent_path() / name, *bytes);
  write_whole_file(library, text);
}

}  // namespace incise::mesh_io
