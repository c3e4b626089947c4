#include "server/mesh_io/tetgen_fill.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <numbers>
#include <optional>

#include "server/core/geometry/quality.hpp"
#include "server/mesh_io/hash.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/remesh.hpp"
#include "server/mesh_io/tetgen_child/exchange.hpp"
#include "server/mesh_io/tetgen_process.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

using core::MeshData;

// Part of the cache's key: increase it when the same options give a different mesh.
constexpr std::string_view kFillVersion = "incise fill 3";
// TetGen with q1.4 and a bound makes tetrahedra of about this share of the bound on average.
constexpr double kMeanShareOfBound = 0.48;
constexpr int kMaxRuns = 6;
constexpr double kVolumeTolerance = 1e-3;  // of the surface's volume; with Y the boundary is kept exactly

void check_options(const FillOptions& options, const std::string& file) {
  const auto& switches = options.tetgen_switches;
  const bool known = std::all_of(switches.begin(), switches.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
           std::strchr("./-+", c);
  });
  if (!known || switches.find('p') == switches.npos || switches.find('r') != switches.npos) {
    throw MeshError(
        file + ": the TetGen switches '" + switches +
        "' cannot be used: letters, digits, '.', '/', '-' and '+' with p and without r are accepted, as in "
        "pYq1.4");
  }
}

// Whether the switches contain a volume bound: an a with a number.
bool has_bound(const std::string& switches) {
  for (std::size_t i = 0; i + 1 < switches.size(); ++i) {
    if (switches[i] == 'a' && ((switches[i + 1] >= '0' && switches[i + 1] <= '9') || switches[i + 1] == '.'))
      return true;
  }
  return false;
}

template <class T>
void append_values(std::string& bytes, const T* values, std::size_t count) {
  if (count > 0) bytes.append(reinterpret_cast<const char*>(values), count * sizeof(T));
}

std::string encode_input(const ClosedSurface& closed) {
  FillInputHeader header{};
  std::memcpy(header.magic, kFillInputMagic, sizeof header.magic);
  header.points = closed.surface.positions.size();
  header.triangles = closed.surface.triangles.size();
  header.holes = closed.holes.size();
  header.regions = closed.regions.size();
  std::string bytes;
  append_values(bytes, &header, 1);
  append_values(bytes, closed.surface.positions.data(), header.points);
  append_values(bytes, closed.surface.triangles.data(), header.triangles);
  append_values(bytes, closed.holes.data(), header.holes);
  for (const auto& region : closed.regions) {
    const double values[5] = {region.seed.x, region.seed.y, region.seed.z, static_cast<double>(region.id),
                              -1};
    append_values(bytes, values, 5);
  }
  return bytes;
}

// The mesh in a file that incise-tetgen wrote. Nothing if it is not one.
std::optional<MeshData> decode_output(std::string_view bytes) {
  FillOutputHeader header;
  if (bytes.size() < sizeof header) return std::nullopt;
  std::memcpy(&header, bytes.data(), sizeof header);
  constexpr std::uint64_t kMost = std::uint64_t{1} << 32;
  if (std::memcmp(header.magic, kFillOutputMagic, sizeof header.magic) != 0 || header.points >= kMost ||
      header.tets >= kMost || header.has_regions > 1) {
    return std::nullopt;
  }
  const std::uint64_t tet_size = header.has_regions ? 20 : 16;
  if (bytes.size() != sizeof header + 24 * header.points + tet_size * header.tets) return std::nullopt;
  MeshData mesh;
  mesh.positions.resize(header.points);
  mesh.tets.resize(header.tets);
  const char* next = bytes.data() + sizeof header;
  const auto take = [&next](auto& values) {
    const std::size_t size = values.size() * sizeof(values[0]);
    if (size > 0) std::memcpy(values.data(), next, size);
    next += size;
  };
  take(mesh.positions);
  take(mesh.tets);
  if (header.has_regions) {
    mesh.regions.resize(header.tets);
    take(mesh.regions);
  }
  for (const auto& tet : mesh.tets) {
    for (const core::VertexId v : tet) {
      if (v >= header.points) return std::nullopt;
    }
  }
  return mesh;
}

