#include "server/haptics/blade_probe.hpp"

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>

#include "server/core/mesh/boundary_grid.hpp"

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::TetId;
using core::Vec3;

constexpr double kSame = 1e-7;  // parameters that differ by less are one crossing

// Which parts of a line run through tissue that is cut already, in samples.
class CutStretches {
 public:
  CutStretches() = default;
  CutStretches(const CutMap& cuts, const BladeLine& line) noexcept {
    if (cuts.empty()) return;
    const double length = distance(line.heel, line.tip);
    count_ = static_cast<int>(std::clamp(std::ceil(length / cuts.cell()), 1.0, double{kMost}));
    const CutMap::Directions along = CutMap::along(normalized(line.tip - line.heel));
    for (int i = 0; i < count_; ++i) {
      if ((cuts.at(lerp(line.heel, line.tip, (i + 0.5) / count_)) & along) != 0)
        cut_.set(static_cast<std::size_t>(i));
    }
  }
  // The part of [a, b] that is not cut.
  double uncut(double a, double b) const noexcept {
    if (count_ == 0) return 1;
    const int first = sample(a), last = sample(b);
    int open = 0;
    for (int i = first; i <= last; ++i) open += !cut_.test(static_cast<std::size_t>(i));
    return static_cast<double>(open) / (last - first + 1);
  }

 private:
  static constexpr int kMost = 512;
  int sample(double t) const noexcept { return std::clamp(static_cast<int>(t * count_), 0, count_ - 1); }
  int count_ = 0;
  std::bitset<kMost> cut_;
};

// Sums over the tetrahedra that the edge passes, piece by piece. Each piece is straight in the body at rest.
class Sum {
 public:
  Sum(const Tissue& tissue, const Materials& materials, double length_m, ProbeWork& work) noexcept
      : tissue_(tissue), mesh_(tissue.body()), materials_(materials), work_(work), length_(length_m) {}

  void piece(const RestLine::Place& a, const RestLine::Place& b) noexcept {
    if (a.gap || b.gap) return;
    line_ = {a.rest, b.rest};
    begin_ = a.at;
    share_ = b.at - a.at;
    cuts_ = CutStretches(tissue_.cuts(), line_);
    std::array<Crossing, kMostCrossings> found;
    const std::size_t count = tissue_.surface().crossings(line_, found, work_);
    if (count == 0) {  // wholly inside or wholly outside
      const TetId t = !a.known               ? locate(mesh_, tissue_.surface(), line_.heel, work_)
                      : a.inside && b.inside ? a.tet
                                             : core::kNone;
      if (t != core::kNone) walk(t, 0, 1);
      return;
    }
    double done = -1;  // the piece has been processed up to here
    for (const Crossing& crossing : std::span(found).first(count)) {
      // The skin where the edge comes through, also where that is at a vertex, and the edge goes on between the elements of the skin.
      sum_.puncture_n =
          std::max(sum_.puncture_n, materials_.of(mesh_.region(core::tet_of(crossing.face))).puncture_n);
      if (crossing.entering) {
        if (crossing.at < done - kSame) continue;
        done = std::max(done, walk(core::tet_of(crossing.face), crossing.at, 1));
      } else if (done < 0) {
        // The first crossing leads out: the heel is inside.
        walk(core::tet_of(crossing.face), crossing.at, 0);
        done = crossing.at;
      }
    }
  }

  Engagement result() noexcept {
    if (sum_.length_m > 0) {
      sum_.middle /= sum_.length_m;
      sum_.stiffness_n_m += point_stiffness_ / sum_.length_m;
    }
    return sum_;
  }

 private:
  Vec3 at(double t) const noexcept { return lerp(line_.heel, line_.tip, t); }
  // A parameter of the edge.
  double edge(double t) const noexcept { return begin_ + t * share_; }

  // Walks from parameter a of the piece inside `tet`, or on its face, to b. Returns where it left the tissue; b where it did not.
  double walk(TetId tet, double a, double b) noexcept {
    double reached = a;
    const std::uint32_t room = ProbeWork::kMostTets - work_.tets;
    std::uint32_t passed = 0;
    const auto visit = [&](TetId t, double in, double out) {
      ++passed;
      reached = a + out * (b - a);
      add(t, a + in * (b - a), reached);
    };
    core::walk(mesh_, tet, at(a), at(b), visit, room);
    work_.tets += passed;
    work_.cut_short = work_.cut_short || passed == room;
    const double from = edge(std::min(a, reached)), to = edge(std::max(a, reached));
    // A stretch that begins where the last one ended, on the other side of a slit, continues it.
    if (from - stretch_to_ < 1e-6 && stretch_to_ > stretch_from_) {
      stretch_to_ = std::max(stretch_to_, to);
    } else {
      stretch_from_ = from;
      stretch_to_ = to;
    }
    if (stretch_to_ - stretch_from_ > sum_.to - sum_.from) {
      sum_.from = stretch_from_;
      sum_.to = stretch_to_;
    }
    return reached;
  }

  void add(TetId t, double first, double last) noexcept {
    double in = edge(first), out = edge(last);
    if (in <= out) {  // only forward: nothing is counted twice, even if inverted tetrahedra overlap
      in = std::max(in, counted_to_);
      counted_to_ = std::max(counted_to_, out);
      if (out <= in) return;
    } else {
      counted_to_ = std::max(counted_to_, in);
    }
    const double piece = std::abs(out - in) * length_;
    if (!(piece > 0)) return;
    const Material& material = materials_.of(mesh_.region(t));
    sum_.length_m += piece;
    sum_.middle += piece * 0.5 * (in + out);
    point_stiffness_ += piece * material.stiffness_n_m;
    sum_.stiffness_n_m += piece * material.stiffness_pa;
    sum_.friction_n_s_m += piece * material.friction_n_s_m2;
    sum_.puncture_n = std::max(sum_.puncture_n, material.puncture_n);
    const double uncut =
        piece * cuts_.uncut((std::min(in, out) - begin_) / share_, (std::max(in, out) - begin_) / share_);
    sum_.uncut_m += uncut;
    sum_.fracture_n += uncut * material.toughness_j_m2;
  }

  const Tissue& tissue_;
  const core::TetMesh& mesh_;
  const Materials& materials_;
  ProbeWork& work_;
  const double length_;  // of the edge now, m
  // Of the piece.
  BladeLine line_;
  CutStretches cuts_;
  double begin_ = 0, share_ = 1;  // where it begins on the edge, and how much of it it is
  double stretch_from_ = -1, stretch_to_ = -1, counted_to_ = 0;
  double point_stiffness_ = 0;  // times length
  Engagement sum_;
};

}  // namespace

Engagement probe(const Tissue& tissue, const Materials& materials, const RestLine& line,
                 ProbeWork& work) noexcept {
  Sum sum(tissue, materials, line.length_m, work);
  const auto places = line.all();
  for (std::size_t i = 1; i < places.size(); ++i) sum.piece(places[i - 1], places[i]);
  return sum.result();
}

}  // namespace incise::haptics
