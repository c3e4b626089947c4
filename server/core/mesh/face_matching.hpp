#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "server/core/mesh/delta.hpp"

namespace incise::core {

// Finds the half-faces that have the same three vertices. `face(h)`: the vertices of half-face h, in any order; h and they run below
// `half_faces` (at most 2^30) and `vertices`. Calls pair(a, b, turned) for two, a < b; `turned`: they have their vertices in the
// same circular order, though they see the face from opposite sides. Calls more(half-faces, ascending) for three and more; it should throw.
//
// The faces go into buckets by their lowest vertex, some 24 each, and are compared within these. O(half_faces).
//
// `part`: only those whose lowest vertex is part.index modulo part.count, so that several threads can share the work.
struct MatchPart {
  std::uint32_t index = 0, count = 1;
};
template <class Face, class Pair, class More>
void match_faces(HalfFace half_faces, std::size_t vertices, MatchPart part, Face face, Pair pair, More more) {
  constexpr HalfFace kOdd = 1u << 31, kDone = 1u << 30;
  constexpr std::ptrdiff_t kFew = 64;
  struct Entry {
    std::uint64_t others;
    HalfFace h;  // with kOdd
  };
  const std::size_t buckets = vertices / part.count + 1;
  std::vector<std::uint32_t> begin(buckets + 1, 0);
  for (HalfFace h = 0; h < half_faces; ++h) {
    const std::array<VertexId, 3> v = face(h);
    const VertexId low = std::min({v[0], v[1], v[2]});
    if (low % part.count == part.index) ++begin[low / part.count + 1];
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<Entry> entries(begin.back());
  {
    std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
    for (HalfFace h = 0; h < half_faces; ++h) {
      const std::array<VertexId, 3> v = face(h);
      // Without branches, which would be guessed wrong half of the time.
      const VertexId low = std::min({v[0], v[1], v[2]}), high = std::max({v[0], v[1], v[2]});
      if (low % part.count != part.index) continue;
      const VertexId mid = v[0] ^ v[1] ^ v[2] ^ low ^ high;
      const auto odd = static_cast<HalfFace>((v[0] > v[1]) ^ (v[0] > v[2]) ^ (v[1] > v[2]));
      entries[next[low / part.count]++] = {std::uint64_t{mid} << 32 | high, h | odd << 31};
    }
  }
  std::vector<HalfFace> same;
  for (std::size_t v = 0; v < buckets; ++v) {
    Entry* const first = entries.data() + begin[v];
    Entry* const last = entries.data() + begin[v + 1];
    const bool sorted = last - first > kFew;
    if (sorted) {
      std::sort(first, last, [](const Entry& a, const Entry& b) {
        return a.others != b.others ? a.others < b.others : (a.h & ~kOdd) < (b.h & ~kOdd);
      });
    }
    for (Entry* a = first; a != last; ++a) {
      if (a->h & kDone) continue;
      Entry* b = nullptr;
      same.clear();
      for (Entry* c = a + 1; c != last; ++c) {
        if (c->others != a->others) {
          if (sorted) break;
          continue;
        }
        if (b != nullptr) same.push_back(c->h & ~kOdd);
        if (b == nullptr) b = c;
        if (c != b) c->h |= kDone;
      }
      if (b == nullptr) continue;
      const HalfFace ha = a->h & ~kOdd, hb = b->h & ~kOdd;
      if (same.empty()) {
        pair(ha, hb, ((a->h ^ b->h) & kOdd) == 0);
      } else {
        same.insert(same.begin(), {ha, hb});
        more(std::span<const HalfFace>(same));
      }
      b->h |= kDone;
    }
  }
}

}  // namespace incise::core
