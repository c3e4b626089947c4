// incise-bench live: the whole server as users run it. incised in its own process on a phantom liver, with its journal
// and checkpoints; a device that sends each pose as it is measured; viewers that follow; all over loopback.

#include <CLI/CLI.hpp>
#include <atomic>
#include <cmath>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "client/client.hpp"
#include "server/base/clock.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/bench/live_server.hpp"

namespace incise::bench {
namespace {

struct LiveBench : LiveMotion {
  int viewers = 4;
  int boxed = 0;  // of them
  double simulate_hz = 0;
};

// A host simulation that moves every vertex with each step, by up to a millimetre, and takes the blades' loads.
class Swaying {
 public:
  Swaying(std::uint16_t port, double rate_hz) : thread_([this, port, rate_hz] { run(port, rate_hz); }) {}
  ~Swaying() {
    stop_ = true;
    thread_.join();
  }
  std::int64_t sent() const { return sent_; }

 private:
  void run(std::uint16_t port, double rate_hz) {
    client::Options options;
    options.role = protocol::Role::Simulator;
    options.load_rate_hz = 240;
    options.background = false;
    const auto client = client::Client::connect("127.0.0.1", port, options);
    const auto period = std::chrono::duration_cast<std::chrono::steady_clock::duration>(
        std::chrono::duration<double>(1 / rate_hz));
    const auto began = std::chrono::steady_clock::now();
    std::vector<float> positions;
    for (auto next = began; !stop_; next += period) {
      client->poll(0);  // one that is late reads, too
      for (auto left = next - std::chrono::steady_clock::now(); left.count() > 0;
           left = next - std::chrono::steady_clock::now())
        client->poll(std::chrono::duration<double>(left).count());
      const std::chrono::duration<double> t = std::chrono::steady_clock::now() - began;
      protocol::Positions message;
      message.frame = ++frame_;
      client->read([&](const protocol::Replica& mesh) {
        message.revision = mesh.revision();
        positions.assign(mesh.rest_positions().begin(), mesh.rest_positions().end());
      });
      const float sway = 0.01F * static_cast<float>(std::sin(6.28 * t.count()));
      for (std::size_t i = 0; i < positions.size(); i += 3) positions[i + 2] += sway * positions[i];
      message.f32 = positions;
      if (!positions.empty() && client->send_positions(message) != 0) ++sent_;
    }
  }
  std::atomic<bool> stop_{false};
  std::atomic<std::int64_t> sent_{0};
  std::uint64_t frame_ = 0;
  std::thread thread_;
};

// What a viewer saw of each delta, ms. Filled on the clients' threads. One machine, so one clock.
struct Latencies {
  std::mutex mutex;
  std::vector<double> pose_to_here, arrival_to_here, cut_to_here;
  void note(const std::vector<protocol::Step>& steps, std::int64_t received_ns) {
    const std::scoped_lock lock(mutex);
    for (const protocol::Step& step : steps) {
      if (step.to_source_ns == 0) continue;  // a step of the simulation, which measures nothing
      pose_to_here.push_back(1e-6 * static_cast<double>(received_ns - step.to_source_ns));
      arrival_to_here.push_back(1e-6 * static_cast<double>(received_ns - step.arrival_ns));
      cut_to_here.push_back(1e-6 * static_cast<double>(received_ns - step.cut_ns));
    }
  }
};

// Of this process so far, s.
double own_cpu_s() {
  return 1e-9 * static_cast<double>(clock_ns(CLOCK_PROCESS_CPUTIME_ID));
}

// The half of the body's box, along each axis, that is around its middle.
protocol::Box middle_of(const LiveServer& server) {
  const auto [low, high] = server.box();
  const core::Vec3 a = lerp(low, high, 0.25), b = lerp(low, high, 0.75);
  return {{a.x, a.y, a.z}, {b.x, b.y, b.z}};
}

void run(const LiveBench& bench, Report& report) {
  LiveServer server(bench);
  Latencies latencies;
  std::vector<std::unique_ptr<client::Client>> viewers;
  for (int i = 0; i < bench.viewers; ++i) {  // half of them hold the volume, half the surface over WebSocket
    client::Options options;
    client::Callbacks callbacks;
    if (i < bench.boxed) options.box = middle_of(server);
    if (i % 2 == 0) {
      callbacks.on_delta = [&](const protocol::Replica&, const protocol::Delta& delta,
                               const client::Arrival& arrival) {
        latencies.note(delta.steps, arrival.received_ns);
      };
      callbacks.on_part_delta = [&](const protocol::VolumePart&, const protocol::Delta& delta,
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
    viewers.push_back(client::Client::connect(
        "127.0.0.1", i % 2 == 0 ? server.tcp_port() : server.http_port(), options, std::move(callbacks)));
    if (!viewers.back()->wait_for_revision(0, 60)) throw std::runtime_error("a viewer got no snapshot");
  }
  const double server_began_s = server.cpu_s();
  const auto threads_began_s = server.threads_cpu_s();
  const double own_began_s = own_cpu_s();
  std::unique_ptr<Swaying> simulation;
  if (bench.simulate_hz > 0) simulation = std::make_unique<Swaying>(server.tcp_port(), bench.simulate_hz);
  const LivePoses poses = server.drive();
  const std::int64_t simulated = simulation ? simulation->sent() : 0;
  const auto threads_s = server.threads_cpu_s();
  const double own_s = own_cpu_s() - own_began_s;
  simulation.reset();
  const nlohmann::json stats = server.settled_stats();
  const std::uint64_t revision = stats["revision"];
  for (const auto& viewer : viewers) {
    if (!viewer->wait_for_revision(revision, 60)) throw std::runtime_error("a viewer did not get to the end");
  }
  server.end();
  const double server_s = server.cpu_s() - server_began_s;

  report.begin("live");
  report.fact("tetrahedra", count(server.tets()));
  report.fact("viewers", count(viewers.size()));
  if (bench.boxed > 0) report.fact("with a box", count(static_cast<std::size_t>(bench.boxed)));
  report.fact("the server's processor time, s", server_s);
  report.fact("processor time of the device, the simulation and the viewers, s", own_s);
  report.fact("poses sent", count(poses.sent));
  report.fact("poses accepted", count(poses.accepted));
  report.fact("poses lost",
              static_cast<std::int64_t>(poses.sent) - static_cast<std::int64_t>(poses.accepted));
  if (bench.simulate_hz > 0) {
    report.fact("positions sent", simulated);
    report.fact("deformations", count(stats["deformations"]["count"]));
  }
  report.fact("settled", std::string(poses.settled ? "yes" : "no"));
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
  report.table("processor time of the server's threads", {{"thread"}, {"ms a second", 1}});
  for (const auto& [thread, used_s] : threads_s) {
    const auto before = threads_began_s.find(thread);
    const double began_s = before == threads_began_s.end() ? 0 : before->second;
    report.row({thread, 1000 * (used_s - began_s) / bench.seconds});
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
  sub->add_option("--boxed", bench->boxed, "So many of them with a box of interest, half of the body's")
      ->capture_default_str();
  sub->add_option("--incised", bench->incised, "Another build of incised, to compare with");
  sub->add_option("--batch-h", bench->batch_h, "cut.batch_h; 0: its default")->capture_default_str();
  sub->add_option("--simulate", bench->simulate_hz,
                  "A simulation moves all vertices so often a second; 0: there is none")
      ->capture_default_str();
  sub->add_flag("!--no-capture", bench->capture, "Without journal and checkpoints");
  sub->callback([bench, &report] { run(*bench, report); });
}

}  // namespace incise::bench
