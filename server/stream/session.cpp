#include "server/stream/session.hpp"

#include <algorithm>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <chrono>
#include <cmath>
#include <utility>

#include "server/base/clock.hpp"

namespace incise::stream {
namespace {

using protocol::ByeReason;
using protocol::ErrorCode;
using protocol::Role;
using protocol::SnapshotCause;
using protocol::View;
using std::chrono::milliseconds;

double distance(const protocol::Vec3& a, const protocol::Vec3& b) {
  return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z);
}

constexpr std::size_t kMaxControlBytes = 1u << 20;   // beyond that a peer does not read what it asked for
constexpr std::size_t kMaxWaitingBladeBytes = 4096;  // older poses are of no use
constexpr std::size_t kMaxWriteBytes = 1u << 20;     // in one go, so that a deadline is about so much
constexpr std::size_t kMaxWriteFrames = 32;
constexpr std::uint32_t kMaxPoseMessagesPerSecond =
    20'000;                                         // more than any device sends; beyond that they wait
constexpr std::int64_t kLinger_ns = 1'000'000'000;  // for the peer to close after Bye
// For a peer that has not read to begin again, so that it finds Bye behind the message that is on its way.
constexpr std::int64_t kLongLinger_ns = 60'000'000'000;
constexpr milliseconds kRetry{1};  // until the loop has drained a full queue
constexpr int kTakeOverTries = 1000;

std::int64_t to_ns(double seconds) {
  return static_cast<std::int64_t>(seconds * 1e9);
}

constexpr const char* kRoleNames[] = {"viewer", "operator", "simulator", "admin"};

std::size_t accepted_bytes(Role role) {
  return role == Role::Simulator ? protocol::kMaxSimulatorBytes : protocol::kMaxClientBytes;
}

// What clients know the run of ids `session` as. Each view, and what a box holds, has a name of its own, so that nobody goes
// on in one view from a state that he holds of another.
std::uint64_t session_name(std::uint64_t session, View view, bool boxed) {
  return session ^ (view == View::Surface ? 0x9e3779b97f4a7c15 : 0) ^ (boxed ? 0xc2b2ae3d27d4eb4f : 0);
}

// A peer's text as it may stand in a log.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text.substr(0, 64)) out += c >= ' ' && c <= '~' && c != '"' ? c : '?';
  return out + '"';
}

}  // namespace

Session::Session(Hub& hub, std::unique_ptr<Transport> transport, Hub::Ticket ticket)
    : hub_(hub),
      transport_(std::move(transport)),
      ticket_(std::move(ticket)),
      number_(hub.counters().accepted),
      peer_(transport_->peer()),
      rate_timer_(hub.io()),
      opened_ns_(monotonic_ns()),
      last_received_ns_(opened_ns_) {}

Session::~Session() = default;

// ---- Reading ----

asio::awaitable<void> Session::run() {
  const auto self = shared_from_this();
  hub_.add(self);
  while (stage_ == Stage::kHandshake || stage_ == Stage::kOpen) {
    const bool go_on = co_await receive();
    if (!go_on) break;
  }
  source_.reset();  // ends the stroke
  positions_.reset();
  if (stage_ == Stage::kClosing) co_await transport_->discard();
  close();
  hub_.remove(self);
}

asio::awaitable<bool> Session::receive() {
  const Received received = co_await transport_->read();
  if (received.closed) co_return false;
  last_received_ns_ = monotonic_ns();
  if (stage_ == Stage::kClosing || stage_ == Stage::kClosed) co_return true;
  if (!received.error.empty()) {
    ++hub_.counters().bad_messages;
    refuse(received.too_long ? ErrorCode::TooLong : ErrorCode::BadFrame, received.error);
    co_return true;
  }
  ++hub_.counters().messages_in;
  hub_.counters().bytes_in += received.body.size();
  const std::size_t max_bytes =
      stage_ == Stage::kHandshake ? protocol::kMaxHandshakeBytes : accepted_bytes(role_);
  protocol::DecodeResult decoded = protocol::decode(received.body, max_bytes);
  if (!decoded) {
    ++hub_.counters().bad_messages;
    refuse(decoded.code, decoded.error);
    co_return true;
  }
  const bool poses = std::holds_alternative<protocol::PoseBatch>(decoded.message->body);
  if (!poses && !within_rate()) {
    refuse(ErrorCode::RateExceeded,
           "more than " + std::to_string(hub_.config().max_messages_per_s) + " messages a second",
           decoded.message->envelope.sequence);
    co_return true;
  }
  co_await handle(std::move(*decoded.message));
  co_return true;
}

