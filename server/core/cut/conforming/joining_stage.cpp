#include "server/core/cut/conforming/joining_stage.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace incise::core {

using namespace tolerance;

namespace {

// Where no wall is within reach: how far ahead it is.
constexpr double kNoWall = -std::numeric_limits<double>::infinity();

// What is farther than this many reaches is so however it is rounded.
constexpr double kSurelyReach = 1 + 1e-9;

// SweepEnd::travel_m of one that its own stroke passes over.
constexpr double kNeverOwn_m = std::numeric_limits<double>::infinity();

// Which way the blade moves, across itself: a unit vector, or 0 where it moves along itself, or hardly at all.
Vec3 direction_of(const BladeLine& from, const BladeLine& to) {
  const Vec3 motion = (to.heel - from.heel) + (to.tip - from.tip);
  const Vec3 along = normalized(to.tip - to.heel);
  const Vec3 across = motion - dot(motion, along) * along;
  if (squared_length(across) < kLeastAcross * kLeastAcross * squared_length(motion)) return {};
  return normalized(across);
}

// Along the blade, out of what a quad stands for: beyond the way of its heel, or of its tip.
Vec3 beyond(const SweptMemory::Quad& quad, SweptMemory::End end) {
  const Vec3 along = normalized((quad.from.tip - quad.from.heel) + (quad.to.tip - quad.to.heel));
  return end == SweptMemory::kTip ? along : -along;
}

// From that way back into the quad, by no more than this.
Vec3 back_into(const SweptMemory::Quad& quad, SweptMemory::End end, double by_m) {
  return -std::min(by_m, distance(quad.from.heel, quad.from.tip)) * beyond(quad, end);
}

}  // namespace

void JoiningStage::clear() {
  direction_ = {};
  strip_.clear();
  begins_ = false;
}

void JoiningStage::begin(const Batch& batch) {
  parts_.clear();
  swept_.clear();
  walled_.clear();
  free_.clear();
  next_ = next_end_ = next_quad_ = walls_end_ = 0;
  next_end_part_ = 0;
  own_rims_ = 0;
  for (std::size_t i = 0; i + 1 < batch.lines.size(); ++i) {
    const BladeLine &from = batch.lines[i], &to = batch.lines[i + 1];
    const Vec3 direction = direction_of(from, to);
    const bool swept = squared_length(direction_) > 0, sweeps = squared_length(direction) > 0;
    if (swept && !sweeps) {
      list(from, direction_);
      end_strip(from);
    }
    if (sweeps && !swept) {
      list(from, -direction);
      begin_strip(from);
    }
    if (sweeps && swept && turns_back(from, direction)) keep_turn(from);
    if (sweeps) {
      follow_strip(to);
      swept_.push_back({from.heel, from.tip, to.tip});
      swept_.push_back({from.heel, to.tip, to.heel});
    }
    direction_ = direction;
  }
  if (batch.ends_stroke && squared_length(direction_) > 0) {
    list(batch.lines.back(), direction_);
    end_strip(batch.lines.back());
  }
  list_rims(batch);
  enclose_swept();
}

void JoiningStage::enclose_swept() {
  if (swept_.empty()) return;
  Vec3 across{};
  in_reach_ = Box::around({swept_.front().a});
  for (const Triangle& t : swept_) {
    in_reach_.add(Box::around({t.a, t.b, t.c}));
    const Vec3 n = cross(t.b - t.a, t.c - t.a);
    // A blade that goes back and forth turns it over.
    across += dot(n, across) < 0 ? -n : n;
  }
  in_reach_ = in_reach_.widened(kJoinReach_h * cut_.h);
  const Triangle& first = swept_.front();
  const Vec3 normal = normalized(across), along = normalized(first.b - first.a);
  around_.axes = {normal, along, normalized(cross(normal, along))};
  for (std::size_t i = 0; i < 3; ++i) {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const Triangle& t : swept_) {
      for (const Vec3& p : {t.a, t.b, t.c}) {
        const double at = dot(around_.axes[i], p);
        low = std::min(low, at);
        high = std::max(high, at);
      }
    }
    around_.low[i] = low - cut_.clear_m;
    around_.high[i] = high + cut_.clear_m;
  }
}

