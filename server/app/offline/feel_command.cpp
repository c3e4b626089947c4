#include <algorithm>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "client/cli/usage.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/feel_plot.hpp"
#include "server/app/offline/feel_run.hpp"
#include "server/app/offline/force_rate.hpp"
#include "server/base/wording.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

double seconds(std::int64_t ns) {
  return static_cast<double>(ns) * 1e-9;
}

// What one blade felt. Between two poses the force of the first acts, as a device holds it.
struct Summary {
  std::uint64_t poses = 0, limited = 0;
  double contact_s = 0, inside_s = 0;
  double impulse_ns = 0;  // of the force's magnitude while in contact, N s
  double work_j = 0;      // by the hand
  double tissue_peak_n = 0;
  std::uint32_t faults = 0;
  bool touched = false, latched = false;
  const FeltPose* peak = nullptr;  // of the force on the hand; nothing: none acted
  const FeltPose* last = nullptr;
  struct Puncture {
    double time_s, force_n;  // the largest at the surface before
    core::Vec3 at;
  };
  std::vector<Puncture> punctures;

  void add(const FeltPose& pose) {
    ++poses;
    limited += pose.limited;
    faults |= pose.faults;
    latched = latched || pose.latched;
    touched = touched || pose.contact;
    tissue_peak_n = std::max(tissue_peak_n, length(pose.tissue));
    const double force = length(pose.hand);
    if (force > (peak ? length(peak->hand) : 0)) peak = &pose;
    if (last && !pose.jumped) add_step(*last, pose);
    if (pose.entered)
      punctures.push_back({seconds(pose.time_ns), last ? length(last->tissue) : 0, pose.position});
    last = &pose;
  }
  void add_step(const FeltPose& from, const FeltPose& to) {
    const double dt = seconds(to.time_ns - from.time_ns);
    work_j -= dot(from.hand, to.position - from.position);
    if (!from.contact) return;
    contact_s += dt;
    inside_s += from.inside ? dt : 0;
    impulse_ns += length(from.hand) * dt;
  }
};

Json json_of(const core::Vec3& v) {
  return {v.x, v.y, v.z};
}

// The safety chain's faults in words.
std::string faults_text(std::uint32_t faults) {
  std::string text;
  const auto add = [&](std::uint32_t bit, const char* words) {
    if ((faults & bit) != 0) text += (text.empty() ? "" : " and ") + std::string(words);
  };
  add(haptics::kNotFinite, "a force that was not finite");
  add(haptics::kSilent, "a silent source");
  add(haptics::kFrozen, "poses that repeat each other (haptics.frozen_s)");
  return text;
}

Json json_of(const Summary& sum, std::uint32_t source, const std::string& name) {
  Json blade{{"source", source}, {"name", name}, {"poses", sum.poses}, {"contact", sum.touched}};
  blade["peak_force_n"] = sum.peak ? length(sum.peak->hand) : 0.0;
  blade["peak_time_s"] = sum.peak ? Json(seconds(sum.peak->time_ns)) : Json();
  blade["peak_at_m"] = sum.peak ? json_of(sum.peak->position) : Json();
  blade["peak_tissue_force_n"] = sum.tissue_peak_n;
  blade["mean_force_in_contact_n"] = sum.contact_s > 0 ? sum.impulse_ns / sum.contact_s : 0.0;
  blade["contact_s"] = sum.contact_s;
  blade["inside_s"] = sum.inside_s;
  blade["work_by_hand_j"] = sum.work_j;
  blade["limited_poses"] = sum.limited;
  blade["faults"] = faults_text(sum.faults);
  blade["punctures"] = Json::array();
  for (const Summary::Puncture& puncture : sum.punctures)
    blade["punctures"].push_back(
        {{"time_s", puncture.time_s}, {"force_n", puncture.force_n}, {"at_m", json_of(puncture.at)}});
  return blade;
}

std::string point_text(const Json& at) {
  return "(" + short_number(at[0]) + ", " + short_number(at[1]) + ", " + short_number(at[2]) + ")";
}

void print_blade(const Json& blade) {
  const auto number = [&blade](const char* key) { return short_number(blade[key].get<double>()); };
  print_row("poses", std::to_string(blade["poses"].get<std::uint64_t>()));
  if (!blade["contact"].get<bool>()) {
    print_row("contact", "no contact");
    return;
  }
  print_row("contact", number("contact_s") + " s, of these inside " + number("inside_s") + " s");
  if (!blade["peak_time_s"].is_null())
    print_row("peak force", number("peak_force_n") + " N at " + number("peak_time_s") + " s, tool at " +
                                point_text(blade["peak_at_m"]));
  print_row("mean in contact", number("mean_force_in_contact_n") + " N");
  const Json& punctures = blade["punctures"];
  std::string text = std::to_string(punctures.size());
  if (!punctures.empty())
    text += (punctures.size() > 1 ? ", the first at " : ", at ") +
            short_number(punctures[0]["time_s"].get<double>()) + " s with " +
            short_number(punctures[0]["force_n"].get<double>()) + " N";
  print_row("punctures", text);
  print_row("work by the hand", number("work_by_hand_j") + " J");
  const auto limited = blade["limited_poses"].get<std::uint64_t>();
  // The largest force may not be one of these.
  const bool lowered = limited > 0 && number("peak_tissue_force_n") != number("peak_force_n");
  print_row("limited", counted(limited, "pose", "poses") +
                           (lowered ? "; without limits up to " + number("peak_tissue_force_n") + " N" : ""));
}

