#include "server/core/mesh/vertex_star.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "server/core/geometry/dihedral_lanes.hpp"

namespace incise::core {

struct LaneKernels : DihedralLanes {
  using Lanes = VertexStar::Lanes;

  [[gnu::always_inline]] static inline V3 row(const Lanes& lanes, int k) {
    V3 out;
    std::memcpy(&out.x, lanes.p[3 * k], sizeof out.x);
    std::memcpy(&out.y, lanes.p[3 * k + 1], sizeof out.y);
    std::memcpy(&out.z, lanes.p[3 * k + 2], sizeof out.z);
    return out;
  }

  // Begins with `first`, and puts there which exceeded the limit. `left_out`: bit k of the i-th: lane k of lanes[i] does not count.
  template <bool kLeavesOut>
  [[gnu::always_inline]] static inline double worst(const Vec3& p, const Lanes* lanes, std::size_t count,
                                                    double limit, std::size_t& first,
                                                    const std::uint8_t* left_out) {
    const V zero{};
    const V3 a{zero + p.x, zero + p.y, zero + p.z};
    double worst = -1;
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t i = k == 0 ? first : k <= first ? k - 1 : k;
      V m = DihedralLanes::worst(minus(row(lanes[i], 0), a), minus(row(lanes[i], 1), a),
                                 minus(row(lanes[i], 2), a));
      if constexpr (kLeavesOut) {
        for (unsigned lane = 0; lane < 4; ++lane) {
          if (left_out[i] >> lane & 1) m[lane] = -1;
        }
      }
      worst = std::max(worst, largest(m));
      if (worst > limit) {
        first = i;
        break;
      }
    }
    return worst;
  }

  static double worst_baseline(const Vec3& p, const Lanes* lanes, std::size_t count, double limit,
                               std::size_t& first, const std::uint8_t* left_out) {
    return left_out == nullptr ? worst<false>(p, lanes, count, limit, first, left_out)
                               : worst<true>(p, lanes, count, limit, first, left_out);
  }
#if defined(__x86_64__)
  // Without fused multiply-add, which would change the bits.
  [[gnu::target("avx2")]] static double worst_avx2(const Vec3& p, const Lanes* lanes, std::size_t count,
                                                   double limit, std::size_t& first,
                                                   const std::uint8_t* left_out) {
    return left_out == nullptr ? worst<false>(p, lanes, count, limit, first, left_out)
                               : worst<true>(p, lanes, count, limit, first, left_out);
  }
#endif
};

namespace {

using WorstOfLanes = decltype(&LaneKernels::worst_baseline);

WorstOfLanes choose() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) return &LaneKernels::worst_avx2;
#endif
  return &LaneKernels::worst_baseline;
}
const WorstOfLanes kWorstOfLanes = choose();

}  // namespace

void VertexStar::gather(const TetMesh& mesh, VertexId v) {
  mesh.star(v, corner_ids_);
  position_ = mesh.position(v);
  local_h_ = mesh.local_h(v);
  flattenable_.clear();
  walls_.clear();
  wall_area_ = {};
  volume_ = -1;
  worst_lanes_ = 0;
  corners_.resize(corner_ids_.size());
  lanes_.resize((corner_ids_.size() + 3) / 4);
  Corner* corner = corners_.data();
  Lanes* const lanes = lanes_.data();
  std::size_t n = 0;
  for (const std::uint32_t id : corner_ids_) {
    const auto& vertices = mesh.vertices(tet_of(id));
    const auto& others = kFaceVertices[index_of(id)];
    double* const at = &lanes[n / 4].p[0][n % 4];
    corner->tet = tet_of(id);
    for (std::size_t k = 0; k < 3; ++k) {
      corner->others[k] = vertices[others[k]];
      const Vec3& p = mesh.position(corner->others[k]);
      at[12 * k] = p.x;
      at[12 * k + 4] = p.y;
      at[12 * k + 8] = p.z;
    }
    ++corner;
    ++n;
  }
  for (; n % 4 != 0; ++n) {
    for (auto& row : lanes[n / 4].p) row[n % 4] = row[n % 4 - 1];
  }
  // Only a vertex of the boundary has faces with nothing beyond them.
  if (!mesh.has_regions() && !mesh.at_boundary(v)) return;
  for (const std::uint32_t id : corner_ids_) {
    if (mesh.has_regions() || mesh.on_boundary(tet_of(id))) add_walls(mesh, tet_of(id), index_of(id));
  }
}

