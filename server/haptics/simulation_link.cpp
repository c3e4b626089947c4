#include "server/haptics/simulation_link.hpp"

#include <algorithm>
#include <cmath>

#include "server/haptics/blade_probe.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;
using core::VertexId;

constexpr int kPlaces = 8;
constexpr double kLongest_s = 1;       // a model is valid at most so long
constexpr double kStiffest_n_m = 1e6;  // beyond any tissue
constexpr double kFarthest_m = 1e6;

class Spreader {
 public:
  Spreader(const core::TetMesh& mesh, VertexLoads& loads) : mesh_(mesh), loads_(loads) {}

  void add(VertexId v, const Vec3& force) noexcept {
    // A chain of vertices that lie between new ones is short; and what is left at its end stays in the sum.
    for (int i = 0; i < 64 && mesh_.is_new(v); ++i) {
      const core::Provenance& from = mesh_.provenance(v);
      if (from.a != from.b && depth_ < 6) {
        ++depth_;
        add(from.a, (1 - from.t) * force);
        add(from.b, from.t * force);
        --depth_;
        return;
      }
      v = from.t < 0.5 ? from.a : from.b;
    }
    const auto end = loads_.ids.begin() + static_cast<std::ptrdiff_t>(loads_.count);
    auto at = static_cast<std::size_t>(std::lower_bound(loads_.ids.begin(), end, v) - loads_.ids.begin());
    if (at < loads_.count && loads_.ids[at] == v) {
      loads_.forces[at] += force;
      return;
    }
    if (loads_.count == VertexLoads::kMost) {
      loads_.forces[std::min(at, loads_.count - 1)] += force;
      return;
    }
    for (std::size_t i = loads_.count++; i > at; --i) {
      loads_.ids[i] = loads_.ids[i - 1];
      loads_.forces[i] = loads_.forces[i - 1];
    }
    loads_.ids[at] = v;
    loads_.forces[at] = force;
  }

 private:
  const core::TetMesh& mesh_;
  VertexLoads& loads_;
  int depth_ = 0;
};

}  // namespace

VertexLoads spread(const Tissue& tissue, const RestLine& rest, const core::BladeLine& line,
                   const Engagement& engagement, const Vec3& force, ProbeWork& work) noexcept {
  VertexLoads loads;
  const double from = engagement.from, to = engagement.to;
  loads.center = lerp(line.heel, line.tip, engagement.length_m > 0 ? 0.5 * (from + to) : 0.5);
  const core::TetMesh* now = tissue.rest().now();
  if (!now || !(engagement.length_m > 0) || !(squared_length(force) > 0)) return loads;
  std::array<RestMap::Hold, kPlaces> holds;
  std::array<Vec3, kPlaces> places;
  int used = 0;
  core::TetId hint = rest.tet(from);
  double best = INFINITY;
  for (int i = 0; i < kPlaces; ++i) {
    const Vec3 p = lerp(line.heel, line.tip, from + (i + 0.5) / kPlaces * (to - from));
    const RestMap::Hold hold = tissue.rest().hold(p, hint, work);
    if (hold.tet == core::kNone) continue;
    hint = hold.loaded;
    // Between the sides of a cut, beside both: a place that is held is better.
    constexpr double kMost = 2;
    if (used > 0 && hold.most > kMost) continue;
    if (used == 1 && best > kMost) used = 0;
    best = hold.most;
    holds[static_cast<std::size_t>(used)] = hold;
    places[static_cast<std::size_t>(used++)] = p;
  }
  if (used == 0) return loads;
  Spreader spreader(*now, loads);
  loads.center = {};
  for (std::size_t i = 0; i < static_cast<std::size_t>(used); ++i) {
    loads.center += (1.0 / used) * places[i];
    const auto& v = now->vertices(holds[i].tet);
    for (std::size_t k = 0; k < 4; ++k) spreader.add(v[k], (-holds[i].weights[k] / used) * force);
  }
  return loads;
}

std::string trouble_of(const LocalModel& model, std::int64_t now_ns) {
  const Mat3& k = model.stiffness;
  const double numbers[] = {model.point.x,
                            model.point.y,
                            model.point.z,
                            model.normal.x,
                            model.normal.y,
                            model.normal.z,
                            k.x.x,
                            k.x.y,
                            k.x.z,
                            k.y.x,
                            k.y.y,
                            k.y.z,
                            k.z.x,
                            k.z.y,
                            k.z.z,
                            model.damping_n_s_m,
                            model.resistance_n};
  for (const double number : numbers) {
    if (!std::isfinite(number)) return "a number is NaN or infinite; accepted are finite numbers";
  }
  if (!(length(model.point) <= kFarthest_m)) return "the point is more than 1000 km away";
  if (std::abs(length(model.normal) - 1) > 1e-3)
    return "normal of length " + std::to_string(length(model.normal)) + "; accepted is a unit vector";
  if (model.damping_n_s_m < 0 || model.resistance_n < 0)
    return "damping or resistance below 0; accepted are 0 and above";
  const double trace = k.x.x + k.y.y + k.z.z;
  if (trace > 3 * kStiffest_n_m) return "stiffness above 1e6 N/m";
  const double rounding = 1e-9 * std::max(std::abs(trace), 1e-300);
  if (std::abs(k.x.y - k.y.x) > rounding || std::abs(k.x.z - k.z.x) > rounding ||
      std::abs(k.y.z - k.z.y) > rounding)
    return "the stiffness is not symmetric";
  // All principal minors: Sylvester's criterion for semidefinite matrices.
  const double xy = k.x.x * k.y.y - k.x.y * k.x.y, xz = k.x.x * k.z.z - k.x.z * k.x.z,
               yz = k.y.y * k.z.z - k.y.z * k.y.z, all = dot(k.x, cross(k.y, k.z));
  if (std::min({k.x.x, k.y.y, k.z.z}) < -rounding || std::min({xy, xz, yz}) < -rounding * std::abs(trace) ||
      all < -rounding * trace * trace)
    return "the stiffness is not positive semidefinite: it would give back more than it takes";
  const double valid_s = static_cast<double>(model.expires_ns - model.from_ns) * 1e-9;
  if (!(valid_s > 0 && valid_s <= kLongest_s))
    return "valid for " + std::to_string(valid_s) + " s; accepted is above 0 and up to 1 s";
  if (model.from_ns > now_ns) return "it answers a BladeLoad of the future";
  if (model.expires_ns <= now_ns)
    return "it expired " + std::to_string(static_cast<double>(now_ns - model.expires_ns) * 1e-6) +
           " ms before it came";
  return "";
}

}  // namespace incise::haptics
