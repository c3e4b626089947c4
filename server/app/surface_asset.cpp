#include "server/app/surface_asset.hpp"

#include <stdexcept>
#include <type_traits>

#include "protocol/framing.hpp"
#include "server/mesh_io/hash.hpp"

namespace incise::app {
namespace {

constexpr const char* kPath = "/surface";

static_assert(sizeof(core::Vec3) == 3 * sizeof(double) && std::is_trivially_copyable_v<core::Vec3>);

// An array of arrays of N numbers is an array of numbers.
template <class T, std::size_t N>
std::span<const T> flat(const std::vector<std::array<T, N>>& values) {
  return {values.empty() ? nullptr : values.front().data(), N * values.size()};
}

std::span<const double> flat(const std::vector<core::Vec3>& values) {
  return {reinterpret_cast<const double*>(values.data()), 3 * values.size()};
}

}  // namespace

protocol::SurfaceAsset asset_of(const mesh_io::Surface& surface) {
  const mesh_io::SurfaceLook& look = surface.look;
  protocol::SurfaceAsset asset;
  asset.positions = flat(surface.positions);
  asset.triangles = flat(surface.triangles);
  asset.uvs = flat(look.uvs);
  asset.normals = flat(look.normals);
  asset.colours = flat(look.colours);
  asset.material_indices = look.material_of;
  for (std::size_t i = 0; i < look.materials.size(); ++i) {
    const mesh_io::Material& material = look.materials[i];
    protocol::Material out{material.name.substr(0, protocol::kMaxNameBytes), material.diffuse, {}};
    if (material.image) {
      std::size_t first = 0;
      while (look.materials[first].image != material.image) ++first;
      out.texture =
          std::to_string(first) + "." + material.image_type.substr(material.image_type.find('/') + 1);
    }
    asset.materials.push_back(std::move(out));
  }
  return asset;
}

std::shared_ptr<const protocol::OriginTree> origin_tree(const mesh_io::Surface* surface) {
  if (surface == nullptr) return nullptr;
  return std::make_shared<const protocol::OriginTree>(flat(surface->positions), flat(surface->triangles));
}

ServedSurface served_surface(const mesh_io::Surface* surface, std::vector<std::string>& warnings) {
  ServedSurface served;
  if (surface == nullptr) return served;
  const protocol::SurfaceAsset asset = asset_of(*surface);
  try {
    const protocol::Frame frame = protocol::encode(asset);
    const auto bytes = frame.body();
    auto body =
        std::make_shared<const std::string>(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    mesh_io::ContentHash hash;
    hash.add(std::string_view(*body));
    served.facts =
        protocol::SurfaceFacts{static_cast<std::uint32_t>(surface->triangles.size()), kPath, hash.hex()};
    served.documents[kPath] = {"application/octet-stream", std::move(body)};
  } catch (const std::length_error& error) {
    warnings.push_back(std::string("viewers get no texture coordinates: the surface: ") + error.what());
    served.facts = protocol::SurfaceFacts{static_cast<std::uint32_t>(surface->triangles.size()), {}, {}};
    return served;
  }
  for (std::size_t i = 0; i < asset.materials.size(); ++i) {
    const std::string& name = asset.materials[i].texture;
    const mesh_io::Material& material = surface->look.materials[i];
    if (!name.empty())
      served.documents[std::string(kPath) + "/" + name] = {material.image_type, material.image};
  }
  return served;
}

}  // namespace incise::app
