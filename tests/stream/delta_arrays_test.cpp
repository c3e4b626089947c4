#include "server/stream/delta_arrays.hpp"

#include <gtest/gtest.h>

namespace incise::stream {
namespace {

TEST(DeltaArrays, AStepHasEachFieldOfItsDelta) {
  PublishedDelta published;
  core::Delta& d = published.delta;
  d.revision = 1;
  d.source = 2;
  d.stroke = 3;
  d.batch = 4;
  d.stroke_ended = true;
  d.from = {{1, 2, 3}, {4, 5, 6}};
  d.to = {{7, 8, 9}, {10, 11, 12}};
  d.from_t_ns = 21;
  d.to_t_ns = 22;
  d.cut_faces = 31;
  d.cut_area = 0.5;
  d.snaps = 32;
  d.splits = 33;
  d.min_dihedral_deg = 34;
  d.max_deviation_h = 0.25;
  d.state_hash = 35;
  published.arrival_ns = 41;
  published.drain_ns = 42;
  published.cut_ns = 43;
  DeltaArrays arrays;
  const protocol::Replica before;
  const protocol::Delta& delta = arrays.assign(published, before);
  ASSERT_EQ(delta.steps.size(), 1u);
  const protocol::Step& step = delta.steps[0];
  EXPECT_EQ(delta.base_revision, 0u);
  EXPECT_EQ(delta.revision, 1u);
  EXPECT_EQ(step.revision, 1u);
  EXPECT_EQ(step.source, 2u);
  EXPECT_EQ(step.stroke, 3u);
  EXPECT_EQ(step.batch, 4u);
  EXPECT_TRUE(step.stroke_ended);
  EXPECT_EQ(step.from_heel.x, 1);
  EXPECT_EQ(step.from_tip.y, 5);
  EXPECT_EQ(step.to_heel.z, 9);
  EXPECT_EQ(step.to_tip.x, 10);
  EXPECT_EQ(step.from_source_ns, 21);
  EXPECT_EQ(step.to_source_ns, 22);
  EXPECT_EQ(step.arrival_ns, 41);
  EXPECT_EQ(step.drain_ns, 42);
  EXPECT_EQ(step.cut_ns, 43);
  EXPECT_EQ(step.cut_faces, 31u);
  EXPECT_EQ(step.cut_area_m2, 0.5);
  EXPECT_EQ(step.snaps, 32u);
  EXPECT_EQ(step.splits, 33u);
  EXPECT_EQ(step.min_dihedral_deg, 34);
  EXPECT_EQ(step.max_deviation_h, 0.25);
  EXPECT_EQ(step.state_hash, 35u);
  EXPECT_EQ(delta.state_hash, 35u);
}

}  // namespace
}  // namespace incise::stream
