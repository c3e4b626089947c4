#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/tolerances.hpp"
#include "server/core/cut/cut_config.hpp"
#include "server/core/stroke/stroke_builder.hpp"
#include "server/core/stroke/swept_surface.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

// The way of the blade in its stroke and the surface that it has swept, as far back as something may still need it.
class StrokePath {
 public:
  // h: mean edge length, m.
  StrokePath(const CutConfig& config, double h) : config_(config), h_(h) {
    retraced_.reserve(kMaxRetraced);
    way_.reserve(tolerance::kMaxWayLines + 1);
  }

  // A new stroke.
  void clear();

  // What the sweep of a batch depends on besides its lines.
  struct Tissue {
    Vec3 low, high;  // a box around it: what is swept beyond is left out
    bool deformed =
        false;  // other tissue may have come to where the blade has been: nothing counts as swept already
  };
  // Adds what a batch sweeps. Call build() before the surface is asked.
  void add(const Batch& batch, const Tissue& tissue, WorkMeter& work);
  // Adds a quad of an older sweep's end, or one that `continues` an end to a wall, to the last batch.
  void add_strip(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, bool continues) {
    surface_.add_strip(a, b, c, d, swept_.back().batch, continues);
  }
  // Forgets what the blade swept before it had travelled `limit_m`.
  void forget_before(double limit_m);
  void build(const Box& tissue) { surface_.build(first_latest_, &tissue); }
  // What was swept goes along with the tissue, between two batches.
  void move(const AffineMotion& motion);
  // After the stroke's end.
  void clear_surface() { surface_.clear(); }

  const SweptSurface& surface() const { return surface_; }
  // The first triangle of the last batch.
  std::size_t first_latest() const { return first_latest_; }
  // Lines of older batches at which the blade, as the last one shows, has turned sharply: rims as well.
  std::span<const BladeLine> late_turns() const { return late_turns_; }
  // The oldest batch whose triangles are kept.
  std::uint32_t oldest_batch() const { return swept_.front().batch; }
  // How far the blade has travelled in this stroke, and how far it had before the last batch, m.
  double travel_m() const { return travel_m_; }
  double travel_before_batch_m() const { return swept_.back().travel_m; }
  // How far it had before one of the batches of the surface, m.
  double travel_before_m(std::uint32_t batch) const {
    return std::ranges::lower_bound(swept_, batch, {}, &Swept::batch)->travel_m;
  }

  // Two parts, in the order of the file format.
  void archive_surface(Archive& io);
  void archive_travel(Archive& io, double& widest_m);

 private:
  static constexpr std::size_t kMaxRetraced = tolerance::kMaxRetraced;

  void sweep(const BladeLine& from, const BladeLine& to, int columns, const Tissue& tissue);
  // Whether the surface, as it was before the batch, is near all that the blade sweeps between two lines, and the second line lies straight above or below it
  // throughout.
  enum class Covered { kNo, kNear, kOver };
  Covered covers(const BladeLine& from, const BladeLine& to, const Tissue& tissue, WorkMeter& work);
  // Whether all lines between them lie so.
  bool is_over_between(const BladeLine& from, const BladeLine& to, const Tissue& tissue, WorkMeter& work);
  // How many lines a motion is looked at by.
  int retrace_rows(const BladeLine& from, const BladeLine& to) const;
  // Of a line, all that is in the tissue.
  bool is_near(const BladeLine& line, const Tissue& tissue, WorkMeter& work) const;
  bool is_over(const BladeLine& line, const Tissue& tissue, WorkMeter& work) const;
  template <class Is>
  bool everywhere(const BladeLine& line, const Tissue& tissue, WorkMeter& work, Is is) const;
  void go_on(const BladeLine& to);

  struct Swept {
    std::uint32_t batch;
    double travel_m;  // of the blade in this stroke before the batch
  };
  // A line from which the blade has swept on, and the triangles that this added if they are the last batch's.
  struct WayLine {
    BladeLine line;
    std::size_t begin = 0, end = 0;
  };

  const CutConfig& config_;
  const double h_;
  bool begun_ = false;  // some surface has been swept
  SweptSurface surface_;
  std::size_t first_latest_ = 0;
  std::vector<Swept> swept_;  // the batches of surface_
  // Lines between which the surface covers what the blade has swept, from one that lies over it; none: it has left the surface.
  std::vector<BladeLine> retraced_;
  double travel_m_ = 0;
  std::vector<WayLine> way_;  // since the last bend
  std::vector<BladeLine> late_turns_;
};

}  // namespace incise::core
