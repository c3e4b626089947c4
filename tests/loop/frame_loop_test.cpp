#include "server/loop/frame_loop.hpp"

#include <gtest/gtest.h>

#include <map>
#include <thread>
#include <vector>

#include "server/base/clock.hpp"
#include "server/core/mesh/measure.hpp"
#include "tests/loop/rig.hpp"
#include "tests/support/bodies.hpp"

namespace incise::loop {
namespace {

using core::Policy;
using input::PoseSources;
using input::TimedPose;

void cut_through(core::CutSession& session) {
  for (int i = 0; i < 100; ++i) session.push(0, {1 + i * 1'000'000, {0.05, -0.02 + 1.4e-3 * i, 0.11}, {}, 1});
  session.end_stroke(0);
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
  }
}

// As after a restart: what was cut before counts, as it does for a viewer that joins.
TEST(FrameLoop, ASessionThatGoesOnBeginsWithTheCutsOfItsBody) {
  core::CutSession session(tests::cube(4), config(core::Policy::kConforming));
  cut_through(session);
  const core::CutReport there = core::measure(session.mesh());
  ASSERT_GT(there.cut_faces, 10u);
  input::PoseSources sources(tests::long_blade(), {});
  Kept kept;
  FrameLoop loop(session, sources, kept, nullptr, {});
  const LoopState state = loop.stats().state.load();
  EXPECT_EQ(state.cut_faces, there.cut_faces);
  EXPECT_NEAR(state.cut_area_m2, there.cut_area, 1e-12);
  EXPECT_EQ(state.strokes, 0u);
}

TEST(FrameLoop, CutsThatABodyComesWithCountAtTheStartAndAfterAReset) {
  core::CutSession session(tests::cube(4), config(Policy::kConforming));
  cut_through(session);
  const core::CutReport there = core::measure(session.mesh());
  const core::MeshData body = session.mesh().export_data();
  Rig rig(Policy::kConforming, body);
  EXPECT_EQ(rig.loop.stats().state.load().cut_faces, there.cut_faces);
  rig.loop.offer_reset([&] { return std::make_unique<core::CutSession>(body, config(Policy::kConforming)); },
                       [](std::unique_ptr<core::CutSession>) { return 1; });
  ASSERT_TRUE(rig.loop.request_reset());
  rig.loop.frame(monotonic_ns());
  rig.loop.frame(monotonic_ns());
  EXPECT_EQ(rig.loop.stats().state.load().cut_faces, there.cut_faces);
  EXPECT_NEAR(rig.loop.stats().state.load().cut_area_m2, there.cut_area, 1e-12);
}

// Forces only look: a session cuts the same with and without them.
TEST(FrameLoop, ForcesChangeNoCut) {
  for (const Policy policy : {Policy::kConforming, Policy::kCroll}) {
    const core::MeshData mesh = tests::cube(6);
    const auto poses = tests::sweep_through(300);
    Rig rig(policy, mesh);
    haptics::ForceSlots slots;
    struct : haptics::ForceSink {
      void feel(const haptics::BladeForce& force) noexcept override {
        most = std::max(most, force.feel.engagement.length_m);
      }
      double most = 0;
    } sink;
    rig.loop.offer_forces({}, std::make_unique<haptics::Tissue>(mesh), &sink, &slots);
    {
      auto source = rig.sources.open("blade");
      for (const TimedPose& pose : timed(poses)) {
        ASSERT_EQ(source->enqueue(std::span(&pose, 1)), 1u);
        rig.loop.frame(monotonic_ns());
      }
    }
    rig.loop.finish();
    rig.read();
    EXPECT_EQ(rig.hashes, without_loop(policy, mesh, poses));
    EXPECT_NEAR(sink.most, 0.1, 0.005) << "croll snaps the boundary, too";
    haptics::ForceCommand command;
    EXPECT_TRUE(slots[0].read(command));
    EXPECT_GT(rig.loop.stats().force.count(), 300u);
  }
}

// An engaged blade presses until the tissue yields at the stated force, and cuts from there on; withdrawn it presses again. What was
// decided is in the poses that are recorded: a replay without forces has the same hashes.
TEST(FrameLoop, TissueResistsThenYieldsAndAReplayNeedsNoForces) {
  const core::MeshData mesh = tests::cube(6);
  core::CutConfig cut = config(Policy::kConforming);
  cut.blade = {{0, 0, 0}, {0, 0, -0.05}};
  std::vector<JournalRecord> records;
  Hashes hashes;
  double largest = 0;  // force while it was held
  {
    core::CutSession session(mesh, cut);
    PoseSources sources(cut.blade);
    Kept kept;
    Journal journal(std::make_unique<Memory>(records), {}, [](const std::string&) {});
    FrameLoop loop(session, sources, kept, &journal, {});
    struct : haptics::ForceSink {
      void feel(const haptics::BladeForce& force) noexcept override { last = force; }
      haptics::BladeForce last;
    } sink;
    haptics::ForceConfig forces;
    forces.resists = true;
    forces.limits.ramp_s = 0;
    forces.limits.slew_n_s = 1e9;
    forces.limits.silence_s = 1e6;
    loop.offer_forces(forces, std::make_unique<haptics::Tissue>(mesh), &sink, nullptr);
    auto source = sources.open("blade");
    core::Pose pose;
    pose.buttons = 1;
    bool cutting = false;
    const auto to = [&](double x, double tip_z) {
      pose.t_ns += 1'000'000;
      pose.position = {x, 0.0512, tip_z + 0.05};
      const input::TimedPose made{pose, monotonic_ns()};
      EXPECT_EQ(source->enqueue(std::span(&made, 1)), 1u);
      loop.frame(monotonic_ns());
      cutting = session.in_stroke(0);
      if (!cutting && sink.last.feel.contact && !sink.last.feel.contact->penetrated)
        largest = std::max(largest, sink.last.feel.force.z);
    };
    // Down until it yields: 0.8 N on 300 N/m and 40 kPa for each metre of edge.
    double z = 0.101;
    for (; z > 0.095 && !cutting; z -= 1e-5) to(0.03, z);
    EXPECT_TRUE(cutting);
    EXPECT_NEAR(largest, forces.materials.tissue.puncture_n, 0.05 * forces.materials.tissue.puncture_n);
    EXPECT_NEAR((300 + 40e3 * (0.1 - z)) * (0.1 - z), 0.8, 0.08) << "where that force is reached";
    for (; z > 0.06; z -= 1e-4) to(0.03, z);
    for (double x = 0.03; x < 0.07; x += 1e-4) to(x, z);
    EXPECT_TRUE(cutting);
    // Out; beside the slit it has to press again.
    for (; z < 0.11; z += 1e-4) to(0.07, z);
    EXPECT_FALSE(cutting);
    for (int i = 0; i < 100; ++i) to(0.07 + 2e-4 * i, z);
    for (; z > 0.0995; z -= 1e-5) to(0.09, z);
    EXPECT_FALSE(cutting);
    EXPECT_GT(sink.last.feel.force.z, 0.05);
    for (; z > 0.09; z -= 1e-5) to(0.09, z);
    EXPECT_TRUE(cutting);
    source.reset();
    loop.finish();
    EXPECT_EQ(journal.close(std::chrono::milliseconds(1000)), "");
    std::uint64_t cut_faces = 0;
    for (const auto& delta : kept.deltas) {
      hashes[delta->delta.revision] = delta->delta.state_hash;
      cut_faces += delta->delta.cut_faces;
    }
    EXPECT_GT(cut_faces, 4u);
  }
  EXPECT_GT(hashes.size(), 3u);
  core::CutSession again(mesh, cut);
  Hashes replayed;
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  int held = 0, cut_poses = 0;
  for (const JournalRecord& record : records) {
    if (record.kind == JournalRecord::Kind::kPose) {
      EXPECT_EQ(again.push(record.source, record.pose), record.verdict);
      (record.pose.buttons == 0 ? held : cut_poses)++;
    }
    if (record.kind == JournalRecord::Kind::kEndStroke) again.end_stroke(record.source);
    while (again.advance(budget, delta) == core::CutSession::Progress::kCommitted)
      replayed[delta.revision] = delta.state_hash;
  }
  EXPECT_EQ(replayed, hashes);
  EXPECT_GT(held, 200);
  EXPECT_GT(cut_poses, 500);
}

// A frame that hangs ends the force of the next one, whatever deadline that one was given.
TEST(FrameLoop, AFrameThatHangsEndsTheForce) {
  const auto pressing = press_until_felt();
  ASSERT_TRUE(pressing) << "there was never a force";
  std::this_thread::sleep_for(std::chrono::milliseconds(30));
  pressing->press();
  EXPECT_EQ(pressing->felt().newtons.z, 0) << "30 ms late: faded in one step";
  EXPECT_NE(pressing->felt().faults & haptics::kLate, 0u);
}

class FrameLoopPolicies : public ::testing::TestWithParam<Policy> {};
INSTANTIATE_TEST_SUITE_P(, FrameLoopPolicies, ::testing::Values(Policy::kConforming, Policy::kCroll),
                         [](const auto& p) { return p.param == Policy::kCroll ? "croll" : "conforming"; });

// "The budget decides when work is done, never what is done."
TEST_P(FrameLoopPolicies, EveryBudgetGivesTheSameHashes) {
  const core::MeshData mesh = tests::cube(6);
  const auto poses = tests::sweep_through(300);
  const Hashes wanted = without_loop(GetParam(), mesh, poses);
  ASSERT_GE(wanted.size(), 5u);
  for (std::int64_t units :
       {std::int64_t{1}, std::int64_t{7}, std::int64_t{100}, std::int64_t{5000}, INT64_MAX}) {
    LoopOptions options;
    options.units_per_frame = units;
    Rig rig(GetParam(), mesh, options);
    {
      auto source = rig.sources.open("blade");
      const auto all = timed(poses);
      for (std::size_t i = 0; i < all.size(); ++i) {  // a pose a frame, as at 1 kHz
        ASSERT_EQ(source->enqueue(std::span(&all[i], 1)), 1u);
        rig.loop.frame(monotonic_ns());
      }
    }
    rig.loop.finish();
    rig.read();
    EXPECT_EQ(rig.hashes, wanted) << units << " units a frame";
    EXPECT_GT(rig.cut_faces, 0u);
    EXPECT_EQ(rig.loop.stats().state.load().state_hash, wanted.rbegin()->second);
    EXPECT_EQ(rig.loop.stats().state.load().backlog_batches, 0u);
  }
}

// 100,000 poses at once, into a queue that holds a twelfth of them, and frames of 50 us: all are taken, none
// twice, and the mesh is that of a run without a limit.
TEST_P(FrameLoopPolicies, ABurstOfPosesIsCarriedOverAndEndsWithTheSameHash) {
  const core::MeshData mesh = tests::cube(6);
  const auto poses = tests::sweep_through(100'000, 100'000);
  const Hashes wanted = without_loop(GetParam(), mesh, poses);
  LoopOptions options;
  options.rate_hz = 4000;
  options.budget_fraction = 0.2;
  Rig rig(GetParam(), mesh, options);
  std::uint64_t carried = 0;
  {
    auto source = rig.sources.open("blade");
    const auto all = timed(poses);
    for (std::size_t pushed = 0; pushed < all.size();) {
      pushed += source->enqueue(std::span(all).subspan(pushed));
      rig.loop.frame(monotonic_ns());
      carried += (rig.loop.stats().state.load().flags & kInputCarried) != 0;
    }
    rig.loop.finish();
    EXPECT_EQ(source->counts().count(core::PoseVerdict::kAccepted), poses.size());
    EXPECT_EQ(source->counts().drained, poses.size());
  }
  EXPECT_GT(carried, 0u);
  rig.read();
  EXPECT_EQ(rig.hashes, wanted);
}

// A mesh ten times too fine for its frames: batches of many frames each, a backlog that is told, the same mesh.
TEST(FrameLoop, AMeshThatIsFarTooFineEndsWithTheSameHash) {
  const core::MeshData mesh = tests::cube(22);
  const auto poses = tests::sweep_through(700);
  const Hashes wanted = without_loop(Policy::kConforming, mesh, poses);
  LoopOptions options;
  options.units_per_frame = 100;  // some 5 us, on any machine
  Rig rig(Policy::kConforming, mesh, options);
  std::uint64_t most_segments = 0, most_recovery_ns = 0;
  {
    auto source = rig.sources.open("blade");
    const auto all = timed(poses);
    for (std::size_t i = 0; i < all.size(); i += 4) {  // poses come at four times the frames' rate
      source->enqueue(std::span(all).subspan(i, std::min<std::size_t>(4, all.size() - i)));
      rig.loop.frame(monotonic_ns());
      const LoopState state = rig.loop.stats().state.load();
      most_segments = std::max(most_segments, state.backlog_segments);
      most_recovery_ns = std::max(most_recovery_ns, state.recovery_ns);
      const double alone_ns = static_cast<double>(state.backlog_ns) / options.budget_fraction;
      EXPECT_NEAR(static_cast<double>(state.recovery_ns), alone_ns, 2)
          << "a frame cuts for a part of its time";
    }
    rig.loop.finish();
    EXPECT_EQ(source->counts().count(core::PoseVerdict::kAccepted), poses.size());
  }
  EXPECT_GT(most_segments, 5u);
  EXPECT_GT(most_recovery_ns, 0u);
  rig.read();
  EXPECT_EQ(rig.hashes, wanted);
  EXPECT_EQ(rig.loop.stats().state.load().backlog_segments, 0u);
}

TEST(FrameLoop, RunsAtItsDeadlinesInAThreadAndEndsCleanly) {
  const core::MeshData mesh = tests::cube(5);
  const auto poses = tests::sweep_through(200);
  const Hashes wanted = without_loop(Policy::kCroll, mesh, poses);
  Rig rig(Policy::kCroll, mesh);
  std::jthread thread([&](const std::stop_token& stop) { rig.loop.run(stop); });
  {
    auto source = rig.sources.open("blade");
    const auto all = timed(poses);
    for (std::size_t pushed = 0; pushed < all.size();) {
      pushed +=
          source->enqueue(std::span(all).subspan(pushed, std::min<std::size_t>(9, all.size() - pushed)));
      std::this_thread::yield();
    }
  }
  while (rig.loop.stats().state.load().frames < 20) std::this_thread::yield();
  thread.request_stop();
  thread.join();
  rig.read();
  EXPECT_EQ(rig.hashes, wanted);
  EXPECT_FALSE(rig.sources.open("late"));
  EXPECT_EQ(rig.loop.stats().frame_work.count(), rig.loop.stats().state.load().frames);
}

// With an hour between frames none would begin within this test.
TEST(FrameLoop, AFrameBeginsWhenPosesArrive) {
  const core::MeshData mesh = tests::cube(3);
  const auto poses = tests::sweep_through(50);
  const Hashes wanted = without_loop(Policy::kCroll, mesh, poses);
  LoopOptions options;
  options.rate_hz = 1.0 / 3600;
  Rig rig(Policy::kCroll, mesh, options);
  std::jthread thread([&](const std::stop_token& stop) { rig.loop.run(stop); });
  auto one = rig.sources.open("one"), other = rig.sources.open("other");
  std::uint64_t frames = 0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    ASSERT_EQ(one->enqueue(timed({poses[i]})), 1u);
    while (one->counts().drained <= i) std::this_thread::yield();
    const std::uint64_t now = rig.loop.stats().frame_work.count();
    EXPECT_LE(now, frames + 3) << "a frame for the pose, and what ends the one before";
    frames = now;
  }
  ASSERT_TRUE(one->end_stroke(monotonic_ns()));
  ASSERT_EQ(other->enqueue(timed({poses[0]})), 1u);
  while (other->counts().drained == 0) std::this_thread::yield();
  thread.request_stop();
  other.reset();
  thread.join();
  rig.read();
  EXPECT_EQ(rig.hashes, wanted);
}

