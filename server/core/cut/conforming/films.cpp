#include "server/core/cut/conforming/films.hpp"

#include <cmath>

namespace incise::core {

using namespace tolerance;

// Amid its vertices off the surface: the barycentre of one that lies in a bend may be beyond it.
Vec3 reference_point(const CutContext& cut, TetId t) {
  Vec3 sum{};
  int count = 0;
  for (VertexId v : cut.mesh.vertices(t)) {
    if (cut.on_surface(v)) continue;
    sum += cut.mesh.position(v);
    ++count;
  }
  return count == 0 ? cut.mesh.barycentre(t) : (1.0 / count) * sum;
}

bool is_shallow(const CutContext& cut, TetId t, double reach) {
  const TetMesh& mesh = cut.mesh;
  for (int f = 0; f < 4; ++f) {
    if (!(mesh.cut_mask(t) >> f & 1)) continue;
    // The middle is a quarter as far from a face as the apex.
    if (6 * mesh.volume(t) <= 4 * reach * length(mesh.twice_area(half_face(t, f)))) return true;
  }
  cut.work += cost::kNearby;
  return cut.surface().is_within(mesh.barycentre(t), reach);
}

namespace {

// A tetrahedron's points, to say how much of it is deep: the middles of so many layers' upright tetrahedra. Of this stroke's cuts alone two layers are enough.
constexpr int kFewLayers = 2, kManyLayers = 4;
constexpr int points_of(int layers) {
  return layers * (layers + 1) * (layers + 2) / 6;
}

// Whether a point is that near to a cut face of its tetrahedron.
bool is_near_own_cut(const TetMesh& mesh, TetId t, const Vec3& p, double reach) {
  for (int f = 0; f < 4; ++f) {
    if (!(mesh.cut_mask(t) >> f & 1)) continue;
    const Vec3 n = mesh.twice_area(half_face(t, f));
    if (std::abs(dot(n, p - mesh.position(mesh.face_vertices(half_face(t, f))[0]))) <= reach * length(n))
      return true;
  }
  return false;
}

// Whether a cut face of one of its neighbours is.
bool is_near_cut_beside(const TetMesh& mesh, TetId t, const Vec3& p, double reach) {
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh.neighbor(t, f);
    if (n == kNone) continue;
    for (int g = 0; g < 4; ++g) {
      if (!(mesh.cut_mask(n) >> g & 1)) continue;
      const auto v = mesh.face_vertices(half_face(n, g));
      const Vec3 q = closest_point(p, mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]));
      if (squared_length(q - p) <= reach * reach) return true;
    }
  }
  return false;
}

}  // namespace

// Whether a cut is that near to a point of a tetrahedron. Older ones cost more to look for, where none is beside it.
bool Films::is_near_cut(TetId t, const Vec3& p, double reach, Cuts cuts) {
  cut_.part_judging += cost::kPartFilmPoint;
  if (is_near_own_cut(mesh_, t, p, reach)) return true;
  cut_.work += cost::kNearby;
  if (cut_.surface().is_within(p, reach)) return true;
  return cuts == Cuts::kAll && (is_near_cut_beside(mesh_, t, p, reach) || faces_.is_within(p, reach));
}

bool Films::is_deep(std::span<const TetId> tets, double least_h3, Cuts cuts) {
  const double least_m3 = least_h3 * cut_.h * cut_.h * cut_.h;
  const int points = points_of(cuts == Cuts::kAll ? kManyLayers : kFewLayers);
  double sum_m3 = 0;
  for (TetId t : tets) {
    sum_m3 += mesh_.volume(t) * count_deep(t, cuts) / points;
    if (sum_m3 >= least_m3) return true;
  }
  return false;
}

int Films::count_deep(TetId t, Cuts cuts) {
  const int layers = cuts == Cuts::kAll ? kManyLayers : kFewLayers;
  std::uint8_t& deep = known(t).deep[cuts == Cuts::kAll];
  // A part of a batch ends by what is asked, not by what it takes.
  if (deep != Known::kUnknown) {
    cut_.part_judging += points_of(layers) * cost::kPartFilmPoint;
    return deep;
  }
  const auto& v = mesh_.vertices(t);
  const Vec3 origin = mesh_.position(v[0]);
  const double step = 1.0 / layers;
  const Vec3 along[3] = {step * (mesh_.position(v[1]) - origin), step * (mesh_.position(v[2]) - origin),
                         step * (mesh_.position(v[3]) - origin)};
  deep = 0;
  for (int i = 0; i < layers; ++i) {
    for (int j = 0; i + j < layers; ++j) {
      for (int k = 0; i + j + k < layers; ++k) {
        const Vec3 p = origin + (i + 0.25) * along[0] + (j + 0.25) * along[1] + (k + 0.25) * along[2];
        if (!is_near_cut(t, p, kDeep_h * cut_.h, cuts)) ++deep;
      }
    }
  }
  return deep;
}

bool Films::may_be_film(TetId t) {
  std::uint8_t& known = this->known(t).may_be_film;
  if (known == Known::kUnknown) {
    known = std::ranges::all_of(mesh_.vertices(t), [&](VertexId v) {
      if (mesh_.at_boundary(v) || cut_.on_surface(v)) return true;
      cut_.work += cost::kSurfaceQuery;
      return cut_.surface().is_within(mesh_.position(v), kOne_h * cut_.h);
    });
  }
  return known != 0;
}

Films::Known& Films::known(TetId t) {
  Known& known = known_[t % kKnown];
  cut_.work += cost::kLook;
  if (known.serial != serial_ || known.tet != t) known = {.serial = serial_, .tet = t};
  return known;
}

bool Films::is_film(const Extent& extent, std::span<const TetId> tets) {
  // A large one may be a part of the tissue in places.
  if (extent.volume_m3 <= extent.film_m3(cut_.h))
    return extent.is_crumb(cut_.h) || !is_deep(tets, kLeastPart_h3, Cuts::kAll);
  if (extent.volume_m3 > extent.shallow_m3(cut_.h)) return false;
  const auto is_far = [&](TetId t) {
    return std::ranges::any_of(mesh_.vertices(t), [&](VertexId v) {
      return !is_near_cut(t, mesh_.position(v), kFilmReach_h * cut_.h, Cuts::kAll);
    });
  };
  // What a sweep that is alone takes off is a part of the body where it reaches that far, however little of it does.
  if (!cut_.meets_cut && std::ranges::any_of(tets, is_far)) return false;
  return !is_deep(tets, kLeastDeep_h3, Cuts::kAll);
}

}  // namespace incise::core
