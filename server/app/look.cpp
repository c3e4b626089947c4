#include "server/app/look.hpp"

#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "server/input/hid/json_node.hpp"
#include "server/mesh_io/hash.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/read_materials.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/volume_image.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;
using core::Vec3;
using mesh_io::Affine;

constexpr const char* kLookPath = "/look.json";
constexpr std::uint32_t kRegionSide = 128;  // samples of the regions along the body's longest side
constexpr std::uint8_t kNoRegion = 255;
constexpr std::size_t kMaxShownRegions = 255;
constexpr std::size_t kMaxTextureBytes = 16 << 20;
constexpr double kDarkShare = 0.01, kBrightShare = 0.99;

struct Box {
  Vec3 low, high;
};

Box box_of(const core::MeshData& mesh) {
  Box box{mesh.positions.front(), mesh.positions.front()};
  for (const Vec3& p : mesh.positions) {
    box.low = {std::min(box.low.x, p.x), std::min(box.low.y, p.y), std::min(box.low.z, p.z)};
    box.high = {std::max(box.high.x, p.x), std::max(box.high.y, p.y), std::max(box.high.z, p.z)};
  }
  return box;
}

stream::Document gzipped(const std::vector<std::uint8_t>& bytes) {
  z_stream z{};
  // 16 + window bits: with gzip's header, which browsers unpack (DecompressionStream).
  if (deflateInit2(&z, 4, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK) throw std::bad_alloc();
  std::string out(deflateBound(&z, bytes.size()), '\0');
  z.next_in = const_cast<Bytef*>(bytes.data());
  z.avail_in = static_cast<uInt>(bytes.size());
  z.next_out = reinterpret_cast<Bytef*>(out.data());
  z.avail_out = static_cast<uInt>(out.size());
  deflate(&z, Z_FINISH);
  out.resize(z.total_out);
  deflateEnd(&z);
  return {"application/gzip", std::make_shared<const std::string>(std::move(out))};
}

// An image of one byte a sample as a document, and what look.json says of it.
Json serve_samples(const std::string& path, const std::array<std::uint32_t, 3>& size,
                   const Affine& unit_from_rest, const std::vector<std::uint8_t>& samples,
                   stream::Documents& documents) {
  mesh_io::ContentHash hash;
  hash.add(samples);
  std::vector<double> rows;
  for (const auto& row : unit_from_rest) rows.insert(rows.end(), row.begin(), row.end());
  documents[path] = gzipped(samples);
  return {{"path", path}, {"size", size}, {"texture_from_rest", rows}, {"content_hash", hash.hex()}};
}

// ------------------------------------------------------------------------------------------------ the volume image

// Throws ConfigError.
mesh_io::VolumeImage read_image(const Config& config, const std::string& file) {
  try {
    return mesh_io::read_volume_image(config.resolve(config.mesh.image));
  } catch (const mesh_io::MeshError& error) {
    throw ConfigError(file + ": mesh.image: " + error.what());
  }
}

// Where the image's box, 0 to 1, is in the body at rest, metres.
Affine rest_from_unit(const Config& config, const mesh_io::VolumeImage& image) {
  Affine m = image.mm_from_unit;
  const Vec3& origin = config.mesh.image_origin;
  for (std::size_t i = 0; i < 3; ++i) {
    const double flip = image.anatomical && i < 2 && config.mesh.image_space == "RAS" ? -1 : 1;
    for (double& x : m[i]) x *= flip * config.mesh.image_scale_to_metres;
    m[i][3] += i == 0 ? origin.x : i == 1 ? origin.y : origin.z;
  }
  return m;
}

// The image's samples in the body's box.
std::vector<float> samples_in(const Box& box, const mesh_io::VolumeImage& image, const Affine& from_unit) {
  std::vector<float> found;
  std::size_t at = 0;
  for (std::uint32_t k = 0; k < image.size[2]; ++k)
    for (std::uint32_t j = 0; j < image.size[1]; ++j)
      for (std::uint32_t i = 0; i < image.size[0]; ++i, ++at) {
        const Vec3 p = mesh_io::apply(
            from_unit, {(i + 0.5) / image.size[0], (j + 0.5) / image.size[1], (k + 0.5) / image.size[2]});
        if (p.x >= box.low.x && p.x <= box.high.x && p.y >= box.low.y && p.y <= box.high.y &&
            p.z >= box.low.z && p.z <= box.high.z)
          found.push_back(image.values[at]);
      }
  return found;
}

std::array<double, 2> window_of(const Config& config, std::vector<float> samples) {
  if (!config.mesh.image_window.empty()) return {config.mesh.image_window[0], config.mesh.image_window[1]};
  const auto share = [&](double s) {
    const auto nth =
        samples.begin() + static_cast<std::ptrdiff_t>(s * static_cast<double>(samples.size() - 1));
    std::nth_element(samples.begin(), nth, samples.end());
    return static_cast<double>(*nth);
  };
  const double low = share(kDarkShare), high = share(kBrightShare);
  return {low, high > low ? high : low + 1};
}

std::string in_mm(const Vec3& p) {
  const auto text = [](double x) { return input::text_of(std::round(1e4 * x) / 10); };
  return "(" + text(p.x) + ", " + text(p.y) + ", " + text(p.z) + ")";
}

// The image's samples in the body's box, or all of them with a line in `warnings`.
std::vector<float> samples_to_see(const core::MeshData& mesh, const mesh_io::VolumeImage& image,
                                  const Affine& from_unit, std::vector<std::string>& warnings) {
  const Box box = box_of(mesh);
  std::vector<float> samples = samples_in(box, image, from_unit);
  if (!samples.empty()) return samples;
  warnings.push_back("mesh.image: no voxel of it lies in the body: its middle is at " +
                     in_mm(mesh_io::apply(from_unit, {0.5, 0.5, 0.5})) + " mm, that of the body at " +
                     in_mm(0.5 * (box.low + box.high)) +
                     " mm; see mesh.image_space, mesh.image_scale_to_metres and mesh.image_origin");
  return image.values;
}

Json serve_image(const Config& config, const core::MeshData& mesh, const std::string& file,
                 std::vector<std::string>& warnings, stream::Documents& documents) {
  const mesh_io::VolumeImage image = read_image(config, file);
  const Affine from_unit = rest_from_unit(config, image);
  std::vector<float> samples = samples_to_see(mesh, image, from_unit, warnings);
  const auto [low, high] = window_of(config, std::move(samples));
  std::vector<std::uint8_t> shown(image.values.size());
  for (std::size_t i = 0; i < shown.size(); ++i)
    shown[i] = static_cast<std::uint8_t>(
        std::lround(255 * std::clamp((static_cast<double>(image.values[i]) - low) / (high - low), 0.0, 1.0)));
  Json json = serve_samples("/look/image.gz", image.size, mesh_io::inverse(from_unit, "mesh.image"), shown,
                            documents);
  json["window"] = {low, high};
  return json;
}

// ------------------------------------------------------------------------------------------------ regions

std::map<std::int32_t, double> volumes_of(const core::MeshData& mesh) {
  std::map<std::int32_t, double> volumes;
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    const auto& v = mesh.tets[t];
    const Vec3& a = mesh.positions[v[0]];
    volumes[mesh.regions.empty() ? 0 : mesh.regions[t]] +=
        dot(cross(mesh.positions[v[1]] - a, mesh.positions[v[2]] - a), mesh.positions[v[3]] - a);
  }
  return volumes;
}