bool JoiningStage::advance(WorkBudget& budget) {
  for (; next_end_ < cut_.workspace.ends.size(); ++next_end_, next_end_part_ = 0) {
    SweepEnd& end = cut_.workspace.ends[next_end_];
    if (!comes_near(end)) continue;
    if (next_end_part_ == 0) end_strip_m_ = strip_m(end);
    for (; next_end_part_ < end.part_count; ++next_end_part_) {
      cut_.work.charge(budget);
      if (budget.spent()) return false;
      cut_.work += cost::kLook;
      if (!(end.taken >> next_end_part_ & 1) && comes_near(end, next_end_part_)) take_up(end, next_end_part_);
    }
  }
  if (!take_up_rims(budget)) return false;
  while (next_ < parts_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    if (next_ == walls_end_) gather_walls();
    const Part& part = parts_[next_++];
    cut_.work += cost::kLook;
    if (part.kind == Part::kRim) {
      close_last();
      extend_rim(part);
      continue;
    }
    const bool follows = next_ > 1 && parts_[next_ - 2].precedes(part);
    const double at_from = follows ? ahead_at_end_m_ : wall_ahead(part.from, part.direction);
    ahead_at_end_m_ = wall_ahead(part.to, part.direction);
    // An edge of the body may be farther ahead than both.
    const double amid = wall_ahead(lerp(part.from, part.to, 0.5), part.direction);
    const double ahead_m = std::max({at_from, amid, ahead_at_end_m_});
    if (!follows) close_last();
    if (part.kind == Part::kAside ? ahead_m > 0 && ahead_m <= kJoinReach_h * cut_.h : ahead_m != kNoWall) {
      walled_.push_back({next_ - 1, ahead_m});
    } else if (part.kind == Part::kAside) {
      close_last();
    } else {
      free_.push_back(next_ - 1);
    }
  }
  close_last();
  return true;
}

// Continues the last parts that have a wall ahead, if that closes anything.
void JoiningStage::close_last() {
  if (!walled_.empty() && is_closed_by_walls()) {
    for (const Walled& walled : walled_) {
      const Part& part = parts_[walled.part];
      extend(part.from, part.to, part.direction, walled.ahead_m);
    }
    // What two of a sweep's sides take off is no lobe of the body as it grew.
    cut_.meets_cut = cut_.meets_cut || parts_[walled_[0].part].kind == Part::kAside;
  }
  walled_.clear();
  free_.clear();
}

// What is left to the boundary beside a sweep and no longer than an element is a rib of a face or two, or the tip of a splinter. Straight ahead, what
// is in the tissue has a wall, but for a few parts: where a blade enters or leaves the body at a slant, the boundary is near beside that place alone, and
// what opens there parts nothing. In a body that moves nothing that was swept before is known, and no later stage closes what is left here.
bool JoiningStage::is_closed_by_walls() const {
  if (parts_[walled_[0].part].kind == Part::kAside) return walled_.size() >= kLeastBeside;
  return mesh_.deformed() || !too_many_are_free();
}

// Whether so many of the last parts are in the tissue without a wall ahead that it hangs together there anyhow.
bool JoiningStage::too_many_are_free() const {
  double in_tissue = 0;
  for (std::size_t i : free_) {
    std::int64_t looked_at = 0;
    const Vec3 amid = lerp(parts_[i].from, parts_[i].to, 0.5);
    in_tissue += cut_.workspace.grid.locate(mesh_, amid, &looked_at) != kNone ? 1 : 0;
    cut_.work += cost::kLocate + looked_at;
    if (in_tissue > kMostFree * static_cast<double>(walled_.size())) return true;
  }
  return false;
}

