// incise-bench loop: the real-time loop on a phantom liver, poses at a device's rate: work of a frame, lateness of its
// wake-up, a pose's way to the cut; and what the input path takes when poses come all at once.

#include <CLI/CLI.hpp>
#include <atomic>
#include <cmath>
#include <memory>
#include <thread>

#include "server/loop/frame_loop.hpp"
#include "server/loop/realtime.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"

namespace incise::bench {
namespace {

using input::monotonic_ns;

struct LoopBench {
  double seconds = 10;
  double pose_rate_hz = 1000;
  double frame_rate_hz = 1000;
  double speed_m_s = 0.2;
  std::size_t tets = 60'000;
  int realtime_priority = 0;
  bool load = false;
};

// Lets go of every delta at once, as a stream does that keeps up.
struct Discard : loop::DeltaSink {
  void publish(std::shared_ptr<const loop::PublishedDelta> delta) noexcept override {
    hash = delta->delta.state_hash;
  }
  std::uint64_t hash = 0;
};

// To and fro across the body, each pass a little further along it, engaged while inside.
class Motion {
 public:
  Motion(const core::MeshData& mesh, double speed_m_s, double rate_hz)
      : step_m_(speed_m_s / rate_hz), rate_hz_(rate_hz) {
    low_ = high_ = mesh.positions.front();
    for (const core::Vec3& p : mesh.positions) {
      low_ = {std::min(low_.x, p.x), std::min(low_.y, p.y), std::min(low_.z, p.z)};
      high_ = {std::max(high_.x, p.x), std::max(high_.y, p.y), std::max(high_.z, p.z)};
    }
  }
  core::Pose next() {
    const double margin = 0.1 * (high_.y - low_.y), width = high_.y - low_.y + 2 * margin;
    const double travelled = step_m_ * static_cast<double>(count_);
    const double pass = std::floor(travelled / width), within = travelled - pass * width;
    const bool back = std::fmod(pass, 2) == 1;
    core::Pose pose;
    pose.t_ns = static_cast<std::int64_t>(1e9 / rate_hz_ * static_cast<double>(++count_));
    const double along = std::fmod(0.1 + 0.03819 * pass, 0.8) + 0.1;
    pose.position = {low_.x + along * (high_.x - low_.x),
                     back ? high_.y + margin - within : low_.y - margin + within, high_.z + 0.01};
    // Lifted while it moves along the body.
    pose.buttons = within > 2 * step_m_ && within < width - 2 * step_m_ ? 1 : 0;
    return pose;
  }
  core::Blade blade() const { return {{0, 0, 0}, {0, 0, -(high_.z - low_.z + 0.02)}}; }

