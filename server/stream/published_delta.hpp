#pragma once

#include <cstdint>
#include <memory>
#include <variant>
#include <vector>

#include "server/core/mesh/delta.hpp"
#include "server/core/mesh/field.hpp"
#include "server/core/mesh/mesh_data.hpp"

namespace incise::protocol {
class OriginTree;
struct Restart;
}  // namespace incise::protocol

namespace incise::stream {

// A delta on its way from the loop to the stream, with times so far (CLOCK_MONOTONIC, ns). Immutable once published;
// the stream releases it once encoded, so the loop may pool these.
struct PublishedDelta {
  core::Delta delta;
  std::int64_t arrival_ns = 0;  // of the batch's last pose, at this machine
  std::int64_t drain_ns = 0;    // when the loop popped that pose
  std::int64_t cut_ns = 0;      // when the batch was done
};

// Rows of a field, from id `first` on, as they are at a revision.
struct NewFieldValues {
  std::uint32_t field = 0, first = 0;
  std::uint64_t revision = 0;
  std::variant<std::vector<float>, std::vector<std::int32_t>> values;
};

class Mirror;

// A whole state: what the stream starts from, and again after a reset.
struct InitialState {
  std::uint64_t epoch = 0;  // names this run of ids; another after each reset. Never 0
  std::uint64_t revision = 0;
  std::vector<core::Vec3> positions;                  // of all vertex slots
  std::vector<core::Vec3> rest;                       // likewise, or empty: the body has not deformed
  std::vector<core::TetState> tets;                   // live ones, ascending by id
  std::vector<std::uint32_t> piece_ids, piece_names;  // the pieces but 0, ascending; a tetrahedron of each
  std::shared_ptr<const Mirror> mirror;  // not null: the state is this one's, and the rest is empty
  std::shared_ptr<const protocol::OriginTree> origins;     // null: the body was not filled from a surface
  std::shared_ptr<const std::vector<core::Field>> fields;  // null: it has none; a row for each id
  // Null: nobody asked for it. Of a reset `by` may be empty: who asked the stream for it last.
  std::shared_ptr<const protocol::Restart> restart;
};

}  // namespace incise::stream
