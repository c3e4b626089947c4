// Binary glTF 2.0 (Khronos, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html).
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <tuple>

#include "server/app/offline/cut_surface.hpp"
#include "server/app/version.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;
using core::Vec3;

// Faces of one kind that meet at less than this are shaded as one smooth surface, as on the page.
const double kCreaseCosine = std::cos(42 * std::numbers::pi / 180);
// glTF's numbers for kinds of components and buffers.
constexpr int kUint32 = 5125, kFloat = 5126, kVertices = 34962, kIndices = 34963;

// The normal of each corner: the sum, by area, of the faces at its vertex that are of its kind (skin or cut) and across no crease.
std::vector<std::array<float, 3>> corner_normals(const CutSurface& cut) {
  const auto& [positions, triangles, look] = cut.surface;
  std::vector<Vec3> normals;                                                            // twice the area long
  std::vector<std::uint32_t> first(positions.size() + 1, 0), at(3 * triangles.size());  // triangles by vertex
  for (const auto& t : triangles) {
    normals.push_back(cross(positions[t[1]] - positions[t[0]], positions[t[2]] - positions[t[0]]));
    for (const core::VertexId v : t) ++first[v + 1];
  }
  for (std::size_t v = 0; v < positions.size(); ++v) first[v + 1] += first[v];
  std::vector<std::uint32_t> next(first.begin(), first.end() - 1);
  for (std::uint32_t t = 0; t < triangles.size(); ++t)
    for (const core::VertexId v : triangles[t]) at[next[v]++] = t;
  std::vector<std::array<float, 3>> out;
  for (std::uint32_t t = 0; t < triangles.size(); ++t) {
    for (const core::VertexId v : triangles[t]) {
      Vec3 sum;
      for (std::uint32_t i = first[v]; i < first[v + 1]; ++i) {
        const std::uint32_t other = at[i];
        if (cut.cut[other] != cut.cut[t]) continue;
        const double limit = kCreaseCosine * length(normals[t]) * length(normals[other]);
        if (other == t || dot(normals[t], normals[other]) >= limit) sum = sum + normals[other];
      }
      const double size = length(sum);
      const Vec3 unit = size > 0 ? (1 / size) * sum : Vec3{0, 0, 1};
      out.push_back({static_cast<float>(unit.x), static_cast<float>(unit.y), static_cast<float>(unit.z)});
    }
  }
  return out;
}

// glTF's colours are linear, ours are sRGB, as the page shows them.
float linear(double x) {
  return static_cast<float>(x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4));
}

// The vertices and triangles of one piece that have one material.
struct Primitive {
  std::vector<float> positions, normals, uvs, colours;
  std::vector<std::uint32_t> indices;
};

class GlbFile {
 public:
  explicit GlbFile(const CutSurface& cut) : cut_(cut), normals_(corner_normals(cut)) {}

  std::string make() {
    json_["asset"] = {{"version", "2.0"}, {"generator", kSoftware}};
    add_materials();
    add_pieces();
    if (json_["images"].empty())
      for (const char* key : {"images", "textures", "samplers"}) json_.erase(key);
    json_["buffers"] = {{{"byteLength", data_.size()}}};
    return chunks();
  }

 private:
  const mesh_io::SurfaceLook& look() const { return cut_.surface.look; }

  void add_materials() {
    json_["scene"] = 0;
    json_["images"] = json_["textures"] = Json::array();
    json_["samplers"] = {Json::object()};
    std::map<const std::string*, std::size_t> textures;
    for (const std::uint32_t used : look().material_of) number_[used] = 0;
    for (auto& [index, number] : number_) {
      const mesh_io::Material& material = look().materials[index];
      number = json_["materials"].size();
      Json pbr = {{"metallicFactor", 0}, {"roughnessFactor", material.roughness}};
      if (material.image) {
        const auto [texture, is_new] = textures.try_emplace(material.image.get(), textures.size());
        if (is_new) add_image(material);
        pbr["baseColorTexture"] = {{"index", texture->second}};
      } else {
        pbr["baseColorFactor"] = Json::array();
        for (const float x : material.diffuse)
          pbr["baseColorFactor"].push_back(linear(static_cast<double>(x)));
        pbr["baseColorFactor"].push_back(1);
      }
      json_["materials"].push_back({{"name", material.name}, {"pbrMetallicRoughness", pbr}});
    }
  }

