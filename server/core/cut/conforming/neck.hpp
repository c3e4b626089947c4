#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

// The tissue around a face that alone holds two parts together, as points on a grid, and the ways between them that the swept surfaces block, those of
// older strokes as well, and the boundary. Says what the mesh cannot: whether the parts hang together by more than that face would have it. A lobe of the
// body as it grew hangs together by a face at the skin as well.
class Neck {
 public:
  explicit Neck(CutContext& cut) : cut_(cut), mesh_(cut.mesh), pass_(cut.workspace) {}

  enum class Answer { kApart, kTogether, kUnknown };
  // Whether the surfaces part what lies on the two sides of a face, which hang together in no other way than through faces that are about
  // to open. Looks around the face. Some 0.5 ms, up to 3 where a hand has been at it for long. kUnknown: the face is so large that too little would be seen
  // of what is around it.
  Answer judge(HalfFace h);
  // The same where one of the sides is known to its end: `part`, on the other side of h. Looks at all of it, some 0.1 ms for a cubic h. kUnknown: it is too
  // large for that, or there is next to nothing of one of the sides.
  Answer judge(HalfFace h, std::span<const TetId> part);

 private:
  // What a rim may be led on to, and a box around all that is as near to it as that.
  struct Triangle {
    Vec3 a, b, c;
    Box around;
  };
  struct Swept {
    const SweptMemory::Quad* quad;
    Box around;
  };
  // What is near some rims: of the skin, or of a sweep's quad.
  struct Wall {
    Triangle triangle;
    const SweptMemory::Quad* quad;
  };
  // How many points lie on each side, and between other faces that are about to open.
  using Counts = std::array<std::size_t, 3>;

  double gap_m() const { return tolerance::kOne_h * cut_.h; }
  Box box_of(TetId t) const;
  Vec3 to_grid(const Vec3& p) const { return (1 / step_m_) * (p - box_.low); }
  std::array<int, 2> range(double low, double high, int axis) const;
  std::size_t point(int i, int j, int k) const {
    const auto at = [](int n) { return static_cast<std::size_t>(n); };
    return first_ + at(i) + step_[1] * at(j) + step_[2] * at(k);
  }
  void lay_out(const Box& box, double step_m);
  bool lay_out_finely(const Box& box);
  std::size_t fill(TetId from, std::uint8_t side);
  std::size_t fill(std::span<const TetId> tets, std::uint8_t side);
  std::size_t fill_between();
  void take_beyond(TetId t, bool through);
  std::size_t fill_tet(TetId t, std::uint8_t side);
  void block_swept();
  void leave_out_thin(Counts& counts);
  void lead_on(const Vec3& a, const Vec3& b, const Vec3& away, const Vec3& normal,
               const SweptMemory::Quad& sweep);
  void list_walls(const Box& rims);
  void list_beside(const Box& rim, const SweptMemory::Quad& sweep);
  bool is_near_beside(const Vec3& p) const;
  void block(const Vec3& a, const Vec3& b, const Vec3& c);
  double shared(const Counts& counts);
  Counts follow(std::size_t first);

  CutContext& cut_;
  const TetMesh& mesh_;
  TetPass pass_;

  // Point (i, j, k) is at box_.low + step_m_ (i, j, k), and number first_ + i + step_[1] j + step_[2] k. Around them is a layer of points on neither
  // side, at which every way ends.
  Box box_;
  double step_m_ = 1;
  std::array<int, 3> points_{};  // along each axis
  std::array<std::size_t, 3> step_{};
  std::size_t first_ = 0;
  // By point: 1 or 2, 3 between other faces that are about to open, 0 where there is no tissue, or the point has been followed.
  std::vector<std::uint8_t> sides_;
  std::vector<std::uint8_t> walls_;  // by point: bit a, the way to the next one along axis a is blocked
  std::vector<Triangle> skin_;       // of the tissue there
  std::vector<Swept> near_;          // what was swept there
  std::vector<Wall> walls_beside_;   // of both, what is near some rims
  std::vector<Triangle> beside_;     // of these, what one rim may be led on to
  std::vector<TetId> filled_;        // the tetrahedra whose points are laid out
  std::vector<TetId> tets_;          // scratch
  std::vector<std::size_t> queue_;   // scratch
};

}  // namespace incise::core