bool Session::within_rate() {
  if (last_received_ns_ - rate_window_ns_ >= 1'000'000'000) {
    rate_window_ns_ = last_received_ns_;
    rate_count_ = rate_pose_messages_ = 0;
  }
  return ++rate_count_ <= hub_.config().max_messages_per_s;
}

asio::awaitable<void> Session::pause(milliseconds time) {
  asio::steady_timer timer(hub_.io(), time);
  co_await timer.async_wait(asio::as_tuple(asio::use_awaitable));
}

asio::awaitable<void> Session::handle(protocol::Message message) {
  const std::uint64_t sequence = message.envelope.sequence;
  const protocol::Body& body = message.body;
  if (stage_ == Stage::kHandshake) {
    if (const auto* hello = std::get_if<protocol::Hello>(&body)) {
      co_await on_hello(*hello, sequence);
    } else {
      refuse(ErrorCode::BadState, std::string(name_of(body)) + " before Hello", sequence);
    }
    co_return;
  }
  if (const auto* poses = std::get_if<protocol::PoseBatch>(&body)) {
    co_await on_poses(*poses, sequence);
  } else if (const auto* stroke = std::get_if<protocol::StrokeControl>(&body)) {
    co_await on_stroke(*stroke, sequence);
  } else if (const auto* ping = std::get_if<protocol::Ping>(&body)) {
    push_control(make_frame(protocol::Pong{ping->nonce, ping->sent_ns, last_received_ns_}));
  } else if (std::holds_alternative<protocol::Pong>(body)) {
    // That it came is all it says.
  } else if (const auto* subscribe = std::get_if<protocol::Subscribe>(&body)) {
    on_subscribe(*subscribe);
  } else if (std::holds_alternative<protocol::Resync>(body)) {
    on_resync();
  } else if (std::holds_alternative<protocol::Reset>(body)) {
    on_reset(sequence);
  } else if (std::holds_alternative<protocol::Bye>(body)) {
    finish(ByeReason::Done, "");
  } else if (const auto* replay = std::get_if<protocol::ReplayControl>(&body)) {
    on_replay(*replay, sequence);
  } else if (const auto* positions = std::get_if<protocol::Positions>(&body)) {
    on_positions(*positions, sequence);
  } else {
    complain(ErrorCode::BadState, std::string(name_of(body)) + " is not for a client to send now", sequence);
  }
}

// ---- Handshake ----

asio::awaitable<void> Session::on_hello(const protocol::Hello& hello, std::uint64_t sequence) {
  if (hello.protocol_version != protocol::kProtocolVersion) {
    refuse(ErrorCode::BadVersion,
           "protocol version " + std::to_string(hello.protocol_version) + ", accepted is " +
               std::to_string(protocol::kProtocolVersion),
           sequence);
    co_return;
  }
  client_name_ = hello.client_name;
  const bool admitted = co_await check_token(hello, sequence);
  if (!admitted) co_return;
  if (!hub_.has_room()) {
    refuse(ErrorCode::TooManySessions,
           "there are " + std::to_string(hub_.config().max_sessions) + " sessions already", sequence);
    co_return;
  }
  // From here on it counts, so that no two take the last place.
  ticket_.welcome();
  if (hello.role == Role::Operator) {
    const bool taken = co_await take_blade(hello, sequence);
    if (!taken || stage_ != Stage::kHandshake) co_return;
  }
  role_ = hello.role;
  view_ = hello.view;
  box_ = hello.box;
  max_rate_hz_ = hello.max_rate_hz;
  blade_rate_hz_ = hello.blade_rate_hz;
  stage_ = Stage::kOpen;
  transport_->set_max_bytes(accepted_bytes(role_));

  const std::uint64_t head = feed().mirror().revision();
  const bool returns = view_ != View::None && hello.resume_session != 0;
  // What a box held is not known any longer.
  const bool resumed = returns && !hello.box &&
                       hello.resume_session == session_name(feed().mirror().session(), view_, false) &&
                       feed().ring().covers(hello.resume_revision, head);
  send_welcome(resumed);
  last_report_.recording = hub_.recording().state;  // Welcome has said so
  if (last_report_.recording == protocol::Recording::Stopped) warn_not_recorded();
  if (resumed) {
    ++hub_.counters().resumed;
    revision_ = hello.resume_revision;
    advance();
  } else {
    request_snapshot(returns ? SnapshotCause::ResumeGone : SnapshotCause::Join);
  }
}

