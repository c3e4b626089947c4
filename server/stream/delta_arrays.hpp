#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "protocol/replica.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::stream {

// A published delta as the wire has it: arrays of scalars. Reused from delta to delta, so that once warm it allocates
// nothing.
class DeltaArrays {
 public:
  // The message that takes `before` to the delta's revision. Valid until the next call; also points into `published`.
  // O(delta).
  const protocol::Delta& assign(const PublishedDelta& published, const protocol::Replica& before);

 private:
  protocol::Delta message_;
  std::vector<std::uint32_t> provenance_a_, provenance_b_;
  std::vector<double> provenance_t_;
  std::vector<std::uint32_t> tet_ids_, tet_vertices_;
  std::vector<std::int32_t> regions_;
  std::vector<std::uint8_t> cut_masks_, boundary_masks_;
  std::vector<std::uint32_t> piece_ids_, piece_sizes_, piece_names_;
  std::vector<std::uint32_t> rest_ids_;
  std::vector<core::Vec3> rest_;
  std::vector<std::uint32_t> blend_ids_, blend_vertices_;
  std::vector<double> blend_weights_;
};

// Loads the state into `replica`. Returns what is wrong with it, or an empty text. O(state).
std::string load_initial(const InitialState& initial, protocol::Replica& replica);

}  // namespace incise::stream
