#include "client/examples/xpbd/soft_body.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>
#include <vector>

#include "protocol/carry.hpp"

namespace incise::xpbd {
namespace {

using protocol::Delta;
using protocol::Replica;
using Vector = float __attribute__((vector_size(16)));

Vector vector_at(std::span<const double> numbers, std::size_t i) {
  return Vector{static_cast<float>(numbers[3 * i]), static_cast<float>(numbers[3 * i + 1]),
                static_cast<float>(numbers[3 * i + 2]), 0};
}

float dot(const Vector& a, const Vector& b) {
  const Vector p = a * b;
  return p[0] + p[1] + p[2];
}

// (y, z, x)
Vector turned(const Vector& a) {
  return __builtin_shufflevector(a, a, 1, 2, 0, 3);
}

Vector cross(const Vector& a, const Vector& b) {
  return turned(a * turned(b) - turned(a) * b);
}

// Six volumes, in cubes of the longest edge: below the first a tetrahedron has no stiffness, below the second it is a
// sliver. A regular one has 0.7.
constexpr float kFlat = 1e-3f, kSliver = 0.1f;

// No vertex weighs less than this times dt^2 times the stiffness around it ("mass scaling"): what is lighter moves farther in a substep than
// one pass over its tetrahedra can answer, so it never rests. Slivers and small elements are what that makes heavier; where a body
// comes to rest does not depend on its mass.
constexpr float kHeaviness = 0.3f;

// A blade's force is as it was while it changes by less than this part of it, turns by less than that (radians) and moves to other vertices
// by less than that part: a hand is never still. On an edge of the skin the force turns to and fro as the tissue gives way to it, so it takes this
// part of a small turn from each message. Less than so many newtons are none. What rests takes so many times the tremor: it came to rest
// anywhere within the first.
constexpr float kTremor = 0.03f, kAsleep = 2, kTurn = 0.3f, kSlid = 0.2f, kFollow = 0.25f, kLeast_n = 0.005f;

// In a step, of the body's size, for a vertex that was held.
constexpr float kFreed = 1e-3f;

// How far the hold of the bed and of the ends reaches into the body, in parts of its height and length.
constexpr float kBed = 0.6f, kEnds = 0.15f;

}  // namespace

SoftBody::SoftBody(const Material& material, double step_s, int substeps)
    : material_(material),
      substeps_(substeps),
      dt_(static_cast<float>(step_s / substeps)),
      mu_(static_cast<float>(material.young_pa / (2 * (1 + material.poisson)))),
      lambda_(static_cast<float>(material.young_pa * material.poisson /
                                 ((1 + material.poisson) * (1 - 2 * material.poisson)))) {}

// What the surroundings resist with at a place of the skin, Pa/m.
float SoftBody::tether_pa_m(const Vector& rest) const {
  const auto size = high_ - low_;
  // From 1 at an end to 0 where it fades out, as smooth as a cosine.
  const auto fade = [](float at, float reach) {
    const float s = std::clamp(1 - at / std::max(reach, 1e-9f), 0.0f, 1.0f);
    return s * s * (3 - 2 * s);
  };
  const float bed = fade(rest[2] - low_[2], kBed * size[2]);
  const float ends =
      std::max(fade(rest[0] - low_[0], kEnds * size[0]), fade(high_[0] - rest[0], kEnds * size[0]));
  const auto skin = static_cast<float>(material_.skin_pa_m), most = static_cast<float>(material_.bed_pa_m);
  return skin + (most - skin) * std::max(bed, ends);
}

void SoftBody::update_vertex(std::uint32_t vertex) {
  // What is left of sums when the last tetrahedron has gone would move the vertex for ever.
  if (uses_[vertex] == 0) {
    mass_[vertex] = stiff_[vertex] = skin_[vertex] = wound_[vertex] = 0;
    lips_[vertex] = v_[vertex] = Vector{};
  }
  const bool free = mass_[vertex] > 0 && !held_[vertex];
  weight_[vertex] = free ? 1 / std::max(mass_[vertex], kHeaviness * dt_ * dt_ * stiff_[vertex]) : 0;
  tether_[vertex] = skin_[vertex] > 1e-12f ? skin_[vertex] * tether_pa_m(rest_[vertex]) : 0;
  tether_[vertex] += wound_[vertex] * static_cast<float>(material_.tension_pa / material_.retraction_m);
}

// The loads and the skin of a tetrahedron's outer faces, a third to each vertex. The outward area of the face opposite to a
// vertex is -3 volume times the gradient of that vertex's barycentric coordinate.
void SoftBody::add_faces(const Tet& tet, float sign) {
  if ((tet.cut_faces | tet.skin_faces) == 0) return;
  const auto& q = tet.inverse;
  const float volume = sign * tet.volume;
  Vector inward[4];
  for (std::size_t k = 0; k < 3; ++k)
    inward[k + 1] = volume * Vector{q[3 * k], q[3 * k + 1], q[3 * k + 2], 0};
  inward[0] = -(inward[1] + inward[2] + inward[3]);
  for (std::size_t f = 0; f < 4; ++f) {
    const bool skin = tet.skin_faces >> f & 1, cut = tet.cut_faces >> f & 1;
    if (!skin && !cut) continue;
    const float area = sign * std::sqrt(dot(inward[f], inward[f]));
    for (std::size_t k = 0; k < 4; ++k) {
      if (k == f) continue;
      const std::uint32_t v = tet.v[k];
      if (cut) lips_[v] += static_cast<float>(material_.tension_pa) * inward[f];
      float& sum = cut ? wound_[v] : skin_[v];
      sum = std::max(sum + area, 0.0f);
    }
  }
}

// A tetrahedron's share in the mass and in the stiffness of its vertices.
void SoftBody::add_weight(const Tet& tet, float sign) {
  const auto& q = tet.inverse;
  Vector gradient[4];
  for (std::size_t k = 0; k < 3; ++k) gradient[k + 1] = Vector{q[3 * k], q[3 * k + 1], q[3 * k + 2], 0};
  gradient[0] = -(gradient[1] + gradient[2] + gradient[3]);
  const float mass = 0.25f * static_cast<float>(material_.density_kg_m3) / tet.per_volume;
  for (std::size_t k = 0; k < 4; ++k) {
    float& m = mass_[tet.v[k]];
    float& s = stiff_[tet.v[k]];
    m = std::max(m + sign * mass, 0.0f);
    s = std::max(s + sign * (mu_ + lambda_) / tet.per_volume * dot(gradient[k], gradient[k]), 0.0f);
  }
}

void SoftBody::remove_tet(std::uint32_t id) {
  Tet& tet = tets_[id];
  if (tet.per_volume == 0) return;
  add_faces(tet, -1);
  add_weight(tet, -1);
  for (const std::uint32_t v : tet.v) {
    --uses_[v];
    update_vertex(v);
  }
  tet = {};
  --live_tets_;
}

// Shape, mass and outer faces of a tetrahedron, from the rest positions of its vertices.
void SoftBody::set_tet(const Replica& mesh, std::uint32_t id) {
  remove_tet(id);
  Tet& tet = tets_[id];
  tet.v = mesh.vertices(id);
  const Vector a = rest_[tet.v[1]] - rest_[tet.v[0]], b = rest_[tet.v[2]] - rest_[tet.v[0]],
               c = rest_[tet.v[3]] - rest_[tet.v[0]];
  const float longest = std::sqrt(std::max({dot(a, a), dot(b, b), dot(c, c)}));
  const float cube = longest * longest * longest;
  const Vector rows[3] = {cross(b, c), cross(c, a), cross(a, b)};
  const float six_volumes = dot(a, rows[0]);
  // A cut in a body that is strongly deformed can leave a tetrahedron flat at rest: it goes along without a stiffness.
  if (six_volumes > kFlat * cube) {
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t k = 0; k < 3; ++k) tet.inverse[3 * i + k] = rows[i][k] / six_volumes;
    }
    tet.volume = six_volumes / 6;
  }
  // A sliver is as stiff and as heavy as if it were thicker, or it would be the first to invert, and never at rest.
  tet.per_volume = 6 / std::max(six_volumes, kSliver * cube);
  tet.cut_faces = mesh.boundary_mask(id) & mesh.cut_mask(id);
  tet.skin_faces = mesh.boundary_mask(id) & ~tet.cut_faces;
  ++live_tets_;
  add_faces(tet, 1);
  add_weight(tet, 1);
  for (const std::uint32_t v : tet.v) {
    ++uses_[v];
    update_vertex(v);
  }
}

