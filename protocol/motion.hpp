#pragma once

// Recorded motions of a tool, as text: TUM trajectories and CSV with a header.

#include <iosfwd>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::protocol {

// A motion that cannot be read. The message names file, line, what was found and what is accepted.
struct MotionError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

struct Motion {
  std::vector<PoseSample> samples;  // times strictly rising, quaternions of unit length
  bool has_orientation = false;     // else every orientation is the identity
  bool has_buttons = false;         // else no button is ever held
  std::size_t repeated = 0;         // samples dropped because the one before has the same time and pose
};

// Reads a motion. Lines that begin with # and empty lines are passed over. Two formats, told apart by the
// first other line:
//
// - TUM (no comma): `t x y z qx qy qz qw`, seconds and metres.
// - CSV: a header names the columns, in any order: t_s, x_m, y_m, z_m; qw, qx, qy, qz (all or none); button
// (a mask,
//   bit i: button i is held). Other columns are passed over.
//
// Times keep their nanoseconds and must rise; a sample that repeats time and pose of the one before is
// dropped. Quaternions may be off unit length by 10 % and are normalised; q and -q are one rotation. Throws
// MotionError.
Motion read_motion(std::istream& in, const std::string& name);
// The same from a file.
Motion read_motion(const std::string& path);

// A blade as command lines give it: `hx,hy,hz:tx,ty,tz`, heel and tip in the tool's frame, metres. Throws MotionError
// naming the option, what was found and what is accepted.
BladeEdge parse_blade(const std::string& option, const std::string& text);

}  // namespace incise::protocol