  void add_image(const mesh_io::Material& material) {
    const std::size_t image = json_["images"].size();
    json_["images"].push_back({{"mimeType", material.image_type},
                               {"bufferView", add_view(material.image->data(), material.image->size(), 0)}});
    Json texture = {{"sampler", 0}};
    if (material.image_type == "image/webp") {
      texture["extensions"] = {{"EXT_texture_webp", {{"source", image}}}};
      json_["extensionsUsed"] = json_["extensionsRequired"] = {"EXT_texture_webp"};
    } else {
      texture["source"] = image;
    }
    json_["textures"].push_back(texture);
  }

  void add_pieces() {
    std::map<std::uint32_t, std::map<std::uint32_t, std::vector<std::uint32_t>>>
        triangles;  // by piece, by material
    for (std::uint32_t t = 0; t < cut_.pieces.size(); ++t)
      triangles[cut_.pieces[t]][look().material_of[t]].push_back(t);
    Json nodes = Json::array(), children = Json::array();
    // glTF has y up, the mesh has z up.
    nodes.push_back(
        {{"name", "body"}, {"rotation", {-std::numbers::sqrt2 / 2, 0, 0, std::numbers::sqrt2 / 2}}});
    for (const auto& [piece, by_material] : triangles) {
      Json primitives = Json::array();
      for (const auto& [material, members] : by_material)
        primitives.push_back(add_primitive(primitive(members), number_.at(material)));
      const std::string name = "piece_" + std::to_string(piece);
      children.push_back(nodes.size());
      nodes.push_back({{"name", name}, {"mesh", nodes.size() - 1}});
      json_["meshes"].push_back({{"name", name}, {"primitives", primitives}});
    }
    nodes[0]["children"] = children;
    json_["nodes"] = nodes;
    json_["scenes"] = {{{"nodes", {0}}}};
  }

  // Corners that have all of it in common become one vertex.
  Primitive primitive(const std::vector<std::uint32_t>& triangles) const {
    Primitive out;
    struct Corner {
      core::VertexId vertex;
      std::array<float, 3> normal;
      std::array<float, 2> uv;
      std::array<std::uint8_t, 4> colour;
      bool operator<(const Corner& o) const {
        return std::tie(vertex, normal, uv, colour) < std::tie(o.vertex, o.normal, o.uv, o.colour);
      }
    };
    const bool has_image = look().materials[look().material_of[triangles[0]]].image != nullptr;
    const bool has_uvs = !look().uvs.empty() && (has_image || cut_.cut[triangles[0]] == 0);
    const bool has_colours = !look().colours.empty() && cut_.cut[triangles[0]] == 0;
    std::map<Corner, std::uint32_t> known;
    for (const std::uint32_t t : triangles) {
      for (std::size_t c = 3 * std::size_t{t}; c < 3 * std::size_t{t} + 3; ++c) {
        const Corner corner{cut_.surface.triangles[t][c % 3], normals_[c],
                            has_uvs ? look().uvs[c] : std::array<float, 2>{},
                            has_colours ? look().colours[c] : std::array<std::uint8_t, 4>{}};
        const auto [place, is_new] = known.try_emplace(corner, static_cast<std::uint32_t>(known.size()));
        out.indices.push_back(place->second);
        if (!is_new) continue;
        const Vec3& p = cut_.surface.positions[corner.vertex];
        for (const double x : {p.x, p.y, p.z}) out.positions.push_back(static_cast<float>(x));
        out.normals.insert(out.normals.end(), corner.normal.begin(), corner.normal.end());
        if (has_uvs) out.uvs.insert(out.uvs.end(), {corner.uv[0], 1 - corner.uv[1]});  // glTF's v points down
        if (!has_colours) continue;
        for (std::size_t i = 0; i < 3; ++i) out.colours.push_back(linear(corner.colour[i] / 255.0));
        out.colours.push_back(static_cast<float>(corner.colour[3]) / 255);
      }
    }
    return out;
  }