// The faces of t at its vertex i that have nothing beyond them, or another region.
void VertexStar::add_walls(const TetMesh& mesh, TetId t, int i) {
  const auto& vertices = mesh.vertices(t);
  for (int f = 0; f < 4; ++f) {
    if (f == i) continue;
    const TetId beyond = mesh.neighbor(t, f);
    // What lies between two materials is as fixed as what lies between tissue and air.
    if (beyond != kNone && (!mesh.has_regions() || mesh.region(beyond) == mesh.region(t))) continue;
    const auto& k = kFaceVertices[f];
    const Vec3& a = mesh.position(vertices[k[0]]);
    const Vec3 twice = cross(mesh.position(vertices[k[1]]) - a, mesh.position(vertices[k[2]]) - a);
    walls_.push_back({normalized(twice), length(twice), (mesh.cut_mask(t) >> f & 1) != 0});
    wall_area_ += 0.5 * twice;
  }
}

double VertexStar::worst_at(const Vec3& p, double limit, double thickness, std::vector<TetId>& flat) const {
  flat.clear();
  for (std::uint32_t c : flattenable_) {
    const Vec3 a = point(c, 0);
    const Vec3 n = cross(point(c, 1) - a, point(c, 2) - a);
    if (std::abs(dot(n, p - a)) > thickness * length(n)) continue;
    if (flat.empty()) flat_lanes_.assign(lanes_.size(), 0);
    flat.push_back(corners_[c].tet);
    leave_out(c);
  }
  return kWorstOfLanes(p, lanes_.data(), lanes_.size(), limit, worst_lanes_,
                       flat.empty() ? nullptr : flat_lanes_.data());
}

// With the copies that fill the last lanes up.
void VertexStar::leave_out(std::size_t corner) const {
  const std::size_t end = corner + 1 == corners_.size() ? 4 * lanes_.size() : corner + 1;
  for (std::size_t i = corner; i < end; ++i) flat_lanes_[i / 4] |= static_cast<std::uint8_t>(1u << i % 4);
}

double VertexStar::worst_now() const {
  return kWorstOfLanes(position_, lanes_.data(), lanes_.size(), kInverted, worst_lanes_, nullptr);
}

double VertexStar::volume() const {
  if (volume_ >= 0) return volume_;
  volume_ = 0;
  for (std::size_t i = 0; i < corners_.size(); ++i) {
    const Vec3 a = point(i, 0);
    volume_ += std::abs(dot(cross(point(i, 1) - a, point(i, 2) - a), position_ - a)) / 6;
  }
  return volume_;
}

bool VertexStar::ends_cut() const {
  constexpr double kCosFacing = -0.9;
  for (std::size_t i = 0; i < walls_.size(); ++i) {
    for (std::size_t k = 0; walls_[i].cut && k < i; ++k) {
      if (walls_[k].cut && dot(walls_[i].normal, walls_[k].normal) < kCosFacing) return true;
    }
  }
  return false;
}

bool VertexStar::keeps_boundary(const Vec3& p) const {
  constexpr double kDistance_local = 0.05;
  constexpr double kVolume_local3 = 0.001;
  constexpr double kVolumePart = 0.01;
  constexpr double kNoVolume_local3 = 1e-9;
  const Vec3 d = p - position_;
  // A pyramid over each boundary face; what lies between interior faces adds up to nothing.
  const double won = std::abs(dot(wall_area_, d)) / 3;
  if (won > kVolume_local3 * local_h_ * local_h_ * local_h_) return false;
  // At the edge of a film or the tip of a splinter that is next to nothing, however far the vertex goes.
  if (won > kNoVolume_local3 * local_h_ * local_h_ * local_h_ && won > kVolumePart * volume()) return false;
  for (const Wall& wall : walls_) {
    if (std::abs(dot(wall.normal, d)) > kDistance_local * local_h_) return false;
  }
  return true;
}

}  // namespace incise::core
