#include "server/core/cut/conforming/parts.hpp"

#include <algorithm>

#include "protocol/state_hash.hpp"

namespace incise::core {

using namespace tolerance;

Parts::Part Parts::look(TetId from, TetId other, Rule rule, std::size_t most) {
  pass_.begin();
  pass_.add(from);
  queue_.assign(1, from);
  inner_ = counted_ = 0;
  for (std::size_t i = 0; i < queue_.size(); ++i) {
    cut_.work += cost::kLook;
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh_.opposite(half_face(queue_[i], f));
      if (o == kNone || cut_.is_pending(o)) continue;
      if (tet_of(o) == other) return Part::kHangsTogether;
      if (pass_.insert(tet_of(o))) queue_.push_back(tet_of(o));
    }
    if (queue_.size() > most && (most < kMaxWay || !grows_as_film(i))) {
      cut_.part_judging += queue_.size();
      return Part::kLarge;
    }
  }
  cut_.part_judging += queue_.size();
  std::uint64_t hash = 0;
  for (TetId t : queue_) {
    protocol::ElementHash tet(cut_.workspace.tets[t].pending);
    tet.add(t);
    hash ^= tet.value();
  }
  const auto known =
      std::ranges::find_if(judged_, [&](const Judged& j) { return j.hash == hash && j.rule == rule; });
  if (known != judged_.end()) return known->part;
  judged_.push_back({hash, rule, judge(rule)});
  return judged_.back().part;
}

// What it has followed to the end.
Parts::Part Parts::judge(Rule rule) {
  const Extent extent = this->extent();
  if (extent.is_crumb(cut_.h)) return Part::kCrumb;
  if (rule == Rule::kBeside) {
    const bool is_part =
        films_.is_deep(queue_, kLeastPart_h3, Films::Cuts::kThisStroke) && !films_.is_film(extent, queue_);
    return is_part ? Part::kSmall : Part::kCrumb;
  }
  if (rule == Rule::kThick ? extent.volume_m3 < kOne_h * cut_.h * 0.5 * extent.area_m2
                           : films_.is_film(extent, queue_))
    return Part::kCrumb;
  if (extent.volume_m3 < kSlab_h * cut_.h * 0.5 * extent.area_m2 &&
      !films_.is_deep(queue_, kLeastDeep_h3, Films::Cuts::kAll))
    return Part::kCrumb;
  const auto reaches_off = [this](TetId t) { return !is_shallow(cut_, t, kOne_h * cut_.h); };
  return std::ranges::any_of(queue_, reaches_off) ? Part::kSmall : Part::kCrumb;
}

// The faces around it, open or about to open, part it from all else.
Extent Parts::extent() const {
  Extent extent;
  for (TetId t : queue_) {
    cut_.work += cost::kLook;
    extent.volume_m3 += mesh_.volume(t);
    for (int f = 0; f < 4; ++f) {
      const HalfFace h = half_face(t, f), o = mesh_.opposite(h);
      if (o == kNone || cut_.is_pending(o)) extent.add_face(mesh_, h);
    }
  }
  return extent;
}

// Whether what it has followed, as far as its i-th tetrahedron, may still turn out to be a film.
bool Parts::grows_as_film(std::size_t i) {
  for (; counted_ <= i; ++counted_) inner_ += films_.may_be_film(queue_[counted_]) ? 0 : 1;
  return queue_.size() <= kMaxSheetIsland && may_be_film(inner_, counted_);
}

}  // namespace incise::core
