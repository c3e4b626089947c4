#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "server/core/stroke/swept_triangle.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/oracle/judge.hpp"
#include "tests/oracle/random_cut.hpp"

// Random cuts right through any mesh, judged by geometry: pieces, deviation, growth, angles, time.
namespace incise::bench {
namespace {

using oracle::RandomCut;
using oracle::Shape;

struct Setting {
  std::string name;
  core::Policy policy;
  core::Preference prefer;
};
const std::vector<Setting> kSettings = {
    {"croll", core::Policy::kCroll, core::Preference::kBalanced},
    {"no-growth", core::Policy::kConforming, core::Preference::kNoGrowth},
    {"balanced", core::Policy::kConforming, core::Preference::kBalanced},
    {"exact", core::Policy::kConforming, core::Preference::kExact},
};

struct Options {
  std::vector<std::string> meshes, settings{"balanced"}, shapes{"planar", "twisted", "curved", "both"};
  double scale = 1;
  std::vector<int> segments{1, 10, 100};
  int cuts = 10;
  std::uint64_t seed = 1;
  bool each = false;
};

// What one cut left.
struct Outcome {
  core::CutReport after;
  SessionTotals totals;
  oracle::Verdict verdict;
  double seconds = 0;
  double max_deviation_h = 0, mean_deviation_h = 0;
  double body_h = 0;  // how far a vertex of the body's own boundary lies off what that was
  std::uint64_t hash = 0;
};

// The body's own boundary: without what cuts have opened.
std::vector<std::array<core::VertexId, 3>> own_boundary(const core::TetMesh& mesh) {
  std::vector<std::array<core::VertexId, 3>> faces;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) == core::kNone && !(mesh.cut_mask(t) >> f & 1))
        faces.push_back(mesh.face_vertices(core::half_face(t, f)));
    }
  }
  return faces;
}

// The farthest that a boundary vertex of `from` lies off the boundary of `to`, of those that are not vertices of that, m.
double farthest_off(const core::TetMesh& from, const core::TetMesh& to) {
  const auto faces = own_boundary(to);
  std::vector<std::uint8_t> seen(from.vertex_slots(), 0);
  double farthest = 0;
  for (const auto& face : own_boundary(from)) {
    for (const core::VertexId v : face) {
      const core::Vec3& p = from.position(v);
      if (seen[v]++ != 0 || (v < to.vertex_slots() && core::distance(p, to.position(v)) == 0)) continue;
      double nearest = INFINITY;
      for (const auto& [a, b, c] : faces) {
        const core::Vec3 closest = core::closest_point(p, to.position(a), to.position(b), to.position(c));
        nearest = std::min(nearest, core::distance(p, closest));
      }
      farthest = std::max(farthest, nearest);
    }
  }
  return farthest;
}

Outcome run_one(const NamedMesh& mesh, const core::TetMesh& uncut, const oracle::Body& body,
                const RandomCut& cut, const Setting& setting) {
  core::CutConfig config = bench_config(setting.policy);
  config.prefer = setting.prefer;
  core::CutSession session(mesh.mesh, config);
  cut.push(session);
  Outcome outcome;
  const double start = thread_cpu_s();
  outcome.totals = run_all(session);
  outcome.seconds = thread_cpu_s() - start;
  const core::TetMesh& cut_mesh = session.mesh();
  const double h = cut_mesh.mean_edge_length();
  outcome.after = core::measure(cut_mesh);
  const oracle::Stroke stroke{cut.lines()};
  outcome.verdict = oracle::judge(body, {&stroke, 1}, cut_mesh);
  outcome.hash = cut_mesh.state_hash();

  std::uint64_t samples = 0;
  double sum = 0;
  for (core::TetId t = 0; t < cut_mesh.tet_slots(); ++t) {
    if (!cut_mesh.alive(t)) continue;
    for (int f = 0; f < 4; ++f) {
      if (!(cut_mesh.cut_mask(t) >> f & 1)) continue;
      for (core::VertexId v : cut_mesh.face_vertices(core::half_face(t, f))) {
        const double off = std::abs(cut.side(cut_mesh.position(v))) / h;
        outcome.max_deviation_h = std::max(outcome.max_deviation_h, off);
        sum += off;
        ++samples;
      }
    }
  }
  outcome.body_h = std::max(farthest_off(cut_mesh, uncut), farthest_off(uncut, cut_mesh)) / h;
  outcome.mean_deviation_h = samples > 0 ? sum / static_cast<double>(samples) : 0;
  return outcome;
}