void print(const Json& report) {
  print_row("duration", short_number(report["duration_s"].get<double>()) + " s");
  if (const auto added = report["interpolated_poses"].get<std::uint64_t>(); added > 0)
    print_row("interpolated", counted(added, "pose", "poses") + " between those of the motion");
  const Json& blades = report["blades"];
  for (const Json& blade : blades) {
    if (blades.size() > 1) std::printf("\n%s\n", blade["name"].get<std::string>().c_str());
    print_blade(blade);
  }
  if (report.contains("raised_limits"))
    print_row("limits raised", report["raised_limits"].get<std::string>() + ", to suit the motion");
}

// Nanoseconds as seconds, every digit.
std::string exact_seconds(std::int64_t ns) {
  std::string text = protocol::seconds_text(ns);
  text.resize(text.size() - 2);  // " s"
  return text;
}

std::string csv_field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
  return quoted + "\"";
}

void write_csv(const std::filesystem::path& path, const std::vector<FeltPose>& poses,
               const std::vector<std::string>& names) {
  std::ofstream out(path, std::ios::binary);
  out << "time_s,t_s,source,x_m,y_m,z_m,fx_n,fy_n,fz_n,f_n,tissue_fx_n,tissue_fy_n,tissue_fz_n,tissue_f_n,"
         "depth_m,edge_inside_m,edge_uncut_m,stiffness_n_m,resistance_n,contact,inside,puncture,engaged,"
         "limited\n";
  for (const FeltPose& p : poses) {
    char text[512];
    std::snprintf(
        text, sizeof text,
        "%.9g,%.9g,%.9g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%.7g,%d,%d,%d,%d,%d\n",
        p.position.x, p.position.y, p.position.z, p.hand.x, p.hand.y, p.hand.z, length(p.hand), p.tissue.x,
        p.tissue.y, p.tissue.z, length(p.tissue), p.depth_m, p.edge.length_m, p.edge.uncut_m,
        p.edge.stiffness_n_m, p.resistance_n, p.contact, p.inside, p.entered, p.engaged, p.limited);
    out << exact_seconds(p.time_ns) << ',' << exact_seconds(p.pose_t_ns) << ',' << csv_field(names[p.source])
        << ',' << text;
  }
  finish_writing(out, path);
}

std::vector<std::string> source_names(const Config& config) {
  std::vector<std::string> names;
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    names.push_back(source < config.sources.size() ? config.sources[source].name
                                                   : "source " + std::to_string(source));
  return names;
}

Json report_of(const FeelCommand& command, const CutInput& in, const FeelRun& run,
               const std::vector<std::string>& names, std::size_t interpolated) {
  std::array<Summary, core::kMaxSources> sums;
  std::int64_t end_ns = 0;
  for (const FeltPose& pose : run.poses()) {
    sums[pose.source].add(pose);
    end_ns = std::max(end_ns, pose.time_ns);
  }
  std::vector<std::string> warnings = in.warnings;
  for (std::string& warning : run.warnings()) warnings.push_back(std::move(warning));
  Json report{{"mesh", command.mesh.string()},
              {"motion", command.motion.string()},
              {"duration_s", seconds(end_ns)},
              {"interpolated_poses", interpolated},
              {"contact", run.touched()}};
  report["blades"] = Json::array();
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    const Summary& sum = sums[source];
    if (sum.poses == 0) continue;
    report["blades"].push_back(json_of(sum, source, names[source]));
    if (sum.faults == 0) continue;
    warnings.push_back(command.motion.string() + ": " + names[source] +
                       ": the safety chain let the force fade because of " + faults_text(sum.faults) +
                       (sum.latched ? ", and after three times kept it off" : ""));
  }
  if (!in.raised_limits.empty()) report["raised_limits"] = in.raised_limits;
  report["warnings"] = warnings;
  return report;
}

}  // namespace

int run_feel(const FeelCommand& command) {
  require_outputs({{command.out, "--out"}, {command.svg, "--svg"}},
                  {command.mesh, command.motion, command.config});
  Json report;
  {
    Progress progress("reading " + command.motion.filename().string());
    CutInput in =
        read_motion_input({command.motion, command.mesh, command.config, command.blade, command.times},
                          Engage::kConfigured, progress);
    const std::size_t interpolated = interpolate_to_force_rate(in);
    const std::vector<std::string> names = source_names(in.config);
    progress.stage("preparing");
    FeelRun run(in, command.motion.string());
    progress.stage("feeling and cutting");
    run.run(progress);
    progress.stage("writing");
    if (!command.out.empty()) write_csv(command.out, run.poses(), names);
    if (!command.svg.empty()) write_text(command.svg, force_plot(run.poses(), names));
    report = report_of(command, in, run, names, interpolated);
  }
  print_warnings(report["warnings"]);
  if (command.json) {
    std::printf("%s\n", report.dump(2).c_str());
  } else {
    print(report);
    for (const auto& path : {command.out, command.svg})
      if (!path.empty()) print_row("written", path.string());
  }
  return report["contact"].get<bool>() ? 0 : kNothingTouched;
}

}  // namespace incise::app
