// What peers send on its way to the loop: nothing is lost, swapped or sent twice.

#include "server/app/stream_input.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace incise::app {
namespace {

std::vector<protocol::PoseSample> samples(std::size_t count) {
  std::vector<protocol::PoseSample> all(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double x = static_cast<double>(i);
    all[i] = {static_cast<std::int64_t>(i + 1),
              {x, x + 0.25, x + 0.5},
              {0.5, -0.5, 0.5, -0.5},
              static_cast<std::uint32_t>(i % 3)};
  }
  return all;
}

TEST(StreamInput, PosesReachTheLoopAsTheyAreAndInOrder) {
  input::PoseSources sources(core::Blade{}, {}, 512);
  input::PositionsSlot positions;
  const Config config;
  StreamInput input(sources, positions, config);
  const auto pose_input = input.open("hand", std::nullopt);
  ASSERT_TRUE(pose_input);
  EXPECT_FALSE(input.open("hand", std::nullopt)) << "it has an owner";
  const auto all = samples(600);
  // The queue holds 512 events, one of which is the opening.
  EXPECT_EQ(pose_input->enqueue(all, 77), 511u);
  EXPECT_EQ(pose_input->enqueue(std::span(all).subspan(511), 78), 0u);
  EXPECT_FALSE(pose_input->end_stroke(79));
  std::size_t next = 0;
  const auto handle = [&](std::uint32_t source, const input::InputEvent& event) {
    EXPECT_EQ(source, pose_input->number());
    if (event.kind != input::InputEvent::Kind::kPose) return true;
    const core::Pose& pose = event.pose.pose;
    const protocol::PoseSample& sample = all[next];
    EXPECT_EQ(pose.t_ns, sample.source_ns);
    EXPECT_EQ(pose.position, (core::Vec3{sample.position.x, sample.position.y, sample.position.z}));
    EXPECT_EQ(pose.orientation, (core::Quat{0.5, -0.5, 0.5, -0.5}));
    EXPECT_EQ(pose.buttons, sample.buttons);
    EXPECT_EQ(event.pose.arrival_ns, next < 511 ? 77 : 78);
    ++next;
    return true;
  };
  sources.drain(handle);
  EXPECT_EQ(next, 511u);
  EXPECT_EQ(pose_input->enqueue(std::span(all).subspan(next), 78), 89u);
  sources.drain(handle);
  EXPECT_EQ(next, 600u);
}

TEST(StreamInput, TheTotalsTellEachVerdict) {
  input::PoseSources sources(core::Blade{});
  input::PositionsSlot positions;
  const Config config;
  StreamInput input(sources, positions, config);
  const auto pose_input = input.open("", protocol::BladeEdge{{1, 2, 3}, {4, 5, 6}});
  ASSERT_TRUE(pose_input);
  EXPECT_EQ(sources.name_of(pose_input->number()), "blade") << "the name without one";
  EXPECT_EQ(pose_input->heel(), (protocol::Vec3{1, 2, 3}));
  EXPECT_EQ(pose_input->tip(), (protocol::Vec3{4, 5, 6}));
  const std::pair<core::PoseVerdict, int> verdicts[] = {{core::PoseVerdict::kAccepted, 5},
                                                        {core::PoseVerdict::kNewStroke, 4},
                                                        {core::PoseVerdict::kNotFinite, 3},
                                                        {core::PoseVerdict::kNotUnit, 2},
                                                        {core::PoseVerdict::kTimeNotIncreasing, 1}};
  for (const auto& [verdict, times] : verdicts) {
    for (int i = 0; i < times; ++i) sources.acknowledge(pose_input->number(), verdict, 100 + i);
  }
  const stream::PoseTotals totals = pose_input->totals();
  EXPECT_EQ(totals.accepted, 9u);
  EXPECT_EQ(totals.too_fast, 4u);
  EXPECT_EQ(totals.not_finite, 3u);
  EXPECT_EQ(totals.not_unit, 2u);
  EXPECT_EQ(totals.time_not_rising, 1u);
  EXPECT_EQ(totals.settled(), 15u);
  EXPECT_EQ(totals.last_source_ns, 103);
}

TEST(StreamInput, PositionsOfEitherPrecisionReachTheSlotFromOneSimulatorAtATime) {
  input::PoseSources sources(core::Blade{});
  input::PositionsSlot slot;
  const Config config;
  StreamInput input(sources, slot, config);
  auto simulator = input.open_positions();
  ASSERT_TRUE(simulator);
  EXPECT_FALSE(input.open_positions());
  const std::vector<float> single{1, 2, 3, 4, 5, 6};
  const std::vector<double> twice{0.1, 0.2, 0.3};
  const std::vector<std::uint32_t> ids{7, 9};
  protocol::Positions positions;
  positions.frame = 3;
  positions.revision = 4;
  positions.source_ns = 5;
  positions.ids = ids;
  positions.f32 = single;
  simulator->offer(positions, 6);
  const auto first = slot.pop_newest();
  ASSERT_TRUE(first);
  EXPECT_EQ(first->frame, 3u);
  EXPECT_EQ(first->revision, 4u);
  EXPECT_EQ(first->source_ns, 5);
  EXPECT_EQ(first->arrival_ns, 6);
  EXPECT_TRUE(first->single);
  EXPECT_EQ(first->ids, (std::vector<core::VertexId>{7, 9}));
  EXPECT_EQ(first->positions, (std::vector<core::Vec3>{{1, 2, 3}, {4, 5, 6}}));
  positions.ids = {};
  positions.first = 12;
  positions.f32 = {};
  positions.f64 = twice;
  simulator->offer(positions, 7);
  simulator->offer(positions, 8);
  const auto second = slot.pop_newest();
  ASSERT_TRUE(second);
  EXPECT_EQ(second->arrival_ns, 8);
  EXPECT_EQ(second->first, 12u);
  EXPECT_FALSE(second->single);
  EXPECT_TRUE(second->ids.empty());
  EXPECT_EQ(second->positions, (std::vector<core::Vec3>{{0.1, 0.2, 0.3}}));
  EXPECT_EQ(simulator->skipped(), 1u);
  simulator.reset();
  simulator = input.open_positions();
  ASSERT_TRUE(simulator) << "the first has let go";
  EXPECT_EQ(simulator->skipped(), 0u);
}

}  // namespace
}  // namespace incise::app
