#include <algorithm>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <stdexcept>

#include "client/cli/usage.hpp"
#include "protocol/motion.hpp"
#include "server/app/body.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/motion_run.hpp"
#include "server/base/hex.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

// What a session did with a motion, batch by batch.
struct Tally {
  const double tolerance_m;  // of the swept surface that the cut is compared with
  core::CutCounts sum;
  std::uint64_t batches = 0;
  std::vector<double> batch_us;
  core::SweptSurface swept;

  void add(const core::Batch& batch, const core::CutCounts& counts, double us) {
    ++batches;
    batch_us.push_back(us);
    sum.events += counts.events;
    sum.snaps += counts.snaps;
    sum.splits += counts.splits;
    sum.failed += counts.failed;
    sum.removed_tets += counts.removed_tets;
    core::add_sweep(swept, batch.lines, tolerance_m);
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

// What is cut, and by what.
struct Input {
  RecordedMotion motion;
  Config config;
  mesh_io::LoadedMesh loaded;
  Box body;
  std::string raised_limits;
  std::vector<std::string> warnings;
};

Input read_input(const CutCommand& command, Progress& progress) {
  Input in;
  in.motion = read_recorded_motion(command.poses, command.times);
  in.warnings = in.motion.warnings;
  if (!command.config.empty()) {
    in.config = load_config(command.config);
  } else if (in.motion.header) {
    in.config = config_of(*in.motion.header, command.poses.string());
  }
  if (!command.blade.empty()) {  // for every source, whatever the configuration or capture says
    in.config.cut.blade = to_core(protocol::parse_blade("--blade", command.blade));
    in.config.sources.clear();
    for (MotionEvent& event : in.motion.events) event.blade.reset();
  }
  in.config.cut.always_engaged = true;

  progress.stage("loading " + command.mesh.filename().string());
  in.loaded = mesh_io::load_mesh(command.mesh, load_options(in.config, [&](std::string_view stage, double) {
                                   progress.show(-1, stage);
                                 }));
  in.warnings.insert(in.warnings.end(), in.loaded.warnings.begin(), in.loaded.warnings.end());
  in.body = box_of(in.loaded.mesh);
  in.raised_limits = suit_limits(in.config, in.motion, in.body.diagonal());
  return in;
}

struct Outcome {
  std::unique_ptr<core::CutSession> session;
  Json report;
};

const char* name_of(core::Preference prefer) {
  constexpr const char* kNames[] = {"no-growth", "balanced", "exact"};
  return kNames[static_cast<std::size_t>(prefer)];
}

// The result for the mesh; `tally` is complete.
Json report_of(const CutCommand& command, const Input& in, const Config& config, const core::TetMesh& mesh,
               const core::CutReport& before, Tally& tally) {
  const core::CutReport after = core::measure(mesh);
  tally.swept.build();
  const core::Deviation deviation = core::deviation(mesh, tally.swept);
  const bool croll = config.cut.policy == core::Policy::kCroll;
  Json report;
  report["mesh"] = command.mesh.string();
  report["poses"] = command.poses.string();
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
  report["deviation_max_h"] = deviation.max_h;
  report["deviation_mean_h"] = deviation.mean_h;
  report["speed_limit_m_s"] = config.cut.speed_limit_m_s;
  report["gap_limit_s"] = config.cut.gap_limit_s;
  if (!in.raised_limits.empty()) report["raised_limits"] = in.raised_limits;
  report["batches"] = tally.batches;
  report["cut_time_us"] = {{"all", tally.sum_us()},
                           {"p50", tally.quantile_us(0.5)},
                           {"p99", tally.quantile_us(0.99)},
                           {"max", tally.quantile_us(1)}};
  report["state_hash"] = hex(mesh.state_hash());
  return report;
}

// Cuts the mesh by the motion, in the same way as the server.
Outcome cut(const CutCommand& command, const Input& in, const Config& config, Progress& progress) {
  progress.stage("preparing");
  Outcome out{std::make_unique<core::CutSession>(in.loaded.mesh, config.cut), {}};
  core::CutSession& session = *out.session;
  const core::CutReport before = core::measure(session.mesh());
  std::vector<std::string> warnings = in.warnings;
  if (const auto copies = session.mesh().initial_vertex_copies(); copies > 0) {
    warnings.push_back(command.mesh.string() + ": " + counted(copies, "vertex", "vertices") +
                       " joined parts that only touch there; now each part has its own");
  }
  Tally tally{0.001 * session.mesh().mean_edge_length(), {}, 0, {}, {}};
  progress.stage("cutting");
  MotionRun run(session, in.motion, config, command.poses.string());
  run.run(
      {.deformations = false,  // they name vertices of another mesh
       .event = {},
       .commit = [&](const core::Delta&,
                     double us) { tally.add(session.committed_batch(), session.committed_counts(), us); }},
      progress);
  progress.stage("measuring");
  out.report = report_of(command, in, config, session.mesh(), before, tally);
  out.report["poses_taken"] = run.poses_taken();
  for (std::string& warning : run.warnings(out.report["cut_faces"].get<std::uint32_t>(), in.body))
    warnings.push_back(std::move(warning));
  out.report["warnings"] = warnings;
  return out;
}

// In h. Rounding errors are not worth their digits.
std::string deviation_text(double h) {
  return h < 1e-9 ? "below 1e-9 h" : short_number(h) + " h";
}

void print(const Json& report) {
  const auto number = [&report](const char* key) { return short_number(report[key].get<double>()); };
  const auto count = [&report](const char* key) { return std::to_string(report[key].get<std::uint64_t>()); };
  print_row("tetrahedra", count("tets_before") + " -> " + count("tets"));
  print_row("pieces", count("pieces_before") + " -> " + count("pieces"));
  print_row("cut faces",
            count("cut_faces") + ", " + short_number(report["cut_area"].get<double>() * 1e4) + " cm2");
  print_row("deviation", report["cut_faces"] == 0
                             ? std::string("none")
                             : "mean " + deviation_text(report["deviation_mean_h"].get<double>()) + ", max " +
                                   deviation_text(report["deviation_max_h"].get<double>()) +
                                   " (h = " + number("h") + " m)");
  print_row("smallest angle",
            number("min_dihedral_deg_before") + " -> " + number("min_dihedral_deg_after") + " degrees");
  print_row("inverted", count("inverted"));
  const Json& time = report["cut_time_us"];
  std::string batches = count("batches");
  if (report["batches"] > 0) {
    batches += ", p50 " + short_duration(time["p50"].get<double>()) + ", max " +
               short_duration(time["max"].get<double>());
  }
  print_row("batches", batches);
  if (report.contains("raised_limits"))
    print_row("limits raised", report["raised_limits"].get<std::string>() + ", to suit the motion");
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

// The same cut by every policy.
std::vector<Json> compare(const CutCommand& command, const Input& in, Progress& progress) {
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
    reports.push_back(cut(command, in, config, progress).report);
  }
  if (!command.report.empty()) write_text(command.report, Json(reports).dump(2) + "\n");
  return reports;
}

// Prints the warnings of all reports, each once, and the report, or the comparison of several. Returns the exit
// status.
int finish(const CutCommand& command, const std::vector<Json>& reports) {
  std::vector<std::string> warnings;
  for (const Json& report : reports) {
    for (const auto& one : report["warnings"]) {
      const auto text = one.get<std::string>();
      if (std::find(warnings.begin(), warnings.end(), text) == warnings.end()) warnings.push_back(text);
    }
  }
  print_warnings(warnings);
  const bool compares = reports.size() > 1;
  if (command.json) {
    std::printf("%s\n", (compares ? Json(reports) : reports[0]).dump(2).c_str());
  } else if (compares) {
    print_comparison(reports);
  } else {
    print(reports[0]);
    print_row("written", command.out.string());
  }
  const bool any =
      std::any_of(reports.begin(), reports.end(), [](const Json& r) { return r["cut_faces"] > 0; });
  return any ? 0 : kNothingCut;
}

}  // namespace

int run_cut(const CutCommand& command) {
  const bool compares = command.policy == "compare";
  if (!compares && command.out.empty())
    throw client::UsageError("--out is required: where the cut mesh goes");
  if (!command.out.empty()) {
    if (compares)
      throw client::UsageError("--policy compare writes no mesh: leave out --out, or name one policy");
    require_mesh_output(command.out, "--out");
    require_not_read(command.out, {command.mesh, command.poses}, "--out");
  }
  if (!command.report.empty()) require_writable(command.report, "--report");
  std::vector<Json> reports;
  {
    Progress progress("reading " + command.poses.filename().string());
    Input in = read_input(command, progress);
    if (!command.policy.empty())
      in.config.cut.policy = command.policy == "croll" ? core::Policy::kCroll : core::Policy::kConforming;
    for (const auto prefer :
         {core::Preference::kNoGrowth, core::Preference::kBalanced, core::Preference::kExact}) {
      if (command.prefer == name_of(prefer)) in.config.cut.prefer = prefer;
    }
    if (compares) {
      reports = compare(command, in, progress);
    } else {
      const Outcome out = cut(command, in, in.config, progress);
      progress.stage("writing " + command.out.filename().string());
      write_cut_mesh(command.out, out.session->mesh());
      if (!command.report.empty()) write_text(command.report, out.report.dump(2) + "\n");
      reports.push_back(out.report);
    }
  }
  return finish(command, reports);
}

}  // namespace incise::app