// Before an older cut the sweep goes on wherever that is in reach. The boundary is near, too, where the blade comes out of the body at a slant, and nothing is
// parted there: it has to run along the heel's or the tip's way.
void JoiningStage::extend_rim(const Part& part) {
  const auto ahead = [&](double at, Of of) {
    return wall_ahead(lerp(part.from, part.to, at), part.direction, of);
  };
  double ahead_m = std::max({ahead(0, Of::kCuts), ahead(0.5, Of::kCuts), ahead(1, Of::kCuts)});
  if (ahead_m == kNoWall) {
    double first_at = 2, last_at = -1, first_m = 0, last_m = 0;
    for (const double at : {0.0, 0.5, 1.0}) {
      const double skin_m = ahead(at, Of::kSkin);
      if (skin_m == kNoWall) continue;
      // A slanted boundary that is near is farther straight ahead.
      if (skin_m > kOne_h * cut_.h && !skin_is_near(lerp(part.from, part.to, at))) return;
      if (first_at > 1) first_at = at, first_m = skin_m;
      last_at = at, last_m = skin_m;
      ahead_m = std::max(ahead_m, skin_m);
    }
    const double way_m = (last_at - first_at) * distance(part.from, part.to);
    if (way_m <= 0) return;
    if (std::abs(last_m - first_m) > kRimSlope * way_m + kLeastAhead_h * cut_.h) return;
  }
  extend(part.from, part.to, part.direction, ahead_m);
}

bool JoiningStage::skin_is_near(const Vec3& p) const {
  const double near_m = kOne_h * cut_.h;
  cut_.work.add(walls_.size(), cost::kWallsAUnit);
  return std::ranges::any_of(walls_, [&](const Wall& wall) {
    const auto& [a, b, c] = wall.corners;
    return !wall.is_cut && squared_length(closest_point(p, a, b, c) - p) <= near_m * near_m;
  });
}

// Continues a sweep beyond a wall that is so far ahead. Where it ends beyond that already, what is missing may be too narrow to matter.
void JoiningStage::extend(const Vec3& a, const Vec3& b, const Vec3& direction, double ahead_m) {
  const double most_m = kJoinBeyond_h * cut_.h;
  const double by_m = ahead_m + std::clamp(kOne_h * cut_.h - ahead_m, kLeastBeyond_h * cut_.h, most_m);
  if (by_m < kLeastJoin * most_m) return;
  const Vec3 by = by_m * direction;
  cut_.path.add_strip(a, b, b + by, a + by, true);
  cut_.workspace.swept.add({{a, b}, {a + by, b + by}, cut_.stroke, cut_.path.travel_m(), false});
}

// ------------------------------------------------------------------------------------------------ where sweeps end

void JoiningStage::begin_strip(const BladeLine& line) {
  strip_.assign(1, line);
  begins_ = true;
}

// The sweep has come to this line.
void JoiningStage::follow_strip(const BladeLine& line) {
  if (strip_.empty() || travel(strip_.back(), line) < kStripStep_h * cut_.h) return;
  strip_.push_back(line);
  const double strip_m = kStrip_h * cut_.h;
  if (begins_ && (strip_.size() == SweepEnd::kMaxLines || travel(strip_.front(), line) >= strip_m))
    keep_beginning();
  while (!begins_ && strip_.size() > 2 &&
         (strip_.size() == SweepEnd::kMaxLines || travel(strip_[1], line) >= strip_m))
    strip_.erase(strip_.begin());
}

void JoiningStage::keep_beginning() {
  keep(strip_, cut_.path.travel_m());
  begins_ = false;
}

void JoiningStage::keep(std::span<const BladeLine> lines, double travel_m) {
  const Box tissue = cut_.near_tissue();
  cut_.workspace.ends.add(cut_.stroke, travel_m, lines.data(), lines.size(), kJoinPart_h * cut_.h, tissue.low,
                          tissue.high);
}