std::string encode_output(const MeshData& mesh) {
  FillOutputHeader header{};
  std::memcpy(header.magic, kFillOutputMagic, sizeof header.magic);
  header.points = mesh.positions.size();
  header.tets = mesh.tets.size();
  header.has_regions = !mesh.regions.empty();
  std::string bytes;
  append_values(bytes, &header, 1);
  append_values(bytes, mesh.positions.data(), mesh.positions.size());
  append_values(bytes, mesh.tets.data(), mesh.tets.size());
  append_values(bytes, mesh.regions.data(), mesh.regions.size());
  return bytes;
}

// ------------------------------------------------------------------------------------------------- the cache

std::filesystem::path cache_directory(const FillOptions& options) {
  if (!options.cache_dir.empty()) return options.cache_dir;
  if (const char* base = std::getenv("XDG_CACHE_HOME"); base && *base)
    return std::filesystem::path(base) / "incise";
  if (const char* home = std::getenv("HOME"); home && *home)
    return std::filesystem::path(home) / ".cache" / "incise";
  return {};
}

std::string cache_key(const ClosedSurface& closed, const FillOptions& options) {
  ContentHash hash;
  hash.add(kFillVersion);
  hash.add(options.tetgen_switches);
  hash.add(static_cast<std::uint64_t>(has_bound(options.tetgen_switches) ? 0 : options.target_tets));
  hash.add(&options.target_tolerance, sizeof options.target_tolerance);
  hash.add(std::string_view(encode_input(closed)));
  return hash.hex();
}

// How many triangles the surface had, and how many it has after those that were too large were split; 0 where none were.
struct SplitTriangles {
  std::uint64_t before = 0, after = 0;
};
struct CachedFill {
  MeshData mesh;
  SplitTriangles split;
};

constexpr std::size_t kDigestLength = 64;

std::string digest(std::string_view bytes) {
  ContentHash hash;
  hash.add(bytes);
  return hash.hex();
}

// An entry is the mesh, what was split, so that a fill from here is reported like a new one, and the digest of these bytes. A missing,
// torn or altered one does not count.
std::optional<CachedFill> read_cache(const std::filesystem::path& entry) {
  try {
    if (!std::filesystem::exists(entry)) return std::nullopt;
    const std::string bytes = read_whole_file(entry);
    if (bytes.size() < sizeof(SplitTriangles) + kDigestLength) return std::nullopt;
    const std::string_view contents = std::string_view(bytes).substr(0, bytes.size() - kDigestLength);
    if (digest(contents) != bytes.substr(contents.size())) return std::nullopt;
    const std::size_t mesh_size = contents.size() - sizeof(SplitTriangles);
    auto mesh = decode_output(contents.substr(0, mesh_size));
    if (!mesh) return std::nullopt;
    CachedFill cached{std::move(*mesh), {}};
    std::memcpy(&cached.split, contents.data() + mesh_size, sizeof cached.split);
    return cached;
  } catch (const MeshError&) {
    return std::nullopt;
  } catch (const std::filesystem::filesystem_error&) {
    return std::nullopt;
  }
}

void write_cache(const std::filesystem::path& entry, const MeshData& mesh, const SplitTriangles& split,
                 std::vector<std::string>& warnings) {
  try {
    std::filesystem::create_directories(entry.parent_path());
    std::string bytes = encode_output(mesh);
    append_values(bytes, &split, 1);
    bytes += digest(bytes);
    write_whole_file(entry, bytes);
  } catch (const std::exception& error) {
    warnings.push_back(std::string("the fill is not kept for the next start: ") + error.what());
  }
}

// -------------------------------------------------------------------------------------------------- one run

std::string describe(const ChildResult& result) {
  std::string text;
  if (!result.last_stage.empty()) text += ", while " + result.last_stage;
  if (!result.last_line.empty() && !result.last_line.ends_with("..."))
    text += ", saying '" + result.last_line + "'";
  return text;
}

