#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cinttypes>
#include <cstdio>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <utility>

#include "client/cli/commands.hpp"
#include "client/cli/restart_notice.hpp"
#include "client/cli/shown_name.hpp"
#include "protocol/limits.hpp"

namespace incise::client {
namespace {

using protocol::PoseSample;
using std::chrono::steady_clock;
constexpr std::chrono::milliseconds kStep{1};
constexpr std::size_t kAtOnce = 1000;                // poses in a message when there is no rate to keep
constexpr std::int64_t kLoopPause_ns = 500'000'000;  // between two rounds: a new stroke
constexpr double kPatience_s = 10;                   // without any progress of the server's

void warn(const std::string& text) {
  std::fprintf(stderr, "warning: %s\n", text.c_str());
}

// "1 pose", "2 poses"
std::string counted(std::uint64_t n, const char* what) {
  return std::to_string(n) + " " + what + (n == 1 ? "" : "s");
}

// In a motion without buttons the one that engages is held, or nothing would be cut.
std::vector<PoseSample> engaged(const protocol::Motion& motion, int engage_button) {
  std::vector<PoseSample> poses = motion.samples;
  if (!motion.has_buttons && engage_button >= 0) {
    for (PoseSample& pose : poses) pose.buttons |= 1u << engage_button;
  }
  return poses;
}

// What has been cut, as far as it has come here.
struct Seen {
  std::atomic<std::uint32_t> source{UINT32_MAX};  // the number of this blade, once it is known
  std::atomic<std::uint64_t> last_cut{0};         // revision of its last batch
  std::atomic<std::uint64_t> faces{0};            // that it has opened
  std::atomic<bool> missed{false};  // a snapshot came in the place of deltas, or took back what it had opened
};

class Player {
 public:
  Player(const StreamCommand& command, Client& client, protocol::Motion motion, const Seen& seen)
      : command_(command),
        client_(client),
        poses_(engaged(motion, client.welcome().engage_button)),
        restarts_(std::move(motion.restarts)),
        welcome_(client.welcome()),
        seen_(seen) {}

  int run() {
    const auto began = steady_clock::now();
    do {
      play_once();
      ++rounds_;
    } while (command_.loop && !interrupted() && connected());
    client_.end_stroke(last_source_ns_);
    const bool settled = wait_until_settled();
    seconds_ = std::chrono::duration<double>(steady_clock::now() - began).count();
    print(settled);
    if (!connected()) {
      throw std::runtime_error(command_.server.address + ": " + client_.last_error() + "; it acknowledged " +
                               std::to_string(acknowledged()) + " of " + counted(sent_, "pose") + " sent; " +
                               advice());
    }
    return settled ? 0 : 1;
  }

 private:
  // What to do where the connection has ended.
  std::string advice() const {
    std::string again = "play the motion again";
    switch (client_.goodbye()) {
      case protocol::ByeReason::HandedOver:
        return "--take-over takes the blade back, --source NAME uses one of your own";
      case protocol::ByeReason::ServerStops:
        return again + " when incised runs again (with --resume it has what it has recorded)";
      case protocol::ByeReason::Unknown:
        return "the server was killed, or the network between has failed: " + again +
               " when it answers (incised --resume has what was recorded)";
      default:
        return again;
    }
  }

  // Poses that the server has reported, taken or not.
  std::uint64_t acknowledged() const {
    const protocol::PoseReport r = client_.report();
    return r.accepted + r.not_finite + r.not_unit + r.time_not_rising + r.queue_full;
  }

  bool connected() const { return client_.status() == Status::kConnected; }

  bool restarts_at(std::size_t pose) const {
    return std::binary_search(restarts_.begin(), restarts_.end(), pose);
  }

  // Sends every pose at its time. The deadlines are absolute: a late one does not make all others late.
  void play_once() {
    const std::int64_t first_ns = poses_.front().source_ns;
    const std::int64_t shift_ns = rounds_ == 0 ? 0 : last_source_ns_ + kLoopPause_ns - first_ns;
    const auto began = steady_clock::now();
    std::vector<PoseSample> due;
    std::size_t next = 0;
    while (next < poses_.size() && !interrupted() && connected()) {
      due.clear();
      const auto elapsed = steady_clock::now() - began;
      while (next + due.size() < poses_.size() && due.size() < kAtOnce) {
        PoseSample pose = poses_[next + due.size()];
        if (command_.speed > 0) {
          const auto at = std::chrono::duration<double, std::nano>(
              static_cast<double>(pose.source_ns - first_ns) / command_.speed);
          if (at > elapsed) break;
        }
        pose.source_ns += shift_ns;
        due.push_back(pose);
        if (restarts_at(next + due.size())) break;
      }
      const std::uint64_t sequence = client_.send_poses(due);
      if (sequence == 0) {
        std::this_thread::sleep_for(kStep);  // nothing due yet, or the network is behind
        continue;
      }
      last_sequence_ = sequence;
      last_source_ns_ = due.back().source_ns;
      next += due.size();
      sent_ += due.size();
      if (restarts_at(next)) client_.end_stroke(last_source_ns_);
    }
  }

