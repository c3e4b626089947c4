#include "client/examples/xpbd/soft_body.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
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

}  // namespace

bool SoftBody::is_held(const Vector& rest) const {
  const auto size = high_ - low_;
  const float ends = static_cast<float>(material_.held_ends) * size[0];
  return rest[2] < low_[2] + static_cast<float>(material_.held_below) * size[2] || rest[0] < low_[0] + ends ||
         rest[0] > high_[0] - ends;
}

void SoftBody::update_weight(std::uint32_t vertex) {
  const bool free = mass_[vertex] > 1e-12f && !fixed_[vertex] && !held_[vertex];
  weight_[vertex] = free ? 1 / mass_[vertex] : 0;
}

void SoftBody::remove_tet(std::uint32_t id) {
  Tet& tet = tets_[id];
  if (tet.mass_kg == 0) return;
  for (const std::uint32_t v : tet.v) {
    mass_[v] = std::max(mass_[v] - 0.25f * tet.mass_kg, 0.0f);
    update_weight(v);
  }
  tet = {};
  --live_tets_;
}

// Shape and mass of a tetrahedron from the rest positions of its vertices.
void SoftBody::set_tet(const Replica& mesh, std::uint32_t id) {
  remove_tet(id);
  Tet& tet = tets_[id];
  tet.v = mesh.vertices(id);
  const float scale = 1 - static_cast<float>(material_.shrink);
  const Vector a = scale * (rest_[tet.v[1]] - rest_[tet.v[0]]),
               b = scale * (rest_[tet.v[2]] - rest_[tet.v[0]]),
               c = scale * (rest_[tet.v[3]] - rest_[tet.v[0]]);
  const float longest = std::sqrt(std::max({dot(a, a), dot(b, b), dot(c, c)}));
  const float cube = longest * longest * longest;
  const Vector rows[3] = {cross(b, c), cross(c, a), cross(a, b)};
  const float six_volumes = dot(a, rows[0]);
  // A cut in a body that is strongly deformed can leave a tetrahedron flat at rest: it goes along without a stiffness.
  if (six_volumes > kFlat * cube) {
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t k = 0; k < 3; ++k) tet.inverse[3 * i + k] = rows[i][k] / six_volumes;
    }
    // A sliver is as stiff as if it were thicker, or it would be the first to invert.
    tet.per_volume = 6 / std::max(six_volumes, kSliver * cube);
  }
  tet.mass_kg =
      static_cast<float>(material_.density_kg_m3) * std::max(std::abs(six_volumes), kFlat * cube) / 6;
  ++live_tets_;
  for (const std::uint32_t v : tet.v) {
    mass_[v] += 0.25f * tet.mass_kg;
    update_weight(v);
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
  before_ = x_;
  v_.assign(n, Vector{});
  mass_.assign(n, 0);
  weight_.assign(n, 0);
  held_.assign(n, 0);
  held_list_.clear();
  changed_.assign(n, 0);
  fixed_.resize(n);
  for (std::size_t i = 0; i < n; ++i) fixed_[i] = is_held(rest_[i]);
  tets_.assign(mesh.tet_slots(), {});
  live_tets_ = 0;
  mesh.for_each_tet([&](std::uint32_t t) { set_tet(mesh, t); });
}

void SoftBody::apply(const Replica& mesh, const Delta& delta) {
  if (delta.tets.ids.empty() && delta.removed_tets.empty() && delta.rest_ids.empty()) return;
  const std::uint32_t first_added = vertices(), n = mesh.vertex_count();
  // Velocities go with the material.
  std::vector<float> velocities(4 * v_.size());
  std::memcpy(velocities.data(), v_.data(), 4 * velocities.size());
  protocol::carry(delta, 4, velocities);
  for (auto* vectors : {&x_, &before_, &v_, &rest_}) vectors->resize(n);
  std::memcpy(v_.data(), velocities.data(), 4 * velocities.size());
  mass_.resize(n, 0);
  weight_.resize(n, 0);
  held_.resize(n, 0);
  fixed_.resize(n, 0);
  changed_.resize(n, 0);
  tets_.resize(mesh.tet_slots());
  // What a cut has put elsewhere or made stands for other material now. While nothing has been deformed there are no rest
  // positions in deltas: they are the positions.
  const auto take = [&](std::uint32_t id) {
    x_[id] = before_[id] = vector_at(mesh.positions(), id);
    rest_[id] = vector_at(mesh.rest_positions(), id);
    fixed_[id] = is_held(rest_[id]);
    changed_[id] = 1;
  };
  for (const std::uint32_t id : mesh.deformed() ? delta.rest_ids : delta.moved_ids) take(id);
  for (std::uint32_t id = first_added; id < n; ++id) take(id);
  for (const std::uint32_t id : delta.removed_tets) remove_tet(id);
  for (const std::uint32_t id : delta.tets.ids) set_tet(mesh, id);
  for (std::uint32_t id = 0; id < tets_.size(); ++id) {
    const auto& v = tets_[id].v;
    if (tets_[id].mass_kg > 0 && (changed_[v[0]] || changed_[v[1]] || changed_[v[2]] || changed_[v[3]]))
      set_tet(mesh, id);
  }
  std::fill(changed_.begin(), changed_.end(), 0);
}

void SoftBody::hold(const Replica& mesh, std::span<const std::uint32_t> held) {
  for (const std::uint32_t id : held_list_) {
    held_[id] = 0;
    update_weight(id);
  }
  held_list_.assign(held.begin(), held.end());
  std::erase_if(held_list_, [this](std::uint32_t id) { return id >= vertices(); });
  for (const std::uint32_t id : held_list_) {
    x_[id] = vector_at(mesh.positions(), id);
    v_[id] = Vector{};
    held_[id] = 1;
    update_weight(id);
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
  const float volume = dot(f[0], cofactor[0]) - goal;
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

void SoftBody::step(double dt_s, int substeps) {
  const auto dt = static_cast<float>(dt_s / substeps);
  const auto keep = static_cast<float>(std::exp(-material_.damping_per_s * static_cast<double>(dt)));
  const double mu = material_.young_pa / (2 * (1 + material_.poisson));
  const double lambda =
      material_.young_pa * material_.poisson / ((1 + material_.poisson) * (1 - 2 * material_.poisson));
  const float shear_compliance = 1 / (static_cast<float>(mu) * dt * dt);
  const float volume_compliance = 1 / (static_cast<float>(lambda) * dt * dt);
  const Vector fall{0, 0, -dt * static_cast<float>(material_.gravity_m_s2), 0};
  for (int n = 0; n < substeps; ++n) {
    for (std::size_t i = 0; i < x_.size(); ++i) {
      before_[i] = x_[i];
      if (weight_[i] > 0) x_[i] += dt * (v_[i] + fall);
    }
    for (const Tet& tet : tets_) {
      if (tet.per_volume > 0)
        project(tet, shear_compliance, volume_compliance, static_cast<float>(1 + mu / lambda));
    }
    for (std::size_t i = 0; i < x_.size(); ++i) {
      // A table lies below the body: what is cut off does not fall out of the picture.
      if (weight_[i] > 0) x_[i][2] = std::max(x_[i][2], low_[2]);
      v_[i] = (keep / dt) * (x_[i] - before_[i]);
    }
  }
}

std::span<const float> SoftBody::positions() {
  out_.clear();
  for (const Vector& p : x_) out_.insert(out_.end(), {p[0], p[1], p[2]});
  return out_;
}

}  // namespace incise::xpbd
