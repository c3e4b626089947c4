#include "server/stream/snapshot_keeper.hpp"

#include <gtest/gtest.h>

#include <future>
#include <memory>
#include <optional>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::stream {
namespace {

using protocol::View;
using SharedSnapshot = std::shared_ptr<const Snapshot>;

constexpr std::uint32_t kCells = 3;
constexpr double kSide = 0.01 * kCells;

class SnapshotKeeperTest : public ::testing::Test {
 protected:
  SnapshotKeeperTest() {
    keeper.reset(std::make_shared<const InitialState>(MiniLoop(box_mesh(kCells), 7).initial()));
  }
  // The steps of one stroke right through.
  std::vector<std::shared_ptr<const PublishedDelta>> cut() {
    for (const protocol::PoseSample& p : sweep(0.4 * kSide, 60, 1, kSide)) {
      session.push(0, {p.source_ns, {p.position.x, p.position.y, p.position.z}, {1, 0, 0, 0}, p.buttons});
    }
    session.end_stroke(0);
    std::vector<std::shared_ptr<const PublishedDelta>> steps;
    for (;;) {
      core::WorkBudget budget = core::WorkBudget::unlimited();
      auto published = std::make_shared<PublishedDelta>();
      if (session.advance(budget, published->delta) != core::CutSession::Progress::kCommitted) return steps;
      steps.push_back(std::move(published));
    }
  }
  SharedSnapshot ask(View view = View::Volume, const std::optional<protocol::Box>& box = std::nullopt,
                     bool fields = false) {
    std::promise<SharedSnapshot> promise;
    keeper.request(view, box, fields,
                   [&](SharedSnapshot snapshot) { promise.set_value(std::move(snapshot)); });
    return promise.get_future().get();
  }
  static protocol::Replica loaded(const Snapshot& snapshot) {
    protocol::Replica replica;
    EXPECT_TRUE(replica.begin(snapshot.begin));
    for (const SharedFrame& chunk : snapshot.chunks) {
      EXPECT_TRUE(
          replica.chunk(std::get<protocol::SnapshotChunk>(protocol::decode(chunk->body()).message->body)));
    }
    EXPECT_TRUE(
        replica.end(std::get<protocol::SnapshotEnd>(protocol::decode(snapshot.end->body()).message->body)));
    return replica;
  }
  static core::CutConfig config() {
    core::CutConfig made;
    made.blade = {{0, 0, 0}, {0, 0, -0.09}};
    return made;
  }

  core::CutSession session{box_mesh(kCells), config()};
  SnapshotKeeper keeper;
};

TEST_F(SnapshotKeeperTest, ASnapshotHasWhatWasPushedBeforeAndNothingAfter) {
  const auto steps = cut();
  ASSERT_GT(steps.size(), 3u);
  std::vector<std::future<SharedSnapshot>> answers;
  const auto request = [&] {
    auto promise = std::make_shared<std::promise<SharedSnapshot>>();
    answers.push_back(promise->get_future());
    keeper.request(View::Volume, std::nullopt, false,
                   [promise](SharedSnapshot snapshot) { promise->set_value(std::move(snapshot)); });
  };
  request();
  for (const auto& step : steps) {
    keeper.apply(step);
    request();
  }
  for (std::size_t i = 0; i < answers.size(); ++i) {
    const SharedSnapshot snapshot = answers[i].get();
    EXPECT_EQ(snapshot->epoch, 7u);
    EXPECT_EQ(snapshot->begin.revision, i);
    const protocol::Replica replica = loaded(*snapshot);
    EXPECT_EQ(replica.compute_state_hash(), i == 0 ? replica.state_hash() : steps[i - 1]->delta.state_hash);
  }
}

TEST_F(SnapshotKeeperTest, ManyShareOneAsLongAsItIsCurrent) {
  const SharedSnapshot first = ask();
  EXPECT_EQ(ask(), first);
  EXPECT_NE(ask(View::Surface), first);
  const protocol::Box box{{0, 0, 0}, {kSide, kSide, kSide / 2}};
  const SharedSnapshot part = ask(View::Volume, box);
  EXPECT_NE(ask(View::Volume, box), part) << "each session changes its own part";
  ASSERT_TRUE(part->part);
  EXPECT_LT(part->bytes, first->bytes);
  EXPECT_EQ(ask(), first) << "a part does not stand for the whole";
  keeper.apply(cut().front());
  const SharedSnapshot next = ask();
  EXPECT_NE(next, first);
  EXPECT_EQ(next->begin.revision, 1u);
}

TEST_F(SnapshotKeeperTest, AResetStartsAnotherSession) {
  const SharedSnapshot before = ask();
  keeper.apply(cut().front());
  keeper.reset(std::make_shared<const InitialState>(MiniLoop(box_mesh(kCells), 8).initial()));
  const SharedSnapshot after = ask();
  EXPECT_EQ(after->epoch, 8u);
  EXPECT_EQ(after->begin.revision, 0u);
  EXPECT_NE(after, before) << "of the same revision, and another session";
}

}  // namespace
}  // namespace incise::stream
