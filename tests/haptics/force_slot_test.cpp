#include "server/haptics/force_slot.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>

namespace incise::haptics {
namespace {

TEST(ForceSlot, HasNothingBeforeTheFirstCommand) {
  ForceSlot slot;
  ForceCommand command{{1, 2, 3}, 4, 5};
  EXPECT_FALSE(slot.read(command));
  EXPECT_EQ(command, (ForceCommand{{1, 2, 3}, 4, 5}));
}

TEST(ForceSlot, GivesTheNewestCommandOnce) {
  ForceSlot slot;
  ForceCommand command;
  for (int round = 1; round < 10; ++round) {
    for (int i = 1; i <= round; ++i) slot.write({{1.0 * i, 0, -1.0 * round}, i, 7});
    ASSERT_TRUE(slot.read(command));
    EXPECT_EQ(command, (ForceCommand{{1.0 * round, 0, -1.0 * round}, round, 7}));
    EXPECT_FALSE(slot.read(command));
  }
}

TEST(ForceSlot, TellsOfItsDevice) {
  ForceSlot slot;
  EXPECT_EQ(slot.limit(), 0);
  slot.device_came(3.5);
  EXPECT_EQ(slot.limit(), 3.5);
  slot.write_failed();
  slot.write_failed();
  EXPECT_EQ(slot.failed_writes(), 2u);
  slot.device_lost();
  EXPECT_EQ(slot.limit(), 0);
  EXPECT_EQ(slot.losses(), 1u);
}

// Both sides at full speed: no command is torn, none comes after a newer one, and the last one arrives.
TEST(ForceSlot, TwoThreadsSeeWholeCommandsInOrder) {
  constexpr std::int64_t kCommands = 200'000;
  ForceSlot slot;
  std::jthread writer([&] {
    for (std::int64_t i = 1; i <= kCommands; ++i) {
      const double x = static_cast<double>(i);
      slot.write({{x, 2 * x, -x}, i, static_cast<std::uint32_t>(i)});
    }
  });
  ForceCommand command;
  std::int64_t last = 0;
  while (last < kCommands) {
    if (!slot.read(command)) {
      std::this_thread::yield();
      continue;
    }
    ASSERT_GT(command.time_ns, last);
    last = command.time_ns;
    const double x = static_cast<double>(last);
    ASSERT_EQ(command, (ForceCommand{{x, 2 * x, -x}, last, static_cast<std::uint32_t>(last)}));
  }
}

}  // namespace
}  // namespace incise::haptics
