#include <algorithm>
#include <charconv>
#include <chrono>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <stdexcept>

#include "protocol/motion.hpp"
#include "server/app/body.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/base/hex.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"

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
        extend(p, low, high);
      }
    }
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
      const double step_m = travel(a, b);
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

// What is cut, and by what.
struct Input {
  RecordedMotion motion;
  Config config;
  mesh_io::LoadedMesh loaded;
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};  // of the mesh
  std::vector<std::string> warnings;
};

Input read_input(const CutCommand& command) {
  Input in;
  in.motion = read_recorded_motion(command.poses);
  in.warnings = in.motion.warnings;
  if (!command.config.empty()) {
    in.config = load_config(command.config);
  } else if (in.motion.header) {
    in.config = config_of(*in.motion.header, command.poses.string());
  }
  if (!command.blade.empty()) {  // for every source, whatever configuration or capture say
    in.config.cut.blade = to_core(protocol::parse_blade("--blade", command.blade));
    in.config.sources.clear();
    for (MotionEvent& event : in.motion.events) event.blade.reset();
  }
  in.config.cut.always_engaged = true;

  Progress filling("filling " + command.mesh.filename().string());
  in.loaded = mesh_io::load_mesh(command.mesh, load_options(in.config, [&](std::string_view stage, double) {
                                   filling.show(-1, stage);
                                 }));
  in.warnings.insert(in.warnings.end(), in.loaded.warnings.begin(), in.loaded.warnings.end());
  for (const core::Vec3& p : in.loaded.mesh.positions) {
    extend(p, in.low, in.high);
  }
  if (!in.motion.header) fit_limits(in.config.cut, in.motion, core::distance(in.low, in.high));
  return in;
}

std::string warning_of(const CutCommand& command, const core::CutConfig& cut, core::PoseVerdict verdict,
                       std::uint64_t count) {
  const std::string line = command.poses.string() + ": " + std::to_string(count);
  if (verdict != core::PoseVerdict::kNewStroke)
    return line + " poses were not taken: " + core::to_string(verdict);
  return line +
         " jumps began a new stroke: faster than cut.speed_limit_m_s = " + short_number(cut.speed_limit_m_s) +
         " or after more than cut.gap_limit_s = " + short_number(cut.gap_limit_s);
}

struct Outcome {
  std::unique_ptr<core::CutSession> session;
  Json report;
  std::vector<std::string> warnings;
};

const char* name_of(core::Preference prefer) {
  constexpr const char* kNames[] = {"no-growth", "balanced", "exact"};
  return kNames[static_cast<std::size_t>(prefer)];
}

