#include "server/stream/delta_ring.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <memory>
#include <vector>

namespace incise::stream {
namespace {

// A step of 100 bytes for each view.
EncodedStep step(std::uint64_t revision) {
  const auto frame = std::make_shared<const protocol::Frame>(std::vector<std::byte>(100));
  return {revision - 1, revision, 0, frame, frame};
}

TEST(DeltaRing, HoldsTheNewestStepsThatFit) {
  DeltaRing ring(1000);
  for (std::uint64_t r = 1; r <= 5; ++r) ring.append(step(r));
  EXPECT_EQ(ring.size(), 5u) << "a thousand bytes just fit";
  EXPECT_EQ(ring.bytes(), 1000u);
  ring.append(step(6));
  EXPECT_EQ(ring.size(), 5u);
  EXPECT_EQ(ring.bytes(), 1000u);
  for (std::uint64_t r = 1; r <= 5; ++r) EXPECT_EQ(ring.after(r).revision, r + 1);
  ring.clear();
  EXPECT_EQ(ring.size(), 0u);
  EXPECT_EQ(ring.bytes(), 0u);
}

TEST(DeltaRing, CoversFromTheStateBeforeItsOldestStep) {
  DeltaRing ring(1000);
  EXPECT_TRUE(ring.covers(0, 0)) << "nothing is missing";
  EXPECT_FALSE(ring.covers(0, 1));
  for (std::uint64_t r = 1; r <= 7; ++r) ring.append(step(r));  // 3 to 7 are left
  EXPECT_FALSE(ring.covers(1, 7));
  EXPECT_TRUE(ring.covers(2, 7));
  EXPECT_TRUE(ring.covers(6, 7));
  EXPECT_TRUE(ring.covers(7, 7));
  EXPECT_FALSE(ring.covers(8, 7)) << "a peer that claims to be ahead";
  EXPECT_FALSE(ring.covers(2, 8)) << "a step that is not here yet";
}

TEST(DeltaRing, AStepLargerThanTheRingLeavesItEmpty) {
  DeltaRing ring(199);
  ring.append(step(1));
  EXPECT_EQ(ring.size(), 0u);
  EXPECT_EQ(ring.bytes(), 0u);
  EXPECT_FALSE(ring.covers(0, 1));
}

}  // namespace
}  // namespace incise::stream