// Poses that are still queued when the server stops are cut all the same, and the stroke is ended.
TEST(FrameLoop, FinishTakesWhatWaitsAndEndsStrokes) {
  const core::MeshData mesh = tests::cube(5);
  const auto poses = tests::sweep_through(200);
  const Hashes wanted = without_loop(Policy::kCroll, mesh, poses);
  Rig rig(Policy::kCroll, mesh);
  auto source = rig.sources.open("blade");
  ASSERT_EQ(source->enqueue(timed(poses)), poses.size());
  rig.loop.finish();
  rig.read();
  EXPECT_EQ(rig.hashes, wanted);
  EXPECT_EQ(rig.loop.stats().state.load().backlog_events, 0u);
}

// A service manager kills what takes minutes to end; what is left has been drained, so a capture has it.
TEST(FrameLoop, FinishLeavesWhatTakesTooLong) {
  const core::MeshData mesh = tests::cube(5);
  LoopOptions options;
  options.longest_finish_ns = 0;
  Rig rig(Policy::kConforming, mesh, options);
  auto source = rig.sources.open("blade");
  const auto poses = tests::sweep_through(200);
  ASSERT_EQ(source->enqueue(timed(poses)), poses.size());
  rig.loop.finish();
  EXPECT_EQ(rig.sources.waiting(), 0u);
  EXPECT_GT(rig.session.backlog_batches(), 0u);
  EXPECT_GT(rig.loop.stats().state.load().backlog_segments, 0u);
}

