#include "server/app/offline/cut_run.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/base/hex.hpp"
#include "server/base/wording.hpp"
#include "server/core/mesh/measure.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

// What a session did with a motion, batch by batch.
struct Tally {
  core::CutCounts sum = {};
  std::vector<double> batch_us = {};
  bool goes_on = false;  // the last batch is not complete: its next part adds to its time

  void add(const core::CutCounts& counts, bool whole, double us) {
    if (!goes_on) batch_us.push_back(0);
    batch_us.back() += us;
    goes_on = !whole;
    sum.events += counts.events;
    sum.snaps += counts.snaps;
    sum.splits += counts.splits;
    sum.failed += counts.failed;
    sum.removed_tets += counts.removed_tets;
  }
  double sum_us() const { return std::accumulate(batch_us.begin(), batch_us.end(), 0.0); }
  double quantile_us(double q) const {
    if (batch_us.empty()) return 0;
    std::vector<double> sorted = batch_us;
    const auto k = static_cast<std::size_t>(std::llround(q * static_cast<double>(sorted.size() - 1)));
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(k), sorted.end());
    return sorted[k];
  }
};

// The result for the mesh, of a whole motion.
Json report_of(const CutInput& in, const Config& config, const core::TetMesh& mesh,
               const core::CutReport& before, const core::SweptSurface& older, const Tally& tally,
               const core::SweptSurface& swept) {
  const core::CutReport after = core::measure(mesh);
  const core::Deviation deviation = core::deviation(mesh, swept, older);
  const bool croll = config.cut.policy == core::Policy::kCroll;
  Json report;
  report["mesh"] = in.mesh_name;
  report["poses"] = in.poses_name;
  report["policy"] = croll ? "croll" : "conforming";
  if (!croll) report["prefer"] = name_of(config.cut.prefer);
  report["h"] = mesh.mean_edge_length();
  report["vertices_before"] = before.vertices;
  report["tets_before"] = before.tets;
  report["vertices"] = after.vertices;
  report["tets"] = after.tets;
  report["pieces_before"] = before.pieces;
  report["pieces"] = after.pieces;
  report["islands"] = after.islands;
  // What the body came with is not counted.
  report["cut_faces"] = after.cut_faces - std::min(before.cut_faces, after.cut_faces);
  report["cut_area"] = std::max(after.cut_area - before.cut_area, 0.0);
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
  report["deviation_max_h"] = deviation.max_h;
  report["deviation_mean_h"] = deviation.mean_h;
  report["speed_limit_m_s"] = config.cut.speed_limit_m_s;
  report["gap_limit_s"] = config.cut.gap_limit_s;
  if (!in.raised_limits.empty()) report["raised_limits"] = in.raised_limits;
  report["batches"] = tally.batch_us.size();
  report["cut_time_us"] = {{"all", tally.sum_us()},
                           {"p50", tally.quantile_us(0.5)},
                           {"p99", tally.quantile_us(0.99)},
                           {"max", tally.quantile_us(1)}};
  report["state_hash"] = hex(mesh.state_hash());
  return report;
}

// What a server would not have cut with these poses. Empty: nothing.
std::string released_warning(const std::string& name, const RecordedMotion& motion, const Config& config) {
  if (!motion.has_buttons) return {};
  const auto released = std::ranges::count_if(motion.events, [&config](const MotionEvent& event) {
    return event.kind == MotionEvent::Kind::kPose && !config.cut.engages(event.pose.buttons);
  });
  if (released == 0) return {};
  return name + ": " + std::to_string(released) + " of " + counted(motion.poses(), "pose does", "poses do") +
         " not hold the button that engages the blade, and cut as well: here it is engaged throughout; "
         "`incise convert --config` cuts as a server does";
}

}  // namespace

const char* name_of(core::Preference prefer) {
  constexpr const char* kNames[] = {"no-growth", "balanced", "exact"};
  return kNames[static_cast<std::size_t>(prefer)];
}

void set_blade(const core::Blade& blade, Config& config, RecordedMotion& motion) {
  config.cut.blade = blade;
  config.sources.clear();
  for (MotionEvent& event : motion.events) event.blade.reset();
}

CutInput cut_input(std::string mesh_name, std::string poses_name, RecordedMotion motion, Config config,
                   std::shared_ptr<const mesh_io::LoadedMesh> loaded, Engage engage) {
  CutInput in{std::move(mesh_name),
              std::move(poses_name),
              std::move(motion),
              std::move(config),
              std::move(loaded),
              {},
              {},
              {}};
  in.warnings = in.motion.warnings;
  if (engage == Engage::kAlways) {
    if (std::string warning = released_warning(in.poses_name, in.motion, in.config); !warning.empty())
      in.warnings.push_back(std::move(warning));
    in.config.cut.always_engaged = true;
  }
  hold_button(in.motion, in.config);
  in.warnings.insert(in.warnings.end(), in.loaded->warnings.begin(), in.loaded->warnings.end());
  in.body = box_of(in.loaded->mesh);
  check_blade(in.config, in.motion, in.body.diagonal());
  in.raised_limits = suit_limits(in.config, in.motion, in.body.diagonal());
  return in;
}

CutOutcome cut(const CutInput& in, const Config& config, Progress& progress, const CutHooks& hooks) {
  progress.stage("preparing");
  CutOutcome out{std::make_unique<core::CutSession>(in.loaded->mesh, config.cut, in.loaded->fields), {}};
  core::CutSession& session = *out.session;
  const core::CutReport before = core::measure(session.mesh());
  const core::SweptSurface older = core::cut_surface(session.mesh());
  std::vector<std::string> warnings = in.warnings;
  if (const auto copies = session.mesh().initial_vertex_copies(); copies > 0) {
    warnings.push_back(in.mesh_name + ": " + counted(copies, "vertex", "vertices") +
                       " joined parts that only touch there; now each part has its own");
  }
  Tally tally;
  progress.stage("cutting");
  MotionRun run(session, in.motion, config, in.poses_name);
  run.run({.deformations = false,  // they name vertices of another mesh
           .event =
               [&](const MotionEvent& event, core::PoseVerdict) {
                 if (hooks.event) hooks.event(session, event);
               },
           .commit =
               [&](const core::Delta& delta, double us) {
                 tally.add(session.committed_counts(), session.committed_whole(), us);
                 if (hooks.commit) hooks.commit(session, delta);
               }},
          progress);
  progress.stage("measuring");
  out.report = report_of(in, config, session.mesh(), before, older, tally, run.swept());
  out.report["poses_taken"] = run.poses_taken();
  for (std::string& warning : run.warnings(out.report["cut_faces"].get<std::uint32_t>(), in.body))
    warnings.push_back(std::move(warning));
  out.report["warnings"] = warnings;
  return out;
}

}  // namespace incise::app