// Whether the sweep goes back from this line, to which it had come straight for some way: a hand that trembles turns after less.
bool JoiningStage::turns_back(const BladeLine& line, const Vec3& direction) const {
  if (dot(direction, direction_) > kTurnsBack) return false;
  for (std::size_t i = strip_.size(); i > 0; --i) {
    if (travel(strip_[i - 1], line) >= kTurnsBackAfter_h * cut_.h) return true;
    if (i > 1 && dot(direction_of(strip_[i - 2], strip_[i - 1]), direction_) <= 0) return false;
  }
  return false;
}

// There it ends for what another stroke sweeps, as where the blade leaves the tissue. This stroke comes by again and again where a hand goes to and fro.
void JoiningStage::keep_turn(const BladeLine& line) {
  std::array<BladeLine, SweepEnd::kMaxLines> lines;  // a frame allocates nothing
  std::size_t count = 0;
  if (strip_.back() != line) lines[count++] = line;
  for (std::size_t i = strip_.size(); i > 0 && count < lines.size(); --i) lines[count++] = strip_[i - 1];
  if (count > 1) keep(std::span(lines).first(count), kNeverOwn_m);
}

void JoiningStage::end_strip(const BladeLine& line) {
  if (!strip_.empty() && strip_.back() != line) strip_.push_back(line);
  if (strip_.size() < 2) return;
  if (begins_) keep_beginning();
  std::reverse(strip_.begin(), strip_.end());
  keep_beginning();
  strip_.clear();
}

// Whether what is swept now may come near the strip at an older sweep's end.
bool JoiningStage::comes_near(const SweepEnd& end) const {
  if (swept_.empty()) return false;
  if (end.stroke == cut_.stroke && cut_.path.travel_m() - end.travel_m < kFar_h * cut_.h) return false;
  return in_reach_.meets({end.low, end.high});
}

// How far the strip goes from where the sweep ended, at most.
double JoiningStage::strip_m(const SweepEnd& end) {
  double most_m = 0;
  for (std::size_t k = 1; k < end.line_count; ++k)
    most_m = std::max({most_m, distance(end.lines[k].heel, end.lines[0].heel),
                       distance(end.lines[k].tip, end.lines[0].tip)});
  return most_m;
}

// Whether what is swept now may come near that part of it: few do of those of a long blade.
bool JoiningStage::comes_near(const SweepEnd& end, std::uint32_t part) const {
  const Vec3 a = end.at(0, part), b = end.at(0, part + 1);
  return around_.is_within(kJoinReach_h * cut_.h + end_strip_m_ + 0.5 * distance(a, b), lerp(a, b, 0.5));
}

void JoiningStage::take_up(SweepEnd& end, std::uint32_t part) {
  const Vec3 a = end.at(0, part), b = end.at(0, part + 1);
  const Vec3 direction = direction_of(end.lines[1], end.lines[0]);
  double ahead_m = -std::numeric_limits<double>::infinity();
  bool at_end = false;
  for (const Vec3& p : {a, lerp(a, b, 0.5), b}) at_end = sweep_ahead(p, direction, ahead_m) || at_end;
  if (!at_end && !meets_gap(end, part)) return;
  end.taken |= std::uint64_t{1} << part;
  const double tolerance_m = cut_.config.chord_tolerance_h * cut_.h;
  for (std::uint32_t k = 0, next; k + 1 < end.line_count; k = next) {
    next = end.straight_to(k, part, tolerance_m);
    cut_.path.add_strip(end.at(k, part), end.at(k, part + 1), end.at(next, part + 1), end.at(next, part),
                        false);
  }
  cut_.meets_cut = true;
  if (at_end) extend(a, b, direction, ahead_m);
}

