#pragma once

// What the replicas of both views and of parts check alike. For their sources alone.

#include <algorithm>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <utility>

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

// Whether it is the next chunk of a snapshot of which so many have come.
inline ApplyResult check_turn(const SnapshotBegin& begin, std::uint32_t chunks_done,
                              const SnapshotChunk& chunk) {
  if (chunk.index == chunks_done && chunk.index < begin.chunks) return {};
  return refuse(ApplyError::OutOfOrder, "snapshot chunk " + number(chunk.index) + ", expected is " +
                                            number(chunks_done) + " of " + number(begin.chunks));
}

// Whether it ends that snapshot, and all chunks have come.
inline ApplyResult check_turn(const SnapshotBegin& begin, std::uint32_t chunks_done, const SnapshotEnd& end) {
  if (chunks_done == begin.chunks && end.revision == begin.revision) return {};
  return refuse(ApplyError::OutOfOrder, "end of the snapshot of revision " + number(end.revision) +
                                            " after " + number(chunks_done) + " of " + number(begin.chunks) +
                                            " chunks of revision " + number(begin.revision));
}

}  // namespace incise::protocol
