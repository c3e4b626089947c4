#pragma once

namespace CLI {
class App;
}

// The registry: each <name>_bench.cpp adds its subcommand, whose callback runs the bench and fills the report.
namespace incise::bench {

class Report;

void add_cut_bench(CLI::App& app, Report& report);
void add_fanout_bench(CLI::App& app, Report& report);
void add_life_bench(CLI::App& app, Report& report);
void add_meet_bench(CLI::App& app, Report& report);
void add_micro_bench(CLI::App& app, Report& report);
void add_paper_bench(CLI::App& app, Report& report);
void add_plane_bench(CLI::App& app, Report& report);
void add_scale_bench(CLI::App& app, Report& report);
void add_stream_bench(CLI::App& app, Report& report);
void add_events_bench(CLI::App& app, Report& report);
void add_live_bench(CLI::App& app, Report& report);
void add_loop_bench(CLI::App& app, Report& report);

}  // namespace incise::bench