// Takes up the ways of heels and tips of older sweeps that what is swept now comes near. True: done; false: the budget is spent.
bool JoiningStage::take_up_rims(WorkBudget& budget) {
  if (swept_.empty()) return true;
  SweptMemory& memory = cut_.workspace.swept;
  for (;; ++next_quad_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    std::size_t looked_at = 0;
    next_quad_ = memory.next_with_free_rim(next_quad_, in_reach_, looked_at);
    cut_.work.add(looked_at, cost::kQuadsAUnit);
    if (next_quad_ == memory.quads().size()) return true;
    const SweptMemory::Quad quad = memory.quads()[next_quad_];  // a copy: what is led on is remembered, too
    // What this stroke has swept just now is part of its surface. Of a hand that is at it for long, its own would be more and more.
    const bool is_own = quad.stroke == cut_.stroke;
    const double after_m = cut_.path.travel_m() - quad.travel_m - travel(quad.from, quad.to);
    if (is_own && (after_m < kOwnSweep_h * cut_.h || own_rims_ >= kMostOwnRims)) continue;
    for (auto end : {SweptMemory::kHeel, SweptMemory::kTip}) {
      const auto [a, b] = quad.rim(end);
      if (!Box::around({a, b}).meets(in_reach_)) continue;
      for (std::uint64_t free = quad.rims[end].free; free != 0; free &= free - 1) {
        const auto part = static_cast<std::uint32_t>(std::countr_zero(free));
        cut_.work += cost::kLook;
        if ((!is_own && take_up(quad, end, part)) || go_on_beyond(quad, end, part))
          memory.take(next_quad_, end, part);
      }
    }
  }
}

// Where what is swept now runs before the way of an older sweep's heel or tip, that sweep goes on until it is through. With its last strip before
// that way, for large elements open only so far before it.
bool JoiningStage::take_up(const SweptMemory::Quad& quad, SweptMemory::End end, std::uint32_t part) {
  const auto [a, b] = quad.part(end, part);
  const Vec3 direction = beyond(quad, end);
  double ahead_m = kNoWall;
  for (const Vec3& p : {a, lerp(a, b, 0.5), b}) sweep_ahead(p, direction, ahead_m);
  if (ahead_m == kNoWall) return false;
  const Vec3 back = back_into(quad, end, kStrip_h * cut_.h);
  cut_.path.add_strip(a + back, b + back, b, a, false);
  cut_.meets_cut = true;
  extend(a, b, direction, ahead_m);
  return true;
}

// Where what is swept now goes on beyond the way of a heel or a tip, as the next row of a cut deeper than the blade does, the last strip before that way is
// part of it. Edges that passed beyond the older row when it was swept may pass through it since their ends have been moved, and no row would meet them.
bool JoiningStage::go_on_beyond(const SweptMemory::Quad& quad, SweptMemory::End end, std::uint32_t part) {
  const auto [a, b] = quad.part(end, part);
  const Vec3 amid = lerp(a, b, 0.5);
  if (!in_reach_.has(amid)) return false;
  own_rims_ += quad.stroke == cut_.stroke ? 1 : 0;
  const Vec3 back = back_into(quad, end, kRow_h * cut_.h);
  if (!covers(amid + kBeyondRow_h * cut_.h * beyond(quad, end)) || covers(amid + back)) return false;
  cut_.path.add_strip(a + back, b + back, b, a, false);
  return true;
}

// Whether p lies in what is swept now.
bool JoiningStage::covers(const Vec3& p) const {
  const double off_m = kCovered_h * cut_.h;
  return std::ranges::any_of(swept_, [&](const Triangle& t) {
    cut_.work += cost::kLook;
    return squared_length(closest_point(p, t.a, t.b, t.c) - p) <= off_m * off_m;
  });
}

// Whether what is swept now comes near the strip where the tissue still hangs together: large elements open only so far before a sweep's end.
// What is open stays so.
bool JoiningStage::meets_gap(SweepEnd& end, std::uint32_t part) {
  double ahead_m = 0;
  const double amid = end.along(part + 0.5);
  for (std::uint32_t k = 1; k < end.line_count; ++k) {
    if (end.open[part] >> k & 1) continue;
    const Vec3 p = lerp(end.lines[k].heel, end.lines[k].tip, amid);
    if (!sweep_ahead(p, {}, ahead_m)) continue;
    if (!is_open(p)) return true;
    end.open[part] |= static_cast<std::uint16_t>(1U << k);
  }
  return false;
}