TEST(FrameLoop, RejectedPosesAreCountedAndChangeNothing) {
  const core::MeshData mesh = tests::cube(5);
  auto poses = tests::sweep_through(200);
  const Hashes wanted = without_loop(Policy::kCroll, mesh, poses);
  auto broken = poses[50];
  broken.position.x = std::numeric_limits<double>::quiet_NaN();
  poses.insert(poses.begin() + 51, broken);
  broken = poses[80];
  broken.orientation.w = 3;
  poses.insert(poses.begin() + 81, broken);
  poses.insert(poses.begin() + 101, poses[100]);  // the same time again
  Rig rig(Policy::kCroll, mesh);
  auto source = rig.sources.open("blade");
  source->enqueue(timed(poses));
  rig.loop.finish();
  rig.read();
  EXPECT_EQ(rig.hashes, wanted);
  const auto counts = source->counts();
  EXPECT_EQ(counts.count(core::PoseVerdict::kNotFinite), 1u);
  EXPECT_EQ(counts.count(core::PoseVerdict::kNotUnit), 1u);
  EXPECT_EQ(counts.count(core::PoseVerdict::kTimeNotIncreasing), 1u);
}

// A source's next owner has a clock of its own; it may well be behind the last one's.
TEST(FrameLoop, TheNextOwnerOfABladeStartsItsOwnClock) {
  Rig rig(Policy::kCroll, tests::cube(5));
  for (int owner = 0; owner < 3; ++owner) {
    auto source = rig.sources.open("blade");
    ASSERT_TRUE(source) << owner;
    source->enqueue(timed(tests::sweep_through(100, 1000, 0.2 + 0.2 * owner)));
    // A frame whose time is up carries the rest of the poses over to the next one.
    do rig.loop.frame(monotonic_ns());
    while (rig.sources.waiting() > 0);
    EXPECT_EQ(source->counts().count(core::PoseVerdict::kAccepted), 100u);
    source.reset();
    rig.loop.frame(monotonic_ns());
  }
  rig.loop.finish();
  EXPECT_EQ(rig.loop.stats().state.load().strokes, 3u);
}

