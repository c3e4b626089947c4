#include "server/core/cut/conforming/rim_stage.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

// Whether v is the rim's vertex where the rim pierces a face of v's at `point`: put there, or of an older cut that the sweep is one with.
bool RimStage::stands_for(VertexId v, const Vec3& point) const {
  return (cut_.on_rim(v) || (cut_.stands(v) && cut_.on_surface(v))) &&
         distance(mesh_.position(v), point) < kRim_local * mesh_.local_h(v);
}

// Whether all of a tetrahedron is on one side of a plane through the line.
bool RimStage::passes_by(TetId t, const Vec3& from, const Vec3& to) const {
  const auto& v = mesh_.vertices(t);
  const Vec3 &a = mesh_.position(v[0]), along = to - from;
  // The plane that lies across the way from the line to one of the vertices separates most.
  const Vec3 normal = cross(
      along,
      cross(0.25 * (a + mesh_.position(v[1]) + mesh_.position(v[2]) + mesh_.position(v[3])) - from, along));
  const double clear = cut_.clear_m * length(normal);
  for (VertexId w : v) {
    if (dot(normal, mesh_.position(w) - from) <= clear) return false;
  }
  return true;
}

void RimStage::probe(TetId t, const Vec3& from, const Vec3& to, Rim rim) {
  cut_.work += cost::kLook;
  if (passes_by(t, from, to)) return;
  for (int f = 0; f < 4; ++f) {
    const auto face = mesh_.face_vertices(half_face(t, f));
    const Vec3 &a = mesh_.position(face[0]), &b = mesh_.position(face[1]), &c = mesh_.position(face[2]);
    const Vec3 normal = cross(b - a, c - a);
    const double above = dot(normal, from - a), below = dot(normal, to - a);
    if ((above >= 0) == (below >= 0)) continue;
    const Vec3 x = lerp(from, to, above / (above - below));
    if (dot(cross(b - a, x - a), normal) < 0 || dot(cross(c - b, x - b), normal) < 0 ||
        dot(cross(a - c, x - c), normal) < 0) {
      continue;
    }
    if (stands_for(face[0], x) || stands_for(face[1], x) || stands_for(face[2], x)) continue;
    const HalfFace side = half_face(t, f);
    if (!is_listed(mesh_.opposite(side), from)) list_.push_back({side, face, x, from, to, rim, false, false});
  }
}

// Whether the same piercing has been listed lately, from the face's other side.
bool RimStage::is_listed(HalfFace other, const Vec3& from) const {
  const auto lately = std::min<std::ptrdiff_t>(std::ssize(list_), kMaxLately);
  return std::any_of(list_.end() - lately, list_.end(),
                     [&](const Piercing& p) { return p.side == other && p.from == from && !p.done; });
}

bool RimStage::advance(WorkBudget& budget) {
  while (next_ < list_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    cut_.work += cost::kLook;
    const std::size_t i = next_++;
    const Piercing piercing = list_[i];
    if (cut_.hot(piercing.face[0]) || cut_.hot(piercing.face[1]) || cut_.hot(piercing.face[2])) continue;
    list_[i].done = true;
    if (!handle(piercing) || piercing.again) continue;
    // What was done here may have changed the faces that the rim pierces: look once more.
    const std::size_t first = list_.size();
    around_.begin();
    for (VertexId v : piercing.face) {
      mesh_.star(v, star_tets_);
      for (std::uint32_t corner : star_tets_) {
        if (around_.insert(tet_of(corner))) probe(tet_of(corner), piercing.from, piercing.to, piercing.rim);
      }
    }
    for (std::size_t k = first; k < list_.size(); ++k) list_[k].again = true;
  }
  std::erase_if(list_, [](const Piercing& p) { return p.done; });
  return true;
}

