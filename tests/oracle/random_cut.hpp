#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/core/session/cut_session.hpp"

// Random cuts right through a body, with what geometry says about each: the sweep is a surface that is known in closed
// form, so nothing of the cutter's own is needed to judge it.
namespace incise::oracle {

enum class Shape { kPlanar, kTwisted, kCurved, kBoth };
const char* to_string(Shape shape);

class RandomCut {
 public:
  // A sweep through `mesh` in `segments` equal steps: at a random place near its middle, in a random direction. Twisted: the
  // blade turns about the line of its motion by up to 25 degrees each way; curved: its path bends sideways by up to an
  // eighth of the body. The same seed gives the same cut, however many segments describe it.
  RandomCut(const core::MeshData& mesh, Shape shape, int segments, std::uint64_t seed);

  // Pushes it into source 0, and ends the stroke. The session is always engaged, and has no limits of speed and of gaps.
  void push(core::CutSession& session) const;

  // How far p lies off the swept surface, along the normal at the nearest blade line, m: positive on one side. The
  // distance is at most its magnitude.
  double side(const core::Vec3& p) const;

  // Where the blade is at each pose.
  std::vector<core::BladeLine> lines() const;

 private:
  core::BladeLine line(double s) const;  // s from 0 to 1, on the ideal sweep

  core::Vec3 middle_, ahead_, along_, normal_;
  double reach_ = 0, turn_ = 0, bend_ = 0, phase_ = 0;
  int segments_ = 1;
};

}  // namespace incise::oracle
