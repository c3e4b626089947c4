#include "server/app/look.hpp"

#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

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

Json serve_image(const Config& config, const core::MeshData& mesh, const std::string& file,
                 std::vector<std::string>& warnings, stream::Documents& documents) {
  const mesh_io::VolumeImage image = read_image(config, file);
  const Affine from_unit = rest_from_unit(config, image);
  const Box box = box_of(mesh);
  std::vector<float> samples = samples_in(box, image, from_unit);
  if (samples.empty()) {
    warnings.push_back("mesh.image: no voxel of it lies in the body: its middle is at " +
                       in_mm(mesh_io::apply(from_unit, {0.5, 0.5, 0.5})) + " mm, that of the body at " +
                       in_mm(0.5 * (box.low + box.high)) +
                       " mm; see mesh.image_space, mesh.image_scale_to_metres and mesh.image_origin");
    samples = image.values;
  }
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

// Paths of textures, in the order in which they are served.
class Textures {
 public:
  Textures(const Config& config, const std::string& file) : config_(config), file_(file) {}

  // The name of the document, "" for none. Throws ConfigError.
  std::string add(const RegionLook& look, bool inside, stream::Documents& documents) {
    const std::string& given = (inside ? look.inside : look.surface).texture;
    if (given.empty()) return {};
    if (const auto known = names_.find(given); known != names_.end()) return known->second;
    const std::string key =
        "materials, region " + std::to_string(look.region) + (inside ? ", inside" : ", surface") + ".texture";
    const std::filesystem::path path = config_.resolve(given);
    std::string bytes;
    std::error_code error;
    if (std::filesystem::file_size(path, error) > kMaxTextureBytes || error)
      throw ConfigError(file_ + ": " + key + ": " + path.string() + ": " +
                        (error ? error.message() : "more than 16 MB"));
    try {
      bytes = mesh_io::read_whole_file(path);
    } catch (const mesh_io::MeshError& fault) {
      throw ConfigError(file_ + ": " + key + ": " + fault.what());
    }
    const std::string type(mesh_io::image_type(bytes));
    if (type.empty())
      throw ConfigError(file_ + ": " + key + ": " + path.string() + ": not a PNG, JPEG or WebP image");
    const std::string name = "/look/" + std::to_string(names_.size()) + "." + type.substr(type.find('/') + 1);
    documents[name] = {type, std::make_shared<const std::string>(std::move(bytes))};
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

Json side_json(const RegionLook::Side& side, const std::array<double, 3>& colour, double roughness,
               const std::array<double, 3>& tint, const std::string& texture) {
  std::array<double, 3> shown = side.colour.value_or(colour);
  if (!side.colour)
    for (std::size_t i = 0; i < 3; ++i) shown[i] = std::min(1.0, shown[i] * tint[i]);
  Json json{{"colour", shown}, {"roughness", side.roughness.value_or(roughness)}};
  if (!texture.empty()) json["texture"] = texture;
  return json;
}

Json serve_regions(const Config& config, const std::map<std::int32_t, double>& volumes,
                   const std::string& file, stream::Documents& documents) {
  Textures textures(config, file);
  std::int32_t largest = 0;
  double most = -1;
  const auto look_of = [&](std::int32_t region) {
    const auto found = std::find_if(config.looks.begin(), config.looks.end(),
                                    [&](const RegionLook& l) { return l.region == region; });
    return found == config.looks.end() ? RegionLook{.region = region,
                                                    .tissue = {},
                                                    .surface = {},
                                                    .inside = {},
                                                    .vessels = {},
                                                    .fat_rim = {}}
                                       : *found;
  };
  for (const auto& [region, volume] : volumes) {
    if (!look_of(region).tissue.empty() || volume <= most) continue;
    most = volume;
    largest = region;
  }
  Json list = Json::array();
  std::size_t plain = 0;
  for (const auto& [region, volume] : volumes) {
    if (list.size() == kMaxShownRegions) break;
    const RegionLook look = look_of(region);
    const Tissue& tissue = tissue_named(look.tissue);
    const bool tinted = look.tissue.empty() && region != largest;
    const auto& tint = kTints[tinted ? 1 + plain++ % (std::size(kTints) - 1) : 0];
    Json inside = side_json(look.inside, tissue.inside, tissue.inside_roughness, tint,
                            textures.add(look, true, documents));
    inside["pattern"] = tissue.pattern;
    inside["vessels"] = look.vessels.value_or(tissue.vessels);
    inside["fat_rim"] = look.fat_rim.value_or(tinted ? 0 : tissue.fat_rim);
    list.push_back({{"region", region},
                    {"surface", side_json(look.surface, tissue.surface, tissue.surface_roughness, tint,
                                          textures.add(look, false, documents))},
                    {"inside", std::move(inside)}});
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

stream::Documents served_look(const Config& config, const core::MeshData& mesh, const std::string& file,
                              std::vector<std::string>& warnings) {
  stream::Documents documents;
  Json look = Json::object();
  if (!config.mesh.image.empty()) look["image"] = serve_image(config, mesh, file, warnings, documents);
  const std::map<std::int32_t, double> volumes = volumes_of(mesh);
  // Without a word about it, a body of one tissue looks as viewers think best.
  if (volumes.size() > 1 || !config.looks.empty()) {
    look["regions"] = serve_regions(config, volumes, file, documents);
    if (volumes.size() > 1) look["region_image"] = serve_region_image(mesh, volumes, documents);
  }
  documents[kLookPath] = {"application/json", std::make_shared<const std::string>(look.dump())};
  return documents;
}

void check_look(const Config& config, const std::string& file) {
  if (!config.mesh.image.empty()) read_image(config, file);
  Textures textures(config, file);
  stream::Documents scratch;
  for (const RegionLook& look : config.looks) {
    textures.add(look, false, scratch);
    textures.add(look, true, scratch);
  }
}

}  // namespace incise::app
