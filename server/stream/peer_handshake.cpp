// Peer, from Hello to Welcome.

#include <algorithm>
#include <cmath>

#include "protocol/blade_name.hpp"
#include "protocol/role_names.hpp"
#include "server/base/clock.hpp"
#include "server/stream/pause.hpp"
#include "server/stream/peer.hpp"
#include "server/stream/quoted.hpp"

namespace incise::stream {
namespace {

using protocol::ErrorCode;
using protocol::SnapshotCause;
using std::chrono::milliseconds;

constexpr int kTakeOverTries = 1000;  // of kQueueRetry each
constexpr int kLeavingTries = 100;    // likewise

double distance(const protocol::Vec3& a, const protocol::Vec3& b) {
  return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z);
}

// The cost of a sweep grows with the blade's length.
std::optional<Refusal> check_blade(const protocol::BladeEdge& blade, const protocol::Box& mesh) {
  const double length = distance(blade.heel, blade.tip), max = 100 * distance(mesh.min, mesh.max);
  if (length <= max) return std::nullopt;
  return Refusal{ErrorCode::BadRequest, "the blade is " + std::to_string(length) +
                                            " m long, accepted are up to " + std::to_string(max) +
                                            " m: 100 times the mesh"};
}

}  // namespace

asio::awaitable<void> Peer::on_hello(const protocol::Hello& hello, std::uint64_t sequence) {
  protocol_version_ = hello.protocol_version;
  if (!speaks(hello.view)) {
    const bool old = protocol_version_ == protocol::kOldProtocolVersion;
    refuse({ErrorCode::BadVersion, "protocol version " + std::to_string(protocol_version_) +
                                       (old ? " with view Volume" : "") + ", accepted is " +
                                       std::to_string(protocol::kProtocolVersion)},
           sequence);
    co_return;
  }
  client_name_ = hello.client_name;
  std::optional<Refusal> refusal = co_await check_token(hello);
  if (!refusal && !ticket_.take_place()) {
    refusal = Refusal{ErrorCode::TooManySessions,
                      "there are " + std::to_string(context_.config.max_sessions) +
                          " sessions already; one has to end first, or listen.max_sessions to be raised"};
  }
  if (!refusal && hello.load_rate_hz != 0 &&
      (hello.role != protocol::Role::Simulator ||
       !(hello.load_rate_hz >= 60 && hello.load_rate_hz <= 1000))) {
    refusal = Refusal{ErrorCode::BadRequest, "load_rate_hz " + std::to_string(hello.load_rate_hz) +
                                                 "; accepted are 60 to 1000, from simulators"};
  }
  if (!refusal && hello.role == protocol::Role::Simulator) {
    if (std::string why = context_.input.no_simulators(); !why.empty())
      refusal = Refusal{ErrorCode::NotAvailable, std::move(why)};
  }
  if (!refusal && hello.role == protocol::Role::Operator) refusal = co_await take_blade(hello);
  if (refusal) refuse(*refusal, sequence);
  if (stage_ != Stage::kHandshake) co_return;

  co_await catch_up(hello);
  if (stage_ != Stage::kHandshake) co_return;
  role_ = hello.role;
  blade_rate_hz_ = hello.blade_rate_hz;
  load_rate_hz_ = hello.load_rate_hz;
  stage_ = Stage::kOpen;
  transport_->set_max_bytes(accepted_bytes());
  follower_.start({hello.view, hello.box, hello.max_rate_hz, hello.fields});
  const bool returns = hello.view != protocol::View::None && hello.resume_session != 0;
  const bool resumed = returns && follower_.can_resume(hello);
  send_welcome(resumed);
  if (blade_.held()) {
    context_.audit(Audit::kBlade, ticket_.address().address(),
                   "blade " + quoted(blade_.source_name()) + " is held by " + described());
  }
  complain_of_fields(sequence);
  blade_.note_reported(context_.recording.state);
  if (context_.recording.state == protocol::Recording::Stopped) warn_not_recorded();
  if (resumed) {
    follower_.resume(hello.resume_revision);
  } else {
    follower_.send_snapshot(returns ? SnapshotCause::ResumeGone : SnapshotCause::Join);
  }
}

// So that a client that comes from a place that is ahead of this one sees no revision go back.
asio::awaitable<void> Peer::catch_up(const protocol::Hello& hello) {
  constexpr milliseconds kLook{10};
  const auto patience_ns = static_cast<std::int64_t>(context_.config.catch_up_s * 1e9);
  const std::int64_t began_ns = monotonic_ns();
  while (follower_.is_behind(hello) && monotonic_ns() - began_ns < patience_ns &&
         stage_ == Stage::kHandshake) {
    opened_ns_ += kLook.count() * 1'000'000;  // the handshake's deadline is for the peer's time, not for ours
    co_await pause(kLook);
  }
}

bool Peer::speaks(protocol::View view) const {
  return protocol_version_ == protocol::kProtocolVersion ||
         (protocol_version_ == protocol::kOldProtocolVersion && view != protocol::View::Volume);
}

