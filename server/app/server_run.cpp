#include "server/app/server_run.hpp"

#include <spdlog/spdlog.h>

#include <csignal>
#include <cstdio>
#include <ctime>
#include <memory>
#include <optional>
#include <thread>

#include "server/app/body.hpp"
#include "server/app/capture_journal.hpp"
#include "server/app/capture_library.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/telemetry.hpp"
#include "server/app/version.hpp"
#include "server/app/wiring.hpp"
#include "server/loop/realtime.hpp"

namespace incise::app {
namespace {

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

std::int64_t unix_ns() {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

// The parts of a configuration that a session's state depends on.
bool same_cut(const Config& a, const Config& b) {
  const auto cut_only = [](const Config& config) {
    Config kept;
    kept.cut = config.cut;
    kept.sources = config.sources;
    return compact(kept);
  };
  return cut_only(a) == cut_only(b);
}

// Where the journal of a session goes, and what names the session.
struct Recording {
  std::unique_ptr<CaptureJournal> journal;  // null: nothing is recorded
  std::uint64_t session_id = 0;
};

Recording begin_recording(const Config& config, const Body& body) {
  Recording recording;
  recording.session_id = fresh_session_id();
  if (config.capture.path.empty()) return recording;
  const std::filesystem::path path = config.resolve(config.capture.path);
  std::error_code error;
  const auto parent = path.has_parent_path() ? path.parent_path() : std::filesystem::path(".");
  if (!std::filesystem::is_directory(parent, error)) {
    throw ConfigError("capture.path: the directory " + parent.string() +
                      " does not exist; make it first (mkdir -p " + parent.string() + ")");
  }
  // A recording is somebody's work: the one before is kept under another name.
  if (std::filesystem::exists(path, error) && std::filesystem::file_size(path, error) > 0) {
    std::filesystem::path old = path;
    old += ".old";
    std::filesystem::rename(path, old, error);
    if (error)
      throw std::runtime_error(path.string() + ": cannot be moved to " + old.string() + ": " +
                               error.message());
    spdlog::warn("{} is there already; it is now {} (incised --resume would have gone on with it)",
                 path.string(), old.string());
  }
  protocol::CaptureHeader header;
  header.mesh_path = config.mesh.path.empty()
                         ? config.mesh.phantom
                         : std::filesystem::absolute(config.resolve(config.mesh.path)).string();
  header.mesh_content_hash = body.loaded.content_hash;
  header.session = recording.session_id;
  header.created_unix_ns = unix_ns();
  header.software = kSoftware;
  header.config_json = compact(config);
  recording.journal = std::make_unique<CaptureJournal>(path.string(), header);
  return recording;
}

// Brings `session` to where its capture ends, checking every hash on the way, and ends the strokes of those who held a
// blade then: they are gone.
Recording resume_recording(const Config& config, const Body& body, core::CutSession& session) {
  if (config.capture.path.empty()) {
    throw ConfigError(
        "capture.path: found \"\"; accepted with --resume is the path of the capture to go on with");
  }
  const std::string path = config.resolve(config.capture.path).string();
  const RecordedMotion motion = read_recorded_motion(path);
  if (!motion.header)
    throw std::runtime_error(path + ": is no capture; accepted with --resume is one of incised");
  if (motion.header->mesh_content_hash != body.loaded.content_hash) {
    throw std::runtime_error(path + ": was recorded with another mesh: its hash is " +
                             motion.header->mesh_content_hash + ", that of " + body.name + " is " +
                             body.loaded.content_hash);
  }
  if (!same_cut(config, config_of(*motion.header, path))) {
    throw std::runtime_error(
        path +
        ": was recorded with other values of cut, blade or sources; a session goes on only "
        "with those it began with (incise info " +
        path + " and incised --config show both)");
  }
  for (const std::string& warning : motion.warnings) spdlog::warn("{}", warning);

  Recording recording;
  recording.session_id = motion.session;
  recording.journal = std::make_unique<CaptureJournal>(path, motion.good_bytes, motion.records);
  std::size_t next_mark = 0;
  core::Delta delta;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  const auto commit_all = [&] {
    while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
      if (next_mark < motion.marks.size()) {
        const protocol::BatchMark& mark = motion.marks[next_mark++];
        if (mark.revision != delta.revision || mark.state_hash != delta.state_hash) {
          throw std::runtime_error(
              path + ": revision " + std::to_string(delta.revision) +
              " replays with another hash than it was recorded with: written by other software (" +
              motion.header->software + ")? incise replay --verify says more");
        }
        continue;
      }
      // The crash took this mark, or it never came to the batch.
      loop::JournalRecord mark;
      mark.kind = loop::JournalRecord::Kind::kCommit;
      mark.source = delta.source;
      mark.stroke = delta.stroke;
      mark.batch = delta.batch;
      mark.stroke_ended = delta.stroke_ended;
      mark.revision = delta.revision;
      mark.state_hash = delta.state_hash;
      recording.journal->write(mark);
    }
  };
  const auto start = input::monotonic_ns();
  for (const MotionEvent& event : motion.events) {
    apply(session, event, config);
    commit_all();
  }
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if (!session.in_stroke(source)) continue;
    loop::JournalRecord end;
    end.kind = loop::JournalRecord::Kind::kEndStroke;
    end.source = source;
    end.arrival_ns = input::monotonic_ns();
    session.end_stroke(source);
    recording.journal->write(end);
    commit_all();
  }
  recording.journal->flush();
  recording.journal->sync();
  spdlog::info("resumed {} at revision {}: {} poses replayed in {:.1f} s", path, session.revision(),
               motion.poses(), static_cast<double>(input::monotonic_ns() - start) * 1e-9);
  return recording;
}

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

}  // namespace

