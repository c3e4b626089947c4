#include "client/examples/xpbd/soft_body.hpp"

#include <algorithm>
#include <cmath>

namespace incise::xpbd {

using protocol::Delta;
using protocol::Replica;

bool SoftBody::is_held(const Vector& rest) const {
  const double ends = material_.held_ends * (high_.x - low_.x);
  return rest.z < low_.z + material_.held_below * (high_.z - low_.z) || rest.x < low_.x + ends ||
         rest.x > high_.x - ends;
}

void SoftBody::update_weight(std::uint32_t vertex) {
  const bool free = mass_[vertex] > 0 && !fixed_[vertex] && !held_[vertex];
  weight_[vertex] = free ? 1 / mass_[vertex] : 0;
}

void SoftBody::remove_tet(std::uint32_t id) {
  Tet& tet = tets_[id];
  if (tet.mass_kg == 0) return;
  for (const std::uint32_t v : tet.v) {
    mass_[v] = std::max(mass_[v] - 0.25 * tet.mass_kg, 0.0);
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
  const Vector& o = rest_[tet.v[0]];
  double e[9];  // edges from v[0], in columns
  double longest = 0;
  for (int j = 0; j < 3; ++j) {
    const Vector& p = rest_[tet.v[static_cast<std::size_t>(j) + 1]];
    const double d[3] = {p.x - o.x, p.y - o.y, p.z - o.z};
    for (int i = 0; i < 3; ++i) e[3 * i + j] = (1 - material_.shrink) * d[i];
    longest = std::max(longest, d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
  }
  const double six_volumes = e[0] * (e[4] * e[8] - e[5] * e[7]) + e[1] * (e[5] * e[6] - e[3] * e[8]) +
                             e[2] * (e[3] * e[7] - e[4] * e[6]);
  // A cut in a body that is strongly deformed can leave a tetrahedron flat at rest: it goes along without a stiffness.
  if (six_volumes > 1e-3 * longest * std::sqrt(longest)) {
    const double s = 1 / six_volumes;
    tet.inverse = {
        s * (e[4] * e[8] - e[5] * e[7]), s * (e[2] * e[7] - e[1] * e[8]), s * (e[1] * e[5] - e[2] * e[4]),
        s * (e[5] * e[6] - e[3] * e[8]), s * (e[0] * e[8] - e[2] * e[6]), s * (e[2] * e[3] - e[0] * e[5]),
        s * (e[3] * e[7] - e[4] * e[6]), s * (e[1] * e[6] - e[0] * e[7]), s * (e[0] * e[4] - e[1] * e[3])};
    tet.volume_m3 = six_volumes / 6;
  }
  const double least_m3 = 1e-4 * longest * std::sqrt(longest);
  tet.mass_kg = material_.density_kg_m3 * std::max(std::abs(six_volumes) / 6, least_m3);
  ++live_tets_;
  for (const std::uint32_t v : tet.v) {
    mass_[v] += 0.25 * tet.mass_kg;
    update_weight(v);
  }
}

void SoftBody::load(const Replica& mesh) {
  const std::size_t n = mesh.vertex_count();
  x_.resize(n);
  rest_.resize(n);
  low_ = {INFINITY, INFINITY, INFINITY};
  high_ = {-INFINITY, -INFINITY, -INFINITY};
  for (std::size_t i = 0; i < n; ++i) {
    const double *p = &mesh.positions()[3 * i], *r = &mesh.rest_positions()[3 * i];
    x_[i] = {p[0], p[1], p[2]};
    rest_[i] = {r[0], r[1], r[2]};
    low_ = {std::min(low_.x, r[0]), std::min(low_.y, r[1]), std::min(low_.z, r[2])};
    high_ = {std::max(high_.x, r[0]), std::max(high_.y, r[1]), std::max(high_.z, r[2])};
  }
  before_ = x_;
  v_.assign(n, {});
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
  for (auto* vectors : {&x_, &before_, &v_, &rest_}) vectors->resize(n);
  mass_.resize(n, 0);
  weight_.resize(n, 0);
  held_.resize(n, 0);
  fixed_.resize(n, 0);
  changed_.resize(n, 0);
  tets_.resize(mesh.tet_slots());
  // What a cut has put elsewhere or made stands for other material now. While nothing has been deformed there are no rest
  // positions in deltas: they are the positions.
  const auto take = [&](std::uint32_t id) {
    const double *p = &mesh.positions()[3 * std::size_t{id}],
                 *r = &mesh.rest_positions()[3 * std::size_t{id}];
    x_[id] = before_[id] = {p[0], p[1], p[2]};
    rest_[id] = {r[0], r[1], r[2]};
    fixed_[id] = is_held(rest_[id]);
    changed_[id] = 1;
  };
  const auto moved = mesh.deformed() ? delta.rest_ids : delta.moved_ids;
  for (const std::uint32_t id : moved) take(id);
  for (std::uint32_t id = first_added; id < n; ++id) take(id);
  for (std::size_t i = 0; i < delta.provenance_t.size(); ++i) {
    const Vector &a = v_[delta.provenance_a[i]], &b = v_[delta.provenance_b[i]];
    const double t = delta.provenance_t[i];
    v_[first_added + i] = {(1 - t) * a.x + t * b.x, (1 - t) * a.y + t * b.y, (1 - t) * a.z + t * b.z};
  }
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
    const double* p = &mesh.positions()[3 * std::size_t{id}];
    x_[id] = {p[0], p[1], p[2]};
    v_[id] = {};
    held_[id] = 1;
    update_weight(id);
  }
}

// The two constraints of Macklin and Müller 2021 on F, the gradient of the deformation: sqrt(tr F^T F) with the compliance
// 1 / (mu V), and det F - (1 + mu / lambda) with 1 / (lambda V); V the volume at rest.
void SoftBody::project(const Tet& tet, double dt_s) {
  const std::array<std::uint32_t, 4>& v = tet.v;
  const double w[4] = {weight_[v[0]], weight_[v[1]], weight_[v[2]], weight_[v[3]]};
  const auto& q = tet.inverse;
  const double mu = material_.young_pa / (2 * (1 + material_.poisson));
  const double lambda =
      material_.young_pa * material_.poisson / ((1 + material_.poisson) * (1 - 2 * material_.poisson));
  for (const bool volume : {false, true}) {
    const Vector& o = x_[v[0]];
    double d[9], f[9], p[9];
    for (int j = 0; j < 3; ++j) {
      const Vector& a = x_[v[static_cast<std::size_t>(j) + 1]];
      d[j] = a.x - o.x;
      d[3 + j] = a.y - o.y;
      d[6 + j] = a.z - o.z;
    }
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j)
        f[3 * i + j] = d[3 * i] * q[static_cast<std::size_t>(j)] +
                       d[3 * i + 1] * q[static_cast<std::size_t>(3 + j)] +
                       d[3 * i + 2] * q[static_cast<std::size_t>(6 + j)];
    }
    double c = 0, compliance = 0;
    if (volume) {
      p[0] = f[4] * f[8] - f[5] * f[7];
      p[1] = f[5] * f[6] - f[3] * f[8];
      p[2] = f[3] * f[7] - f[4] * f[6];
      p[3] = f[2] * f[7] - f[1] * f[8];
      p[4] = f[0] * f[8] - f[2] * f[6];
      p[5] = f[1] * f[6] - f[0] * f[7];
      p[6] = f[1] * f[5] - f[2] * f[4];
      p[7] = f[2] * f[3] - f[0] * f[5];
      p[8] = f[0] * f[4] - f[1] * f[3];
      c = f[0] * p[0] + f[1] * p[1] + f[2] * p[2] - (1 + mu / lambda);
      compliance = 1 / (lambda * tet.volume_m3);
    } else {
      double sum = 0;
      for (const double x : f) sum += x * x;
      c = std::sqrt(sum);
      if (c < 1e-9) continue;
      for (int i = 0; i < 9; ++i) p[i] = f[i] / c;
      compliance = 1 / (mu * tet.volume_m3);
    }
    // Gradients: the columns of p times the transposed inverse, for v[1] to v[3]; v[0] has the opposite of their sum.
    double g[4][3] = {};
    double sum = 0;
    for (int j = 0; j < 3; ++j) {
      for (int i = 0; i < 3; ++i) {
        g[j + 1][i] = p[3 * i] * q[static_cast<std::size_t>(3 * j)] +
                      p[3 * i + 1] * q[static_cast<std::size_t>(3 * j + 1)] +
                      p[3 * i + 2] * q[static_cast<std::size_t>(3 * j + 2)];
        g[0][i] -= g[j + 1][i];
      }
    }
    for (int k = 0; k < 4; ++k) sum += w[k] * (g[k][0] * g[k][0] + g[k][1] * g[k][1] + g[k][2] * g[k][2]);
    if (sum == 0) continue;
    const double s = -c / (sum + compliance / (dt_s * dt_s));
    for (int k = 0; k < 4; ++k) {
      Vector& x = x_[v[static_cast<std::size_t>(k)]];
      x.x += s * w[k] * g[k][0];
      x.y += s * w[k] * g[k][1];
      x.z += s * w[k] * g[k][2];
    }
  }
}

