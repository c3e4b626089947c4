#pragma once

// One message of every kind with every field set, one capture record of every kind, and a small stream: two
// tetrahedra that share a face are cut apart, then one is split. The golden bytes in protocol/vectors are
// these.

#include <cstddef>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "protocol/capture.hpp"
#include "protocol/framing.hpp"
#include "protocol/messages.hpp"
#include "tests/protocol/model.hpp"

namespace incise::protocol::samples {

// Revision 0: two tetrahedra on five vertices, the face 1 2 3 between them. Revision 1: it is open, and the
// second has copies of its vertices and is a piece of its own. Revision 2: vertex 0 has moved, and the first
// is split in two in the middle of its edge (0, 1).
Model two_tets(std::uint64_t revision);

// Every kind of message in the order of the schema's union, under its name. The arrays live as long as the
// program.
const std::vector<std::pair<std::string, Body>>& messages();
// Messages with the fields that were added later, each under a name of its own: the bytes of those above stay as they are.
const std::vector<std::pair<std::string, Body>>& extended_messages();

// What a viewer gets (view Volume, view Surface, view Volume with a box around vertex 4): Welcome, the snapshot of revision
// 0, two deltas, Bye.
std::vector<Body> volume_stream();
std::vector<Body> surface_stream();
std::vector<Body> volume_part_stream();

CaptureHeader capture_header();
std::vector<CaptureRecord> capture_records();

// An envelope for the message at `index` of a list.
inline Envelope envelope(std::size_t index) {
  return {index + 1, 123'456'789'000 + static_cast<std::int64_t>(index)};
}

}  // namespace incise::protocol::samples