void SoftBody::load(const Replica& mesh) {
  const std::size_t n = mesh.vertex_count();
  x_.resize(n);
  rest_.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    x_[i] = vector_at(mesh.positions(), i);
    rest_[i] = vector_at(mesh.rest_positions(), i);
    if (i == 0) low_ = high_ = rest_[0];
    for (int k = 0; k < 3; ++k) {
      low_[k] = std::min(low_[k], rest_[i][k]);
      high_[k] = std::max(high_[k], rest_[i][k]);
    }
  }
  before_ = sent_ = x_;
  for (auto* vectors : {&v_, &lips_}) vectors->assign(n, Vector{});
  uses_.assign(n, 0);
  for (auto* numbers : {&mass_, &stiff_, &weight_, &skin_, &wound_, &tether_}) numbers->assign(n, 0);
  held_.assign(n, 0);
  held_list_.clear();
  freed_.clear();
  blades_.clear();
  changed_.assign(n, 0);
  tets_.assign(mesh.tet_slots(), {});
  live_tets_ = 0;
  mesh.for_each_tet([&](std::uint32_t t) { set_tet(mesh, t); });
}

bool SoftBody::apply(const Replica& mesh, const Delta& delta) {
  if (delta.tets.ids.empty() && delta.removed_tets.empty() && delta.rest_ids.empty()) return false;
  const std::uint32_t first_added = vertices(), n = mesh.vertex_count();
  // Velocities go with the material.
  std::vector<float> velocities(4 * v_.size());
  std::memcpy(velocities.data(), v_.data(), 4 * velocities.size());
  protocol::carry(delta, 4, velocities);
  for (auto* vectors : {&x_, &before_, &v_, &rest_, &sent_, &lips_}) vectors->resize(n);
  uses_.resize(n, 0);
  std::memcpy(v_.data(), velocities.data(), 4 * velocities.size());
  for (auto* numbers : {&mass_, &stiff_, &weight_, &skin_, &wound_, &tether_}) numbers->resize(n, 0);
  held_.resize(n, 0);
  changed_.resize(n, 0);
  tets_.resize(mesh.tet_slots());
  // What a cut has put elsewhere or made stands for other material now. While nothing has been deformed there are no rest
  // positions in deltas: they are the positions.
  const auto take = [&](std::uint32_t id) {
    x_[id] = before_[id] = sent_[id] = vector_at(mesh.positions(), id);
    rest_[id] = vector_at(mesh.rest_positions(), id);
    changed_[id] = 1;
  };
  for (const std::uint32_t id : mesh.deformed() ? delta.rest_ids : delta.moved_ids) take(id);
  for (std::uint32_t id = first_added; id < n; ++id) take(id);
  for (const std::uint32_t id : delta.removed_tets) remove_tet(id);
  for (const std::uint32_t id : delta.tets.ids) set_tet(mesh, id);
  // A face that opens is named as a half-face: its tetrahedron may be the same.
  for (const auto* faces : {&delta.boundary_upserted, &delta.boundary_removed}) {
    for (const std::uint32_t face : *faces) {
      if (mesh.alive(face / 4)) set_tet(mesh, face / 4);
    }
  }
  for (std::uint32_t id = 0; id < tets_.size(); ++id) {
    const auto& v = tets_[id].v;
    if (tets_[id].per_volume > 0 && (changed_[v[0]] || changed_[v[1]] || changed_[v[2]] || changed_[v[3]]))
      set_tet(mesh, id);
  }
  std::fill(changed_.begin(), changed_.end(), 0);
  freed_.clear();
  return true;
}

