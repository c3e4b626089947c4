#include <algorithm>
#include <charconv>
#include <chrono>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "protocol/motion.hpp"
#include "server/app/body.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/core/cut_session.hpp"
#include "server/core/measure.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;
using std::chrono::steady_clock;

// What a session did with a motion, batch by batch.
struct Tally {
  const double tolerance_m;  // of the swept surface that the cut is compared with
  core::CutCounts sum;
  std::uint64_t batches = 0;
  std::vector<double> batch_us;
  core::SweptSurface swept;
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};  // of the blade's lines

  void add(const core::Batch& batch, const core::CutCounts& counts, double us) {
    ++batches;
    batch_us.push_back(us);
    sum.events += counts.events;
    sum.snaps += counts.snaps;
    sum.splits += counts.splits;
    sum.failed += counts.failed;
    sum.removed_tets += counts.removed_tets;
    core::add_sweep(swept, batch.lines, tolerance_m);
    for (const core::BladeLine& line : batch.lines) {
      for (const core::Vec3& p : {line.heel, line.tip}) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
      }
    }
  }
  double quantile_us(double q) const {
    if (batch_us.empty()) return 0;
    std::vector<double> sorted = batch_us;
    const auto k = static_cast<std::size_t>(std::llround(q * static_cast<double>(sorted.size() - 1)));
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(k), sorted.end());
    return sorted[k];
  }
};

double middle(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// What counts as a jump or as a silence, for a recorded motion whose rate, and a mesh whose units, nobody has stated:
// the server's limits, which are a hand's, or many times what is usual in this motion and for a body of this size.
// A limit that the configuration sets to something else than the default stands.
void fit_limits(core::CutConfig& cut, const RecordedMotion& motion, double body_size_m) {
  constexpr double kBodiesPerSecond = 10, kTimesUsualSpeed = 20, kTimesUsualGap = 5;
  std::array<const core::Pose*, core::kMaxSources> last{};
  std::vector<double> gaps_s, speeds_m_s;
  for (const MotionEvent& event : motion.events) {
    if (event.kind != MotionEvent::Kind::kPose) continue;
    const core::Pose*& previous = last[event.source];
    if (previous && event.pose.t_ns > previous->t_ns) {
      const core::BladeLine a = core::blade_line(cut.blade, *previous),
                            b = core::blade_line(cut.blade, event.pose);
      const double step_m = std::max(core::distance(a.heel, b.heel), core::distance(a.tip, b.tip));
      gaps_s.push_back(static_cast<double>(event.pose.t_ns - previous->t_ns) * 1e-9);
      if (step_m > 0) speeds_m_s.push_back(step_m / gaps_s.back());
    }
    previous = &event.pose;
  }
  const core::CutConfig defaults;
  if (cut.speed_limit_m_s == defaults.speed_limit_m_s) {
    cut.speed_limit_m_s = std::max(
        {defaults.speed_limit_m_s, kBodiesPerSecond * body_size_m, kTimesUsualSpeed * middle(speeds_m_s)});
  }
  if (cut.gap_limit_s == defaults.gap_limit_s) {
    cut.gap_limit_s = std::max(defaults.gap_limit_s, kTimesUsualGap * middle(gaps_s));
  }
}

std::string box_text(const core::Vec3& low, const core::Vec3& high) {
  const auto point = [](const core::Vec3& p) {
    return "(" + short_number(p.x) + ", " + short_number(p.y) + ", " + short_number(p.z) + ")";
  };
  return point(low) + " to " + point(high);
}

std::string hex(std::uint64_t hash) {
  char text[17];
  std::snprintf(text, sizeof text, "%016" PRIx64, hash);
  return text;
}

}  // namespace