// Where the end of the period is near, the budget is not: a frame cuts one slice, however much budget there is.
TEST(FrameLoop, ALateFrameCutsOneSlice) {
  LoopOptions options;
  options.rate_hz = 1e6;          // periods of a microsecond: every frame is late
  options.budget_fraction = 1e9;  // a budget of a thousand seconds
  Rig rig(Policy::kConforming, tests::cube(6), options);
  auto source = rig.sources.open("blade");
  ASSERT_EQ(source->enqueue(timed(tests::sweep_through(300))), 300u);
  int frames = 0;
  do {
    const std::size_t before = rig.kept.deltas.size();
    rig.loop.frame(monotonic_ns());
    EXPECT_LE(rig.kept.deltas.size(), before + 1) << "frame " << frames;
    ++frames;
  } while (rig.sources.waiting() > 0 || rig.session.backlog_batches() > 0);
  EXPECT_GT(rig.kept.deltas.size(), 5u);
  EXPECT_GE(static_cast<std::size_t>(frames), rig.kept.deltas.size());
}

// A stream that reads nothing stops the cutting, loses nothing, and all goes on when it reads again.
TEST(FrameLoop, AStreamThatDoesNotReadHoldsTheCutAndLosesNothing) {
  const core::MeshData mesh = tests::cube(3);
  core::CutConfig fine = config(Policy::kConforming);
  fine.batch_h = 1e-6;  // a batch for each pose
  core::CutSession session(mesh, fine);
  PoseSources sources(tests::long_blade());
  Kept kept;
  LoopOptions options;
  options.most_unread_deltas = 1000;
  FrameLoop loop(session, sources, kept, nullptr, options);
  auto source = sources.open("blade");
  const auto all = timed(tests::sweep_through(5'000, 10'000, 2.0));  // beside the body
  std::size_t pushed = 0;
  while (pushed < all.size()) {
    pushed += source->enqueue(std::span(all).subspan(pushed));
    loop.frame(monotonic_ns());
  }
  // A frame that was held up takes but some of the poses that wait.
  const auto left = [&] { return session.backlog_batches() > 0 || sources.waiting() > 0; };
  while ((loop.stats().state.load().flags & kDeltasBlocked) == 0 && left()) {
    loop.frame(monotonic_ns());
  }
  EXPECT_NE(loop.stats().state.load().flags & kDeltasBlocked, 0u);
  EXPECT_EQ(kept.deltas.size(), 1000u);
  EXPECT_EQ(session.revision(), 1000u);
  std::uint64_t next = 1;
  while (left()) {
    for (const auto& delta : kept.deltas) EXPECT_EQ(delta->delta.revision, next++);
    kept.deltas.clear();
    loop.frame(monotonic_ns());
  }
  EXPECT_GT(session.revision(), 2000u);
}