// Puts a vertex of the pierced face on the rim, where it is pierced or nearer. Returns whether faces near by may have
// changed.
bool RimStage::handle(const Piercing& piercing) {
  const TetId t = tet_of(piercing.side);
  if (!mesh_.alive(t)) return true;
  for (VertexId v : piercing.face) {
    if (mesh_.local_index(t, v) < 0) return true;
  }
  std::array<VertexId, 3> nearest = piercing.face;
  std::sort(nearest.begin(), nearest.end(), [&](VertexId v, VertexId w) {
    const double dv = squared_length(mesh_.position(v) - piercing.point);
    const double dw = squared_length(mesh_.position(w) - piercing.point);
    return dv != dw ? dv < dw : v < w;
  });
  for (VertexId v : nearest) {
    if (stands_for(v, piercing.point)) return false;
  }
  bool fair[3] = {};
  for (std::size_t i = 0; i < 3; ++i) {
    if (!cut_.on_rim(nearest[i]) && put(nearest[i], piercing, kGood, fair[i])) return true;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (fair[i] && put(nearest[i], piercing, kSnapFloor, fair[i])) return true;
  }
  // A split beside an older cut only leaves splinters where the sweep does not end there, and so does one beside the skin where the blade ends.
  const auto is_at_wall = [&](VertexId v) {
    return mesh_.at_boundary(v) && (piercing.rim == Rim::kWay || cut_.at_cut(v));
  };
  if (piercing.rim != Rim::kLine && std::ranges::any_of(piercing.face, is_at_wall)) return false;
  return cut_.may_add() && split_for(piercing);
}

// Puts v on the rim near the place, if its star is not worse than `limit` there. `fair`: it has come upon a place where kSnapFloor is kept.
bool RimStage::put(VertexId v, const Piercing& piercing, double limit, bool& fair) {
  const Vec3 direction = normalized(piercing.to - piercing.from);
  const double length_m = distance(piercing.from, piercing.to);
  cut_.gather(star_, v);
  const double middle = dot(star_.position() - piercing.from, direction);
  const double pierced = dot(piercing.point - piercing.from, direction);
  const double h = star_.local_h(), shift = kRimShift_local * h;
  for (const double along : {middle, pierced, pierced - shift, pierced + shift}) {
    const Vec3 target = piercing.from + std::clamp(along, 0.0, length_m) * direction;
    if (distance(target, star_.position()) > kRimReach_local * h) continue;
    if (!star_.keeps_boundary(target)) continue;
    const double worst = cut_.worst_at(star_, target, kSnapFloor, kFlat_local * h, flat_);
    fair = fair || worst <= kSnapFloor;
    if (worst > limit) continue;
    if (editor_.tears_film(v, target, flat_)) continue;
    editor_.snap_to_rim(star_, v, target);
    return true;
  }
  return false;
}

// Makes a new vertex on the face's edge that is nearest to the rim, and puts that there.
bool RimStage::split_for(const Piercing& piercing) {
  VertexId a = kNone, b = kNone;
  double best = INFINITY, at = 0;
  for (int k = 0; k < 3; ++k) {
    const VertexId from = piercing.face[k], to = piercing.face[(k + 1) % 3];
    const Vec3 &p = mesh_.position(from), &q = mesh_.position(to);
    const double t = std::clamp(dot(piercing.point - p, q - p) / squared_length(q - p), kRimSplit_edge,
                                1 - kRimSplit_edge);
    const double d2 = squared_length(lerp(p, q, t) - piercing.point);
    if (d2 < best) {
      best = d2;
      at = t;
      a = from;
      b = to;
    }
  }
  const TetId t = tet_of(piercing.side);
  if (cut_.worst_after_split(t, a, b, at, kSnapFloor) > kSnapFloor) return false;
  bool fair = false;
  put(editor_.split(t, a, b, at, MeshEditor::NewVertex::kNotYet), piercing, kSnapFloor, fair);
  return true;
}

void RimStage::clinging(std::vector<VertexId>& out) const {
  for (const Piercing& piercing : list_) out.insert(out.end(), piercing.face.begin(), piercing.face.end());
}

void RimStage::move(const AffineMotion& motion) {
  for (Piercing& p : list_) {
    p.point = motion(p.point);
    p.from = motion(p.from);
    p.to = motion(p.to);
  }
}

void RimStage::archive(Archive& io) {
  io.list(list_, 90, [&](Piercing& p) {
    io(p.side);
    for (VertexId& v : p.face) io(v);
    io(p.point);
    io(p.from);
    io(p.to);
    io(p.rim);
    io(p.again);
    io.demand(tet_of(p.side) < mesh_.tet_slots(), "a rim that pierces no tetrahedron");
    io.demand(p.rim <= Rim::kWay, "a rim of no kind");
    for (const VertexId v : p.face) io.demand(v < mesh_.vertex_slots(), "a rim that pierces no face");
    if (io.reads()) p.done = false;
  });
}

}  // namespace incise::core
