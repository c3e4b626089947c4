#include <benchmark/benchmark.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "server/core/geometry/predicates.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_model.hpp"
#include "server/stream/mirror.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/core/test_meshes.hpp"

// The operations that a cut is made of, one at a time, by Google Benchmark.
namespace incise::bench {
namespace {

using core::TetId;
using core::TetMesh;
using core::Vec3;
using core::VertexId;
using core::testing::Random;

std::vector<Vec3> random_points(std::size_t n, bool flat) {
  Random random(1);
  std::vector<Vec3> points(n);
  for (Vec3& p : points) {
    p = random.in_box({-1, -1, -1}, {1, 1, 1});
    if (flat) p.z = 0.25;
  }
  return points;
}

void orient3d(benchmark::State& state, bool flat) {
  const auto p = random_points(4096 + 3, flat);
  std::size_t i = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(core::orient3d(p[i], p[i + 1], p[i + 2], p[i + 3]));
    i = (i + 1) & 4095u;
  }
}

void worst_dihedral(benchmark::State& state) {
  const auto p = random_points(4096 + 3, false);
  std::size_t i = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(core::worst_dihedral(p[i], p[i + 1], p[i + 2], p[i + 3]));
    i = (i + 1) & 4095u;
  }
}

// 82,944 tetrahedra: more than a second-level cache holds.
const core::MeshData& body() {
  static const core::MeshData mesh = core::testing::shaken_box(24, 24, 24, 1);
  return mesh;
}

void star(benchmark::State& state) {
  const TetMesh mesh(body());
  Random random(2);
  std::vector<std::uint32_t> corners;
  std::size_t tets = 0;
  for (auto _ : state) {
    mesh.star(random.below(mesh.vertex_slots()), corners);
    tets += corners.size();
  }
  state.counters["tets"] = benchmark::Counter(static_cast<double>(tets), benchmark::Counter::kAvgIterations);
}

void ring(benchmark::State& state) {
  const TetMesh mesh(body());
  Random random(3);
  std::vector<TetId> tets;
  for (auto _ : state) {
    const TetId t = random.below(mesh.tet_slots());
    const auto& e = core::kEdgeVertices[random.below(6)];
    mesh.ring(t, mesh.vertices(t)[e[0]], mesh.vertices(t)[e[1]], tets);
    benchmark::DoNotOptimize(tets.data());
  }
}

// Changes a mesh until it has changed enough, then takes a fresh one, untimed.
template <class Change>
void on_fresh_meshes(benchmark::State& state, int changes, Change change) {
  auto mesh = std::make_unique<TetMesh>(body());
  core::Delta delta;
  Random random(4);
  int done = 0;
  for (auto _ : state) {
    change(*mesh, random);
    if (++done < changes) continue;
    done = 0;
    state.PauseTiming();
    mesh = std::make_unique<TetMesh>(body());
    state.ResumeTiming();
  }
}

void split_edge(benchmark::State& state) {
  on_fresh_meshes(state, 5000, [](TetMesh& mesh, Random& random) {
    const TetId t = random.below(mesh.tet_slots());
    const auto& e = core::kEdgeVertices[random.below(6)];
    benchmark::DoNotOptimize(mesh.split_edge(t, mesh.vertices(t)[e[0]], mesh.vertices(t)[e[1]], 0.5));
  });
}

void open_faces(benchmark::State& state) {
  on_fresh_meshes(state, 5000, [](TetMesh& mesh, Random& random) {
    const core::HalfFace faces[] = {random.below(4 * mesh.tet_slots())};
    benchmark::DoNotOptimize(mesh.open_faces(faces));
  });
}

// A step of `range` moved vertices, with its delta.
void move_and_commit(benchmark::State& state) {
  TetMesh mesh(body());
  core::Delta delta;
  Random random(5);
  for (auto _ : state) {
    for (std::int64_t i = 0; i < state.range(0); ++i) {
      const VertexId v = random.below(mesh.vertex_slots());
      mesh.move_vertex(v, mesh.position(v) + Vec3{1e-9, 0, 0});
    }
    mesh.commit(delta);
    benchmark::DoNotOptimize(delta.state_hash);
  }
  state.SetItemsProcessed(state.iterations() * state.range(0));
}

void build(benchmark::State& state) {
  for (auto _ : state) {
    const TetMesh mesh(body());
    benchmark::DoNotOptimize(mesh.state_hash());
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(body().tets.size()));
}

// One frame's force on a blade that is drawn to and fro: `on_surface` presses without cutting, else it lies across the
// whole body, which may be `bent`.
void force(benchmark::State& state, bool on_surface, bool bent = false) {
  const core::MeshData data = core::testing::shaken_box(24, 24, 24, 1, 0.1, 0.005);
  haptics::Tissue tissue(data);
  core::CutSession session(data, {});
  if (bent) {
    auto positions = std::make_shared<core::VertexPositions>();
    for (const Vec3& p : data.positions) positions->positions.push_back(p + Vec3{0, 0, -p.x * p.x});
    session.deform(positions);
    core::Delta delta;
    auto budget = core::WorkBudget::unlimited();
    while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    }
    tissue.follow(session.mesh());
  }
  haptics::Materials materials;
  haptics::ForceModel model(materials, 2000, 0.5);
  haptics::BladeMotion motion;
  motion.engaged = !on_surface;
  motion.dt_s = motion.elapsed_s = 1e-3;
  haptics::Feel feel;
  int i = 0;
  const auto move = [&](double up) {
    i = (i + 1) % 1000;
    const double s = 1e-5 * (i < 500 ? i : 1000 - i);
    motion.tool = {0.0613 + s, 0.0487 + 0.7 * s, 0.15 + up};
    motion.line = {motion.tool, motion.tool - Vec3{0, 0, on_surface ? 0.032 : 0.16}};
    feel = model.update(tissue, motion, feel.force);
  };
  for (int k = 0; on_surface && k < 40; ++k) move(0.006 - 1.5e-4 * k);  // down to the surface
  for (auto _ : state) move(0);
  state.counters["N"] = length(feel.force);
  state.counters["edge_mm"] = 1e3 * feel.engagement.length_m;
}

