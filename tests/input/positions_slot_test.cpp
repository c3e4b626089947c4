#include "server/input/positions_slot.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <vector>

namespace incise::input {
namespace {

using core::VertexPositions;

bool offer(PositionsSlot& slot, std::uint64_t frame) {
  const auto buffer = slot.buffer();
  if (!buffer) return false;
  buffer->frame = frame;
  return slot.offer(buffer);
}

TEST(PositionsSlot, TheLoopGetsTheNewestAndTheOthersAreCounted) {
  PositionsSlot slot;
  EXPECT_FALSE(slot.pop_newest());
  EXPECT_TRUE(offer(slot, 1));
  EXPECT_TRUE(offer(slot, 2));
  EXPECT_TRUE(offer(slot, 3));
  const auto newest = slot.pop_newest();
  ASSERT_TRUE(newest);
  EXPECT_EQ(newest->frame, 3u);
  EXPECT_EQ(slot.skipped(), 2u);
  EXPECT_FALSE(slot.pop_newest());
}

// The journal and the checkpoints hold on to what the loop took.
TEST(PositionsSlot, ABufferThatSomebodyHoldsIsNotWrittenInto) {
  PositionsSlot slot;
  std::vector<std::shared_ptr<const VertexPositions>> held;
  for (std::uint64_t frame = 1; frame <= 3; ++frame) {
    ASSERT_TRUE(offer(slot, frame));
    held.push_back(slot.pop_newest());
    ASSERT_TRUE(held.back());
  }
  for (std::uint64_t frame = 1; frame <= 3; ++frame) EXPECT_EQ(held[frame - 1]->frame, frame);
  const VertexPositions* const first = held[0].get();
  held[0].reset();
  EXPECT_EQ(slot.buffer().get(), first) << "free again, and the oldest";
}

TEST(PositionsSlot, FourBuffersInAnyCaseAndMoreWhileTheyFit) {
  const auto fill = [](PositionsSlot& slot, std::vector<std::shared_ptr<const VertexPositions>>& held) {
    const auto buffer = slot.buffer();
    if (!buffer) return false;
    buffer->positions.resize(1000);
    if (!slot.offer(buffer)) return false;
    held.push_back(slot.pop_newest());
    return true;
  };
  std::vector<std::shared_ptr<const VertexPositions>> held;
  PositionsSlot small(1);
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(fill(small, held));
  EXPECT_FALSE(fill(small, held));
  EXPECT_EQ(small.skipped(), 1u);
  held.erase(held.begin());
  EXPECT_TRUE(fill(small, held)) << "the oldest is free again";

  std::vector<std::shared_ptr<const VertexPositions>> more;
  PositionsSlot large(6 * 1000 * sizeof(core::Vec3));
  for (int i = 0; i < 6; ++i) EXPECT_TRUE(fill(large, more)) << i;
  EXPECT_FALSE(fill(large, more));
}

TEST(PositionsSlot, WhatTheQueueCannotTakeIsSkipped) {
  PositionsSlot slot;
  std::uint64_t frame = 0;
  while (offer(slot, frame + 1)) ++frame;
  EXPECT_GE(frame, 8u);
  EXPECT_EQ(slot.skipped(), 1u);
  EXPECT_EQ(slot.pop_newest()->frame, frame);
  EXPECT_EQ(slot.skipped(), frame) << "all but the newest";
}

}  // namespace
}  // namespace incise::input
