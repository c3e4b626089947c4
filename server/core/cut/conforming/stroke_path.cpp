#include "server/core/cut/conforming/stroke_path.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

// Of what a blade sweeps between two lines, unit; 0: nothing. Where it turns about a place on itself its ends go opposite ways.
Vec3 normal_between(const BladeLine& from, const BladeLine& to) {
  const Vec3 heel = to.heel - from.heel, tip = to.tip - from.tip;
  return normalized(cross(from.tip - from.heel, dot(heel, tip) < 0 ? tip - heel : tip + heel));
}

BladeLine lerp(const BladeLine& from, const BladeLine& to, double part) {
  return {incise::core::lerp(from.heel, to.heel, part), incise::core::lerp(from.tip, to.tip, part)};
}

// What a blade sweeps that goes straight from one line to another.
class Chord {
 public:
  Chord(const BladeLine& from, const BladeLine& to) : from_(from) {
    const Vec3 along = (from.tip - from.heel) + (to.tip - to.heel);
    heel_normal_ = normalized(cross(along, to.heel - from.heel));
    tip_normal_ = normalized(cross(along, to.tip - from.tip));
  }
  // How far a line is beside it.
  double off_m(const BladeLine& line) const {
    return std::max(std::abs(dot(heel_normal_, line.heel - from_.heel)),
                    std::abs(dot(tip_normal_, line.tip - from_.tip)));
  }

 private:
  BladeLine from_;
  Vec3 heel_normal_, tip_normal_;
};

}  // namespace

void StrokePath::clear() {
  begun_ = false;
  way_.clear();
  surface_.clear();
  swept_.clear();
  retraced_.clear();
  travel_m_ = 0;
}

void StrokePath::add(const Batch& batch, const Tissue& tissue, WorkMeter& work) {
  swept_.push_back({batch.number, travel_m_});
  first_latest_ = surface_.size();
  late_turns_.clear();
  for (WayLine& line : way_) line.begin = line.end = 0;
  const double blade_m = distance(batch.lines[0].heel, batch.lines[0].tip);
  const int columns = static_cast<int>(std::clamp(std::ceil(blade_m / (kCell_h * h_)), 1.0, kMaxColumns));
  const auto sweep_retraced = [&] {
    for (std::size_t k = 0; k + 1 < retraced_.size(); ++k)
      sweep(retraced_[k], retraced_[k + 1], columns, tissue);
    retraced_.clear();
  };
  for (std::size_t i = 0; i + 1 < batch.lines.size(); ++i) {
    const BladeLine &from = batch.lines[i], &to = batch.lines[i + 1];
    travel_m_ += travel(from, to);
    const Covered covered = covers(from, to, tissue, work);
    if (covered == Covered::kNo || retraced_.empty() || retraced_.size() == kMaxRetraced) {
      sweep_retraced();
      sweep(from, to, columns, tissue);
      if (covered == Covered::kOver) retraced_.push_back(to);
    } else {
      retraced_.push_back(to);
      if (covered == Covered::kNear) continue;
      // Back over the surface: it went out and came back, or a slit is between.
      if (!is_over_between(retraced_.front(), to, tissue, work)) sweep_retraced();
      retraced_.assign(1, to);
    }
  }
  if (batch.ends_stroke) sweep_retraced();
}

// Cells somewhat larger than tetrahedra, and flat to within the tolerance.
void StrokePath::sweep(const BladeLine& from, const BladeLine& to, int columns, const Tissue& tissue) {
  const double twist_m = length((to.tip - to.heel) - (from.tip - from.heel));
  const double rows = std::max(travel(from, to) / (kCell_h * h_),
                               kTwistSag * twist_m / (columns * config_.chord_tolerance_h * h_));
  const std::size_t begin = surface_.size();
  surface_.add_quad(from, to, static_cast<int>(std::clamp(std::ceil(rows), 1.0, kMaxRows)), columns,
                    swept_.back().batch, !begun_, tissue.low, tissue.high);
  begun_ = begun_ || squared_length(normal_between(from, to)) > 0;
  if (way_.empty() || travel(way_.back().line, from) >= kWayStep_h * h_)
    way_.push_back({from, begin, surface_.size()});
  go_on(to);
}

void StrokePath::forget_before(double limit_m) {
  std::size_t first = 0;
  while (first + 1 < swept_.size() && swept_[first + 1].travel_m <= limit_m) ++first;
  if (first == 0) return;
  swept_.erase(swept_.begin(), swept_.begin() + static_cast<std::ptrdiff_t>(first));
  first_latest_ -= surface_.drop_before(swept_.front().batch);
}

void StrokePath::move(const AffineMotion& motion) {
  surface_.move(motion);
  for (WayLine& way : way_) way.line = motion(way.line);
  for (BladeLine& line : retraced_) line = motion(line);
  surface_.build();
}

