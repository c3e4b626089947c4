#include "server/wasm/local_server.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <sstream>
#include <variant>

#include "protocol/blade_name.hpp"
#include "protocol/framing.hpp"
#include "protocol/surface.hpp"
#include "server/replay/session_view.hpp"

namespace incise::wasm {

using protocol::ByeReason;
using protocol::ErrorCode;
using protocol::ReplayAction;
using protocol::Role;
using protocol::SnapshotCause;
using protocol::View;

namespace {

constexpr std::int64_t kSliceUnits = 2000;  // some 0.2 ms: between two looks at the clock
constexpr double kFrameRate_hz = 60;        // what the figures call a frame
constexpr double kMostBladeLengths =
    100;  // of the body's diagonal: a sweep's cost grows with the blade's length
constexpr std::size_t kMostArrivals = 4096;  // while a blade does not cut, its poses' times are of no use

}  // namespace

struct LocalServer::Peer {
  bool open = false;
  Role role = Role::Viewer;
  View view = View::None;
  // An operator's.
  std::optional<std::uint32_t> source;
  std::string source_name;
  core::Blade blade;
  bool engaged = false;  // by StrokeControl
  // A viewer's.
  std::unique_ptr<LocalReplay> replay;
  std::string wanted_capture;
  std::uint64_t wanted_by = 0;  // the message
};

LocalServer::LocalServer(BodyFile body, const protocol::CaptureHeader& header, Host& host)
    : body_(std::move(body)),
      config_(session_config(header.config_json, "the session")),
      host_(host),
      began_ns_(host.now_ns()) {
  begin_session();
  protocol::CaptureHeader own = header;
  own.session = epoch_;
  own.created_unix_ns = host_.unix_ns();
  own.software = "incise in a browser " + body_.welcome.server_version;
  recording_.emplace(own);
}

LocalServer::~LocalServer() = default;

void LocalServer::begin_session() {
  session_ = std::make_unique<core::CutSession>(body_.mesh, config_.cut);
  epoch_ = std::max<std::uint64_t>(1, host_.random());
  show_session();
  for (auto& times : arrivals_) times.clear();
}

void LocalServer::show_session() {
  stream::InitialState state = replay::initial_state(*session_, epoch_);
  state.origins = body_.origins;
  mirror_.reset(state);
}

// ------------------------------------------------------------------------------------------------ sending

void LocalServer::send(std::uint32_t peer, const protocol::Body& body) {
  host_.send(peer, protocol::encode(body, {0, host_.now_ns()}).body());
}

void LocalServer::complain(std::uint32_t peer, ErrorCode code, const std::string& text,
                           std::uint64_t sequence) {
  send(peer, protocol::Error{code, text.substr(0, protocol::kMaxTextBytes), false, sequence});
}

void LocalServer::refuse(std::uint32_t peer, ErrorCode code, const std::string& text,
                         std::uint64_t sequence) {
  send(peer, protocol::Error{code, text.substr(0, protocol::kMaxTextBytes), true, sequence});
  finish(peer, ByeReason::Refused, "");
}

void LocalServer::finish(std::uint32_t peer, ByeReason reason, const std::string& text) {
  send(peer, protocol::Bye{reason, text});
  host_.close(peer);
  closed(peer);
}

const stream::Mirror& LocalServer::mirror_of(const Peer& peer) const {
  return peer.replay ? peer.replay->mirror() : mirror_;
}

void LocalServer::send_welcome(std::uint32_t number, const Peer& peer) {
  const stream::Mirror& mirror = mirror_of(peer);
  protocol::Welcome welcome = body_.welcome;
  welcome.session = mirror.epoch() ^ (peer.view == View::Surface ? 0x9e3779b97f4a7c15 : 0);
  welcome.role = peer.role;
  welcome.view = peer.view;
  welcome.revision = mirror.revision();
  welcome.state_hash = mirror.volume().state_hash();
  if (peer.source) {
    welcome.blade_heel = replay::to_protocol(peer.blade.heel);
    welcome.blade_tip = replay::to_protocol(peer.blade.tip);
    welcome.source = *peer.source;
  }
  welcome.frame_rate_hz = kFrameRate_hz;
  welcome.max_message_bytes = protocol::kMaxClientBytes;
  welcome.server_name = "in this page, incise";
  welcome.server_monotonic_ns = host_.now_ns();
  welcome.server_unix_ns = host_.unix_ns();
  welcome.recording = recording_->state();
  if (!mirror.surface().finds_origins()) welcome.surface.reset();
  send(number, welcome);
}

void LocalServer::send_snapshot(std::uint32_t number, const Peer& peer, SnapshotCause cause) {
  const stream::Mirror& mirror = mirror_of(peer);
  const auto send_all = [&](auto writer, auto... hash) {
    protocol::SnapshotBegin begin = writer.begin();
    begin.tet_count = mirror.volume().live_tets();
    send(number, begin);
    while (writer.next()) send(number, writer.chunk());
    send(number, writer.end(hash...));
  };
  if (peer.view == View::Surface) {
    send_all(protocol::SurfaceSnapshotWriter(mirror.surface(), cause), mirror.volume().state_hash());
  } else if (peer.view == View::Volume) {
    send_all(protocol::SnapshotWriter(mirror.volume(), cause));
  }
}

void LocalServer::send_step(std::uint32_t number, const Peer& peer, const stream::Mirror::Applied& step,
                            const stream::Mirror& mirror) {
  if (!peer.open || peer.view == View::None || &mirror_of(peer) != &mirror) return;
  if (!step.step) return send_snapshot(number, peer, SnapshotCause::TooSlow);  // too long for one message
  host_.send(number, (peer.view == View::Surface ? step.step->surface : step.step->volume)->body());
}

// ------------------------------------------------------------------------------------------------ peers

void LocalServer::open(std::uint32_t peer) {
  peers_[peer] = Peer();
}

void LocalServer::closed(std::uint32_t peer) {
  const auto found = peers_.find(peer);
  if (found == peers_.end()) return;
  release_blade(found->second);
  peers_.erase(found);
}

void LocalServer::receive(std::uint32_t peer, std::span<const std::byte> message) {
  const auto found = peers_.find(peer);
  if (found == peers_.end()) return;
  const protocol::DecodeResult decoded = protocol::decode(message, protocol::kMaxClientBytes);
  if (!decoded) return refuse(peer, decoded.code, decoded.error, 0);
  dispatch(peer, found->second, *decoded.message);
}

void LocalServer::dispatch(std::uint32_t number, Peer& peer, const protocol::Message& message) {
  const std::uint64_t sequence = message.envelope.sequence;
  const protocol::Body& body = message.body;
  if (const auto* hello = std::get_if<protocol::Hello>(&body))
    return on_hello(number, peer, *hello, sequence);
  if (!peer.open) return refuse(number, ErrorCode::BadState, "a message before Hello", sequence);
  if (const auto* poses = std::get_if<protocol::PoseBatch>(&body)) {
    if (!peer.source)
      return complain(number, ErrorCode::Forbidden, "PoseBatch: only operators send poses", sequence);
    on_poses(peer, *poses);
  } else if (const auto* stroke = std::get_if<protocol::StrokeControl>(&body)) {
    on_stroke(number, peer, *stroke, sequence);
  } else if (const auto* ping = std::get_if<protocol::Ping>(&body)) {
    send(number, protocol::Pong{ping->nonce, ping->sent_ns, host_.now_ns()});
  } else if (const auto* subscribe = std::get_if<protocol::Subscribe>(&body)) {
    peer.view = subscribe->view;
    send_snapshot(number, peer, SnapshotCause::Subscribe);
  } else if (std::holds_alternative<protocol::Resync>(body)) {
    send_snapshot(number, peer, SnapshotCause::Resync);
  } else if (std::holds_alternative<protocol::Reset>(body)) {
    if (peer.role != Role::Admin)
      return complain(number, ErrorCode::Forbidden, "Reset: only an admin may", sequence);
    reset();
  } else if (std::holds_alternative<protocol::Undo>(body)) {
    if (peer.role != Role::Admin && !peer.source)
      return complain(number, ErrorCode::Forbidden, "Undo: only operators and admins may", sequence);
    undo(number, sequence);
  } else if (std::holds_alternative<protocol::Bye>(body)) {
    finish(number, ByeReason::Done, "");
  } else if (const auto* replay = std::get_if<protocol::ReplayControl>(&body)) {
    on_replay(number, peer, *replay, sequence);
  } else if (!std::holds_alternative<protocol::Pong>(body)) {
    complain(number, ErrorCode::BadState, "a page's session does not take such a message", sequence);
  }
}

void LocalServer::on_hello(std::uint32_t number, Peer& peer, const protocol::Hello& hello,
                           std::uint64_t sequence) {
  if (peer.open) return refuse(number, ErrorCode::BadState, "a second Hello", sequence);
  if (hello.protocol_version != protocol::kProtocolVersion) {
    return refuse(number, ErrorCode::BadVersion,
                  "protocol version " + std::to_string(hello.protocol_version) + ", accepted is " +
                      std::to_string(protocol::kProtocolVersion),
                  sequence);
  }
  if (hello.role == Role::Simulator)
    return refuse(number, ErrorCode::NotAvailable, "a page's session takes no simulator", sequence);
  if (hello.role == Role::Operator && !take_blade(number, peer, hello, sequence)) return;
  peer.open = true;
  peer.role = hello.role;
  peer.view = hello.view;
  send_welcome(number, peer);
  send_snapshot(number, peer, SnapshotCause::Join);
}

// ------------------------------------------------------------------------------------------------ blades

bool LocalServer::take_blade(std::uint32_t number, Peer& peer, const protocol::Hello& greeting,
                             std::uint64_t sequence) {
  protocol::Hello hello = greeting;
  if (hello.source_name.empty()) hello.source_name = protocol::kDefaultBladeName;
  const auto holder = std::find_if(peers_.begin(), peers_.end(), [&](const auto& entry) {
    return entry.second.source && entry.second.source_name == hello.source_name;
  });
  if (holder != peers_.end()) {
    if (!hello.take_over) {
      refuse(number, ErrorCode::BladeTaken,
             "the blade \"" + hello.source_name + "\" is held by another operator", sequence);
      return false;
    }
    finish(holder->first, ByeReason::HandedOver, "another operator has taken the blade");
  }
  std::uint32_t source = 0;
  const auto held = [&](std::uint32_t wanted) {
    return std::any_of(peers_.begin(), peers_.end(),
                       [&](const auto& entry) { return entry.second.source == wanted; });
  };
  while (source < core::kMaxSources && held(source)) ++source;
  if (source == core::kMaxSources) {
    refuse(number, ErrorCode::BladeTaken, "no blade is free: all are held by other operators", sequence);
    return false;
  }
  core::Blade blade = source < config_.blades.size() ? config_.blades[source] : config_.cut.blade;
  if (hello.blade) blade = replay::to_core(*hello.blade);
  const protocol::Box& box = body_.welcome.mesh.box;
  const double body_m = std::hypot(box.max.x - box.min.x, box.max.y - box.min.y, box.max.z - box.min.z);
  if (distance(blade.heel, blade.tip) > kMostBladeLengths * body_m) {
    refuse(number, ErrorCode::BadRequest, "the blade is longer than 100 times the body", sequence);
    return false;
  }
  peer.source = source;
  peer.source_name = hello.source_name;
  peer.blade = blade;
  session_->set_blade(source, blade);
  record(protocol::BladeRecord{
      source, host_.now_ns(), {replay::to_protocol(blade.heel), replay::to_protocol(blade.tip)}});
  return true;
}

void LocalServer::release_blade(Peer& peer) {
  if (!peer.source) return;
  session_->end_stroke(*peer.source);
  record(protocol::StrokeRecord{*peer.source, protocol::StrokeAction::End, 0, host_.now_ns()});
  peer.source.reset();
}

void LocalServer::on_poses(Peer& peer, const protocol::PoseBatch& batch) {
  const std::uint32_t source = *peer.source;
  const std::int64_t arrival_ns = host_.now_ns();
  const std::int32_t engage = replay::engage_button(config_.cut);
  for (protocol::PoseSample sample : batch.poses) {
    if (peer.engaged && engage >= 0) sample.buttons |= 1u << engage;
    record(protocol::PoseRecord{source, sample, arrival_ns});
    const bool stroking = session_->in_stroke(source);
    const std::uint64_t revision = session_->revision() + session_->backlog_batches();
    const core::PoseVerdict verdict = session_->push(source, replay::to_core(sample));
    const bool taken = core::accepted(verdict);
    if (session_->in_stroke(source) && (!stroking || verdict == core::PoseVerdict::kNewStroke))
      strokes_.push_back({{0, 0, source, sample.source_ns, arrival_ns, revision}});
    ++(taken ? poses_accepted_ : poses_rejected_);
    if (!taken) continue;
    arrivals_[source].emplace_back(sample.source_ns, arrival_ns);
    if (arrivals_[source].size() > kMostArrivals) arrivals_[source].pop_front();
  }
}

void LocalServer::on_stroke(std::uint32_t number, Peer& peer, const protocol::StrokeControl& control,
                            std::uint64_t sequence) {
  if (!peer.source)
    return complain(number, ErrorCode::Forbidden, "StrokeControl: only operators have a blade", sequence);
  peer.engaged = control.action == protocol::StrokeAction::Engage;
  if (control.action == protocol::StrokeAction::HandOver) {
    finish(number, ByeReason::HandedOver, "the blade is free");
  } else if (control.action == protocol::StrokeAction::End) {
    session_->end_stroke(*peer.source);
    record(protocol::StrokeRecord{*peer.source, control.action, control.source_ns, host_.now_ns()});
  }
}

void LocalServer::reset() {
  begin_session();
  strokes_.clear();
  record(protocol::ResetRecord{epoch_, host_.now_ns()});
  welcome_again();
}

// Cuts again what came before the stroke, as the recording has it.
void LocalServer::undo(std::uint32_t number, std::uint64_t sequence) {
  for (const auto& [other, peer] : peers_) {
    if (!peer.source || !session_->in_stroke(*peer.source)) continue;
    session_->end_stroke(*peer.source);
    record(protocol::StrokeRecord{*peer.source, protocol::StrokeAction::End, 0, host_.now_ns()});
  }
  commit_all();
  const auto last =
      std::find_if(strokes_.rbegin(), strokes_.rend(), [](const Stroke& s) { return s.has_cut; });
  if (last == strokes_.rend())
    return complain(number, ErrorCode::NotAvailable, "Undo: there is no stroke to undo", sequence);
  if (recording_->state() != protocol::Recording::On)
    return complain(number, ErrorCode::NotAvailable, "Undo: the recording has no more room", sequence);
  protocol::UndoRecord undo = last->undo;
  strokes_.erase(std::next(last).base(), strokes_.end());
  begin_session();
  undo.session = epoch_;
  undo.arrival_ns = host_.now_ns();
  record(undo);
  const std::vector<std::byte> bytes = recording_->capture();
  std::istringstream in(std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
  core::WorkBudget budget = core::WorkBudget::unlimited();
  for (const replay::MotionEvent& event : replay::read_capture(in, "the recording").events) {
    replay::apply(*session_, event, config_.cut.blade);
    while (session_->advance(budget, delta_.delta) == core::CutSession::Progress::kCommitted) {
    }
  }
  show_session();
  welcome_again();
}

void LocalServer::welcome_again() {
  const std::int64_t now_ns = host_.now_ns();
  for (const auto& [number, peer] : peers_) {
    if (!peer.source) continue;
    session_->set_blade(*peer.source, peer.blade);
    record(protocol::BladeRecord{
        *peer.source, now_ns, {replay::to_protocol(peer.blade.heel), replay::to_protocol(peer.blade.tip)}});
  }
  for (const auto& [number, peer] : peers_) {
    if (!peer.open || peer.replay) continue;
    send_welcome(number, peer);
    send_snapshot(number, peer, SnapshotCause::Reset);
  }
}

// ------------------------------------------------------------------------------------------------ replays

void LocalServer::on_replay(std::uint32_t number, Peer& peer, const protocol::ReplayControl& control,
                            std::uint64_t sequence) {
  if (control.action == ReplayAction::Open) {
    end_replay(number, peer);
    peer.wanted_capture = control.capture;
    peer.wanted_by = sequence;
    host_.fetch_capture(control.capture);
  } else if (!peer.replay) {
    complain(number, ErrorCode::BadState, "ReplayControl: no capture is open", sequence);
  } else if (control.action == ReplayAction::Close) {
    end_replay(number, peer);
    send(number, protocol::ReplayState{});
  } else {
    peer.replay->control(control, host_.now_ns());
    send(number, peer.replay->state());
  }
}

// For each viewer that waits for this capture; what() may throw.
template <class What>
void LocalServer::answer_wanted(const std::string& name, What what) {
  for (auto& [number, peer] : peers_) {
    if (peer.wanted_capture.empty() || peer.wanted_capture != name) continue;
    peer.wanted_capture.clear();
    try {
      what(number, peer);
    } catch (const std::exception& error) {
      complain(number, ErrorCode::NotAvailable, error.what(), peer.wanted_by);
      send(number, protocol::ReplayState{});
    }
  }
}

void LocalServer::offer_capture(const std::string& name, std::span<const std::byte> bytes) {
  answer_wanted(name, [&](std::uint32_t number, Peer& peer) { begin_replay(number, peer, name, bytes); });
}

void LocalServer::miss_capture(const std::string& name, const std::string& why) {
  answer_wanted(name, [&](std::uint32_t, Peer&) { throw std::runtime_error(why); });
}

void LocalServer::begin_replay(std::uint32_t number, Peer& peer, const std::string& name,
                               std::span<const std::byte> bytes) {
  std::istringstream in(std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
  replay::RecordedMotion motion = replay::read_capture(in, name);
  if (motion.header->mesh_content_hash != body_.welcome.mesh.content_hash)
    throw std::runtime_error(name + ": was recorded with another body than this page's");
  SessionConfig config = session_config(motion.header->config_json, name);
  LocalReplay::Events events;
  events.restarted = [this, number] {
    const Peer& owner = peers_.at(number);
    send_welcome(number, owner);
    send_snapshot(number, owner, SnapshotCause::Reset);
  };
  events.stepped = [this, number](const stream::Mirror::Applied& step) {
    const Peer& owner = peers_.at(number);
    send_step(number, owner, step, owner.replay->mirror());
  };
  peer.replay = std::make_unique<LocalReplay>(
      name, replay::Replay(body_.mesh, config.cut, std::move(config.blades), std::move(motion)),
      std::max<std::uint64_t>(1, host_.random()), body_.origins, std::move(events));
  send_welcome(number, peer);
  send_snapshot(number, peer, SnapshotCause::Reset);
  send(number, peer.replay->state(true));
}

void LocalServer::end_replay(std::uint32_t number, Peer& peer) {
  peer.wanted_capture.clear();
  if (!peer.replay) return;
  peer.replay.reset();
  send_welcome(number, peer);
  send_snapshot(number, peer, SnapshotCause::Reset);
}

// ------------------------------------------------------------------------------------------------ working

std::optional<std::int64_t> LocalServer::work(std::int64_t until_ns) {
  const std::int64_t begun_ns = host_.now_ns();
  std::int64_t now_ns = begun_ns;
  auto progress = core::CutSession::Progress::kSpent;
  do {
    core::WorkBudget budget{kSliceUnits};
    progress = session_->advance(budget, delta_.delta);
    if (progress == core::CutSession::Progress::kCommitted) commit();
    now_ns = host_.now_ns();
  } while (progress != core::CutSession::Progress::kIdle && now_ns < until_ns);
  std::optional<std::int64_t> due_ns;
  if (progress != core::CutSession::Progress::kIdle) due_ns = now_ns;
  for (auto& [number, peer] : peers_) {
    if (!peer.replay) continue;
    bool worked = false;
    while (peer.replay->work(now_ns)) {
      worked = true;
      now_ns = host_.now_ns();
      if (now_ns >= until_ns) break;
    }
    if (worked) send(number, peer.replay->state());
    if (const auto replay_due_ns = peer.replay->due_ns())
      due_ns = std::min(due_ns.value_or(INT64_MAX), *replay_due_ns);
  }
  busy_ns_ += now_ns - begun_ns;
  return due_ns;
}

void LocalServer::commit_all() {
  core::WorkBudget budget = core::WorkBudget::unlimited();
  while (session_->advance(budget, delta_.delta) == core::CutSession::Progress::kCommitted) commit();
}

void LocalServer::commit() {
  const core::Delta& d = delta_.delta;
  delta_.cut_ns = host_.now_ns();
  delta_.arrival_ns = delta_.drain_ns = arrival_of_batch();
  record(protocol::BatchMark{d.revision, d.state_hash, d.source, d.stroke, d.batch, d.stroke_ended, 0});
  if (d.has_cut() && d.stroke <= strokes_.size()) strokes_[d.stroke - 1].has_cut = true;
  const stream::Mirror::Applied step = mirror_.apply(delta_);
  for (const auto& [number, peer] : peers_) send_step(number, peer, step, mirror_);
}

// When the committed batch's last pose arrived.
std::int64_t LocalServer::arrival_of_batch() {
  const core::Delta& d = delta_.delta;
  auto& times = arrivals_[d.source];
  while (times.size() > 1 && times.front().first < d.to_t_ns) times.pop_front();
  return times.empty() ? delta_.cut_ns : times.front().second;
}

void LocalServer::tick() {
  const std::int64_t now_ns = host_.now_ns();
  const auto frames =
      static_cast<std::uint64_t>(static_cast<double>(now_ns - began_ns_) * 1e-9 * kFrameRate_hz);
  protocol::Stats stats;
  stats.revision = mirror_.revision();
  stats.live_tets = mirror_.volume().live_tets();
  stats.sessions = static_cast<std::uint32_t>(peers_.size());
  stats.backlog_segments = static_cast<std::uint32_t>(session_->backlog_segments());
  stats.frames = frames;
  stats.poses_accepted = poses_accepted_;
  stats.poses_rejected = poses_rejected_;
  stats.recording = recording_->state();
  stats.undoable = static_cast<std::uint32_t>(
      std::count_if(strokes_.begin(), strokes_.end(), [](const Stroke& s) { return s.has_cut; }));
  stats.json =
      "{\"stages_us\":{\"frame_work\":{\"sum\":" + std::to_string(busy_ns_ / 1000) +
      ",\"count\":" + std::to_string(frames) +
      "}},\"frames\":{\"rate_hz\":60},\"backlog\":{\"segments\":" + std::to_string(stats.backlog_segments) +
      ",\"work_ms\":0}}";
  for (const auto& [number, peer] : peers_) {
    if (peer.open) send(number, stats);
  }
}

// ------------------------------------------------------------------------------------------------ the recording

void LocalServer::record(const protocol::CaptureRecord& entry) {
  if (recording_->add(entry)) return;
  for (const auto& [number, peer] : peers_) {
    if (peer.source)
      complain(number, ErrorCode::NotRecorded,
               "poses are cut, but not recorded: the recording has reached 256 MB", 0);
  }
}

}  // namespace incise::wasm