void run(const Options& options, Report& report) {
  report.begin("cut");
  std::vector<NamedMesh> meshes;
  for (const std::string& path : options.meshes) meshes.push_back(load(path, options.scale));
  if (meshes.empty() && !data_folder().empty()) {
    for (const char* name : {"seed_1720", "seed_3234", "armadillo_3717", "liver_80298"})
      meshes.push_back(load(data_folder() + "/meshes/" + name + ".node", 1));
  }
  if (meshes.empty()) meshes = {phantom("cylinder", 15000), phantom("liver", 20000)};
  report.fact("seed", count(options.seed));

  std::vector<std::string> each;
  report.table("random cuts right through, judged by geometry",
               {{"mesh"},        {"policy"},        {"shape"},        {"segments"},    {"cuts"},
                {"wrong"},       {"islands"},       {"inverted"},     {"faces"},       {"growth/face", 2},
                {"worst", 2},    {"dev mean h", 4}, {"max h", 3},     {"body h", 3},   {"volume ppm", 0},
                {"angle in", 2}, {"p50", 2},        {"worst deg", 2}, {"ms a cut", 2}, {"us an event", 2},
                {"units"}});
  for (const NamedMesh& mesh : meshes) {
    const core::TetMesh uncut(mesh.mesh);
    const oracle::Body body(mesh.mesh);
    for (const Setting& setting : kSettings) {
      if (std::find(options.settings.begin(), options.settings.end(), setting.name) == options.settings.end())
        continue;
      for (Shape shape : {Shape::kPlanar, Shape::kTwisted, Shape::kCurved, Shape::kBoth}) {
        if (std::find(options.shapes.begin(), options.shapes.end(), to_string(shape)) == options.shapes.end())
          continue;
        for (int segments : options.segments) {
          std::int64_t wrong = 0, islands = 0, inverted = 0, faces = 0, units = 0;
          std::vector<double> growths, angles, seconds, event_us;
          double mean = 0, max = 0, body_h = 0, volume = 0;
          for (int i = 0; i < options.cuts; ++i) {
            const std::uint64_t seed = options.seed + static_cast<std::uint64_t>(i);
            const Outcome o =
                run_one(mesh, uncut, body, RandomCut(mesh.mesh, shape, segments, seed), setting);
            wrong += !o.verdict.right();
            islands += o.after.islands;
            inverted += o.after.inverted;
            faces += o.after.cut_faces;
            units += o.totals.work_units;
            growths.push_back(o.verdict.growth);
            angles.push_back(o.after.min_dihedral_deg);
            seconds.push_back(o.seconds);
            event_us.push_back(1e6 * o.seconds / std::max(o.totals.counts.events, 1u));
            mean += o.mean_deviation_h / options.cuts;
            max = std::max(max, o.max_deviation_h);
            body_h = std::max(body_h, o.body_h);
            volume = std::max(volume, std::abs(o.verdict.volume_change));
            if (!o.verdict.right() || options.each) {
              std::fprintf(stderr, "%s %s %s, %d segments, seed %llu: %s; body %.3f h, hash %s\n",
                           mesh.name.c_str(), setting.name.c_str(), to_string(shape), segments,
                           static_cast<unsigned long long>(seed), oracle::to_string(o.verdict).c_str(),
                           o.body_h, std::get<std::string>(hex(o.hash)).c_str());
            }
          }
          report.row({mesh.name,
                      setting.name,
                      std::string(to_string(shape)),
                      std::int64_t{segments},
                      std::int64_t{options.cuts},
                      wrong,
                      islands,
                      inverted,
                      faces / options.cuts,
                      percentile(growths, 0.5),
                      percentile(growths, 1),
                      mean,
                      max,
                      body_h,
                      1e6 * volume,
                      body.min_angle_deg,
                      percentile(angles, 0.5),
                      *std::min_element(angles.begin(), angles.end()),
                      1e3 * percentile(seconds, 0.5),
                      percentile(event_us, 0.5),
                      units / options.cuts});
        }
      }
    }
  }
}

}  // namespace

void add_cut_bench(CLI::App& app, Report& report) {
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("cut", "Random cuts right through any mesh, judged by geometry, and their time");
  command->add_option("--mesh", options->meshes, "Mesh files; without: some of INCISE_DATA's, or phantoms");
  command->add_option("--scale", options->scale, "Metres in a unit of the files")->capture_default_str();
  std::vector<std::string> names;
  for (const Setting& setting : kSettings) names.push_back(setting.name);
  command->add_option("--policy", options->settings, "Which: croll, no-growth, balanced, exact")
      ->delimiter(',')
      ->check(CLI::IsMember(names))
      ->capture_default_str();
  command->add_option("--shape", options->shapes, "Which: planar, twisted, curved, both")
      ->delimiter(',')
      ->check(CLI::IsMember({"planar", "twisted", "curved", "both"}))
      ->capture_default_str();
  command->add_option("--segments", options->segments, "Steps that describe the motion")
      ->delimiter(',')
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--cuts", options->cuts, "Cuts for each line of the table")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "Of the first cut; the others count on")
      ->capture_default_str();
  command->add_flag("--each", options->each, "Say a line about each cut, not only about wrong ones");
  command->callback([options, &report] { run(*options, report); });
}

}  // namespace incise::bench
