#include "server/core/cut/conforming/cut_faces.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

// A body in which faces open here and there.
class CutFacesTest : public ::testing::Test {
 protected:
  void open_some(std::size_t count) {
    std::vector<HalfFace> faces;
    while (faces.size() < count) {
      const auto h = static_cast<HalfFace>(random_.below(4 * mesh_.tet_slots()));
      const HalfFace o = mesh_.opposite(h);
      if (o == kNone || std::ranges::find(faces, h) != faces.end() ||
          std::ranges::find(faces, o) != faces.end())
        continue;
      faces.push_back(h);
      workspace_.grid.add(mesh_, tet_of(h));
      workspace_.grid.add(mesh_, tet_of(o));
    }
    mesh_.open_faces(faces);
    workspace_.grow(mesh_);
    faces_.begin();
  }
  bool is_within(const Vec3& p, double reach) const {
    for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
      for (int f = 0; f < 4; ++f) {
        if (!(mesh_.cut_mask(t) >> f & 1)) continue;
        const auto v = mesh_.face_vertices(half_face(t, f));
        const Vec3 q = closest_point(p, mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]));
        if (squared_length(q - p) <= reach * reach) return true;
      }
    }
    return false;
  }
  // How many of some points are near a face, when both say the same of all of them.
  int count_near(double reach_h) {
    int near = 0;
    for (int i = 0; i < 1000; ++i) {
      const Vec3 p = random_.in_box({-1, -1, -1}, {9, 9, 9});
      const bool expected = is_within(p, reach_h * cut_.h);
      near += expected;
      if (faces_.is_within(p, reach_h * cut_.h) != expected) {
        ADD_FAILURE() << p.x << " " << p.y << " " << p.z << ", reach " << reach_h << " h";
        break;
      }
    }
    return near;
  }

  testing::Random random_{7};
  TetMesh mesh_{testing::shaken_box(8, 8, 8, 7)};
  CutWorkspace workspace_{mesh_};
  CutContext cut_{mesh_, workspace_, CutConfig{}};
  CutFaces faces_{cut_};
};

TEST_F(CutFacesTest, are_found_wherever_a_search_through_all_finds_one) {
  EXPECT_EQ(count_near(0.3), 0);
  open_some(60);
  const int near = count_near(0.3);
  EXPECT_GT(near, 20);
  EXPECT_GT(count_near(tolerance::kFilmReach_h), near);
}

TEST_F(CutFacesTest, that_open_later_are_found_once_the_change_is_told) {
  open_some(20);
  const int before = count_near(0.3);
  open_some(200);
  EXPECT_GT(count_near(0.3), 2 * before);
}

}  // namespace
}  // namespace incise::core
