#pragma once

#include <cstdint>

#include "server/core/stroke/blade.hpp"

namespace incise::core {

// How a swept surface becomes a cut.
enum class Policy {
  kConforming,  // snap or split where the sweep crosses edges, separate on the dual graph: the default
  kCroll,       // Croll 2007 as written: the baseline
};

// What the policy `conforming` prefers where accuracy and the number of tetrahedra are at odds.
enum class Preference {
  kNoGrowth,  // never adds a tetrahedron: snaps where it can, opens the nearest faces elsewhere
  kBalanced,  // splits an edge only where no vertex can be snapped
  kExact,  // moves no vertex farther than a twentieth of an edge, but splits: all that the body had on one side stays there
};

// All that decides what a cut does. Lengths with `_h` are in units of h, the mesh's mean edge length, so nothing here
// depends on the size of the mesh or on its units.
struct CutConfig {
  Policy policy = Policy::kConforming;
  Preference prefer = Preference::kBalanced;
  Blade blade;
  bool always_engaged = false;       // true: the blade cuts whatever the buttons say
  std::uint32_t engage_buttons = 1;  // else it cuts while any of these buttons is held
  bool engages(std::uint32_t buttons) const noexcept {
    return always_engaged || (buttons & engage_buttons) != 0;
  }
  double speed_limit_m_s = 2.0;     // a faster motion of heel or tip ends the stroke: it is a jump, not a cut
  double gap_limit_s = 0.25;        // so does a longer silence of the source
  double batch_h = 0.25;            // travel of the blade after which its segments are committed
  double chord_tolerance_h = 0.02;  // how far the swept surface may leave the poses it stands for
};

// The most blades at once. Sources are numbered from 0.
inline constexpr std::uint32_t kMaxSources = 8;

}  // namespace incise::core