  Json add_primitive(const Primitive& p, std::size_t material) {
    std::array<float, 3> low, high;
    low.fill(std::numeric_limits<float>::max());
    high.fill(std::numeric_limits<float>::lowest());
    for (std::size_t i = 0; i < p.positions.size(); ++i) {
      low[i % 3] = std::min(low[i % 3], p.positions[i]);
      high[i % 3] = std::max(high[i % 3], p.positions[i]);
    }
    const std::size_t position = add_array(p.positions, 3, "VEC3");
    json_["accessors"][position]["min"] = low;
    json_["accessors"][position]["max"] = high;
    Json attributes = {{"POSITION", position}, {"NORMAL", add_array(p.normals, 3, "VEC3")}};
    if (!p.uvs.empty()) attributes["TEXCOORD_0"] = add_array(p.uvs, 2, "VEC2");
    if (!p.colours.empty()) attributes["COLOR_0"] = add_array(p.colours, 4, "VEC4");
    return {
        {"attributes", attributes}, {"indices", add_array(p.indices, 1, "SCALAR")}, {"material", material}};
  }

  template <class T>
  std::size_t add_array(const std::vector<T>& values, std::size_t each, const char* type) {
    constexpr bool kIsIndex = std::is_same_v<T, std::uint32_t>;
    const std::size_t view =
        add_view(values.data(), values.size() * sizeof(T), kIsIndex ? kIndices : kVertices);
    json_["accessors"].push_back({{"bufferView", view},
                                  {"componentType", kIsIndex ? kUint32 : kFloat},
                                  {"count", values.size() / each},
                                  {"type", type}});
    return json_["accessors"].size() - 1;
  }

  std::size_t add_view(const void* bytes, std::size_t size, int target) {
    data_.resize((data_.size() + 3) / 4 * 4);
    Json view = {{"buffer", 0}, {"byteOffset", data_.size()}, {"byteLength", size}};
    if (target != 0) view["target"] = target;
    data_.append(static_cast<const char*>(bytes), size);
    json_["bufferViews"].push_back(std::move(view));
    return json_["bufferViews"].size() - 1;
  }

  // Header, JSON, data. Texts of the surface's file may be in any encoding: what is not UTF-8 is replaced.
  std::string chunks() {
    std::string text = json_.dump(-1, ' ', false, Json::error_handler_t::replace);
    text.resize((text.size() + 3) / 4 * 4, ' ');
    data_.resize((data_.size() + 3) / 4 * 4);
    const std::size_t size = 12 + 8 + text.size() + 8 + data_.size();
    if (size > std::numeric_limits<std::uint32_t>::max()) {
      throw mesh_io::MeshError(std::to_string(size >> 20) +
                               " MB are more than the 4 GB that a .glb can hold: write .vtp or .ply instead");
    }
    std::string out;
    const auto put = [&out](std::size_t value) {
      const auto word = static_cast<std::uint32_t>(value);
      out.append(reinterpret_cast<const char*>(&word), 4);
    };
    out += "glTF";
    put(2);
    put(size);
    put(text.size());
    out += "JSON";
    out += text;
    put(data_.size());
    out += std::string("BIN\0", 4);
    out += data_;
    return out;
  }

  const CutSurface& cut_;
  const std::vector<std::array<float, 3>> normals_;
  std::map<std::uint32_t, std::size_t> number_;  // in the file, of each material that is used
  Json json_;
  std::string data_;
};

}  // namespace

void write_glb(const std::filesystem::path& path, const CutSurface& cut) {
  std::string bytes;
  try {
    bytes = GlbFile(cut).make();
  } catch (const mesh_io::MeshError& error) {
    throw mesh_io::MeshError(path.string() + ": " + error.what());
  }
  mesh_io::write_whole_file(path, bytes);
}

}  // namespace incise::app