MeshData run_tetgen(const ClosedSurface& closed, const std::string& file, const std::string& switches,
                    const FillOptions& options) {
  const MemoryFile input(encode_input(closed)), output;
  const int files[] = {input.descriptor(), output.descriptor()};
  const auto seconds = std::chrono::ceil<std::chrono::seconds>(options.time_limit).count();
  const std::string program = tetgen_program(options.tetgen_directory);
  const ChildResult result =
      run_child(program,
                {"--switches", switches, "--memory-mb", std::to_string(options.memory_limit_mb), "--cpu-s",
                 std::to_string(std::max<long>(seconds, 1)), input.path(), output.path()},
                files, options.time_limit, options.progress);
  const std::string who = file + ": TetGen (switches " + switches + ") ";
  switch (result.end) {
    case ChildResult::End::kNotStarted:
      throw MeshError(file + ": the program '" + program +
                      "' that fills surfaces cannot be started: " + std::strerror(result.code) +
                      "; install it beside this one or name it in INCISE_TETGEN");
    case ChildResult::End::kTimedOut:
      throw MeshError(
          who + "was stopped after " + to_text(static_cast<double>(options.time_limit.count()) / 1000) +
          " s" + describe(result) +
          ": raise the time limit, ask for fewer tetrahedra, or keep the surface's triangles (switch Y)");
    case ChildResult::End::kSignalled:
      throw MeshError(who + "died of signal " + std::to_string(result.code) + " (" + strsignal(result.code) +
                      ")" + describe(result) + ": remesh the surface, raise the memory limit (" +
                      std::to_string(options.memory_limit_mb) + " MB), or try other switches");
    case ChildResult::End::kExited:
      break;
  }
  if (result.code != 0) {
    throw MeshError(who + "failed with exit code " + std::to_string(result.code) + describe(result) +
                    ": remesh the surface or try other switches");
  }
  std::optional<MeshData> mesh = decode_output(output.bytes());
  if (!mesh)
    throw MeshError(who + "ended well but left no readable result: check the program '" + program + "'");
  if (mesh->tets.empty()) throw MeshError(who + "found no volume to fill: is the surface closed?");
  return std::move(*mesh);
}

// The sum of the volumes; turns the mesh right-handed, which TetGen's order of vertices is not.
double turn_right_handed(MeshData& mesh) {
  double volume = 0;
  for (const auto& t : mesh.tets) {
    volume += core::signed_volume(mesh.positions[t[0]], mesh.positions[t[1]], mesh.positions[t[2]],
                                  mesh.positions[t[3]]);
  }
  if (volume < 0) {
    for (auto& t : mesh.tets) std::swap(t[2], t[3]);
  }
  return std::abs(volume);
}

MeshData checked_run(const ClosedSurface& closed, const std::string& file, std::string switches,
                     const FillOptions& options) {
  // A gives each tetrahedron the id of its region.
  if (!closed.regions.empty() && switches.find('A') == switches.npos) switches += 'A';
  MeshData mesh = run_tetgen(closed, file, switches, options);
  const double volume = turn_right_handed(mesh);
  if (!(std::abs(volume - closed.volume) <= kVolumeTolerance * closed.volume)) {
    throw MeshError(file + ": TetGen (switches " + switches + ") filled " + to_text(volume) +
                    " m^3 of the surface's " + to_text(closed.volume) + " m^3: try other switches");
  }
  return mesh;
}

double off_target(const MeshData& mesh, std::size_t target) {
  return std::abs(static_cast<double>(mesh.tets.size()) / static_cast<double>(target) - 1.0);
}

