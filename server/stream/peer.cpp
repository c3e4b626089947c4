#include "server/stream/peer.hpp"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <utility>
#include <variant>

#include "server/base/clock.hpp"
#include "server/stream/feed_listener.hpp"
#include "server/stream/pause.hpp"
#include "server/stream/quoted.hpp"

namespace incise::stream {
namespace {

using protocol::ByeReason;
using protocol::ErrorCode;
using protocol::Role;

constexpr std::size_t kMaxWaitingBladeBytes = 4096;  // older poses are of no use
constexpr std::size_t kMaxWaitingLoadBytes = 16384;
constexpr std::int64_t kLinger_ns = 1'000'000'000;  // for the peer to close after Bye
// For a peer that has not been reading, so that it still finds Bye behind the message that is on its way.
constexpr std::int64_t kLongLinger_ns = 60'000'000'000;

std::int64_t to_ns(double seconds) {
  return static_cast<std::int64_t>(seconds * 1e9);
}

std::string seconds_text(std::int64_t ns) {
  return std::to_string(ns / 1'000'000'000) + " s";
}

}  // namespace

Peer::Peer(PeerContext& context, PeerDirectory& others, std::unique_ptr<Transport> transport, Ticket ticket)
    : context_(context),
      others_(others),
      transport_(std::move(transport)),
      ticket_(std::move(ticket)),
      address_(transport_->peer()),
      rate_(context.config.max_messages_per_s),
      outbox_(*transport_, *this, *context.counters),
      replay_(context, outbox_, *this),
      follower_(context, outbox_),
      opened_ns_(monotonic_ns()),
      last_received_ns_(opened_ns_) {}

Peer::~Peer() = default;

std::string Peer::described() const {
  return quoted(client_name_) + " at " + address_;
}

std::string Peer::with_blade() const {
  return blade_.held() ? described() + ", blade " + quoted(blade_.source_name()) : described();
}

std::size_t Peer::accepted_bytes() const {
  if (stage_ == Stage::kHandshake) return protocol::kMaxHandshakeBytes;
  return role_ == Role::Simulator ? protocol::kMaxSimulatorBytes : protocol::kMaxClientBytes;
}

// ---- Reading ----

asio::awaitable<void> Peer::run() {
  const auto self = shared_from_this();
  others_.add(self);
  while (stage_ == Stage::kHandshake || stage_ == Stage::kOpen) {
    const bool go_on = co_await receive();
    if (!go_on) break;
  }
  release_blade("its connection was lost");
  positions_.release();
  if (stage_ == Stage::kClosing) co_await transport_->discard();
  close();
  others_.remove(self);
}

// False at the end of the connection.
asio::awaitable<bool> Peer::receive() {
  const Received received = co_await transport_->read();
  if (received.closed) co_return false;
  last_received_ns_ = monotonic_ns();
  if (ending()) co_return true;
  if (!received.error.empty()) {
    ++context_.counters->bad_messages;
    refuse({received.too_long ? ErrorCode::TooLong : ErrorCode::BadFrame, received.error});
    co_return true;
  }
  ++context_.counters->messages_in;
  context_.counters->bytes_in += received.body.size();
  protocol::DecodeResult decoded = protocol::decode(received.body, accepted_bytes());
  if (!decoded) {
    ++context_.counters->bad_messages;
    refuse({decoded.code, decoded.error});
    co_return true;
  }
  const bool poses = std::holds_alternative<protocol::PoseBatch>(decoded.message->body);
  const bool model = load_rate_hz_ > 0 && std::holds_alternative<protocol::BladeModel>(decoded.message->body);
  if (!poses && !(model ? model_rate_ : rate_).allow(last_received_ns_)) {
    refuse({ErrorCode::RateExceeded,
            "more than " + std::to_string(context_.config.max_messages_per_s) + " messages a second"},
           decoded.message->envelope.sequence);
    co_return true;
  }
  co_await dispatch(std::move(*decoded.message));
  co_return true;
}

asio::awaitable<void> Peer::dispatch(protocol::Message message) {
  const std::uint64_t sequence = message.envelope.sequence;
  const protocol::Body& body = message.body;
  if (stage_ == Stage::kHandshake) {
    if (const auto* hello = std::get_if<protocol::Hello>(&body)) {
      co_await on_hello(*hello, sequence);
    } else {
      refuse({ErrorCode::BadState, std::string(name_of(body)) + " before Hello"}, sequence);
    }
    co_return;
  }
  if (const auto* poses = std::get_if<protocol::PoseBatch>(&body)) {
    co_await on_poses(*poses, sequence);
  } else if (const auto* stroke = std::get_if<protocol::StrokeControl>(&body)) {
    co_await on_stroke(*stroke, sequence);
  } else if (const auto* ping = std::get_if<protocol::Ping>(&body)) {
    outbox_.send(make_frame(protocol::Pong{ping->nonce, ping->sent_ns, last_received_ns_}));
  } else if (std::holds_alternative<protocol::Pong>(body)) {
    // It has moved last_received_ns_, which is all it is for.
  } else if (const auto* subscribe = std::get_if<protocol::Subscribe>(&body)) {
    if (speaks(subscribe->view)) {
      follower_.resubscribe({subscribe->view, subscribe->box, subscribe->max_rate_hz, subscribe->fields});
      complain_of_fields(sequence);
    } else {
      outbox_.complain(ErrorCode::NotAvailable, "view Volume needs protocol version 2", sequence);
    }
  } else if (std::holds_alternative<protocol::Resync>(body)) {
    follower_.resync();
  } else if (std::holds_alternative<protocol::Reset>(body)) {
    on_reset(sequence);
  } else if (const auto* undo = std::get_if<protocol::Undo>(&body)) {
    on_undo(*undo, sequence);
  } else if (std::holds_alternative<protocol::Bye>(body)) {
    finish(ByeReason::Done, "");
  } else if (const auto* replay = std::get_if<protocol::ReplayControl>(&body)) {
    on_replay(*replay, sequence);
  } else if (const auto* positions = std::get_if<protocol::Positions>(&body)) {
    on_positions(*positions, sequence);
  } else if (const auto* values = std::get_if<protocol::FieldValues>(&body)) {
    on_field_values(*values, sequence);
  } else if (const auto* model = std::get_if<protocol::BladeModel>(&body)) {
    on_model(*model, sequence);
  } else {
    outbox_.complain(ErrorCode::BadState, std::string(name_of(body)) + " is not for a client to send now",
                     sequence);
  }
}

// ---- Messages of an open peer ----

asio::awaitable<void> Peer::on_poses(const protocol::PoseBatch& batch, std::uint64_t sequence) {
  if (!blade_.held()) {
    if (!rate_.allow(last_received_ns_)) {
      refuse({ErrorCode::RateExceeded, "poses from a peer that is not an operator"}, sequence);
    } else {
      outbox_.complain(ErrorCode::Forbidden, "PoseBatch: only operators send poses", sequence);
    }
    co_return;
  }
  const auto delay = rate_.delay_poses(last_received_ns_);
  if (delay.count() > 0) co_await pause(delay);
  co_await blade_.enqueue(batch, sequence, last_received_ns_, context_.facts.engage_button);
}

asio::awaitable<void> Peer::on_stroke(const protocol::StrokeControl& control, std::uint64_t sequence) {
  if (!blade_.held()) {
    outbox_.complain(ErrorCode::Forbidden, "StrokeControl: only operators have a blade", sequence);
    co_return;
  }
  switch (control.action) {
    case protocol::StrokeAction::Engage:
      blade_.engage();
      break;
    case protocol::StrokeAction::End:
      co_await blade_.end_stroke(last_received_ns_);
      break;
    case protocol::StrokeAction::HandOver:
      ++context_.counters->handovers;
      context_.audit(Audit::kBlade, ticket_.address().address(),
                     "blade " + quoted(blade_.source_name()) + " handed over by " + described());
      blade_.release();
      finish(ByeReason::HandedOver, "the blade is free");
      break;
  }
}

void Peer::on_positions(const protocol::Positions& positions, std::uint64_t sequence) {
  if (role_ != Role::Simulator) {
    outbox_.complain(ErrorCode::Forbidden, "Positions: only simulators send them", sequence);
    return;
  }
  const auto refusal = positions_.offer(positions, context_.live.mirror(), context_.input, last_received_ns_);
  if (refusal) outbox_.complain(refusal->code, refusal->text, sequence);
}

void Peer::on_field_values(const protocol::FieldValues& values, std::uint64_t sequence) {
  if (role_ != Role::Simulator && role_ != Role::Admin) {
    outbox_.complain(ErrorCode::Forbidden, "FieldValues: only simulators and admins send them", sequence);
    return;
  }
  if (const std::string why = context_.input.no_simulators(); !why.empty()) {
    outbox_.complain(ErrorCode::NotAvailable, "FieldValues: " + why, sequence);
    return;
  }
  if (const auto refusal = context_.live.set_field(values)) {
    outbox_.complain(refusal->code, "FieldValues: " + refusal->text, sequence);
  } else {
    others_.advance_all();
    if (FeedListener* listener = context_.providers.listener) listener->on_fields_set();
  }
}

void Peer::on_model(const protocol::BladeModel& model, std::uint64_t sequence) {
  if (role_ != Role::Simulator) {
    outbox_.complain(ErrorCode::Forbidden, "BladeModel: only simulators send them", sequence);
    return;
  }
  const std::string blade = "BladeModel of blade " + std::to_string(model.source);
  const bool known = std::any_of(sent_loads_.begin(), sent_loads_.end(),
                                 [&](const SentLoad& sent) { return sent.source == model.source; });
  if (!known || !context_.providers.use_model) {
    outbox_.complain(ErrorCode::BadRequest,
                     blade + ": no BladeLoad of it was sent to you; accepted are answers to these", sequence);
    return;
  }
  const std::string trouble = context_.providers.use_model(model);
  if (!trouble.empty()) outbox_.complain(ErrorCode::BadRequest, blade + ": " + trouble, sequence);
}

PeerInput::Later Peer::refuse_later(std::uint64_t sequence) {
  return [weak = weak_from_this(), &context = context_, sequence, address = ticket_.address().address(),
          who = described()](Refusal refusal) {
    asio::post(context.io, [weak, &context, sequence, address, who, refusal = std::move(refusal)] {
      context.audit(Audit::kReset, address,
                    "the reset that " + who + " asked for is not done: " + refusal.text);
      complain_to(weak, refusal, sequence);
    });
  };
}

void Peer::complain_to(const std::weak_ptr<Peer>& peer, const Refusal& refusal, std::uint64_t sequence) {
  const auto self = peer.lock();
  if (self && self->open())
    self->outbox_.complain(refusal.code, refusal.text.substr(0, protocol::kMaxTextBytes), sequence);
}

// Who asked may have gone by then: what was done is counted and logged all the same.
PeerInput::Answer Peer::answer_undo(std::uint64_t sequence) {
  return [weak = weak_from_this(), &context = context_, sequence, address = ticket_.address().address(),
          who = with_blade()](std::optional<Refusal> refusal) {
    asio::post(context.io, [weak, &context, sequence, address, who, refusal = std::move(refusal)] {
      if (refusal) {
        context.audit(Audit::kReset, address,
                      "the undo that " + who + " asked for is not done: " + refusal->text);
        complain_to(weak, *refusal, sequence);
      } else {
        ++context.counters->undos;
        context.audit(Audit::kReset, address, "the last stroke is undone for " + who);
      }
    });
  };
}

void Peer::on_reset(std::uint64_t sequence) {
  if (role_ != Role::Admin) {
    outbox_.complain(ErrorCode::Forbidden, "Reset: only an admin may", sequence);
  } else if (!context_.input.reset(refuse_later(sequence))) {
    outbox_.complain(ErrorCode::NotAvailable, "Reset: this server does not offer it", sequence);
  } else {
    ++context_.counters->resets;
    context_.reset_by = client_name_;
    context_.audit(Audit::kReset, ticket_.address().address(),
                   "a reset of the mesh is asked for by " + described());
  }
}

void Peer::on_undo(const protocol::Undo& undo, std::uint64_t sequence) {
  if (role_ != Role::Admin && !blade_.held()) {
    outbox_.complain(ErrorCode::Forbidden, "Undo: only operators and admins may", sequence);
    return;
  }
  UndoRequest request{std::nullopt, undo.others, client_name_};
  if (role_ != Role::Admin) {
    request.source = blade_.input()->number();
    request.by = blade_.source_name();
  }
  if (const std::string refusal = context_.input.undo(request, answer_undo(sequence)); !refusal.empty()) {
    outbox_.complain(ErrorCode::NotAvailable, "Undo: " + refusal, sequence);
  } else {
    context_.audit(Audit::kReset, ticket_.address().address(), "an undo is asked for by " + with_blade());
  }
}

void Peer::on_replay(const protocol::ReplayControl& control, std::uint64_t sequence) {
  if (role_ != Role::Viewer && role_ != Role::Admin) {
    outbox_.complain(ErrorCode::Forbidden, "ReplayControl: only viewers and admins may", sequence);
  } else {
    replay_.control(control, sequence);
  }
}

// ---- What is sent to it ----

void Peer::on_live_reset(bool same_ids) {
  if (replay_.feed()) return;
  if (!same_ids) {
    on_state_replaced();
    return;
  }
  follower_.switch_to(context_.live);
  if (open()) follower_.send_snapshot(protocol::SnapshotCause::Resync);
}

void Peer::on_state_replaced() {
  follower_.switch_to(replay_.feed() ? *replay_.feed() : context_.live);
  if (!open()) return;
  send_welcome(false);
  follower_.send_snapshot(protocol::SnapshotCause::Reset);
}

void Peer::send(SharedFrame frame) {
  if (open()) outbox_.send(std::move(frame));
}

void Peer::send_force(const protocol::Force& force) {
  if (open() && blade_.held() && blade_.input()->number() == force.source) outbox_.send_force(force);
}

void Peer::report_deformation(const PublishedDelta& step) {
  if (!open()) return;
  if (const auto report = positions_.report(step)) outbox_.send(make_frame(*report));
}

void Peer::send_blades(const std::vector<SharedFrame>& frames, std::int64_t now_ns) {
  if (!wants_blades() || now_ns < blades_due_ns_ || outbox_.control_bytes() > kMaxWaitingBladeBytes) return;
  blades_due_ns_ = now_ns + to_ns(0.9 / static_cast<double>(blade_rate_hz_));
  for (const SharedFrame& frame : frames) outbox_.send(frame);
}

void Peer::send_loads(std::span<const protocol::BladeLoad> loads, std::int64_t now_ns) {
  if (!wants_loads() || now_ns < loads_due_ns_ || outbox_.control_bytes() > kMaxWaitingLoadBytes) return;
  bool any = false;
  for (const protocol::BladeLoad& newest : loads) {
    auto sent = std::find_if(sent_loads_.begin(), sent_loads_.end(),
                             [&](const SentLoad& other) { return other.source == newest.source; });
    if (sent == sent_loads_.end()) sent = sent_loads_.insert(sent, {newest.source, newest.number - 1, 0});
    if (newest.number == sent->number) continue;
    sent->skipped += newest.number - sent->number - 1;
    sent->number = newest.number;
    protocol::BladeLoad load = newest;
    load.skipped = sent->skipped;
    outbox_.send(make_frame(load));
    any = true;
  }
  if (any) loads_due_ns_ = now_ns + to_ns(0.9 / static_cast<double>(load_rate_hz_));
}

void Peer::warn_not_recorded() {
  if (!open() || !blade_.held()) return;
  const std::string text = "poses are cut, but not recorded: " + context_.recording.trouble;
  outbox_.complain(ErrorCode::NotRecorded, text.substr(0, protocol::kMaxTextBytes), 0);
}

// ---- Deadlines ----

void Peer::tick(std::int64_t now_ns) {
  switch (stage_) {
    case Stage::kHandshake:
      tick_handshake(now_ns);
      break;
    case Stage::kOpen:
      tick_open(now_ns);
      break;
    case Stage::kClosing:
      if (now_ns - closing_since_ns_ > (outbox_.write_began_ns() != 0 ? kLongLinger_ns : kLinger_ns)) close();
      break;
    case Stage::kClosed:
      break;
  }
}

void Peer::tick_handshake(std::int64_t now_ns) {
  // A client that waits as long as we do began before us: it has to hear why before it gives up.
  constexpr double kShareForOrigin = 0.8;
  const double share = waits_for_origin_ ? kShareForOrigin : 1;
  if (now_ns - opened_ns_ <= to_ns(share * context_.config.handshake_timeout_s)) return;
  std::string why = "no Hello in time";
  if (waits_for_origin_) {
    why = "the server that has the blade does not answer";
    const auto& trouble = context_.providers.trouble;
    if (const std::string text = trouble ? trouble() : ""; !text.empty()) why += ": " + text;
  }
  finish(ByeReason::HandshakeTimeout, why.substr(0, protocol::kMaxTextBytes));
}

void Peer::tick_open(std::int64_t now_ns) {
  const StreamConfig& config = context_.config;
  const std::int64_t writing_ns = outbox_.write_began_ns() != 0 ? now_ns - outbox_.write_began_ns() : 0;
  if (writing_ns > to_ns(config.write_timeout_s)) {
    on_too_slow("nothing was read for " + seconds_text(writing_ns));
    return;
  }
  const std::int64_t silent_ns = now_ns - last_received_ns_, idle_ns = to_ns(config.idle_timeout_s);
  if (silent_ns > idle_ns) {
    finish(ByeReason::Idle, "nothing came for " + seconds_text(silent_ns));
    return;
  }
  if (silent_ns > idle_ns / 3 && now_ns - last_ping_ns_ > idle_ns / 3) {
    last_ping_ns_ = now_ns;
    outbox_.send(make_frame(protocol::Ping{static_cast<std::uint64_t>(now_ns), now_ns}));
  }
  if (blade_.held()) {
    if (const auto end = blade_.input()->ended()) {
      end_with_blade(*end);
      return;
    }
  }
  if (blade_.held() && now_ns - last_report_ns_ >= to_ns(1 / config.max_report_rate_hz)) {
    last_report_ns_ = now_ns;
    if (const auto report = blade_.next_report(context_.recording.state)) outbox_.send(make_frame(*report));
  }
}

// ---- Ending ----

void Peer::end_with_blade(const BladeEnd& end) {
  if (end.code != ErrorCode::Unknown) {
    refuse({end.code, end.text});
  } else if (end.reason != ByeReason::Unknown) {
    finish(end.reason, end.text);
  } else {
    close();
  }
}

void Peer::refuse(const Refusal& refusal, std::uint64_t sequence) {
  if (ending()) return;
  if (stage_ == Stage::kHandshake) ++context_.counters->refused;
  const std::string text = refusal.text.substr(0, protocol::kMaxTextBytes);
  outbox_.send(make_frame(protocol::Error{refusal.code, text, true, sequence}));
  finish(ByeReason::Refused, "");
}

void Peer::on_too_slow(const std::string& what) {
  if (ending()) return;
  ++context_.counters->slow_disconnects;
  outbox_.drop_control();
  finish(ByeReason::TooSlow, what);
}

void Peer::finish(ByeReason reason, const std::string& text) {
  if (ending()) return;
  // When the server stops, what it has published still goes out.
  if (reason != ByeReason::ServerStops) outbox_.drop_state();
  release_parts(text.empty() ? "it has left" : text);
  stage_ = Stage::kClosing;
  closing_since_ns_ = monotonic_ns();
  ticket_.free_place();
  if (outbox_.write_began_ns() != 0) others_.linger(shared_from_this());
  outbox_.send_last(make_frame(protocol::Bye{reason, text}));
}

void Peer::release_blade(const std::string& why) {
  if (!blade_.held()) return;
  const std::string line = "blade " + quoted(blade_.source_name()) + " is free: " + described() + ": " + why;
  context_.audit(Audit::kBlade, ticket_.address().address(), line);
  blade_.release();
}

void Peer::release_parts(const std::string& why) {
  release_blade(why);
  positions_.release();
  replay_.stop();
  follower_.stop();
}

void Peer::on_last_written() {
  closing_since_ns_ = monotonic_ns();
  transport_->shut_down(shared_from_this());
}

void Peer::close() {
  if (stage_ == Stage::kClosed) return;
  stage_ = Stage::kClosed;
  release_parts("its connection was lost");
  outbox_.close();
  transport_->close();
}

}  // namespace incise::stream
