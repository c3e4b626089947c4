#include "server/stream/peer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <deque>
#include <functional>
#include <limits>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "server/base/clock.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/stream/operator_blade.hpp"
#include "server/stream/peers.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::Role;
using protocol::View;

// A peer that has sent all its messages at once. It reads one write at a time, when the test says so.
class SlowReader final : public Transport {
 public:
  struct Wire {
    std::deque<protocol::Frame> sends;
    std::vector<SharedFrame> reads;
    std::function<void(boost::system::error_code)> done;  // of the write under way
    bool closed = false;
    std::function<void()> wake;  // the peer has sent more
  };
  SlowReader(asio::io_context& io, Wire& wire) : silence_(io), io_(io), wire_(wire) {
    silence_.expires_at(asio::steady_timer::time_point::max());
    wire_.wake = [this] { silence_.cancel(); };
  }

  asio::awaitable<Received> read() override {
    while (wire_.sends.empty() && !wire_.closed) {
      try {
        co_await silence_.async_wait(asio::use_awaitable);
      } catch (const boost::system::system_error&) {
      }
    }
    if (wire_.closed) co_return Received::end(asio::error::eof);
    current_ = std::move(wire_.sends.front());
    wire_.sends.pop_front();
    co_return Received::message(current_->body());
  }
  void set_max_bytes(std::size_t) override {}
  void write(std::span<const SharedFrame> frames,
             std::function<void(boost::system::error_code)> done) override {
    wire_.reads.insert(wire_.reads.end(), frames.begin(), frames.end());
    wire_.done = std::move(done);
  }
  asio::awaitable<void> discard() override { co_return; }
  void shut_down(std::shared_ptr<void>) override {}
  void close() override {
    wire_.closed = true;
    silence_.cancel();
  }
  std::string peer() const override { return "test"; }
  asio::any_io_executor executor() override { return io_.get_executor(); }

 private:
  asio::steady_timer silence_;
  asio::io_context& io_;
  Wire& wire_;
  std::optional<protocol::Frame> current_;
};

