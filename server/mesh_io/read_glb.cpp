// Binary glTF 2.0 (Khronos, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html).
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>

#include "server/mesh_io/glb_document.hpp"
#include "server/mesh_io/read_materials.hpp"
#include "server/mesh_io/surface_reading.hpp"

namespace incise::mesh_io {
namespace {

using core::Vec3;
using core::VertexId;
using Json = GlbDocument::Json;

// Nodes may share meshes, and primitives and images data. What is read over and over, beyond this, is no body but a file that is made to fill the
// memory: values and bytes of images, at least the first, and this for each byte of data.
constexpr std::size_t kLeastRead = 1'000'000, kMostRead = 2;

// From the frame of a node to the body's.
struct Affine {
  Vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1}, origin{};

  Vec3 direction(const Vec3& p) const { return p.x * x + p.y * y + p.z * z; }
  Vec3 point(const Vec3& p) const { return direction(p) + origin; }
  Affine operator*(const Affine& b) const {
    return {direction(b.x), direction(b.y), direction(b.z), point(b.origin)};
  }
  bool mirrors() const { return dot(cross(x, y), z) < 0; }
  // The direction of a normal: by the cofactors, which are the inverse transposed but for a factor.
  Vec3 normal(const Vec3& n) const {
    const Vec3 turned = n.x * cross(y, z) + n.y * cross(z, x) + n.z * cross(x, y);
    const double size = length(turned);
    if (!(size > 0) || !std::isfinite(size)) return {};
    return ((mirrors() ? -1 : 1) / size) * turned;
  }
};

// glTF's numbers for colours are linear, 0 to 1; ours are sRGB.
double srgb(double linear) {
  const double x = std::clamp(linear, 0.0, 1.0);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

// 0 to 1 in a byte.
std::uint8_t in_byte(double x) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(x, 0.0, 1.0)));
}

// The file in an address: %20 is a blank.
std::string unescaped(const std::string& uri) {
  const auto digit = [](char c) {
    if (c >= '0' && c <= '9') return c - '0';
    const char low = static_cast<char>(c | 0x20);
    return low >= 'a' && low <= 'f' ? low - 'a' + 10 : -1;
  };
  std::string name;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    const bool escape =
        uri[i] == '%' && i + 2 < uri.size() && digit(uri[i + 1]) >= 0 && digit(uri[i + 2]) >= 0;
    name += escape ? static_cast<char>(16 * digit(uri[i + 1]) + digit(uri[i + 2])) : uri[i];
    if (escape) i += 2;
  }
  return name;
}

class GlbReader : GlbDocument {
 public:
  GlbReader(const std::filesystem::path& path, std::string_view bytes, std::vector<std::string>& warnings)
      : GlbDocument(path, bytes, warnings), path_(path), warnings_(warnings) {}

  Surface read() {
    for (const auto& [node, frame] : shown_nodes()) add_node(node, frame);
    SurfaceLook& look = surface_.look;
    // Triangles without a material have the last, which has no name.
    if (!look.materials.empty() &&
        std::find(look.material_of.begin(), look.material_of.end(), core::kNone) != look.material_of.end()) {
      std::replace(look.material_of.begin(), look.material_of.end(), core::kNone, new_material());
    } else if (look.materials.empty()) {
      look.material_of.clear();
    }
    return std::move(surface_);
  }

