#include "server/core/cut/conforming/other_blades.hpp"

#include <algorithm>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

using namespace tolerance;

OtherBlades::OtherBlades(CutContext& cut, CutWorkspace& workspace) : cut_(cut), blades_(workspace.blades) {
  blades_.push_back(&cut);
  // A frame allocates nothing, as a rule.
  offered_.reserve(kMostBridges);
  left_.reserve(kMostBridges);
}

// Each busy one.
template <class Visit>
void OtherBlades::for_each(Visit visit) const {
  for (CutContext* blade : blades_) {
    if (blade != &cut_ && blade->others.is_busy_) visit(*blade);
  }
}

// Of several the one whose stroke began first: a session that goes on from a checkpoint may have them in another order.
CutContext* OtherBlades::near(const Vec3& p) const {
  CutContext* first = nullptr;
  for_each([&](CutContext& other) {
    if (first != nullptr && first->stroke < other.stroke) return;
    cut_.work += cost::kNearby;
    if (other.surface().is_within(p, kLeftToOthers_h * cut_.h)) first = &other;
  });
  return first;
}

void OtherBlades::offer_to_all(TetId t) const {
  for_each([&](CutContext& other) {
    const auto& v = cut_.mesh.vertices(t);
    const FourPoints p({cut_.mesh.position(v[0]), cut_.mesh.position(v[1]), cut_.mesh.position(v[2]),
                        cut_.mesh.position(v[3])});
    cut_.work += cost::kFindCrossing;
    if (other.surface().any_between(p, kOnSurface_h * cut_.h, [](std::uint32_t) { return true; }))
      other.others.offered_.push_back(t);
  });
}

bool OtherBlades::leave(HalfFace face) const {
  CutContext* other = near(cut_.mesh.face_middle(face));
  if (other == nullptr) return false;
  // One that stands still does not look at them.
  std::vector<HalfFace>& left = other->others.left_;
  if (left.size() == kMostBridges) left.erase(left.begin(), left.begin() + kMostBridges / 4);
  left.push_back(face);
  return true;
}

// What this batch has offered may be there more than once, or gone.
void OtherBlades::end_batch(bool is_busy) {
  is_busy_ = is_busy;
  for_each([this](CutContext& other) {
    std::vector<TetId>& offered = other.others.offered_;
    std::erase_if(offered, [this](TetId t) { return !cut_.mesh.alive(t); });
    std::ranges::sort(offered);
    offered.erase(std::unique(offered.begin(), offered.end()), offered.end());
  });
}

void OtherBlades::archive(Archive& io, bool is_busy) {
  is_busy_ = is_busy;
  io.list(offered_, 4, [&](TetId& t) {
    io(t);
    io.demand(t < cut_.mesh.tet_slots(), "a changed tetrahedron that does not exist");
  });
  io.list(left_, 4, [&](HalfFace& face) {
    io(face);
    io.demand(tet_of(face) < cut_.mesh.tet_slots(), "a face that was left of no tetrahedron");
  });
}

}  // namespace incise::core
