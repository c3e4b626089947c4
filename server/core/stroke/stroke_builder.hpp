#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/core/session/vertex_positions.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// What became of a pose.
enum class PoseVerdict : std::uint8_t {
  kAccepted,
  kNewStroke,          // accepted, but too far or too late after the last one to be one motion with it
  kNotFinite,          // rejected: a coordinate is NaN or infinite, or farther than kFarthest from the origin
  kNotUnit,            // rejected: the quaternion's length is off 1 by more than kUnitTolerance
  kTimeNotIncreasing,  // rejected: not later than the source's last pose
  kUnknownSource,      // rejected: the source's number is kMaxSources or more
};
inline constexpr int kPoseVerdicts = 6;
inline constexpr double kUnitTolerance = 0.01;
inline constexpr double kFarthest_m = 1e4;
// A short name, for messages: "accepted", "not finite", ...
const char* to_string(PoseVerdict verdict);
inline bool accepted(PoseVerdict v) {
  return v == PoseVerdict::kAccepted || v == PoseVerdict::kNewStroke;
}

// Blade lines whose sweep is committed as one: between two consecutive lines the heel and the tip move straight, and
// the ruled quad between is cut as the triangles (heel0, tip0, tip1) and (heel0, tip1, heel1). Or no cut, but a
// deformation that waits among them.
struct Batch {
  std::uint32_t source = 0;
  std::uint32_t stroke = 0;                 // of all sources, from 1
  std::uint32_t number = 0;                 // within the stroke, from 1
  bool ends_stroke = false;                 // flush: nothing more will come
  std::vector<BladeLine> lines;             // at least one; the first is the last one of the batch before
  std::vector<std::uint64_t> steps;         // for each line: so many deformations went before it
  std::int64_t from_t_ns = 0, to_t_ns = 0;  // source times of the first and the last line
  std::shared_ptr<const VertexPositions> deformation;  // instead of a cut; stroke 0
  std::vector<double> ways_m;  // of a deformation: how far each source's blade has gone since the last one
};

// Which batch: 0 and 0 for none.
struct BatchNumber {
  std::uint32_t stroke = 0, batch = 0;
};

// Batches that wait to be cut, oldest first. Keeps the memory of those that are done: a steady stream of batches
// allocates nothing.
class BatchQueue {
 public:
  bool empty() const { return size_ == 0; }
  std::size_t size() const { return size_; }
  // The sum of their segments.
  std::size_t segments() const { return segments_; }
  const Batch& front() const { return ring_[head_]; }
  // Appends `batch` by swapping it in: it comes back with old contents, whose capacity can be used again.
  void push(Batch& batch);
  // Takes the oldest out, into `batch`, likewise.
  void pop(Batch& batch);

 private:
  std::vector<Batch> ring_;
  std::size_t head_ = 0, size_ = 0, segments_ = 0;
};

// Makes strokes and batches out of one source's poses. What comes out depends on the poses alone: not on when they
// came, nor on how far the cutting is.
class StrokeBuilder {
 public:
  // h: mean edge length, m. `stroke_counter` is shared by all sources and must outlive this.
  StrokeBuilder(std::uint32_t source, const CutConfig& config, double h, std::uint32_t& stroke_counter);

  // Takes a pose; batches that it completes are appended to `out`. `step`: so many deformations went before it. O(1) amortised, O(buffer) when a
  // batch completes.
  PoseVerdict push(Pose pose, BatchQueue& out, std::uint64_t step = 0);
  // Ends the running stroke, if there is one: the source was let go, or has vanished.
  void end_stroke(BatchQueue& out);

  bool in_stroke() const { return in_stroke_; }
  const Pose& last_pose() const { return last_pose_; }
  const Blade& blade() const { return config_.blade; }
  // How far the blade has gone in its stroke since this was last asked, m; less where it has stood since.
  double take_way() { return std::exchange(way_m_, 0); }
  // The batch made last.
  BatchNumber last_batch() const { return {stroke_, batch_}; }

  void archive(Archive& io);

 private:
  struct TimedLine {
    BladeLine line;
    std::int64_t t_ns;
    std::uint64_t step;
  };
  void begin_stroke(const TimedLine& line);
  void emit(BatchQueue& out, bool ends_stroke);
  void smooth(bool ends_stroke);
  void simplify();

  const std::uint32_t source_;
  const CutConfig config_;
  const double travel_m_;  // that completes a batch
  const double tolerance_m_;
  const double noise_m_, noise_span_m_;  // the tolerance in spans no longer than the second
  std::uint32_t& stroke_counter_;
  bool has_pose_ = false;
  bool in_stroke_ = false;
  Pose last_pose_;
  std::uint32_t stroke_ = 0, batch_ = 0;
  std::vector<TimedLine> buffer_;  // the lines after the last batch; [0] is that batch's last line
  double way_m_ = 0;
  std::vector<std::uint32_t> kept_;  // indices into buffer_ that the simplification keeps
  std::vector<std::pair<std::uint32_t, std::uint32_t>> spans_;  // its stack
  Batch made_;                                                  // scratch
};

}  // namespace incise::core
