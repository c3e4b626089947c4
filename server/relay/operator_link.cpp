#include "server/relay/operator_link.hpp"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <utility>

#include "protocol/limits.hpp"

namespace incise::relay {
namespace {

using protocol::ErrorCode;

constexpr std::size_t kMaxWaitingPoses = 2 * protocol::kMaxPosesPerBatch;
constexpr std::size_t kMaxUnsent_bytes = 1u << 20;  // beyond that poses wait here, and then the operator does
constexpr std::size_t kMaxUndos = 16;               // that may still be refused
constexpr std::chrono::milliseconds kRetry{200}, kSendRetry{1};

protocol::Hello hello(protocol::Role role, const Origin& origin) {
  protocol::Hello hello;
  hello.role = role;
  hello.client_name = "incise-relay";
  hello.client_version = INCISE_VERSION;
  hello.token = origin.options.token;
  return hello;
}

}  // namespace

OperatorLink::OperatorLink(asio::io_context& io, std::optional<Origin> origin, Wanted wanted, ForceSink force)
    : io_(io), origin_(std::move(origin)), wanted_(std::move(wanted)), force_(std::move(force)), retry_(io) {}

void OperatorLink::start() {
  asio::post(io_, [self = shared_from_this()] { self->connect(); });
}

void OperatorLink::leave() {
  asio::post(io_, [self = shared_from_this()] {
    self->left_ = true;
    self->retry_.cancel();
    if (!self->connection_) return;
    self->send_waiting();
    std::exchange(self->connection_, nullptr)->close();
  });
}

void OperatorLink::connect() {
  if (left_) return;
  if (!origin_) {
    on_end({ErrorCode::NotAvailable, {}, "this relay knows no server that takes poses"}, false);
    return;
  }
  protocol::Hello mine = hello(protocol::Role::Operator, *origin_);
  mine.source_name = wanted_.source_name;
  mine.blade = wanted_.blade;
  mine.take_over = wanted_.take_over;
  connection_ = std::make_shared<Connection>(io_, *origin_, static_cast<Connection::Owner&>(*this));
  connection_->open(std::move(mine));
}

// ---- What comes ----

void OperatorLink::on_message(const protocol::Message& message) {
  if (const auto* force = std::get_if<protocol::Force>(&message.body)) {
    force_(*force);
    return;
  }
  if (const auto* error = std::get_if<protocol::Error>(&message.body)) {
    const auto undo = undos_.find(error->in_reply_to);
    if (undo == undos_.end()) return;
    undo->second({error->code, error->text});
    undos_.erase(undo);
    return;
  }
  const std::scoped_lock lock(mutex_);
  round_trip_ns_ = connection_->clock().round_trip_ns();
  if (const auto* welcome = std::get_if<protocol::Welcome>(&message.body)) {
    welcome_ = *welcome;
    opening_ = false;
  } else if (const auto* report = std::get_if<protocol::PoseReport>(&message.body)) {
    report_ = *report;
  }
}

void OperatorLink::on_end(const Connection::End& end, bool welcomed) {
  connection_ = nullptr;
  if (!welcomed && end.code == ErrorCode::Unknown) {
    // The operator waits, for as long as a handshake may take: an operator who is refused would not come back.
    retry_.expires_after(kRetry);
    retry_.async_wait([self = shared_from_this()](boost::system::error_code error) {
      if (!error) self->connect();
    });
    return;
  }
  const std::scoped_lock lock(mutex_);
  end_ = stream::BladeEnd{end.code, end.reason, end.text};
  opening_ = false;
}

// ---- The operator's side ----

bool OperatorLink::opening() const {
  const std::scoped_lock lock(mutex_);
  return opening_;
}

std::optional<stream::BladeEnd> OperatorLink::ended() const {
  const std::scoped_lock lock(mutex_);
  return end_;
}

std::uint32_t OperatorLink::number() const {
  const std::scoped_lock lock(mutex_);
  return welcome_.source;
}

protocol::Vec3 OperatorLink::heel() const {
  const std::scoped_lock lock(mutex_);
  return welcome_.blade_heel;
}

protocol::Vec3 OperatorLink::tip() const {
  const std::scoped_lock lock(mutex_);
  return welcome_.blade_tip;
}

std::chrono::nanoseconds OperatorLink::round_trip() const {
  const std::scoped_lock lock(mutex_);
  return std::chrono::nanoseconds(round_trip_ns_);
}

stream::PoseTotals OperatorLink::totals() const {
  const std::scoped_lock lock(mutex_);
  stream::PoseTotals totals;
  totals.accepted = report_.accepted;
  totals.not_finite = report_.not_finite;
  totals.not_unit = report_.not_unit;
  totals.time_not_rising = report_.time_not_rising;
  totals.queue_full = report_.queue_full;
  totals.too_fast = report_.too_fast;
  totals.last_source_ns = report_.last_source_ns;
  totals.backlog_segments = report_.backlog_segments;
  totals.recorded = report_.recorded;
  totals.recorded_source_ns = report_.recorded_source_ns;
  return totals;
}

std::size_t OperatorLink::enqueue(std::span<const protocol::PoseSample> poses) {
  const std::scoped_lock lock(mutex_);
  const std::size_t count = std::min(poses.size(), kMaxWaitingPoses - waiting_poses_);
  if (count == 0) return 0;
  poses = poses.first(count);
  if (waiting_.empty() || waiting_.back().poses.empty() ||
      waiting_.back().poses.size() + count > protocol::kMaxPosesPerBatch) {
    waiting_.emplace_back();
  }
  waiting_.back().poses.insert(waiting_.back().poses.end(), poses.begin(), poses.end());
  waiting_poses_ += count;
  last_source_ns_ = poses.back().source_ns;
  if (!std::exchange(sending_, true)) asio::post(io_, [self = shared_from_this()] { self->send_waiting(); });
  return count;
}

bool OperatorLink::end_stroke() {
  add({});
  return true;
}

// In its place among the poses: it is for the strokes before it.
void OperatorLink::undo(protocol::Undo what, const stream::PeerInput::Later& later) {
  add({{}, later, what});
}

void OperatorLink::add(Work work) {
  const std::scoped_lock lock(mutex_);
  waiting_.push_back(std::move(work));
  if (!std::exchange(sending_, true)) asio::post(io_, [self = shared_from_this()] { self->send_waiting(); });
}

void OperatorLink::send_waiting() {
  std::vector<Work> work;
  std::int64_t last_source_ns = 0;
  {
    const std::scoped_lock lock(mutex_);
    if (connection_ && !left_ && connection_->waiting_bytes() > kMaxUnsent_bytes) {
      retry_.expires_after(kSendRetry);
      retry_.async_wait([self = shared_from_this()](boost::system::error_code error) {
        if (!error) self->send_waiting();
      });
      return;
    }
    sending_ = false;
    work.swap(waiting_);
    waiting_poses_ = 0;
    last_source_ns = last_source_ns_;
  }
  if (!connection_) return;
  for (const Work& next : work) {
    if (next.undo) {
      // What is done is not answered.
      if (undos_.size() >= kMaxUndos) undos_.erase(undos_.begin());
      undos_[connection_->send(next.undone)] = next.undo;
    } else if (next.poses.empty()) {
      connection_->send(protocol::StrokeControl{protocol::StrokeAction::End, last_source_ns});
    } else {
      connection_->send(protocol::PoseBatch{next.poses});
    }
  }
}

// ---- For the server here ----

namespace {

class LentBlade final : public stream::PoseInput {
 public:
  explicit LentBlade(std::shared_ptr<OperatorLink> link) : link_(std::move(link)) {}
  ~LentBlade() override { link_->leave(); }
  bool opening() const override { return link_->opening(); }
  std::optional<stream::BladeEnd> ended() const override { return link_->ended(); }
  std::uint32_t number() const override { return link_->number(); }
  std::size_t enqueue(std::span<const protocol::PoseSample> poses, std::int64_t /*arrival_ns*/) override {
    return link_->enqueue(poses);
  }
  bool end_stroke(std::int64_t /*arrival_ns*/) override { return link_->end_stroke(); }
  stream::PoseTotals totals() const override { return link_->totals(); }
  protocol::Vec3 heel() const override { return link_->heel(); }
  protocol::Vec3 tip() const override { return link_->tip(); }

