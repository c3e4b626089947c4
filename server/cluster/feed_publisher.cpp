#include "server/cluster/feed_publisher.hpp"

#include <sys/random.h>

#include <chrono>
#include <utility>

#include "server/base/clock.hpp"
#include "server/base/hex.hpp"

namespace incise::cluster {
namespace {

using protocol::View;
using stream::EncodedStep;
using stream::SharedFrame;

constexpr std::chrono::milliseconds kRetry{1000}, kLook{100}, kFinish{2000};
constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kLookAfter_ns = 5 * kSecond_ns;
constexpr std::int64_t kLogAgain_ns = 60 * kSecond_ns;  // the same trouble
constexpr std::size_t kHeaderBytes = 4096;              // of a message, and more than they take
constexpr std::size_t kPartBytes = 512 << 10;           // less than NATS's default limit of 1 MB
constexpr std::int64_t kAcks_ms = 10'000;

std::string fresh_instance() {
  std::uint64_t id = 0;
  if (getrandom(&id, sizeof id, 0) != sizeof id) id = static_cast<std::uint64_t>(unix_ns());
  return hex(id);
}

}  // namespace

FeedPublisher::FeedPublisher(PublisherOptions options, Log log, std::function<bool()> may_write,
                             std::uint64_t fence)
    : options_(std::move(options)),
      subjects_(options_.session),
      log_(std::move(log)),
      may_write_(std::move(may_write)),
      fence_(fence),
      instance_(fresh_instance()) {
  trouble_ = "not connected yet";
}

FeedPublisher::~FeedPublisher() {
  stop();
}

void FeedPublisher::start(RequestState request) {
  request_ = std::move(request);
  thread_ = std::thread([this] { run(); });
}

void FeedPublisher::stop() {
  if (!thread_.joinable()) return;
  {
    const std::scoped_lock lock(mutex_);
    stopping_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

PublisherCounters FeedPublisher::counters() const {
  PublisherCounters out;
  out.connected = connected_;
  out.connections = connections_;
  out.failures = failures_;
  out.messages = messages_;
  out.bytes = bytes_;
  out.deltas = deltas_;
  out.snapshots = snapshots_;
  out.dropped = dropped_;
  const std::scoped_lock lock(mutex_);
  out.queued_bytes = queued_bytes_;
  out.trouble = trouble_;
  return out;
}

// ---- The stream thread ----

// The lock is held for as long as it takes to move a pointer, on both sides.
void FeedPublisher::push(Item item, std::size_t bytes) {
  {
    const std::scoped_lock lock(mutex_);
    if (!connected_) return;  // a snapshot comes first in any case
    if (queued_bytes_ + bytes > options_.queue_bytes && bytes > 0) {
      dropped_ += queue_.size() + 1;
      queue_.clear();
      queued_bytes_ = 0;
      queue_.emplace_back(Epoch{now_epoch_});
    } else {
      queue_.push_back(std::move(item));
      queued_bytes_ += bytes;
    }
  }
  wake_.notify_one();
}

void FeedPublisher::on_epoch(std::uint64_t epoch, std::uint64_t) {
  {
    const std::scoped_lock lock(mutex_);
    now_epoch_ = epoch;
  }
  push(Epoch{epoch}, 0);
}
void FeedPublisher::on_step(const EncodedStep& step) {
  push(step, step.bytes());
}
void FeedPublisher::on_gap(std::uint64_t) {
  push(Gap{}, 0);
}
void FeedPublisher::on_fields_set() {
  push(FieldsSet{}, 0);
}
void FeedPublisher::on_live(const SharedFrame& frame) {
  push(frame, frame->body().size());
}

// ---- Its own thread ----

void FeedPublisher::run() {
  for (;;) {
    try {
      connect();
      work();
      return;
    } catch (const NatsError& error) {
      disconnect(error.what());
    }
    std::unique_lock lock(mutex_);
    if (wake_.wait_for(lock, kRetry, [this] { return stopping_; })) return;
  }
}

void FeedPublisher::connect() {
  {
    const std::scoped_lock lock(mutex_);
    refused_.clear();
  }
  client_ = std::make_unique<NatsClient>(options_.nats, 3000, &FeedPublisher::on_refused, this);
  part_bytes_ =
      std::min(kPartBytes, client_->max_payload() - std::min(client_->max_payload() / 2, kHeaderBytes));
  make_stream();
  for (ViewState& view : views_) {
    lose(view);
    view.first = view.before = 0;  // the stream may be another one, whose numbers began again
  }
  ++connections_;
  {
    const std::scoped_lock lock(mutex_);
    queue_.clear();
    queued_bytes_ = 0;
    epoch_ = now_epoch_;
    trouble_.clear();
    connected_ = true;
  }
  log_(false, options_.nats.url + ": publishing session " + options_.session);
  logged_.clear();
}

void FeedPublisher::disconnect(const std::string& why) {
  ++failures_;
  {
    const std::scoped_lock lock(mutex_);
    connected_ = false;
    queue_.clear();
    queued_bytes_ = 0;
    trouble_ = why;
  }
  client_.reset();
  const std::int64_t now = monotonic_ns();
  if (why == logged_ && now - logged_ns_ < kLogAgain_ns) return;
  logged_ = why;
  logged_ns_ = now;
  log_(true, why + "; the session goes on, nothing is published until that is mended");
}

void FeedPublisher::make_stream() {
  const std::string volume = subjects_.all(View::Volume), surface = subjects_.all(View::Surface);
  const char* subjects[] = {volume.c_str(), surface.c_str()};
  jsStreamConfig config;
  jsStreamConfig_Init(&config);
  config.Name = subjects_.stream().c_str();
  config.Subjects = subjects;
  config.SubjectsLen = 2;
  config.Storage = options_.in_memory ? js_MemoryStorage : js_FileStorage;
  config.Replicas = options_.replicas;
  config.MaxBytes = options_.stream_bytes;
  config.MaxAge = static_cast<std::int64_t>(options_.keep_s * 1e9);
  config.Discard = js_DiscardOld;
  config.AllowDirect = true;
  jsErrCode code{};
  // In this order, because nats-server looks for room for a new stream first.
  natsStatus status = js_UpdateStream(nullptr, client_->jetstream(), &config, nullptr, &code);
  if (status != NATS_OK && code == JSStreamNotFoundErr)
    status = js_AddStream(nullptr, client_->jetstream(), &config, nullptr, &code);
  client_->check(status, "stream " + subjects_.stream());
}

void FeedPublisher::on_refused(jsCtx*, jsPubAckErr* error, void* self) {
  auto& publisher = *static_cast<FeedPublisher*>(self);
  const std::scoped_lock lock(publisher.mutex_);
  if (publisher.refused_.empty())
    publisher.refused_ = error->ErrText && *error->ErrText ? error->ErrText : natsStatus_GetText(error->Err);
}

// Throws where what went out may not have arrived.
void FeedPublisher::require_health() {
  std::string refused;
  {
    const std::scoped_lock lock(mutex_);
    refused = refused_;
  }
  const std::string& where = options_.nats.url;
  if (!refused.empty()) throw NatsError(NATS_ERR, where + ": it does not take what is published: " + refused);
  if (!client_->alive()) {
    const std::string said = client_->last_error();
    throw NatsError(NATS_CONNECTION_CLOSED,
                    where + ": the connection was lost" + (said.empty() ? "" : ": " + said));
  }
  if (may_write_ && !may_write_())
    throw NatsError(NATS_ERR, "the lease of session " + options_.session + " is not ours");
}

void FeedPublisher::work() {
  std::deque<Item> items;
  std::int64_t finish_ns = 0;
  for (;;) {
    {
      std::unique_lock lock(mutex_);
      wake_.wait_for(lock, kLook, [this] { return stopping_ || !queue_.empty(); });
      items.swap(queue_);
      queued_bytes_ = 0;
      if (stopping_ && finish_ns == 0) finish_ns = monotonic_ns() + 2 * kSecond_ns;
    }
    require_health();
    for (Item& item : items) {
      handle(item);
      if (finish_ns != 0 && monotonic_ns() > finish_ns) return;
    }
    items.clear();
    if (finish_ns != 0) {
      jsPubOptions options;
      jsPubOptions_Init(&options);
      options.MaxWait = kFinish.count();
      js_PublishAsyncComplete(client_->jetstream(), &options);
      return;
    }
    look_after_snapshots();
    request_wanted();
  }
}

void FeedPublisher::lose(ViewState& view) {
  view.broken = view.wanted = true;
  view.requested = 0;
  view.since.clear();
  view.since_bytes = 0;
}

void FeedPublisher::handle(Item& item) {
  if (const auto* step = std::get_if<EncodedStep>(&item)) {
    handle(*step);
  } else if (auto* state = std::get_if<State>(&item)) {
    handle(*state);
  } else if (const auto* frame = std::get_if<SharedFrame>(&item)) {
    if ((*frame)->body().size() <= part_bytes_)
      publish(subjects_.live(), *frame, {head_, {}, {}}, false, true);
  } else if (std::holds_alternative<FieldsSet>(item)) {
    views_[0].wanted = true;  // fields come with the volume
  } else {
    if (const auto* epoch = std::get_if<Epoch>(&item)) epoch_ = epoch->epoch;
    for (ViewState& view : views_) lose(view);
  }
}

void FeedPublisher::handle(const EncodedStep& step) {
  head_ = step.revision;
  for (ViewState& view : views_) {
    if (!view.broken) publish_delta(view, step);
    if (view.requested == 0) continue;
    view.since.push_back(step);
    view.since_bytes += step.bytes();
    if (view.since_bytes > options_.queue_bytes) lose(view);  // the snapshot takes too long: ask again
  }
}

void FeedPublisher::publish_delta(ViewState& view, const EncodedStep& step) {
  const SharedFrame& frame = view.view == View::Surface ? step.surface : step.volume;
  publish(subjects_.delta(view.view), frame, {step.revision, step.base_hash, {}});
  view.delta_bytes += frame->body().size();
  ++deltas_;
}

// Fields that clients set often wait for a second: each of these is a whole state.
void FeedPublisher::request_wanted() {
  const std::int64_t now = monotonic_ns();
  for (ViewState& view : views_) {
    const auto age_ns = static_cast<double>(now - view.snapshot_ns);
    if (view.delta_bytes > options_.join_bytes || age_ns > options_.keep_s * 0.5e9) view.wanted = true;
    if (!view.wanted || view.requested != 0 || (!view.broken && age_ns < 1e9)) continue;
    view.wanted = false;
    view.requested = ++requests_;
    view.since.clear();
    view.since_bytes = 0;
    request_(view.view, [this, which = view.view, request = requests_](stream::WholeState state) {
      push(State{which, request, std::move(state)}, 0);
    });
  }
}

void FeedPublisher::handle(State& answer) {
  ViewState& view = views_[answer.view == View::Surface ? 1 : 0];
  if (view.requested != answer.request) return;  // something was lost since it was asked for
  const stream::WholeState& state = answer.state;
  if (state.epoch != epoch_) return lose(view);
  const std::uint64_t before = bytes_;
  const std::uint64_t first = publish(subjects_.welcome(view.view), state.frames.front(),
                                      {state.revision, {}, state.fields_set}, true);
  for (std::size_t i = 1; i < state.frames.size(); ++i) {
    publish(subjects_.snapshot(view.view), state.frames[i], {state.revision, {}, {}});
    require_health();
  }
  const std::size_t written = bytes_ - before;
  view.delta_bytes = 0;
  // Those that follow the state were published before it, too, for readers who had no need of it.
  for (const EncodedStep& step : view.since) {
    if (step.revision > state.revision) publish_delta(view, step);
  }
  wait_for_acks();
  if (std::exchange(view.snapshot_bytes, written) == 0) warn_if_small();
  view.before = std::exchange(view.first, first);
  view.requested = 0;
  view.broken = false;
  view.since.clear();
  view.since_bytes = 0;
  view.snapshot_ns = monotonic_ns();
  ++snapshots_;
  purge(view);
}

// The oldest would go before the next snapshot is there.
void FeedPublisher::warn_if_small() {
  const std::size_t needed =
      2 * (views_[0].snapshot_bytes + views_[1].snapshot_bytes + 2 * options_.join_bytes);
  if (needed > static_cast<std::size_t>(options_.stream_bytes)) {
    log_(true, "cluster.stream_megabytes: " + std::to_string(options_.stream_bytes >> 20) +
                   ", but this body needs about " + std::to_string((needed >> 20) + 1) +
                   "; who joins may have to wait for the next snapshot");
  }
}

void FeedPublisher::wait_for_acks() {
  jsPubOptions options;
  jsPubOptions_Init(&options);
  options.MaxWait = kAcks_ms;
  client_->check(js_PublishAsyncComplete(client_->jetstream(), &options), "acknowledgements");
  require_health();
}

// What lies before the last snapshot but one serves nobody: whoever is reading still may be in that one.
void FeedPublisher::purge(ViewState& view) {
  if (view.before <= 1) return;  // nothing is before it; and to nats-server 2.9, "before 1" means everything
  const std::string subject = subjects_.all(view.view);
  jsOptions options;
  jsOptions_Init(&options);
  options.Stream.Purge.Subject = subject.c_str();
  options.Stream.Purge.Sequence = view.before;
  client_->check(js_PurgeStream(client_->jetstream(), subjects_.stream().c_str(), &options, nullptr),
                 "purge");
}

// Somebody else may have purged the stream, which nothing that is published would tell us. NATS that is slow to answer is no reason to begin again.
void FeedPublisher::look_after_snapshots() {
  const std::int64_t now = monotonic_ns();
  if (now - looked_ns_ < kLookAfter_ns) return;
  looked_ns_ = now;
  for (ViewState& view : views_) {
    if (view.broken || view.requested != 0) continue;
    try {
      if (client_->newest(subjects_.stream(), subjects_.welcome(view.view)) == view.first) continue;
    } catch (const NatsError& error) {
      if (error.status == NATS_TIMEOUT) return;
      throw;
    }
    ++failures_;
    log_(true,
         options_.nats.url + ": stream " + subjects_.stream() +
             " has lost its newest snapshot (it was purged, or another server publishes under this name); "
             "publishing another one");
    lose(view);
  }
}

std::uint64_t FeedPublisher::publish(const std::string& subject, const SharedFrame& frame,
                                     const Headers& headers, bool ack, bool live) {
  const std::span<const std::byte> body = frame->body();
  const std::size_t parts = std::max<std::size_t>(1, (body.size() + part_bytes_ - 1) / part_bytes_);
  std::uint64_t first = 0;
  for (std::size_t part = 0; part < parts; ++part) {
    const std::span<const std::byte> data =
        body.subspan(part * part_bytes_, std::min(part_bytes_, body.size() - part * part_bytes_));
    natsMsg* raw = nullptr;
    client_->check(natsMsg_Create(&raw, subject.c_str(), nullptr, reinterpret_cast<const char*>(data.data()),
                                  static_cast<int>(data.size())),
                   "message");
    NatsMessage message(raw);
    const auto set = [&](const char* name, const std::string& value) {
      client_->check(natsMsgHeader_Set(message.get(), name, value.c_str()), "header");
    };
    set(kEpochHeader, hex(epoch_));
    set(kInstanceHeader, instance_);
    set(kRevisionHeader, std::to_string(headers.revision));
    if (fence_ > 0) set(kFenceHeader, std::to_string(fence_));
    if (headers.base_hash) set(kBaseHashHeader, hex(*headers.base_hash));
    if (headers.fields_set) set(kFieldsSetHeader, std::to_string(*headers.fields_set));
    if (headers.fields_set || live) set(kClockHeader, std::to_string(unix_ns() - monotonic_ns()));
    if (parts > 1) set(kPartHeader, std::to_string(part + 1) + "/" + std::to_string(parts));
    if (live) {
      client_->check(natsConnection_PublishMsg(client_->connection(), message.get()), subject);
    } else if (ack) {
      jsPubAck* answer = nullptr;
      client_->check(js_PublishMsg(&answer, client_->jetstream(), message.get(), nullptr, nullptr), subject);
      if (part == 0) first = answer->Sequence;
      jsPubAck_Destroy(answer);
    } else {
      natsMsg* given = message.release();  // taken where it is sent
      const natsStatus status = js_PublishMsgAsync(client_->jetstream(), &given, nullptr);
      if (given) natsMsg_Destroy(given);
      client_->check(status, subject);
    }
    ++messages_;
    bytes_ += data.size();
  }
  return first;
}

}  // namespace incise::cluster
