#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/geometry/box.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The newest of what all blades have swept in a body at rest, as quads between two lines: what a later stroke parts may hang together where an
// older one has been, and the surface of that one is gone. Some hundred h of a blade's way.
class SweptMemory {
 public:
  struct Quad {
    BladeLine from, to;
    std::uint32_t stroke = 0;
    double travel_m = 0;    // of the blade in that stroke, before
    bool has_rims = false;  // the heel's and the tip's ways; else it leads from a sweep's end to a wall

    Box box() const { return Box::around({from.heel, from.tip, to.heel, to.tip}); }
  };

  SweptMemory() { quads_.reserve(kMost); }

  std::span<const Quad> quads() const { return quads_; }
  // What a blade has swept from the first of these lines to the last in a box, that of the tissue, by chords no shorter than
  // `chord_m`, but for the last one.
  void add(std::span<const BladeLine> lines, std::uint32_t stroke, double travel_m, double chord_m,
           const Box& box);
  void add(const Quad& quad);
  // The body has moved, the quads have not.
  void clear() {
    is_whole_ = is_whole_ && quads_.empty();
    quads_.clear();
    oldest_ = 0;
  }
  void lack_what_was_before() { is_whole_ = false; }
  // Whether nothing but the oldest of what was swept in this body has been forgotten.
  bool is_whole() const { return is_whole_; }

  void archive(Archive& io);

 private:
  static constexpr std::size_t kMost = 2048;

  std::vector<Quad> quads_;
  std::size_t oldest_ = 0;  // when there are kMost: which the next one takes the place of
  bool is_whole_ = true;
};

}  // namespace incise::core
