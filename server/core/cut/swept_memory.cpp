#include "server/core/cut/swept_memory.hpp"

namespace incise::core {

void SweptMemory::add(std::span<const BladeLine> lines, std::uint32_t stroke, double travel_m, double chord_m,
                      const Box& box) {
  std::size_t from = 0;
  double chord_travel_m = 0;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    chord_travel_m += travel(lines[i - 1], lines[i]);
    if (chord_travel_m == 0 || (chord_travel_m < chord_m && i + 1 < lines.size())) continue;
    const Quad quad{lines[from], lines[i], stroke, travel_m, true};
    if (quad.box().meets(box)) add(quad);
    travel_m += chord_travel_m;
    chord_travel_m = 0;
    from = i;
  }
}

void SweptMemory::add(const Quad& quad) {
  if (quads_.size() < kMost) {
    quads_.push_back(quad);
    return;
  }
  quads_[oldest_] = quad;
  oldest_ = (oldest_ + 1) % kMost;
}

void SweptMemory::archive(Archive& io) {
  std::uint64_t oldest = oldest_;
  io(oldest);
  io(is_whole_);
  io.list(quads_, 109, [&](Quad& quad) {
    for (BladeLine* line : {&quad.from, &quad.to}) {
      io(line->heel);
      io(line->tip);
    }
    io(quad.stroke);
    io(quad.travel_m);
    io(quad.has_rims);
  });
  io.demand(quads_.size() <= kMost, "more is remembered of what was swept than is kept");
  io.demand(oldest == 0 || oldest < quads_.size(), "the oldest quad of those that were swept is none");
  if (!io.reads()) return;
  if (io.failed()) quads_.clear();
  oldest_ = io.failed() ? 0 : oldest;
  quads_.reserve(kMost);
}

}  // namespace incise::core
