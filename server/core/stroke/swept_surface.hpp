#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/geometry/box.hpp"
#include "server/core/stroke/swept_tree.hpp"
#include "server/core/stroke/swept_triangle.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The surface that a blade has swept, as triangles in the order in which they were swept, with a tree over them.
class SweptSurface {
 public:
  // Adds the ruled quad between two blade lines, cut into `rows` strips along the motion and `columns` along the
  // blade, each cell as two triangles. Call build() before the next query.
  // Cells beyond the box from `low` to `high`, that of the tissue, are left out.
  // The heel's and the tip's path are rims of the sweep, and so is the line `from` where `first` says so.
  void add_quad(const BladeLine& from, const BladeLine& to, int rows, int columns, std::uint32_t batch,
                bool first, const Vec3& low = {-INFINITY, -INFINITY, -INFINITY},
                const Vec3& high = {INFINITY, INFINITY, INFINITY});
  // The sweep turns at the line `from` of the quad that added these triangles.
  void mark_turn(std::size_t begin, std::size_t end);
  // Adds the quad with these corners in turn, none of whose sides is a rim. `continues`: no blade has swept it.
  void add_strip(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, std::uint32_t batch,
                 bool continues);
  // `latest`: the first triangle of the last batch. `around`: what flat_box() shall hold besides.
  void build(std::size_t latest = SIZE_MAX, const Box* around = nullptr);
  // Forgets all triangles of batches before `oldest`; returns by how much the others' indices become less. Call build() before the next query.
  std::size_t drop_before(std::uint32_t oldest);
  void clear();
  // All of it goes along with the tissue. Call build() before the next query. O(triangles).
  void move(const AffineMotion& motion);

  // One more than the last triangle's index.
  std::size_t size() const { return triangles_.size(); }
  const SweptTriangle& operator[](std::size_t i) const { return triangles_[i]; }
  // Those that are not forgotten.
  std::span<const SweptTriangle> triangles() const {
    return std::span<const SweptTriangle>(triangles_).subspan(first_);
  }

  // Calls visit(index) for each triangle whose box comes nearer than `slack_m` to that around two or four points, in order, until it returns
  // true; returns whether one did. Leaves some of those out on one side of whose plane all the points lie, farther off than that.
  template <std::size_t N, class Visit>
  bool any_between(const Points<N>& points, double slack_m, Visit visit) const {
    return all_.any_between(points, slack_m, [&](std::uint32_t i) {
      if (!visit(i)) return false;
      found_ = i;
      return true;
    });
  }
  // The same for the triangles of the last batch alone.
  template <std::size_t N, class Visit>
  bool any_latest_between(const Points<N>& points, double slack_m, Visit visit) const {
    return latest_.any_between(points, slack_m, visit);
  }

  // build() follows what is read.
  void archive(Archive& io);

  // The closest point of the surface, as it was when it was built, within `reach` of p and its triangle; false if
  // nothing is within reach. `likely`: a triangle near p, if one is known, so that less is looked at.
  bool closest(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle,
               std::uint32_t likely = UINT32_MAX) const;
  // Where it is flat, as a straight sweep leaves it: a triangle whose plane those of all others are no farther off than that within flat_box(),
  // as it was when it was built; else none. O(1).
  const SweptTriangle* flat(double off_m) const {
    return flat_box_.low.x <= flat_box_.high.x && flat_off_m_ <= off_m ? &triangles_[first_] : nullptr;
  }
  const Box& flat_box() const { return flat_box_; }
  // Whether it is flat, and p lies in the planes of all its triangles, to within `clear_m`.
  bool is_in_all_planes(const Vec3& p, double clear_m) const {
    return flat_box_.has(p) && std::abs(triangles_[first_].signed_distance(p)) + flat_off_m_ <= 0.5 * clear_m;
  }
  // Whether there is one.
  bool is_within(const Vec3& p, double reach) const;
  // Whether there is one that a blade has swept.
  bool was_swept_within(const Vec3& p, double reach) const;
  // Whether some of it is straight above or below p, to within `clear_m`, and within `reach`.
  bool is_over(const Vec3& p, double reach, double clear_m) const;
  // A point of the surface straight above or below p, within `reach`: on the triangle that is passed in where p is
  // over that, else the closest point of all.
  bool near(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;

 private:
  // Whether `is` says so of a triangle that may be within `reach` of p.
  template <class Is>
  bool any_near(const Vec3& p, double reach, Is is) const;
  // Leaves out those with one of these bits in `rim`.
  bool is_within(const Vec3& p, double reach, std::uint8_t without) const;

  void find_flat_box(const Box* around);
  // Whether it is flat, and all of it farther off p than `reach`.
  bool is_clearly_beyond(const Vec3& p, double reach) const;
  // Whether a query may find that triangle.
  bool has(std::uint32_t index) const { return index >= first_ && index < built_; }

  std::vector<SweptTriangle> triangles_;
  std::size_t first_ = 0;  // those before are forgotten, but still in all_
  std::size_t built_ = 0;  // so many of them are in all_ as they are
  // Where it is flat a box around it, else one that holds nothing; and how far off the first one's plane the others' are in there.
  static constexpr Box kNowhere{{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  Box flat_box_ = kNowhere;
  double flat_off_m_ = 0;
  SweptTree all_, latest_;
  mutable std::uint32_t found_ =
      0;  // the triangle that a query has found last: the next one asks near there, as a rule
};

}  // namespace incise::core
