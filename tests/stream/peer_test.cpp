#include "server/stream/peer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <deque>
#include <functional>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

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
  bool ended_ = false;
};

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
  context_->live.request_snapshot(View::Volume, std::nullopt, [&](const auto& same) { snapshot = same; });
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

}  // namespace
}  // namespace incise::stream
