// Wavefront MTL, and the images that it names.
#include "server/mesh_io/read_materials.hpp"

#include <algorithm>
#include <map>
#include <memory>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxImageBytes = std::uintmax_t{64} << 20;
constexpr std::uintmax_t kMaxLibraryBytes = std::uintmax_t{16} << 20;

std::string not_shown(const fs::path& of, const Material& material) {
  return of.string() + ": the texture of material " + in_quotes(material.name) + " is not shown: ";
}

}  // namespace

std::string rest_of_line(const LineReader& in, std::size_t first) {
  if (first >= in.size()) return {};
  const std::string_view from = in.field(first), to = in.field(in.size() - 1);
  return {from.data(), static_cast<std::size_t>(to.data() + to.size() - from.data())};
}

// Throws MeshError.
fs::path file_beside(const fs::path& of, std::string name, std::uintmax_t max_bytes) {
  const std::string said = in_quotes(name);
  std::replace(name.begin(), name.end(), '\\', '/');
  const fs::path relative(name);
  if (name.empty() || name.find('\0') != name.npos || relative.is_absolute() || name.find(':') != name.npos)
    throw MeshError(said + " is not a name relative to the folder of " + of.filename().string());
  std::error_code error;
  const fs::path folder = fs::canonical(of.has_parent_path() ? of.parent_path() : fs::path("."), error);
  fs::path path = error ? fs::path() : fs::canonical(folder / relative, error);
  if (error) throw MeshError(said + ": " + error.message());
  // The resolved path counts, after every ".." and every link.
  if (std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first != folder.end())
    throw MeshError(said + " lies outside of the folder of " + of.filename().string());
  if (!fs::is_regular_file(path, error)) throw MeshError(said + " is not a file");
  if (fs::file_size(path, error) > max_bytes || error)
    throw MeshError(said + " has more than the " + std::to_string(max_bytes >> 20) + " MB that are read");
  return path;
}

std::string_view image_type(std::string_view bytes) {
  if (bytes.starts_with("\x89PNG\r\n\x1a\n")) return "image/png";
  if (bytes.starts_with("\xff\xd8\xff")) return "image/jpeg";
  if (bytes.starts_with("RIFF") && bytes.size() > 12 && bytes.substr(8, 4) == "WEBP") return "image/webp";
  return {};
}

void read_texture(const fs::path& of, const std::string& name, Material& material,
                  std::vector<std::string>& warnings) {
  std::string bytes;
  try {
    bytes = read_whole_file(file_beside(of, name, kMaxImageBytes));
  } catch (const MeshError& error) {
    warnings.push_back(not_shown(of, material) + error.what());
    return;
  }
  use_image(of, in_quotes(name), bytes, material, warnings);
}

void use_image(const fs::path& of, const std::string& name, std::string_view bytes, Material& material,
               std::vector<std::string>& warnings) {
  const std::string_view type = image_type(bytes);
  if (type.empty() || bytes.size() > kMaxImageBytes) {
    warnings.push_back(
        not_shown(of, material) + name +
        (type.empty() ? std::string(" is not a PNG, JPEG or WebP image")
                      : " has more than the " + std::to_string(kMaxImageBytes >> 20) + " MB that are read"));
    return;
  }
  if (const std::string fault = image_fault(bytes); !fault.empty()) {
    warnings.push_back(not_shown(of, material) + name + " " + fault);
    return;
  }
  material.image_type = type;
  material.image = std::make_shared<const std::string>(bytes);
}

void read_material_library(const fs::path& of, const std::string& name, std::vector<Material>& materials,
                           std::vector<std::string>& warnings) {
  try {
    const fs::path path = file_beside(of, name, kMaxLibraryBytes);
    const std::string text = read_whole_file(path);
    LineReader in(text, path.string());
    Material* material = nullptr;  // one that is used
    std::map<std::string, Material> by_image;
    while (in.next()) {
      if (in.field(0) == "newmtl") {
        const std::string called = rest_of_line(in, 1);
        const auto found = std::find_if(materials.begin(), materials.end(),
                                        [&](const Material& m) { return m.name == called; });
        material = found == materials.end() ? nullptr : &*found;
      } else if (material != nullptr && in.field(0) == "Kd" && in.size() >= 4) {
        for (std::size_t i = 0; i < 3; ++i) {
          material->diffuse[i] =
              static_cast<float>(std::clamp(in.number(i + 1, "a component of Kd"), 0.0, 1.0));
        }
      } else if (material != nullptr && in.field(0) == "map_Kd" && in.size() >= 2) {
        // Options such as "-s 1 1 1" come before the name.
        const std::string image =
            in.field(1).starts_with('-') ? rest_of_line(in, in.size() - 1) : rest_of_line(in, 1);
        const auto [known, is_new] = by_image.try_emplace(image);
        if (is_new) {
          known->second.name = material->name;
          read_texture(path, image, known->second, warnings);
        }
        material->image = known->second.image;
        material->image_type = known->second.image_type;
      }
    }
  } catch (const MeshError& error) {
    warnings.push_back(of.string() + ": mtllib: its materials have names only: " + error.what());
  }
}

}  // namespace incise::mesh_io
