#include <algorithm>
#include <cstring>
#include <map>
#include <numeric>

#include "server/base/check.hpp"
#include "server/mesh_io/surface_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/write_materials.hpp"

namespace incise::mesh_io {
namespace {

template <class T>
void append_bytes(std::string& bytes, const T& value) {
  char buffer[sizeof(T)];
  std::memcpy(buffer, &value, sizeof(T));
  bytes.append(buffer, sizeof(T));
}

void append_point(std::string& text, const core::Vec3& p) {
  append_number(text, p.x);
  text += ' ';
  append_number(text, p.y);
  text += ' ';
  append_number(text, p.z);
  text += '\n';
}

template <class T>
constexpr const char* kPlyType = nullptr;
template <>
constexpr const char* kPlyType<std::uint8_t> = "uchar";
template <>
constexpr const char* kPlyType<std::int32_t> = "int";
template <>
constexpr const char* kPlyType<std::uint32_t> = "uint";
template <>
constexpr const char* kPlyType<float> = "float";
template <>
constexpr const char* kPlyType<double> = "double";

}  // namespace

void write_stl(const std::filesystem::path& path, const Surface& surface) {
  std::string bytes = "binary STL, metres";  // must not start with "solid": readers would take it for ASCII
  bytes.resize(80, ' ');
  append_bytes(bytes, static_cast<std::uint32_t>(surface.triangles.size()));
  bytes.reserve(84 + 50 * surface.triangles.size());
  for (const auto& t : surface.triangles) {
    const core::Vec3 &a = surface.positions[t[0]], &b = surface.positions[t[1]], &c = surface.positions[t[2]];
    const core::Vec3 normal = core::normalized(core::cross(b - a, c - a));
    for (const core::Vec3& p : {normal, a, b, c}) {
      for (const double x : {p.x, p.y, p.z}) append_bytes(bytes, static_cast<float>(x));
    }
    append_bytes(bytes, std::uint16_t{0});
  }
  write_whole_file(path, bytes);
}

void write_ply(const std::filesystem::path& path, const Surface& surface,
               std::span<const CellArray> cell_data) {
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(surface.positions.size()) +
      "\nproperty double x\nproperty double y\nproperty double z\nelement face " +
      std::to_string(surface.triangles.size()) + "\nproperty list uchar int vertex_indices\n" +
      (surface.look.uvs.empty() ? "" : "property list uchar float texcoord\n");
  for (const CellArray& array : cell_data) {
    std::visit(
        [&](const auto& values) {
          INCISE_CHECK(values.size() == surface.triangles.size(), array.name, values.size());
          using T = typename std::decay_t<decltype(values)>::value_type;
          bytes += std::string("property ") + kPlyType<T> + " " + array.name + "\n";
        },
        array.values);
  }
  bytes += "end_header\n";
  for (const core::Vec3& p : surface.positions) append_bytes(bytes, p);
  for (std::size_t i = 0; i < surface.triangles.size(); ++i) {
    append_bytes(bytes, std::uint8_t{3});
    for (const core::VertexId v : surface.triangles[i]) append_bytes(bytes, static_cast<std::int32_t>(v));
    if (!surface.look.uvs.empty()) {
      append_bytes(bytes, std::uint8_t{6});
      for (std::size_t k = 0; k < 3; ++k) append_bytes(bytes, surface.look.uvs[3 * i + k]);
    }
    for (const CellArray& array : cell_data) {
      std::visit([&](const auto& values) { append_bytes(bytes, values[i]); }, array.values);
    }
  }
  write_whole_file(path, bytes);
}

void write_off(const std::filesystem::path& path, const Surface& surface) {
  std::string text = "OFF\n" + std::to_string(surface.positions.size()) + " " +
                     std::to_string(surface.triangles.size()) + " 0\n";
  for (const core::Vec3& p : surface.positions) append_point(text, p);
  for (const auto& t : surface.triangles) {
    text += "3 " + std::to_string(t[0]) + " " + std::to_string(t[1]) + " " + std::to_string(t[2]) + "\n";
  }
  write_whole_file(path, text);
}

void write_obj(const std::filesystem::path& path, const Surface& surface) {
  const SurfaceLook& look = surface.look;
  std::string text = "# metres\n";
  std::vector<std::string> names;
  if (!look.material_of.empty()) {
    names = material_names(look.materials);
    write_material_library(path, look, names);
    text += "mtllib " + material_library_of(path).filename().string() + "\n";
  }
  for (const core::Vec3& p : surface.positions) {
    text += "v ";
    append_point(text, p);
  }
  std::vector<std::size_t> uv_of;  // by corner, counted from 1
  std::map<std::array<float, 2>, std::size_t> known;
  for (const auto& uv : look.uvs) {
    const auto [place, is_new] = known.try_emplace(uv, known.size() + 1);
    uv_of.push_back(place->second);
    if (!is_new) continue;
    text += "vt ";
    append_number(text, static_cast<double>(uv[0]));
    text += ' ';
    append_number(text, static_cast<double>(uv[1]));
    text += '\n';
  }
  std::vector<std::size_t> order(surface.triangles.size());
  std::iota(order.begin(), order.end(), 0);
  if (!look.material_of.empty()) {
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return look.material_of[a] < look.material_of[b]; });
  }
  std::uint32_t material = core::kNone;
  for (const std::size_t t : order) {
    if (!look.material_of.empty() && look.material_of[t] != material) {
      material = look.material_of[t];
      text += "usemtl " + names[material] + "\n";
    }
    text += "f";
    for (std::size_t k = 0; k < 3; ++k) {
      text += " " + std::to_string(surface.triangles[t][k] + 1);
      if (!uv_of.empty()) text += "/" + std::to_string(uv_of[3 * t + k]);
    }
    text += "\n";
  }
  write_whole_file(path, text);
}

}  // namespace incise::mesh_io
