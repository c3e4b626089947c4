#include "server/app/server_run.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <future>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "server/app/audit_log.hpp"
#include "server/app/body.hpp"
#include "server/app/capture_library.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/recording.hpp"
#include "server/app/telemetry.hpp"
#include "server/app/wiring.hpp"
#include "server/base/check.hpp"
#include "server/base/clock.hpp"
#include "server/core/session/session_state.hpp"
#include "server/loop/realtime.hpp"

namespace incise::app {
namespace {

// At the end what waits is cut, but nobody waits for the work of minutes: service managers kill after 90 s.
constexpr std::int64_t kLongestFinish_ns = 20'000'000'000;
// What is left of that goes to the last checkpoint, which only makes the next start shorter; at least so much.
constexpr std::int64_t kLastCheckpoint_ns = 5'000'000'000;

// Blocks the signals that end the server in this thread and in all that it makes, so that wait() gets them.
class EndSignals {
 public:
  EndSignals() {
    sigemptyset(&set_);
    sigaddset(&set_, SIGINT);
    sigaddset(&set_, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &set_, nullptr);
    // A peer that has gone shows as an error of the write.
    std::signal(SIGPIPE, SIG_IGN);
    // So does a file that has reached its limit: a full disk, to the journal.
    std::signal(SIGXFSZ, SIG_IGN);
  }
  // The signal's name; null after a second without one.
  const char* wait() const {
    const timespec second{1, 0};
    const int signal = sigtimedwait(&set_, nullptr, &second);
    return signal == SIGINT ? "SIGINT" : signal == SIGTERM ? "SIGTERM" : nullptr;
  }

