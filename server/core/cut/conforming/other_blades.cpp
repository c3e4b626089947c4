#include "server/core/cut/conforming/other_blades.hpp"

#include <algorithm>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

using namespace tolerance;

OtherBlades::OtherBlades(CutContext& cut, CutWorkspace& workspace) : cut_(cut), blades_(workspace.blades) {
  blades_.push_back(&cut);
}

// Calls visit(context) for each busy one until it returns true; returns whether one did.
template <class Visit>
bool OtherBlades::any(Visit visit) const {
  for (CutContext* blade : blades_) {
    if (blade != &cut_ && blade->others.is_busy_ && visit(*blade)) return true;
  }
  return false;
}

CutContext* OtherBlades::near(const Vec3& p) const {
  CutContext* found = nullptr;
  any([&](CutContext& other) {
    cut_.work += cost::kNearby;
    if (other.surface().is_within(p, kLeftToOthers_h * cut_.h)) found = &other;
    return found != nullptr;
  });
  return found;
}

void OtherBlades::offer_to_all(TetId t) const {
  any([&](CutContext& other) {
    const auto& v = cut_.mesh.vertices(t);
    const FourPoints p({cut_.mesh.position(v[0]), cut_.mesh.position(v[1]), cut_.mesh.position(v[2]),
                        cut_.mesh.position(v[3])});
    cut_.work += cost::kFindCrossing;
    if (other.surface().any_between(p, kOnSurface_h * cut_.h, [](std::uint32_t) { return true; }))
      other.others.offered_.push_back(t);
    return false;
  });
}

bool OtherBlades::leave(HalfFace face) const {
  CutContext* other = near(cut_.mesh.face_middle(face));
  if (other == nullptr) return false;
  other->others.left_.push_back(face);
  return true;
}

// What this batch has offered may be there more than once, or gone.
void OtherBlades::end_batch(bool is_busy) {
  is_busy_ = is_busy;
  any([this](CutContext& other) {
    std::vector<TetId>& offered = other.others.offered_;
    std::erase_if(offered, [this](TetId t) { return !cut_.mesh.alive(t); });
    std::ranges::sort(offered);
    offered.erase(std::unique(offered.begin(), offered.end()), offered.end());
    return false;
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
