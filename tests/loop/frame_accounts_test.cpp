// What the loop says of its work: times, owners, counts; and what it passes over.

#include <gtest/gtest.h>

#include <limits>
#include <mutex>
#include <thread>
#include <vector>

#include "tests/loop/rig.hpp"
#include "tests/oracle/meetings.hpp"

namespace incise::loop {
namespace {

using core::Policy;
using input::TimedPose;

// A batch for each pose, beside the body.
core::CutConfig batch_per_pose() {
  core::CutConfig made = config(Policy::kConforming);
  made.batch_h = 1e-6;
  return made;
}

// Both times are those of its delta; in the statistics each batch counts once.
TEST(FrameAccounts, TheStatisticsOfABatchHaveTheTimesOfItsDelta) {
  core::CutSession session(tests::cube(3), batch_per_pose());
  input::PoseSources sources(tests::long_blade());
  Kept kept;
  LoopOptions options;
  options.units_per_frame = 1;  // a batch is cut some frames after it was drained
  FrameLoop loop(session, sources, kept, nullptr, options);
  auto source = sources.open("blade");
  source->enqueue(timed(tests::sweep_through(100, 1000, 2.0)));
  while (kept.deltas.size() < 5) loop.frame(monotonic_ns());
  loop.finish();
  ASSERT_GT(kept.deltas.size(), 50u);
  std::int64_t drain_ns = 0, cut_ns = 0;
  for (const auto& delta : kept.deltas) {
    drain_ns += delta->drain_ns - delta->arrival_ns;
    cut_ns += delta->cut_ns - delta->arrival_ns;
  }
  EXPECT_LT(drain_ns, cut_ns);
  const LoopStats& stats = loop.stats();
  EXPECT_EQ(stats.pose_to_drain.count(), kept.deltas.size());
  EXPECT_EQ(stats.pose_to_drain.sum_ns(), static_cast<std::uint64_t>(drain_ns));
  EXPECT_EQ(stats.pose_to_cut.count(), kept.deltas.size());
  EXPECT_EQ(stats.pose_to_cut.sum_ns(), static_cast<std::uint64_t>(cut_ns));
}

// However many batches wait, and wherever the oldest stands among them.
TEST(FrameAccounts, ADeltaHasTheArrivalOfThePoseThatCompletedIt) {
  core::CutSession session(tests::cube(3), batch_per_pose());
  input::PoseSources sources(tests::long_blade());
  Kept kept;
  LoopOptions options;
  options.units_per_frame = 1;
  FrameLoop loop(session, sources, kept, nullptr, options);
  auto source = sources.open("blade");
  std::vector<TimedPose> all;
  for (const core::Pose& pose : tests::sweep_through(400, 1000, 2.0)) all.push_back({pose, pose.t_ns});
  ASSERT_EQ(source->enqueue(std::span(all).first(50)), 50u);
  while (kept.deltas.size() < 10) loop.frame(monotonic_ns());
  ASSERT_EQ(source->enqueue(std::span(all).subspan(50)), 350u);
  loop.finish();
  ASSERT_GT(kept.deltas.size(), 300u);
  for (const auto& delta : kept.deltas) {
    if (delta->delta.stroke_ended) continue;  // by no pose
    ASSERT_EQ(delta->arrival_ns, delta->delta.to_t_ns) << "revision " << delta->delta.revision;
  }
}

// Also where batches come in parts, whose deltas have the times of the whole.
TEST(FrameAccounts, PartsOfABatchHaveTheArrivalOfItsLastPose) {
  const core::MeshData body = tests::cube(8);
  const double h = core::TetMesh(body).mean_edge_length();
  const oracle::Meeting meeting = oracle::random_meeting(body, h, "square", 8);
  core::CutSession session(body, oracle::meeting_config(meeting));
  input::PoseSources sources(meeting.blade);
  Kept kept;
  LoopOptions options;
  options.units_per_frame = 5000;
  FrameLoop loop(session, sources, kept, nullptr, options);
  auto source = sources.open("blade");
  for (const auto& stroke : meeting.strokes) {
    for (const core::Pose& pose : stroke) {
      while (source->enqueue(std::vector<TimedPose>{{pose, pose.t_ns}}) == 0) loop.frame(monotonic_ns());
    }
  }
  loop.finish();
  std::size_t parts = 0;
  for (std::size_t i = 0; i < kept.deltas.size(); ++i) {
    const PublishedDelta& now = *kept.deltas[i];
    if (i > 0) {
      const PublishedDelta& before = *kept.deltas[i - 1];
      const bool is_part = now.delta.stroke == before.delta.stroke && now.delta.batch == before.delta.batch;
      parts += is_part;
      if (is_part) {
        EXPECT_EQ(now.arrival_ns, before.arrival_ns);
      }
    }
    // What ends a stroke has been completed by a pose of the next one, or by the end.
    const bool is_last = i + 1 == kept.deltas.size() || kept.deltas[i + 1]->delta.stroke != now.delta.stroke;
    if (!is_last && now.delta.batch < kept.deltas[i + 1]->delta.batch) {
      EXPECT_EQ(now.arrival_ns, now.delta.to_t_ns) << "revision " << now.delta.revision;
    }
  }
  EXPECT_GE(parts, 1u);
  EXPECT_EQ(loop.stats().batches, kept.deltas.size() - parts);
  EXPECT_EQ(loop.stats().state.load().backlog_batches, 0u);
}

// With a budget of a microsecond the first look at the clock is the last one.
TEST(FrameAccounts, AFrameTakesPosesForItsShareOfTheBudgetOnly) {
  LoopOptions options;
  options.rate_hz = 1e6;
  options.budget_fraction = 1;
  Rig rig(Policy::kConforming, tests::cube(2), options);
  auto source = rig.sources.open("blade");
  ASSERT_EQ(source->enqueue(timed(tests::sweep_through(1000, 1000, 2.0))), 1000u);
  while (rig.sources.waiting() > 64) {
    const std::size_t before = rig.sources.waiting();
    rig.loop.frame(monotonic_ns());
    ASSERT_EQ(before - rig.sources.waiting(), 64u);
    EXPECT_NE(rig.loop.stats().state.load().flags & kInputCarried, 0u);
  }
}

// Frames that are far apart by their rate are not late for that.
TEST(FrameAccounts, ASlowLoopIsNotLate) {
  LoopOptions options;
  options.rate_hz = 0.1;
  const std::int64_t ahead_ns = 1'000'000'000;
  const auto pressing = press_until_felt(options, ahead_ns);
  ASSERT_TRUE(pressing);
  std::this_thread::sleep_for(std::chrono::milliseconds(30));
  pressing->press(ahead_ns);
  EXPECT_NE(pressing->felt().newtons.z, 0);
  EXPECT_EQ(pressing->felt().faults & haptics::kLate, 0u);
}

// The journal reports on the poses that it was given, to their owner; the loop only on those that the journal did not get.
TEST(FrameAccounts, ThePosesInAJournalAreToldByIt) {
  for (const bool journalled : {true, false}) {
    std::vector<JournalRecord> records;
    std::mutex mutex;
    std::vector<std::uint32_t> owners;  // guarded by mutex
    Journal journal(
        std::make_unique<Memory>(records), {}, [](const std::string&) {}, nullptr,
        [&](const JournalRecord& pose, bool) {
          const std::scoped_lock lock(mutex);
          if (owners.empty() || owners.back() != pose.owner) owners.push_back(pose.owner);
        });
    core::CutSession session(tests::cube(3), config(Policy::kCroll));
    input::PoseSources sources(tests::long_blade());
    Kept kept;
    FrameLoop loop(session, sources, kept, journalled ? &journal : nullptr, {});
    for (int owner = 0; owner < 2; ++owner) {
      auto source = sources.open("blade");
      source->enqueue(timed(tests::sweep_through(100, 1000, 2.0)));
      do loop.frame(monotonic_ns());
      while (sources.waiting() > 0);
      EXPECT_EQ(source->counts().drained, journalled ? 0u : 100u);
      source.reset();
      loop.frame(monotonic_ns());
    }
    journal.close(std::chrono::milliseconds(1));
    EXPECT_EQ(owners, journalled ? (std::vector<std::uint32_t>{1, 2}) : std::vector<std::uint32_t>());
  }
}

// A cube whose vertices a simulation moves.
struct Soft : Rig {
  explicit Soft(const LoopOptions& options = {}) : Rig(Policy::kConforming, tests::cube(3), options) {
    loop.offer_deformation(slot);
  }
  // Vertex 0 to x, and another one.
  void send(const core::Vec3& first, const core::Vec3& second) {
    const auto positions = slot.buffer();
    ASSERT_TRUE(positions);
    *positions = {};
    positions->frame = ++frame;
    positions->revision = session.revision();
    positions->ids = {0, 1};
    positions->positions = {first, second};
    ASSERT_TRUE(slot.offer(positions));
  }
  input::PositionsSlot slot;
  std::uint64_t frame = 0;
};
const core::Vec3 kNear{-0.001, 0, 0}, kBeside{0.034, -0.001, 0};

// While one set of positions is at work the next waits in the slot, where a newer one takes its place.
TEST(FrameAccounts, OneDeformationAtATimeAndTheNewestNext) {
  LoopOptions options;
  options.units_per_frame = 1;
  Soft soft(options);
  for (int i = 0; i < 3; ++i) {
    soft.send(kNear + core::Vec3{-1e-5 * i, 0, 0}, kBeside);
    soft.loop.frame(monotonic_ns());
  }
  ASSERT_EQ(soft.kept.deltas.size(), 0u) << "the first is still at work";
  while (soft.kept.deltas.size() < 2) soft.loop.frame(monotonic_ns());
  soft.loop.finish();
  EXPECT_EQ(soft.loop.stats().deformations, 2u);
  EXPECT_EQ(soft.kept.deltas.back()->delta.deformation.frame, 3u);
  EXPECT_EQ(soft.slot.skipped(), 1u);
}

TEST(FrameAccounts, VerticesThatMoveAndThoseThatAreHeldAreCounted) {
  Soft soft;
  soft.send(kNear, {std::numeric_limits<double>::quiet_NaN(), 0, 0});
  while (soft.kept.deltas.empty()) soft.loop.frame(monotonic_ns());
  EXPECT_EQ(soft.loop.stats().vertices_moved, 1u);
  EXPECT_EQ(soft.loop.stats().vertices_held, 1u);
  soft.send(kNear, kBeside);
  while (soft.kept.deltas.size() < 2) soft.loop.frame(monotonic_ns());
  EXPECT_EQ(soft.loop.stats().vertices_moved, 2u);
  EXPECT_EQ(soft.loop.stats().vertices_held, 1u);
}

// ---- A reset ----

struct Resettable : Soft {
  explicit Resettable(const LoopOptions& options = {}) : Soft(options) {
    loop.offer_reset(
        [] { return std::make_unique<core::CutSession>(tests::cube(3), config(Policy::kConforming)); },
        [this](const auto&) { return ++resets; });
  }
  std::atomic<std::uint64_t> resets{0};
};

TEST(FrameAccounts, AResetForgetsPositionsOfTheMeshThatWas) {
  Resettable rig;
  rig.send(kNear, kBeside);
  ASSERT_TRUE(rig.loop.request_reset());
  rig.loop.finish();
  EXPECT_EQ(rig.resets, 0u) << "it comes with the next frame";
  rig.loop.frame(monotonic_ns());
  rig.loop.finish();
  EXPECT_EQ(rig.resets, 1u);
  EXPECT_EQ(rig.loop.stats().deformations, 0u);
  EXPECT_EQ(rig.loop.stats().state.load().revision, 0u);
}

TEST(FrameAccounts, AResetLeavesASourceItsOwnBlade) {
  const core::Blade own{{0, 0, 0}, {0, 0, -0.05}};  // it reaches half as deep as the common one
  const auto poses = tests::sweep_through(200);
  core::CutSession plain(tests::cube(3), config(Policy::kConforming));
  plain.set_blade(0, own);
  for (const core::Pose& pose : poses) plain.push(0, pose);
  plain.end_stroke(0);
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  while (plain.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
  }
  Resettable rig;
  auto source = rig.sources.open("blade", own);
  rig.loop.frame(monotonic_ns());
  ASSERT_TRUE(rig.loop.request_reset());
  rig.loop.frame(monotonic_ns());
  ASSERT_EQ(rig.resets, 1u);
  source->enqueue(timed(poses));
  rig.loop.finish();
  EXPECT_EQ(rig.loop.stats().state.load().state_hash, plain.mesh().state_hash());
}

TEST(FrameAccounts, SkippedFramesAreCountedOnAfterAReset) {
  LoopOptions options;
  options.rate_hz = 1e6;  // which no machine keeps
  Resettable rig(options);
  std::jthread thread([&](const std::stop_token& stop) { rig.loop.run(stop); });
  const auto skipped = [&] { return rig.loop.stats().state.load().skipped_frames; };
  while (skipped() < 1000) std::this_thread::yield();
  ASSERT_TRUE(rig.loop.request_reset());
  std::uint64_t last = skipped();
  const auto rises = [&] {
    const std::uint64_t now = skipped();
    EXPECT_GE(now, std::exchange(last, now));
  };
  while (rig.resets == 0) rises();
  const std::uint64_t frames = rig.loop.stats().state.load().frames;
  while (rig.loop.stats().state.load().frames < frames + 10) rises();
  // By hand, where nothing is skipped in between.
  thread.request_stop();
  thread.join();
  const std::uint64_t before = skipped();
  const auto resets = rig.resets.load();
  ASSERT_TRUE(rig.loop.request_reset());
  rig.loop.frame(monotonic_ns());
  EXPECT_GT(rig.resets, resets);
  EXPECT_EQ(skipped(), before);
}

// Each frame takes one and a half periods, in a reset. So after each at least one is skipped, and what ran and was skipped
// never exceeds the periods that have passed. A slow machine skips more and passes, too.
TEST(FrameAccounts, SkippedFramesAreThePeriodsInWhichNoneBegan) {
  constexpr std::uint64_t kFrames = 20;
  constexpr std::int64_t kPeriod_ns = 2'000'000;
  LoopOptions options;
  options.rate_hz = 1e9 / kPeriod_ns;
  Rig rig(Policy::kConforming, tests::cube(2), options);
  std::stop_source stop;
  std::uint64_t frames = 0;
  rig.loop.offer_reset(
      [&] {
        const std::int64_t begin = monotonic_ns();
        if (++frames == kFrames) stop.request_stop();
        rig.loop.request_reset();
        while (monotonic_ns() < begin + kPeriod_ns * 3 / 2) {
        }
        return std::make_unique<core::CutSession>(tests::cube(2), config(Policy::kConforming));
      },
      [](const auto&) { return 1; });
  rig.loop.request_reset();
  const std::int64_t begin = monotonic_ns();
  rig.loop.run(stop.get_token());
  const auto periods = static_cast<std::uint64_t>((monotonic_ns() - begin) / kPeriod_ns);
  const LoopState state = rig.loop.stats().state.load();
  ASSERT_EQ(state.frames, kFrames + 1) << "finish() accounts as a frame";
  EXPECT_GE(state.skipped_frames, kFrames);
  EXPECT_LE(kFrames + state.skipped_frames, periods);
}

}  // namespace
}  // namespace incise::loop
