#include "server/app/server_run.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdio>
#include <future>
#include <memory>
#include <optional>
#include <stdexcept>
#include <thread>
#include <vector>

#include "server/app/audit_log.hpp"
#include "server/app/body.hpp"
#include "server/app/capture_library.hpp"
#include "server/app/capture_lock.hpp"
#include "server/app/cluster_link.hpp"
#include "server/app/end_signals.hpp"
#include "server/app/freed_memory.hpp"
#include "server/app/look.hpp"
#include "server/app/loop_watch.hpp"
#include "server/app/network_sources.hpp"
#include "server/app/recording.hpp"
#include "server/app/session_journal.hpp"
#include "server/app/spare_session.hpp"
#include "server/app/stream_input.hpp"
#include "server/app/stream_output.hpp"
#include "server/app/stream_setup.hpp"
#include "server/app/surface_asset.hpp"
#include "server/app/telemetry.hpp"
#include "server/app/undone_slot.hpp"
#include "server/base/clock.hpp"
#include "server/base/thread_name.hpp"
#include "server/base/wording.hpp"
#include "server/loop/realtime.hpp"
#include "server/stream/ports.hpp"

namespace incise::app {
namespace {

// At the end the backlog is cut, but not minutes of it: service managers kill after 90 s.
constexpr std::int64_t kLongestFinish_ns = 20'000'000'000;
// What is left of that goes to the last checkpoint, which only makes the next start shorter; at least so much.
constexpr std::int64_t kLastCheckpoint_ns = 5'000'000'000;

Body load_and_log(const Config& config) {
  std::string last_stage;
  Body body = load_body(
      config,
      [&](std::string_view stage, double seconds) {
        if (seconds > 2 && last_stage != stage) spdlog::info("filling the mesh: {}", last_stage = stage);
      },
      true);
  check_cuttable(config, body.loaded.mesh, "");
  for (const std::string& warning : body.loaded.warnings) spdlog::warn("{}", warning);
  return_freed_memory();
  return body;
}

// With how the inside looks among its documents.
ServedSurface serve_surface(const Config& config, const Body& body) {
  std::vector<std::string> warnings;
  ServedSurface served = served_surface(body.loaded.surface.get(), warnings);
  served.documents.merge(served_look(config, body.loaded.mesh, "the configuration", warnings));
  for (const std::string& warning : warnings) spdlog::warn("{}", warning);
  return served;
}

// Makes of the body what sessions and, in a fresh one, viewers begin with, on two threads; then the arrays of the file are let go.
stream::InitialState build(Body& body, bool resume) {
  core::MeshData mesh = std::move(body.loaded.mesh);
  body.loaded.mesh = {};
  auto built =
      std::make_shared<core::LoadedBody>(mesh, body.loaded.fields, core::LoadedBody::ClustersLater{});
  auto clusters = std::async(std::launch::async, [&] {
    mesh = {};
    built->form_clusters();
  });
  stream::InitialState shown;
  if (!resume) {
    shown.mirror = mirror_of(replay::initial_state(built->mesh(), fresh_session_id()), body.origins);
    shown.fields = replay::shared_fields(built->fields());
  }
  clusters.get();
  body.built = std::move(built);
  return shown;
}

Recording open_recording(const Config& config, const Body& body, const stream::InitialState& shown,
                         bool resume, std::function<bool()> may_write, std::int64_t started_ns) {
  Recording recording = resume ? resume_recording(config, body) : begin_recording(config, body, shown);
  if (recording.journal) recording.journal->write_while(may_write);
  recording.may_write = std::move(may_write);
  recording.shown.before.origins = body.origins;
  spdlog::info("{}: {} vertices, {} tetrahedra, h = {:.4g} m, ready in {:.1f} s", body.name,
               body.built->mesh().vertex_slots() - body.built->mesh().initial_vertex_copies(),
               body.built->mesh().tet_slots(), body.built->mesh().mean_edge_length(),
               static_cast<double>(monotonic_ns() - started_ns) * 1e-9);
  return recording;
}

std::future<std::unique_ptr<haptics::Tissue>> begin_tissue(const Config& config, const Body& body,
                                                           const core::CutSession& session) {
  if (!config.haptics.forces) return {};
  return std::async(std::launch::async, [&body, &session] {
    auto tissue = std::make_unique<haptics::Tissue>(
        std::shared_ptr<const core::TetMesh>(body.built, &body.built->mesh()));
    if (session.revision() > 0) tissue->note_cuts(session.mesh());
    return tissue;
  });
}

std::vector<input::PoseSources::Declared> declared_sources(const Config& config) {
  std::vector<input::PoseSources::Declared> declared;
  for (const Config::Source& source : config.sources) declared.push_back({source.name, source.blade});
  return declared;
}

loop::LoopOptions loop_options(const Config& config) {
  loop::LoopOptions options;
  options.rate_hz = config.loop.rate_hz;
  options.budget_fraction = config.loop.budget_fraction;
  options.longest_finish_ns = kLongestFinish_ns;
  return options;
}

stream::RecordingNow recording_now(const loop::Journal* journal) {
  if (!journal) return {};
  std::string trouble = journal->trouble();
  return {trouble.empty() ? protocol::Recording::On : protocol::Recording::Stopped, std::move(trouble)};
}

// All parts of a running server, in the order in which they are made: each refers to those above it.
class RunningServer {
 public:
  RunningServer(const Config& config, bool resume, ClusterLink& cluster);
  ~RunningServer() {
    cluster_.stop();
    network_.stop();
  }
  RunningServer(const RunningServer&) = delete;
  RunningServer& operator=(const RunningServer&) = delete;
  // Opens the ports and starts the loop, then prints where the server listens.
  void start();
  // Watches the loop until a signal comes; its name.
  const char* watch(const EndSignals& signals);
  // Ends everything in an order that loses nothing, and logs how it ended. Returns how many records are not in the capture.
  std::uint64_t stop();

