#include "server/stream/outbox.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "server/stream/message_rate.hpp"

namespace incise::stream {
namespace {

// Takes one write at a time, which ends when the test says so.
struct FakeTransport final : Transport {
  asio::awaitable<Received> read() override { co_return Received::end(asio::error::eof); }
  void set_max_bytes(std::size_t) override {}
  void write(std::span<const SharedFrame> frames,
             std::function<void(boost::system::error_code)> done) override {
    written.emplace_back(frames.begin(), frames.end());
    end_write = std::move(done);
  }
  asio::awaitable<void> discard() override { co_return; }
  void shut_down(std::shared_ptr<void>) override {}
  void close() override {}
  std::string peer() const override { return "test"; }
  asio::any_io_executor executor() override { return {}; }

  std::vector<std::vector<SharedFrame>> written;
  std::function<void(boost::system::error_code)> end_write;
};

struct OutboxTest : ::testing::Test, Outbox::Owner {
  void on_too_slow(const std::string& what) override { events.push_back(what); }
  void on_written() override { events.emplace_back("written"); }
  void on_last_written() override { events.emplace_back("last"); }
  void on_write_failed() override { events.emplace_back("failed"); }
  std::shared_ptr<void> keep() override { return alive; }

  static SharedFrame ping(std::uint64_t nonce) { return make_frame(protocol::Ping{nonce, 0}); }
  void end_write(boost::system::error_code error = {}) {
    ASSERT_TRUE(transport.end_write);
    std::exchange(transport.end_write, nullptr)(error);
  }

  std::shared_ptr<int> alive = std::make_shared<int>(0);
  FakeTransport transport;
  SharedCounters counters;
  std::vector<std::string> events;
  Outbox outbox{transport, *this, counters};
};

TEST_F(OutboxTest, ForcesGoFirstThenControlThenState) {
  outbox.send(ping(0));  // is being written while the others come
  const SharedFrame state = ping(1), control = ping(2);
  outbox.send_state(state);
  outbox.send(control);
  protocol::Force force;
  force.source = 3;
  outbox.send_force(force);
  force.source = 4;
  outbox.send_force(force);  // replaces the one before
  EXPECT_EQ(transport.written.size(), 1u) << "one write at a time";
  EXPECT_EQ(outbox.state_bytes(), state->tcp().size());
  end_write();
  ASSERT_EQ(transport.written.size(), 2u);
  const std::vector<SharedFrame>& second = transport.written[1];
  ASSERT_EQ(second.size(), 3u);
  const protocol::DecodeResult first = protocol::decode(second[0]->body());
  EXPECT_EQ(std::get<protocol::Force>(first.message->body).source, 4u);
  EXPECT_EQ(second[1], control);
  EXPECT_EQ(second[2], state);
  EXPECT_EQ(events, std::vector<std::string>{"written"});
  end_write();
  EXPECT_EQ(outbox.state_bytes() + outbox.control_bytes(), 0u);
  EXPECT_EQ(outbox.write_began_ns(), 0);
}

TEST_F(OutboxTest, DroppedStateThatIsBeingWrittenStillCounts) {
  outbox.send_state(ping(1));
  outbox.send_state(ping(1));
  const std::size_t one = outbox.state_bytes() / 2;
  outbox.drop_state();
  EXPECT_EQ(outbox.state_bytes(), one);
  end_write();
  EXPECT_EQ(outbox.state_bytes(), 0u);
  EXPECT_EQ(transport.written.size(), 1u);
  EXPECT_EQ(counters.bytes_out, one);
}

TEST_F(OutboxTest, NothingFollowsTheLastFrame) {
  outbox.send(ping(0));
  outbox.send_last(ping(1));
  outbox.send(ping(2));
  outbox.send_state(ping(3));
  outbox.send_force({});
  end_write();
  ASSERT_EQ(transport.written.size(), 2u);
  EXPECT_EQ(transport.written[1].size(), 1u);
  end_write();
  EXPECT_EQ(events.back(), "last");
  EXPECT_FALSE(transport.end_write);
}

TEST_F(OutboxTest, TooManyUnreadAnswersAreReported) {
  const SharedFrame frame = ping(0);
  const std::size_t fit = (1u << 20) / frame->tcp().size();
  for (std::size_t i = 0; i < fit; ++i) outbox.send(frame);
  EXPECT_TRUE(events.empty());
  outbox.send(frame);
  EXPECT_EQ(events.size(), 1u);
}

TEST_F(OutboxTest, AFailedWriteIsReportedOnce) {
  outbox.send(ping(0));
  outbox.send(ping(1));
  end_write(asio::error::broken_pipe);
  EXPECT_EQ(events, std::vector<std::string>{"failed"});
  EXPECT_EQ(transport.written.size(), 1u);
}

TEST_F(OutboxTest, AWriteKeepsItsOwner) {
  const std::weak_ptr<int> owner = alive;
  outbox.send(ping(0));
  alive.reset();
  EXPECT_FALSE(owner.expired());
  transport.end_write = nullptr;
  EXPECT_TRUE(owner.expired());
}

TEST(MessageRate, EachSecondHasItsOwnCount) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  MessageRate rate(3);
  for (int second = 5; second < 8; ++second) {
    const std::int64_t now = second * kSecond;
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(rate.allow(now + i));
    EXPECT_FALSE(rate.allow(now + 3));
  }
}

TEST(MessageRate, TooManyPoseMessagesWaitForTheNextSecond) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  MessageRate rate(1);
  for (std::uint32_t i = 0; i < MessageRate::kMaxPoseMessagesPerSecond; ++i)
    EXPECT_EQ(rate.delay_poses(5 * kSecond).count(), 0);
  EXPECT_EQ(rate.delay_poses(5 * kSecond).count(), 1001);
  EXPECT_EQ(rate.delay_poses(5 * kSecond + kSecond / 2).count(), 501);
  EXPECT_EQ(rate.delay_poses(6 * kSecond).count(), 0);
}

}  // namespace
}  // namespace incise::stream