// Lines for materials of regions that the mesh does not have.
void warn_of_absent_regions(const Config& config, const core::MeshData& mesh,
                            std::vector<std::string>& warnings) {
  std::set<std::int32_t> there(mesh.regions.begin(), mesh.regions.end());
  if (there.empty()) there.insert(0);
  std::string list;
  std::size_t listed = 0;
  for (const std::int32_t region : there) {
    if (listed++ == 20) break;
    list += (list.empty() ? "" : ", ") + std::to_string(region);
  }
  if (there.size() > listed) list += " and others";
  for (const RegionLook& look : config.looks) {
    if (there.contains(look.region)) continue;
    warnings.push_back("materials: the mesh has no region " + std::to_string(look.region) +
                       ", so that entry changes nothing; it has " + list);
  }
}

// Paths of textures, in the order in which they are served.
class Textures {
 public:
  Textures(const Config& config, const std::string& file) : config_(config), file_(file) {}

  // The name of the document, "" for none. Throws ConfigError.
  std::string add(std::int32_t region, bool inside, const std::string& given, stream::Documents& documents) {
    if (given.empty()) return {};
    if (const auto known = names_.find(given); known != names_.end()) return known->second;
    stream::Document document = read_region_texture(config_, region, inside, given, file_);
    const std::string name =
        "/look/" + std::to_string(names_.size()) + "." + document.type.substr(document.type.find('/') + 1);
    documents[name] = std::move(document);
    return names_[given] = name;
  }

 private:
  const Config& config_;
  const std::string& file_;
  std::map<std::string, std::string> names_;
};

const Tissue& tissue_named(const std::string& name) {
  for (const Tissue& tissue : kTissues)
    if (name == tissue.name) return tissue;
  return kTissues[0];
}

// Regions that nobody has described differ in colour, so that they are seen apart.
constexpr std::array<double, 3> kTints[] = {{1, 1, 1},       {1.3, 2.2, 2.4}, {0.85, 1.5, 2.2},
                                            {1.4, 2.6, 1.4}, {0.6, 0.7, 1.0}, {1.0, 1.2, 2.6}};

