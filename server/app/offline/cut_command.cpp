#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "client/cli/usage.hpp"
#include "server/app/look.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/motion_input.hpp"
#include "server/base/wording.hpp"
#include "server/core/mesh/measure.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

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
std::vector<Json> compare(const CutCommand& command, const CutInput& in, Progress& progress) {
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
    reports.push_back(cut(in, config, progress).report);
  }
  if (!command.report.empty()) write_text(command.report, Json(reports).dump(2) + "\n");
  return reports;
}

// What is wrong or missing in the mesh that is written: no part of the report, which is of the cut. (A comparison writes none, and has the
// inverted tetrahedra in its table.)
std::vector<std::string> mesh_warnings(const std::filesystem::path& path, const CutOutcome& out) {
  std::vector<std::string> warnings;
  if (const auto inverted = out.report["inverted"].get<std::uint64_t>(); inverted > 0) {
    warnings.push_back(counted(inverted, "tetrahedron is", "tetrahedra are") +
                       " inverted, as the policy croll may leave them: --policy conforming leaves none");
  }
  if (std::string without = cuts_left_out(path, out.session->mesh()); !without.empty())
    warnings.push_back(std::move(without));
  return warnings;
}

// Prints the warnings of all reports, each once, those of the mesh that was written, and the report, or the comparison of several. Returns the
// exit status.
int finish(const CutCommand& command, const std::vector<Json>& reports,
           const std::vector<std::string>& of_mesh) {
  std::vector<std::string> warnings;
  for (const Json& report : reports) {
    for (const auto& one : report["warnings"]) {
      const auto text = one.get<std::string>();
      if (std::find(warnings.begin(), warnings.end(), text) == warnings.end()) warnings.push_back(text);
    }
  }
  warnings.insert(warnings.end(), of_mesh.begin(), of_mesh.end());
  print_warnings(warnings);
  const bool compares = reports.size() > 1;
  if (command.json) {
    std::printf("%s\n", (compares ? Json(reports) : reports[0]).dump(2).c_str());
  } else if (compares) {
    print_comparison(reports);
  } else {
    print(reports[0]);
    std::vector<std::filesystem::path> files = files_of_mesh(command.out);
    if (!command.report.empty()) files.push_back(command.report);
    print_written(files);
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
  if (compares && !command.out.empty())
    throw client::UsageError("--policy compare writes no mesh: leave out --out, or name one policy");
  if (compares && !command.prefer.empty())
    throw client::UsageError("--policy compare cuts with every --prefer: leave it out, or name one policy");
  require_outputs({{command.out, "--out", Output::Kind::kMesh}, {command.report, "--report"}},
                  {command.mesh, command.poses, command.config});
  std::vector<Json> reports;
  std::vector<std::string> of_mesh;
  {
    Progress progress("reading " + command.poses.filename().string());
    CutInput in = read_motion_input(
        {command.poses, command.mesh, command.config, command.blade, command.times, command.out},
        Engage::kAlways, progress);
    if (!command.policy.empty())
      in.config.cut.policy = command.policy == "croll" ? core::Policy::kCroll : core::Policy::kConforming;
    for (const auto prefer :
         {core::Preference::kNoGrowth, core::Preference::kBalanced, core::Preference::kExact}) {
      if (command.prefer == name_of(prefer)) in.config.cut.prefer = prefer;
    }
    if (compares) {
      reports = compare(command, in, progress);
    } else {
      // Before the work: a texture may be missing.
      std::vector<RegionMaterials> regions;
      if (keeps_materials(command.out)) {
        if (command.config.empty() && drop_look_files(in.config)) in.warnings.push_back(kLookFilesLeftOut);
        regions = region_materials(in.config, in.loaded->mesh, command.config.string());
      }
      const CutOutcome out = cut(in, in.config, progress);
      of_mesh = mesh_warnings(command.out, out);
      progress.stage("writing " + command.out.filename().string());
      write_cut_mesh(command.out, *out.session, in.loaded->surface.get(), &regions);
      if (!command.report.empty()) write_text(command.report, out.report.dump(2) + "\n");
      reports.push_back(out.report);
    }
  }
  return finish(command, reports, of_mesh);
}

}  // namespace incise::app