// A right token is never delayed; the answer to a wrong one may be.
asio::awaitable<std::optional<Refusal>> Peer::check_token(const protocol::Hello& hello) {
  using Verdict = Access::Verdict;
  const auto opens = [&](const AccessToken& token) {
    return std::find(token.roles.begin(), token.roles.end(), hello.role) != token.roles.end();
  };
  const asio::ip::address address = ticket_.address().address();
  const Access::Answer answer = context_.access.ask(address, hello.token, opens, last_received_ns_);
  if (answer.verdict == Verdict::kGranted) co_return std::nullopt;
  const std::string role = std::string("role ") + name_of(hello.role);
  context_.note_refusal(answer, address, role, described());
  if (answer.hold_ns > 0) {
    const auto held = context_.access.hold();
    opened_ns_ += answer.hold_ns;  // the handshake's deadline is for the peer's time, not for ours
    co_await pause(milliseconds(answer.hold_ns / 1'000'000));
  }
  Refusal refusal{ErrorCode::Unauthorized, "the token is wrong, or does not open " + role};
  if (answer.verdict == Verdict::kNoToken) refusal.text = role + " needs a token, and none was given";
  if (answer.verdict == Verdict::kNotLookedAt) {
    refusal = {ErrorCode::RateExceeded, "too many wrong tokens from this address; try again in " +
                                            std::to_string(1 + answer.come_back_ns / 1'000'000'000) + " s"};
  }
  co_return refusal;
}

asio::awaitable<std::optional<Refusal>> Peer::take_blade(const protocol::Hello& greeting) {
  // Named here, so that the next one who asks for it by either name finds its holder (PROTOCOL.md, section 7).
  protocol::Hello hello = greeting;
  if (hello.source_name.empty()) hello.source_name = protocol::kDefaultBladeName;
  if (hello.blade) {
    std::optional<Refusal> refusal = check_blade(*hello.blade, context_.facts.mesh.box);
    if (refusal) co_return refusal;
  }
  std::unique_ptr<PoseInput> input = context_.input.open(hello.source_name, hello.blade);
  // One whose holder has just left is free once the loop has ended its stroke.
  for (int i = 0; i < kLeavingTries && !input && stage_ == Stage::kHandshake &&
                  !others_.holder(hello.source_name) && !context_.input.is_held(hello.source_name);
       ++i) {
    co_await pause(kQueueRetry);
    input = context_.input.open(hello.source_name, hello.blade);
  }
  std::optional<Refusal> refusal = co_await wait_until_open(input);
  if (!input && hello.take_over && (!refusal || refusal->code == ErrorCode::BladeTaken)) {
    input = co_await take_over(hello);
    refusal = co_await wait_until_open(input);
  }
  if (!input) {
    if (refusal) co_return refusal;
    co_return Refusal{ErrorCode::BladeTaken, why_taken(hello.source_name)};
  }
  blade_.hold(std::move(input), hello.source_name);
  co_return std::nullopt;
}

std::string Peer::why_taken(const std::string& source_name) const {
  const std::string name = '"' + source_name + '"';
  if (others_.holder(source_name)) return "the blade " + name + " is held by another operator";
  if (context_.input.is_held(source_name)) {
    return "the blade " + name +
           " is held by a device at the server (OpenIGTLink, HID or Haply) and cannot be taken over; "
           "choose another name";
  }
  std::string by;
  const std::vector<std::string> holders = context_.input.holders();
  for (const std::string& holder : holders) by += (by.empty() ? ", by " : ", ") + quoted(holder);
  return "no blade is free for " + name + ": all " +
         (holders.empty() ? "" : std::to_string(holders.size()) + " ") + "are held" + by +
         "; one of them has to leave first";
}

// Where another server has the blade: waits for its answer. No input is left if that is no.
asio::awaitable<std::optional<Refusal>> Peer::wait_until_open(std::unique_ptr<PoseInput>& input) {
  waits_for_origin_ = true;
  while (input && input->opening() && stage_ == Stage::kHandshake) co_await pause(kQueueRetry);
  if (!input || stage_ != Stage::kHandshake) co_return std::nullopt;
  const std::optional<BladeEnd> end = input->ended();
  if (!end) co_return std::nullopt;
  input.reset();
  const bool lost = end->code == ErrorCode::Unknown;
  co_return Refusal{lost ? ErrorCode::NotAvailable : end->code, end->text};
}

// The blade of that name, from the peer that holds it; null where it does not become free.
asio::awaitable<std::unique_ptr<PoseInput>> Peer::take_over(const protocol::Hello& hello) {
  if (const auto holder = others_.holder(hello.source_name)) {
    ++context_.counters->takeovers;
    context_.audit(Audit::kBlade, ticket_.address().address(),
                   "blade " + quoted(hello.source_name) + " taken over by " + described() + " from " +
                       holder->described());
    holder->blade_.release();
    holder->finish(protocol::ByeReason::HandedOver, "another operator has taken the blade");
  }
  // It is free once the loop has ended its stroke.
  std::unique_ptr<PoseInput> input;
  for (int i = 0; i < kTakeOverTries && !input && stage_ == Stage::kHandshake; ++i) {
    co_await pause(kQueueRetry);
    input = context_.input.take_over(hello.source_name, hello.blade);
  }
  co_return input;
}

void Peer::complain_of_fields(std::uint64_t sequence) {
  if (const std::string missing = follower_.missing_fields(); !missing.empty())
    outbox_.complain(ErrorCode::NotAvailable, missing, sequence);
}

void Peer::send_welcome(bool resumed) {
  const PoseInput* blade = blade_.input();
  protocol::Welcome welcome = context_.welcome_to(follower_.feed());
  welcome.protocol_version = protocol_version_;
  welcome.session = follower_.epoch_name();
  welcome.role = role_;
  welcome.view = follower_.view();
  welcome.resumed = resumed;
  if (replay_.feed()) welcome.mesh = replay_.mesh();
  if (blade) {
    welcome.blade_heel = blade->heel();
    welcome.blade_tip = blade->tip();
    welcome.source = blade->number();
  }
  welcome.max_message_bytes = static_cast<std::uint32_t>(accepted_bytes());
  outbox_.send(make_frame(std::move(welcome)));
}

}  // namespace incise::stream