 private:
  core::Vec3 low_, high_;
  double step_m_, rate_hz_;
  std::uint64_t count_ = 0;
};

void add_row(Report& report, const char* name, const loop::Histogram& histogram) {
  const auto us = [](std::uint64_t ns) { return static_cast<double>(ns) * 1e-3; };
  report.row({std::string(name), count(histogram.count()), us(histogram.quantile_ns(0.5)),
              us(histogram.quantile_ns(0.99)), us(histogram.quantile_ns(0.999)), us(histogram.max_ns())});
}

void run(const LoopBench& bench, Report& report) {
  const NamedMesh body = phantom("liver", bench.tets);
  Motion motion(body.mesh, bench.speed_m_s, bench.pose_rate_hz);
  core::CutConfig config;
  config.blade = motion.blade();
  core::CutSession session(body.mesh, config);
  input::InputHub hub(config.blade);
  Discard sink;
  loop::LoopOptions options;
  options.rate_hz = bench.frame_rate_hz;
  loop::FrameLoop frames(session, hub, sink, nullptr, options);

  std::atomic<bool> done{false};
  std::thread load;
  if (bench.load) {
    load = std::thread([&] {
      volatile double x = 1;
      while (!done) x = std::sqrt(x + 1);
    });
  }
  std::string granted;
  std::jthread loop_thread([&](const std::stop_token& stop) {
    if (bench.realtime_priority > 0) granted = loop::request_priority(bench.realtime_priority);
    frames.run(stop);
  });
  auto source = hub.open_source("bench");
  const std::int64_t start = monotonic_ns(), period = static_cast<std::int64_t>(1e9 / bench.pose_rate_hz);
  const auto poses = static_cast<std::int64_t>(bench.seconds * bench.pose_rate_hz);
  for (std::int64_t i = 0; i < poses; ++i) {
    const std::int64_t at = start + i * period;
    const timespec when{at / 1'000'000'000, at % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr) != 0) {
    }
    const input::TimedPose pose{motion.next(), monotonic_ns()};
    while (source->push(std::span(&pose, 1)) == 0) std::this_thread::yield();
  }
  loop_thread.request_stop();
  loop_thread.join();
  done = true;
  if (load.joinable()) load.join();

  const loop::LoopStats& stats = frames.stats();
  const loop::LoopState state = stats.state.load();
  report.begin("loop");
  report.fact("tetrahedra", count(body.mesh.tets.size()));
  report.fact("poses", count(static_cast<std::uint64_t>(poses)));
  report.fact("poses accepted", count(source->counts().count(core::PoseVerdict::kAccepted)));
  report.fact("revision", count(state.revision));
  report.fact("cut faces", count(state.cut_faces));
  report.fact("frames", count(state.frames));
  report.fact("frames skipped", count(state.skipped_frames));
  for (int i = 0; i < loop::kLateCauses; ++i) {
    report.fact("late: " + std::string(to_string(static_cast<loop::LateCause>(i))),
                count(stats.late[static_cast<std::size_t>(i)].load()));
  }
  report.fact("ns a work unit", state.ns_per_unit);
  report.fact("state hash", hex(state.state_hash));
  if (!granted.empty()) report.fact("priority", granted);
  report.table("stages, us", {{"stage"}, {"count"}, {"p50", 1}, {"p99", 1}, {"p99.9", 1}, {"max", 1}});
  add_row(report, "wake-up late", stats.wake_late);
  add_row(report, "frame work", stats.frame_work);
  add_row(report, "drain", stats.drain);
  add_row(report, "cut", stats.cut);
  add_row(report, "publish", stats.publish);
  add_row(report, "batch cut", stats.batch_cut);
  add_row(report, "pose to drain", stats.pose_to_drain);
  add_row(report, "pose to cut", stats.pose_to_cut);

  // The input path alone: poses beside the body, as fast as one thread gives them and the loop takes them.
  core::CutSession idle(body.mesh, config);
  input::InputHub flood_hub(config.blade);
  loop::FrameLoop flood(idle, flood_hub, sink, nullptr, options);
  auto flooding = flood_hub.open_source("flood");
  std::vector<input::TimedPose> chunk(4096);
  std::int64_t t_ns = 0, taken = 0, taking_ns = 0;
  while (taken < 1'000'000) {
    for (auto& pose : chunk) pose.pose.t_ns = ++t_ns;
    const std::size_t pushed = flooding->push(chunk);
    const std::int64_t before = monotonic_ns();
    while (flood_hub.waiting() > 0) flood.frame(before);
    taking_ns += monotonic_ns() - before;
    taken += static_cast<std::int64_t>(pushed);
  }
  report.table("input path", {{"poses"}, {"ns a pose", 1}, {"poses a second", 0}});
  const double ns_a_pose = static_cast<double>(taking_ns) / static_cast<double>(taken);
  report.row({taken, ns_a_pose, 1e9 / ns_a_pose});
}

}  // namespace

void add_loop_bench(CLI::App& app, Report& report) {
  auto bench = std::make_shared<LoopBench>();
  CLI::App* sub =
      app.add_subcommand("loop", "The real-time loop: frame work, jitter, a pose's way to the cut");
  sub->add_option("--seconds", bench->seconds, "How long poses come")->capture_default_str();
  sub->add_option("--pose-rate", bench->pose_rate_hz, "Poses a second")->capture_default_str();
  sub->add_option("--rate", bench->frame_rate_hz, "Frames a second")->capture_default_str();
  sub->add_option("--speed", bench->speed_m_s, "Of the blade, m/s")->capture_default_str();
  sub->add_option("--tets", bench->tets, "Of the phantom liver")->capture_default_str();
  sub->add_option("--priority", bench->realtime_priority, "SCHED_FIFO priority; 0: none")
      ->capture_default_str();
  sub->add_flag("--load", bench->load, "With another thread that computes all the time");
  sub->callback([bench, &report] { run(*bench, report); });
}

}  // namespace incise::bench