// A reset in the middle of a stroke: what was cut is gone, the blade is still there, and what follows is what a fresh
// session makes of the poses after it.
TEST(FrameLoop, AResetStartsAgainFromTheMeshAsLoaded) {
  const core::MeshData mesh = tests::cube(6);
  const auto poses = tests::sweep_through(300);
  const std::size_t half = 150;
  const Hashes wanted = without_loop(Policy::kConforming, mesh, {poses.begin() + half, poses.end()});
  Rig rig(Policy::kConforming, mesh);
  EXPECT_FALSE(rig.loop.request_reset()) << "not offered";
  std::uint64_t resets = 0;
  bool is_ready = false;
  rig.loop.offer_reset(
      [&] {
        return is_ready ? std::make_unique<core::CutSession>(mesh, config(Policy::kConforming)) : nullptr;
      },
      [&](std::unique_ptr<core::CutSession> used) {
        EXPECT_EQ(used, nullptr) << "the first is the rig's own";
        rig.read();  // what was published before the reset came before it
        rig.hashes.clear();
        rig.revision = 0;
        return ++resets;
      });
  auto source = rig.sources.open("blade");
  const auto all = timed(poses);
  for (std::size_t i = 0; i < all.size(); ++i) {
    // What comes until the session is ready is cut in the old one.
    if (i == half - 5) {
      EXPECT_TRUE(rig.loop.request_reset());
    }
    if (i == half) {
      EXPECT_EQ(resets, 0u);
      EXPECT_GT(rig.loop.stats().state.load().revision, 0u);
      is_ready = true;
    }
    source->enqueue(std::span(&all[i], 1));
    rig.loop.frame(monotonic_ns());
  }
  rig.loop.finish();
  rig.read();
  EXPECT_EQ(resets, 1u);
  EXPECT_EQ(rig.hashes, wanted);
  EXPECT_EQ(rig.loop.stats().state.load().state_hash, wanted.rbegin()->second);
}

