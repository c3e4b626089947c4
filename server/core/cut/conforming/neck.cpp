#include "server/core/cut/conforming/neck.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

// Looks farther where one of the sides has little of itself near the face: how it lies beside a surface says little about it then. And where most of
// it is parted, but not all: faces of large elements lie beside what was swept, and put tissue near them on the wrong side.
Neck::Answer Neck::judge(HalfFace h) {
  const Vec3 middle = mesh_.face_middle(h);
  double face_m = 0;
  for (VertexId v : mesh_.face_vertices(h)) face_m = std::max(face_m, distance(mesh_.position(v), middle));
  Answer answer = Answer::kUnknown;
  for (double reach_h : kNeckReach_h) {
    const double reach_m = reach_h * cut_.h;
    if (face_m > reach_m) continue;
    lay_out(Box{middle, middle}.widened(reach_m), 2 * reach_m / (kNeckPoints - 1));
    const TetId other = tet_of(mesh_.opposite(h));
    pass_.begin();
    pass_.add(other);
    Counts counts{fill(tet_of(h), 1), fill(other, 2)};
    counts[2] = fill_between();
    grid_.block_swept();
    const double share = shared(counts);
    const bool together = share >= kNeckShared;
    answer = together ? Answer::kTogether : Answer::kApart;
    const double least_h3 =
        static_cast<double>(std::min(counts[0], counts[1])) * std::pow(grid_.step_m() / cut_.h, 3);
    const bool sees_enough = reach_h > kNeckReach_h[0] || least_h3 >= kNeckPart_h3;
    if (share >= kNeckSure || (sees_enough && (!together || share >= kNeckDoubtful))) break;
  }
  return answer;
}

// What is thinner than two steps is left out: it is no neck, and whether points lie in it is chance. Looks farther where next to nothing of what is beside
// the part is near.
Neck::Answer Neck::judge(HalfFace h, std::span<const TetId> part) {
  Box box = grid_.box_of(part[0]);
  for (TetId t : part) box.add(grid_.box_of(t));
  Answer answer = Answer::kUnknown;
  for (double around_h : kPartAround_h) {
    if (!lay_out_finely(box.widened(around_h * cut_.h))) break;
    pass_.begin();
    for (TetId t : part) pass_.add(t);
    Counts counts{fill(tet_of(h), 1), fill(part, 2)};
    counts[2] = fill_between();
    grid_.block_swept();
    leave_out_thin(counts);
    const double beside_h3 = static_cast<double>(counts[0]) * std::pow(kPartStep_h, 3);
    if (counts[1] == 0 || beside_h3 < kPartBeside_h3) continue;
    const double share = shared(counts);
    answer = share >= kPartShared ? Answer::kTogether
             : share < kPartApart ? Answer::kApart
                                  : Answer::kUnknown;
    if (beside_h3 >= kNeckPart_h3) break;
  }
  return answer;
}

bool Neck::lay_out_finely(const Box& box) {
  const double step_m = kPartStep_h * cut_.h;
  const Vec3 size = (1 / step_m) * (box.high - box.low);
  if ((size.x + 1) * (size.y + 1) * (size.z + 1) > kMaxPartPoints) return false;
  lay_out(box, step_m);
  return true;
}

void Neck::lay_out(const Box& box, double step_m) {
  grid_.lay_out(box, step_m);
  cut_.work.add(grid_.size(), cost::kNeckPointsAUnit);
  filled_.clear();
}

// Marks the points in what hangs together with a tetrahedron in the box, and blocks the ways through the boundary there. Returns how many there
// are.
std::size_t Neck::fill(TetId from, std::uint8_t side) {
  tets_.assign(1, from);
  pass_.add(from);
  for (std::size_t i = 0; i < tets_.size(); ++i) take_beyond(tets_[i], false);
  return fill(tets_, side);
}

std::size_t Neck::fill(std::span<const TetId> tets, std::uint8_t side) {
  std::size_t count = 0;
  filled_.insert(filled_.end(), tets.begin(), tets.end());
  for (TetId t : tets) count += grid_.fill(t, side);
  return count;
}

// What hangs together with the two sides through faces that are about to open: a way may lead through it.
std::size_t Neck::fill_between() {
  tets_.clear();
  for (TetId t : filled_) take_beyond(t, true);
  for (std::size_t i = 0; i < tets_.size(); ++i) take_beyond(tets_[i], true);
  return fill(tets_, 3);
}

// Adds the neighbours of t that are in the box and in no list yet; `through`: those beyond a face that is about to open, too.
void Neck::take_beyond(TetId t, bool through) {
  for (int f = 0; f < 4; ++f) {
    const HalfFace o = mesh_.opposite(half_face(t, f));
    if (o == kNone || (!through && cut_.is_pending(o))) continue;
    if (pass_.insert(tet_of(o)) && grid_.box_of(tet_of(o)).meets(grid_.box())) tets_.push_back(tet_of(o));
  }
}

// Leaves out the points that lie between two blocked ways of an axis.
void Neck::leave_out_thin(Counts& counts) {
  std::vector<std::uint8_t>& sides = grid_.sides();
  for (std::size_t at = 0; at < sides.size(); ++at) {
    if (sides[at] == 0) continue;
    bool thin = false;
    for (std::size_t axis = 0; axis < 3; ++axis)
      thin = thin || (grid_.is_blocked(at, axis) && grid_.is_blocked(at - grid_.step(axis), axis));
    if (!thin) continue;
    --counts[sides[at] - 1u];
    sides[at] = 0;
  }
}

// The largest part of both sides that open ways connect. Of a side without a point nothing is known.
double Neck::shared(const Counts& counts) {
  if (std::min(counts[0], counts[1]) == 0) return 1;
  double most = 0;
  for (std::size_t i = 0; i < grid_.size(); ++i) {
    if (grid_.sides()[i] == 0) continue;
    const Counts part = follow(i);
    most = std::max(most, std::min(static_cast<double>(part[0]) / static_cast<double>(counts[0]),
                                   static_cast<double>(part[1]) / static_cast<double>(counts[1])));
  }
  return most;
}

Neck::Counts Neck::follow(std::size_t first) {
  Counts counts{};
  std::vector<std::uint8_t>& sides = grid_.sides();
  const auto take = [&](std::size_t at) {
    if (sides[at] == 0) return;
    ++counts[sides[at] - 1u];
    sides[at] = 0;
    queue_.push_back(at);
  };
  queue_.clear();
  take(first);
  while (!queue_.empty()) {
    const std::size_t at = queue_.back();
    queue_.pop_back();
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::size_t step = grid_.step(axis);
      if (!grid_.is_blocked(at, axis)) take(at + step);
      if (!grid_.is_blocked(at - step, axis)) take(at - step);
    }
  }
  return counts;
}

}  // namespace incise::core