bool JoiningStage::is_open(const Vec3& p) {
  const double reach = kOpen_h * cut_.h;
  const Vec3 r{reach, reach, reach};
  bool open = false;
  gathered_.begin();
  cut_.workspace.grid.visit_box(p - r, p + r, [&](TetId t) {
    if (open || !gathered_.insert(t)) return;
    cut_.work += cost::kLook;
    if (!mesh_.alive(t)) return;
    const unsigned mask = mesh_.cut_mask(t);
    for (int f = 0; f < 4 && !open; ++f) {
      if (!(mask >> f & 1)) continue;
      const auto v = mesh_.face_vertices(half_face(t, f));
      const Vec3 q = closest_point(p, mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]));
      open = squared_length(q - p) <= reach * reach;
    }
  });
  return open;
}

// Whether what is swept now comes near p, and how far ahead that is, at most.
bool JoiningStage::sweep_ahead(const Vec3& p, const Vec3& direction, double& ahead_m) const {
  const double reach = kJoinReach_h * cut_.h;
  if (!around_.is_within(reach, p)) return false;
  bool near = false;
  for (const Triangle& t : swept_) {
    cut_.work += cost::kLook;
    const Vec3 q = closest_point(p, t.a, t.b, t.c);
    if (squared_length(q - p) > reach * reach) continue;
    near = true;
    const Vec3 n = cross(t.b - t.a, t.c - t.a);
    const double d = dot(q - p, direction);
    if (std::abs(dot(n, direction)) >= kSinAlong * length(n) || d >= kLeastAhead_h * cut_.h)
      ahead_m = std::max(ahead_m, d);
  }
  return near;
}

void JoiningStage::move(const AffineMotion& motion) {
  direction_ = motion.turn(direction_);
  for (BladeLine& line : strip_) line = motion(line);
}

void JoiningStage::archive(Archive& io) {
  io(direction_);
  io(begins_);
  io.list(strip_, 48, [&](BladeLine& line) {
    io(line.heel);
    io(line.tip);
  });
}

// Lists a line at which the sweep ends, and would go on in that direction. Under a boundary that runs along the sweep, the way out is to
// one of its sides.
void JoiningStage::list(const BladeLine& line, const Vec3& direction) {
  list(line.heel, line.tip, direction, Part::kEnd);
  // In a body that moves, that may be elsewhere by the time the blade has left.
  if (mesh_.deformed()) return;
  // The direction is across the line before, from which this one may have turned.
  const Vec3 aside = normalized(cross(direction, line.tip - line.heel));
  list(line.heel, line.tip, aside, Part::kAside);
  list(line.heel, line.tip, -aside, Part::kAside);
}

// Lists its parts that are near the tissue.
void JoiningStage::list(const Vec3& from, const Vec3& to, const Vec3& direction, Part::Kind kind) {
  const int count = static_cast<int>(
      std::clamp(std::ceil(distance(from, to) / (kJoinPart_h * cut_.h)), 1.0, kMaxJoinParts));
  const auto at = [&](int i) {
    return i == 0 ? from : i == count ? to : lerp(from, to, static_cast<double>(i) / count);
  };
  const Box tissue = cut_.near_tissue();
  if (!Box::around({from, to}).meets(tissue)) return;
  for (int i = 0; i < count; ++i) {
    const Vec3 a = at(i), b = at(i + 1);
    if (Box::around({a, b}).meets(tissue)) parts_.push_back({a, b, direction, kind});
  }
}

// Lists the ways of the heel and the tip, by the chords by which what was swept is remembered: the sweep would go on along the blade.
void JoiningStage::list_rims(const Batch& batch) {
  for_each_chord(batch.lines, kRemembered_h * cut_.h, [&](const BladeLine& a, const BladeLine& b, double) {
    if (squared_length(direction_of(a, b)) == 0) return;
    const Vec3 along = normalized((a.tip - a.heel) + (b.tip - b.heel));
    list(a.heel, b.heel, -along, Part::kRim);
    list(a.tip, b.tip, along, Part::kRim);
  });
}

