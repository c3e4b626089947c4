#include "server/core/cut/swept_memory.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace incise::core {

namespace {

// A quad goes on as far as this many chords, while it stays this near, in chords, to what was swept.
constexpr double kMostChords = 5, kOffChords = 0.1;
// Of a coordinate: more than the rounding of a sum of three products of it.
constexpr double kRoundedSlab = 1e-14;
constexpr double kDoesNotGoOn_m = std::numeric_limits<double>::infinity();

// How far a line that a blade came by is beside the quad from one line to another.
double off_m(const BladeLine& line, const SweptMemory::Quad& quad) {
  // Its ends lie beside the rims: the quad is no wider than what was swept, either.
  return std::sqrt(std::max({squared_distance_to_segment(line.heel, quad.from.heel, quad.to.heel),
                             squared_distance_to_segment(line.tip, quad.from.tip, quad.to.tip),
                             quad.squared_distance(lerp(line.heel, line.tip, 0.5))}));
}

}  // namespace

void SweptMemory::add(std::span<const BladeLine> lines, std::uint32_t stroke, double travel_m, double chord_m,
                      const Box& box) {
  for_each_chord(lines, chord_m, [&](const BladeLine& from, const BladeLine& to, double chord_travel_m) {
    Quad quad{from, to, stroke, travel_m, true};
    travel_m += chord_travel_m;
    if (!quad.box().meets(box)) return;
    const std::size_t before = newest_that_ends_at(from, stroke);
    if (before != quads_.size() && go_on(quads_[before], to, chord_m)) {
      list_rims(quads_[before], chord_m, box);
      enclose_quad(before);
      return;
    }
    list_rims(quad, chord_m, box);
    add(quad);
  });
}

// Of the last ones the one that a stroke has swept up to this line; quads_.size(): none.
std::size_t SweptMemory::newest_that_ends_at(const BladeLine& line, std::uint32_t stroke) const {
  const std::size_t size = quads_.size();
  for (std::size_t back = 1; back <= std::min(kBlock, size); ++back) {
    const std::size_t i = (oldest_ + size - back) % size;
    if (quads_[i].stroke == stroke && quads_[i].has_rims && quads_[i].to == line) return i;
  }
  return size;
}

// Whether a quad stands for what is swept from its last line to this one as well: then it goes on to there. By how far it is beside what was swept adds up over
// all lines that it has gone over; on a circle that is twice as much as it is.
bool SweptMemory::go_on(Quad& quad, const BladeLine& to, double chord_m) {
  if (travel(quad.from, to) > kMostChords * chord_m) return false;
  Quad longer = quad;
  longer.to = to;
  longer.off_m += off_m(quad.to, longer);
  if (!(longer.off_m <= kOffChords * chord_m)) return false;
  longer.anchors[1] = {};
  quad = longer;
  return true;
}

// All parts of its rims that are near the tissue, in this box, are free.
void SweptMemory::list_rims(Quad& quad, double chord_m, const Box& box) {
  for (End end : {kHeel, kTip}) {
    const double way_m =
        end == kTip ? distance(quad.from.tip, quad.to.tip) : distance(quad.from.heel, quad.to.heel);
    Rim& rim = quad.rims[end];
    rim.parts =
        static_cast<std::uint8_t>(std::clamp(std::ceil(way_m / chord_m), 1.0, double{Rim::kMaxParts}));
    rim.free = 0;
    for (std::uint32_t k = 0; k < rim.parts; ++k) {
      const auto [a, b] = quad.part(end, k);
      if (Box::around({a, b}).meets(box)) rim.free |= std::uint64_t{1} << k;
    }
  }
}

void SweptMemory::add(const Quad& quad) {
  if (quads_.size() < kMost) {
    quads_.push_back(quad);
    enclose_quad(quads_.size() - 1);
    return;
  }
  quads_[oldest_] = quad;
  enclose_quad(oldest_);
  oldest_ = (oldest_ + 1) % kMost;
}

void SweptMemory::enclose() {
  slabs_.resize(quads_.size());
  for (std::size_t i = 0; i < quads_.size(); ++i) slabs_[i] = slabs_of({&quads_[i], 1}, quads_[i].box());
  for (std::size_t block = 0; block * kBlock < quads_.size(); ++block) enclose(block);
}

// What is around one that is new or goes on.
void SweptMemory::enclose_quad(std::size_t quad) {
  slabs_.resize(quads_.size());
  slabs_[quad] = slabs_of({&quads_[quad], 1}, quads_[quad].box());
  enclose(quad / kBlock);
}

void SweptMemory::enclose(std::size_t number) {
  blocks_.resize(std::max(blocks_.size(), number + 1));
  Block& block = blocks_[number];
  block.all = quads_[number * kBlock].box();
  block.free_rims.reset();
  const std::size_t stop = std::min(quads_.size(), (number + 1) * kBlock);
  for (std::size_t i = number * kBlock; i < stop; ++i) {
    block.all.add(quads_[i].box());
    for (End end : {kHeel, kTip}) {
      for (std::uint64_t free = quads_[i].rims[end].free; free != 0; free &= free - 1) {
        const auto [a, b] = quads_[i].part(end, static_cast<std::uint32_t>(std::countr_zero(free)));
        const Box around = Box::around({a, b});
        block.free_rims ? block.free_rims->add(around) : void(block.free_rims = around);
      }
    }
  }
  block.slabs = slabs_of(std::span(quads_).subspan(number * kBlock, stop - number * kBlock), block.all);
}