  // Until the server has counted every pose, and cut what they called for. As long as it takes, while it goes
  // on. Other blades may have it busy all the while.
  bool wait_until_settled() {
    protocol::PoseReport last = client_.report();
    std::uint64_t last_cut = seen_.last_cut;
    auto progress = steady_clock::now(), own_progress = progress;
    while (connected()) {
      std::this_thread::sleep_for(10 * kStep);
      const protocol::PoseReport report = client_.report();
      const std::uint64_t cut = seen_.last_cut;  // a body that a simulation deforms always has news
      const auto now = steady_clock::now();
      if (report.through_sequence != last.through_sequence || report.accepted != last.accepted ||
          cut != last_cut)
        own_progress = now;
      if (own_progress == now || report.backlog_segments != last.backlog_segments) progress = now;
      last = report;
      last_cut = cut;
      // The last batch is reported before its delta is here: a moment without news says that it is.
      if (report.through_sequence >= last_sequence_ && report.backlog_segments == 0 &&
          now - own_progress > std::chrono::milliseconds(300)) {
        return true;
      }
      if (now - progress > std::chrono::duration<double>(kPatience_s)) return false;
    }
    return false;
  }

  // Where its own blade has opened nothing. A jump is told by its limits: the server has said the one, the other is named with its default.
  std::string why_nothing_was_cut(const protocol::PoseReport& report) const {
    if (report.too_fast == 0) {
      return "the blade missed the mesh, never moved, or no pose held the button that engages it, or all "
             "of it was cut before";
    }
    std::int64_t longest_ns = 0;
    for (std::size_t i = 1; i < poses_.size(); ++i)
      longest_ns = std::max(longest_ns, poses_[i].source_ns - poses_[i - 1].source_ns);
    char text[320];
    std::snprintf(
        text, sizeof text,
        "%s treated as a jump, which is faster than the server's cut.speed_limit_m_s (%g m/s) or comes "
        "after more than its cut.gap_limit_s (0.25 s by default): the poses are up to %.3g s apart; record "
        "more of them, or raise the limit there",
        (counted(report.too_fast, "step") + (report.too_fast == 1 ? " was" : " were")).c_str(),
        welcome_.max_speed_m_s, static_cast<double>(longest_ns) * 1e-9);
    return text;
  }

  void print(bool settled) const {
    const protocol::PoseReport r = client_.report();
    const std::uint64_t revision = client_.revision();
    const std::uint64_t rejected = r.not_finite + r.not_unit + r.time_not_rising + r.queue_full;
    if (r.recording != protocol::Recording::Off && r.recorded < r.accepted) {
      std::fprintf(stderr,
                   "incise: %" PRIu64 " of %" PRIu64 " accepted poses are not in the server's capture\n",
                   r.accepted - r.recorded, r.accepted);
    }
    if (settled && seen_.faces == 0 && !seen_.missed) {
      warn("nothing was cut by blade " + shown_name(command_.source_name) + ": " + why_nothing_was_cut(r));
    }
    if (command_.json) {
      const nlohmann::ordered_json summary{{"poses_sent", sent_},
                                           {"accepted", r.accepted},
                                           {"rejected",
                                            {{"not_finite", r.not_finite},
                                             {"not_unit", r.not_unit},
                                             {"time_not_rising", r.time_not_rising},
                                             {"queue_full", r.queue_full}}},
                                           {"new_strokes_by_speed_or_gap", r.too_fast},
                                           {"cut_faces", seen_.faces.load()},
                                           {"recorded", r.recorded},
                                           {"recording", name_of(r.recording)},
                                           {"settled", settled},
                                           {"first_revision", welcome_.revision},
                                           {"revision", revision},
                                           {"revisions", revision - std::min(revision, welcome_.revision)},
                                           // Text: jq and JavaScript round a number of 64 bits.
                                           {"session", std::to_string(welcome_.session)},
                                           {"rounds", rounds_},
                                           {"seconds", seconds_}};
      std::printf("%s\n", summary.dump().c_str());
      return;
    }
    std::printf("sent %" PRIu64 " poses in %.2f s: %" PRIu64 " accepted, %" PRIu64 " rejected", sent_,
                seconds_, r.accepted, rejected);
    if (rejected > 0) {
      std::printf(" (%" PRIu64 " not finite or more than 10 km away, %" PRIu64
                  " without a unit quaternion, %" PRIu64 " with a time that does not rise, %" PRIu64
                  " queue full)",
                  r.not_finite, r.not_unit, r.time_not_rising, r.queue_full);
    }
    std::printf("; %s by speed or gap\nrevision %" PRIu64 " to %" PRIu64 ", with %s of this blade\n",
                counted(r.too_fast, "new stroke").c_str(), welcome_.revision, revision,
                counted(seen_.faces, "cut face").c_str());
    if (!settled && connected())
      std::printf("the server has not received and cut all of them within %.0f s\n", kPatience_s);
  }

