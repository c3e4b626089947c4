#include <CLI/CLI.hpp>
#include <memory>

#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"

// The paper's table (Croll 2007, section 4.2): one cut through cylinders of 1,720 vertices / 7,844 tetrahedra and
// 3,234 / 15,272, by the policy `croll` and by `conforming`, with the paper's times of 2007.
namespace incise::bench {
namespace {

struct Setting {
  const char* file;  // in the data folder
  std::size_t tets;  // of the paper's mesh
  double paper_s;    // section 4.2
};
constexpr Setting kSettings[] = {{"seed_1720", 7844, 0.016}, {"seed_3234", 15272, 0.047}};
constexpr core::Vec3 kNormal{0.31, 0.17, 1};

void run(int repetitions, bool use_phantom, Report& report) {
  report.begin("paper");
  report.fact("paper", std::string("Croll 2007, section 4.2, on a Core2 Quad at 2.66 GHz"));
  report.fact("repetitions", count(static_cast<std::uint64_t>(repetitions)));
  struct Outcome {
    std::string name;
    core::CutReport before, after;
    core::Deviation deviation;
    SessionTotals totals;
    std::uint64_t hash;
  };
  std::vector<Outcome> outcomes;
  report.table("CPU time of one through-cut, ms", {{"mesh and policy"},
                                                   {"vertices"},
                                                   {"tets"},
                                                   {"paper", 0},
                                                   {"p50", 3},
                                                   {"p99", 3},
                                                   {"max", 3},
                                                   {"cold", 3},
                                                   {"paper / p50", 1},
                                                   {"work units"},
                                                   {"us a cut face", 2}});
  for (const Setting& setting : kSettings) {
    const bool from_data = !use_phantom && !data_folder().empty();
    const NamedMesh mesh = from_data ? load(data_folder() + "/meshes/" + setting.file + ".node", 0.001)
                                     : phantom("cylinder", setting.tets);
    const ThroughCut cut = through_cut(mesh.mesh, kNormal);
    for (core::Policy policy : {core::Policy::kCroll, core::Policy::kConforming}) {
      std::unique_ptr<core::CutSession> last;
      SessionTotals totals;
      core::CutReport before;
      const Timings timings = time_repeated(
          repetitions,
          [&] {
            auto session = std::make_unique<core::CutSession>(mesh.mesh, bench_config(policy));
            if (before.tets == 0) before = core::measure(session->mesh());
            push(*session, cut, 1);
            return session;
          },
          [&](std::unique_ptr<core::CutSession>& session) {
            totals = run_all(*session);
            last = std::move(session);
          });
      const std::string name = mesh.name + (policy == core::Policy::kCroll ? " croll" : " conforming");
      const double p50 = percentile(timings.warm, 0.5);
      report.row({name, count(before.vertices), count(before.tets), 1e3 * setting.paper_s, 1e3 * p50,
                  1e3 * percentile(timings.warm, 0.99), 1e3 * percentile(timings.warm, 1), 1e3 * timings.cold,
                  setting.paper_s / p50, Cell(totals.work_units),
                  1e6 * p50 / std::max(totals.counts.cut_faces, 1u)});
      core::SweptSurface surface;
      core::add_sweep(surface, std::vector{cut.from, cut.to}, 1e-3 * last->mesh().mean_edge_length());
      surface.build();
      outcomes.push_back({name, before, core::measure(last->mesh()), core::deviation(last->mesh(), surface),
                          totals, last->mesh().state_hash()});
    }
  }
  report.table("what the cut left", {{"mesh and policy"},
                                     {"vertices"},
                                     {"tets"},
                                     {"growth %", 2},
                                     {"cut faces"},
                                     {"cut area cm2", 3},
                                     {"removed"},
                                     {"inverted"},
                                     {"pieces"},
                                     {"islands"},
                                     {"angle before", 2},
                                     {"angle after", 2},
                                     {"deviation max h", 4},
                                     {"mean h", 5},
                                     {"hash"}});
  for (const Outcome& o : outcomes) {
    const double growth = 100.0 * (static_cast<double>(o.after.tets) / o.before.tets - 1);
    report.row({o.name, count(o.after.vertices), count(o.after.tets), growth, count(o.after.cut_faces),
                1e4 * o.after.cut_area, count(o.totals.counts.removed_tets), count(o.after.inverted),
                count(o.after.pieces), count(o.after.islands), o.before.min_dihedral_deg,
                o.after.min_dihedral_deg, o.deviation.max_h, o.deviation.mean_h, hex(o.hash)});
  }
}

}  // namespace

void add_paper_bench(CLI::App& app, Report& report) {
  struct Options {
    int repetitions = 200;
    bool phantom = false;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("paper", "The paper's two cylinders, with the paper's times");
  command->add_option("--repetitions", options->repetitions, "Cuts to time, each in a fresh mesh")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_flag("--phantom", options->phantom,
                    "Use cylinders of our own even where INCISE_DATA names a folder with meshes/seed_*");
  command->callback([options, &report] { run(options->repetitions, options->phantom, report); });
}

}  // namespace incise::bench
