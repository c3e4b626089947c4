#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "protocol/replica.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::stream {

// A published delta in the shape of the wire: arrays of scalars. Reused from delta to delta, so a warm one
// allocates nothing.
class DeltaArrays {
 public:
  // The message that takes `before` to the delta's revision. Valid until the next call; points into
  // `published` too. O(delta).
  const protocol::Delta& assign(const PublishedDelta& published, const protocol::Replica& before);

 private:
  protocol::Delta message_;
  std::vector<std::uint32_t> provenance_a_, provenance_b_;
  std::vector<double> provenance_t_;
  std::vector<std::uint32_t> tet_ids_, tet_vertices_;
  std::vector<std::int32_t> regions_;
  std::vector<std::uint8_t> cut_masks_, boundary_masks_;
  std::vector<std::uint32_t> piece_ids_, piece_sizes_, piece_tets_;
  std::vector<std::uint32_t> rest_ids_;
  std::vector<core::Vec3> rest_;
};

// Makes `replica` hold the state. Returns what is wrong with it, or an empty text. O(state).
std::string load_initial(const InitialState& initial, protocol::Replica& replica);

}  // namespace incise::stream
