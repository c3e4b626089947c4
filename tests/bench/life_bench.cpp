#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <memory>
#include <random>

#include "server/base/check.hpp"
#include "server/core/mesh/validate.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"

// Many strokes in one mesh: what becomes of it.
namespace incise::bench {
namespace {

using core::Vec3;

// A random stroke somewhere in the box: a blade a fifth of the body long, pushed along an arc over up to a third of it.
void push_stroke(core::CutSession& session, const Vec3& low, const Vec3& high, std::mt19937_64& random,
                 std::int64_t& t_ns) {
  const auto uniform = [&random](double from, double to) {
    return from + (to - from) * static_cast<double>(random() >> 11) * 0x1p-53;
  };
  const double size = core::distance(low, high);
  const Vec3 start{uniform(low.x, high.x), uniform(low.y, high.y), uniform(low.z, high.z)};
  core::Quat q{uniform(-1, 1), uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)};
  const double l = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  if (l < 0.1) return;
  q = {q.w / l, q.x / l, q.y / l, q.z / l};
  const Vec3 ahead = core::rotate(q, {1, 0, 0}), aside = core::rotate(q, {0, 1, 0});
  const double travel = uniform(0.05, 0.35) * size, bend = uniform(-0.1, 0.1) * size;
  constexpr int kPoses = 40;
  for (int i = 0; i <= kPoses; ++i) {
    const double s = static_cast<double>(i) / kPoses;
    core::Pose pose;
    pose.t_ns = (t_ns += 1'000'000);
    pose.position = start + (s * travel) * ahead + (bend * s * s) * aside;
    pose.orientation = q;
    INCISE_CHECK(core::accepted(session.push(0, pose)), i);
  }
  session.end_stroke(0);
}

void run(const std::string& file, std::size_t tets, int strokes, std::uint64_t seed, bool validate,
         Report& report) {
  report.begin("life");
  const NamedMesh mesh = file.empty() ? phantom("liver", tets) : load(file, 1);
  const auto [low, high] = bounds(mesh.mesh);
  core::CutSession session(mesh.mesh, bench_config(core::Policy::kConforming));
  session.set_blade(0, {{0, 0, 0}, {0, 0, 0.2 * core::distance(low, high)}});
  std::mt19937_64 random(seed);
  std::int64_t t_ns = 0;
  const core::CutReport before = core::measure(session.mesh());
  report.fact("mesh", mesh.name);
  report.fact("seed", count(seed));
  report.table("random strokes in one mesh", {{"strokes"},
                                              {"tets"},
                                              {"cut faces"},
                                              {"growth/face", 2},
                                              {"pieces"},
                                              {"islands"},
                                              {"inverted"},
                                              {"smallest deg", 2},
                                              {"below 5 deg", 4},
                                              {"volume", 6},
                                              {"us an event", 2},
                                              {"slots MB", 1},
                                              {"hash"}});
  double seconds = 0;
  std::uint32_t sum_events = 0;
  for (int stroke = 1, next = 1; stroke <= strokes; ++stroke) {
    push_stroke(session, low, high, random, t_ns);
    const double start = thread_cpu_s();
    const SessionTotals totals = run_all(session);
    seconds += thread_cpu_s() - start;
    sum_events += totals.counts.events;
    if (validate) {
      const std::string problem = core::validate(session.mesh());
      INCISE_CHECK(problem.empty(), problem, stroke);
    }
    // Rows at 1, 3, 10, 30, ...
    if (stroke != next && stroke != strokes) continue;
    if (stroke == next) next = std::to_string(next)[0] == '1' ? 3 * next : 10 * next / 3;
    const core::CutReport now = core::measure(session.mesh());
    // The formula in server/ARCHITECTURE.md, without the grid.
    const double megabytes =
        1e-6 * (64.0 * session.mesh().vertex_slots() + 69.0 * session.mesh().tet_slots());
    report.row({std::to_string(stroke), count(now.tets), count(now.cut_faces),
                (static_cast<double>(now.tets) - before.tets) / std::max(now.cut_faces, 1u),
                count(now.pieces), count(now.islands), count(now.inverted), now.min_dihedral_deg,
                static_cast<double>(now.dihedral_histogram[0]) / now.tets, now.volume / before.volume,
                1e6 * seconds / std::max(sum_events, 1u), megabytes, hex(session.mesh().state_hash())});
    seconds = 0;
    sum_events = 0;
  }
}

}  // namespace

void add_life_bench(CLI::App& app, Report& report) {
  struct Options {
    std::string mesh;
    std::size_t tets = 20'000;
    int strokes = 1000;
    std::uint64_t seed = 1;
    bool validate = false;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("life", "Many random strokes in one mesh: growth, quality, pieces, memory");
  command->add_option("--mesh", options->mesh, "A mesh file; without: a liver phantom");
  command->add_option("--tets", options->tets, "Size of the phantom")->capture_default_str();
  command->add_option("--strokes", options->strokes, "How many")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "Of the strokes")->capture_default_str();
  command->add_flag("--validate", options->validate, "Check all invariants of the mesh after each stroke");
  command->callback([options, &report] {
    run(options->mesh, options->tets, options->strokes, options->seed, options->validate, report);
  });
}

}  // namespace incise::bench