SideLook side_look(const RegionLook::Side& side, const std::array<double, 3>& colour, double roughness,
                   const std::array<double, 3>& tint) {
  SideLook shown{side.colour.value_or(colour), side.roughness.value_or(roughness), side.texture};
  if (!side.colour)
    for (std::size_t i = 0; i < 3; ++i) shown.colour[i] = std::min(1.0, shown.colour[i] * tint[i]);
  return shown;
}

RegionLook look_of(const Config& config, std::int32_t region) {
  const auto found = std::find_if(config.looks.begin(), config.looks.end(),
                                  [&](const RegionLook& l) { return l.region == region; });
  if (found != config.looks.end()) return *found;
  return {.region = region, .tissue = {}, .surface = {}, .inside = {}, .vessels = {}, .fat_rim = {}};
}

std::vector<ShownRegion> shown_regions(const Config& config, const std::map<std::int32_t, double>& volumes) {
  std::vector<ShownRegion> list;
  // Without a word about it, a body of one tissue looks as viewers think best.
  if (volumes.size() < 2 && config.looks.empty()) return list;
  std::int32_t largest = 0;
  double most = -1;
  for (const auto& [region, volume] : volumes) {
    if (!look_of(config, region).tissue.empty() || volume <= most) continue;
    most = volume;
    largest = region;
  }
  std::size_t plain = 0;
  for (const auto& [region, volume] : volumes) {
    const RegionLook look = look_of(config, region);
    const Tissue& tissue = tissue_named(look.tissue);
    const bool tinted = look.tissue.empty() && region != largest;
    const auto& tint = kTints[tinted ? 1 + plain++ % (std::size(kTints) - 1) : 0];
    list.push_back({.region = region,
                    .tissue = look.tissue,
                    .surface = side_look(look.surface, tissue.surface, tissue.surface_roughness, tint),
                    .inside = side_look(look.inside, tissue.inside, tissue.inside_roughness, tint),
                    .pattern = tissue.pattern,
                    .vessels = look.vessels.value_or(tissue.vessels),
                    .fat_rim = look.fat_rim.value_or(tinted ? 0 : tissue.fat_rim)});
  }
  return list;
}

Json serve_regions(const Config& config, const std::vector<ShownRegion>& regions, const std::string& file,
                   stream::Documents& documents) {
  Textures textures(config, file);
  const auto side_json = [&](const ShownRegion& shown, bool inside) {
    const SideLook& side = inside ? shown.inside : shown.surface;
    Json json{{"colour", side.colour}, {"roughness", side.roughness}};
    const std::string texture = textures.add(shown.region, inside, side.texture, documents);
    if (!texture.empty()) json["texture"] = texture;
    return json;
  };
  Json list = Json::array();
  for (const ShownRegion& shown : regions) {
    if (list.size() == kMaxShownRegions) break;
    Json inside = side_json(shown, true);
    inside["pattern"] = shown.pattern;
    inside["vessels"] = shown.vessels;
    inside["fat_rim"] = shown.fat_rim;
    list.push_back(
        {{"region", shown.region}, {"surface", side_json(shown, false)}, {"inside", std::move(inside)}});
  }
  return list;
}