// Two hands: the order of commits is the order in which poses were drained, so the journal's order replays
// it.
TEST(FrameLoop, TheJournalOfTwoBladesReplaysToTheSameHashes) {
  const core::MeshData mesh = tests::cube(6);
  std::vector<JournalRecord> records;
  Hashes hashes;
  {
    core::CutSession session(mesh, config(Policy::kCroll));
    PoseSources sources(tests::long_blade());
    Kept kept;
    Journal journal(std::make_unique<Memory>(records), {}, [](const std::string&) {});
    LoopOptions options;
    options.units_per_frame = 50;
    FrameLoop loop(session, sources, kept, &journal, options);
    auto left = sources.open("left"), right = sources.open("right");
    const auto a = timed(tests::sweep_through(300, 1000, 0.3)),
               b = timed(tests::sweep_through(400, 1000, 0.62));
    for (std::size_t i = 0; i < b.size(); ++i) {
      if (i < a.size()) left->enqueue(std::span(&a[i], 1));
      right->enqueue(std::span(&b[i], 1));
      if (i % 3 == 0) loop.frame(monotonic_ns());
    }
    loop.finish();
    EXPECT_EQ(journal.close(std::chrono::milliseconds(1000)), "");
    for (const auto& delta : kept.deltas) hashes[delta->delta.revision] = delta->delta.state_hash;
  }
  ASSERT_GE(hashes.size(), 10u);
  core::CutSession replay(mesh, config(Policy::kCroll));
  Hashes marked, replayed;
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  for (const JournalRecord& record : records) {
    switch (record.kind) {
      case JournalRecord::Kind::kOpened:
        replay.set_blade(record.source, tests::long_blade());
        break;
      case JournalRecord::Kind::kPose:
        replay.push(record.source, record.pose);
        break;
      case JournalRecord::Kind::kEndStroke:
        replay.end_stroke(record.source);
        break;
      case JournalRecord::Kind::kCommit:
        marked[record.revision] = record.state_hash;
        break;
      case JournalRecord::Kind::kDeform:
      case JournalRecord::Kind::kReset:
      case JournalRecord::Kind::kUndo:
      case JournalRecord::Kind::kUndoWanted:
      case JournalRecord::Kind::kGap:
      case JournalRecord::Kind::kCheckpoint:
        FAIL() << "none of these happened";
    }
  }
  while (replay.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    replayed[delta.revision] = delta.state_hash;
  }
  EXPECT_EQ(marked, hashes);
  EXPECT_EQ(replayed, hashes);
}

}  // namespace
}  // namespace incise::loop
