#pragma once

// Recorded motions of a tool, as text: TUM trajectories and CSV with a header.

#include <cstddef>
#include <cstdint>
#include <iosfwd>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::protocol {

// A motion that cannot be read. The message names file, line, what was found and what is accepted.
struct MotionError : std::runtime_error {
  using std::runtime_error::runtime_error;
};
// Nothing in the file looks like a motion: its first line is neither a TUM line nor a CSV header.
struct NotAMotion : MotionError {
  using MotionError::MotionError;
};
// There is no sample in the file: it is empty, or has only comments or a header.
struct EmptyMotion : NotAMotion {
  using NotAMotion::NotAMotion;
};

struct Motion {
  std::vector<PoseSample> samples;  // times strictly rising, quaternions of unit length
  bool csv = false;                 // else TUM
  bool has_orientation = false;     // else every orientation is the identity
  bool has_buttons = false;         // else no button is ever held
  std::size_t not_rising = 0;       // samples skipped because their time is not later than the one before
  // Where the clock restarted, or a capture's blade had another holder: indices of samples that begin a new stroke. Their times, and all later ones, are
  // shifted so that the motion continues after a pause of a second.
  std::vector<std::size_t> restarts;
  std::string warning;  // what was skipped or shifted, and where first; else empty
};

// What to do with a sample whose time is not later than that of the one before. kSkip: if it is more than a second earlier
// and the next sample continues from there, the clock has restarted, and both are kept; else the sample is skipped.
enum class Times { kSkip, kRefuse };

// Puts samples one behind the other so that their times rise: skips those that are not later, and joins what follows a
// restart of the clock, as Times says.
class RisingSamples {
 public:
  RisingSamples(std::string name, Times times) : name_(std::move(name)), times_(times) {}
  // `line`: where in the file, for messages; 0 where it has no lines. Throws MotionError.
  void add(PoseSample sample, std::size_t line = 0);
  // The next sample begins a new stroke, and its clock may have another origin. If it is not later than the last one, it and all after it come
  // a second later.
  void begin_clock() { begins_clock_ = !samples_.empty(); }
  std::size_t size() const { return samples_.size(); }
  // Once, after the last: moves the samples into `motion`, with where the clock restarted and the warning.
  void finish(Motion& motion);

 private:
  // A sample that is earlier than the last one kept: skipped, unless the next one shows that the clock has restarted.
  struct Early {
    PoseSample sample;
    std::int64_t file_ns;
    std::string where;
  };
  [[noreturn]] void fail(std::size_t line, const std::string& what) const;
  void handle_earlier(const PoseSample& sample, std::int64_t file_ns, std::size_t line);
  bool continues(std::int64_t file_ns) const;
  void restart(PoseSample sample, std::int64_t file_ns);
  void take_up_clock(std::int64_t file_ns, std::size_t line);
  void skip_early();
  std::string warning() const;

  std::string name_;
  Times times_;
  std::vector<PoseSample> samples_;
  std::vector<std::size_t> restarts_;
  std::size_t not_rising_ = 0, clock_restarts_ = 0;
  std::optional<Early> early_;
  std::int64_t shift_ns_ = 0;  // from the file's times to ours, after a restart
  bool begins_clock_ = false;  // the next sample does
  std::string first_skipped_, first_restart_;
};

// Reads a motion. Lines that begin with # and empty lines are passed over. Two formats, told apart by the
// first other line:
//
// - TUM (no comma): `t x y z qx qy qz qw`, seconds and metres.
// - CSV: a header names the columns, in any order: t_s, x_m, y_m, z_m; qw, qx, qy, qz (all or none); button
//   (a mask, bit i: button i is held). Other columns are passed over.
//
// Times keep their nanoseconds; `times` says what happens if they do not rise. Quaternions may be off unit
// length by 10 % and are normalised; q and -q are one rotation. Throws MotionError.
Motion read_motion(std::istream& in, const std::string& name, Times times = Times::kSkip);
// The same from a file.
Motion read_motion(const std::string& path, Times times = Times::kSkip);
// Opens the file of a motion, text or capture, so that one can go back to its beginning: a pipe is first read to its end,
// into memory. Throws MotionError.
std::unique_ptr<std::istream> open_motion(const std::string& path);

// "12.345 s": nanoseconds as a file has them, in seconds, every digit.
std::string seconds_text(std::int64_t ns);
// The warning of a file in which `skipped` of `samples` samples were skipped; `first` says where and what the first was.
std::string skipped_warning(const std::string& name, std::size_t skipped, std::size_t samples,
                            const std::string& first);

// A blade as command lines give it: `hx,hy,hz:tx,ty,tz`, heel and tip in the tool's frame, metres. Throws MotionError
// naming the option, what was found and what is accepted.
BladeEdge parse_blade(const std::string& option, const std::string& text);

}  // namespace incise::protocol