 private:
  Affine frame_of(const Json& node, const std::string& name) const {
    if (find(node, "matrix") != nullptr) {
      const auto m = numbers<16>(node, "matrix", {}, name);
      if (m[3] != 0 || m[7] != 0 || m[11] != 0 || m[15] != 1)
        fail(name + ": the last row of its matrix is not 0 0 0 1");
      return {{m[0], m[1], m[2]}, {m[4], m[5], m[6]}, {m[8], m[9], m[10]}, {m[12], m[13], m[14]}};
    }
    const auto t = numbers<3>(node, "translation", {0, 0, 0}, name);
    const auto s = numbers<3>(node, "scale", {1, 1, 1}, name);
    const auto [x, y, z, w] = numbers<4>(node, "rotation", {0, 0, 0, 1}, name);
    // Divided by the norm here, a quarter turn of rounded numbers stays exact.
    const double norm = x * x + y * y + z * z + w * w;
    if (!(norm > 0) || !std::isfinite(norm)) fail(name + ": its rotation is not a quaternion");
    const double f = 1 / norm;
    return {(s[0] * f) * Vec3{w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)},
            (s[1] * f) * Vec3{2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)},
            (s[2] * f) * Vec3{2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z},
            {t[0], t[1], t[2]}};
  }

  // The nodes of the default scene in the file's order, a parent before its children. A file without a scene shows all.
  std::vector<std::pair<std::size_t, Affine>> shown_nodes() const {
    const Json* nodes = find(json(), "nodes");
    const std::size_t count = nodes != nullptr && nodes->is_array() ? nodes->size() : 0;
    // glTF has y up, a body z.
    const Affine upright{{1, 0, 0}, {0, 0, 1}, {0, -1, 0}, {}};
    std::vector<std::pair<std::size_t, Affine>> open, shown;
    if (find(json(), "scenes") != nullptr) {
      const Json& scene = item("scenes", whole(json(), "scene", 0, "the document"), "the document");
      if (const Json* roots = find(scene, "nodes"); roots != nullptr && roots->is_array())
        for (const Json& root : *roots) open.emplace_back(index(root), upright);
    } else {
      std::vector<bool> is_child(count, false);
      for (std::size_t i = 0; i < count; ++i) {
        const Json* children = find((*nodes)[i], "children");
        if (children == nullptr) continue;
        for (const Json& child : *children)
          if (index(child) < count) is_child[index(child)] = true;
      }
      for (std::size_t i = 0; i < count; ++i)
        if (!is_child[i]) open.emplace_back(i, upright);
    }
    std::reverse(open.begin(), open.end());
    std::vector<bool> seen(count, false);
    while (!open.empty()) {
      const auto [i, parent] = open.back();
      open.pop_back();
      const Json& node = item("nodes", i, "the scene");
      const std::string name = "node " + std::to_string(i);
      if (seen[i]) fail(name + " is in the scene twice: its nodes are not a tree");
      seen[i] = true;
      shown.emplace_back(i, parent * frame_of(node, name));
      const Json* children = find(node, "children");
      if (children == nullptr || !children->is_array()) continue;
      for (auto child = children->rbegin(); child != children->rend(); ++child)
        open.emplace_back(index(*child), shown.back().second);
    }
    return shown;
  }

  void add_node(std::size_t i, const Affine& frame) {
    const Json& node = (*find(json(), "nodes"))[i];
    if (find(node, "mesh") == nullptr) return;
    const std::string name = "node " + std::to_string(i);
    if (find(node, "skin") != nullptr)
      fail(name + " is posed by a skeleton (skin): apply the pose to the mesh and save it again");
    const std::size_t mesh = whole(node, "mesh", 0, name);
    const Json* primitives = find(item("meshes", mesh, name), "primitives");
    if (primitives == nullptr || !primitives->is_array()) return;
    for (std::size_t k = 0; k < primitives->size(); ++k)
      add_primitive((*primitives)[k], frame,
                    "mesh " + std::to_string(mesh) + ", primitive " + std::to_string(k));
  }

  void count(std::size_t read) {
    read_ += read;
    if (read_ > kLeastRead && read_ / kMostRead > data_size())
      fail("its nodes, meshes or images repeat the same data too often: save each part once");
  }

  void add_primitive(const Json& primitive, const Affine& frame, const std::string& name) {
    count(1);
    const std::size_t mode = whole(primitive, "mode", 4, name);
    if (mode < 4) {
      warn(name + " is of points or lines, which are left out");
      return;
    }
    if (mode != 4) fail(name + " is a strip or fan of triangles: save it as single triangles (mode 4)");
    if (find(primitive, "targets") != nullptr) warn(name + ": its morph targets are left out");
    const Json* attributes = find(primitive, "attributes");
    const Json* position = attributes != nullptr ? find(*attributes, "POSITION") : nullptr;
    if (position == nullptr) fail(name + " has no POSITION");
    const std::size_t rows = accessor(index(*position), "POSITION").rows;
    const Accessor positions = attribute(*attributes, "POSITION", rows, 3, false);
    std::vector<VertexId> corners = corners_of(primitive, rows, name);
    count(rows + corners.size());
    if (surface_.positions.size() + rows > kMaxSurfaceVertices)
      fail("more than " + std::to_string(kMaxSurfaceVertices) + " vertices");
    const std::size_t base = surface_.positions.size(), before = 3 * surface_.triangles.size();
    for (std::size_t v = 0; v < rows; ++v) {
      const Vec3 p = frame.point({positions.value(v, 0), positions.value(v, 1), positions.value(v, 2)});
      if (!core::is_finite(p)) fail(name + ", vertex " + std::to_string(v) + ": a coordinate is not finite");
      surface_.positions.push_back(p);
    }
    // Of a mirrored part the file's order is clockwise.
    if (frame.mirrors())
      for (std::size_t c = 0; c < corners.size(); c += 3) std::swap(corners[c + 1], corners[c + 2]);
    for (std::size_t c = 0; c < corners.size(); c += 3) {
      const auto at = [&](std::size_t k) { return static_cast<VertexId>(base + corners[c + k]); };
      surface_.triangles.push_back({at(0), at(1), at(2)});
    }
    add_look(primitive, *attributes, rows, corners, before, frame, name);
  }

  std::vector<VertexId> corners_of(const Json& primitive, std::size_t rows, const std::string& name) const {
    std::vector<VertexId> corners;
    if (find(primitive, "indices") == nullptr) {
      if (rows > kMaxSurfaceVertices) fail(name + " has " + std::to_string(rows) + " vertices");
      for (std::size_t v = 0; v < rows; ++v) corners.push_back(static_cast<VertexId>(v));
    } else {
      const Accessor indices = accessor(whole(primitive, "indices", 0, name), "indices");
      if (indices.columns != 1 || (indices.type != 5121 && indices.type != 5123 && indices.type != 5125))
        fail(indices.name + " (indices) is of a type that is not accepted there");
      corners.reserve(indices.rows);
      for (std::size_t i = 0; i < indices.rows; ++i) {
        const auto v = static_cast<std::size_t>(indices.type == 5125
                                                    ? load<std::uint32_t>(indices.first + i * indices.stride)
                                                    : indices.value(i, 0));
        if (v >= rows) {
          fail(name + ": vertex " + std::to_string(v) + " does not exist; there are " + std::to_string(rows) +
               ", counted from 0");
        }
        corners.push_back(static_cast<VertexId>(v));
      }
    }
    if (corners.size() % 3 != 0)
      fail(name + " has " + std::to_string(corners.size()) + " corners, which are no whole triangles");
    return corners;
  }

  // What the corners look like: `make` of each one's vertex; `none` where there are no data, but other primitives have them.
  template <class T, class Make>
  void spread(std::vector<T>& values, const Accessor& from, const std::vector<VertexId>& corners,
              std::size_t before, const T& none, const Make& make) {
    if (from.first == nullptr && values.empty()) return;
    values.resize(before, none);
    for (const VertexId v : corners) values.push_back(from.first == nullptr ? none : make(v));
  }

  void add_look(const Json& primitive, const Json& attributes, std::size_t rows,
                const std::vector<VertexId>& corners, std::size_t before, const Affine& frame,
                const std::string& name) {
    SurfaceLook& look = surface_.look;
    std::uint32_t material = core::kNone;
    std::size_t set = 0;  // of texture coordinates
    if (find(primitive, "material") != nullptr)
      std::tie(material, set) = material_of(whole(primitive, "material", 0, name), name);
    look.material_of.resize(surface_.triangles.size(), material);

    const Accessor uvs = attribute(attributes, "TEXCOORD_" + std::to_string(set), rows, 2, true);
    // glTF's v points down.
    spread(look.uvs, uvs, corners, before, {}, [&](VertexId v) {
      return std::array<float, 2>{finite(uvs, v, 0), 1 - finite(uvs, v, 1)};
    });
    const Accessor normals = attribute(attributes, "NORMAL", rows, 3, false);
    spread(look.normals, normals, corners, before, {}, [&](VertexId v) {
      const Vec3 n = frame.normal({finite(normals, v, 0), finite(normals, v, 1), finite(normals, v, 2)});
      return std::array<float, 3>{static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)};
    });
    const Accessor colours = attribute(attributes, "COLOR_0", rows, 4, true);
    spread(look.colours, colours, corners, before, {255, 255, 255, 255}, [&](VertexId v) {
      std::array<std::uint8_t, 4> colour{255, 255, 255, 255};
      for (std::size_t k = 0; k < 3; ++k)
        colour[k] = in_byte(srgb(static_cast<double>(finite(colours, v, k))));
      if (colours.columns == 4) colour[3] = in_byte(static_cast<double>(finite(colours, v, 3)));
      return colour;
    });
  }

  std::uint32_t new_material() {
    std::vector<Material>& materials = surface_.look.materials;
    if (materials.size() == kMaxMaterials) fail("more than " + std::to_string(kMaxMaterials) + " materials");
    materials.emplace_back();
    return static_cast<std::uint32_t>(materials.size() - 1);
  }

  // Where the surface has that material, and which texture coordinates its texture uses.
  std::pair<std::uint32_t, std::size_t> material_of(std::size_t i, const std::string& by) {
    const auto [known, is_new] = materials_.try_emplace(i);
    if (!is_new) return known->second;
    const Json& json = item("materials", i, by);
    const std::string name = "material " + std::to_string(i);
    const std::uint32_t made = new_material();
    Material& material = surface_.look.materials[made];
    if (const Json* called = find(json, "name"); called != nullptr && called->is_string())
      material.name = called->get<std::string>();
    // A name is a line of an .obj file.
    for (char& c : material.name)
      if (static_cast<unsigned char>(c) < ' ') c = ' ';
    std::size_t set = 0;
    const Json* pbr = find(json, "pbrMetallicRoughness");
    const auto factor = numbers<4>(pbr != nullptr ? *pbr : json, "baseColorFactor", {1, 1, 1, 1}, name);
    for (std::size_t k = 0; k < 3; ++k) material.diffuse[k] = static_cast<float>(srgb(factor[k]));
    if (const Json* texture = pbr != nullptr ? find(*pbr, "baseColorTexture") : nullptr; texture != nullptr) {
      set = whole(*texture, "texCoord", 0, name);
      if (const Json* extensions = find(*texture, "extensions");
          extensions != nullptr && find(*extensions, "KHR_texture_transform") != nullptr)
        warn(name + ": KHR_texture_transform is left out: its texture may be shown in the wrong place");
      add_texture(item("textures", whole(*texture, "index", 0, name), name), material, name);
    }
    return known->second = {made, set};
  }

  // The material's image. Materials with the same one share it.
  void add_texture(const Json& texture, Material& material, const std::string& by) {
    const Json* extensions = find(texture, "extensions");
    const Json* webp = extensions != nullptr ? find(*extensions, "EXT_texture_webp") : nullptr;
    const Json& source = webp != nullptr ? *webp : texture;
    if (find(source, "source") == nullptr) {
      warn(by + ": its texture has no image that is known, and is not shown");
      return;
    }
    const std::size_t i = whole(source, "source", 0, by);
    const auto [known, is_new] = images_.try_emplace(i);
    if (is_new) {
      const Json& image = item("images", i, by);
      known->second.name = material.name;
      const std::string name = "image " + std::to_string(i);
      const Json* uri = find(image, "uri");
      if (uri == nullptr || !uri->is_string()) {
        const auto bytes =
            view(whole(image, "bufferView", std::numeric_limits<std::size_t>::max(), name), name).first;
        count(bytes.size());
        use_image(path_, name, bytes, known->second, warnings_);
      } else if (const auto& text = uri->get_ref<const std::string&>(); text.starts_with("data:")) {
        warn(name +
             " is text within the JSON (a data URI) and is not shown: save it as one .glb with its images as "
             "data");
      } else {
        read_texture(path_, unescaped(text), known->second, warnings_);
      }
    }
    material.image = known->second.image;
    material.image_type = known->second.image_type;
  }

  const std::filesystem::path& path_;
  std::vector<std::string>& warnings_;
  Surface surface_;
  std::map<std::size_t, std::pair<std::uint32_t, std::size_t>> materials_;  // by the file's number
  std::map<std::size_t, Material> images_;                                  // likewise
  std::size_t read_ = 0;                                                    // see kMostRead
};