 private:
  sigset_t set_;
};

// Tells in the log, at most once a second, what the loop cannot tell itself.
class Watch {
 public:
  explicit Watch(const loop::LoopStats& stats) : stats_(stats) {}
  void look() {
    const loop::LoopState state = stats_.state.load();
    const std::uint64_t late = stats_.late_frames();
    if (late > late_) {
      std::string causes;
      for (int i = 0; i < loop::kLateCauses; ++i) {
        const std::uint64_t n = stats_.late[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
        if (n > 0)
          causes += fmt::format("{}{} {}", causes.empty() ? "" : ", ",
                                to_string(static_cast<loop::LateCause>(i)), n);
      }
      spdlog::debug("{} late frames since the start (by cause: {})", late, causes);
    }
    late_ = late;
    const bool behind = state.recovery_ns > 1'000'000'000;
    if (behind && !behind_) {
      spdlog::warn("the cut is behind: {} segments wait, about {:.1f} s; nothing is lost",
                   state.backlog_segments, static_cast<double>(state.recovery_ns) * 1e-9);
    } else if (!behind && behind_) {
      spdlog::info("the cut has caught up at revision {}", state.revision);
    }
    behind_ = behind;
    const std::uint64_t rejected = this->rejected();
    if (rejected > rejected_) spdlog::warn("{} poses rejected since the start: see /stats", rejected);
    rejected_ = rejected;
  }

 private:
  std::uint64_t rejected() const {
    std::uint64_t sum = 0;
    for (int i = 0; i < core::kPoseVerdicts; ++i) {
      if (!core::accepted(static_cast<core::PoseVerdict>(i))) {
        sum += stats_.verdicts[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
      }
    }
    return sum;
  }
  const loop::LoopStats& stats_;
  std::uint64_t late_ = 0, rejected_ = 0;
  bool behind_ = false;
};

// Whether the loop goes on: as seen by looks at its count of frames.
//
// Thread: look() by one; trouble() by any.
class LoopHealth {
 public:
  void look(std::uint64_t frames) {
    if (frames != frames_) seen_ns_.store(monotonic_ns(), std::memory_order_relaxed);
    frames_ = frames;
  }
  // For /healthz.
  std::string trouble() const {
    const auto ns = monotonic_ns() - seen_ns_.load(std::memory_order_relaxed);
    return ns > kLongest_ns ? "the loop has not advanced for " + std::to_string(ns / 1'000'000'000) + " s"
                            : "";
  }

 private:
  static constexpr std::int64_t kLongest_ns = 3'000'000'000;  // looks come once a second
  std::uint64_t frames_ = 0;
  std::atomic<std::int64_t> seen_ns_{monotonic_ns()};
};

// Sources of poses on the network, those that are configured.
class NetworkSources {
 public:
  NetworkSources(const Config& config, input::PoseSources& sources, haptics::ForceSlots& forces,
                 [[maybe_unused]] stream::Server& server, const std::function<void()>& on_thread) {
#ifdef INCISE_OPENIGTLINK
    if (config.openigtlink.wanted()) {
      input::OpenIgtLinkOptions options = config.openigtlink;
      options.engage_buttons = static_cast<std::uint32_t>(config.cut.engage_buttons);
      openigtlink_ = std::make_unique<input::OpenIgtLinkInput>(
          sources, std::move(options),
          input::SurfaceFeed{[&] { return server.counters().state_hash; },
                             [&](auto ready) { server.request_surface(std::move(ready)); }});
    }
#endif
    if (!config.haply.url.empty()) {
      input::HaplyOptions options = config.haply;
      options.on_thread = on_thread;
      haply_ = std::make_unique<input::HaplyInput>(sources, forces, std::move(options));
    }
  }
  std::vector<input::NetworkStatus> status() const {
    std::vector<input::NetworkStatus> all;
#ifdef INCISE_OPENIGTLINK
    if (openigtlink_) all.push_back(openigtlink_->status());
#endif
    if (haply_) all.push_back(haply_->status());
    return all;
  }
  // For the line that says where the server listens; empty: nowhere.
  std::string place([[maybe_unused]] const Config& config) const {
#ifdef INCISE_OPENIGTLINK
    if (openigtlink_ && openigtlink_->port() != 0)
      return " openigtlink=" + config.openigtlink.address + ":" + std::to_string(openigtlink_->port());
#endif
    return "";
  }
  void stop() {
    if (haply_) haply_->stop();
#ifdef INCISE_OPENIGTLINK
    if (openigtlink_) openigtlink_->stop();
#endif
  }

 private:
#ifdef INCISE_OPENIGTLINK
  std::unique_ptr<input::OpenIgtLinkInput> openigtlink_;
#endif
  std::unique_ptr<input::HaplyInput> haply_;
};

// A session's state, which somebody saves; whoever takes it moves it out.
using SavedState = std::shared_future<std::shared_ptr<std::vector<std::byte>>>;

// Follows the session of `recording` from here on; null where there are to be no checkpoints. `saved` is its state as it is
// now, invalid where it has just begun.
std::unique_ptr<loop::Checkpointer> make_checkpointer(const Config& config, const Body& body,
                                                      const Recording& recording, const SavedState& saved) {
  if (config.capture.checkpoint_replay_s == 0) return nullptr;
  loop::Checkpointer::Options options;
  options.journal = config.resolve(config.capture.path).string();
  options.replay_s = config.capture.checkpoint_replay_s;
  options.debt_s = recording.debt_s;
  options.fresh = [&config, &body] {
    return std::make_unique<core::CutSession>(body.loaded.mesh, config.cut);
  };
  auto first = options.fresh;
  if (saved.valid()) {
    first = [&config, saved] {
      const std::vector<std::byte> state = std::move(*saved.get());
      std::string error;
      auto copy = core::restore_session(state, config.cut, error);
      INCISE_CHECK(copy, error);
      return copy;
    };
  }
  return std::make_unique<loop::Checkpointer>(
      options, recording.session_id, recording.next_checkpoint, first, [](bool bad, const std::string& text) {
        spdlog::log(bad ? spdlog::level::err : spdlog::level::warn, "{}", text);
      });
}

stream::RecordingNow recording_now(const loop::Journal* journal) {
  if (!journal) return {};
  std::string trouble = journal->trouble();
  return {trouble.empty() ? protocol::Recording::On : protocol::Recording::Stopped, std::move(trouble)};
}

}  // namespace

void run_server(const Config& config, bool resume) {
  const EndSignals signals;
  const auto started = monotonic_ns();
  std::string told;
  const Body body = load_body(config, [&](std::string_view stage, double seconds) {
    if (seconds > 2 && told != stage) spdlog::info("filling the mesh: {}", told = stage);
  });
  for (const std::string& warning : body.loaded.warnings) spdlog::warn("{}", warning);
  Recording recording = resume ? resume_recording(config, body) : begin_recording(config, body);
  core::CutSession& session = *recording.session;
  spdlog::info("{}: {} vertices, {} tetrahedra, h = {:.4g} m, ready in {:.1f} s", body.name,
               body.loaded.mesh.positions.size(), body.loaded.mesh.tets.size(),
               session.mesh().mean_edge_length(), static_cast<double>(monotonic_ns() - started) * 1e-9);
  // A session that has been cut a lot takes seconds to make ready: what can be is done side by side.
  const bool cut = session.revision() > 0;
  SavedState saved;
  if (cut && config.capture.checkpoint_replay_s > 0) {
    saved = std::async(std::launch::async,
                       [&] { return std::make_shared<std::vector<std::byte>>(core::save_session(session)); });
  }
  std::future<std::unique_ptr<haptics::Tissue>> tissue;
  if (config.haptics.forces) {
    tissue = std::async(std::launch::async, [&] {
      auto made = std::make_unique<haptics::Tissue>(body.loaded.mesh);
      if (cut) made->note_cuts(session.mesh());
      return made;
    });
  }
  std::vector<input::PoseSources::Declared> declared;
  for (const Config::Source& source : config.sources) declared.push_back({source.name, source.blade});
  input::PoseSources sources(config.cut.blade, declared);
  const bool capture = recording.journal != nullptr;
  std::unique_ptr<loop::Journal> journal;
  if (capture) {
    loop::Journal::Options options;
    options.policy = config.capture.sync == "none"     ? loop::SyncPolicy::kNone
                     : config.capture.sync == "always" ? loop::SyncPolicy::kAlways
                                                       : loop::SyncPolicy::kGroup;
    options.lost = recording.lost;
    options.realtime_priority = static_cast<int>(config.loop.realtime_priority) / 2;
    options.sync_interval_ms = static_cast<std::int64_t>(config.capture.sync_interval_ms);
    journal = std::make_unique<loop::Journal>(
        std::move(recording.journal), options,
        [](const std::string& trouble) {
          if (trouble.empty()) {
            spdlog::info("the capture can be written again; the gap is marked in it");
          } else {
            spdlog::error("the capture cannot be written: {}; cutting goes on, poses are not recorded",
                          trouble);
          }
        },
        make_checkpointer(config, body, recording, saved),
        [&sources](const loop::JournalRecord& pose, bool recorded) {
          if (recorded && core::accepted(pose.verdict))
            sources.acknowledge_recorded(pose.source, pose.owner, pose.pose.t_ns);
          sources.acknowledge(pose.source, pose.verdict, pose.pose.t_ns);
        });
  }

  input::PositionsSlot positions;
  StreamInput sink(sources, positions, config);

  // The loop wants the stream to publish to, the stream the loop's figures: the figures come first, by a pointer that is
  // set before the stream starts.
  std::optional<Telemetry> telemetry;
  LoopHealth health;
  CaptureLibrary library(config.resolve(config.capture.library), body);
  AuditLog audit;
  stream::Providers providers{[&] { return telemetry->json(); },
                              [&] { return telemetry->metrics(); },
                              [&] { return telemetry->message(); },
                              [&] { return telemetry->blades(); },
                              &library,
                              [&] { return health.trouble(); },
                              [&](auto kind, auto& address, auto& line) { audit.write(kind, address, line); },
                              [&] { return recording_now(journal.get()); }};
  stream::Server server(stream_config(config), server_facts(config, body, session.mesh()),
                        recording.shown.before, sink, providers);
  for (auto& delta : recording.shown.deltas) server.publish(std::move(delta));
  recording.shown = {};
  StreamOutput output(server);
  loop::LoopOptions options;
  options.rate_hz = config.loop.rate_hz;
  options.budget_fraction = config.loop.budget_fraction;
  options.longest_finish_ns = kLongestFinish_ns;
  loop::FrameLoop frames(session, sources, output, journal.get(), options);
  frames.offer_deformation(positions);
  haptics::ForceSlots forces;
  ForceOutput force_output(server, static_cast<std::int64_t>(config.haptics.contact_valid_ms * 1e6));
  if (config.haptics.forces) frames.offer_forces(config.haptics.force, tissue.get(), &force_output, &forces);
  telemetry.emplace(frames.stats(), sources, journal.get(), config.loop.rate_hz);
  telemetry->join_stream([&] { return server.counters(); });
  sink.join(frames);
  frames.offer_reset(
      [&] { return std::make_unique<core::CutSession>(body.loaded.mesh, config.cut); },
      [&](const core::CutSession& fresh) {
        const std::uint64_t id = fresh_session_id();
        server.publish_reset(std::make_shared<const stream::InitialState>(initial_state(fresh, id)));
        return id;
      });

  const std::function<void()> on_thread = [&] {
    const int priority = static_cast<int>(config.loop.realtime_priority);
    if (priority > 0) loop::request_priority(priority);
  };
  std::unique_ptr<input::HidInput> devices;
  if (config.devices.enabled) {
    devices = std::make_unique<input::HidInput>(
        sources, forces,
        input::HidInput::Options{device_profiles(config), config.devices.overrides, on_thread});
    telemetry->join([&] { return devices->status(); });
  }
  NetworkSources network(config, sources, forces, server, on_thread);
  telemetry->join_network([&] { return network.status(); });

  if (saved.valid()) saved.wait();  // before anything changes the session
  if (config.loop.lock_memory) spdlog::info("{}", loop::request_locked_memory());
  server.start();
  std::jthread loop_thread([&](const std::stop_token& stop) {
    if (config.loop.cpu >= 0) spdlog::info("{}", loop::request_cpu(static_cast<int>(config.loop.cpu)));
    if (config.loop.realtime_priority > 0) {
      spdlog::info("{}", loop::request_priority(static_cast<int>(config.loop.realtime_priority)));
    }
    frames.run(stop);
  });

  // One line on stdout, for people and for scripts that wait for it; all else goes to the log.
  const auto place = [&](std::uint16_t port) {
    return port == 0 ? std::string("off") : config.listen.address + ":" + std::to_string(port);
  };
  std::printf("listening tcp=%s http=%s%s\n", place(server.tcp_port()).c_str(),
              place(server.http_port()).c_str(), network.place(config).c_str());
  std::fflush(stdout);
  if (capture && recording.lost == 0)
    spdlog::info("recording to {}", config.resolve(config.capture.path).string());
  spdlog::info("ready: {} frames a second, {:.1f} s after the start; Ctrl-C ends", config.loop.rate_hz,
               static_cast<double>(monotonic_ns() - started) * 1e-9);

  Watch watch(frames.stats());
  const char* signal = nullptr;
  while (!(signal = signals.wait())) {
    watch.look();
    audit.flush();
    health.look(frames.stats().state.load().frames);
  }

  spdlog::info("{}: ending", signal);
  const auto ending = monotonic_ns();
  if (devices) devices->stop();  // forces go to zero first
  network.stop();
  loop_thread.request_stop();
  loop_thread.join();  // takes what waits, ends the strokes, cuts and publishes, for 20 s at most
  server.stop();
  library.stop();
  const loop::LoopState state = frames.stats().state.load();
  if (journal) {
    const auto limit = std::max(kLongestFinish_ns - (monotonic_ns() - ending), kLastCheckpoint_ns);
    const std::string why = journal->close(std::chrono::milliseconds(limit / 1'000'000));
    if (!why.empty() && journal->lost() > 0) {
      spdlog::error(
          "recording stopped before the end and {} records are not in the capture: incised --resume goes "
          "back to where it "
          "stopped; make room on the disk",
          journal->lost());
    } else if (!why.empty()) {
      spdlog::warn("no checkpoint of the end ({}); incised --resume takes longer for it", why);
    }
  }
  const std::uint64_t lost = journal ? journal->lost() : 0;
  if (state.backlog_segments > 0) {
    spdlog::warn("{} segments were not cut in the {} s that the end may take{}", state.backlog_segments,
                 kLongestFinish_ns / 1'000'000'000,
                 capture ? "; the capture has them: incised --resume goes on with them"
                         : "; they are lost, for nothing was recorded (capture.path)");
  }
  spdlog::info("ended at revision {}, state hash {:016x}, {} frames{}", state.revision, state.state_hash,
               state.frames, lost > 0 ? fmt::format(", {} records not in the capture", lost) : std::string());
}

}  // namespace incise::app