// A token that opens the role is not held up; the answer to a wrong one may be.
asio::awaitable<bool> Session::check_token(const protocol::Hello& hello, std::uint64_t sequence) {
  using Verdict = Access::Verdict;
  const auto opens = [&](const AccessToken& token) {
    return std::find(token.roles.begin(), token.roles.end(), hello.role) != token.roles.end();
  };
  const Access::Answer answer =
      hub_.access().ask(ticket_.peer().address(), hello.token, opens, last_received_ns_);
  if (answer.verdict == Verdict::kGranted) co_return true;
  const std::string role = std::string("role ") + kRoleNames[static_cast<std::size_t>(hello.role)];
  hub_.note_refusal(answer, role, described());
  if (answer.hold_ns > 0) {
    const auto held = hub_.access().hold();
    opened_ns_ += answer.hold_ns;  // the deadline of the handshake is for the peer's time
    co_await pause(milliseconds(answer.hold_ns / 1'000'000));
  }
  if (answer.verdict == Verdict::kNotLookedAt) {
    refuse(ErrorCode::RateExceeded,
           "too many wrong tokens from this address; try again in " +
               std::to_string(1 + answer.come_back_ns / 1'000'000'000) + " s",
           sequence);
    co_return false;
  }
  refuse(ErrorCode::Unauthorized,
         answer.verdict == Verdict::kNoToken ? role + " needs a token, and none was given"
                                             : "the token is wrong, or does not open " + role,
         sequence);
  co_return false;
}

std::string Session::described() const {
  return quoted(client_name_) + " at " + peer_;
}

asio::awaitable<bool> Session::take_blade(const protocol::Hello& hello, std::uint64_t sequence) {
  if (hello.blade) {  // what a sweep costs grows with the blade's length
    const protocol::Box& box = hub_.facts().mesh.box;
    const double length = distance(hello.blade->heel, hello.blade->tip),
                 most = 100 * distance(box.min, box.max);
    if (!(length <= most)) {
      refuse(ErrorCode::BadRequest,
             "Hello.blade is " + std::to_string(length) + " m long, accepted are up to " +
                 std::to_string(most) + " m: 100 times the mesh",
             sequence);
      co_return false;
    }
  }
  std::unique_ptr<PoseInput> source = hub_.input().open(hello.source_name, hello.blade);
  if (!source && hello.take_over) {
    if (const auto holder = hub_.holder(hello.source_name)) {
      ++hub_.counters().takeovers;
      hub_.audit(Audit::kBlade, "blade " + quoted(hello.source_name) + " taken over by " + described() +
                                    " from " + holder->described());
      holder->source_.reset();
      holder->finish(ByeReason::HandedOver, "another operator has taken the blade");
    }
    // The blade is free once the loop has ended the stroke that was.
    for (int i = 0; i < kTakeOverTries && !source && stage_ == Stage::kHandshake; ++i) {
      co_await pause(kRetry);
      source = hub_.input().open(hello.source_name, hello.blade);
    }
  }
  if (!source) {
    refuse(ErrorCode::BladeTaken,
           hub_.holder(hello.source_name)
               ? "the blade \"" + hello.source_name + "\" is held by another operator"
               : "no blade is free for \"" + hello.source_name + "\": all are held by other sources",
           sequence);
    co_return false;
  }
  source_ = std::move(source);
  source_name_ = hello.source_name;
  co_return true;
}

void Session::send_welcome(bool resumed) {
  const ServerFacts& facts = hub_.facts();
  protocol::Welcome welcome;
  welcome.session = session_name(feed().mirror().session(), view_, box_.has_value());
  welcome.role = role_;
  welcome.view = view_;
  welcome.resumed = resumed;
  welcome.revision = feed().mirror().revision();
  welcome.state_hash = feed().mirror().volume().state_hash();
  welcome.mesh = scratch_ ? scratch_->mesh : facts.mesh;
  welcome.blade_heel = source_ ? source_->heel() : facts.blade_heel;
  welcome.blade_tip = source_ ? source_->tip() : facts.blade_tip;
  welcome.source = source_ ? source_->number() : 0;
  welcome.engage_button = facts.engage_button;
  welcome.max_speed_m_s = facts.max_speed_m_s;
  welcome.frame_rate_hz = facts.frame_rate_hz;
  welcome.max_message_bytes = static_cast<std::uint32_t>(accepted_bytes(role_));
  welcome.server_name = "incised";
  welcome.server_version = INCISE_VERSION;
  welcome.server_monotonic_ns = monotonic_ns();
  welcome.server_unix_ns = unix_ns();
  welcome.policy = facts.policy;
  welcome.recording = hub_.recording().state;
  push_control(make_frame(std::move(welcome)));
}

void Session::live_restarted() {
  if (!scratch_) restart();
}

void Session::restart() {
  if (stage_ != Stage::kOpen) return;
  drop_state();
  snapshot_.reset();
  resync_again_ = false;
  send_welcome(false);
  request_snapshot(SnapshotCause::Reset);
}

// ---- What an open session takes ----

asio::awaitable<void> Session::on_poses(const protocol::PoseBatch& batch, std::uint64_t sequence) {
  if (!source_) {
    if (!within_rate()) {
      refuse(ErrorCode::RateExceeded, "poses from who is no operator", sequence);
    } else {
      complain(ErrorCode::Forbidden, "PoseBatch: only operators send poses", sequence);
    }
    co_return;
  }
  if (last_received_ns_ - rate_window_ns_ >= 1'000'000'000) {
    rate_window_ns_ = last_received_ns_;
    rate_count_ = rate_pose_messages_ = 0;
  }
  if (++rate_pose_messages_ > kMaxPoseMessagesPerSecond) {
    // Not an error: the peer's own send buffer fills, and it waits.
    co_await pause(milliseconds(1 + (1'000'000'000 - (last_received_ns_ - rate_window_ns_)) / 1'000'000));
  }
  const std::int64_t arrival_ns = last_received_ns_;
  std::span<const protocol::PoseSample> poses = batch.poses;
  std::vector<protocol::PoseSample> held;  // with the button that the message stands for
  if (engaged_ && hub_.facts().engage_button >= 0) {
    held.assign(poses.begin(), poses.end());
    for (protocol::PoseSample& pose : held) pose.buttons |= 1u << hub_.facts().engage_button;
    poses = held;
  }
  while (!poses.empty() && source_) {
    poses = poses.subspan(source_->enqueue(poses, arrival_ns));
    // The queue is full: nothing is read from the peer until the loop has made room.
    if (!poses.empty()) co_await pause(kRetry);
  }
  offered_ += batch.poses.size();
  unsettled_.push_back({sequence, offered_});
}

asio::awaitable<void> Session::on_stroke(const protocol::StrokeControl& control, std::uint64_t sequence) {
  if (!source_) {
    complain(ErrorCode::Forbidden, "StrokeControl: only operators have a blade", sequence);
    co_return;
  }
  switch (control.action) {
    case protocol::StrokeAction::Engage:
      engaged_ = true;
      break;
    case protocol::StrokeAction::End:
      engaged_ = false;
      while (source_ && !source_->end_stroke(last_received_ns_)) co_await pause(kRetry);
      break;
    case protocol::StrokeAction::HandOver:
      ++hub_.counters().handovers;
      hub_.audit(Audit::kBlade, "blade " + quoted(source_name_) + " handed over by " + described());
      source_.reset();
      finish(ByeReason::HandedOver, "the blade is free");
      break;
  }
}

void Session::on_positions(const protocol::Positions& positions, std::uint64_t sequence) {
  const Mirror& mirror = hub_.live().mirror();
  const std::size_t count = (positions.f32.size() + positions.f64.size()) / 3;
  const std::uint64_t end = positions.ids.empty() ? std::uint64_t{positions.first} + count
                                                  : positions.ids.back() + std::uint64_t{1};
  if (role_ != Role::Simulator) {
    complain(ErrorCode::Forbidden, "Positions: only simulators send them", sequence);
  } else if (count == 0 || end > mirror.volume().vertex_count() || positions.revision > mirror.revision()) {
    complain(ErrorCode::BadRequest,
             "Positions of " + std::to_string(count) + " vertices below " + std::to_string(end) +
                 " at revision " + std::to_string(positions.revision) + "; accepted are one or more below " +
                 std::to_string(mirror.volume().vertex_count()) + ", at a revision up to " +
                 std::to_string(mirror.revision()),
             sequence);
  } else if (!positions_ && !(positions_ = hub_.input().open_positions())) {
    complain(ErrorCode::NotAvailable, "Positions: another simulator sets them", sequence);
  } else {
    positions_->offer(positions, last_received_ns_);
  }
}

void Session::report_deformation(const PublishedDelta& step) {
  if (stage_ != Stage::kOpen || !positions_) return;
  const core::Deformation& d = step.delta.deformation;
  protocol::PositionsReport report;
  report.frame = d.frame;
  report.revision = step.delta.revision;
  report.moved = d.moved;
  report.passed_over = d.passed_over;
  report.held = d.held;
  report.taken = ++positions_taken_;
  report.skipped = positions_->skipped();
  push_control(make_frame(report));
}

void Session::on_subscribe(const protocol::Subscribe& subscribe) {
  const std::optional<protocol::Box> box = box_;
  const View view = std::exchange(view_, subscribe.view);
  box_ = subscribe.box;
  max_rate_hz_ = subscribe.max_rate_hz;
  next_due_ns_ = 0;
  if (view == view_ && box == box_) {
    advance();
    return;
  }
  drop_state();
  snapshot_.reset();
  resync_again_ = false;
  ++snapshot_request_;  // one of the other view that is on its way is not for us
  snapshot_wanted_ = false;
  request_snapshot(SnapshotCause::Subscribe);
}

void Session::on_resync() {
  // One whole state at a time, however often it is asked for.
  if (snapshot_wanted_ || snapshot_) {
    resync_again_ = snapshot_ != nullptr;
    return;
  }
  drop_state();
  request_snapshot(SnapshotCause::Resync);
}

void Session::on_reset(std::uint64_t sequence) {
  if (role_ != Role::Admin) {
    complain(ErrorCode::Forbidden, "Reset: only an admin may", sequence);
  } else if (!hub_.input().reset()) {
    complain(ErrorCode::NotAvailable, "Reset: this server does not offer it", sequence);
  } else {
    ++hub_.counters().resets;
    hub_.audit(Audit::kReset, "the mesh is reset by " + described());
  }
}

// ---- Replay ----

Feed& Session::feed() const {
  return scratch_ ? scratch_->feed : hub_.live();
}

void Session::on_replay(const protocol::ReplayControl& control, std::uint64_t sequence) {
  using protocol::ReplayAction;
  ReplayLibrary* const library = hub_.library();
  if (role_ != Role::Viewer && role_ != Role::Admin) {
    complain(ErrorCode::Forbidden, "ReplayControl: only viewers and admins may", sequence);
  } else if (!library) {
    complain(ErrorCode::NotAvailable, "ReplayControl: this server offers no captures", sequence);
  } else if (control.action == ReplayAction::Open) {
    end_replay();
    const std::uint64_t number = ++replay_number_;
    player_ = library->open(control.capture, replay_events(number, sequence));
    if (!player_) {
      complain(ErrorCode::BadRequest,
               "there is no capture \"" + control.capture.substr(0, 256) +
                   "\", or too many are being replayed; GET /captures lists them",
               sequence);
    }
  } else if (!player_) {
    complain(ErrorCode::BadState, "ReplayControl: no capture is open", sequence);
  } else if (control.action == ReplayAction::Close) {
    end_replay();
    push_control(make_frame(protocol::ReplayState{}));
  } else {
    player_->control(control);
  }
}

// What the player says on its thread is done on this one, while it is still that player's turn.
ReplayEvents Session::replay_events(std::uint64_t number, std::uint64_t sequence) {
  const auto post = [&io = hub_.io(), weak = weak_from_this(), number](auto what) {
    asio::post(io, [weak, number, what = std::move(what)]() mutable {
      const auto self = weak.lock();
      if (self && self->player_ && self->replay_number_ == number && self->stage_ == Stage::kOpen)
        what(*self);
    });
  };
  ReplayEvents events;
  events.restarted = [post](protocol::MeshFacts mesh, std::shared_ptr<const InitialState> initial) {
    post([mesh = std::move(mesh), initial = std::move(initial)](Session& self) {
      if (!self.scratch_) {
        self.scratch_ = std::make_unique<Scratch>(self.hub_.io(), self.hub_.config().ring_bytes);
      }
      self.scratch_->mesh = mesh;
      self.scratch_->feed.reset(initial);
      self.restart();
    });
  };
  events.delta = [post](std::shared_ptr<const PublishedDelta> delta) {
    post([delta = std::move(delta)](Session& self) {
      self.scratch_->feed.apply(delta);
      self.advance();
    });
  };
  events.state = [post](protocol::ReplayState state) {
    post([state = std::move(state)](Session& self) { self.push_control(make_frame(state)); });
  };
  events.failed = [post, sequence](std::string why) {
    post([why = std::move(why), sequence](Session& self) {
      self.complain(ErrorCode::NotAvailable, why.substr(0, protocol::kMaxTextBytes), sequence);
      self.end_replay();
      self.push_control(make_frame(protocol::ReplayState{}));
    });
  };
  return events;
}

void Session::end_replay() {
  player_.reset();
  if (!scratch_) return;
  scratch_.reset();
  restart();
}

void Session::report_poses() {
  const PoseTotals totals = source_->totals();
  while (!unsettled_.empty() && unsettled_.front().offered <= totals.settled()) {
    through_sequence_ = unsettled_.front().sequence;
    unsettled_.pop_front();
  }
  protocol::PoseReport report;
  report.through_sequence = through_sequence_;
  report.accepted = totals.accepted;
  report.not_finite = totals.not_finite;
  report.not_unit = totals.not_unit;
  report.time_not_rising = totals.time_not_rising;
  report.queue_full = totals.queue_full;
  report.too_fast = totals.too_fast;
  report.last_source_ns = totals.last_source_ns;
  report.backlog_segments = totals.backlog_segments;
  report.recorded = totals.recorded;
  report.recorded_source_ns = totals.recorded_source_ns;
  report.recording = hub_.recording().state;
  const auto same = [](const protocol::PoseReport& a, const protocol::PoseReport& b) {
    return a.through_sequence == b.through_sequence && a.accepted == b.accepted &&
           a.not_finite == b.not_finite && a.not_unit == b.not_unit &&
           a.time_not_rising == b.time_not_rising && a.queue_full == b.queue_full &&
           a.backlog_segments == b.backlog_segments && a.recorded == b.recorded && a.recording == b.recording;
  };
  if (same(report, last_report_)) return;
  last_report_ = report;
  push_control(make_frame(report));
}

void Session::warn_not_recorded() {
  if (stage_ != Stage::kOpen || !source_) return;
  complain(
      ErrorCode::NotRecorded,
      ("poses are cut, but not recorded: " + hub_.recording().trouble).substr(0, protocol::kMaxTextBytes), 0);
}

void Session::tick(std::int64_t now_ns) {
  const StreamConfig& config = hub_.config();
  if (stage_ == Stage::kOpen && write_began_ns_ != 0 &&
      now_ns - write_began_ns_ > to_ns(config.write_timeout_s)) {
    finish(ByeReason::TooSlow,
           "nothing was read for " + std::to_string((now_ns - write_began_ns_) / 1'000'000'000) + " s");
    return;
  }
  switch (stage_) {
    case Stage::kHandshake:
      if (now_ns - opened_ns_ > to_ns(config.handshake_timeout_s)) {
        finish(ByeReason::HandshakeTimeout, "no Hello in time");
      }
      break;
    case Stage::kOpen: {
      const std::int64_t silent = now_ns - last_received_ns_;
      if (silent > to_ns(config.idle_timeout_s)) {
        finish(ByeReason::Idle, "nothing came for " + std::to_string(silent / 1'000'000'000) + " s");
        break;
      }
      if (silent > to_ns(config.idle_timeout_s) / 3 &&
          now_ns - last_ping_ns_ > to_ns(config.idle_timeout_s) / 3) {
        last_ping_ns_ = now_ns;
        push_control(make_frame(protocol::Ping{static_cast<std::uint64_t>(now_ns), now_ns}));
      }
      if (source_ && now_ns - last_report_ns_ >= to_ns(1 / config.max_report_rate_hz)) {
        last_report_ns_ = now_ns;
        report_poses();
      }
      break;
    }
    case Stage::kClosing:
      if (now_ns - closing_since_ns_ > (write_began_ns_ != 0 ? kLongLinger_ns : kLinger_ns)) close();
      break;
    case Stage::kClosed:
      break;
  }
}

// ---- Ending ----

void Session::refuse(ErrorCode code, const std::string& text, std::uint64_t sequence) {
  if (stage_ == Stage::kClosing || stage_ == Stage::kClosed) return;
  if (stage_ == Stage::kHandshake) ++hub_.counters().refused;
  push_control(make_frame(protocol::Error{code, text.substr(0, protocol::kMaxTextBytes), true, sequence}));
  finish(ByeReason::Refused, "");
}

void Session::complain(ErrorCode code, const std::string& text, std::uint64_t sequence) {
  push_control(make_frame(protocol::Error{code, text, false, sequence}));
}

void Session::finish(ByeReason reason, const std::string& text) {
  if (stage_ == Stage::kClosing || stage_ == Stage::kClosed) return;
  if (reason == ByeReason::TooSlow) {
    ++hub_.counters().slow_disconnects;
    control_.clear();
    control_bytes_ = writing_control_;
  }
  // On a server that stops, what it published still goes out.
  if (reason != ByeReason::ServerStops) drop_state();
  snapshot_.reset();
  source_.reset();
  positions_.reset();
  player_.reset();
  set_part(nullptr);
  stage_ = Stage::kClosing;
  closing_since_ns_ = monotonic_ns();
  ticket_.leave();
  if (write_began_ns_ != 0) hub_.linger(shared_from_this());
  state_.push_back(make_frame(protocol::Bye{reason, text}));  // behind all else
  state_bytes_ += state_.back()->tcp().size();
  write();
}

void Session::close() {
  if (stage_ == Stage::kClosed) return;
  stage_ = Stage::kClosed;
  source_.reset();
  positions_.reset();
  player_.reset();
  snapshot_.reset();
  set_part(nullptr);
  rate_timer_.cancel();
  transport_->close();
}

// ---- Writing ----

void Session::send(SharedFrame frame) {
  if (stage_ == Stage::kOpen) push_control(std::move(frame));
}

void Session::send_force(const protocol::Force& force) {
  if (stage_ != Stage::kOpen || !source_ || source_->number() != force.source) return;
  force_ = force;
  write();
}

void Session::send_blades(const std::vector<SharedFrame>& frames, std::int64_t now_ns) {
  if (!wants_blades() || now_ns < blades_due_ns_ || control_bytes_ > kMaxWaitingBladeBytes) return;
  blades_due_ns_ = now_ns + to_ns(0.9 / static_cast<double>(blade_rate_hz_));
  for (const SharedFrame& frame : frames) push_control(frame);
}

void Session::push_control(SharedFrame frame) {
  if (stage_ == Stage::kClosing || stage_ == Stage::kClosed) return;
  control_bytes_ += frame->tcp().size();
  control_.push_back(std::move(frame));
  if (control_bytes_ > kMaxControlBytes) {
    finish(ByeReason::TooSlow, "answers and statistics were not read");
    return;
  }
  write();
}

void Session::push_state(SharedFrame frame) {
  state_bytes_ += frame->tcp().size();
  state_.push_back(std::move(frame));
  write();
}

void Session::drop_state() {
  state_.clear();
  state_bytes_ = writing_state_;
  behind_ = false;
}

void Session::write() {
  if (!writing_.empty() || stage_ == Stage::kClosed) return;
  std::size_t bytes = 0;
  const auto take = [&](std::deque<SharedFrame>& from, std::size_t& counted) {
    while (!from.empty() && writing_.size() < kMaxWriteFrames && bytes < kMaxWriteBytes) {
      bytes += from.front()->tcp().size();
      counted += from.front()->tcp().size();
      writing_.push_back(std::move(from.front()));
      from.pop_front();
    }
  };
  if (force_ && stage_ == Stage::kOpen) {
    writing_.push_back(make_frame(*std::exchange(force_, std::nullopt)));
    bytes += writing_.back()->tcp().size();
    control_bytes_ += bytes;
    writing_control_ += bytes;
  }
  take(control_, writing_control_);
  take(state_, writing_state_);
  if (writing_.empty()) return;
  write_began_ns_ = monotonic_ns();
  transport_->write(
      writing_, [self = shared_from_this()](boost::system::error_code error) { self->on_written(error); });
}

void Session::on_written(boost::system::error_code error) {
  hub_.counters().bytes_out += writing_control_ + writing_state_;
  control_bytes_ -= writing_control_;
  state_bytes_ -= writing_state_;
  writing_control_ = writing_state_ = 0;
  writing_.clear();
  write_began_ns_ = 0;
  if (error) {
    close();
    return;
  }
  if (stage_ == Stage::kClosing && control_.empty() && state_.empty()) {
    closing_since_ns_ = monotonic_ns();
    transport_->shut_down(shared_from_this());
    return;
  }
  write();
  advance();
}

// ---- State ----

void Session::request_snapshot(SnapshotCause cause) {
  if (view_ == View::None || snapshot_wanted_ || stage_ != Stage::kOpen) return;
  if (cause == SnapshotCause::TooSlow) {
    if (++slow_snapshots_ > hub_.config().max_slow_snapshots) {
      finish(ByeReason::TooSlow,
             std::to_string(slow_snapshots_ - 1) + " snapshots in a row, and never caught up");
      return;
    }
    ++hub_.counters().slow_snapshots;
  }
  snapshot_wanted_ = true;
  snapshot_cause_ = cause;
  const std::uint64_t request = ++snapshot_request_;
  ++hub_.counters().snapshots;
  feed().request_snapshot(view_, box_,
                          [weak = weak_from_this(), request](std::shared_ptr<const Snapshot> snapshot) {
                            if (const auto self = weak.lock())
                              self->on_snapshot(std::move(snapshot), request);
                          });
}

void Session::on_snapshot(std::shared_ptr<const Snapshot> snapshot, std::uint64_t request) {
  if (request != snapshot_request_ || !snapshot_wanted_ || stage_ != Stage::kOpen) return;
  snapshot_wanted_ = false;
  if (snapshot->session != feed().mirror().session()) {
    request_snapshot(snapshot_cause_);  // of before a reset
    return;
  }
  if (snapshot->part) {
    const std::size_t others = hub_.counters().part_bytes - part_bytes_;
    if (others + snapshot->part->bytes() > hub_.config().max_part_bytes) {
      refuse_box("has no memory for more of them", snapshot_cause_);
      return;
    }
    if (!hub_.box_turns().has_room()) {
      refuse_box("has no time for more of them", snapshot_cause_);
      return;
    }
  }
  snapshot_ = std::move(snapshot);
  next_chunk_ = 0;
  protocol::SnapshotBegin begin = snapshot_->begin;
  begin.cause = snapshot_cause_;
  push_state(make_frame(begin));
  advance();
}

void Session::feed_snapshot() {
  while (next_chunk_ < snapshot_->chunks.size()) {
    if (state_bytes_ > hub_.config().outbox_bytes) return;
    push_state(snapshot_->chunks[next_chunk_++]);
  }
  push_state(snapshot_->end);
  revision_ = snapshot_->begin.revision;
  set_part(snapshot_->part);
  snapshot_.reset();
  if (std::exchange(resync_again_, false)) request_snapshot(SnapshotCause::Resync);
}

void Session::set_part(std::shared_ptr<BoxPart> part) {
  part_ = std::move(part);
  const std::size_t bytes = part_ ? part_->bytes() : 0;
  hub_.counters().part_bytes += bytes - part_bytes_;
  part_bytes_ = bytes;
}

void Session::refuse_box(const std::string& why, SnapshotCause cause) {
  ++hub_.counters().boxes_refused;
  complain(ErrorCode::NotAvailable,
           "box: the server " + why +
               "; everything is sent. Subscribe again later, with a smaller box or a max_rate_hz",
           0);
  box_.reset();
  set_part(nullptr);
  request_snapshot(cause);
}

void Session::lose_box() {
  if (stage_ != Stage::kOpen || !box_ || snapshot_wanted_ || snapshot_) return;
  drop_state();
  refuse_box("has no time for yours", SnapshotCause::Subscribe);
}

bool Session::wants_box_turn() const {
  return stage_ == Stage::kOpen && box_ && part_ && !snapshot_wanted_ && !snapshot_ &&
         revision_ != feed().mirror().revision();
}

bool Session::take_box_turn() {
  box_turn_asked_ = false;
  const std::uint64_t head = feed().mirror().revision();
  const SharedFrame frame = feed().part_delta(*part_);
  set_part(part_);
  if (!frame) {
    request_snapshot(SnapshotCause::TooSlow);
    return false;
  }
  if (head - revision_ > 1) {
    ++hub_.counters().coalesced;
    ++hub_.counters().box_coalesced;
  }
  revision_ = head;
  push_state(frame);
  return true;
}

void Session::advance() {
  if (stage_ != Stage::kOpen || view_ == View::None || snapshot_wanted_) return;
  if (snapshot_) {
    feed_snapshot();
    if (snapshot_ || snapshot_wanted_) return;
  }
  const std::size_t limit = hub_.config().outbox_bytes;
  if (state_bytes_ > limit) behind_ = true;
  if (behind_ && state_bytes_ > limit / 2) return;
  behind_ = false;
  const std::uint64_t head = feed().mirror().revision();
  if (revision_ == head) {
    if (state_bytes_ == 0) slow_snapshots_ = 0;
    return;
  }
  if (max_rate_hz_ > 0) {
    const std::int64_t now = monotonic_ns();
    if (now < next_due_ns_) {
      if (std::exchange(rate_timer_armed_, true)) return;
      rate_timer_.expires_after(std::chrono::nanoseconds(next_due_ns_ - now));
      rate_timer_.async_wait([weak = weak_from_this()](boost::system::error_code) {
        const auto self = weak.lock();
        if (!self) return;
        self->rate_timer_armed_ = false;
        self->advance();
      });
      return;
    }
    next_due_ns_ = now + to_ns(1 / static_cast<double>(max_rate_hz_));
  }
  if (box_) {
    if (!std::exchange(box_turn_asked_, true)) hub_.box_turns().ask(shared_from_this());
    return;
  }
  if (!feed().ring().covers(revision_, head)) {
    request_snapshot(SnapshotCause::TooSlow);
    return;
  }
  // One delta for each revision where the peer did not ask for fewer and there is room for them; else one for
  // all.
  const auto frame_of = [&](std::uint64_t revision) {
    const EncodedStep& step = feed().ring().step(revision);
    return view_ == View::Surface ? step.surface : step.volume;
  };
  std::size_t missing = 0;
  for (std::uint64_t r = revision_ + 1; r <= head && missing <= limit; ++r)
    missing += frame_of(r)->tcp().size();
  const bool one_by_one = head - revision_ == 1 || (max_rate_hz_ == 0 && state_bytes_ + missing <= limit);
  if (one_by_one) {
    while (revision_ < head && stage_ == Stage::kOpen) push_state(frame_of(++revision_));
    return;
  }
  const SharedFrame frame = feed().coalesced(view_, revision_);
  if (!frame) {
    request_snapshot(SnapshotCause::TooSlow);
    return;
  }
  ++hub_.counters().coalesced;
  revision_ = head;
  push_state(frame);
}

}  // namespace incise::stream
