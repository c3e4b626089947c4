#include "server/app/replay_tail.hpp"

#include <gtest/gtest.h>

#include "protocol/replica.hpp"
#include "server/app/stream_setup.hpp"
#include "server/stream/delta_arrays.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::app {
namespace {

constexpr std::uint64_t kSession = 77;

// A box that strokes cut, as a resumed server replays it.
class ReplayTailTest : public ::testing::Test {
 protected:
  void replay(int strokes, std::size_t max_bytes) {
    constexpr std::uint32_t kCells = 6;
    core::CutConfig config;
    config.blade = {{0, 0, 0}, {0, 0, -0.09}};
    session_ = std::make_unique<core::CutSession>(stream::box_mesh(kCells), config);
    ReplayTail tail(*session_, kSession, max_bytes);
    for (int stroke = 1; stroke <= strokes; ++stroke) {
      for (const protocol::PoseSample& p :
           stream::sweep(0.06 * stroke / (strokes + 1), 60, std::int64_t{stroke} * 1'000'000'000, 0.06)) {
        session_->push(0, {p.source_ns, {p.position.x, p.position.y, p.position.z}, {1, 0, 0, 0}, p.buttons});
      }
      core::Delta delta;
      core::WorkBudget budget = core::WorkBudget::unlimited();
      while (session_->advance(budget, delta) == core::CutSession::Progress::kCommitted)
        tail.note(*session_, delta);
    }
    tail_ = tail.finish(*session_);
  }
  // Whether the deltas lead from the state before to the session's, without a gap.
  void expect_leads_to_the_end() {
    protocol::Replica replica(protocol::kMaxVertices, protocol::kMaxTets);
    ASSERT_EQ(tail_.before.epoch, kSession);
    ASSERT_EQ(stream::load_initial(tail_.before, replica), "");
    stream::DeltaArrays arrays;
    for (const auto& delta : tail_.deltas) {
      const protocol::ApplyResult result = replica.apply(arrays.assign(*delta, replica));
      ASSERT_TRUE(result) << result.text;
    }
    EXPECT_EQ(replica.revision(), session_->revision());
    EXPECT_EQ(replica.compute_state_hash(), session_->mesh().state_hash());
  }

  std::unique_ptr<core::CutSession> session_;
  ReplayTail::Tail tail_;
};

TEST_F(ReplayTailTest, AShortReplayIsKeptWhole) {
  replay(2, 64 << 20);
  ASSERT_GT(session_->revision(), 4u);
  EXPECT_EQ(tail_.before.revision, 0u);
  EXPECT_EQ(tail_.deltas.size(), session_->revision());
  expect_leads_to_the_end();
}

TEST_F(ReplayTailTest, OfALongReplayTheLastStepsAreKept) {
  replay(8, 64 << 10);
  EXPECT_GT(tail_.before.revision, 0u);
  EXPECT_GT(tail_.deltas.size(), 0u);
  EXPECT_LT(tail_.deltas.size(), session_->revision());
  expect_leads_to_the_end();
}

TEST_F(ReplayTailTest, WithoutStepsTheStateIsTheSessions) {
  replay(0, 64 << 10);
  EXPECT_TRUE(tail_.deltas.empty());
  expect_leads_to_the_end();
}

}  // namespace
}  // namespace incise::app
