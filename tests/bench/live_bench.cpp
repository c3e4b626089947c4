// incise-bench live: the whole server as it is run. incised in a process of its own on a phantom liver, with its journal
// and checkpoints; a device that sends each pose as it is measured; viewers that follow; all over loopback.

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "client/client.hpp"
#include "server/input/input_hub.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/e2e/process.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/support/to_and_fro.hpp"

namespace incise::bench {
namespace {

namespace fs = std::filesystem;
using input::monotonic_ns;

struct LiveBench {
  double seconds = 60;
  double pose_rate_hz = 1000;
  double speed_m_s = 0.2;
  int tets = 60'000;
  int viewers = 4;
  double batch_h = 0;
  bool capture = true;
};

// A folder for the server's files that goes with this.
struct Folder {
  fs::path path = fs::temp_directory_path() / ("incise_live_" + std::to_string(::getpid()));
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
};

// What a viewer saw of each delta, ms. Filled on the clients' threads. One machine, so one clock.
struct Latencies {
  std::mutex mutex;
  std::vector<double> pose_to_here, arrival_to_here, cut_to_here;
  void note(const std::vector<protocol::Step>& steps, std::int64_t received_ns) {
    const std::scoped_lock lock(mutex);
    for (const protocol::Step& step : steps) {
      pose_to_here.push_back(1e-6 * static_cast<double>(received_ns - step.to_source_ns));
      arrival_to_here.push_back(1e-6 * static_cast<double>(received_ns - step.arrival_ns));
      cut_to_here.push_back(1e-6 * static_cast<double>(received_ns - step.cut_ns));
    }
  }
};

void write_config(const LiveBench& bench, const core::Blade& blade, const fs::path& file) {
  nlohmann::json config{{"mesh", {{"phantom", "liver"}, {"target_tets", bench.tets}}},
                        {"blade",
                         {{"heel", {blade.heel.x, blade.heel.y, blade.heel.z}},
                          {"tip", {blade.tip.x, blade.tip.y, blade.tip.z}}}},
                        {"listen", {{"tcp_port", 0}, {"http_port", 0}}},
                        {"log", {{"level", "warning"}}}};
  if (bench.capture) config["capture"]["path"] = "live.capture";
  if (bench.batch_h > 0) config["cut"]["batch_h"] = bench.batch_h;
  std::ofstream(file) << config;
}

// Poses at their times, each sent as soon as it is there; the source's clock is CLOCK_MONOTONIC.
void send_poses(const LiveBench& bench, tests::ToAndFro motion, client::Client& client, std::uint64_t& sent,
                std::uint64_t& sequence) {
  const std::int64_t start = monotonic_ns(), period = static_cast<std::int64_t>(1e9 / bench.pose_rate_hz);
  const auto poses = static_cast<std::int64_t>(bench.seconds * bench.pose_rate_hz);
  for (std::int64_t i = 0; i <= poses; ++i) {
    const std::int64_t at = start + i * period;
    const timespec when{at / 1'000'000'000, at % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr) != 0) {
    }
    const core::Pose pose = motion.next();
    const core::Vec3& p = pose.position;
    // The last one is lifted: what was begun is ended.
    const protocol::PoseSample sample{at, {p.x, p.y, p.z}, {1, 0, 0, 0}, i < poses ? pose.buttons : 0, 0};
    if (const std::uint64_t n = client.send_poses(std::span(&sample, 1))) {
      sequence = n;
      ++sent;
    }
  }
}

nlohmann::json stats_of(std::uint16_t http_port) {
  const std::string answer = stream::http(http_port, "/stats");
  const auto body = answer.find("\r\n\r\n");
  return nlohmann::json::parse(body == std::string::npos ? "" : answer.substr(body + 4), nullptr, false);
}

std::uint16_t port_after(const std::string& line, const std::string& key) {
  const auto colon = line.find(':', line.find(key));
  return static_cast<std::uint16_t>(std::atoi(line.c_str() + colon + 1));
}

void run(const LiveBench& bench, Report& report) {
  const NamedMesh body = phantom("liver", static_cast<std::size_t>(bench.tets));
  const auto [low, high] = bounds(body.mesh);
  const tests::ToAndFro motion(low, high, bench.speed_m_s, bench.pose_rate_hz);
  const Folder folder;
  write_config(bench, motion.blade(), folder.path / "live.json");
  e2e::Process server({"incised", "--config", (folder.path / "live.json").string()});
  const std::string line = server.line("listening ");
  if (line.empty()) throw std::runtime_error("incised did not start");
  const std::uint16_t tcp = port_after(line, "tcp="), http = port_after(line, "http=");

  Latencies latencies;
  std::vector<std::unique_ptr<client::Client>> viewers;
  for (int i = 0; i < bench.viewers; ++i) {  // half of them hold the volume, half the surface over WebSocket
    client::Options options;
    client::Callbacks callbacks;
    if (i % 2 == 0) {
      callbacks.on_delta = [&](const protocol::Replica&, const protocol::Delta& delta,
                               const client::Arrival& arrival) {
        latencies.note(delta.steps, arrival.received_ns);
      };
    } else {
      options.view = protocol::View::Surface;
      options.transport = client::TransportKind::kWebSocket;
      callbacks.on_surface_delta = [&](const protocol::SurfaceReplica&, const protocol::SurfaceDelta& delta,
                                       const client::Arrival& arrival) {
        latencies.note(delta.steps, arrival.received_ns);
      };
    }
    viewers.push_back(
        client::Client::connect("127.0.0.1", i % 2 == 0 ? tcp : http, options, std::move(callbacks)));
    if (!viewers.back()->wait_for_revision(0, 60)) throw std::runtime_error("a viewer got no snapshot");
  }
  client::Options options;
  options.role = protocol::Role::Operator;
  options.view = protocol::View::None;
  const auto device = client::Client::connect("127.0.0.1", tcp, options);
  std::uint64_t sent = 0, sequence = 0;
  send_poses(bench, motion, *device, sent, sequence);
  const bool settled = device->wait_for_report(sequence, 60);
  const protocol::PoseReport taken = device->report();
  nlohmann::json stats = stats_of(http);
  for (int i = 0; i < 6000 && (stats["backlog"]["batches"] != 0 || i < 20); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    stats = stats_of(http);
  }
  const std::uint64_t revision = stats["revision"];
  for (const auto& viewer : viewers) {
    if (!viewer->wait_for_revision(revision, 60)) throw std::runtime_error("a viewer did not get to the end");
  }
  device->close();
  server.signal(SIGTERM);
  if (server.wait() != 0) throw std::runtime_error("incised did not end cleanly");

  report.begin("live");
  report.fact("tetrahedra", count(body.mesh.tets.size()));
  report.fact("viewers", count(viewers.size()));
  report.fact("poses sent", count(sent));
  report.fact("poses accepted", count(taken.accepted));
  report.fact("poses lost", static_cast<std::int64_t>(sent) - static_cast<std::int64_t>(taken.accepted));
  report.fact("settled", std::string(settled ? "yes" : "no"));
  report.fact("revision", count(revision));
  report.fact("cut faces", count(stats["cut_faces"]));
  report.fact("tetrahedra at the end", count(stats["live_tets"]));
  report.fact("frames", count(stats["frames"]["count"]));
  report.fact("frames skipped", count(stats["frames"]["skipped"]));
  for (const auto& [cause, n] : stats["frames"]["late"].items()) report.fact("late: " + cause, count(n));
  report.fact("ns a work unit", stats["ns_per_work_unit"].get<double>());
  report.fact("state hash", stats["state_hash"].get<std::string>());
  if (stats.contains("journal")) report.fact("journal records lost", count(stats["journal"]["lost"]));
  if (stats.contains("checkpoints")) report.fact("checkpoints", count(stats["checkpoints"]["written"]));
  report.table("in the server, us", {{"stage"}, {"count"}, {"p50", 1}, {"p99", 1}, {"p99.9", 1}, {"max", 1}});
  for (const auto& [stage, figures] : stats["stages_us"].items()) {
    report.row({stage, count(figures["count"]), figures["p50"].get<double>(), figures["p99"].get<double>(),
                figures["p99.9"].get<double>(), figures["max"].get<double>()});
  }
  report.table("at the viewers, ms",
               {{"way of a batch's last pose"}, {"deltas"}, {"p50", 2}, {"p90", 2}, {"p99", 2}, {"max", 2}});
  const std::pair<const char*, const std::vector<double>*> ways[] = {
      {"measured to delta", &latencies.pose_to_here},
      {"arrived to delta", &latencies.arrival_to_here},
      {"cut to delta", &latencies.cut_to_here}};
  for (const auto& [name, values] : ways) {
    report.row({std::string(name), count(values->size()), percentile(*values, 0.5), percentile(*values, 0.9),
                percentile(*values, 0.99), percentile(*values, 1)});
  }
}

}  // namespace

void add_live_bench(CLI::App& app, Report& report) {
  auto bench = std::make_shared<LiveBench>();
  CLI::App* sub = app.add_subcommand(
      "live", "incised, a device and viewers over loopback: frames, a pose's way to the viewers");
  sub->add_option("--seconds", bench->seconds, "How long poses come")->capture_default_str();
  sub->add_option("--pose-rate", bench->pose_rate_hz, "Poses a second")->capture_default_str();
  sub->add_option("--speed", bench->speed_m_s, "Of the blade, m/s")->capture_default_str();
  sub->add_option("--tets", bench->tets, "Of the phantom liver")->capture_default_str();
  sub->add_option("--viewers", bench->viewers, "That follow")->capture_default_str();
  sub->add_option("--batch-h", bench->batch_h, "cut.batch_h; 0: its default")->capture_default_str();
  sub->add_flag("!--no-capture", bench->capture, "Without journal and checkpoints");
  sub->callback([bench, &report] { run(*bench, report); });
}

}  // namespace incise::bench
