#include "server/cluster/feed_reader.hpp"

#include <charconv>
#include <chrono>
#include <utility>
#include <variant>

#include "server/base/clock.hpp"

namespace incise::cluster {
namespace {

constexpr std::chrono::milliseconds kRetry{1000};
constexpr std::int64_t kLook_ms = 10;               // for the next message, and then for live ones
constexpr std::int64_t kSilent_ns = 5'000'000'000;  // statistics come once a second
constexpr std::int64_t kBehind_ns = 3'000'000'000;  // statistics tell of more than has come

}  // namespace

FeedReader::FeedReader(NatsOptions nats, const std::string& session, protocol::View view)
    : nats_(std::move(nats)), session_(session), subjects_(session), view_(view) {}

FeedReader::~FeedReader() {
  stop();
}

void FeedReader::start(Sink& sink) {
  sink_ = &sink;
  thread_ = std::thread([this] { run(); });
}

void FeedReader::stop() {
  if (!thread_.joinable()) return;
  {
    const std::scoped_lock lock(mutex_);
    stopping_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

bool FeedReader::stopping() const {
  const std::scoped_lock lock(mutex_);
  return stopping_;
}

void FeedReader::resync() {
  resync_ = true;
}

void FeedReader::lose(const std::string& why) {
  lost_ = true;
  live_revision_ = 0;
  sink_->on_lost(why);
}

void FeedReader::run() {
  while (!stopping()) {
    try {
      read();
      if (std::exchange(again_, false)) continue;
    } catch (const NatsError& error) {
      lose(error.what());
    }
    std::unique_lock lock(mutex_);
    wake_.wait_for(lock, kRetry, [this] { return stopping_; });
  }
}

// The revision to which the deltas behind that message lead; 0: there are none.
std::uint64_t FeedReader::newest_delta(NatsClient& client, std::uint64_t behind) const {
  natsMsg* raw = nullptr;
  const natsStatus status = js_GetLastMsg(&raw, client.jetstream(), subjects_.stream().c_str(),
                                          subjects_.delta(view_).c_str(), nullptr, nullptr);
  const NatsMessage message(raw);
  if (status != NATS_OK || natsMsg_GetSequence(message.get()) < behind) return 0;
  return header_number(message.get(), kRevisionHeader);
}

void FeedReader::read() {
  NatsOptions options = nats_;
  NatsClient client(options);
  const std::uint64_t first = client.newest(subjects_.stream(), subjects_.welcome(view_));
  if (first == 0) return lose(nats_.url + ": session " + session_ + " is not there");
  mode_ = Mode::kWaiting;
  partial_ = again_ = false;
  const FeedReader::Held held = sink_->held();
  held_ = fresh_ ? Held{} : held;
  tail_ = newest_delta(client, first);

  natsSubscription* raw = nullptr;
  client.check(natsConnection_SubscribeSync(&raw, client.connection(), subjects_.live().c_str()),
               subjects_.live());
  const NatsSubscription live(raw);
  jsSubOptions from;
  jsSubOptions_Init(&from);
  from.Stream = subjects_.stream().c_str();
  from.Ordered = true;
  from.Config.DeliverPolicy = js_DeliverByStartSequence;
  from.Config.OptStartSeq = first;
  raw = nullptr;
  client.check(
      js_SubscribeSync(&raw, client.jetstream(), subjects_.all(view_).c_str(), nullptr, &from, nullptr),
      "session " + session_);
  const NatsSubscription state(raw);
  live_ns_ = moved_ns_ = monotonic_ns();
  while (!stopping() && !again_) {
    natsMsg* message = nullptr;
    const natsStatus status = natsSubscription_NextMsg(&message, state.get(), kLook_ms);
    const NatsMessage keep(message);
    if (status == NATS_OK) {
      if (add_part(message)) handle();
    } else if (status != NATS_TIMEOUT) {
      client.check(status, "session " + session_);
    }
    if (!client.alive()) throw NatsError(NATS_CONNECTION_CLOSED, nats_.url + ": the connection was lost");
    read_live(live.get());
    if (resync_.exchange(false)) fresh_ = again_ = true;
  }
}

// What comes once a second also tells whether the publisher lives, and whether something was missed.
void FeedReader::read_live(natsSubscription* live) {
  natsMsg* raw = nullptr;
  while (natsSubscription_NextMsg(&raw, live, 0) == NATS_OK) {
    const NatsMessage message(raw);
    raw = nullptr;
    if (header_number(message.get(), kFenceHeader) < fence_) continue;
    if (lost_ && mode_ == Mode::kFollowing) again_ = true;  // it is back; the sink gets a Welcome
    live_ns_ = monotonic_ns();
    live_revision_ = header_number(message.get(), kRevisionHeader);
    std::int64_t clock = 0;
    const std::string text = header(message.get(), kClockHeader);
    std::from_chars(text.data(), text.data() + text.size(), clock);
    if (clock != 0) ahead_ns_ = unix_ns() - clock - live_ns_;
    const auto* data = reinterpret_cast<const std::byte*>(natsMsg_GetData(message.get()));
    const protocol::DecodeResult got =
        protocol::decode({data, static_cast<std::size_t>(natsMsg_GetDataLength(message.get()))});
    if (got && mode_ == Mode::kFollowing) sink_->on_message(*got.message, ahead_ns_);
  }
  const std::int64_t now = monotonic_ns();
  if (now - live_ns_ > kSilent_ns) {
    live_ns_ = now;
    lose(nats_.url + ": session " + session_ + " is silent: its server has gone, or cannot reach NATS");
  }
  if ((mode_ != Mode::kFollowing || live_revision_ > held_.revision) && now - moved_ns_ > kBehind_ns) {
    moved_ns_ = now;
    again_ = live_revision_ > 0 && live_ns_ > now - kBehind_ns;
  }
}

bool FeedReader::add_part(natsMsg* message) {
  std::size_t part = 1, parts = 1;
  if (const std::string text = header(message, kPartHeader); !text.empty()) {
    const std::size_t slash = text.find('/');
    std::from_chars(text.data(), text.data() + std::min(slash, text.size()), part);
    if (slash != std::string::npos)
      std::from_chars(text.data() + slash + 1, text.data() + text.size(), parts);
  }
  const std::string subject = natsMsg_GetSubject(message);
  const std::string instance = header(message, kInstanceHeader);
  const std::size_t bytes = static_cast<std::size_t>(natsMsg_GetDataLength(message));
  if (part == 1) {
    whole_ = {};
    partial_ = true;
    parts_ = 0;
    whole_.kind = subject.ends_with(".welcome")    ? Whole::Kind::kWelcome
                  : subject.ends_with(".snapshot") ? Whole::Kind::kSnapshot
                                                   : Whole::Kind::kDelta;
    whole_.epoch = header_number(message, kEpochHeader, 16);
    whole_.revision = header_number(message, kRevisionHeader);
    whole_.base_hash = header_number(message, kBaseHashHeader, 16);
    whole_.fields_set = header_number(message, kFieldsSetHeader);
    whole_.fence = header_number(message, kFenceHeader);
    whole_.instance = instance;
  } else if (!partial_ || part != parts_ + 1 || instance != whole_.instance) {
    partial_ = false;  // it began before us, or two wrote at a time: its revision will be missed
    return false;
  }
  if (whole_.bytes.size() + bytes > protocol::kMaxMessageBytes) {
    partial_ = false;
    return false;
  }
  const auto* data = reinterpret_cast<const std::byte*>(natsMsg_GetData(message));
  whole_.bytes.insert(whole_.bytes.end(), data, data + bytes);
  parts_ = part;
  if (part < parts) return false;
  partial_ = false;
  return true;
}

void FeedReader::handle() {
  if (whole_.fence < fence_) return;  // of an instance that has lost the session
  fence_ = whole_.fence;
  // Most of a snapshot that is passed over is not even looked at.
  if (whole_.kind == Whole::Kind::kSnapshot && mode_ != Mode::kTaking && mode_ != Mode::kFields) return;
  const protocol::DecodeResult got = protocol::decode(whole_.bytes);
  if (!got)
    throw NatsError(NATS_ERR,
                    nats_.url + ": session " + session_ + ": a message cannot be read: " + got.error);
  switch (whole_.kind) {
    case Whole::Kind::kWelcome:
      return on_welcome(*got.message);
    case Whole::Kind::kSnapshot:
      return on_snapshot(*got.message);
    case Whole::Kind::kDelta:
      return on_delta(*got.message);
  }
}

// Whether the deltas behind this Welcome go on from what is held.
bool FeedReader::leads_on(const protocol::Welcome& welcome) const {
  if (held_.epoch != whole_.epoch || held_.revision < welcome.revision) return false;
  if (held_.revision == welcome.revision) return held_.state_hash == welcome.state_hash;
  // Another run of the program begins with what it has: less than we have means that the rest is gone.
  const bool followed = mode_ == Mode::kFollowing && whole_.instance == instance_;
  return followed || (mode_ == Mode::kWaiting && tail_ >= held_.revision);
}

void FeedReader::on_welcome(const protocol::Message& message) {
  const auto* welcome = std::get_if<protocol::Welcome>(&message.body);
  if (!welcome) return;
  const bool keep = leads_on(*welcome);
  if (!keep || mode_ != Mode::kFollowing || lost_) {
    protocol::Message told = message;
    std::get<protocol::Welcome>(told.body).resumed = keep;
    lost_ = false;
    sink_->on_message(told, ahead_ns_);
  }
  if (keep) {
    mode_ = whole_.fields_set != fields_set_ ? Mode::kFields
            : mode_ == Mode::kFollowing      ? mode_
                                             : Mode::kPassing;
  } else {
    mode_ = Mode::kTaking;
    held_ = {};
  }
  if (mode_ == Mode::kPassing) mode_ = Mode::kFollowing;
  fields_set_ = whole_.fields_set;
  instance_ = whole_.instance;
}

void FeedReader::on_snapshot(const protocol::Message& message) {
  const auto* end = std::get_if<protocol::SnapshotEnd>(&message.body);
  if (mode_ == Mode::kFields) {
    if (std::holds_alternative<protocol::FieldValues>(message.body)) sink_->on_message(message, ahead_ns_);
    if (end) mode_ = Mode::kFollowing;
    return;
  }
  if (end) {
    fresh_ = false;
    mode_ = Mode::kFollowing;
    held_ = {whole_.epoch, whole_.revision, end->state_hash};
    moved_ns_ = monotonic_ns();
  }
  sink_->on_message(message, ahead_ns_);
}

void FeedReader::on_delta(const protocol::Message& message) {
  if ((mode_ != Mode::kFollowing && mode_ != Mode::kFields) || whole_.epoch != held_.epoch) return;
  std::uint64_t base = 0, hash = 0;
  if (const auto* delta = std::get_if<protocol::Delta>(&message.body)) {
    base = delta->base_revision;
    hash = delta->state_hash;
  } else if (const auto* surface = std::get_if<protocol::SurfaceDelta>(&message.body)) {
    base = surface->base_revision;
    hash = surface->state_hash;
  }
  if (whole_.revision < held_.revision || (whole_.revision == held_.revision && hash == held_.state_hash))
    return;
  if (base != held_.revision || whole_.base_hash != held_.state_hash) {
    mode_ = Mode::kWaiting;  // for the publisher's next snapshot; after a while the stream is read again
    return;
  }
  held_.revision = whole_.revision;
  held_.state_hash = hash;
  moved_ns_ = monotonic_ns();
  sink_->on_message(message, ahead_ns_);
}

}  // namespace incise::cluster
