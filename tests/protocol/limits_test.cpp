#include "protocol/limits.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "protocol/framing.hpp"

namespace incise::protocol {
namespace {

TEST(Limits, APositionsMessageHasTwoMillionVerticesAtMost) {
  std::vector<float> f32(3 * (kMaxPositionsVertices + 1));
  Positions positions;
  positions.f32 = std::span(f32).first(3 * kMaxPositionsVertices);
  EXPECT_TRUE(decode(encode(positions, {}).body(), kMaxSimulatorBytes));
  positions.f32 = f32;
  const DecodeResult more = decode(encode(positions, {}).body(), kMaxSimulatorBytes);
  EXPECT_FALSE(more);
  EXPECT_NE(more.error.find("Positions"), std::string::npos) << more.error;
}

TEST(Limits, APoseBatchHasEightThousandPosesAtMost) {
  const std::vector<PoseSample> poses(kMaxPosesPerBatch + 1);
  EXPECT_TRUE(decode(encode(PoseBatch{std::span(poses).first(kMaxPosesPerBatch)}).body(), kMaxClientBytes));
  const DecodeResult more = decode(encode(PoseBatch{poses}).body(), kMaxClientBytes);
  EXPECT_NE(more.error.find("PoseBatch.poses"), std::string::npos) << more.error;
}

TEST(Limits, PositionsEndBelowTheLargestVertex) {
  const std::vector<float> f32(6);
  Positions positions;
  positions.f32 = f32;
  positions.first = kMaxVertices - 2;
  EXPECT_TRUE(decode(encode(positions).body()));
  ++positions.first;
  const DecodeResult beyond = decode(encode(positions).body());
  EXPECT_NE(beyond.error.find("Positions.first"), std::string::npos) << beyond.error;
}

TEST(Limits, TrianglesAreNamedByTheirHalfFaces) {
  const std::vector<std::uint32_t> vertices{0, 1, 2}, piece{0};
  const std::vector<std::int32_t> region{0};
  const std::vector<std::uint8_t> flags{0};
  SurfaceDelta delta;
  delta.revision = 1;
  for (const std::uint32_t id : {4 * kMaxTets - 1, 4 * kMaxTets}) {
    const std::vector<std::uint32_t> ids{id};
    delta.triangles = {ids, vertices, flags, piece, region};
    EXPECT_EQ(static_cast<bool>(decode(encode(delta).body())), id < 4 * kMaxTets) << id;
  }
}

}  // namespace
}  // namespace incise::protocol
