#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/grid_rows.hpp"

namespace incise::core {

// The tissue in a box as points on a grid, and the ways between neighbouring points that the boundary and what was swept block, by all strokes: what the
// mesh cannot say of itself where cuts meet.
//
// Point (i, j, k) is at box().low + step_m() (i, j, k). Around the points is a layer of others that are in no tissue, at which every way ends.
class TissueGrid {
 public:
  // Bits of walls: along axis a the way from a point to the next one is blocked, by whatever it is; by the skin.
  static constexpr unsigned kBlocked = 1, kBlockedBySkin = 8;

  // What was swept there, and a box around all that is as near to it as what is one.
  struct Swept {
    const SweptMemory::Quad* quad;
    Box around;
  };

  explicit TissueGrid(CutContext& cut) : cut_(cut), mesh_(cut.mesh) {}

  // Begins with a box: no tissue, nothing blocked. Its low corner is moved aside by next to nothing.
  void lay_out(const Box& box, double step_m);
  const Box& box() const { return box_; }
  double step_m() const { return step_m_; }
  std::size_t size() const { return sides_.size(); }
  Vec3 place(std::size_t at) const {
    const double i = static_cast<double>(at % step_[1]), j = static_cast<double>(at % step_[2] / step_[1]),
                 k = static_cast<double>(at / step_[2]);
    return box_.low + step_m_ * (Vec3{i, j, k} - Vec3{1, 1, 1});
  }
  // How far apart in all lists two points are that are neighbours along an axis.
  std::size_t step(std::size_t axis) const { return step_[axis]; }
  // By point: 0 where there is no tissue, else what the caller has put there.
  std::vector<std::uint8_t>& sides() { return sides_; }
  bool is_blocked(std::size_t at, std::size_t axis, unsigned by = kBlocked) const {
    return (walls_[at] & by << axis) != 0;
  }
  // What block_swept() has found in the box.
  std::span<const Swept> swept() const { return near_; }

  Box box_of(TetId t) const;
  // Calls visit(point) for those in a tetrahedron.
  template <class Visit>
  void each_point(TetId t, Visit visit) const {
    Vec3 p[4];
    const auto& v = mesh_.vertices(t);
    for (int i = 0; i < 4; ++i) p[i] = to_grid(mesh_.position(v[i]));
    Vec3 low = p[0], high = p[0];
    for (int i = 1; i < 4; ++i) extend(p[i], low, high);
    // Of the small ones beside cuts many have no point.
    const auto across = range(low.x, high.x, 0), js = range(low.y, high.y, 1), ks = range(low.z, high.z, 2);
    if (across[0] > across[1] || js[0] > js[1] || ks[0] > ks[1]) return;
    GridRows rows;
    for (int f = 0; f < 4; ++f) {
      const Vec3& a = p[(f + 1) % 4];
      Vec3 inward = cross(p[(f + 2) % 4] - a, p[(f + 3) % 4] - a);
      if (dot(inward, p[f] - a) < 0) inward = -inward;
      rows.add(inward.x, {dot(inward, a), -inward.y, -inward.z}, std::abs(inward.y) + std::abs(inward.z));
    }
    for (int k = ks[0]; k <= ks[1]; ++k) {
      for (int j = js[0]; j <= js[1]; ++j) {
        const std::size_t row = point(0, j, k);
        rows.each_inside(j, k, across[0], across[1],
                         [&](int i) { visit(row + static_cast<std::size_t>(i)); });
      }
    }
  }
  // Puts a number at the points in a tetrahedron that have none, and blocks the ways through its faces at the boundary. Returns how many points there were.
  std::size_t fill(TetId t, std::uint8_t side);
  // When all is filled: blocks the ways through what was swept, and those through gaps to the skin or another sweep that are no wider than what is one.
  void block_swept();

 private:
  // What a rim may be led on to, a box around all that is as near to it as that, and its plane.
  struct Triangle {
    Vec3 a, b, c;
    Box around;
    Vec3 normal;  // of length 1, or none where it is next to a line
    double offset;
  };
  // Of what was swept from a to b. It may be led on away from the sweep, and to either side of it.
  struct Rim {
    Vec3 a, b, away, normal;
    std::uint32_t stroke;
    double travel_m;
    Box around() const { return Box::around({a, b}); }
  };
  // What is near some rims: of the skin, or of a sweep's quad.
  struct Wall {
    Triangle triangle;
    const SweptMemory::Quad* quad;
  };

  double gap_m() const { return tolerance::kOne_h * cut_.h; }
  Vec3 to_grid(const Vec3& p) const { return (1 / step_m_) * (p - box_.low); }
  std::array<int, 2> range(double low, double high, int axis) const;
  std::size_t point(int i, int j, int k) const {
    const auto at = [](int n) { return static_cast<std::size_t>(n); };
    return first_ + at(i) + step_[1] * at(j) + step_[2] * at(k);
  }
  static Triangle wall(const Vec3& a, const Vec3& b, const Vec3& c, const Box& around);
  void list_rims();
  void lead_on(const Rim& rim);
  void list_walls(const Box& rims);
  void list_beside(const Rim& rim);
  bool is_near_beside(const Vec3& p) const;
  void block(const Vec3& a, const Vec3& b, const Vec3& c, unsigned by = kBlocked);

  CutContext& cut_;
  const TetMesh& mesh_;

  Box box_;
  double step_m_ = 1;
  std::array<int, 3> points_{};  // along each axis
  std::array<std::size_t, 3> step_{};
  std::size_t first_ = 0;  // point (0, 0, 0)
  std::vector<std::uint8_t> sides_;
  std::vector<std::uint8_t> walls_;
  std::vector<Triangle> skin_;  // of the tissue there
  std::vector<Swept> near_;
  std::vector<Rim> rims_;
  std::vector<Wall> walls_beside_;  // of both, what is near some rims
  std::vector<Triangle> beside_;    // of these, what one rim may be led on to
};

}  // namespace incise::core