int run_cut(const CutCommand& command) {
  require_mesh_output(command.out, "--out");
  if (!command.report.empty()) require_writable(command.report, "--report");
  RecordedMotion motion = read_recorded_motion(command.poses);
  std::vector<std::string> warnings = motion.warnings;

  Config config;
  if (!command.config.empty()) {
    config = load_config(command.config);
  } else if (motion.header) {
    config = config_of(*motion.header, command.poses.string());
  }
  if (!command.blade.empty()) {  // for every source, whatever configuration or capture say
    config.cut.blade = to_core(protocol::parse_blade("--blade", command.blade));
    config.sources.clear();
    for (MotionEvent& event : motion.events) event.blade.reset();
  }
  if (!command.policy.empty())
    config.cut.policy = command.policy == "croll" ? core::Policy::kCroll : core::Policy::kConforming;
  if (!command.growth.empty()) {
    config.cut.growth = command.growth == "none" ? core::Growth::kNoGrowth : core::Growth::kBalanced;
  }
  config.cut.always_engaged = true;

  Progress filling("filling " + command.mesh.filename().string());
  const mesh_io::LoadedMesh loaded = mesh_io::load_mesh(
      command.mesh, load_options(config, [&](std::string_view stage, double) { filling.show(-1, stage); }));
  warnings.insert(warnings.end(), loaded.warnings.begin(), loaded.warnings.end());

  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  for (const core::Vec3& p : loaded.mesh.positions) {
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  if (!motion.header) fit_limits(config.cut, motion, core::distance(low, high));
  core::CutSession session(loaded.mesh, config.cut);
  const core::CutReport before = core::measure(session.mesh());
  if (session.mesh().initial_vertex_copies() > 0) {
    warnings.push_back(command.mesh.string() + ": " + std::to_string(session.mesh().initial_vertex_copies()) +
                       " vertices joined parts that merely touch there; each part has its own now");
  }

  Tally tally{0.001 * session.mesh().mean_edge_length(), {}, 0, {}, {}};
  core::Delta delta;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  const auto cut_all = [&] {
    while (session.backlog_batches() > 0) {
      const auto start = steady_clock::now();
      session.advance(budget, delta);
      const std::chrono::duration<double, std::micro> us = steady_clock::now() - start;
      tally.add(session.committed_batch(), session.committed_counts(), us.count());
    }
  };
  std::array<std::uint64_t, core::kPoseVerdicts> verdicts{};
  {
    Progress progress("cutting");
    for (std::size_t i = 0; i < motion.events.size(); ++i) {
      const MotionEvent& event = motion.events[i];
      if (event.kind == MotionEvent::Kind::kPose) {
        ++verdicts[static_cast<std::size_t>(session.push(event.source, event.pose))];
      } else if (event.kind != MotionEvent::Kind::kDeform) {  // which is of the vertices of another mesh
        apply(session, event, config);
      }
      cut_all();
      if (i % 64 == 0) progress.show(static_cast<double>(i) / static_cast<double>(motion.events.size()));
    }
    for (std::uint32_t source = 0; source < core::kMaxSources; ++source) session.end_stroke(source);
    cut_all();
  }
  for (std::size_t i = 0; i < verdicts.size(); ++i) {
    const auto verdict = static_cast<core::PoseVerdict>(i);
    if (verdicts[i] == 0 || verdict == core::PoseVerdict::kAccepted) continue;
    std::string line = command.poses.string() + ": " + std::to_string(verdicts[i]);
    if (verdict == core::PoseVerdict::kNewStroke) {
      line += " jumps began a new stroke: faster than cut.speed_limit_m_s = " +
              short_number(config.cut.speed_limit_m_s) +
              " or after more than cut.gap_limit_s = " + short_number(config.cut.gap_limit_s);
    } else {
      line += std::string(" poses were not taken: ") + core::to_string(verdict);
    }
    warnings.push_back(line);
  }

  const core::CutReport after = core::measure(session.mesh());
  if (after.cut_faces == 0) {
    warnings.push_back(
        tally.batches == 0
            ? command.poses.string() + ": the blade never moved far enough to cut; nothing was cut"
            : "nothing was cut: the blade swept " + box_text(tally.low, tally.high) + ", the mesh fills " +
                  box_text(low, high) + " (metres); check --blade, units and frames");
  }
  tally.swept.build();
  const core::Deviation deviation = core::deviation(session.mesh(), tally.swept);

  Json report;
  report["mesh"] = command.mesh.string();
  report["poses"] = command.poses.string();
  report["policy"] = config.cut.policy == core::Policy::kCroll ? "croll" : "conforming";
  report["h"] = session.mesh().mean_edge_length();
  report["vertices_before"] = before.vertices;
  report["tets_before"] = before.tets;
  report["vertices"] = after.vertices;
  report["tets"] = after.tets;
  report["pieces_before"] = before.pieces;
  report["pieces"] = after.pieces;
  report["islands"] = after.islands;
  report["cut_faces"] = after.cut_faces;
  report["cut_area"] = after.cut_area;
  report["events"] = tally.sum.events;
  report["snaps"] = tally.sum.snaps;
  report["splits"] = tally.sum.splits;
  report["failed_events"] = tally.sum.failed;
  report["removed_tets"] = tally.sum.removed_tets;
  report["inverted"] = after.inverted;
  report["volume_before"] = before.volume;
  report["volume_after"] = after.volume;
  report["min_dihedral_deg_before"] = before.min_dihedral_deg;
  report["min_dihedral_deg_after"] = after.min_dihedral_deg;
  report["dihedral_histogram"] = {{"bin_deg", core::kHistogramBin_deg}, {"tets", after.dihedral_histogram}};
  report["deviation_max_h"] = deviation.samples > 0 ? deviation.max_h : 0.0;
  report["deviation_mean_h"] = deviation.samples > 0 ? deviation.mean_h : 0.0;
  report["batches"] = tally.batches;
  report["poses_taken"] = verdicts[0] + verdicts[1];
  report["cut_time_us"] = {
      {"p50", tally.quantile_us(0.5)}, {"p99", tally.quantile_us(0.99)}, {"max", tally.quantile_us(1)}};
  report["state_hash"] = hex(session.mesh().state_hash());
  report["warnings"] = warnings;

  write_cut_mesh(command.out, session.mesh());
  if (!command.report.empty()) write_text(command.report, report.dump(2) + "\n");
  for (const std::string& warning : warnings) std::fprintf(stderr, "warning: %s\n", warning.c_str());
  if (command.json) {
    std::printf("%s\n", report.dump(2).c_str());
    return 0;
  }
  print_row("tetrahedra", std::to_string(before.tets) + " -> " + std::to_string(after.tets));
  print_row("pieces", std::to_string(before.pieces) + " -> " + std::to_string(after.pieces));
  print_row("cut faces",
            std::to_string(after.cut_faces) + ", " + short_number(after.cut_area * 1e4) + " cm2");
  print_row("deviation", "mean " + short_number(report["deviation_mean_h"]) + " h, max " +
                             short_number(report["deviation_max_h"]) +
                             " h (h = " + short_number(report["h"]) + " m)");
  print_row("smallest angle", short_number(before.min_dihedral_deg) + " -> " +
                                  short_number(after.min_dihedral_deg) + " degrees");
  print_row("inverted", std::to_string(after.inverted));
  print_row("batches", std::to_string(tally.batches) + ", p50 " + short_number(tally.quantile_us(0.5)) +
                           " us, max " + short_number(tally.quantile_us(1)) + " us");
  print_row("state hash", hex(session.mesh().state_hash()));
  print_row("written", command.out.string());
  return 0;
}

}  // namespace incise::app
