#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "server/core/cut/line_anchor.hpp"
#include "server/core/geometry/box.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/stroke/swept_triangle.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The newest of what all blades have swept in a body, as quads between two lines, which go with the tissue as it moves (SweptFollower): what a later
// stroke parts may hang together where an older one has been, and the surface of that one is gone. Some thousand h of a blade's way where it is straight.
class SweptMemory {
 public:
  // The way of the heel or the tip between two lines, in parts of equal length.
  struct Rim {
    static constexpr std::uint32_t kMaxParts = 64;
    std::uint8_t parts = 0;
    std::uint64_t free = 0;  // bit k: part k is near the tissue, and no later sweep has taken it up
  };
  enum End : std::uint8_t { kHeel, kTip };
  struct Quad {
    BladeLine from, to;
    std::uint32_t stroke = 0;
    double travel_m = 0;    // of the blade in that stroke, before
    bool has_rims = false;  // the heel's and the tip's ways; else it leads from a sweep to a wall
    double off_m = 0;       // how far it may be beside what was swept; infinity: it does not go on any more
    std::array<Rim, 2> rims{};  // the heel's and the tip's
    std::array<LineAnchor, 2> anchors{};

    Box box() const { return Box::around({from.heel, from.tip, to.heel, to.tip}); }
    // As what a batch sweeps is cut.
    std::array<std::array<Vec3, 3>, 2> triangles() const {
      return {{{from.heel, from.tip, to.tip}, {from.heel, to.tip, to.heel}}};
    }
    double squared_distance(const Vec3& p) const {
      double least_m2 = std::numeric_limits<double>::infinity();
      for (const auto& [a, b, c] : triangles())
        least_m2 = std::min(least_m2, squared_length(closest_point(p, a, b, c) - p));
      return least_m2;
    }
    // A rim, from the one line to the other; part k of it.
    std::array<Vec3, 2> rim(End end) const {
      return end == kTip ? std::array{from.tip, to.tip} : std::array{from.heel, to.heel};
    }
    std::array<Vec3, 2> part(End end, std::uint32_t k) const {
      const auto [a, b] = rim(end);
      const double parts = rims[end].parts;
      return {lerp(a, b, k / parts), lerp(a, b, (k + 1) / parts)};
    }
    bool has_free_rims() const { return (rims[kHeel].free | rims[kTip].free) != 0; }
  };

  SweptMemory() {
    quads_.reserve(kMost);
    slabs_.reserve(kMost);
    blocks_.reserve(kMost / kBlock);
  }