void run_server(const Config& config, bool resume) {
  const EndSignals signals;
  const auto started = input::monotonic_ns();
  std::string told;
  const Body body = load_body(config, [&](std::string_view stage, double seconds) {
    if (seconds > 2 && told != stage) spdlog::info("filling the mesh: {}", told = stage);
  });
  for (const std::string& warning : body.loaded.warnings) spdlog::warn("{}", warning);
  core::CutSession session(body.loaded.mesh, config.cut);
  spdlog::info("{}: {} vertices, {} tetrahedra, h = {:.4g} m, ready in {:.1f} s", body.name,
               body.loaded.mesh.positions.size(), session.mesh().live_tets(),
               session.mesh().mean_edge_length(),
               static_cast<double>(input::monotonic_ns() - started) * 1e-9);

  Recording recording = resume ? resume_recording(config, body, session) : begin_recording(config, body);
  CaptureJournal* const capture = recording.journal.get();
  std::unique_ptr<loop::Journal> journal;
  if (capture) {
    loop::Journal::Options options;
    options.policy = config.capture.sync == "none"     ? loop::SyncPolicy::kNone
                     : config.capture.sync == "always" ? loop::SyncPolicy::kAlways
                                                       : loop::SyncPolicy::kGroup;
    options.sync_interval_ms = static_cast<std::int64_t>(config.capture.sync_interval_ms);
    journal = std::make_unique<loop::Journal>(
        std::move(recording.journal), options, [](const std::string& trouble) {
          if (trouble.empty()) {
            spdlog::info("the capture can be written again; the gap is marked in it");
          } else {
            spdlog::error("the capture cannot be written: {}; cutting goes on, poses are not recorded",
                          trouble);
          }
        });
  }

  std::vector<input::InputHub::Declared> declared;
  for (const Config::Source& source : config.sources) declared.push_back({source.name, source.blade});
  input::InputHub hub(config.cut.blade, declared);
  HubInput sink(hub, config);

  // The loop wants the stream to publish to, the stream the loop's figures: the figures come first, by a pointer that is
  // set before the stream starts.
  std::optional<Telemetry> telemetry;
  CaptureLibrary library(config.resolve(config.capture.library), body);
  stream::Providers providers{[&] { return telemetry->json(); }, [&] { return telemetry->metrics(); },
                              [&] { return telemetry->message(); }, [&] { return telemetry->blades(); },
                              &library};
  stream::Server server(stream_config(config), server_facts(config, body, session.mesh()),
                        initial_state(session, recording.session_id), sink, providers);
  StreamOutput output(server);
  loop::LoopOptions options;
  options.rate_hz = config.loop.rate_hz;
  options.budget_fraction = config.loop.budget_fraction;
  loop::FrameLoop frames(session, hub, output, journal.get(), options);
  telemetry.emplace(frames.stats(), hub, journal.get(), config.loop.rate_hz);
  sink.join(frames);
  frames.offer_reset(
      [&] { return std::make_unique<core::CutSession>(body.loaded.mesh, config.cut); },
      [&](const core::CutSession& fresh) {
        const std::uint64_t id = fresh_session_id();
        server.publish_reset(std::make_shared<const stream::InitialState>(initial_state(fresh, id)));
        return id;
      });

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
  std::printf("listening tcp=%s http=%s\n", place(server.tcp_port()).c_str(),
              place(server.http_port()).c_str());
  std::fflush(stdout);
  if (capture) spdlog::info("recording to {}", config.resolve(config.capture.path).string());
  spdlog::info("ready: {} frames a second; Ctrl-C ends", config.loop.rate_hz);

  Watch watch(frames.stats());
  const char* signal = nullptr;
  while (!(signal = signals.wait())) watch.look();

  spdlog::info("{}: ending", signal);
  loop_thread.request_stop();
  loop_thread.join();  // takes what waits, ends the strokes, cuts and publishes all of it
  server.stop();
  library.stop();
  const loop::LoopState state = frames.stats().state.load();
  const std::uint64_t lost = journal ? journal->lost() : 0;
  journal.reset();
  spdlog::info("ended at revision {}, state hash {:016x}, {} frames{}", state.revision, state.state_hash,
               state.frames, lost > 0 ? fmt::format(", {} records not in the capture", lost) : std::string());
}

}  // namespace incise::app