class PeerTest : public ::testing::Test {
 protected:
  void start(std::uint32_t cells) {
    cells_ = cells;
    loop_ = std::make_unique<MiniLoop>(box_mesh(cells));
    context_ = std::make_unique<PeerContext>(io_, config_, loop_->facts(), *loop_, providers_);
    peers_ = std::make_unique<Peers>(*context_);
    peers_->reset(std::make_shared<const InitialState>(loop_->initial()));
  }
  void join(const protocol::Hello& greeting) {
    wire_.sends.push_front(protocol::encode(greeting, {1, 0}));
    asio::ip::tcp::socket none(io_);
    Admission admission(config_, context_->counters);
    peer_ = std::make_shared<Peer>(*context_, *peers_, std::make_unique<SlowReader>(io_, wire_),
                                   *admission.admit(none));
    asio::co_spawn(io_, run(peer_), [this](std::exception_ptr) { ended_ = true; });
  }
  // One stroke right through the mesh; its deltas go to all peers at the end.
  void cut() {
    if (!session_) {
      core::CutConfig config;
      config.blade = {{0, 0, 0}, {0, 0, -1}};
      session_ = std::make_unique<core::CutSession>(box_mesh(cells_), config);
    }
    const double side = 0.01 * cells_, y = side * (0.2 + 0.1 * (strokes_++ % 7));
    for (const protocol::PoseSample& p : sweep(y, 60, strokes_ * std::int64_t{1'000'000'000}, side)) {
      session_->push(0, {p.source_ns, {p.position.x, p.position.y, p.position.z}, {1, 0, 0, 0}, p.buttons});
    }
    for (;;) {
      core::WorkBudget budget = core::WorkBudget::unlimited();
      auto published = std::make_shared<PublishedDelta>();
      if (session_->advance(budget, published->delta) != core::CutSession::Progress::kCommitted) break;
      peers_->apply(published);
    }
    peers_->advance_all();
  }
  // The peer reads what was being written. Returns the messages that it has read.
  std::vector<SharedFrame> read_write() {
    if (wire_.done) std::exchange(wire_.done, nullptr)({});
    return std::exchange(wire_.reads, {});
  }
  template <class T>
  static std::vector<T> all_of(const std::vector<SharedFrame>& frames) {
    std::vector<T> found;
    for (const SharedFrame& frame : frames) {
      protocol::DecodeResult decoded = protocol::decode(frame->body());
      if (const auto* body = std::get_if<T>(&decoded.message->body)) found.push_back(*body);
    }
    return found;
  }
  static asio::awaitable<void> run(std::shared_ptr<Peer> peer) { co_await peer->run(); }
  // Runs what is ready until `condition` holds.
  bool run_until(const std::function<bool()>& condition) {
    return eventually([&] {
      io_.restart();
      io_.poll();
      return condition();
    });
  }
  void TearDown() override {
    peer_->close();
    EXPECT_TRUE(run_until([&] { return ended_; }));
  }

  StreamConfig config_ = test_config();
  asio::io_context io_{1};
  Providers providers_;
  SlowReader::Wire wire_;
  std::unique_ptr<MiniLoop> loop_;
  std::unique_ptr<PeerContext> context_;
  std::unique_ptr<Peers> peers_;
  std::shared_ptr<Peer> peer_;
  std::unique_ptr<core::CutSession> session_;
  std::uint32_t cells_ = 0;
  int strokes_ = 0;
  bool ended_ = false;
};

TEST_F(PeerTest, ASilentPeerIsPingedTwiceAndThenLetGo) {
  start(2);
  join(hello(Role::Viewer, View::None));
  ASSERT_TRUE(run_until([&] { return peer_->open(); }));
  const std::int64_t idle_ns = static_cast<std::int64_t>(config_.idle_timeout_s * 1e9);
  const std::int64_t begin_ns = monotonic_ns();
  std::size_t pings = 0, byes = 0;
  for (std::int64_t passed_ns = 0; passed_ns < idle_ns + 1'000'000'000; passed_ns += 50'000'000) {
    peer_->tick(begin_ns + passed_ns);
    const auto read = read_write();
    pings += all_of<protocol::Ping>(read).size();
    byes += all_of<protocol::Bye>(read).size();
    EXPECT_TRUE(pings == 0 || passed_ns > idle_ns / 4) << passed_ns;
    ASSERT_TRUE(byes == 0 || passed_ns > idle_ns - 1'000'000'000) << passed_ns;
  }
  EXPECT_EQ(pings, 2u);
  EXPECT_EQ(byes, 1u);
}

// While the answer to a wrong token is held back, the peer's time for its Hello stands still.
TEST_F(PeerTest, TheDelayAfterAWrongTokenIsNotThePeersTime) {
  config_.tokens = {{"the right token", {Role::Viewer}}};
  start(2);
  const auto guess = [&] {
    return context_->access
        .ask(
            asio::ip::address(), "a guess", [](const AccessToken&) { return true; }, monotonic_ns())
        .hold_ns;
  };
  while (guess() < 1'000'000'000) {
  }
  protocol::Hello greeting = hello(Role::Viewer, View::None);
  greeting.token = "another guess";
  const std::uint64_t before = context_->counters->wrong_tokens;
  join(greeting);
  ASSERT_TRUE(run_until([&] { return context_->counters->wrong_tokens > before; }));
  const auto timeout_ns = static_cast<std::int64_t>(config_.handshake_timeout_s * 1e9);
  peer_->tick(monotonic_ns() + timeout_ns + 500'000'000);  // of the two seconds that it is held
  std::vector<SharedFrame> read;
  ASSERT_TRUE(run_until([&] {
    const auto more = read_write();
    read.insert(read.end(), more.begin(), more.end());
    return !read.empty();
  }));
  ASSERT_EQ(all_of<protocol::Error>(read).size(), 1u);
  EXPECT_EQ(all_of<protocol::Error>(read)[0].code, protocol::ErrorCode::Unauthorized);
}

// A peer that finds its state wrong while a snapshot is on its way gets another one behind it, however often it asks.
TEST_F(PeerTest, AResyncDuringASnapshotBringsOneMore) {
  config_.outbox_bytes = 1000;
  start(12);
  join(hello(Role::Viewer, View::Volume));
  ASSERT_TRUE(run_until([&] { return wire_.done != nullptr && context_->counters->snapshots == 1; }));
  std::vector<SharedFrame> read;
  const auto read_more = [&] {
    const auto more = read_write();
    read.insert(read.end(), more.begin(), more.end());
  };
  ASSERT_TRUE(run_until([&] {
    read_more();
    return !all_of<protocol::SnapshotBegin>(read).empty();
  }));
  ASSERT_TRUE(all_of<protocol::SnapshotEnd>(read).empty());
  for (int i = 0; i < 3; ++i) wire_.sends.push_back(protocol::encode(protocol::Resync{}, {2, 0}));
  wire_.wake();
  ASSERT_TRUE(run_until([&] { return wire_.sends.empty(); }));
  ASSERT_TRUE(run_until([&] {
    read_more();
    return all_of<protocol::SnapshotEnd>(read).size() == 2;
  }));
  const auto begins = all_of<protocol::SnapshotBegin>(read);
  ASSERT_EQ(begins.size(), 2u);
  EXPECT_EQ(begins[0].cause, protocol::SnapshotCause::Join);
  EXPECT_EQ(begins[1].cause, protocol::SnapshotCause::Resync);
  EXPECT_EQ(context_->counters->snapshots, 2u);
}

// An outbox that was full is half empty before it gets more, so that what is missing by then is one delta.
TEST_F(PeerTest, AFullOutboxGetsMoreWhenItIsHalfEmpty) {
  start(4);
  config_.outbox_bytes = 90 << 10;  // less than what seven strokes change
  join(hello(Role::Viewer, View::Volume));
  ASSERT_TRUE(run_until([&] { return !all_of<protocol::SnapshotEnd>(read_write()).empty(); }));
  while (wire_.done) read_write();
  // Single steps until no more fit; then one delta for several, which is too much; then nothing.
  const auto& coalesced = context_->counters->coalesced;
  for (int i = 0; i < 60; ++i) cut();
  EXPECT_EQ(coalesced, 1u);
  std::size_t all = 0, written = 0, last = 0;  // bytes; written: when it got the rest as another delta
  std::uint64_t revision = 0;
  std::vector<SharedFrame> writing = std::exchange(wire_.reads, {});
  while (!writing.empty()) {
    for (const protocol::Delta& delta : all_of<protocol::Delta>(writing)) revision = delta.revision;
    for (const SharedFrame& frame : writing) all += last = frame->tcp().size();
    if (coalesced == 1) written = all;
    writing = read_write();
  }
  EXPECT_EQ(coalesced, 2u);
  EXPECT_EQ(revision, context_->counters->revision);
  EXPECT_GT(all - last, config_.outbox_bytes);
  EXPECT_LE(all - last - written, config_.outbox_bytes / 2) << "bytes still waited when it got more";
}

TEST_F(PeerTest, APeerThatPingsAndReadsNothingIsLetGo) {
  config_.max_messages_per_s = std::numeric_limits<std::uint32_t>::max();
  start(2);
  for (int i = 0; i < 50'000; ++i) wire_.sends.push_back(protocol::encode(protocol::Ping{1, 2}, {2, 0}));
  join(hello(Role::Viewer, View::None));
  ASSERT_TRUE(run_until([&] { return !peer_->open() || wire_.sends.empty(); }));
  EXPECT_FALSE(peer_->open());
  EXPECT_GT(wire_.sends.size(), 10'000u) << "the answers to the first fill its megabyte";
  EXPECT_EQ(context_->counters->slow_disconnects, 1u);
}

// Who joins and does not read holds one piece of the snapshot at a time, not all of it.
TEST_F(PeerTest, AJoinerThatReadsNothingHoldsOneChunkOfTheSnapshot) {
  config_.outbox_bytes = 1000;
  start(24);
  join(hello(Role::Viewer, View::Volume));
  std::shared_ptr<const Snapshot> snapshot;
  ASSERT_TRUE(run_until([&] { return context_->counters->snapshots == 1; }));
  // The peer's own snapshot, as long as it sends it.
  context_->live.request_snapshot(View::Volume, std::nullopt, false,
                                  [&](const auto& same) { snapshot = same; });
  ASSERT_TRUE(run_until([&] { return snapshot != nullptr; }));
  ASSERT_GE(snapshot->chunks.size(), 4u);
  const auto waiting = [&] {
    return std::count_if(snapshot->chunks.begin(), snapshot->chunks.end(),
                         [](const SharedFrame& chunk) { return chunk.use_count() > 1; });
  };
  EXPECT_EQ(waiting(), 1);
  std::size_t chunks = 0;
  bool ended = false;
  for (;;) {
    for (const SharedFrame& frame : std::exchange(wire_.reads, {})) {
      chunks += static_cast<std::size_t>(std::count(snapshot->chunks.begin(), snapshot->chunks.end(), frame));
      ended = ended || frame == snapshot->end;
    }
    if (ended) break;
    ASSERT_TRUE(wire_.done) << "the peer is sent no more";
    std::exchange(wire_.done, nullptr)({});
    EXPECT_LE(waiting(), 1);
  }
  EXPECT_EQ(chunks, snapshot->chunks.size());
}

// A player whose state is there as soon as it is opened.
class InstantLibrary final : public ReplayLibrary {
 public:
  explicit InstantLibrary(std::shared_ptr<const InitialState> initial) : initial_(std::move(initial)) {}
  std::vector<std::string> names() override { return {"a"}; }
  std::unique_ptr<ReplayPlayer> open(const std::string&, ReplayEvents events) override {
    struct Player final : ReplayPlayer {
      void control(const protocol::ReplayControl&) override {}
    };
    events.restarted({}, initial_);
    return std::make_unique<Player>();
  }

 private:
  std::shared_ptr<const InitialState> initial_;
};

// A snapshot that was requested of the replay's state may end with it: the peer must not wait for that one.
TEST_F(PeerTest, AReplayClosedAtOnceLeavesThePeerWithTheLiveMesh) {
  MiniLoop other(box_mesh(12), 4712);
  InstantLibrary library(std::make_shared<const InitialState>(other.initial()));
  providers_.library = &library;
  start(2);
  join(hello(Role::Viewer, View::Volume));
  // Reads until `wanted` says so of a message.
  const auto read_until = [&](const std::function<bool(const protocol::Body&)>& wanted) {
    return run_until([&] {
      bool found = false;
      if (wire_.done) std::exchange(wire_.done, nullptr)({});
      for (const SharedFrame& frame : std::exchange(wire_.reads, {}))
        found = wanted(protocol::decode(frame->body()).message->body) || found;
      return found;
    });
  };
  const auto live_snapshot = [&](const protocol::Body& body) {
    const auto* end = std::get_if<protocol::SnapshotEnd>(&body);
    return end && end->state_hash == loop_->state_hash();
  };
  const auto control = [&](protocol::ReplayAction action) {
    protocol::ReplayControl message;
    message.action = action;
    message.capture = "a";
    wire_.sends.push_back(protocol::encode(message, {2, 0}));
    wire_.wake();
  };
  ASSERT_TRUE(read_until(live_snapshot));
  for (int i = 0; i < 10; ++i) {
    control(protocol::ReplayAction::Open);
    ASSERT_TRUE(read_until([](const auto& body) { return std::holds_alternative<protocol::Welcome>(body); }));
    control(protocol::ReplayAction::Close);
    ASSERT_TRUE(read_until(live_snapshot)) << i;
  }
}

// A blade whose poses become what the test says.
class CountedInput final : public PoseInput {
 public:
  explicit CountedInput(const PoseTotals& totals) : totals_(totals) {}
  std::uint32_t number() const override { return 0; }
  std::size_t enqueue(std::span<const protocol::PoseSample> poses, std::int64_t) override {
    return poses.size();
  }
  bool end_stroke(std::int64_t) override { return true; }
  PoseTotals totals() const override { return totals_; }
  protocol::Vec3 heel() const override { return {}; }
  protocol::Vec3 tip() const override { return {}; }

 private:
  const PoseTotals& totals_;
};

// A message is settled when all its poses are, whatever became of them; each new count is reported once.
TEST(OperatorBlade, EachFateOfAPoseIsReportedAndSettlesIt) {
  PoseTotals totals;
  OperatorBlade blade;
  blade.hold(std::make_unique<CountedInput>(totals), "blade");
  const std::vector<protocol::PoseSample> poses(6);
  asio::io_context io;
  asio::co_spawn(io, blade.enqueue(protocol::PoseBatch{poses}, 7, 0, -1), asio::detached);
  io.run();
  const auto report = [&] { return blade.next_report(protocol::Recording::Off); };
  EXPECT_FALSE(report());
  for (std::uint64_t PoseTotals::*fate :
       {&PoseTotals::accepted, &PoseTotals::not_finite, &PoseTotals::not_unit, &PoseTotals::time_not_rising,
        &PoseTotals::queue_full}) {
    ++(totals.*fate);
    const auto told = report();
    ASSERT_TRUE(told);
    EXPECT_EQ(told->through_sequence, 0u);
    EXPECT_EQ(told->accepted + told->not_finite + told->not_unit + told->time_not_rising + told->queue_full,
              totals.settled());
    EXPECT_FALSE(report()) << "it is known";
  }
  ++totals.queue_full;
  const auto told = report();
  ASSERT_TRUE(told);
  EXPECT_EQ(told->through_sequence, 7u);
  EXPECT_EQ(told->queue_full, 2u);
}

}  // namespace
}  // namespace incise::stream
