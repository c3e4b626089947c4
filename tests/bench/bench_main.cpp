#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"

int main(int argc, char** argv) {
  CLI::App app("Incise's benchmarks. Meshes come from the folder that INCISE_DATA names, or are phantoms.",
               "incise-bench");
  incise::bench::Report report;
  app.add_flag("--json", report.json, "Print one JSON object instead of tables");
  app.fallthrough();
  app.require_subcommand(0, 1);
  incise::bench::add_cut_bench(app, report);
  incise::bench::add_life_bench(app, report);
  incise::bench::add_meet_bench(app, report);
  incise::bench::add_micro_bench(app, report);
  incise::bench::add_paper_bench(app, report);
  incise::bench::add_loop_bench(app, report);
  incise::bench::add_plane_bench(app, report);
  incise::bench::add_scale_bench(app, report);
  incise::bench::add_events_bench(app, report);
#ifdef INCISE_LIVE_BENCH
  incise::bench::add_fanout_bench(app, report);
  incise::bench::add_live_bench(app, report);
  incise::bench::add_stream_bench(app, report);
#endif
  try {
    app.parse(argc, argv);
    if (app.get_subcommands().empty()) std::printf("%s", app.help().c_str());
    report.print();
  } catch (const CLI::ParseError& error) {
    return app.exit(error);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise-bench: %s\n", error.what());
    return 1;
  }
  return 0;
}