  const StreamCommand& command_;
  Client& client_;
  const std::vector<PoseSample> poses_;
  const std::vector<std::size_t> restarts_;
  const protocol::Welcome welcome_;
  const Seen& seen_;
  std::uint64_t rounds_ = 0, sent_ = 0, last_sequence_ = 0;
  std::int64_t last_source_ns_ = 0;
  double seconds_ = 0;
};

// Resets the body as an administrator, on a connection of its own; returns when the server has done it.
void reset_body(const Address& where, Options options) {
  // The others are told who it was.
  options.client_name =
      (options.client_name + " stream, blade " + options.source_name).substr(0, protocol::kMaxNameBytes);
  try {
    restart_as_admin(where, options, protocol::RestartKind::Reset);
  } catch (const ConnectError&) {
    throw;
  } catch (const std::runtime_error& error) {
    throw std::runtime_error("--reset: " + std::string(error.what()));
  }
}

std::unique_ptr<Client> connect_operator(const Address& where, const Options& options, Callbacks callbacks) {
  try {
    return connect(where, options, std::move(callbacks));
  } catch (const ConnectError& error) {
    if (error.code != protocol::ErrorCode::BladeTaken || options.take_over) throw;
    throw ConnectError(std::string(error.what()) +
                           "; --source NAME uses another blade, --take-over takes it from its holder",
                       error.code);
  }
}

}  // namespace

int run_stream(const StreamCommand& command, protocol::Motion motion) {
  Address where;
  Options options = command.server.options(where);
  options.role = protocol::Role::Operator;
  // For the revision, which the view None would not tell: the smaller view, a few times a second.
  options.view = protocol::View::Surface;
  options.max_rate_hz = 10;
  options.source_name = command.source_name;
  options.take_over = command.take_over;
  if (!command.blade.empty()) options.blade = protocol::parse_blade("--blade", command.blade);
  if (command.reset) reset_body(where, options);
  interrupted();  // from here on Ctrl-C ends the playing, not the program
  Callbacks callbacks;
  callbacks.on_error = [](const protocol::Error& error) {
    std::fprintf(stderr, "incise: server: %s\n", error.text.c_str());
  };
  bool stopped = false;
  callbacks.on_report = [&stopped](const protocol::PoseReport& report) {
    const bool before = std::exchange(stopped, report.recording == protocol::Recording::Stopped);
    if (before && !stopped) std::fprintf(stderr, "incise: server: poses are recorded again\n");
  };
  Seen seen;
  std::vector<std::pair<std::uint64_t, std::uint64_t>>
      opened;  // at this revision so many faces; the client's thread
  callbacks.on_welcome = [&, notice = RestartNotice()](const protocol::Welcome& welcome) mutable {
    notice(welcome);
    // What it has opened since is closed after a reset or an undo.
    while (!opened.empty() && opened.back().first > welcome.revision) {
      seen.faces -= opened.back().second;
      seen.missed = true;
      opened.pop_back();
    }
  };
  callbacks.on_surface_delta = [&](const protocol::SurfaceReplica&, const protocol::SurfaceDelta& delta,
                                   const Arrival&) {
    for (const protocol::Step& step : delta.steps) {
      if (step.stroke == 0 || step.source != seen.source) continue;
      seen.last_cut = step.revision;
      seen.faces += step.cut_faces;
      if (step.cut_faces > 0) opened.emplace_back(step.revision, step.cut_faces);
    }
  };
  callbacks.on_snapshot = [&](const protocol::SnapshotEnd&, protocol::SnapshotCause cause) {
    using Cause = protocol::SnapshotCause;
    if (cause == Cause::Resync || cause == Cause::TooSlow) seen.missed = true;
  };
  const auto client = connect_operator(where, options, std::move(callbacks));
  seen.source = client->welcome().source;
  return Player(command, *client, std::move(motion), seen).run();
}

}  // namespace incise::client