void SoftBody::hold(const Replica& mesh, std::span<const std::uint32_t> held) {
  for (const std::uint32_t id : held) {
    if (id >= vertices()) continue;
    x_[id] = sent_[id] = vector_at(mesh.positions(), id);
    v_[id] = Vector{};
    if (std::exchange(held_[id], std::uint8_t{1})) continue;
    held_list_.push_back(id);
    update_vertex(id);
  }
}

void SoftBody::let_go() {
  freed_ = held_list_;
  for (const std::uint32_t id : held_list_) {
    held_[id] = 0;
    update_vertex(id);
  }
  held_list_.clear();
}

bool SoftBody::press(const protocol::BladeLoad& load, bool rests) {
  const auto to_vector = [](const protocol::Vec3& p) {
    return Vector{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z), 0};
  };
  const Vector force = -to_vector(load.force_n);
  const float told = std::sqrt(dot(force, force));
  BladeForce blade;
  blade.source = load.source;
  for (std::size_t i = 0; i < load.ids.size() && told >= kLeast_n; ++i) {
    // A vertex of a cut that we have not seen yet.
    if (load.ids[i] >= vertices()) continue;
    blade.ids.push_back(load.ids[i]);
    blade.shares.push_back(dot(vector_at(load.forces, i), force) / (told * told));
  }
  const auto before = std::find_if(blades_.begin(), blades_.end(),
                                   [&](const BladeForce& other) { return other.source == load.source; });
  blade.force = std::sqrt(dot(force, force));
  blade.way = (1 / std::max(blade.force, kLeast_n)) * force;
  blade.center = dot(blade.way, to_vector(load.center));
  if (before != blades_.end()) {
    if (much_the_same(*before, blade, rests ? kAsleep * kTremor : kTremor)) return false;
    if (const Vector turn = blade.way - before->way; dot(turn, turn) < kTurn * kTurn) {
      const Vector way = before->way + kFollow * turn;
      blade.way = (1 / std::sqrt(dot(way, way))) * way;
      blade.center = dot(blade.way, to_vector(load.center));
    }
    blades_.erase(before);
  } else if (blade.ids.empty()) {
    return false;
  }
  if (blade.ids.empty()) return true;
  blades_.push_back(std::move(blade));
  return true;
}