void SoftBody::step(double dt_s, int substeps) {
  const double dt = dt_s / substeps, keep = std::exp(-material_.damping_per_s * dt);
  for (int n = 0; n < substeps; ++n) {
    for (std::size_t i = 0; i < x_.size(); ++i) {
      before_[i] = x_[i];
      if (weight_[i] == 0) continue;
      v_[i].z -= material_.gravity_m_s2 * dt;
      x_[i] = {x_[i].x + dt * v_[i].x, x_[i].y + dt * v_[i].y, x_[i].z + dt * v_[i].z};
    }
    for (const Tet& tet : tets_) {
      if (tet.volume_m3 > 0) project(tet, dt);
    }
    for (std::size_t i = 0; i < x_.size(); ++i) {
      if (weight_[i] == 0) {
        v_[i] = {};
        continue;
      }
      // A table lies below the body: what is cut off does not fall out of the picture.
      x_[i].z = std::max(x_[i].z, low_.z);
      const double s = keep / dt;
      v_[i] = {s * (x_[i].x - before_[i].x), s * (x_[i].y - before_[i].y), s * (x_[i].z - before_[i].z)};
    }
  }
}

std::span<const float> SoftBody::positions() {
  out_.clear();
  for (const Vector& p : x_)
    out_.insert(out_.end(), {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
  return out_;
}

}  // namespace incise::xpbd
