#include "server/core/stroke/stroke_builder.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/stroke/jump.hpp"

namespace incise::core {
namespace {

// Poses kept between two batches at most: a blade that trembles in place for minutes must not fill the memory.
constexpr std::size_t kMaxBuffered = 512;
// In a span no longer than this, lines nearer to its chord are the device's noise and no motion, h.
constexpr double kNoiseSpan_h = 0.35, kNoise_h = 0.08;
// So is a way this many times as long as its chord: a corner's is 1.4 times.
constexpr double kNoisyWay = 1.5;
// Of the blade's way so much is left at the next pose: one that has stood for a second has gone nowhere.
constexpr double kFading = 0.98;

double distance_to_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 u = b - a;
  const double l2 = squared_length(u);
  const double t = l2 > 0 ? std::clamp(dot(p - a, u) / l2, 0.0, 1.0) : 0.0;
  return distance(p, a + t * u);
}

// A quarter of the twist: the distance between a ruled quad and its two triangles at the quad's centre.
double triangulation_error(const BladeLine& a, const BladeLine& b) {
  return 0.25 * length((b.tip - b.heel) - (a.tip - a.heel));
}

}  // namespace

const char* to_string(PoseVerdict verdict) {
  switch (verdict) {
    case PoseVerdict::kAccepted:
      return "accepted";
    case PoseVerdict::kNewStroke:
      return "accepted as a new stroke";
    case PoseVerdict::kNotFinite:
      return "not finite";
    case PoseVerdict::kNotUnit:
      return "quaternion not of unit length";
    case PoseVerdict::kTimeNotIncreasing:
      return "time not increasing";
    case PoseVerdict::kUnknownSource:
      return "unknown source";
  }
  return "?";
}

void BatchQueue::push(Batch& batch) {
  if (size_ == ring_.size()) {
    std::rotate(ring_.begin(), ring_.begin() + static_cast<std::ptrdiff_t>(head_), ring_.end());
    head_ = 0;
    ring_.resize(std::max<std::size_t>(64, 2 * ring_.size()));
  }
  segments_ += batch.lines.size() - 1;
  std::swap(ring_[(head_ + size_++) % ring_.size()], batch);
}

void BatchQueue::pop(Batch& batch) {
  std::swap(batch, ring_[head_]);
  segments_ -= batch.lines.size() - 1;
  // An empty queue begins again at its first slot, whose memory is the one used last.
  head_ = --size_ == 0 ? 0 : (head_ + 1) % ring_.size();
}

StrokeBuilder::StrokeBuilder(std::uint32_t source, const CutConfig& config, double h,
                             std::uint32_t& stroke_counter)
    : source_(source),
      config_(config),
      // Croll's segments are about as long as a tetrahedron: shorter ones would do the baseline wrong.
      travel_m_((config.policy == Policy::kCroll ? std::max(config.batch_h, 1.0) : config.batch_h) * h),
      tolerance_m_(config.chord_tolerance_h * h),
      noise_m_(std::max(config.chord_tolerance_h, kNoise_h) * h),
      noise_span_m_(config.policy == Policy::kCroll ? 0 : kNoiseSpan_h * h),
      stroke_counter_(stroke_counter) {
  buffer_.reserve(kMaxBuffered + 1);
}

PoseVerdict StrokeBuilder::push(Pose pose, BatchQueue& out, std::uint64_t step) {
  const Quat& q = pose.orientation;
  const double norm = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  if (!is_finite(pose.position) || !std::isfinite(norm) || length(pose.position) > kFarthest_m) {
    return PoseVerdict::kNotFinite;
  }
  if (std::abs(norm - 1.0) > kUnitTolerance) return PoseVerdict::kNotUnit;
  if (has_pose_ && pose.t_ns <= last_pose_.t_ns) return PoseVerdict::kTimeNotIncreasing;
  pose.orientation = {q.w / norm, q.x / norm, q.y / norm, q.z / norm};

  const bool engaged = config_.engages(pose.buttons);
  const TimedLine now{blade_line(config_.blade, pose), pose.t_ns, step};
  PoseVerdict verdict = PoseVerdict::kAccepted;
  if (in_stroke_ && is_jump(config_, config_.blade, last_pose_, pose)) {
    end_stroke(out);
    if (engaged) verdict = PoseVerdict::kNewStroke;
  }
  if (engaged && !in_stroke_) {
    begin_stroke(now);
  } else if (in_stroke_) {  // the motion up to the release still cuts
    const double by_m = travel(buffer_.back().line, now.line);
    way_m_ = kFading * way_m_ + by_m;
    if (by_m > 0) buffer_.push_back(now);
    if (!engaged) {
      end_stroke(out);
    } else if (travel(buffer_.front().line, now.line) >= travel_m_ || buffer_.size() > kMaxBuffered) {
      emit(out, false);
    }
  }
  last_pose_ = pose;
  has_pose_ = true;
  return verdict;
}

