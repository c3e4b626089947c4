#include "server/stream/guess_limiter.hpp"

#include <gtest/gtest.h>

#include <string>

namespace incise::stream {
namespace {

using boost::asio::ip::make_address;
constexpr std::int64_t kMs = 1'000'000, kSecond = 1000 * kMs;

TEST(GuessLimiter, TheAnswerIsHeldBackTwiceAsLongEachTimeUpToAMost) {
  GuessLimiter limiter;
  const auto from = make_address("192.0.2.1");
  std::int64_t now = kSecond;
  for (const std::int64_t delay_ms : {0, 0, 0, 250, 500, 1000, 2000, 4000, 4000, 4000}) {
    EXPECT_EQ(limiter.closed_for(from, now), 0);
    EXPECT_EQ(limiter.note_wrong(from, now), delay_ms * kMs);
    now += delay_ms * kMs;
  }
  EXPECT_EQ(limiter.note_wrong(make_address("192.0.2.2"), now), 0) << "another address waits for nothing";
}

TEST(GuessLimiter, ManyAtOnceAreNotLookedAtAndNobodyIsShutOutForLongerThanTheDelay) {
  GuessLimiter limiter;
  const auto from = make_address("192.0.2.1");
  const std::int64_t now = kSecond;
  std::size_t looked_at = 0;
  for (int i = 0; i < 10'000; ++i) {
    if (limiter.closed_for(from, now) > 0) continue;
    ++looked_at;
    limiter.note_wrong(from, now);
  }
  EXPECT_EQ(looked_at, GuessLimiter::kFreeGuesses + GuessLimiter::kSlots);
  // Hanging up does not help: a slot is taken until its time.
  const std::int64_t first = limiter.closed_for(from, now);
  EXPECT_LT(first, GuessLimiter::kFirstDelay_ns) << "a slot is free before its guesser knows";
  EXPECT_EQ(limiter.closed_for(from, now + first), 0);
  // Guessed all the time from there on, as fast as it goes, for a minute.
  looked_at = 0;
  for (std::int64_t t = now + 4 * kSecond; t < now + 64 * kSecond; t += kMs) {
    EXPECT_LE(limiter.closed_for(from, t), GuessLimiter::kMaxDelay_ns);
    while (limiter.closed_for(from, t) == 0) {
      ++looked_at;
      limiter.note_wrong(from, t);
    }
  }
  EXPECT_LE(looked_at, 20 * GuessLimiter::kSlots) << "60 s in turns of 3";
  EXPECT_EQ(limiter.closed_for(from, now + 68 * kSecond), 0);
}

TEST(GuessLimiter, ForgetsWithTime) {
  GuessLimiter limiter;
  const auto from = make_address("192.0.2.1");
  std::int64_t now = kSecond;
  for (int i = 0; i < 30; ++i) limiter.note_wrong(from, now);
  now += GuessLimiter::kForget_ns;
  EXPECT_EQ(limiter.note_wrong(from, now), GuessLimiter::kMaxDelay_ns);
  now += 2 * GuessLimiter::kForget_ns;
  EXPECT_EQ(limiter.note_wrong(from, now), GuessLimiter::kMaxDelay_ns / 2);
  now += 100 * GuessLimiter::kForget_ns;
  EXPECT_EQ(limiter.note_wrong(from, now), 0);
}

TEST(GuessLimiter, AnAddressIsASubscribersNetworkHoweverItCame) {
  GuessLimiter limiter;
  const auto guess = [&](const char* address, int times) {
    std::int64_t delay = 0;
    for (int i = 0; i < times; ++i) delay = limiter.note_wrong(make_address(address), kSecond);
    return delay;
  };
  EXPECT_EQ(guess("2001:db8:0:1::5", 3), 0);
  EXPECT_GT(guess("2001:db8:0:1:ffff::6", 1), 0);
  EXPECT_EQ(guess("2001:db8:0:2::5", 1), 0);
  EXPECT_EQ(guess("192.0.2.7", 3), 0);
  EXPECT_GT(guess("::ffff:192.0.2.7", 1), 0);
}

TEST(GuessLimiter, RemembersSoManyAddressesAndForgetsTheQuietest) {
  GuessLimiter limiter;
  const auto address = [](std::uint32_t i) {
    return boost::asio::ip::address(boost::asio::ip::make_address_v4(0x0a000000 + i));
  };
  std::int64_t now = kSecond;
  for (int i = 0; i < 5; ++i) limiter.note_wrong(address(0), now);
  for (std::uint32_t i = 1; i < 3 * GuessLimiter::kMaxAddresses; ++i) {
    limiter.note_wrong(address(i), ++now);
    if (i % 1000 != 0) continue;
    EXPECT_GT(limiter.note_wrong(address(0), ++now), 0) << "who goes on is not forgotten";
  }
  EXPECT_EQ(limiter.addresses(), GuessLimiter::kMaxAddresses);
}

}  // namespace
}  // namespace incise::stream
