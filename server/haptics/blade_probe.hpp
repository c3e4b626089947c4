#pragma once

#include "server/core/stroke/blade.hpp"
#include "server/haptics/material.hpp"
#include "server/haptics/probe_work.hpp"
#include "server/haptics/tissue.hpp"

namespace incise::haptics {

// How a blade's edge lies in the tissue at one moment, with the materials summed along it.
struct Engagement {
  double length_m = 0;    // of the edge inside, as it is now
  double uncut_m = 0;     // of that, in tissue that no cut has opened along the edge
  double fracture_n = 0;  // toughness times uncut length: the work of cutting on, for each metre of motion
  double friction_n_s_m = 0;  // friction times length
  double stiffness_n_m = 0;   // of the tissue that the edge presses on
  double puncture_n = 0;      // the largest
  double middle = 0;          // of what is inside: a parameter of the line, 0 at the heel, 1 at the tip
  // The ends of the longest stretch inside, as parameters.
  double from = 0, to = 0;
};

// Finds the parts of the edge inside, from its crossings with the surface and a walk through the
// tetrahedra between them, and which of that is cut, every 0.25 h. O(log surface + tetrahedra along the edge), within the bounds of
// `work`; at most kMostCrossings crossings count.
Engagement probe(const Tissue& tissue, const Materials& materials, const RestLine& line,
                 ProbeWork& work) noexcept;
inline constexpr int kMostCrossings = 64;

}  // namespace incise::haptics
