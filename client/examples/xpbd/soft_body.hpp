#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/replica.hpp"

namespace incise::xpbd {

// What the body is made of and how its surroundings hold it: SI units.
struct Material {
  double young_pa = 2000;  // of soft tissue, a few kilopascals
  double poisson = 0.45;   // nearly incompressible
  double density_kg_m3 = 1050;
  double tension_pa = 300;      // with which tissue pulls at a cut
  double retraction_m = 0.015;  // when a lip has gone so far, nothing pulls at it any more
  double damping_per_s = 18;    // velocities fall by e in 1/25 s
  // Pascals that the surroundings resist with for each metre that the skin has moved: all of it a little, as fat and
  // peritoneum do; what lies on the bed (from below) and the ends along x (ligaments) much, fading out towards the middle.
  double skin_pa_m = 2e4, bed_pa_m = 5e5;
};

// A soft body on the tetrahedra that a server cuts: extended position based dynamics (XPBD; Macklin, Müller and Chentanez
// 2016) in small steps of one iteration each (Macklin et al. 2019), with a stable neo-Hookean material (Macklin and Müller
// 2021, "A Constraint-based Formulation of Stable Neo-Hookean Materials"). All constraints belong to tetrahedra, so that a cut
// needs no more than its delta: gone ones stop pulling, new ones get their shape from rest positions.
//
// At rest. A body that was scanned or modelled has its shape under gravity and under the pull of what surrounds it, so this is
// where it rests: nothing sags, and nothing moves before something is done to it. Tension shows where a cut releases it. By
// superposition (Bueckner 1958, "The propagation of cracks and the energy of elastic deformation"), that is the same as an
// untensed body whose cut faces are pressed apart with that tension: cut faces get it as a load, and nothing else does. It falls as a lip
// retracts, so a piece that is cut off moves no farther than that. Whatever moves is damped within a tenth of a second, and what a cut leaves
// is made heavy enough for the substeps (kHeaviness), so the body soon rests.
//
// Loads. A blade's force was computed for the body as the server had it; while the body gives way it would fall, along a spring
// no stiffer than kContact_n_m. It does so here, between two messages: a force that stayed as it was would drive soft tissue too far,
// and back, and so on. With springs up to that stiffness each step comes nearer to where force and tissue agree, however late messages are.
//
// Arrays are indexed by the server's ids. Thread: one, at a time.
class SoftBody {
 public:
  // Of one time step, seconds, which step() does in so many smaller ones.
  SoftBody(const Material& material, double step_s, int substeps);

  // Starts over with a whole mesh, with all velocities zero and without loads. O(mesh).
  void load(const protocol::Replica& mesh);
  // Takes a cut in; `mesh` is the state after it. False, and nothing is done, for deformations, which are our own positions
  // coming back. O(mesh), some 2 ns a tetrahedron.
  bool apply(const protocol::Replica& mesh, const protocol::Delta& delta);
  // The server did not move these where they were sent, at a blade that cuts or so that no tetrahedron inverts: they stay where
  // they are in `mesh` until let_go().
  void hold(const protocol::Replica& mesh, std::span<const std::uint32_t> vertices);
  void let_go();
  bool holds() const { return !held_list_.empty(); }
  // What a blade does to the body, until the next load of this blade. False: that is much as it was; where the body rests, more so.
  bool press(const protocol::BladeLoad& load, bool rests = false);
  void release_blades() { blades_.clear(); }

  // All velocities are zero.
  void stop() { std::fill(v_.begin(), v_.end(), Vector{}); }
  // A time step on.
  void step();

  // How far some vertex is from where the server has it, as far as we know: where it said, or where we sent it, m. O(vertices).
  double unsent_m() const;
  // x y z of all vertices.
  std::span<const float> positions();
  // They have gone to the server.
  void note_sent() { sent_ = x_; }
  std::uint32_t tets() const { return live_tets_; }
  std::uint32_t vertices() const { return static_cast<std::uint32_t>(x_.size()); }
  double size_m() const;

 private:
  // x y z, and a fourth number beside them: one register.
  using Vector = float __attribute__((vector_size(16)));
  struct Tet {
    std::array<std::uint32_t, 4> v{};
    // Of its shape at rest: the inverse of the matrix of its edges from v[0], by rows, which are the gradients of the barycentric
    // coordinates of v[1] to v[3], and its volume; all 0 where it is too flat to have a stiffness. And 1 / the volume that it has for
    // stiffness and mass; 0: there is no tetrahedron.
    std::array<float, 9> inverse{};
    float volume = 0, per_volume = 0;
    std::uint8_t cut_faces = 0, skin_faces = 0;  // a bit for each
  };
  // A blade's force, N, along the unit vector `way`, shared out by `shares`, which sum to 1. It acted where these were at `center`.
  struct BladeForce {
    std::uint32_t source = 0;
    Vector way{};
    float force = 0, center = 0;
    std::vector<std::uint32_t> ids;
    std::vector<float> shares;
  };
  static constexpr float kContact_n_m = 2000;  // the server's haptics.stiffest_n_m

  void add_weight(const Tet& tet, float sign);
  float tether_pa_m(const Vector& rest) const;
  void set_tet(const protocol::Replica& mesh, std::uint32_t id);
  void remove_tet(std::uint32_t id);
  void add_faces(const Tet& tet, float sign);
  void update_vertex(std::uint32_t vertex);
  void project(const Tet& tet, float shear_compliance, float volume_compliance, float goal);
  bool much_the_same(const BladeForce& before, const BladeForce& now, float tremor) const;
  float give(const BladeForce& blade) const;
  float acting(const BladeForce& blade) const;
  void push(const BladeForce& blade);

  const Material material_;
  const int substeps_;
  const float dt_;           // of a smaller one, s
  const float mu_, lambda_;  // Lame's parameters, Pa
  Vector low_{}, high_{};    // of the body at rest
  std::vector<Vector> x_, before_, v_, rest_, sent_;
  std::vector<Vector> lips_;         // N: the tension that cuts have released
  std::vector<float> skin_, wound_;  // m^2 of each
  std::vector<float> tether_;        // N/m towards the place at rest
  std::vector<float> mass_, stiff_;  // kg; N/m
  std::vector<float> weight_;        // 1/kg, 0 where it is held
  std::vector<std::uint32_t> uses_;  // tetrahedra that have it
  std::vector<std::uint8_t> held_;
  std::vector<std::uint32_t> held_list_, freed_;  // held; let go since the last cut
  std::vector<Vector> began_;                     // where freed_ were before the step
  std::vector<Tet> tets_;
  std::uint32_t live_tets_ = 0;
  std::vector<BladeForce> blades_;
  std::vector<std::uint8_t> changed_;  // scratch, by vertex
  std::vector<float> out_;
};

}  // namespace incise::xpbd