  std::span<const Quad> quads() const { return quads_; }
  // The same, for who moves their lines and anchors; then enclose() is due.
  std::span<Quad> quads_to_move() { return quads_; }
  // The next quad, from this one on, that has a free rim and lies in a block whose free rims may meet the box; quads().size(): none. `looked_at`: increased by
  // the blocks that were looked at.
  std::size_t next_with_free_rim(std::size_t quad, const Box& box, std::size_t& looked_at) const;
  // Calls visit(quad) for all that have a point in the box, and some others near it, until it says true; returns that. `looked_at`: increased by the
  // blocks and the quads that were looked at.
  template <class Visit>
  bool any_in(const Box& box, std::size_t& looked_at, Visit visit) const {
    looked_at += blocks_.size();
    for (std::size_t block = 0; block < blocks_.size(); ++block) {
      if (!blocks_[block].meets(box)) continue;
      const std::size_t end = std::min(quads_.size(), (block + 1) * kBlock);
      looked_at += end - block * kBlock;
      for (std::size_t i = block * kBlock; i < end; ++i) {
        if (meet(slabs_[i], box) && quads_[i].box().meets(box) && visit(quads_[i])) return true;
      }
    }
    return false;
  }
  // Whether a blade has gone across the segment from a to b.
  bool crosses(const Vec3& a, const Vec3& b, std::size_t& looked_at) const;
  // A stroke that has swept within `reach_m` of p; 0: none.
  std::uint32_t stroke_at(const Vec3& p, double reach_m, std::size_t& looked_at) const;
  // A part of a rim is taken up; it may be one that is not free.
  void take(std::size_t quad, End end, std::uint32_t part);
  // What a blade has swept from the first of these lines to the last in a box, that of the tissue, by chords no shorter than
  // `chord_m`, but for the last one; the parts of rims are as long, or longer where there would be more than Rim::kMaxParts. Where the way is straight, a
  // quad goes on: short batches and long cuts would else soon fill the memory.
  void add(std::span<const BladeLine> lines, std::uint32_t stroke, double travel_m, double chord_m,
           const Box& box);
  void add(const Quad& quad);
  // Calls visit(line, anchor) for both lines of each quad.
  template <class Visit>
  void each_line(Visit visit) const {
    for (const Quad& quad : quads_) {
      visit(quad.from, quad.anchors[0]);
      visit(quad.to, quad.anchors[1]);
    }
  }
  void enclose();
  // Forgets the quads for which is_lost(anchors) holds.
  template <class IsLost>
  void forget_if(IsLost is_lost) {
    std::rotate(quads_.begin(), quads_.begin() + static_cast<std::ptrdiff_t>(oldest_), quads_.end());
    oldest_ = 0;
    if (std::erase_if(quads_, [&](const Quad& quad) { return is_lost(quad.anchors); }) > 0) is_whole_ = false;
    blocks_.clear();
    enclose();
  }
  // Nothing has an anchor: the numbers of vertices are others.
  void lose_anchors() {
    for (Quad& quad : quads_) quad.anchors = {};
  }
  void lack_what_was_before() { is_whole_ = false; }
  // Whether nothing but the oldest of what was swept in this body has been forgotten.
  bool is_whole() const { return is_whole_; }

  void archive(Archive& io);

 private:
  static constexpr std::size_t kMost = 4096, kBlock = 16;

  // Planes around a quad, or kBlock of them: across their mean normal, and across their motion. A blade is long and lies along no axis, and boxes alone let
  // through most of what it has swept.
  struct Slab {
    Vec3 axis{};  // none: it lets everything through
    double low = 0, high = 0;

    bool meets(const Box& box) const {
      const Vec3 middle = 0.5 * (box.low + box.high), half = 0.5 * (box.high - box.low);
      const double at = dot(axis, middle);
      const double reach = std::abs(axis.x) * half.x + std::abs(axis.y) * half.y + std::abs(axis.z) * half.z;
      return at - reach <= high && at + reach >= low;
    }
  };
  using Slabs = std::array<Slab, 2>;
  static bool meet(const Slabs& slabs, const Box& box) { return slabs[0].meets(box) && slabs[1].meets(box); }
  struct Block {
    Box all;                       // around kBlock quads
    Slabs slabs;                   // around them
    std::optional<Box> free_rims;  // around their free rims

    bool meets(const Box& box) const { return all.meets(box) && meet(slabs, box); }
  };

  void enclose(std::size_t block);
  void enclose_quad(std::size_t quad);
  static Slabs slabs_of(std::span<const Quad> quads, const Box& around);
  std::size_t newest_that_ends_at(const BladeLine& line, std::uint32_t stroke) const;
  static bool go_on(Quad& quad, const BladeLine& to, double chord_m);
  static void list_rims(Quad& quad, double chord_m, const Box& box);

  std::vector<Quad> quads_;
  std::vector<Slabs> slabs_;  // by quad: around it
  std::vector<Block> blocks_;
  std::size_t oldest_ = 0;  // when there are kMost: which the next one takes the place of
  bool is_whole_ = true;
};

// What a blade sweeps by these lines, in chords no shorter than `chord_m`, but for the last one: visit(its first line, its last one, the blade's way
// between them). A blade that rests makes none.
template <class Visit>
void for_each_chord(std::span<const BladeLine> lines, double chord_m, Visit&& visit) {
  std::size_t from = 0;
  double way_m = 0;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    way_m += travel(lines[i - 1], lines[i]);
    if (way_m == 0 || (way_m < chord_m && i + 1 < lines.size())) continue;
    visit(lines[from], lines[i], way_m);
    way_m = 0;
    from = i;
  }
}

}  // namespace incise::core