 private:
  const std::shared_ptr<OperatorLink> link_;
};

}  // namespace

std::unique_ptr<stream::PoseInput> lend(std::shared_ptr<OperatorLink> link) {
  return std::make_unique<LentBlade>(std::move(link));
}

// ---- Administrators ----

namespace {

// Longer than the origin lets an undo wait for strokes to end.
constexpr std::chrono::seconds kLongestUndo{15};

// Waits for the origin to refuse what was asked. A reset it refuses before the pong behind it; an undo it may refuse later.
class Errand final : public std::enable_shared_from_this<Errand>, private Connection::Owner {
 public:
  Errand(asio::io_context& io, const Origin& origin, protocol::Body what, stream::PeerInput::Later later)
      : connection_(std::make_shared<Connection>(io, origin, static_cast<Connection::Owner&>(*this))),
        what_(std::move(what)),
        later_(std::move(later)),
        patience_(io) {}

  void start(const Origin& origin) {
    self_ = shared_from_this();
    connection_->open(hello(protocol::Role::Admin, origin));
  }

 private:
  void on_message(const protocol::Message& message) override {
    if (std::holds_alternative<protocol::Welcome>(message.body)) {
      if (sequence_ == 0) ask();  // the second one comes with what was asked, or what somebody else did
    } else if (const auto* error = std::get_if<protocol::Error>(&message.body)) {
      if (error->in_reply_to != sequence_) return;
      later_({error->code, error->text});
      end();
    } else if (const auto* pong = std::get_if<protocol::Pong>(&message.body); pong && pong->nonce == kNonce) {
      end();
    }
  }
  void ask() {
    sequence_ = connection_->send(what_);
    if (!std::holds_alternative<protocol::Undo>(what_)) {
      connection_->send(protocol::Ping{kNonce, 0});
      return;
    }
    patience_.expires_after(kLongestUndo);
    patience_.async_wait([self = shared_from_this()](boost::system::error_code error) {
      if (!error) self->end();
    });
  }
  void end() {
    patience_.cancel();
    connection_->close();
    self_.reset();
  }
  void on_end(const Connection::End& end, bool /*welcomed*/) override {
    later_({ErrorCode::NotAvailable, "the server that cuts does not do it for this relay: " + end.text});
    patience_.cancel();
    self_.reset();
  }

  static constexpr std::uint64_t kNonce = ~std::uint64_t{0};
  const std::shared_ptr<Connection> connection_;
  const protocol::Body what_;
  const stream::PeerInput::Later later_;
  asio::steady_timer patience_;
  std::uint64_t sequence_ = 0;  // 0: not asked yet
  std::shared_ptr<Errand> self_;
};

}  // namespace

void ask_origin(asio::io_context& io, const Origin& origin, protocol::Body what,
                stream::PeerInput::Later later) {
  std::make_shared<Errand>(io, origin, std::move(what), std::move(later))->start(origin);
}

}  // namespace incise::relay