 private:
  stream::Providers providers();
  stream::ServerFacts facts();
  void join_loop();
  void open_inputs();
  void print_places() const;
  void run_loop(const std::stop_token& stop);
  void close_journal(std::int64_t ending_ns);
  void log_end() const;
  cluster::DirectoryEntry directory_entry() const;
  core::CutSession& session() { return *recording_.session; }
  double seconds_since_start() const { return static_cast<double>(monotonic_ns() - started_ns_) * 1e-9; }

  const Config& config_;
  ClusterLink& cluster_;
  const std::int64_t started_ns_ = monotonic_ns(), started_unix_ns_ = unix_ns();
  // Ports first: a start that fails must not have touched the last capture.
  std::unique_ptr<stream::Ports> ports_;  // until the server has them
  input::PoseSources sources_;
  NetworkSources network_;
  Body body_;
  ServedSurface surface_;
  stream::InitialState as_loaded_;  // what viewers are shown of the body; nothing where a session is resumed
  Recording recording_;
  // A session that has been cut a lot takes seconds to prepare: these two run side by side.
  SavedState saved_;
  std::future<std::unique_ptr<haptics::Tissue>> tissue_;
  UndoneSlot undone_;                       // the journal's thread writes it
  std::unique_ptr<loop::Journal> journal_;  // null: nothing is recorded
  input::PositionsSlot positions_;
  StreamInput stream_input_;
  // The loop publishes to the stream, which reports the loop's figures: they are set before the stream starts.
  std::optional<Telemetry> telemetry_;
  std::optional<LoopWatch> watch_;
  AuditLog audit_;
  CaptureLibrary library_;
  SpareSession spare_;
  SimulationOutput simulation_;
  stream::Server server_;
  StreamOutput output_;
  loop::FrameLoop frames_;
  haptics::ForceSlots forces_;
  ForceOutput force_output_;
  std::unique_ptr<input::HidInput> devices_;
  std::jthread loop_thread_;
};

RunningServer::RunningServer(const Config& config, bool resume, ClusterLink& cluster)
    : config_(config),
      cluster_(cluster),
      ports_(std::make_unique<stream::Ports>(stream_config(config))),
      sources_(config.cut.blade, declared_sources(config)),
      network_(config, sources_, server_),
      body_(load_and_log(config)),
      surface_(serve_surface(config, body_)),
      as_loaded_(build(body_, resume)),
      recording_(open_recording(config, body_, as_loaded_, resume, cluster.may_write(), started_ns_)),
      saved_(save_for_checkpoints(config, session())),
      tissue_(begin_tissue(config, body_, session())),
      undone_(body_.origins),
      journal_(make_journal(
          config, body_, recording_, saved_,
          [this](const loop::JournalRecord& pose, bool recorded) {
            if (recorded && core::accepted(pose.verdict))
              sources_.acknowledge_recorded(pose.source, pose.owner, pose.pose.t_ns);
            sources_.acknowledge(pose.source, pose.verdict, pose.pose.t_ns);
          },
          [this](loop::Undone undone) { undone_.offer(std::move(undone)); })),
      stream_input_(sources_, positions_, config),
      library_(config.resolve(config.capture.library), body_),
      spare_(body_, config.cut, as_loaded_),
      server_(std::move(ports_), facts(), recording_.shown.before, stream_input_, providers()),
      output_(server_),
      frames_(session(), sources_, output_, journal_.get(), loop_options(config)),
      force_output_(server_, static_cast<std::int64_t>(config.haptics.contact_valid_ms * 1e6),
                    config.haptics.force.most_torque_n_m > 0) {
  for (auto& delta : recording_.shown.deltas) server_.publish(std::move(delta));
  recording_.shown = {};
  as_loaded_ = {};
  join_loop();
  open_inputs();
}

stream::Providers RunningServer::providers() {
  return {[this] { return telemetry_->json(); },
          [this] { return telemetry_->metrics(); },
          [this] { return telemetry_->message(); },
          [this] { return telemetry_->blades(); },
          &library_,
          [this] { return watch_->trouble(); },
          [this](auto kind, auto& address, auto& line) { audit_.write(kind, address, line); },
          [this] { return recording_now(journal_.get()); },
          [this] { return simulation_.loads(); },
          [this](const protocol::BladeModel& model) { return simulation_.use(model); },
          std::move(surface_.documents),
          cluster_.listener(),
          cluster_ ? [this] { return cluster_.sessions_json(); } : std::function<std::string()>()};
}

stream::ServerFacts RunningServer::facts() {
  stream::ServerFacts facts = server_facts(config_, body_, session().mesh());
  facts.surface = std::move(surface_.facts);
  return facts;
}

void RunningServer::join_loop() {
  watch_.emplace(frames_.stats());
  telemetry_.emplace(frames_.stats(), sources_, journal_.get(), config_.loop.rate_hz);
  telemetry_->join_stream([this] { return server_.counters(); });
  if (cluster_) telemetry_->join_cluster([this] { return cluster_.counters(); });
  frames_.offer_deformation(positions_);
  if (config_.haptics.forces)
    frames_.offer_forces(config_.haptics.force, tissue_.get(), &force_output_, &forces_, &simulation_.link());
  stream_input_.join(frames_);
  const auto go_on = [this](std::unique_ptr<core::CutSession> used,
                            const std::shared_ptr<stream::InitialState>& shown) {
    spare_.give_back(used ? std::move(used) : std::move(recording_.session));
    server_.publish_reset(shown);
    return shown->epoch;
  };
  frames_.offer_reset([this] { return spare_.take(); },
                      [this, go_on](std::unique_ptr<core::CutSession> used) {
                        const auto shown = spare_.shown();
                        shown->restart = std::make_shared<const protocol::Restart>(protocol::Restart{
                            protocol::RestartKind::Reset, protocol::Role::Admin, {}, 0, {}});
                        return go_on(std::move(used), shown);
                      });
  if (!journal_ || !journal_->checkpointer()) return;
  stream_input_.join(journal_->checkpointer());
  frames_.offer_undo([this] { return undone_.take(); },
                     [this, go_on](std::unique_ptr<core::CutSession> used) {
                       const auto shown = undone_.shown();
                       shown->restart = stream_input_.undone();
                       return go_on(std::move(used), shown);
                     });
}

void RunningServer::open_inputs() {
  const std::function<void()> on_thread = [this] {
    const int priority = static_cast<int>(config_.loop.realtime_priority);
    if (priority > 0) loop::request_priority(priority);
  };
  if (config_.devices.enabled) {
    devices_ = std::make_unique<input::HidInput>(
        sources_, forces_,
        input::HidInput::Options{device_profiles(config_), config_.devices.overrides, on_thread});
    telemetry_->join([this] { return devices_->status(); });
  }
  network_.start(forces_, on_thread);
  telemetry_->join_network([this] { return network_.status(); });
}

void RunningServer::start() {
  if (saved_.valid()) saved_.wait();  // before anything changes the session
  session().drop_fields();            // the stream carries them, and the checkpoints
  if (config_.loop.lock_memory) spdlog::info("{}", loop::request_locked_memory());
  server_.start();
  loop_thread_ = std::jthread([this](const std::stop_token& stop) { run_loop(stop); });
  spare_.start();
  cluster_.start(server_, [this] { return directory_entry(); });
  print_places();
  if (journal_ && recording_.lost == 0)
    spdlog::info("recording to {}", config_.resolve(config_.capture.path).string());
  spdlog::info("ready: {} frames a second, {:.1f} s after the start; Ctrl-C ends", config_.loop.rate_hz,
               seconds_since_start());
}

cluster::DirectoryEntry RunningServer::directory_entry() const {
  cluster::DirectoryEntry entry;
  const stream::StreamCounters counters = server_.counters();
  entry.body = body_.name;
  entry.revision = counters.revision;
  entry.viewers = static_cast<std::uint32_t>(counters.peers);
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if (std::string name = sources_.name_of(source); !name.empty()) entry.blades.push_back(std::move(name));
  }
  entry.frame_p99_us = static_cast<double>(frames_.stats().frame_work.quantile_ns(0.99)) * 1e-3;
  entry.started_unix_s = started_unix_ns_ / 1'000'000'000;
  return entry;
}

void RunningServer::run_loop(const std::stop_token& stop) {
  name_thread("loop");
  if (config_.loop.cpu >= 0) spdlog::info("{}", loop::request_cpu(static_cast<int>(config_.loop.cpu)));
  if (config_.loop.realtime_priority > 0)
    spdlog::info("{}", loop::request_priority(static_cast<int>(config_.loop.realtime_priority)));
  frames_.run(stop);
}

// One line on stdout, for people and for scripts that wait for it; all else goes to the log.
void RunningServer::print_places() const {
  const auto place = [&](std::uint16_t port) {
    return port == 0 ? std::string("off") : config_.listen.address + ":" + std::to_string(port);
  };
  std::printf("listening tcp=%s http=%s%s\n", place(server_.tcp_port()).c_str(),
              place(server_.http_port()).c_str(), network_.place(config_).c_str());
  std::fflush(stdout);
}

const char* RunningServer::watch(const EndSignals& signals) {
  const char* signal = nullptr;
  while (!(signal = signals.wait())) {
    watch_->look();
    audit_.flush();
  }
  return signal;
}

std::uint64_t RunningServer::stop() {
  const std::int64_t ending_ns = monotonic_ns();
  if (devices_) devices_->stop();  // forces go to zero first
  network_.stop();
  loop_thread_.request_stop();
  loop_thread_.join();  // drains the queues, ends the strokes, cuts and publishes, for 20 s at most
  server_.stop();
  cluster_.stop();
  library_.stop();
  if (journal_) close_journal(ending_ns);
  log_end();
  return journal_ ? journal_->lost() : 0;
}

void RunningServer::close_journal(std::int64_t ending_ns) {
  const auto limit = std::max(kLongestFinish_ns - (monotonic_ns() - ending_ns), kLastCheckpoint_ns);
  const std::string why = journal_->close(std::chrono::milliseconds(limit / 1'000'000));
  if (why.empty()) return;
  if (journal_->lost() > 0) {
    spdlog::error(
        "recording stopped before the end and {} records are not in the capture: incised --resume goes back "
        "to where it stopped; make room on the disk",
        journal_->lost());
  } else {
    spdlog::warn("no checkpoint of the end ({}); incised --resume takes longer for it", why);
  }
}

void RunningServer::log_end() const {
  const loop::LoopState state = frames_.stats().state.load();
  const std::uint64_t lost = journal_ ? journal_->lost() : 0;
  if (state.backlog_segments > 0) {
    spdlog::warn("{} segments were not cut in the {} s that the end may take{}", state.backlog_segments,
                 kLongestFinish_ns / 1'000'000'000,
                 journal_ ? "; the capture has them: incised --resume goes on with them"
                          : "; they are lost, because nothing was recorded (capture.path)");
  }
  spdlog::info("ended at revision {}, state hash {:016x}, {} frames{}", state.revision, state.state_hash,
               state.frames, lost > 0 ? fmt::format(", {} records not in the capture", lost) : std::string());
}

// Null where nothing is recorded.
std::unique_ptr<CaptureLock> lock_capture(const Config& config) {
  if (config.capture.path.empty()) return nullptr;
  auto lock = std::make_unique<CaptureLock>(
      config.resolve(config.capture.path),
      config.cluster.failover ? CaptureLock::IfHeld::kGoOn : CaptureLock::IfHeld::kRefuse);
  if (!lock->trouble().empty()) spdlog::warn("{}", lock->trouble());
  return lock;
}

}  // namespace

void run_server(const Config& config, bool resume, const EndSignals& signals) {
  ClusterLink cluster(config);
  if (!cluster.acquire(signals)) {
    spdlog::info("{}: ending; another instance had the session", signals.wait());
    return;
  }
  std::uint64_t lost = 0;
  {
    const auto lock = lock_capture(config);  // until the server has closed the capture
    raise_descriptor_limit();
    RunningServer server(config, resume || cluster.resumes(), cluster);
    server.start();
    const char* const signal = server.watch(signals);
    spdlog::info("{}: ending", signal);
    lost = server.stop();
  }
  cluster.release();
  if (lost > 0) {
    throw std::runtime_error(config.resolve(config.capture.path).string() +
                             ": is incomplete: " + counted(lost, "record is", "records are") +
                             " not in it, since it could not be written (the log says when and why)");
  }
}

}  // namespace incise::app
