#include "server/core/cut/held_faces.hpp"

#include <gtest/gtest.h>

namespace incise::core {
namespace {

HeldFace held(HalfFace face, double off_m) {
  return {face, {}, off_m, false};
}

TEST(HeldFaces, HoldEachFaceOnceAsItWasLast) {
  HeldFaces faces;
  faces.push(held(7, 0.1));
  faces.push(held(8, 0.2));
  faces.push(held(7, 0.3));
  ASSERT_EQ(faces.size(), 2u);
  EXPECT_EQ(faces[0].face, 7u);
  EXPECT_EQ(faces[0].off_m, 0.3);
  faces.clear();
  EXPECT_TRUE(faces.empty());
  faces.push(held(7, 0.4));
  EXPECT_EQ(faces.size(), 1u);
}

TEST(HeldFaces, ForgetTheOldestWhereThereAreTooMany) {
  HeldFaces faces;
  for (HalfFace face = 0; face <= HeldFaces::kMost; ++face) faces.push(held(4 * face, 0));
  ASSERT_EQ(faces.size(), HeldFaces::kMost * 3 / 4 + 1);
  EXPECT_EQ(faces[0].face, HeldFaces::kMost);
  const std::size_t before = faces.size();
  faces.push(held(4 * HeldFaces::kMost, 1));
  EXPECT_EQ(faces.size(), before);
  faces.push(held(0, 1));
  EXPECT_EQ(faces.size(), before + 1);
}

}  // namespace
}  // namespace incise::core
