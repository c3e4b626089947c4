#include "server/app/capture_library.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "protocol/capture.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/stream_setup.hpp"
#include "server/base/clock.hpp"
#include "server/replay/replay.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using protocol::ReplayAction;
using std::chrono::steady_clock;

constexpr std::size_t kMostPlaying = 4;               // each holds a mesh and three replicas of it
constexpr std::chrono::milliseconds kStateEvery{50};  // while it plays

// Whether clients can show a name: UTF-8 without control characters.
bool is_text(const std::string& name) {
  const auto is_control = [](unsigned char c) { return c < 0x20 || c == 0x7f; };
  if (std::any_of(name.begin(), name.end(), is_control)) return false;
  try {
    return !nlohmann::json(name).dump().empty();
  } catch (const nlohmann::json::exception&) {
    return false;
  }
}

// Whether it is a file in the folder `home` (canonical); links that lead outside are not.
bool lies_in(const fs::path& home, const fs::path& path) {
  std::error_code error;
  const fs::path real = fs::canonical(path, error);
  if (error || !fs::is_regular_file(real, error)) return false;
  return std::mismatch(home.begin(), home.end(), real.begin(), real.end()).first == home.end();
}

// One capture's replay, on its thread. Requests arrive in `wishes`, under the mutex.
class Replay {
 public:
  Replay(std::string name, stream::ReplayEvents events)
      : name_(std::move(name)), events_(std::move(events)) {}

  void load(const fs::path& path, const Body& live) {
    {
      std::ifstream in(path, std::ios::binary);
      const protocol::CaptureReader reader(in);
      if (!reader.header_ok())
        throw std::runtime_error(name_ + ": is not a capture of incised: " + reader.error());
    }
    RecordedMotion motion = read_recorded_motion(path);
    config_ = config_of(*motion.header, name_);
    if (live.loaded.has_hash(motion.header->mesh_content_hash)) {
      body_ = &live;
    } else {
      if (!config_.mesh.path.empty()) config_.mesh.path = motion.header->mesh_path;
      own_body_ = load_body(config_, {}, true);
      if (!own_body_.loaded.has_hash(motion.header->mesh_content_hash)) {
        throw std::runtime_error(name_ + ": " + own_body_.name +
                                 " has changed since this was recorded; a replay needs the mesh as it was");
      }
      body_ = &own_body_;
    }
    std::vector<core::Blade> blades;
    for (const Config::Source& source : config_.sources) blades.push_back(source.blade);
    replay_.emplace([this] { return body_->session(config_.cut); }, config_.cut, std::move(blades),
                    std::move(motion));
    show();
  }

  std::uint64_t revision() const { return replay_->revision(); }
  bool at_end() const { return replay_->at_end(); }
  std::int64_t due_ns() const { return replay_->due_ns(); }
  std::int64_t clock_ns() const { return replay_->clock_ns(); }

  // As replay::Replay does; `tell`: viewers get the batch.
  bool advance(bool tell) {
    auto delta = std::make_shared<stream::PublishedDelta>();
    if (!replay_->advance(delta->delta)) return false;
    delta->arrival_ns = delta->drain_ns = delta->cut_ns = monotonic_ns();
    if (tell) events_.delta(std::move(delta));
    return true;
  }

  void seek(std::uint64_t revision, const std::atomic<bool>& stop) {
    const bool back = revision < this->revision();
    if (back) replay_->restart();
    while (this->revision() < revision && !at_end() && !stop) advance(!back);
    if (back) show();
  }

  // `first`: says what there is in the recording, too.
  void report_state(bool playing, float speed, bool first = false) const {
    protocol::ReplayState state;
    state.capture = name_;
    state.playing = playing;
    state.speed = speed;
    state.revision = revision();
    state.last_revision = replay_->last_revision();
    if (first) replay_->describe(state);
    events_.state(std::move(state));
  }
  void fail(const std::string& why) const { events_.failed(why); }

 private:
  void show() {
    auto state =
        std::make_shared<stream::InitialState>(replay::initial_state(replay_->session(), fresh_session_id()));
    // Clients have the live body's surface only.
    if (body_ != &own_body_) state->origins = body_->origins;
    events_.restarted(server_facts(config_, *body_, replay_->session().mesh()).mesh, std::move(state));
  }

  const std::string name_;
  const stream::ReplayEvents events_;
  Config config_;
  Body own_body_;
  const Body* body_ = nullptr;
  std::optional<replay::Replay> replay_;
};

}  // namespace

struct CaptureLibrary::Playing {
  std::mutex mutex;
  std::condition_variable wake;
  std::vector<protocol::ReplayControl> wishes;  // guarded by mutex
  std::atomic<bool> stop{false}, ended{false};
  std::thread thread;

  void end() {
    stop = true;
    const std::scoped_lock lock(mutex);
    wake.notify_one();
  }