// A blade that trembles in place, or goes back in its own cut, sweeps again what it has swept: where the surface covers all
// between the two lines to within the tolerance, that is left out, or the surface would grow for as long as it goes on.
// What comes upon the surface is swept until a line lies straight above or below that throughout: no slit is left between. What leads from one such line
// to another is left out for good, for what follows overlaps there, unless there is a slit between; what comes after the last such line is swept if the
// blade leaves the surface from there.
StrokePath::Covered StrokePath::covers(const BladeLine& from, const BladeLine& to, const Tissue& tissue,
                                       WorkMeter& work) {
  if (tissue.deformed) return Covered::kNo;
  const int rows = retrace_rows(from, to);
  for (int row = rows; row > 0; --row) {
    if (!is_near(lerp(from, to, static_cast<double>(row) / rows), tissue, work)) return Covered::kNo;
  }
  return is_over(to, tissue, work) ? Covered::kOver : Covered::kNear;
}

bool StrokePath::is_over_between(const BladeLine& from, const BladeLine& to, const Tissue& tissue,
                                 WorkMeter& work) {
  const int rows = retrace_rows(from, to);
  for (int row = 1; row < rows; ++row) {
    if (!is_over(lerp(from, to, static_cast<double>(row) / rows), tissue, work)) return false;
  }
  return true;
}

int StrokePath::retrace_rows(const BladeLine& from, const BladeLine& to) const {
  return static_cast<int>(std::clamp(std::ceil(travel(from, to) / (kRetrace_h * h_)), 1.0, kMaxRetraceRows));
}

bool StrokePath::is_near(const BladeLine& line, const Tissue& tissue, WorkMeter& work) const {
  return everywhere(line, tissue, work,
                    [this](const Vec3& p) { return surface_.is_within(p, kRetrace_h * h_); });
}

bool StrokePath::is_over(const BladeLine& line, const Tissue& tissue, WorkMeter& work) const {
  return everywhere(line, tissue, work,
                    [this](const Vec3& p) { return surface_.is_over(p, kRetrace_h * h_, kClear_h * h_); });
}

template <class Is>
bool StrokePath::everywhere(const BladeLine& line, const Tissue& tissue, WorkMeter& work, Is is) const {
  // Amid a short blade, too: where it turns about its tip in a slit, both of its ends are where something was swept.
  const int columns =
      static_cast<int>(std::clamp(std::ceil(distance(line.heel, line.tip) / h_), 2.0, kMaxRetraceColumns));
  const Vec3 &low = tissue.low, &high = tissue.high;
  for (int column = 0; column <= columns; ++column) {
    const Vec3 p = lerp(line.heel, line.tip, static_cast<double>(column) / columns);
    if (p.x < low.x || p.y < low.y || p.z < low.z || p.x > high.x || p.y > high.y || p.z > high.z) continue;
    work += cost::kRetraceSample;
    if (!is(p)) return false;
  }
  return true;
}

// The way of the blade from its last bend to `to` is a chord: where it leaves that by more than the tolerance it bends, and if it turns by enough
// there, that line has to be met as exactly as a rim. Single segments do not say so: a hand that trembles points in all directions.
void StrokePath::go_on(const BladeLine& to) {
  while (way_.size() > 1) {
    const Chord chord(way_[0].line, to);
    std::size_t bend = 0;
    double most_m = kBend_h * h_;
    for (std::size_t i = 1; i < way_.size(); ++i) {
      const double off_m = chord.off_m(way_[i].line);
      if (off_m <= most_m) continue;
      most_m = off_m;
      bend = i;
    }
    if (bend == 0) break;
    const WayLine& at = way_[bend];
    if (std::abs(dot(normal_between(way_[0].line, at.line), normal_between(at.line, to))) <= kCosSharpTurn) {
      if (at.end > at.begin) {
        surface_.mark_turn(at.begin, at.end);
      } else {
        late_turns_.push_back(at.line);
      }
    }
    way_.erase(way_.begin(), way_.begin() + static_cast<std::ptrdiff_t>(bend));
  }
  std::size_t first = 0;
  while (first + 1 < way_.size() &&
         (way_.size() - first > kMaxWayLines || travel(way_[first].line, to) > kWay_h * h_))
    ++first;
  way_.erase(way_.begin(), way_.begin() + static_cast<std::ptrdiff_t>(first));
}

void StrokePath::archive_surface(Archive& io) {
  io(begun_);
  io.list(way_, 48, [&](WayLine& way) {
    io(way.line.heel);
    io(way.line.tip);
  });
  io.demand(way_.size() <= kMaxWayLines, "more lines than a way is followed by");
  surface_.archive(io);
  // Another blade may ask what it crosses before the next batch of this one.
  if (io.reads() && !io.failed()) surface_.build();
}

void StrokePath::archive_travel(Archive& io, double& widest_m) {
  io(travel_m_);
  io(widest_m);
  io.demand(travel_m_ >= 0 && widest_m >= 0, "a path or a width below 0");
  io.list(swept_, 12, [&](Swept& s) {
    io(s.batch);
    io(s.travel_m);
  });
  io.list(retraced_, 48, [&](BladeLine& line) {
    io(line.heel);
    io(line.tip);
  });
  io.demand(retraced_.size() <= kMaxRetraced, "more lines than a blade retraces");
  if (io.reads() && !io.failed()) surface_.build();
}

}  // namespace incise::core
