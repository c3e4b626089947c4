#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string>

#include "server/core/cut/cut_config.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/haptics/latest.hpp"
#include "server/haptics/rest_map.hpp"

namespace incise::haptics {

// Forces on vertices, ids ascending.
struct VertexLoads {
  static constexpr std::size_t kMost = 96;
  std::array<core::VertexId, kMost> ids{};
  std::array<core::Vec3, kMost> forces{};  // N
  std::size_t count = 0;
  core::Vec3 center;  // they have the moment of their sum acting here, m
};

enum class ContactState : std::uint8_t { kNone, kPresses, kInside };

// What one blade does to the body in one frame, for the host simulation.
struct BladeLoad {
  std::uint64_t number = 0;  // counts the frames of this blade that had one
  std::uint64_t revision = 0;
  std::int64_t pose_t_ns = 0, now_ns = 0;
  ContactState contact = ContactState::kNone;
  bool engaged = false;
  core::BladeLine line;
  core::Vec3 tool, force, torque;  // on the hand: N, and N m about the tool's origin
  double engaged_m = 0;
  VertexLoads loads;  // sum to -force
};

// A host simulation's own model of the tissue at a blade: force = stiffness (point - tool) on the inner side of the plane
// through `point`.
struct LocalModel {
  std::uint64_t number = 0;                  // another one for each that came
  core::Vec3 point;                          // the tool's origin where the force begins, m
  core::Vec3 normal;                         // unit, out of the tissue
  Mat3 stiffness;                            // symmetric, positive semidefinite, N/m
  double damping_n_s_m = 0;                  // along the normal
  double resistance_n = 0;                   // at which the tissue gives way; 0: it holds
  std::int64_t from_ns = 0, expires_ns = 0;  // CLOCK_MONOTONIC
};

// Why a model cannot be used: what was found and what is accepted; "": it can.
std::string trouble_of(const LocalModel& model, std::int64_t now_ns);

// Between the loop and the host simulation: what blades do to the body, and the simulation's own models of it. The
// loop writes loads only while somebody reads them.
//
// Thread: loads are the loop's to write and the stream's to read, models the other way.
struct SimulationLink {
  std::atomic<std::int64_t> wanted_until_ns{0};  // CLOCK_MONOTONIC
  std::array<Latest<BladeLoad>, core::kMaxSources> loads;
  std::array<Latest<LocalModel>, core::kMaxSources> models;
};

class Tissue;
struct Engagement;

// Spreads -force over the vertices of the tetrahedra that hold the edge where it is inside: in equal parts over 8 places of the longest
// stretch, at each by barycentric coordinates, so that sum and moment are those of -force at `center`, the middle of these places. A vertex
// that the step in progress has made is not known to anyone yet: its part goes to those it lies between. Within the bounds of `work`.
VertexLoads spread(const Tissue& tissue, const RestLine& rest, const core::BladeLine& line,
                   const Engagement& engagement, const core::Vec3& force, ProbeWork& work) noexcept;

}  // namespace incise::haptics