// The length to which a surface's edges are split: 2 edges of a regular tetrahedron of the wanted mean volume,
// but on a thin sheet no less than gives half as many triangles as tetrahedra.
double split_length(const Surface& surface, double volume, double target) {
  double area = 0;
  for (const auto& t : surface.triangles) {
    const auto& p = surface.positions;
    area += 0.5 * length(cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]));
  }
  const double of_tets = 2 * std::cbrt(6 * std::numbers::sqrt2 * volume / target);
  const double of_triangles = std::sqrt(4 / std::numbers::sqrt3 * area / (0.5 * target));
  return std::max(of_tets, of_triangles);
}

// Tunes the volume bound: the count is nearly inverse to it, unless the surface's own triangles need more.
//
// Triangles much larger than the wanted tetrahedra are split first: since Y forbids TetGen to add vertices on the surface, it would
// put needles and slivers beneath them, and cuts that meet there come out worse.
MeshData fill_to_target(const ClosedSurface& given, const std::string& file, const FillOptions& options,
                        SplitTriangles& split_triangles) {
  const auto target = static_cast<double>(options.target_tets);
  ClosedSurface closed = given;
  split_long_edges(closed.surface, split_length(closed.surface, closed.volume, target));
  if (closed.surface.triangles.size() > given.surface.triangles.size())
    split_triangles = {given.surface.triangles.size(), closed.surface.triangles.size()};
  double bound = closed.volume / target / kMeanShareOfBound;
  MeshData best;
  double previous = 0;
  FillOptions remaining = options;
  const auto start = std::chrono::steady_clock::now();
  for (int run = 0; run < kMaxRuns; ++run) {
    const auto spent =
        std::chrono::floor<std::chrono::milliseconds>(std::chrono::steady_clock::now() - start);
    // Another run would take about as long: not worth the risk for a closer count.
    if (!best.tets.empty() && 2 * spent > options.time_limit) break;
    remaining.time_limit = options.time_limit - spent;
    MeshData mesh = checked_run(closed, file, options.tetgen_switches + "a" + to_text(bound), remaining);
    const auto count = static_cast<double>(mesh.tets.size());
    if (best.tets.empty() || off_target(mesh, options.target_tets) < off_target(best, options.target_tets)) {
      best = std::move(mesh);
    }
    if (off_target(best, options.target_tets) <= options.target_tolerance) break;
    // A larger bound that changed nothing: the surface alone makes this many.
    if (previous > 0 && count > target && count > 0.97 * previous) break;
    bound *= count / target;
    previous = count;
  }
  return best;
}

}  // namespace

Fill fill_surface(const ClosedSurface& closed, const std::string& file, const FillOptions& options,
                  std::vector<std::string>& warnings) {
  check_options(options, file);
  Fill fill;
  SplitTriangles split;
  std::filesystem::path entry;
  if (const auto directory = cache_directory(options); options.use_cache && !directory.empty()) {
    entry = directory / "fills" / (cache_key(closed, options) + ".tets");
    if (auto cached = read_cache(entry)) {
      fill.mesh = std::move(cached->mesh);
      split = cached->split;
      fill.from_cache = true;
    }
  }
  const bool tuned = options.target_tets > 0 && !has_bound(options.tetgen_switches);
  if (!fill.from_cache) {
    fill.mesh = tuned ? fill_to_target(closed, file, options, split)
                      : checked_run(closed, file, options.tetgen_switches, options);
  }
  if (split.after > 0) {
    warnings.push_back(file + ": triangles too large for " + std::to_string(options.target_tets) +
                       " tetrahedra are split: the surface's " + std::to_string(split.before) + " become " +
                       std::to_string(split.after));
  }
  if (tuned && off_target(fill.mesh, options.target_tets) > options.target_tolerance) {
    warnings.push_back(file + ": " + std::to_string(fill.mesh.tets.size()) + " tetrahedra instead of the " +
                       std::to_string(options.target_tets) + " wanted" +
                       (fill.mesh.tets.size() > options.target_tets
                            ? ": the surface's triangles are too fine for fewer"
                            : ""));
  }
  if (!fill.from_cache && !entry.empty()) write_cache(entry, fill.mesh, split, warnings);
  return fill;
}

}  // namespace incise::mesh_io
