#include "tests/bench/bench_util.hpp"

#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "server/base/check.hpp"
#include "server/base/hex.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/phantom.hpp"

namespace incise::bench {
namespace {

std::string text(const Cell& cell, int decimals) {
  if (const auto* s = std::get_if<std::string>(&cell)) return *s;
  if (const auto* n = std::get_if<std::int64_t>(&cell)) return std::to_string(*n);
  char buffer[64];
  std::snprintf(buffer, sizeof buffer, "%.*f", decimals, std::get<double>(cell));
  return buffer;
}

nlohmann::ordered_json to_json(const Cell& cell) {
  return std::visit([](const auto& value) { return nlohmann::ordered_json(value); }, cell);
}

void print_warnings(const std::string& name, const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings) std::fprintf(stderr, "%s: %s\n", name.c_str(), warning.c_str());
}

}  // namespace

double percentile(std::vector<double> samples, double p) {
  if (samples.empty()) return 0;
  std::sort(samples.begin(), samples.end());
  const double rank = std::ceil(p * static_cast<double>(samples.size()));
  return samples[static_cast<std::size_t>(std::max(rank, 1.0)) - 1];
}

void Report::table(std::string title, std::vector<Column> columns) {
  tables_.push_back({std::move(title), std::move(columns), {}});
}

void Report::row(std::vector<Cell> cells) {
  INCISE_CHECK(!tables_.empty() && cells.size() == tables_.back().columns.size(), cells.size());
  tables_.back().rows.push_back(std::move(cells));
}

void Report::print() const {
  if (bench_.empty()) return;
  json ? print_json() : print_text();
}

void Report::print_text() const {
  for (const auto& [name, value] : facts_) std::printf("%s: %s\n", name.c_str(), text(value, 6).c_str());
  for (const Table& table : tables_) {
    std::printf("\n%s\n", table.title.c_str());
    std::vector<std::vector<std::string>> lines(1);
    for (const Column& column : table.columns) lines[0].push_back(column.name);
    for (const auto& row : table.rows) {
      auto& line = lines.emplace_back();
      for (std::size_t i = 0; i < row.size(); ++i) line.push_back(text(row[i], table.columns[i].decimals));
    }
    std::vector<int> width(table.columns.size(), 0);
    for (const auto& line : lines) {
      for (std::size_t i = 0; i < line.size(); ++i)
        width[i] = std::max(width[i], static_cast<int>(line[i].size()));
    }
    for (const auto& line : lines) {
      for (std::size_t i = 0; i < line.size(); ++i) {
        // The first column names the row.
        std::printf(i == 0 ? "%-*s" : "  %*s", width[i], line[i].c_str());
      }
      std::printf("\n");
    }
  }
}

void Report::print_json() const {
  nlohmann::ordered_json out{{"bench", bench_}, {"facts", nlohmann::ordered_json::object()}};
  for (const auto& [name, value] : facts_) out["facts"][name] = to_json(value);
  out["tables"] = nlohmann::ordered_json::object();
  for (const Table& table : tables_) {
    auto rows = nlohmann::ordered_json::array();
    for (const auto& row : table.rows) {
      nlohmann::ordered_json object;
      for (std::size_t i = 0; i < row.size(); ++i) object[table.columns[i].name] = to_json(row[i]);
      rows.push_back(std::move(object));
    }
    out["tables"][table.title] = std::move(rows);
  }
  std::printf("%s\n", out.dump(2).c_str());
}

Cell hex(std::uint64_t hash) {
  return incise::hex(hash);
}

NamedMesh load(const std::string& path, double scale) {
  mesh_io::LoadOptions options;
  options.scale_to_metres = scale;
  mesh_io::LoadedMesh loaded = mesh_io::load_mesh(path, options);
  print_warnings(path, loaded.warnings);
  return {std::filesystem::path(path).stem().string(), std::move(loaded.mesh)};
}

NamedMesh phantom(const std::string& kind, std::size_t tets) {
  const auto found = mesh_io::phantom_kind(kind);
  if (!found) throw std::runtime_error("phantom '" + kind + "': not one of liver, cylinder, slab");
  mesh_io::FillOptions options;
  options.target_tets = tets;
  options.target_tolerance = 0.03;
  std::vector<std::string> warnings;
  NamedMesh named{kind + "_" + std::to_string(tets), mesh_io::make_phantom(*found, options, warnings)};
  print_warnings(named.name, warnings);
  return named;
}

std::string data_folder() {
  const char* folder = std::getenv("INCISE_DATA");
  return folder != nullptr ? folder : "";
}

std::pair<core::Vec3, core::Vec3> bounds(const core::MeshData& mesh) {
  INCISE_CHECK(!mesh.positions.empty());
  core::Vec3 low = mesh.positions[0], high = low;
  for (const core::Vec3& p : mesh.positions) {
    extend(p, low, high);
  }
  return {low, high};
}

ThroughCut through_cut(const core::MeshData& mesh, const core::Vec3& normal) {
  using core::Vec3;
  const auto [low, high] = bounds(mesh);
  const Vec3 n = core::normalized(normal);
  const Vec3 other = std::abs(n.x) < 0.9 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  const Vec3 along = core::normalized(core::cross(n, other)), ahead = core::cross(n, along);
  const Vec3 middle = 0.5 * (low + high);
  const double reach = 0.6 * core::distance(low, high);
  const auto line = [&](double s) {
    const Vec3 p = middle + s * ahead;
    return core::BladeLine{p - reach * along, p + reach * along};
  };
  return {line(-reach), line(reach)};
}

core::CutConfig bench_config(core::Policy policy) {
  core::CutConfig config;
  config.policy = policy;
  config.always_engaged = true;
  config.speed_limit_m_s = 1e9;
  config.gap_limit_s = 1e9;
  return config;
}

void push(core::CutSession& session, const ThroughCut& cut, int segments) {
  // The tool's frame is the world's, moved: the blade is the first line, the motion a translation.
  session.set_blade(0, {cut.from.heel, cut.from.tip});
  for (int i = 0; i <= segments; ++i) {
    core::Pose pose;
    pose.t_ns = 1'000'000ll * (i + 1);
    pose.position = (static_cast<double>(i) / segments) * (cut.to.heel - cut.from.heel);
    INCISE_CHECK(core::accepted(session.push(0, pose)), i);
  }
  session.end_stroke(0);
}

SessionTotals run_all(core::CutSession& session) {
  SessionTotals totals;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  core::Delta delta;
  while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    const core::CutCounts& c = session.committed_counts();
    ++totals.batches;
    totals.counts.events += c.events;
    totals.counts.snaps += c.snaps;
    totals.counts.splits += c.splits;
    totals.counts.failed += c.failed;
    totals.counts.removed_tets += c.removed_tets;
    totals.counts.repairs += c.repairs;
    totals.counts.cut_faces += c.cut_faces;
    totals.counts.cut_area += c.cut_area;
    totals.counts.max_deviation_h = std::max(totals.counts.max_deviation_h, c.max_deviation_h);
  }
  totals.work_units = INT64_MAX - budget.left;
  return totals;
}

}  // namespace incise::bench