SweptMemory::Slabs SweptMemory::slabs_of(std::span<const Quad> quads, const Box& around) {
  Vec3 sum{};
  for (const Quad& quad : quads) {
    const Vec3 normal = cross(quad.to.tip - quad.from.heel, quad.to.heel - quad.from.tip);
    // A blade that goes back and forth turns it over.
    sum += dot(normal, sum) < 0 ? -normal : normal;
  }
  const Vec3 first = quads.front().from.tip - quads.front().from.heel;
  Slabs slabs;
  if (squared_length(sum) > 0) slabs[0].axis = normalized(sum);
  const Vec3 motion = cross(slabs[0].axis, first);
  if (squared_length(motion) > 0) slabs[1].axis = normalized(motion);
  const double rounded_m = kRoundedSlab * (length(around.low) + length(around.high));
  for (Slab& slab : slabs) {
    slab.low = std::numeric_limits<double>::infinity();
    slab.high = -slab.low;
    for (const Quad& quad : quads) {
      for (const Vec3& p : {quad.from.heel, quad.from.tip, quad.to.heel, quad.to.tip}) {
        const double at = dot(slab.axis, p);
        slab.low = std::min(slab.low, at - rounded_m);
        slab.high = std::max(slab.high, at + rounded_m);
      }
    }
  }
  return slabs;
}

std::size_t SweptMemory::next_with_free_rim(std::size_t quad, const Box& box, std::size_t& looked_at) const {
  while (quad < quads_.size()) {
    const std::size_t block = quad / kBlock;
    ++looked_at;
    if (!blocks_[block].free_rims || !blocks_[block].free_rims->meets(box)) {
      quad = (block + 1) * kBlock;
      continue;
    }
    for (; quad < quads_.size() && quad / kBlock == block; ++quad) {
      if (quads_[quad].has_free_rims()) return quad;
    }
  }
  return quads_.size();
}

bool SweptMemory::crosses(const Vec3& a, const Vec3& b, std::size_t& looked_at) const {
  const auto is_across = [&](const std::array<Vec3, 3>& triangle) {
    const auto& [p, q, r] = triangle;
    const Vec3 normal = cross(q - p, r - p);
    const double from = dot(normal, a - p), to = dot(normal, b - p);
    if ((from >= 0) == (to >= 0)) return false;
    const Vec3 x = lerp(a, b, from / (from - to));
    return dot(cross(q - p, x - p), normal) >= 0 && dot(cross(r - q, x - q), normal) >= 0 &&
           dot(cross(p - r, x - r), normal) >= 0;
  };
  return any_in(Box::around({a, b}), looked_at,
                [&](const Quad& quad) { return std::ranges::any_of(quad.triangles(), is_across); });
}

std::uint32_t SweptMemory::stroke_at(const Vec3& p, double reach_m, std::size_t& looked_at) const {
  std::uint32_t stroke = 0;
  any_in(Box::around({p}).widened(reach_m), looked_at, [&](const Quad& quad) {
    const bool is_near = quad.squared_distance(p) <= reach_m * reach_m;
    if (is_near) stroke = quad.stroke;
    return is_near;
  });
  return stroke;
}

void SweptMemory::take(std::size_t quad, End end, std::uint32_t part) {
  quads_[quad].rims[end].free &= ~(std::uint64_t{1} << part);
  quads_[quad].off_m = kDoesNotGoOn_m;
}

void SweptMemory::archive(Archive& io) {
  std::uint64_t oldest = oldest_;
  io(oldest);
  io(is_whole_);
  io.list(quads_, 128, [&](Quad& quad) {
    for (BladeLine* line : {&quad.from, &quad.to}) {
      io(line->heel);
      io(line->tip);
    }
    io(quad.stroke);
    io(quad.travel_m);
    io(quad.has_rims);
    io(quad.off_m);
    io.demand(quad.off_m >= 0, "a quad that is nearer to what was swept than at it");
    archive_anchors(io, quad.anchors);
    for (Rim& rim : quad.rims) {
      io(rim.parts);
      io(rim.free);
      io.demand(rim.parts >= Rim::kMaxParts ? rim.parts == Rim::kMaxParts : rim.free >> rim.parts == 0,
                "a rim with a part that it does not have");
    }
  });
  io.demand(quads_.size() <= kMost, "more is remembered of what was swept than is kept");
  io.demand(oldest == 0 || oldest < quads_.size(), "the oldest quad of those that were swept is none");
  if (!io.reads()) return;
  if (io.failed()) quads_.clear();
  oldest_ = io.failed() ? 0 : oldest;
  quads_.reserve(kMost);
  blocks_.clear();
  enclose();
}

}  // namespace incise::core
