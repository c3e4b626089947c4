// incise-bench loop: the real-time loop on a phantom liver, poses at a device's rate: work of a frame, lateness of its
// wake-up, a pose's way to the cut; and what the input path takes when poses come all at once.

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>
#include <thread>

#include "server/base/clock.hpp"
#include "server/loop/frame_loop.hpp"
#include "server/loop/realtime.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/support/to_and_fro.hpp"

namespace incise::bench {
namespace {

struct LoopBench {
  double seconds = 10;
  double pose_rate_hz = 1000;
  double frame_rate_hz = 1000;
  double speed_m_s = 0.2;
  std::size_t tets = 60'000;
  int realtime_priority = 0;
  bool load = false;
  double jitter_seconds = 3;
};

// Releases every delta at once, as a stream that keeps up does.
struct Discard : loop::DeltaSink {
  void publish(std::shared_ptr<const loop::PublishedDelta> delta) noexcept override {
    hash = delta->delta.state_hash;
  }
  std::uint64_t hash = 0;
};

void add_row(Report& report, const char* name, const Histogram& histogram) {
  const auto us = [](std::uint64_t ns) { return static_cast<double>(ns) * 1e-3; };
  report.row({std::string(name), count(histogram.count()), us(histogram.quantile_ns(0.5)),
              us(histogram.quantile_ns(0.99)), us(histogram.quantile_ns(0.999)), us(histogram.max_ns())});
}

// Computes all the time, in a thread of its own.
class Load {
 public:
  explicit Load(bool wanted) {
    if (!wanted) return;
    thread_ = std::jthread([](const std::stop_token& stop) {
      volatile double x = 1;
      while (!stop.stop_requested()) x = std::sqrt(x + 1);
    });
  }

 private:
  std::jthread thread_;
};

// How late empty frames begin, alone and with another thread that computes.
void bench_jitter(const LoopBench& bench, const core::MeshData& mesh, const core::CutConfig& config,
                  Report& report) {
  report.table("wake-up late, us", {{"beside"}, {"count"}, {"p50", 1}, {"p99", 1}, {"p99.9", 1}, {"max", 1}});
  for (const bool loaded : {false, true}) {
    core::CutSession session(mesh, config);
    input::PoseSources sources(config.blade);
    Discard sink;
    loop::LoopOptions options;
    options.rate_hz = bench.frame_rate_hz;
    loop::FrameLoop frames(session, sources, sink, nullptr, options);
    const Load load(loaded);
    std::jthread thread([&](const std::stop_token& stop) {
      if (bench.realtime_priority > 0) loop::request_priority(bench.realtime_priority);
      frames.run(stop);
    });
    std::this_thread::sleep_for(std::chrono::duration<double>(bench.jitter_seconds));
    thread.request_stop();
    thread.join();
    add_row(report, loaded ? "a thread that computes" : "nothing", frames.stats().wake_late);
  }
}

void run(const LoopBench& bench, Report& report) {
  const NamedMesh body = phantom("liver", bench.tets);
  const auto [low, high] = bounds(body.mesh);
  tests::ToAndFro motion(low, high, bench.speed_m_s, bench.pose_rate_hz);
  core::CutConfig config;
  config.blade = motion.blade();
  core::CutSession session(body.mesh, config);
  input::PoseSources sources(config.blade);
  Discard sink;
  loop::LoopOptions options;
  options.rate_hz = bench.frame_rate_hz;
  loop::FrameLoop frames(session, sources, sink, nullptr, options);

  auto load = std::make_unique<Load>(bench.load);
  std::string granted;
  std::jthread loop_thread([&](const std::stop_token& stop) {
    if (bench.realtime_priority > 0) granted = loop::request_priority(bench.realtime_priority);
    frames.run(stop);
  });
  auto source = sources.open("bench");
  const std::int64_t start = monotonic_ns(), period = static_cast<std::int64_t>(1e9 / bench.pose_rate_hz);
  const auto poses = static_cast<std::int64_t>(bench.seconds * bench.pose_rate_hz);
  for (std::int64_t i = 0; i < poses; ++i) {
    const std::int64_t at = start + i * period;
    const timespec when{at / 1'000'000'000, at % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr) != 0) {
    }
    const input::TimedPose pose{motion.next(), monotonic_ns()};
    while (source->enqueue(std::span(&pose, 1)) == 0) std::this_thread::yield();
  }
  loop_thread.request_stop();
  loop_thread.join();
  load.reset();

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

  bench_jitter(bench, body.mesh, config, report);

  // The input path alone: poses outside the body, as fast as one thread sends them and the loop takes them.
  core::CutSession idle(body.mesh, config);
  input::PoseSources flood_sources(config.blade);
  loop::FrameLoop flood(idle, flood_sources, sink, nullptr, options);
  auto flooding = flood_sources.open("flood");
  std::vector<input::TimedPose> chunk(4096);
  std::int64_t t_ns = 0, taken = 0, taking_ns = 0;
  while (taken < 1'000'000) {
    for (auto& pose : chunk) pose.pose.t_ns = ++t_ns;
    const std::size_t pushed = flooding->enqueue(chunk);
    const std::int64_t before = monotonic_ns();
    while (flood_sources.waiting() > 0) flood.frame(before);
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
  sub->add_option("--jitter-seconds", bench->jitter_seconds, "Of empty frames, alone and under load")
      ->capture_default_str();
  sub->add_flag("--load", bench->load, "With another thread that computes all the time");
  sub->callback([bench, &report] { run(*bench, report); });
}

}  // namespace incise::bench