// Cuts the mesh by the motion, in the server's own way.
Outcome cut(const CutCommand& command, const Input& in, const Config& config) {
  Outcome out;
  out.session = std::make_unique<core::CutSession>(in.loaded.mesh, config.cut);
  core::CutSession& session = *out.session;
  const core::CutReport before = core::measure(session.mesh());
  if (session.mesh().initial_vertex_copies() > 0) {
    out.warnings.push_back(command.mesh.string() + ": " +
                           std::to_string(session.mesh().initial_vertex_copies()) +
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
    for (std::size_t i = 0; i < in.motion.events.size(); ++i) {
      const MotionEvent& event = in.motion.events[i];
      if (event.kind == MotionEvent::Kind::kPose) {
        ++verdicts[static_cast<std::size_t>(session.push(event.source, event.pose))];
      } else if (event.kind != MotionEvent::Kind::kDeform) {  // which is of the vertices of another mesh
        apply(session, event, config);
      }
      cut_all();
      if (i % 64 == 0) progress.show(static_cast<double>(i) / static_cast<double>(in.motion.events.size()));
    }
    for (std::uint32_t source = 0; source < core::kMaxSources; ++source) session.end_stroke(source);
    cut_all();
  }
  for (std::size_t i = 0; i < verdicts.size(); ++i) {
    const auto verdict = static_cast<core::PoseVerdict>(i);
    if (verdicts[i] > 0 && verdict != core::PoseVerdict::kAccepted)
      out.warnings.push_back(warning_of(command, config.cut, verdict, verdicts[i]));
  }

  const core::CutReport after = core::measure(session.mesh());
  if (after.cut_faces == 0) {
    out.warnings.push_back(
        tally.batches == 0
            ? command.poses.string() + ": the blade never moved far enough to cut; nothing was cut"
            : "nothing was cut: the blade swept " + box_text(tally.low, tally.high) + ", the mesh fills " +
                  box_text(in.low, in.high) + " (metres); check --blade, units and frames");
  }
  tally.swept.build();
  const core::Deviation deviation = core::deviation(session.mesh(), tally.swept);
  const bool croll = config.cut.policy == core::Policy::kCroll;

  Json& report = out.report;
  report["mesh"] = command.mesh.string();
  report["poses"] = command.poses.string();
  report["policy"] = croll ? "croll" : "conforming";
  if (!croll) report["prefer"] = name_of(config.cut.prefer);
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
  report["cut_time_us"] = {{"all", tally.sum_us()},
                           {"p50", tally.quantile_us(0.5)},
                           {"p99", tally.quantile_us(0.99)},
                           {"max", tally.quantile_us(1)}};
  report["state_hash"] = hex(session.mesh().state_hash());
  report["warnings"] = in.warnings;
  for (const std::string& warning : out.warnings) report["warnings"].push_back(warning);
  return out;
}

void print(const Json& report) {
  const auto number = [&report](const char* key) { return short_number(report[key].get<double>()); };
  const auto count = [&report](const char* key) { return std::to_string(report[key].get<std::uint64_t>()); };
  print_row("tetrahedra", count("tets_before") + " -> " + count("tets"));
  print_row("pieces", count("pieces_before") + " -> " + count("pieces"));
  print_row("cut faces",
            count("cut_faces") + ", " + short_number(report["cut_area"].get<double>() * 1e4) + " cm2");
  print_row("deviation", "mean " + number("deviation_mean_h") + " h, max " + number("deviation_max_h") +
                             " h (h = " + number("h") + " m)");
  print_row("smallest angle",
            number("min_dihedral_deg_before") + " -> " + number("min_dihedral_deg_after") + " degrees");
  print_row("inverted", count("inverted"));
  const Json& time = report["cut_time_us"];
  print_row("batches", count("batches") + ", p50 " + short_number(time["p50"].get<double>()) + " us, max " +
                           short_number(time["max"].get<double>()) + " us");
  print_row("state hash", report["state_hash"].get<std::string>());
}

void print_comparison(const std::vector<Json>& reports) {
  const auto line = [&](const char* name, const auto& value) {
    std::printf("%-26s", name);
    for (const Json& report : reports) std::printf("%12s", value(report).c_str());
    std::printf("\n");
  };
  const auto number = [&](const char* name, const char* key) {
    line(name, [key](const Json& report) { return short_number(report[key].get<double>()); });
  };
  const auto count = [&](const char* name, const char* key) {
    line(name, [key](const Json& report) { return std::to_string(report[key].get<std::uint64_t>()); });
  };
  line("", [](const Json& r) { return r.value("prefer", r["policy"].get<std::string>()); });
  line("cutting, ms",
       [](const Json& r) { return short_number(1e-3 * r["cut_time_us"]["all"].get<double>()); });
  count("tetrahedra", "tets");
  line("new ones a cut face", [](const Json& r) {
    const double faces = std::max(r["cut_faces"].get<double>(), 1.0);
    return short_number((r["tets"].get<double>() - r["tets_before"].get<double>()) / faces);
  });
  count("pieces", "pieces");
  count("inverted", "inverted");
  count("cut faces", "cut_faces");
  line("cut area, cm2", [](const Json& r) { return short_number(1e4 * r["cut_area"].get<double>()); });
  number("deviation, mean, h", "deviation_mean_h");
  number("deviation, max, h", "deviation_max_h");
  number("smallest angle, degrees", "min_dihedral_deg_after");
  for (std::size_t bin = 0; bin < 4; ++bin) {
    const auto from = static_cast<int>(core::kHistogramBin_deg * static_cast<double>(bin));
    const std::string name = "smallest " + std::to_string(from) + " to " +
                             std::to_string(from + static_cast<int>(core::kHistogramBin_deg)) + ", tets";
    line(name.c_str(), [bin](const Json& r) {
      return std::to_string(r["dihedral_histogram"]["tets"][bin].get<std::uint64_t>());
    });
  }
}

// The same cut in every way that there is.
int compare(const CutCommand& command, const Input& in) {
  struct Way {
    core::Policy policy;
    core::Preference prefer;
  };
  constexpr Way kWays[] = {{core::Policy::kCroll, core::Preference::kBalanced},
                           {core::Policy::kConforming, core::Preference::kNoGrowth},
                           {core::Policy::kConforming, core::Preference::kBalanced},
                           {core::Policy::kConforming, core::Preference::kExact}};
  std::vector<Json> reports;
  for (const Way& way : kWays) {
    Config config = in.config;
    config.cut.policy = way.policy;
    config.cut.prefer = way.prefer;
    reports.push_back(cut(command, in, config).report);
  }
  if (!command.report.empty()) write_text(command.report, Json(reports).dump(2) + "\n");
  for (const std::string& warning : in.warnings) std::fprintf(stderr, "warning: %s\n", warning.c_str());
  if (command.json) {
    std::printf("%s\n", Json(reports).dump(2).c_str());
  } else {
    print_comparison(reports);
  }
  return 0;
}

}  // namespace

int run_cut(const CutCommand& command) {
  const bool compares = command.policy == "compare";
  if (!compares && command.out.empty())
    throw std::runtime_error("--out is required: where the cut mesh goes");
  if (!command.out.empty()) {
    if (compares)
      throw std::runtime_error("--policy compare writes no mesh: leave out --out, or name one policy");
    require_mesh_output(command.out, "--out");
  }
  if (!command.report.empty()) require_writable(command.report, "--report");
  Input in = read_input(command);
  if (compares) return compare(command, in);
  if (!command.policy.empty())
    in.config.cut.policy = command.policy == "croll" ? core::Policy::kCroll : core::Policy::kConforming;
  for (const auto prefer :
       {core::Preference::kNoGrowth, core::Preference::kBalanced, core::Preference::kExact}) {
    if (command.prefer == name_of(prefer)) in.config.cut.prefer = prefer;
  }
  const Outcome out = cut(command, in, in.config);
  write_cut_mesh(command.out, out.session->mesh());
  if (!command.report.empty()) write_text(command.report, out.report.dump(2) + "\n");
  for (const Json& warning : out.report["warnings"])
    std::fprintf(stderr, "warning: %s\n", warning.get<std::string>().c_str());
  if (command.json) {
    std::printf("%s\n", out.report.dump(2).c_str());
    return 0;
  }
  print(out.report);
  print_row("written", command.out.string());
  return 0;
}

}  // namespace incise::app
