// What relays give and cost: viewers at a relay, how late they see a cut, bytes and processor time of origin and relays.

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/bench/crowd.hpp"
#include "tests/bench/live_server.hpp"
#include "tests/e2e/process.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::bench {
namespace {

struct FanoutBench : LiveMotion {
  FanoutBench() { seconds = 10; }
  std::vector<int> viewers{250, 500, 1000};
  std::vector<int> relays{0, 1, 2};
  std::string view = "surface";
};

// What a process has used so far.
struct Use {
  double cpu_s = 0, resident_mb = 0;
};
Use use_of(pid_t pid) {
  Use use;
  std::ifstream stat("/proc/" + std::to_string(pid) + "/stat");
  std::string text((std::istreambuf_iterator<char>(stat)), {});
  std::istringstream fields(text.substr(std::min(text.rfind(')') + 2, text.size())));
  std::string skipped;
  for (int i = 3; i < 14; ++i) fields >> skipped;
  double user = 0, system = 0;
  fields >> user >> system;
  use.cpu_s = (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  for (std::string key; status >> key;) {
    double kb = 0;
    if (key == "VmRSS:" && status >> kb) use.resident_mb = kb / 1024;
  }
  return use;
}

// Bytes of messages that a server has sent, or received.
double bytes_of(std::uint16_t http_port, const std::string& way) {
  const std::string text = stream::http(http_port, "/metrics"),
                    name = "\nincise_stream_bytes_" + way + "_total ";
  const auto at = text.find(name);
  return at == std::string::npos ? 0 : std::strtod(text.c_str() + at + name.size(), nullptr);
}

// incise-relay of the server, on free ports.
struct Relay {
  Relay(const LiveServer& server, int max_sessions, const std::filesystem::path& config) {
    nlohmann::json json{{"relay", {{"upstream", "127.0.0.1:" + std::to_string(server.tcp_port())}}},
                        {"listen", {{"tcp_port", 0}, {"http_port", 0}, {"max_sessions", max_sessions}}},
                        {"log", {{"level", "warning"}}}};
    std::ofstream(config) << json;
    process =
        std::make_unique<e2e::Process>(std::vector<std::string>{"incise-relay", "--config", config.string()});
    const std::string line = process->line("listening ");
    if (line.empty()) throw std::runtime_error("incise-relay did not start");
    tcp_port = e2e::port_after(line, "tcp=");
    http_port = e2e::port_after(line, "http=");
  }
  std::unique_ptr<e2e::Process> process;
  std::uint16_t tcp_port = 0, http_port = 0;
};

// One row: so many viewers, shared by so many relays; without any they are at the origin.
void run_fanout(const FanoutBench& bench, int viewers, int relay_count, Report& report) {
  LiveServer server(bench, {{"max_sessions", viewers + 20}});
  std::vector<std::unique_ptr<Relay>> relays;
  const auto folder =
      std::filesystem::temp_directory_path() / ("incise_fanout_" + std::to_string(::getpid()));
  std::filesystem::create_directories(folder);
  for (int i = 0; i < relay_count; ++i) {
    relays.push_back(
        std::make_unique<Relay>(server, viewers + 20, folder / ("relay_" + std::to_string(i) + ".json")));
  }
  std::vector<std::unique_ptr<Crowd>> crowds;
  const int shares = std::max(relay_count, 1);
  for (int i = 0; i < shares; ++i) {
    Crowd::Options options;
    options.viewers = viewers / shares + (i < viewers % shares ? 1 : 0);
    options.view = bench.view == "volume" ? protocol::View::Volume : protocol::View::Surface;
    const std::uint16_t port =
        relay_count > 0 ? relays[static_cast<std::size_t>(i)]->tcp_port : server.tcp_port();
    crowds.push_back(std::make_unique<Crowd>(port, options));
  }
  for (const auto& crowd : crowds) {
    if (!crowd->wait_for_revision(0, 60)) throw std::runtime_error("a viewer got no snapshot");
  }
  server.connect_device();
  const Use before = use_of(server.pid());
  const double origin_out = bytes_of(server.http_port(), "out");
  std::vector<Use> relay_before;
  std::vector<double> relay_out;
  for (const auto& relay : relays) {
    relay_before.push_back(use_of(relay->process->pid()));
    relay_out.push_back(bytes_of(relay->http_port, "out"));
  }
  server.drive();
  const nlohmann::json stats = server.settled_stats();
  for (const auto& crowd : crowds) {
    if (!crowd->wait_for_revision(stats["revision"], 120))
      throw std::runtime_error("a viewer fell behind for good");
  }
  const Use after = use_of(server.pid());
  std::vector<double> ms;
  int lost = 0;
  for (const auto& crowd : crowds) {
    const std::vector<double>& theirs = crowd->stop();
    ms.insert(ms.end(), theirs.begin(), theirs.end());
    lost += crowd->viewers_lost();
  }
  double relay_cpu = 0, relay_mb = 0, sent = 0;
  for (std::size_t i = 0; i < relays.size(); ++i) {
    const Use use = use_of(relays[i]->process->pid());
    relay_cpu = std::max(relay_cpu, use.cpu_s - relay_before[i].cpu_s);
    relay_mb = std::max(relay_mb, use.resident_mb);
    sent += bytes_of(relays[i]->http_port, "out") - relay_out[i];
  }
  const double origin_sent = bytes_of(server.http_port(), "out") - origin_out;
  const auto& work = stats["stages_us"]["frame_work"];
  report.row({std::int64_t{relay_count}, std::int64_t{viewers}, static_cast<std::int64_t>(stats["revision"]),
              percentile(ms, 0.5), percentile(ms, 0.99), percentile(ms, 1), std::int64_t{lost},
              1e-6 * origin_sent, 1e-6 * sent, 100 * (after.cpu_s - before.cpu_s) / bench.seconds,
              100 * relay_cpu / bench.seconds, relay_mb, work["p99"].get<double>(),
              work["p99.9"].get<double>()});
  crowds.clear();
  for (const auto& relay : relays) {
    relay->process->signal(SIGTERM);
    if (relay->process->wait() != 0) throw std::runtime_error("incise-relay did not end cleanly");
  }
  server.end();
  std::filesystem::remove_all(folder);
}

void run(const FanoutBench& bench, Report& report) {
  report.begin("fanout");
  raise_descriptor_limit();
  report.fact("view", bench.view);
  report.fact("tetrahedra", std::int64_t{bench.tets});
  report.fact("seconds", bench.seconds);
  report.table(
      "a device cuts at the origin while viewers follow, over loopback; the viewers run on the same machine",
      {{"relays"},
       {"viewers"},
       {"deltas"},
       {"cut to viewer p50, ms", 2},
       {"p99, ms", 2},
       {"max, ms", 2},
       {"viewers lost"},
       {"origin sent, MB", 2},
       {"relays sent, MB", 2},
       {"origin CPU, %", 1},
       {"busiest relay CPU, %", 1},
       {"largest relay, MB", 1},
       {"frame work p99, us", 1},
       {"p99.9, us", 1}});
  for (const int viewers : bench.viewers) {
    for (const int relays : bench.relays) run_fanout(bench, viewers, relays, report);
  }
}

}  // namespace

void add_fanout_bench(CLI::App& app, Report& report) {
  auto bench = std::make_shared<FanoutBench>();
  CLI::App* sub = app.add_subcommand("fanout", "How many viewers relays serve, how late, and what it costs");
  sub->add_option("--viewers", bench->viewers, "That follow, one run for each number")
      ->check(CLI::Range(1, 100'000))
      ->delimiter(',')
      ->capture_default_str();
  sub->add_option("--relays", bench->relays,
                  "That share them, one run for each number; 0: they are at the origin")
      ->check(CLI::Range(0, 64))
      ->delimiter(',')
      ->capture_default_str();
  sub->add_option("--view", bench->view, "Of the viewers")
      ->check(CLI::IsMember({"surface", "volume"}))
      ->capture_default_str();
  sub->add_option("--tets", bench->tets, "Of the phantom liver")->capture_default_str();
  sub->add_option("--seconds", bench->seconds, "How long poses come in each run")->capture_default_str();
  sub->add_option("--speed", bench->speed_m_s, "Of the blade, m/s")->capture_default_str();
  sub->callback([bench, &report] { run(*bench, report); });
}

}  // namespace incise::bench