// For the section plane, whose pictures know only the body's skin: which region each place is, as its index in the list.
Json serve_region_image(const core::MeshData& mesh, const std::map<std::int32_t, double>& volumes,
                        stream::Documents& documents) {
  const Box box = box_of(mesh);
  const Vec3 extent = box.high - box.low;
  const double step = std::max({extent.x, extent.y, extent.z}) / kRegionSide;
  const auto count = [&](double length) {
    return static_cast<std::uint32_t>(std::clamp(std::ceil(length / step), 1.0, double{kRegionSide}));
  };
  const std::array<std::uint32_t, 3> size = {count(extent.x), count(extent.y), count(extent.z)};
  std::map<std::int32_t, std::uint8_t> index;
  for (const auto& [region, volume] : volumes)
    if (index.size() < kMaxShownRegions) index.emplace(region, static_cast<std::uint8_t>(index.size()));
  std::vector<std::uint8_t> samples(std::size_t{size[0]} * size[1] * size[2], kNoRegion);
  // Samples of one tetrahedron: those where all four barycentric coordinates are positive.
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    const auto named = index.find(mesh.regions[t]);
    if (named == index.end()) continue;
    std::array<Vec3, 4> p;
    for (std::size_t v = 0; v < 4; ++v)
      p[v] = (1 / step) * (mesh.positions[mesh.tets[t][v]] - box.low) - Vec3{0.5, 0.5, 0.5};
    std::array<long, 3> low{}, high{};
    const auto axis = [&](std::size_t a, auto of) {
      const auto [least, most] = std::minmax({of(p[0]), of(p[1]), of(p[2]), of(p[3])});
      low[a] = std::max(0L, std::lround(std::ceil(least)));
      high[a] = std::min(static_cast<long>(size[a]) - 1, std::lround(std::floor(most)));
    };
    axis(0, [](const Vec3& q) { return q.x; });
    axis(1, [](const Vec3& q) { return q.y; });
    axis(2, [](const Vec3& q) { return q.z; });
    const Vec3 u = p[1] - p[0], v = p[2] - p[0], w = p[3] - p[0];
    const double volume = dot(cross(u, v), w);
    for (long z = low[2]; z <= high[2]; ++z)
      for (long y = low[1]; y <= high[1]; ++y)
        for (long x = low[0]; x <= high[0]; ++x) {
          const Vec3 q = Vec3{static_cast<double>(x), static_cast<double>(y), static_cast<double>(z)} - p[0];
          const double b = dot(cross(q, v), w), c = dot(cross(u, q), w), d = dot(cross(u, v), q);
          if (b < 0 || c < 0 || d < 0 || b + c + d > volume) continue;
          samples[static_cast<std::size_t>(x) +
                  size[0] * (static_cast<std::size_t>(y) + size[1] * static_cast<std::size_t>(z))] =
              named->second;
        }
  }
  Affine unit_from_rest{};
  const double lows[3] = {box.low.x, box.low.y, box.low.z};
  for (std::size_t i = 0; i < 3; ++i) {
    unit_from_rest[i][i] = 1 / (step * size[i]);
    unit_from_rest[i][3] = -lows[i] / (step * size[i]);
  }
  return serve_samples("/look/regions.gz", size, unit_from_rest, samples, documents);
}

}  // namespace

std::vector<ShownRegion> shown_regions(const Config& config, const core::MeshData& mesh) {
  return shown_regions(config, volumes_of(mesh));
}

stream::Document read_region_texture(const Config& config, std::int32_t region, bool inside,
                                     const std::string& texture, const std::string& file) {
  const std::filesystem::path path = config.resolve(texture);
  const auto fail = [&](const std::string& why) {
    throw ConfigError(file + ": materials, region " + std::to_string(region) +
                      (inside ? ", inside" : ", surface") + ".texture: " + why);
  };
  std::error_code error;
  if (std::filesystem::file_size(path, error) > kMaxTextureBytes || error)
    fail(path.string() + ": " + (error ? error.message() : "more than 16 MB"));
  std::string bytes;
  try {
    bytes = mesh_io::read_whole_file(path);
  } catch (const mesh_io::MeshError& fault) {
    fail(fault.what());
  }
  const std::string type(mesh_io::image_type(bytes));
  if (type.empty()) fail(path.string() + ": not a PNG, JPEG or WebP image");
  if (const std::string fault = mesh_io::image_fault(bytes); !fault.empty())
    fail(path.string() + " " + fault);
  return {type, std::make_shared<const std::string>(std::move(bytes))};
}

bool drop_look_files(Config& config) {
  bool any = !config.mesh.image.empty();
  config.mesh.image.clear();
  for (RegionLook& look : config.looks) {
    for (RegionLook::Side* side : {&look.surface, &look.inside}) {
      any = any || !side->texture.empty();
      side->texture.clear();
    }
  }
  return any;
}

stream::Documents served_look(const Config& config, const core::MeshData& mesh, const std::string& file,
                              std::vector<std::string>& warnings) {
  stream::Documents documents;
  Json look = Json::object();
  warn_of_absent_regions(config, mesh, warnings);
  if (!config.mesh.image.empty()) look["image"] = serve_image(config, mesh, file, warnings, documents);
  const std::map<std::int32_t, double> volumes = volumes_of(mesh);
  if (const std::vector<ShownRegion> regions = shown_regions(config, volumes); !regions.empty()) {
    look["regions"] = serve_regions(config, regions, file, documents);
    if (volumes.size() > 1) look["region_image"] = serve_region_image(mesh, volumes, documents);
  }
  documents[kLookPath] = {"application/json", std::make_shared<const std::string>(look.dump())};
  return documents;
}

void check_look(const Config& config, const core::MeshData& mesh, const std::string& file,
                std::vector<std::string>& warnings) {
  if (!config.mesh.image.empty()) {
    const mesh_io::VolumeImage image = read_image(config, file);
    samples_to_see(mesh, image, rest_from_unit(config, image), warnings);
  }
  warn_of_absent_regions(config, mesh, warnings);
  Textures textures(config, file);
  stream::Documents scratch;
  for (const RegionLook& look : config.looks) {
    textures.add(look.region, false, look.surface.texture, scratch);
    textures.add(look.region, true, look.inside.texture, scratch);
  }
}

}  // namespace incise::app
