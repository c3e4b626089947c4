#include "server/core/cut/conforming/cut_context.hpp"

#include <algorithm>

namespace incise::core {

using namespace tolerance;

CutContext::CutContext(const TetMesh& body, CutWorkspace& marks, const CutConfig& settings)
    : mesh(body),
      workspace(marks),
      config(settings),
      h(body.mean_edge_length()),
      clear_m(kClear_h * body.mean_edge_length()),
      path(config, h),
      others(*this, marks) {}

void CutContext::gather(VertexStar& star, VertexId v) const {
  star.gather(mesh, v, [this](VertexId w) { return on_surface(w); });
  work += cost::kGather;
  work.add(star.corners().size(), cost::kGatherCornersAUnit);
}

double CutContext::worst_at(const VertexStar& star, const Vec3& p, double limit, double thickness_m,
                            std::vector<TetId>& flat) const {
  work += cost::kWorstAt;
  work.add(star.corners().size(), cost::kWorstAtCornersAUnit);
  const double worst = star.worst_at(p, limit, thickness_m, flat);
  if (worst > limit) return worst;
  for (TetId t : flat) {
    work += cost::kSurfaceQuery;
    if (!surface().is_within(mesh.barycentre(t) + 0.25 * (p - star.position()), kFlatOff_h * h))
      return kInverted;
  }
  return worst;
}

bool CutContext::find_crossing(const Vec3& a, bool a_on, const Vec3& b, bool b_on, std::uint32_t& triangle,
                               double& t) const {
  work += cost::kFindCrossing;
  return any_crossing(a, a_on, b, b_on, [&](std::uint32_t i, double at) {
    triangle = i;
    t = at;
    return true;
  });
}

std::uint32_t CutContext::batch_across(VertexId a, VertexId b) const {
  std::uint32_t triangle = 0;
  double t = 0;
  return find_crossing(mesh.position(a), on_surface(a), mesh.position(b), on_surface(b), triangle, t)
             ? surface()[triangle].batch
             : kNone;
}

double CutContext::worst_after_split(TetId tet, VertexId a, VertexId b, double t, double limit) const {
  mesh.ring(tet, a, b, ring_);
  work += cost::kTrySplit * static_cast<std::int64_t>(ring_.size());
  const Vec3 x = lerp(mesh.position(a), mesh.position(b), t);
  double worst = -1;
  for (TetId r : ring_) {
    const auto& v = mesh.vertices(r);
    Vec3 near[4], far[4];
    for (int i = 0; i < 4; ++i) {
      near[i] = v[i] == b ? x : mesh.position(v[i]);
      far[i] = v[i] == a ? x : mesh.position(v[i]);
    }
    worst = std::max({worst, worst_dihedral(near[0], near[1], near[2], near[3]),
                      worst_dihedral(far[0], far[1], far[2], far[3])});
    if (worst > limit) break;
  }
  return worst;
}

bool CutContext::at_cut(VertexId v) const {
  if (!mesh.may_be_at_cut(v)) return false;
  mesh.star(v, corners_);
  work.add(corners_.size(), cost::kStarCornersAUnit);
  return std::ranges::any_of(
      corners_, [this](Corner c) { return (mesh.cut_mask(tet_of(c)) & ~(1u << index_of(c))) != 0; });
}

}  // namespace incise::core