// Whether `now` is what `before` has become by now.
bool SoftBody::much_the_same(const BladeForce& before, const BladeForce& now, float tremor) const {
  const Vector turn = now.way - before.way;
  if (std::abs(now.force - acting(before)) > std::max(kLeast_n, tremor * now.force) ||
      dot(turn, turn) > kTurn * kTurn)
    return false;
  // The same vertices? Ids are ascending, and one that is not there has no share.
  float moved = 0;
  for (std::size_t i = 0, k = 0; i < before.ids.size() || k < now.ids.size();) {
    const bool first = k == now.ids.size() || (i < before.ids.size() && before.ids[i] <= now.ids[k]);
    const bool second = i == before.ids.size() || (k < now.ids.size() && now.ids[k] <= before.ids[i]);
    moved += std::abs((first ? before.shares[i] : 0) - (second ? now.shares[k] : 0));
    i += first ? 1 : 0;
    k += second ? 1 : 0;
  }
  return moved < kSlid;
}

// How far the tissue has given way since its force was computed, m.
float SoftBody::give(const BladeForce& blade) const {
  float give = -blade.center, all = 0;
  for (std::size_t i = 0; i < blade.ids.size(); ++i) {
    give += blade.shares[i] * dot(blade.way, x_[blade.ids[i]]);
    all += blade.shares[i];
  }
  return std::abs(all - 1) < 0.01f ? give : 0;  // with a vertex missing nobody knows where it was
}

// The force now, N.
float SoftBody::acting(const BladeForce& blade) const {
  return std::max(0.0f, blade.force - kContact_n_m * give(blade));
}

// The force as it will be at the end of the time step, in which the spring relaxes by what the body gives way.
void SoftBody::push(const BladeForce& blade) {
  float weight = 0;
  for (std::size_t i = 0; i < blade.ids.size(); ++i)
    weight += blade.shares[i] * blade.shares[i] * weight_[blade.ids[i]];
  const float force = acting(blade) / (1 + dt_ * dt_ * kContact_n_m * weight);
  for (std::size_t i = 0; i < blade.ids.size(); ++i) {
    const std::uint32_t id = blade.ids[i];
    x_[id] += dt_ * dt_ * weight_[id] * blade.shares[i] * force * blade.way;
  }
}

