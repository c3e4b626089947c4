#pragma once

// The state hash: 64 bits that name one state of a mesh. PROTOCOL.md, "State hash", is its specification; this
// header needs only the standard library, because the cut core (server/core) computes it too.
//
// The hash of a state is the XOR of one hash for each vertex and each live tetrahedron, so a change costs
// what changed: XOR the old element out, the new one in. Every element's hash covers its id, so no two cancel.
// The arithmetic is 32 bits wide, two lanes, because that is what a browser multiplies exactly.

#include <bit>
#include <cstdint>

namespace incise::protocol {

class ElementHash {
 public:
  explicit ElementHash(std::uint32_t kind) : lane_a_(kind * 0x9e3779b1u), lane_b_(~kind * 0x85ebca77u) {}

  void add(std::uint32_t word) {
    lane_a_ = std::rotl(lane_a_ ^ (word * 0xcc9e2d51u), 13) * 5u + 0xe6546b64u;
    lane_b_ = std::rotl(lane_b_ ^ (word * 0x1b873593u), 17) * 9u + 0x38495ab5u;
  }
  void add(double value) {
    const auto bits = std::bit_cast<std::uint64_t>(value);
    add(static_cast<std::uint32_t>(bits));
    add(static_cast<std::uint32_t>(bits >> 32));
  }
  std::uint64_t value() const {
    const std::uint32_t a = mix(lane_a_ ^ std::rotl(lane_b_, 7));
    const std::uint32_t b = mix(lane_b_ + a);
    return (static_cast<std::uint64_t>(b) << 32) | a;
  }

 private:
  static std::uint32_t mix(std::uint32_t h) {
    h ^= h >> 16;
    h *= 0x85ebca6bu;
    h ^= h >> 13;
    h *= 0xc2b2ae35u;
    return h ^ (h >> 16);
  }
  std::uint32_t lane_a_;
  std::uint32_t lane_b_;
};

// A vertex: its id and the IEEE 754 bits of its coordinates in metres.
inline std::uint64_t vertex_hash(std::uint32_t id, double x, double y, double z) {
  ElementHash hash(1);
  hash.add(id);
  hash.add(x);
  hash.add(y);
  hash.add(z);
  return hash.value();
}

// A tetrahedron: its id, its four vertices in stored order, its region, and its cut mask (bit f: the face opposite
// to vertex f was opened by a cut).
inline std::uint64_t tet_hash(std::uint32_t id, const std::uint32_t* vertices, std::int32_t region,
                              std::uint8_t cut_mask) {
  ElementHash hash(2);
  hash.add(id);
  for (int i = 0; i < 4; ++i) hash.add(vertices[i]);
  hash.add(static_cast<std::uint32_t>(region));
  hash.add(static_cast<std::uint32_t>(cut_mask));
  return hash.value();
}

// The surface hash, of what a client with view Surface holds, is made the same way from these two.

// A boundary triangle: its half-face, its three vertices in order and its flags (bit 0: cut face).
inline std::uint64_t triangle_hash(std::uint32_t id, const std::uint32_t* vertices, std::uint8_t flags) {
  ElementHash hash(3);
  hash.add(id);
  for (int i = 0; i < 3; ++i) hash.add(vertices[i]);
  hash.add(static_cast<std::uint32_t>(flags));
  return hash.value();
}

// A vertex of the surface: its id and the IEEE 754 bits of its coordinates as 32-bit floats.
inline std::uint64_t surface_vertex_hash(std::uint32_t id, const float* xyz) {
  ElementHash hash(4);
  hash.add(id);
  for (int i = 0; i < 3; ++i) hash.add(std::bit_cast<std::uint32_t>(xyz[i]));
  return hash.value();
}

}  // namespace incise::protocol