// A step of a simulation that moves all vertices of a box of range^3 cubes: the loop's part, or the stream's.
// `known`: the loop's part in a session that knows what gives way, nothing, as the one that writes checkpoints.
void deform(benchmark::State& state, bool stream_part, bool known = false) {
  const auto n = static_cast<int>(state.range(0));
  core::CutSession session(core::testing::shaken_box(n, n, n, 1, 0.1, 0.005), {});
  const TetMesh& mesh = session.mesh();
  std::array<std::shared_ptr<core::VertexPositions>, 2> places;
  for (std::size_t k = 0; k < 2; ++k) {
    places[k] = std::make_shared<core::VertexPositions>();
    for (VertexId v = 0; v < mesh.vertex_slots(); ++v)
      places[k]->positions.push_back(mesh.position(v) +
                                     Vec3{0, 0, (k == 0 ? 1e-4 : -1e-4) * std::sin(30 * mesh.position(v).x)});
  }
  stream::InitialState initial;
  initial.epoch = 1;
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v) initial.positions.push_back(mesh.position(v));
  for (TetId t = 0; t < mesh.tet_slots(); ++t) initial.tets.push_back(mesh.state(t));
  stream::Mirror mirror;
  if (stream_part) mirror.reset(initial);
  stream::PublishedDelta published;
  std::size_t i = 0;
  for (auto _ : state) {
    if (stream_part) state.PauseTiming();
    auto budget = core::WorkBudget::unlimited();
    session.deform(places[i++ % 2]);
    const std::vector<core::GaveWay> nothing;
    session.advance(budget, published.delta, known ? &nothing : nullptr);
    if (!stream_part) continue;
    state.ResumeTiming();
    benchmark::DoNotOptimize(mirror.apply(published));
  }
  state.counters["vertices"] = mesh.vertex_slots();
  state.counters["tets"] = mesh.live_tets();
  state.counters["moved"] = static_cast<double>(published.delta.moved.size());
}

int run(const std::string& filter, double min_time_s, bool json) {
  benchmark::RegisterBenchmark("orient3d/random", [](benchmark::State& s) { orient3d(s, false); });
  benchmark::RegisterBenchmark("orient3d/coplanar", [](benchmark::State& s) { orient3d(s, true); });
  benchmark::RegisterBenchmark("worst_dihedral", worst_dihedral);
  benchmark::RegisterBenchmark("star", star);
  benchmark::RegisterBenchmark("ring", ring);
  benchmark::RegisterBenchmark("split_edge", split_edge);
  benchmark::RegisterBenchmark("open_faces/one", open_faces);
  benchmark::RegisterBenchmark("move_and_commit", move_and_commit)->Arg(1)->Arg(100);
  benchmark::RegisterBenchmark("build", build)->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("force/pressing", [](benchmark::State& s) { force(s, true); });
  benchmark::RegisterBenchmark("force/cutting_120_mm", [](benchmark::State& s) { force(s, false); });
  benchmark::RegisterBenchmark("force/cutting_120_mm_bent",
                               [](benchmark::State& s) { force(s, false, true); });
  for (const bool stream_part : {false, true}) {
    benchmark::RegisterBenchmark(stream_part ? "deform/stream" : "deform/loop",
                                 [stream_part](benchmark::State& s) { deform(s, stream_part); })
        ->Arg(14)
        ->Arg(45)
        ->Unit(benchmark::kMillisecond);
  }
  benchmark::RegisterBenchmark("deform/known", [](benchmark::State& s) { deform(s, false, true); })
      ->Arg(45)
      ->Unit(benchmark::kMillisecond);
  std::vector<std::string> arguments{"incise-bench", "--benchmark_filter=" + filter,
                                     "--benchmark_min_time=" + std::to_string(min_time_s)};
  if (json) arguments.push_back("--benchmark_format=json");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  int argc = static_cast<int>(argv.size());
  benchmark::Initialize(&argc, argv.data());
  return static_cast<int>(benchmark::RunSpecifiedBenchmarks());
}

}  // namespace

void add_micro_bench(CLI::App& app, Report& report) {
  struct Options {
    std::string filter = ".*";
    double min_time_s = 0.5;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("micro", "Predicates, quality, stars, splits: one operation at a time");
  command->add_option("--filter", options->filter, "Only those whose name matches this regular expression");
  command->add_option("--min-time", options->min_time_s, "Seconds for each")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->callback([options, &report] {
    if (run(options->filter, options->min_time_s, report.json) == 0) {
      throw std::runtime_error("--filter '" + options->filter + "' matches no benchmark");
    }
  });
}

}  // namespace incise::bench