// The walls near the next parts, as far as these follow each other.
void JoiningStage::gather_walls() {
  walls_.clear();
  const Part& first = parts_[next_];
  Box in_reach = Box::around({first.from});
  for (walls_end_ = next_; walls_end_ < parts_.size() && walls_end_ < next_ + kJoinBlock; ++walls_end_) {
    if (walls_end_ > next_ && !parts_[walls_end_ - 1].precedes(parts_[walls_end_])) break;
    in_reach.add(Box::around({parts_[walls_end_].to}));
  }
  in_reach = in_reach.widened(kSurelyReach * kJoinReach_h * cut_.h);
  gathered_.begin();
  cut_.workspace.grid.visit_box(in_reach.low, in_reach.high, [&](TetId t) {
    if (!gathered_.insert(t)) return;
    cut_.work += cost::kLook;
    if (!mesh_.alive(t)) return;
    const unsigned mask = mesh_.boundary_mask(t);
    for (int f = 0; f < 4; ++f) {
      if (!(mask >> f & 1)) continue;
      const auto v = mesh_.face_vertices(half_face(t, f));
      const Vec3 &a = mesh_.position(v[0]), &b = mesh_.position(v[1]), &c = mesh_.position(v[2]);
      const Box box = Box::around({a, b, c});
      if (!box.meets(in_reach)) continue;
      const Vec3 normal = mesh_.twice_area(half_face(t, f));
      const double facing = std::abs(dot(normal, first.direction)) / length(normal);
      const Wall wall{{a, b, c}, box, normal, facing, (mesh_.cut_mask(t) >> f & 1) != 0};
      if (is_ahead(wall, first)) walls_.push_back(wall);
    }
  });
}

// An older cut, or the body's own boundary where this faces a blade that moves in that direction: not where the blade enters the body.
// Beside the sweep, the boundary alone counts, from inside: along an older cut the sweep is one with it.
bool JoiningStage::is_ahead(const Wall& wall, const Part& part) const {
  const bool is_cut = wall.is_cut;
  if (part.kind == Part::kRim) {
    return is_cut || (wall.facing >= kCosFacing && dot(wall.normal, part.direction) > 0);
  }
  if (part.kind == Part::kEnd) return is_cut || wall.facing >= kCosFacing;
  return !is_cut && wall.facing >= kCosFacing && dot(wall.normal, part.direction) > 0;
}

// How far ahead of p a wall is. Less than 0 where p is beyond it. The stroke's own faces open farther
// behind the blade.
double JoiningStage::wall_ahead(const Vec3& p, const Vec3& direction, Of of) const {
  const double reach = kJoinReach_h * cut_.h;
  const Box in_reach = Box::around({p}).widened(kSurelyReach * reach);
  double ahead = kNoWall;
  cut_.work.add(walls_.size(), cost::kWallsAUnit);
  for (const Wall& wall : walls_) {
    if (of != Of::kAll && wall.is_cut != (of == Of::kCuts)) continue;
    if (!wall.box.meets(in_reach)) continue;
    const auto& [a, b, c] = wall.corners;
    const Vec3 q = closest_point(p, a, b, c);
    const double d = dot(q - p, direction);
    // A cut that the blade runs along counts where it begins ahead: the blade that goes into a slit again adds nothing at its end.
    if (wall.facing < kSinAlong && d < kLeastAhead_h * cut_.h) continue;
    if (squared_length(q - p) > reach * reach) continue;
    ahead = std::max(ahead, d);
    // The nearest point of a slanted wall is not the one straight ahead.
    const double straight = dot(wall.normal, q - p) / dot(wall.normal, direction);
    const Vec3 x = p + straight * direction;
    if (straight > ahead && straight <= kOne_h / kCosFacing * cut_.h &&
        squared_length(closest_point(x, a, b, c) - x) <= kAimOff_h * kAimOff_h * cut_.h * cut_.h)
      ahead = straight;
  }
  return ahead;
}

}  // namespace incise::core
