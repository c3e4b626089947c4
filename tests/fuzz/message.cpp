// A stream of messages, each decoded and, where it is about state, applied to a replica that has a small
// mesh: nothing that is refused changes the state, and the hash that is kept is the hash of what is there.
// The input is a TCP stream.

#include <cstddef>
#include <cstdint>
#include <span>
#include <variant>
#include <vector>

#include "protocol/framing.hpp"
#include "protocol/replica.hpp"
#include "protocol/surface.hpp"
#include "protocol/volume_part.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::protocol;

namespace {

// Limits that keep an id from asking for more memory than a fuzzer has.
Replica small_replica() {
  static const double positions[] = {0, 0, 0, 0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01, 0.01, 0.01, 0.01};
  static const std::uint32_t ids[] = {0, 1}, vertices[] = {0, 1, 2, 3, 1, 2, 3, 4};
  static const std::int32_t regions[] = {7, -2};
  static const std::uint8_t cut_masks[] = {0, 0}, boundary_masks[] = {0b1110, 0b0111};
  Replica replica(1u << 16, 1u << 16);
  FUZZ_CHECK(replica.load(positions, {ids, vertices, regions, cut_masks, boundary_masks}, 0));
  return replica;
}

// Applies, and checks that a refusal changes nothing.
template <class R, class F>
bool try_it(R& replica, F&& change) {
  const auto before = replica.canonical_bytes();
  const ApplyResult result = change(replica);
  FUZZ_CHECK(static_cast<bool>(result) == result.text.empty());
  FUZZ_CHECK(result || replica.canonical_bytes() == before);
  return static_cast<bool>(result);
}

// The server's side of a box: follows what the volume has been through, which a replica behind it goes through after it.
class Follower {
 public:
  explicit Follower(const Replica& volume) { reload(volume); }
  template <class F>
  void snapshot(const Replica& volume, F&& change) {
    if (change(behind_)) reload(volume);
  }
  // The tetrahedra that are in another piece than before the last delta. A message may join pieces, which no cut does.
  std::vector<std::uint32_t> in_other_pieces(const Replica& volume) const {
    std::vector<std::uint32_t> out;
    behind_.for_each_tet([&](std::uint32_t t) {
      if (behind_.piece(t) != volume.piece(t)) out.push_back(t);
    });
    return out;
  }
  void delta(const Replica& volume, const Delta& delta) {
    MeshChange change(behind_, delta);
    for (const std::uint32_t t : in_other_pieces(volume)) change.tets.push_back(t);
    index_.follow(behind_, delta);
    FUZZ_CHECK(behind_.apply(delta));
    part_.follow_part(volume, index_, change, kBox);
    VolumePart fresh;
    fresh.load_part(volume, kBox);
    FUZZ_CHECK(part_.canonical_bytes() == fresh.canonical_bytes());
    FUZZ_CHECK(part_.part_hash() == part_.compute_part_hash());
  }
  void reload(const Replica& volume) {
    index_.load(volume);
    part_.load_part(volume, kBox);
  }

 private:
  static constexpr Box kBox{{0.002, 0.002, -1}, {0.02, 0.02, 0.004}};
  Replica behind_ = small_replica();
  TetIndex index_;
  VolumePart part_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Replica volume = small_replica();
  SurfaceReplica surface, server;
  surface.load(volume);
  server.load(volume);
  VolumePart part;
  Follower follower(volume);
  std::span<const std::byte> input(reinterpret_cast<const std::byte*>(data), size);
  FrameReader reader;
  while (reader.read(input) == FrameReader::Status::Complete) {
    const DecodeResult result = decode(reader.body());
    FUZZ_CHECK(static_cast<bool>(result) == result.error.empty());
    if (!result) continue;
    const Body& body = result.message->body;
    // What was accepted can be sent on, and comes back the same.
    const Frame again = encode(body, result.message->envelope);
    const DecodeResult second = decode(again.body());
    FUZZ_CHECK(second && second.message->body.index() == body.index());

    if (const auto* begin = std::get_if<SnapshotBegin>(&body)) {
      try_it(volume, [&](auto& r) { return r.begin(*begin); });
      try_it(surface, [&](auto& r) { return r.begin(*begin); });
      try_it(part, [&](auto& r) { return r.begin(*begin); });
      follower.snapshot(volume, [&](auto& r) { return r.begin(*begin), false; });
    } else if (const auto* chunk = std::get_if<SnapshotChunk>(&body)) {
      try_it(volume, [&](auto& r) { return r.chunk(*chunk); });
      try_it(surface, [&](auto& r) { return r.chunk(*chunk); });
      try_it(part, [&](auto& r) { return r.chunk(*chunk); });
      follower.snapshot(volume, [&](auto& r) { return r.chunk(*chunk), false; });
    } else if (const auto* end = std::get_if<SnapshotEnd>(&body)) {
      if (try_it(volume, [&](auto& r) { return r.end(*end); })) server.load(volume);
      try_it(surface, [&](auto& r) { return r.end(*end); });
      try_it(part, [&](auto& r) { return r.end(*end); });
      follower.snapshot(volume, [&](auto& r) { return static_cast<bool>(r.end(*end)); });
    } else if (const auto* delta = std::get_if<Delta>(&body)) {
      if (try_it(volume, [&](auto& r) { return r.apply(*delta); })) {
        server.follow(volume, *delta, follower.in_other_pieces(volume));
        FUZZ_CHECK(server.surface_hash() == server.compute_surface_hash());
        follower.delta(volume, *delta);
      }
      try_it(part, [&](auto& r) { return r.apply(*delta); });
    } else if (const auto* surface_delta = std::get_if<SurfaceDelta>(&body)) {
      try_it(surface, [&](auto& r) { return r.apply(*surface_delta); });
    }
    FUZZ_CHECK(volume.state_hash() == volume.compute_state_hash());
    FUZZ_CHECK(surface.surface_hash() == surface.compute_surface_hash());
    FUZZ_CHECK(part.part_hash() == part.compute_part_hash());
  }
  return 0;
}
