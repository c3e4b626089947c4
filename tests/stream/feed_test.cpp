#include "server/stream/feed.hpp"

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <deque>

#include "protocol/replica.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/stream/delta_arrays.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::stream {
namespace {

using protocol::View;

// A feed of a box that two strokes cut.
class FeedTest : public ::testing::Test {
 protected:
  void follow(std::size_t ring_bytes) {
    MiniLoop start(box_mesh(kCells));
    initial_ = std::make_shared<const InitialState>(start.initial());
    feed_ = std::make_unique<Feed>(io_, ring_bytes);
    feed_->reset(initial_);
    core::CutConfig config;
    config.blade = {{0, 0, 0}, {0, 0, -0.09}};
    session_ = std::make_unique<core::CutSession>(box_mesh(kCells), config);
  }
  // One stroke right through, at `y` times the side.
  void cut(double y) {
    constexpr double kSide = 0.01 * kCells;
    for (const protocol::PoseSample& p : sweep(y * kSide, 60, ++strokes_ * 1'000'000'000, kSide)) {
      session_->push(0, {p.source_ns, {p.position.x, p.position.y, p.position.z}, {1, 0, 0, 0}, p.buttons});
    }
    for (;;) {
      core::WorkBudget budget = core::WorkBudget::unlimited();
      auto published = std::make_shared<PublishedDelta>();
      if (session_->advance(budget, published->delta) != core::CutSession::Progress::kCommitted) return;
      feed_->apply(published);
    }
  }
  std::uint64_t hash() const { return session_->mesh().state_hash(); }

  // A frame's message, kept with what its arrays point into.
  template <class T>
  const T& decoded(const SharedFrame& frame) {
    protocol::DecodeResult result = protocol::decode(frame->body());
    EXPECT_TRUE(result) << result.error;
    return std::get<T>(messages_.emplace_back(frame, std::move(*result.message)).second.body);
  }

  static constexpr std::uint32_t kCells = 5;
  boost::asio::io_context io_;
  std::shared_ptr<const InitialState> initial_;
  std::unique_ptr<Feed> feed_;
  std::unique_ptr<core::CutSession> session_;
  std::int64_t strokes_ = 0;
  std::deque<std::pair<SharedFrame, protocol::Message>> messages_;
};

TEST_F(FeedTest, WhoFallsBehindTogetherSharesOneDeltaThatLeadsToTheEnd) {
  follow(64 << 20);
  cut(0.3);
  ASSERT_GT(feed_->mirror().revision(), 2u);
  const SharedFrame first = feed_->coalesced(View::Volume, 0);
  ASSERT_TRUE(first);
  EXPECT_EQ(first, feed_->coalesced(View::Volume, 0)) << "encoded once";
  EXPECT_NE(first, feed_->coalesced(View::Surface, 0));
  EXPECT_NE(first, feed_->coalesced(View::Volume, 1));

  cut(0.7);
  const SharedFrame later = feed_->coalesced(View::Volume, 0);
  ASSERT_TRUE(later);
  EXPECT_NE(first, later) << "what was made before the second stroke is old";
  const protocol::Delta& whole = decoded<protocol::Delta>(later);
  EXPECT_EQ(whole.base_revision, 0u);
  EXPECT_EQ(whole.revision, session_->revision());
  EXPECT_EQ(whole.state_hash, hash());
  protocol::Replica replica, in_two;
  ASSERT_EQ(load_initial(*initial_, replica), "");
  ASSERT_EQ(load_initial(*initial_, in_two), "");
  ASSERT_TRUE(replica.apply(whole));
  EXPECT_EQ(replica.compute_state_hash(), hash());
  ASSERT_TRUE(in_two.apply(decoded<protocol::Delta>(first)));
  ASSERT_TRUE(in_two.apply(decoded<protocol::Delta>(feed_->coalesced(View::Volume, in_two.revision()))));
  EXPECT_EQ(in_two.canonical_bytes(), replica.canonical_bytes());
}

TEST_F(FeedTest, WhatTheRingHasLetGoOfIsCoalescedNoMore) {
  follow(8 << 10);
  cut(0.3);
  const std::uint64_t head = feed_->mirror().revision();
  ASSERT_LT(feed_->ring().size(), head) << "the stroke fits into the ring; the test needs a smaller one";
  EXPECT_FALSE(feed_->ring().covers(0, head));
  EXPECT_TRUE(feed_->ring().covers(head, head));
  EXPECT_TRUE(feed_->ring().covers(head - feed_->ring().size(), head));
}

TEST_F(FeedTest, AResetForgetsTheStepsOfTheRunBefore) {
  follow(64 << 20);
  cut(0.3);
  ASSERT_TRUE(feed_->coalesced(View::Volume, 0));
  feed_->reset(initial_);
  EXPECT_EQ(feed_->mirror().revision(), 0u);
  EXPECT_EQ(feed_->ring().size(), 0u);
  EXPECT_FALSE(feed_->ring().covers(1, 2));
}

TEST_F(FeedTest, ASnapshotIsOfTheStateWhenItWasAskedFor) {
  follow(64 << 20);
  cut(0.3);
  const std::uint64_t asked_at = session_->revision(), hash_then = hash();
  std::shared_ptr<const Snapshot> got;
  feed_->request_snapshot(View::Volume, std::nullopt, false,
                          [&](std::shared_ptr<const Snapshot> snapshot) { got = std::move(snapshot); });
  cut(0.7);
  EXPECT_FALSE(got) << "called before the thread's own turn";
  ASSERT_TRUE(eventually([&] {
    io_.restart();
    io_.poll();
    return got != nullptr;
  }));
  protocol::Replica replica(protocol::kMaxVertices, protocol::kMaxTets);
  ASSERT_TRUE(replica.begin(got->begin));
  for (const SharedFrame& frame : got->chunks) {
    ASSERT_TRUE(replica.chunk(decoded<protocol::SnapshotChunk>(frame)));
  }
  ASSERT_TRUE(replica.end(decoded<protocol::SnapshotEnd>(got->end)));
  EXPECT_EQ(replica.revision(), asked_at);
  EXPECT_EQ(replica.compute_state_hash(), hash_then);
  ASSERT_TRUE(replica.apply(decoded<protocol::Delta>(feed_->coalesced(View::Volume, asked_at))));
  EXPECT_EQ(replica.compute_state_hash(), hash());
}

// A relay's feed: steps come off the wire, single or several in one.
class RelayedFeedTest : public FeedTest {
 protected:
  // The other feed goes on by one delta to where the first is.
  void relay() {
    const std::uint64_t base = relayed_->mirror().revision();
    const SharedFrame frame = feed_->coalesced(View::Volume, base);
    ASSERT_TRUE(frame);
    const auto received = received_delta(decoded<protocol::Delta>(frame));
    ASSERT_TRUE(received);
    relayed_->apply(received);
    EXPECT_EQ(relayed_->mirror().revision(), feed_->mirror().revision());
    EXPECT_EQ(relayed_->mirror().volume().compute_state_hash(), hash());
    EXPECT_EQ(relayed_->mirror().volume().canonical_bytes(), feed_->mirror().volume().canonical_bytes())
        << "with pieces";
    EXPECT_EQ(relayed_->mirror().surface().surface_hash(), feed_->mirror().surface().surface_hash());
    EXPECT_EQ(relayed_->mirror().surface().canonical_bytes(), feed_->mirror().surface().canonical_bytes());
  }
  std::unique_ptr<Feed> relayed_;
};

TEST_F(RelayedFeedTest, HoldsWhatTheLoopsFeedHoldsHoweverTheStepsCame) {
  follow(64 << 20);
  auto mirror = std::make_shared<Mirror>();
  protocol::Replica replica;
  ASSERT_EQ(load_initial(*initial_, replica), "");
  mirror->reset(replica, initial_->epoch, nullptr);
  auto start = std::make_shared<InitialState>();
  start->epoch = initial_->epoch;
  start->mirror = mirror;
  relayed_ = std::make_unique<Feed>(io_, 64 << 20);
  relayed_->reset(start);

  // Boxes that a cut goes through.
  const protocol::Box box{{-1, 0.01, -1}, {0.03, 0.03, 1}};
  BoxPart volume{box, protocol::VolumePart()}, surface{box, protocol::SurfaceReplica()};
  std::get<protocol::VolumePart>(volume.held).load_part(relayed_->mirror().volume(), box);
  std::get<protocol::SurfaceReplica>(surface.held).load_part(relayed_->mirror().surface(), box);

  std::vector<std::uint64_t> stops{0};
  for (const double y : {0.3, 0.5, 0.7}) {  // the second one goes through what the first has cut off
    cut(y);
    relay();
    stops.push_back(relayed_->mirror().revision());
  }
  ASSERT_GT(stops[1], 2u) << "several revisions in one delta";
  EXPECT_EQ(relayed_->ring().size(), 3u);
  for (const std::uint64_t stop : stops) {
    EXPECT_TRUE(relayed_->can_resume(stop, 0)) << stop;
    EXPECT_FALSE(relayed_->can_resume(stop, 4711) && stop != 0) << stop;
  }
  EXPECT_FALSE(relayed_->can_resume(stops[1] + 1, 0)) << "no delta begins within one";

  // Who is behind gets what leads to the same.
  protocol::Replica late;
  ASSERT_EQ(load_initial(*initial_, late), "");
  ASSERT_TRUE(late.apply(decoded<protocol::Delta>(relayed_->coalesced(View::Volume, 0))));
  EXPECT_EQ(late.canonical_bytes(), feed_->mirror().volume().canonical_bytes());
  ASSERT_TRUE(relayed_->part_delta(volume));
  ASSERT_TRUE(relayed_->part_delta(surface));
  protocol::VolumePart whole_volume;
  protocol::SurfaceReplica whole_surface;
  whole_volume.load_part(feed_->mirror().volume(), box);
  whole_surface.load_part(feed_->mirror().surface(), box);
  EXPECT_EQ(std::get<protocol::VolumePart>(volume.held).part_hash(), whole_volume.part_hash());
  EXPECT_EQ(std::get<protocol::SurfaceReplica>(surface.held).surface_hash(), whole_surface.surface_hash());
}

}  // namespace
}  // namespace incise::stream
