#pragma once

// Checks that the replicas of both views and of parts share. For their sources only.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "protocol/replica.hpp"

namespace incise::protocol {

inline ApplyResult refuse(ApplyError error, std::string text) {
  return {error, std::move(text)};
}

inline std::string number(std::uint64_t n) {
  return std::to_string(n);
}

inline bool ascending(std::span<const std::uint32_t> ids) {
  return std::adjacent_find(ids.begin(), ids.end(), std::greater_equal<>()) == ids.end();
}

// `ids` ascend.
inline bool contains(std::span<const std::uint32_t> ids, std::uint32_t id) {
  return std::binary_search(ids.begin(), ids.end(), id);
}

inline void sort_unique(std::vector<std::uint32_t>& ids) {
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
}

// How many more elements vertices have after a change than before.
class MoreUses {
 public:
  struct Use {
    std::uint32_t vertex;
    std::int32_t more;
  };
  template <std::size_t N>
  void add(const std::array<std::uint32_t, N>& vertices, std::int32_t more) {
    for (const std::uint32_t v : vertices) uses_.push_back({v, more});
  }
  // Also one that has as many as before.
  void add(std::uint32_t vertex) { uses_.push_back({vertex, 0}); }
  // By vertex, each once. O(n log n) once all are added.
  const std::vector<Use>& sorted() {
    const auto by_vertex = [](const Use& a, const Use& b) { return a.vertex < b.vertex; };
    if (!std::is_sorted(uses_.begin(), uses_.end(), by_vertex))
      std::sort(uses_.begin(), uses_.end(), by_vertex);
    std::size_t last = 0;
    for (std::size_t i = 1; i < uses_.size(); ++i) {
      if (uses_[i].vertex == uses_[last].vertex) {
        uses_[last].more += uses_[i].more;
      } else {
        uses_[++last] = uses_[i];
      }
    }
    if (!uses_.empty()) uses_.resize(last + 1);
    return uses_;
  }
  // Of what sorted() gave.
  std::int64_t more(std::uint32_t vertex) const {
    const auto use = std::lower_bound(uses_.begin(), uses_.end(), vertex,
                                      [](const Use& u, std::uint32_t v) { return u.vertex < v; });
    return use == uses_.end() || use->vertex != vertex ? 0 : use->more;
  }

 private:
  std::vector<Use> uses_;
};

// Whether `chunk` is the next one of a snapshot, after the first `chunks_done`.
inline ApplyResult check_turn(const SnapshotBegin& begin, std::uint32_t chunks_done,
                              const SnapshotChunk& chunk) {
  if (chunk.index == chunks_done && chunk.index < begin.chunks) return {};
  return refuse(ApplyError::OutOfOrder, "snapshot chunk " + number(chunk.index) + ", expected is " +
                                            number(chunks_done) + " of " + number(begin.chunks));
}

// Whether `end` ends that snapshot, and all chunks have arrived.
inline ApplyResult check_turn(const SnapshotBegin& begin, std::uint32_t chunks_done, const SnapshotEnd& end) {
  if (chunks_done == begin.chunks && end.revision == begin.revision) return {};
  return refuse(ApplyError::OutOfOrder, "end of the snapshot of revision " + number(end.revision) +
                                            " after " + number(chunks_done) + " of " + number(begin.chunks) +
                                            " chunks of revision " + number(begin.revision));
}

}  // namespace incise::protocol
