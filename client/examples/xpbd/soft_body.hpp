#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/replica.hpp"

namespace incise::xpbd {

// What the body is made of and how it is held: SI units.
struct Material {
  double young_pa = 4000;  // of soft tissue, a few kilopascals
  double poisson = 0.45;   // nearly incompressible
  double density_kg_m3 = 1050;
  double shrink =
      0.12;  // stress-free lengths are so much shorter than those of the mesh: it is under tension
  double damping_per_s = 3;    // velocities fall by e in 1/3 s
  double gravity_m_s2 = 9.81;  // against z
  // Held where, at rest, it is in this part of its height from below, or at one of its ends along x.
  double held_below = 0.15, held_ends = 0.04;
};

// A soft body on the tetrahedra that a server cuts: extended position based dynamics (XPBD; Macklin, Müller and Chentanez
// 2016) in small steps of one iteration each (Macklin et al. 2019), with a stable neo-Hookean material (Macklin and Müller
// 2021, "A Constraint-based Formulation of Stable Neo-Hookean Materials"). All constraints belong to tetrahedra, so that a cut needs no more than its delta: gone ones stop pulling, new ones get their shape from rest positions.
//
// Arrays are indexed by the server's ids. Thread: one, at a time.
class SoftBody {
 public:
  explicit SoftBody(const Material& material) : material_(material) {}

  // Starts over with a whole mesh, with all velocities zero. O(mesh).
  void load(const protocol::Replica& mesh);
  // Takes a cut in; `mesh` is the state after it. Deformations, which are our own positions coming back, are passed over.
  // O(mesh), some 2 ns a tetrahedron.
  void apply(const protocol::Replica& mesh, const protocol::Delta& delta);
  // The server did not move these (ascending) where they were sent: they stay where they are in `mesh` until the next call.
  void hold(const protocol::Replica& mesh, std::span<const std::uint32_t> vertices);

  // A time step, seconds, in so many smaller ones.
  void step(double dt_s, int substeps);

  // x y z of all vertices.
  std::span<const float> positions();
  std::uint32_t tets() const { return live_tets_; }
  std::uint32_t vertices() const { return static_cast<std::uint32_t>(x_.size()); }

 private:
  // x y z, and a fourth number beside them: one register.
  using Vector = float __attribute__((vector_size(16)));
  struct Tet {
    std::array<std::uint32_t, 4> v{};
    // Of the stress-free shape: the inverse of the matrix of its edges from v[0], by rows; and
    // 1 / volume, 0 where it is too flat to have a stiffness. Of no tetrahedron at all mass is 0.
    std::array<float, 9> inverse{};
    float per_volume = 0;
    float mass_kg = 0;
  };
  bool is_held(const Vector& rest) const;
  void set_tet(const protocol::Replica& mesh, std::uint32_t id);
  void remove_tet(std::uint32_t id);
  void update_weight(std::uint32_t vertex);
  void project(const Tet& tet, float shear_compliance, float volume_compliance, float goal);

  const Material material_;
  Vector low_{}, high_{};  // of the body at rest
  std::vector<Vector> x_, before_, v_, rest_;
  std::vector<float> mass_, weight_;  // kg; 1/kg, 0 where it is held
  std::vector<std::uint8_t> fixed_, held_;
  std::vector<std::uint32_t> held_list_;
  std::vector<Tet> tets_;
  std::uint32_t live_tets_ = 0;
  std::vector<std::uint8_t> changed_;  // scratch, by vertex
  std::vector<float> out_;
};

}  // namespace incise::xpbd
