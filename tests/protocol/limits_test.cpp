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

}  // namespace
}  // namespace incise::protocol