// Programs that make a shape from a formula give the sides of its seam places that differ by a rounding: sin(2 pi) is not 0. Joins vertices on open
// edges that lie this near to each other, as a part of the surface's size; the rest stays as it is. Their number. O(n log n).
constexpr double kSameSeam = 1e-6;

std::size_t join_seams(Surface& surface) {
  std::vector<std::pair<VertexId, VertexId>> edges;
  edges.reserve(3 * surface.triangles.size());
  for (const auto& t : surface.triangles)
    for (std::size_t k = 0; k < 3; ++k) edges.push_back(std::minmax(t[k], VertexId{t[(k + 1) % 3]}));
  std::sort(edges.begin(), edges.end());
  std::vector<VertexId> open;
  for (std::size_t i = 0, end = 0; i < edges.size(); i = end) {
    while (end < edges.size() && edges[end] == edges[i]) ++end;
    if (end == i + 1) open.insert(open.end(), {edges[i].first, edges[i].second});
  }
  std::sort(open.begin(), open.end());
  open.erase(std::unique(open.begin(), open.end()), open.end());

  Vec3 low = surface.positions[0], high = low;
  for (const Vec3& p : surface.positions) core::extend(p, low, high);
  const Vec3 size = high - low;
  const double near = kSameSeam * std::max({size.x, size.y, size.z});
  if (!std::isfinite(near) || !std::isfinite(1 / near)) return 0;
  // Cells as wide as that: what is near lies in the same one or beside it.
  std::map<std::array<std::int64_t, 3>, std::vector<VertexId>> cells;
  std::map<VertexId, VertexId> joined;
  for (const VertexId v : open) {
    const Vec3 p = surface.positions[v], from = (1 / near) * (p - low);
    const std::array<std::int64_t, 3> cell{static_cast<std::int64_t>(from.x),
                                           static_cast<std::int64_t>(from.y),
                                           static_cast<std::int64_t>(from.z)};
    VertexId same = core::kNone;
    for (std::int64_t i = 0; i < 27 && same == core::kNone; ++i) {
      const auto found = cells.find({cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1});
      if (found == cells.end()) continue;
      for (const VertexId w : found->second)
        if (core::distance(p, surface.positions[w]) <= near) same = w;
    }
    if (same == core::kNone) {
      cells[cell].push_back(v);
    } else {
      joined[v] = same;
    }
  }
  for (auto& t : surface.triangles)
    for (VertexId& v : t)
      if (const auto found = joined.find(v); found != joined.end()) v = found->second;
  return joined.size();
}

}  // namespace

Surface read_glb(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  const std::string bytes = read_whole_file(path);
  Surface surface = finish(GlbReader(path, bytes, warnings).read(), path);
  const std::size_t joined = join_seams(surface);
  if (joined == 0) return surface;
  warnings.push_back(
      path.string() + ": " + std::to_string(joined) +
      " vertices on open edges became one with another that is nearer than a millionth of the size");
  return finish(std::move(surface), path);
}

}  // namespace incise::mesh_io
