#include "server/core/cut/conforming/closing_stage.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

namespace incise::core {

using namespace tolerance;

void ClosingStage::begin(std::span<const HalfFace> opened) {
  begin_around();
  for (HalfFace h : opened) list_around(h);
  for (HalfFace h : cut_.others.left()) {
    if (mesh_.alive(tet_of(h))) list_around(h);
  }
  cut_.others.left().clear();
  gaps_.clear();
  rest_.clear();
  left_.clear();
  faces_.clear();
  doubtful_.clear();
  together_.clear();
  hangs_between_ = false;
  asked_ = 0;
  apart_ = kNone;
  bridges_.stop();
  parts_.begin();
  finder_.begin();
  round_ = Kind::kAcross;
  pass_.begin();
  go(Phase::kCollect);
}

void ClosingStage::begin_around() {
  around_.clear();
  scan_ = cut_.workspace.next_serial();
}

void ClosingStage::list_around(HalfFace h) {
  for (VertexId v : mesh_.face_vertices(h)) {
    if (std::exchange(cut_.workspace.vertices[v].looked_at, scan_) != scan_) around_.push_back(v);
  }
}

bool ClosingStage::advance(WorkBudget& budget) {
  switch (phase_) {
    case Phase::kCollect:
      if (!collect(budget)) return false;
      go(Phase::kCollectMade);
      return false;
    case Phase::kCollectMade:
      if (!collect_made(budget)) return false;
      begin_around();
      waited_.swap(waiting_);
      go(Phase::kCollectWaiting);
      return false;
    case Phase::kCollectWaiting:
      if (!collect_waiting(budget)) return false;
      go(Phase::kCollectHeld);
      return false;
    case Phase::kCollectHeld:
      if (!cut_.has_front && !collect_held(cut_.workspace.held, Kind::kAcross, budget)) return false;
      go(Phase::kCollectAroundHeld);
      return false;
    case Phase::kCollectAroundHeld:
      if (!collect(budget)) return false;
      std::sort(gaps_.begin(), gaps_.end());
      go(Phase::kJudge);
      return false;
    case Phase::kJudge:
      if (!judge(budget)) return false;
      sides_.begin();
      go(Phase::kLookFar);
      return false;
    case Phase::kLookFar:
      if (!look_far(budget)) return false;
      doubtful_.clear();
      if (!rest_.empty() && (!faces_.empty() || hangs_between_)) {
        gaps_.swap(rest_);
        std::sort(gaps_.begin(), gaps_.end());
        go(Phase::kJudge);
        return false;
      }
      keep_rest_closed();
      begin_around();
      go(Phase::kOpen);
      return false;
    case Phase::kOpen:
      if (!open(budget)) return false;
      parts_.begin();
      // A face beside what has opened may be all that holds two parts together now.
      if (!around_.empty() && !cut_.has_front) {
        pass_.begin();
        go(Phase::kCollectAroundHeld);
        return false;
      }
      if (cut_.has_front) return true;
      if (round_ == Kind::kNeck) {
        if (!cut_.meets_cut) return true;
        suspects_.begin();
        go(Phase::kFindBridges);
        return false;
      }
      hangs_between_ = false;
      round_ = round_ == Kind::kAcross ? Kind::kRib : Kind::kNeck;
      go(round_ == Kind::kRib ? Phase::kCollectRibs : Phase::kCollectNecks);
      return false;
    case Phase::kCollectRibs:
      if (!collect_held(cut_.workspace.ribs, Kind::kRib, budget)) return false;
      go(Phase::kCollectHeld);
      return false;
    case Phase::kCollectNecks:
      if (!collect_held(cut_.workspace.necks, Kind::kNeck, budget)) return false;
      go(gaps_.empty() ? Phase::kOpen : Phase::kCollectRibs);
      return false;
    case Phase::kFindBridges:
      return find_bridges(budget);
  }
  return true;
}

inline void ClosingStage::consider_faces(TetId t) {
  if (pass_.insert(t)) consider_new_faces(t);
}

// The faces around the vertices of what has opened, or is held.
bool ClosingStage::collect(WorkBudget& budget) {
  for (; next_ < around_.size(); ++next_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    if (next_ + 4 < around_.size()) {
      mesh_.prefetch_position(around_[next_ + 4]);
      mesh_.prefetch_star(around_[next_ + 2]);
    }
    mesh_.star(around_[next_], star_);
    cut_.work.add(star_.size(), cost::kStarCornersAUnit);
    for (Corner c : star_) consider_faces(tet_of(c));
    pinched_.list(around_[next_]);
  }
  return true;
}

// Those of new tetrahedra: the ones that were considered, and held, may be gone.
bool ClosingStage::collect_made(WorkBudget& budget) {
  for (; next_ < editor_.made().size(); ++next_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    cut_.work += cost::kLook;
    if (mesh_.alive(editor_.made()[next_])) consider_faces(editor_.made()[next_]);
  }
  return true;
}

// Those that have waited.
bool ClosingStage::collect_waiting(WorkBudget& budget) {
  while (next_ < waited_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const Waiting w = waited_[next_++];
    cut_.work += cost::kLook;
    if (cut_.has_front && cut_.path.travel_m() < w.ripe_at_m) {
      waiting_.push_back(w);
      continue;
    }
    set_waits(w.face, false);
    if (mesh_.alive(tet_of(w.face)) && mesh_.opposite(w.face) != kNone && all_at_boundary(w.face))
      consider(w.face);
  }
  waited_.clear();
  return true;
}

// The end of a stroke may have parted, elsewhere, what held these faces closed.
bool ClosingStage::collect_held(HeldFaces& held, Kind kind, WorkBudget& budget) {
  for (; next_ < held.size(); ++next_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const auto& [h, middle, off_m, meets] = held[next_];
    cut_.work += cost::kLook;
    if (!mesh_.alive(tet_of(h)) || mesh_.opposite(h) == kNone || cut_.is_pending(h) || !all_at_boundary(h) ||
        distance(mesh_.face_middle(h), middle) > HeldFaces::kSame_h * cut_.h)
      continue;
    // What hangs together farther off a sweep that is alone is a lobe of the body as it grew.
    if ((!cut_.meets_cut && kind != Kind::kAcross && off_m > kOffAlone_h * cut_.h) ||
        cut_.others.are_near(middle)) {
      left_.push_back(held[next_]);
      continue;
    }
    Gap gap{off_m, h, meets, true, kind};
    // What was farther off when it was seen may lie on what has been swept since.
    Gap now{0, h, false, false, Kind::kAcross};
    if (kind == Kind::kNeck && finder_.may_close(now)) gap = now;
    gap.area_m2 = length(mesh_.twice_area(h));
    cut_.set_pending(h);
    cut_.set_pending(mesh_.opposite(h));
    // With the necks, what was held before may be all that is left.
    const bool waits_for_necks = round_ == Kind::kNeck && kind != Kind::kNeck;
    (waits_for_necks ? rest_ : gaps_).push_back(gap);
    // Repairs may have made faces beside it since that nothing has considered.
    const auto v = mesh_.face_vertices(h);
    if (round_ == Kind::kAcross && std::ranges::any_of(v, [this](VertexId w) { return cut_.on_surface(w); }))
      list_around(h);
  }
  held.clear();
  for (const HeldFace& left : left_) held.push(left);
  left_.clear();
  return true;
}

// Only a tetrahedron with three vertices at the boundary has such a face: few have.
void ClosingStage::consider_new_faces(TetId t) {
  unsigned inside = 0;  // bit i: vertex i is
  const auto& v = mesh_.vertices(t);
  for (unsigned i = 0; i < 4; ++i) inside |= (mesh_.at_boundary(v[i]) ? 0u : 1u) << i;
  if (std::popcount(inside) > 1) return;
  cut_.work += cost::kLook;
  for (int f = 0; f < 4; ++f) {
    if ((inside & ~(1u << f)) != 0) continue;
    const HalfFace h = half_face(t, f), o = mesh_.opposite(h);
    // From the other side it looks the same.
    if (o != kNone && !pass_.has(tet_of(o))) consider(h);
  }
}

// A face near the blade is listed once, however often its neighbours open.
void ClosingStage::consider(HalfFace h) {
  const HalfFace o = mesh_.opposite(h);
  if (waits(h) || cut_.is_pending(h) || has_to_wait(h)) return;
  suspects_.keep(h);
  Gap gap{0, h, false, false, Kind::kAcross};
  if (!finder_.may_close(gap)) {
    gap = {0, h, false, false, Kind::kNeck};
    if (!finder_.may_be_neck(gap)) return;
  }
  if (gap.kind != Kind::kAcross || cut_.others.are_near(mesh_.face_middle(h))) {
    hold(gap);
    return;
  }
  cut_.set_pending(h);
  cut_.set_pending(o);
  gap.area_m2 = length(mesh_.twice_area(h));
  gaps_.push_back(gap);
}

// Before the blade all hangs together that it is about to part.
bool ClosingStage::has_to_wait(HalfFace h) {
  if (!cut_.has_front) return false;
  const double far_m = kFar_h * cut_.h;
  const Vec3& p = mesh_.position(mesh_.face_vertices(h)[0]);
  const double d2 = squared_distance_to_segment(p, cut_.front.heel, cut_.front.tip);
  if (d2 >= far_m * far_m) return false;
  waiting_.push_back({h, cut_.path.travel_m() + far_m - std::sqrt(d2)});
  set_waits(h, true);
  return true;
}

bool ClosingStage::all_at_boundary(HalfFace h) const {
  return std::ranges::all_of(mesh_.face_vertices(h), [this](VertexId v) { return mesh_.at_boundary(v); });
}

bool ClosingStage::judge(WorkBudget& budget) {
  while (next_ < gaps_.size()) {
    if (!goes_on(budget)) return false;
    const Gap gap = gaps_[next_++];
    const HalfFace h = gap.face, o = mesh_.opposite(h);
    const auto rule = gap.kind != Kind::kAcross ? Parts::Rule::kBeside
                      : gap.by_thickness        ? Parts::Rule::kThick
                                                : Parts::Rule::kInside;
    // Most are decided by what is nearest: a crumb, beside something large as a rule, or a way round.
    const Part near = parts_.look(tet_of(o), tet_of(h), rule, kNearWay);
    const Part one = is_part(near) ? parts_.look(tet_of(h), tet_of(o), rule, kMaxWay) : near;
    const Part other = is_part(one) ? parts_.look(tet_of(o), tet_of(h), rule, kMaxWay) : one;
    const bool is_small = one == Part::kSmall || other == Part::kSmall;
    const bool lies_off = gap.off_m > kAtSkin_h * cut_.h;
    // Of two large parts one may turn out to hang by it alone.
    if (other == Part::kLarge && !is_small && lies_off && !cut_.has_front) {
      doubtful_.push_back(gap);
      continue;
    }
    if (is_part(other) && (is_small || !lies_off)) {
      if (is_small && other != Part::kSmall) parts_.look(tet_of(h), tet_of(o), rule, kMaxWay);
      if (!(is_small ? stays_closed(gap, other == Part::kSmall ? h : o, parts_.seen()) : stays_closed(gap))) {
        faces_.push_back(h);
        continue;
      }
      hangs_between_ = hangs_between_ || (one == Part::kSmall && other == Part::kSmall);
    }
    keep_closed(gap);
    if (other != Part::kCrumb) hold(gap);
  }
  gaps_.clear();
  return true;
}

bool ClosingStage::goes_on(WorkBudget& budget) {
  cut_.work.charge(budget);
  return !budget.spent() && !cut_.part_is_full();
}

void ClosingStage::keep_closed(const Gap& gap) {
  cut_.clear_pending(gap.face);
  cut_.clear_pending(mesh_.opposite(gap.face));
}

void ClosingStage::keep_rest_closed() {
  for (const Gap& gap : rest_) {
    keep_closed(gap);
    hold(gap);
  }
  rest_.clear();
}

bool ClosingStage::look_far(WorkBudget& budget) {
  while (next_ < doubtful_.size()) {
    if (!goes_on(budget)) return false;
    const Gap& gap = doubtful_[next_];
    const TwoSides::Outcome outcome = sides_.follow(tet_of(gap.face), tet_of(mesh_.opposite(gap.face)));
    if (outcome == TwoSides::Outcome::kGoesOn) continue;
    const bool apart = outcome == TwoSides::Outcome::kApart;
    const HalfFace h = gap.face, o = mesh_.opposite(h);
    const std::size_t asked = asked_;
    // Where they hang together elsewhere nothing comes off, and cuts that meet are to be open where they do.
    const bool opens = apart ? !stays_closed(gap, sides_.is_in_part(tet_of(h)) ? o : h, sides_.part())
                             : gap.meets && !may_lead_through(gap);
    if (opens) {
      faces_.push_back(h);
      if (asked_ != asked) sides_.mark_again();
    } else {
      keep_closed(gap);
      hold(gap);
      if (apart) sides_.forget();
    }
    ++next_;
  }
  return true;
}

// Opens what holds parts together though no single face does.
bool ClosingStage::find_bridges(WorkBudget& budget) {
  while (bridges_.is_looking() || next_suspect(budget)) {
    if (!bridges_.advance(budget)) return false;
    suspects_.was_looked_around(bridges_.look());
    const std::span<const HalfFace> faces = bridges_.faces();
    if (parts_something(faces)) open(faces);
  }
  if (!suspects_.is_done()) return false;
  suspects_.clear();
  return true;
}

// Whether what lies on the two sides of each of these faces would be apart near by if all of them opened, and no crumb.
bool ClosingStage::parts_something(std::span<const HalfFace> faces) {
  for (HalfFace h : faces) {
    cut_.set_pending(h);
    cut_.set_pending(mesh_.opposite(h));
  }
  const bool parts = std::ranges::all_of(faces, [&](HalfFace h) {
    const TetId one = tet_of(h), other = tet_of(mesh_.opposite(h));
    return is_part(parts_.look(one, other, Parts::Rule::kThick, kMaxWay)) &&
           is_part(parts_.look(other, one, Parts::Rule::kThick, kMaxWay));
  });
  for (HalfFace h : faces) {
    cut_.clear_pending(h);
    cut_.clear_pending(mesh_.opposite(h));
  }
  parts_.begin();
  return parts;
}

// Begins to look around the next one. False: there is none, the budget is spent, or the part of the batch is full.
bool ClosingStage::next_suspect(WorkBudget& budget) {
  while (!suspects_.is_done() && goes_on(budget)) {
    const HalfFace h = suspects_.next();
    if (h == kNone) continue;
    if (cut_.others.leave(h)) continue;
    bridges_.begin(h);
    return true;
  }
  return false;
}

// Whether its sides hang together in what was swept by more than the face: a lobe of the body as it grew does. What may be a neck has to be parted
// by what was swept; a hole opens unless it is seen to lead through the tissue.
bool ClosingStage::stays_closed(const Gap& gap) {
  const bool is_neck = gap.kind == Kind::kNeck;
  if (!is_neck && !may_lead_through(gap)) return false;
  if (std::ranges::find(together_, gap.face) != together_.end()) return true;
  if (++asked_ > kMaxNecks) return is_neck;
  const Neck::Answer answer = neck_.judge(gap.face);
  if (answer == Neck::Answer::kTogether) together_.push_back(gap.face);
  return is_neck ? answer != Neck::Answer::kApart : answer == Neck::Answer::kTogether;
}

// The same where the part on the other side of h, which is the gap, is known to its end.
bool ClosingStage::stays_closed(const Gap& gap, HalfFace h, std::span<const TetId> part) {
  if (part.size() > kMaxPart || !cut_.workspace.swept.is_whole()) return stays_closed(gap);
  // It may have several faces, and all of them open then. What is small at these belongs now to it, now to the other side.
  const TetId largest = *std::ranges::max_element(part, {}, [this](TetId t) { return mesh_.volume(t); });
  if (largest == apart_ && part.size() <= kSamePart * apart_size_ && apart_size_ <= kSamePart * part.size())
    return false;
  if (asked_ >= kMaxNecks) return stays_closed(gap);
  ++asked_;
  const Neck::Answer answer = neck_.judge(h, part);
  if (answer == Neck::Answer::kTogether) return true;
  if (answer == Neck::Answer::kUnknown && stays_closed(gap)) return true;
  apart_ = largest;
  apart_size_ = part.size();
  return false;
}

// Whether a face between vertices at cuts may be a way from one cut to another, across what lies between them.
bool ClosingStage::may_lead_through(const Gap& gap) {
  if (!gap.meets || gap.kind != Kind::kAcross || !cut_.workspace.swept.is_whole()) return false;
  return !finder_.is_near(mesh_.face_middle(gap.face));
}

void ClosingStage::hold(const Gap& gap) {
  cut_.work += cost::kLook;
  CutWorkspace& workspace = cut_.workspace;
  HeldFaces& list = gap.kind == Kind::kAcross ? workspace.held
                    : gap.kind == Kind::kRib  ? workspace.ribs
                                              : workspace.necks;
  list.push({gap.face, mesh_.face_middle(gap.face), gap.off_m, gap.meets});
}

bool ClosingStage::open(WorkBudget& budget) {
  while (next_ < faces_.size()) {
    if (!goes_on(budget)) return false;
    const std::size_t end = std::min(next_ + kOpenChunk, faces_.size());
    open(std::span<const HalfFace>(faces_.data() + next_, end - next_));
    next_ = end;
  }
  faces_.clear();
  return true;
}

void ClosingStage::open(std::span<const HalfFace> faces) {
  for (HalfFace h : faces) others_.push_back(mesh_.opposite(h));
  editor_.open(faces);
  for (std::span<const HalfFace> opened : {faces, std::span<const HalfFace>(others_)}) {
    for (HalfFace h : opened) {
      list_pinched(h);
      list_around(h);
    }
  }
  others_.clear();
}

void ClosingStage::list_pinched(HalfFace opened) {
  for (VertexId v : mesh_.face_vertices(opened)) pinched_.list(v);
}

void ClosingStage::archive(Archive& io) {
  io.list(waiting_, 13, [&](Waiting& w) {
    io(w.face);
    io(w.ripe_at_m);
    // Another blade may have taken the mark, and this one lists the face again.
    bool marked = !io.reads() && is_marked(w.face);
    io(marked);
    io.demand(tet_of(w.face) < mesh_.tet_slots(), "a waiting face of no tetrahedron");
    if (io.reads() && !io.failed() && marked) set_waits(w.face, true);
  });
  suspects_.archive(io);
}

}  // namespace incise::core
