#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <random>

#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"

// What a cut costs as the mesh grows (`scale`), and what one operation costs (`events`).
namespace incise::bench {
namespace {

using core::Vec3;

// A block of about `tets` tetrahedra, six in each cube of a grid whose points are shaken (Kuhn 1960); h is about
// 1.3 mm whatever the count. The corner at the origin is the same for all.
core::MeshData block(std::size_t tets) {
  const auto n =
      static_cast<std::uint32_t>(std::max(2.0, std::round(std::cbrt(static_cast<double>(tets) / 6))));
  constexpr double kCell_m = 0.001;
  core::MeshData mesh;
  const auto id = [n](std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    return (z * (n + 1) + y) * (n + 1) + x;
  };
  mesh.positions.reserve(std::size_t{n + 1} * (n + 1) * (n + 1));
  for (std::uint32_t z = 0; z <= n; ++z) {
    for (std::uint32_t y = 0; y <= n; ++y) {
      for (std::uint32_t x = 0; x <= n; ++x) {
        // Of the place alone, so that the corner looks the same in every block.
        std::mt19937_64 random(std::uint64_t{x} << 42 | std::uint64_t{y} << 21 | z);
        const auto shake = [&](std::uint32_t at) {
          const double u = static_cast<double>(random() >> 11) * 0x1p-53 - 0.5;
          return kCell_m * (at + (at == 0 || at == n ? 0.0 : 0.4 * u));
        };
        const double px = shake(x), py = shake(y), pz = shake(z);
        mesh.positions.push_back({px, py, pz});
      }
    }
  }
  constexpr int kPaths[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  mesh.tets.reserve(6 * std::size_t{n} * n * n);
  for (std::uint32_t z = 0; z < n; ++z) {
    for (std::uint32_t y = 0; y < n; ++y) {
      for (std::uint32_t x = 0; x < n; ++x) {
        for (int p = 0; p < 6; ++p) {
          std::array<std::uint32_t, 3> at{x, y, z};
          std::array<core::VertexId, 4> tet{id(x, y, z), 0, 0, 0};
          for (int i = 0; i < 3; ++i) {
            ++at[static_cast<std::size_t>(kPaths[p][i])];
            tet[static_cast<std::size_t>(i) + 1] = id(at[0], at[1], at[2]);
          }
          if (p >= 3) std::swap(tet[2], tet[3]);
          mesh.tets.push_back(tet);
        }
      }
    }
  }
  return mesh;
}

// A straight sweep that takes off the corner at the origin, `size_m` along each axis.
ThroughCut corner_cut(double size_m) {
  const Vec3 normal = core::normalized({1, 0.93, 1.07});
  const Vec3 middle{size_m / 3, size_m / 3, size_m / 3};
  const Vec3 along = core::normalized(core::cross(normal, {1, 0, 0})), ahead = core::cross(normal, along);
  const auto line = [&](double s) {
    const Vec3 p = middle + s * ahead;
    return core::BladeLine{p - (1.5 * size_m) * along, p + (1.5 * size_m) * along};
  };
  return {line(-1.5 * size_m), line(1.5 * size_m)};
}

struct Cost {
  std::vector<double> seconds;
  SessionTotals totals;
  std::uint64_t touched = 0;
  std::uint32_t tets = 0;
};

// One session for all repetitions would cut the same place twice: so a fresh one each time.
Cost time_cut(const core::MeshData& mesh, const ThroughCut& cut, int segments, int repetitions) {
  Cost cost;
  const Timings timings = time_repeated(
      repetitions,
      [&] {
        auto session = std::make_unique<core::CutSession>(mesh, bench_config(core::Policy::kConforming));
        cost.tets = session->mesh().live_tets();
        push(*session, cut, segments);
        return session;
      },
      [&](std::unique_ptr<core::CutSession>& session) { cost.totals = run_all(*session); });
  cost.seconds = timings.warm;
  return cost;
}

void run_scale(const std::vector<std::size_t>& sizes, double corner_h, int repetitions, Report& report) {
  report.begin("scale");
  report.fact("blocks", std::string("shaken grids; the same corner is cut off each"));
  report.table("the same cut in meshes that grow; CPU time", {{"tets"},
                                                              {"corner ms", 3},
                                                              {"to the first", 2},
                                                              {"events"},
                                                              {"cut faces"},
                                                              {"units"},
                                                              {"through ms", 2},
                                                              {"events "},
                                                              {"cut faces "},
                                                              {"us an event", 2}});
  double first = 0;
  for (const std::size_t size : sizes) {
    const core::MeshData mesh = block(size);
    const Cost corner = time_cut(mesh, corner_cut(0.001 * corner_h), 4, repetitions);
    const Cost through = time_cut(mesh, through_cut(mesh, {0.31, 0.17, 1}), 1, std::max(1, repetitions / 10));
    const double ms = 1e3 * percentile(corner.seconds, 0.5),
                 through_ms = 1e3 * percentile(through.seconds, 0.5);
    if (first == 0) first = ms;
    report.row({std::to_string(corner.tets), ms, ms / first, count(corner.totals.counts.events),
                count(corner.totals.counts.cut_faces), Cell(corner.totals.work_units), through_ms,
                count(through.totals.counts.events), count(through.totals.counts.cut_faces),
                1e3 * through_ms / std::max(through.totals.counts.events, 1u)});
  }
}

// One cut right through a mesh file, along a plane: what tests/bench/peers compares with others.
void run_plane(const std::string& file, const std::vector<double>& normal, int repetitions, Report& report) {
  report.begin("plane");
  const NamedMesh mesh = load(file, 1);
  const ThroughCut cut = through_cut(mesh.mesh, {normal[0], normal[1], normal[2]});
  std::unique_ptr<core::CutSession> last;
  SessionTotals totals;
  const Timings timings = time_repeated(
      repetitions,
      [&] {
        auto session = std::make_unique<core::CutSession>(mesh.mesh, bench_config(core::Policy::kConforming));
        push(*session, cut, 1);
        return session;
      },
      [&](std::unique_ptr<core::CutSession>& session) {
        totals = run_all(*session);
        last = std::move(session);
      });
  const core::CutReport after = core::measure(last->mesh());
  report.fact("mesh", mesh.name);
  report.fact("p50 ms", 1e3 * percentile(timings.warm, 0.5));
  report.fact("min ms", 1e3 * percentile(timings.warm, 0));
  report.fact("tets before", count(mesh.mesh.tets.size()));
  report.fact("tets after", count(after.tets));
  report.fact("pieces", count(after.pieces));
  report.fact("cut faces", count(after.cut_faces));
  report.fact("events", count(totals.counts.events));
  report.fact("min dihedral deg", after.min_dihedral_deg);
}

std::vector<double> differences(const std::vector<std::int64_t>& ns) {
  std::vector<double> out;
  for (std::size_t i = 1; i < ns.size(); ++i) out.push_back(1e-3 * static_cast<double>(ns[i] - ns[i - 1]));
  return out;
}

// Stops after every operation and looks at the clock; what the clock itself takes is measured first.
void run_events(std::size_t size, int segments, Report& report) {
  report.begin("events");
  const core::MeshData mesh = block(size);
  core::CutSession session(mesh, bench_config(core::Policy::kConforming));
  push(session, through_cut(mesh, {0.31, 0.17, 1}), segments);
  std::vector<std::int64_t> clock(2000);
  for (auto& t : clock) t = static_cast<std::int64_t>(1e9 * thread_cpu_s());
  const double clock_us = percentile(differences(clock), 0.5);

  core::CutCounts counts;
  core::Delta delta;
  std::vector<double> operations_us, events_us, commits_us;
  std::uint64_t delta_bytes = 0;
  for (;;) {
    core::WorkBudget one{1};
    const std::uint32_t events = session.running_counts().events;
    const double start = thread_cpu_s();
    const auto progress = session.advance(one, delta);
    const double us = std::max(0.0, 1e6 * (thread_cpu_s() - start) - clock_us);
    if (progress == core::CutSession::Progress::kIdle) break;
    if (progress == core::CutSession::Progress::kSpent) {
      operations_us.push_back(us);
      if (session.running_counts().events > events) events_us.push_back(us);
      continue;
    }
    commits_us.push_back(us);
    counts.events += session.committed_counts().events;
    counts.cut_faces += session.committed_counts().cut_faces;
    delta_bytes += delta.moved.size() * 28 + delta.added_positions.size() * 40 + delta.upserted.size() * 26 +
                   delta.removed.size() * 4 +
                   (delta.boundary_upserted.size() + delta.boundary_removed.size()) * 4;
  }
  double sum = 0;
  for (const double us : operations_us) sum += us;
  for (const double us : commits_us) sum += us;
  report.fact("tets", count(mesh.tets.size()));
  report.fact("events", count(counts.events));
  report.fact("cut faces", count(counts.cut_faces));
  report.fact("us an event, all work", sum / std::max(counts.events, 1u));
  report.fact("delta bytes an event, before encoding",
              static_cast<double>(delta_bytes) / std::max(counts.events, 1u));
  report.table("CPU time between two stops, microseconds",
               {{"what"}, {"count"}, {"p50", 2}, {"p90", 2}, {"p99", 2}, {"max", 2}});
  const auto row = [&](const char* what, const std::vector<double>& us) {
    report.row({std::string(what), count(us.size()), percentile(us, 0.5), percentile(us, 0.9),
                percentile(us, 0.99), percentile(us, 1)});
  };
  row("operation", operations_us);
  row("of them: an event (snap or split)", events_us);
  row("commit of a batch", commits_us);
}

}  // namespace

void add_scale_bench(CLI::App& app, Report& report) {
  struct Options {
    std::vector<std::size_t> sizes{15'000, 150'000, 1'500'000, 5'000'000};
    double corner_h = 6;
    int repetitions = 20;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("scale", "The same cut in meshes of 15k to 5M tetrahedra, and cuts right through");
  command->add_option("--tets", options->sizes, "Sizes of the meshes")->delimiter(',')->capture_default_str();
  command->add_option("--corner", options->corner_h, "Size of the corner that is cut off, in grid cells")
      ->check(CLI::Range(1.0, 20.0))
      ->capture_default_str();
  command->add_option("--repetitions", options->repetitions, "Corner cuts to time, each in a fresh mesh")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  command->callback(
      [options, &report] { run_scale(options->sizes, options->corner_h, options->repetitions, report); });
}

void add_plane_bench(CLI::App& app, Report& report) {
  struct Options {
    std::string mesh;
    std::vector<double> normal{0.31, 0.17, 1};
    int repetitions = 20;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("plane", "One cut right through a mesh file, along a plane through its middle");
  command->add_option("--mesh", options->mesh, "The mesh")->required();
  command->add_option("--normal", options->normal, "The plane's normal")->delimiter(',')->expected(3);
  command->add_option("--repetitions", options->repetitions, "Cuts to time, each in a fresh mesh")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  command->callback(
      [options, &report] { run_plane(options->mesh, options->normal, options->repetitions, report); });
}

void add_events_bench(CLI::App& app, Report& report) {
  struct Options {
    std::size_t size = 150'000;
    int segments = 50;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("events", "Time and bytes of single operations in one cut right through");
  command->add_option("--tets", options->size, "Size of the mesh")->capture_default_str();
  command->add_option("--segments", options->segments, "Steps that describe the motion")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  command->callback([options, &report] { run_events(options->size, options->segments, report); });
}

}  // namespace incise::bench