// The two constraints of Macklin and Müller 2021 on F, the gradient of the deformation: sqrt(tr F^T F), and
// det F - goal with goal = 1 + mu / lambda; both at once. Compliances are 1 / (mu dt^2) and 1 / (lambda dt^2), for 1 m^3.
void SoftBody::project(const Tet& tet, float shear_compliance, float volume_compliance, float goal) {
  const auto& v = tet.v;
  const auto& q = tet.inverse;
  const Vector o = x_[v[0]];
  const Vector a = x_[v[1]] - o, b = x_[v[2]] - o, c = x_[v[3]] - o;
  // F and the gradients by columns.
  const Vector f[3] = {q[0] * a + q[3] * b + q[6] * c, q[1] * a + q[4] * b + q[7] * c,
                       q[2] * a + q[5] * b + q[8] * c};
  const Vector cofactor[3] = {cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])};
  const float norm = std::sqrt(dot(f[0], f[0]) + dot(f[1], f[1]) + dot(f[2], f[2]));
  if (norm < 1e-6f) return;
  const float det = dot(f[0], cofactor[0]), volume = det - goal;
  Vector shear_gradient[4], volume_gradient[4];
  shear_gradient[0] = volume_gradient[0] = Vector{};
  const float per_norm = 1 / norm;
  for (std::size_t j = 0; j < 3; ++j) {
    shear_gradient[j + 1] = per_norm * (q[3 * j] * f[0] + q[3 * j + 1] * f[1] + q[3 * j + 2] * f[2]);
    volume_gradient[j + 1] = q[3 * j] * cofactor[0] + q[3 * j + 1] * cofactor[1] + q[3 * j + 2] * cofactor[2];
    shear_gradient[0] -= shear_gradient[j + 1];
    volume_gradient[0] -= volume_gradient[j + 1];
  }
  float ss = shear_compliance * tet.per_volume, vv = volume_compliance * tet.per_volume, sv = 0;
  float weights[4];
  for (std::size_t k = 0; k < 4; ++k) {
    weights[k] = weight_[v[k]];
    ss += weights[k] * dot(shear_gradient[k], shear_gradient[k]);
    vv += weights[k] * dot(volume_gradient[k], volume_gradient[k]);
    sv += weights[k] * dot(shear_gradient[k], volume_gradient[k]);
  }
  // The two multipliers. Where the gradients are all but parallel (or nothing is free) the determinant is that of the
  // compliances, which is above 0.
  const float determinant = ss * vv - sv * sv;
  if (!(determinant > 1e-6f * ss * vv)) return;
  const float shear_step = (sv * volume - vv * norm) / determinant;
  const float volume_step = (sv * norm - ss * volume) / determinant;
  for (std::size_t k = 0; k < 4; ++k)
    x_[v[k]] += weights[k] * (shear_step * shear_gradient[k] + volume_step * volume_gradient[k]);
}

void SoftBody::step() {
  began_.clear();
  for (const std::uint32_t id : freed_) began_.push_back(x_[id]);
  const float dt = dt_;
  const auto keep = static_cast<float>(std::exp(-material_.damping_per_s * static_cast<double>(dt)));
  const float shear_compliance = 1 / (mu_ * dt * dt), volume_compliance = 1 / (lambda_ * dt * dt);
  for (int n = 0; n < substeps_; ++n) {
    for (std::size_t i = 0; i < x_.size(); ++i) {
      before_[i] = x_[i];
      if (weight_[i] > 0) x_[i] += dt * (v_[i] + dt * weight_[i] * lips_[i]);
    }
    for (const BladeForce& blade : blades_) push(blade);
    for (const Tet& tet : tets_) {
      if (tet.volume > 0) project(tet, shear_compliance, volume_compliance, 1 + mu_ / lambda_);
    }
    for (std::size_t i = 0; i < x_.size(); ++i) {
      const float pull = dt * dt * tether_[i] * weight_[i];
      x_[i] += pull / (1 + pull) * (rest_[i] - x_[i]);
      v_[i] = (keep / dt) * (x_[i] - before_[i]);
    }
  }
  // The server may hold them again: they must not leap, and be thrown back.
  const float most = kFreed * static_cast<float>(size_m());
  for (std::size_t i = 0; i < freed_.size(); ++i) {
    const std::uint32_t id = freed_[i];
    const Vector way = x_[id] - began_[i];
    const float share = most / std::max(most, std::sqrt(dot(way, way)));
    x_[id] = began_[i] + share * way;
    v_[id] *= share;
  }
}

double SoftBody::unsent_m() const {
  float most = 0;
  for (std::size_t i = 0; i < x_.size(); ++i) {
    const Vector way = x_[i] - sent_[i];
    most = std::max(most, dot(way, way));
  }
  return std::sqrt(static_cast<double>(most));
}

std::span<const float> SoftBody::positions() {
  out_.clear();
  for (const Vector& p : x_) out_.insert(out_.end(), {p[0], p[1], p[2]});
  return out_;
}

double SoftBody::size_m() const {
  const Vector size = high_ - low_;
  return std::sqrt(static_cast<double>(dot(size, size)));
}

}  // namespace incise::xpbd