  void run(Replay& replay) {
    Tempo tempo;
    steady_clock::time_point reported;
    replay.report_state(tempo.playing, tempo.speed, true);
    while (!stop) {
      const std::vector<protocol::ReplayControl> asked = wait_for_wishes(replay, tempo);
      for (const protocol::ReplayControl& wish : asked) {
        apply(wish, replay, tempo);
        tempo.from_ns = replay.clock_ns();
        tempo.since = steady_clock::now();
      }
      bool news = !asked.empty();
      if (tempo.playing && asked.empty() && !stop) {
        replay.advance(true);
        if (replay.at_end()) tempo.playing = false;
        news = !tempo.playing || steady_clock::now() - reported > kStateEvery;
      }
      if (news) {
        reported = steady_clock::now();
        replay.report_state(tempo.playing, tempo.speed);
      }
    }
  }

 private:
  struct Tempo {
    bool playing = false;
    float speed = 1;
    // While it plays: the recording's clock read `from_ns` at the time `since`.
    std::int64_t from_ns = 0;
    steady_clock::time_point since;
  };

  // While it plays, waits until the next event is due.
  std::vector<protocol::ReplayControl> wait_for_wishes(const Replay& replay, const Tempo& tempo) {
    std::unique_lock lock(mutex);
    const auto asked = [&] { return stop || !wishes.empty(); };
    if (tempo.playing) {
      const double ahead_ns =
          static_cast<double>(replay.due_ns() - tempo.from_ns) / static_cast<double>(tempo.speed);
      wake.wait_until(lock, tempo.since + std::chrono::nanoseconds(static_cast<std::int64_t>(ahead_ns)),
                      asked);
    } else {
      wake.wait(lock, asked);
    }
    return std::exchange(wishes, {});
  }

  void apply(const protocol::ReplayControl& wish, Replay& replay, Tempo& tempo) {
    switch (wish.action) {
      case ReplayAction::Play:
        // From the end it starts again.
        if (replay.at_end()) replay.seek(0, stop);
        tempo.playing = true;
        tempo.speed = std::clamp(wish.speed, replay::kLeastSpeed, replay::kMostSpeed);
        break;
      case ReplayAction::Pause:
        tempo.playing = false;
        break;
      case ReplayAction::Step:
        tempo.playing = false;
        while (!replay.at_end() && !replay.advance(true) && !stop) {
        }
        break;
      case ReplayAction::Seek:
        replay.seek(wish.revision, stop);
        break;
      case ReplayAction::Open:
      case ReplayAction::Close:
        break;
    }
  }
};

// What the session holds. It hands the wishes to the thread.
class CaptureLibrary::Player final : public stream::ReplayPlayer {
 public:
  explicit Player(std::shared_ptr<Playing> playing) : playing_(std::move(playing)) {}
  ~Player() override { playing_->end(); }
  void control(const protocol::ReplayControl& control) override {
    const std::scoped_lock lock(playing_->mutex);
    playing_->wishes.push_back(control);
    playing_->wake.notify_one();
  }

 private:
  std::shared_ptr<Playing> playing_;
};

CaptureLibrary::CaptureLibrary(fs::path directory, const Body& live)
    : directory_(std::move(directory)), live_(live) {}

CaptureLibrary::~CaptureLibrary() {
  stop();
}

void CaptureLibrary::stop() {
  for (const auto& playing : playing_) playing->end();
  for (const auto& playing : playing_) playing->thread.join();
  playing_.clear();
}

std::vector<std::string> CaptureLibrary::names() {
  std::vector<std::string> names;
  std::error_code error;
  const fs::path home = fs::canonical(directory_, error);
  if (error) return names;
  for (const fs::directory_entry& entry : fs::directory_iterator(home, error)) {
    const std::string name = entry.path().filename().string();
    if (entry.path().extension() != ".capture" || name.front() == '.') continue;
    if (is_text(name) && lies_in(home, entry.path())) {
      names.push_back(name);
    } else if (left_out_.insert(name).second) {
      spdlog::warn("capture.library: {} is not offered", is_text(name)
                                                             ? name + ", which is not a file in this folder,"
                                                             : "a file whose name is not UTF-8 text");
    }
  }
  std::sort(names.begin(), names.end());
  return names;
}

void CaptureLibrary::forget_ended() {
  std::erase_if(playing_, [](const std::shared_ptr<Playing>& playing) {
    if (!playing->ended) return false;
    playing->thread.join();
    return true;
  });
}

std::unique_ptr<stream::ReplayPlayer> CaptureLibrary::open(const std::string& name,
                                                           stream::ReplayEvents events) {
  forget_ended();
  const std::vector<std::string> known = names();
  const auto running =
      std::count_if(playing_.begin(), playing_.end(), [](const auto& p) { return !p->stop; });
  if (std::find(known.begin(), known.end(), name) == known.end()) return nullptr;
  if (static_cast<std::size_t>(running) >= kMostPlaying) return nullptr;
  auto playing = std::make_shared<Playing>();
  playing_.push_back(playing);
  playing->thread = std::thread([playing, replay = std::make_shared<Replay>(name, std::move(events)),
                                 path = directory_ / name, &live = live_] {
    try {
      replay->load(path, live);
      playing->run(*replay);
    } catch (const std::exception& error) {
      replay->fail(error.what());
    }
    playing->ended = true;
  });
  return std::make_unique<Player>(std::move(playing));
}

}  // namespace incise::app