void StrokeBuilder::begin_stroke(const TimedLine& line) {
  in_stroke_ = true;
  stroke_ = ++stroke_counter_;
  batch_ = 0;
  way_m_ = 0;
  buffer_.assign(1, line);
}

void StrokeBuilder::end_stroke(BatchQueue& out) {
  if (!in_stroke_) return;
  in_stroke_ = false;
  // A stroke that never moved has swept nothing.
  if (batch_ > 0 || buffer_.size() > 1) emit(out, true);
}

// A noisy way is cut as its chord, to where the blade was on the mean of its later half: steps that zigzag would make a
// surface of creases far smaller than a tetrahedron. One that leads farther away than noise does, and back, is a cut.
void StrokeBuilder::smooth(bool ends_stroke) {
  const double chord_m = travel(buffer_.front().line, buffer_.back().line);
  if (chord_m > noise_span_m_) return;
  double way_m = 0;
  for (std::size_t i = 0; i + 1 < buffer_.size(); ++i) {
    way_m += travel(buffer_[i].line, buffer_[i + 1].line);
    if (travel(buffer_.front().line, buffer_[i].line) > noise_span_m_) return;
  }
  if (way_m < kNoisyWay * chord_m) return;
  if (!ends_stroke) {
    const std::size_t first = buffer_.size() / 2;
    Vec3 heel{}, tip{};
    for (std::size_t i = first; i < buffer_.size(); ++i) {
      heel += buffer_[i].line.heel;
      tip += buffer_[i].line.tip;
    }
    const double each = 1.0 / static_cast<double>(buffer_.size() - first);
    buffer_.back().line = {each * heel, each * tip};
  }
  buffer_.erase(buffer_.begin() + 1, buffer_.end() - 1);
}

void StrokeBuilder::emit(BatchQueue& out, bool ends_stroke) {
  if (buffer_.size() > 2) smooth(ends_stroke);
  simplify();
  Batch& batch = made_;
  batch.source = source_;
  batch.stroke = stroke_;
  batch.number = ++batch_;
  batch.ends_stroke = ends_stroke;
  batch.from_t_ns = buffer_.front().t_ns;
  batch.to_t_ns = buffer_.back().t_ns;
  batch.lines.assign(1, buffer_.front().line);
  batch.steps.assign(1, buffer_.front().step);
  for (std::size_t i = 1; i < kept_.size(); ++i) {
    batch.lines.push_back(buffer_[kept_[i]].line);
    batch.steps.push_back(buffer_[kept_[i]].step);
  }
  out.push(batch);
  buffer_.assign(1, TimedLine(buffer_.back()));
}

// Keeps the buffered lines that a polyline within the tolerance needs, heel and tip alike (Douglas and Peucker 1973),
// and those without which a quad would twist beyond it.
void StrokeBuilder::simplify() {
  kept_.clear();
  const auto last = static_cast<std::uint32_t>(buffer_.size() - 1);
  kept_.push_back(0);
  auto& spans = spans_;
  if (last > 0) spans.push_back({0, last});
  while (!spans.empty()) {
    const auto [i, j] = spans.back();
    spans.pop_back();
    const BladeLine &a = buffer_[i].line, &b = buffer_[j].line;
    double worst = 0;
    std::uint32_t at = i;
    for (std::uint32_t k = i + 1; k < j; ++k) {
      const BladeLine& l = buffer_[k].line;
      const double error =
          std::max(distance_to_segment(l.heel, a.heel, b.heel), distance_to_segment(l.tip, a.tip, b.tip));
      if (error > worst) {
        worst = error;
        at = k;
      }
    }
    bool keep = worst > (travel(a, b) <= noise_span_m_ ? noise_m_ : tolerance_m_);
    if (!keep && j > i + 1 && triangulation_error(a, b) > tolerance_m_) {
      at = i + (j - i) / 2;
      keep = true;
    }
    if (keep) {
      spans.push_back({at, j});
      spans.push_back({i, at});
    } else {
      kept_.push_back(j);
    }
  }
}

void StrokeBuilder::archive(Archive& io) {
  io(has_pose_);
  io(in_stroke_);
  io(stroke_);
  io(batch_);
  io(last_pose_.t_ns);
  io(last_pose_.position);
  for (double* q : {&last_pose_.orientation.w, &last_pose_.orientation.x, &last_pose_.orientation.y,
                    &last_pose_.orientation.z}) {
    io(*q);
    io.demand(std::isfinite(*q), "a quaternion is not finite");
  }
  io(last_pose_.buttons);
  io(way_m_);
  io.demand(way_m_ >= 0, "a way below 0");
  io.list(buffer_, 64, [&](TimedLine& line) {
    io(line.line.heel);
    io(line.line.tip);
    io(line.t_ns);
    io(line.step);
  });
  io.demand(!in_stroke_ || !buffer_.empty(), "a stroke without a line");
  io.demand(buffer_.size() <= (1u << 20), "more lines than a stroke keeps");
  io.demand(stroke_ <= stroke_counter_, "a stroke that is not counted");
  if (io.reads()) buffer_.reserve(1024);
}

}  // namespace incise::core
