// incise-bench stream --boxed: a simulator moves the whole body while viewers with a box of interest follow. What these cost
// a viewer without a box, and the simulator.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <numbers>
#include <thread>

#include "client/client.hpp"
#include "server/base/clock.hpp"
#include "server/input/pose_sources.hpp"
#include "tests/bench/box_bench.hpp"
#include "tests/bench/crowd.hpp"
#include "tests/bench/live_server.hpp"

namespace incise::bench {
namespace {

// Sends the positions of all vertices at a fixed rate, as a solver does whose body sways.
class SwayingBody {
 public:
  SwayingBody(std::uint16_t port, double rate_hz) : rate_hz_(rate_hz) {
    client::Options options;
    options.role = protocol::Role::Simulator;
    client::Callbacks callbacks;
    callbacks.on_positions_report = [this](const protocol::PositionsReport& report) { took(report); };
    client_ = client::Client::connect("127.0.0.1", port, options, callbacks);
    if (!client_->wait_for_revision(0, 60)) throw std::runtime_error("the simulator got no state");
    client_->read([&](const protocol::Replica& mesh) {
      const auto rest = mesh.rest_positions();
      rest_.assign(rest.begin(), rest.end());
    });
  }
  void run(double seconds) {
    const auto start = std::chrono::steady_clock::now();
    for (int i = 0; i < static_cast<int>(seconds * rate_hz_); ++i) {
      std::this_thread::sleep_until(start + std::chrono::duration<double>(i / rate_hz_));
      send(i / rate_hz_);
    }
  }
  std::uint64_t taken() const {
    const std::scoped_lock lock(mutex_);
    return ages_ms_.size();
  }
  // From "sent" to "the step of these positions is reported", ms.
  std::vector<double> ages_ms() const {
    const std::scoped_lock lock(mutex_);
    return ages_ms_;
  }

 private:
  // A bend to and fro once in two seconds, up to a twentieth of the body's size.
  void send(double t_s) {
    const protocol::Box& box = client_->welcome().mesh.box;
    const double size = box.max.x - box.min.x;
    const double by = 0.05 * size * std::sin(std::numbers::pi * t_s);
    std::vector<float> moved(rest_.begin(), rest_.end());
    for (std::size_t i = 0; i < rest_.size(); i += 3) {
      const double along = (rest_[i] - box.min.x) / size;
      moved[i + 1] += static_cast<float>(by * along * along);
      moved[i + 2] += static_cast<float>(0.5 * by * along);
    }
    protocol::Positions message;
    message.revision = client_->revision();
    message.f32 = moved;
    {
      const std::scoped_lock lock(mutex_);
      sent_ns_.push_back(monotonic_ns());
      message.frame = sent_ns_.size();
    }
    client_->send_positions(message);
  }
  void took(const protocol::PositionsReport& report) {
    const std::scoped_lock lock(mutex_);
    ages_ms_.push_back(1e-6 * static_cast<double>(monotonic_ns() - sent_ns_[report.frame - 1]));
  }

  const double rate_hz_;
  std::vector<double> rest_;
  mutable std::mutex mutex_;
  std::vector<std::int64_t> sent_ns_;  // by frame, from 1
  std::vector<double> ages_ms_;
  std::unique_ptr<client::Client> client_;  // last: its callbacks use the rest
};

// The middle of the body, `part` of its size along each axis.
protocol::Box middle(const LiveServer& server, double part) {
  client::Options options;
  options.view = protocol::View::None;
  const protocol::Box all =
      client::Client::connect("127.0.0.1", server.tcp_port(), options)->welcome().mesh.box;
  const auto between = [&](double low, double high, double side) {
    return 0.5 * (low + high) + 0.5 * side * part * (high - low);
  };
  return {
      {between(all.min.x, all.max.x, -1), between(all.min.y, all.max.y, -1),
       between(all.min.z, all.max.z, -1)},
      {between(all.min.x, all.max.x, 1), between(all.min.y, all.max.y, 1), between(all.min.z, all.max.z, 1)}};
}

// CPU time of a process, s.
double cpu_s(pid_t pid) {
  clockid_t clock{};
  timespec now{};
  if (clock_getcpuclockid(pid, &clock) != 0 || clock_gettime(clock, &now) != 0) return 0;
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

void run_boxed(const BoxBench& bench, int boxed, Report& report) {
  LiveServer server(bench.motion);
  SwayingBody body(server.tcp_port(), bench.rate_hz);
  Crowd::Options one, many;
  one.viewers = 1;
  one.view = many.view = protocol::View::Volume;
  many.viewers = boxed;
  many.box = middle(server, bench.part);
  Crowd plain(server.tcp_port(), one), boxes(server.tcp_port(), many);
  const double cpu_before = cpu_s(server.pid());
  body.run(bench.motion.seconds);
  const double cpu = cpu_s(server.pid()) - cpu_before;
  const std::uint64_t taken = body.taken();
  const std::vector<double> ages = body.ages_ms();
  const std::vector<double>& latencies = plain.stop();
  const double per_box = static_cast<double>(boxes.stop().size()) / std::max(boxed, 1);
  report.row({count(static_cast<std::uint64_t>(boxed)), static_cast<double>(taken) / bench.motion.seconds,
              percentile(ages, 0.5), percentile(latencies, 0.5), percentile(latencies, 0.99),
              per_box / bench.motion.seconds, count(boxes.boxes_refused()), cpu / bench.motion.seconds});
  server.end();
}

}  // namespace

void bench_boxed(const BoxBench& bench, Report& report) {
  report.table("a simulator moves all vertices at " + std::to_string(static_cast<int>(bench.rate_hz)) + " Hz",
               {{"boxed viewers"},
                {"steps a second", 1},
                {"positions' age p50, ms", 1},
                {"viewer's p50, ms", 2},
                {"p99, ms", 2},
                {"deltas a second to each box", 1},
                {"boxes refused"},
                {"server's CPU, cores", 2}});
  for (int round = 0; round < bench.rounds; ++round)
    for (const int boxed : bench.boxed) run_boxed(bench, boxed, report);
}

}  // namespace incise::bench
