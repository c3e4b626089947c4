#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "protocol/state_hash.hpp"

namespace incise::protocol {

// ElementHash of eight elements at once, of `kWordCount` words each, for bodies in which a simulation moves every vertex at every step.
template <std::uint32_t kKind, std::size_t kWordCount>
class HashLanes {
 public:
  // Elements whose words are laid out before they are hashed: wide loads right after narrow stores would wait for these.
  static constexpr std::size_t kBlock = 64;
  // What ElementHash::add() is given, in turn: by word, then by element.
  using Words = std::array<std::array<std::uint32_t, kBlock>, kWordCount>;
  // The XOR of a block's hashes.
  using HashBlock = std::uint64_t (*)(const Words&);

  static std::uint64_t hash_anywhere(const Words& words) { return hash_lanes(words); }
#if defined(__x86_64__)
  [[gnu::target("avx2")]] static std::uint64_t hash_with_avx2(const Words& words) {
    return hash_lanes(words);
  }
  static HashBlock fastest() {
    return __builtin_cpu_supports("avx2") ? hash_with_avx2 : hash_anywhere;
  }
#else
  static HashBlock fastest() {
    return hash_anywhere;
  }
#endif

 private:
  static constexpr std::size_t kLanes = 8;
  using Lanes [[gnu::vector_size(4 * kLanes)]] = std::uint32_t;

  // ElementHash, with an element in each lane.
  [[gnu::always_inline]] static inline std::uint64_t hash_lanes(const Words& words) {
    Lanes low{}, high{};
    for (std::size_t first = 0; first < kBlock; first += kLanes) {
      Lanes a = Lanes{} + kKind * 0x9e3779b1u;
      Lanes b = Lanes{} + ~kKind * 0x85ebca77u;
      for (const auto& word : words) {
        Lanes w;
        std::memcpy(&w, &word[first], sizeof w);
        a ^= w * 0xcc9e2d51u;
        a = (a << 13 | a >> 19) * 5u + 0xe6546b64u;
        b ^= w * 0x1b873593u;
        b = (b << 17 | b >> 15) * 9u + 0x38495ab5u;
      }
      a ^= b << 7 | b >> 25;
      Lanes mixed[2];
      for (int half = 0; half < 2; ++half) {
        Lanes h = half == 0 ? a : b + mixed[0];
        h ^= h >> 16;
        h *= 0x85ebca6bu;
        h ^= h >> 13;
        h *= 0xc2b2ae35u;
        mixed[half] = h ^ (h >> 16);
      }
      low ^= mixed[0];
      high ^= mixed[1];
    }
    std::uint64_t hash = 0;
    for (std::size_t lane = 0; lane < kLanes; ++lane) hash ^= std::uint64_t{high[lane]} << 32 | low[lane];
    return hash;
  }
};

// vertex_hash() of many vertices.
class VertexHashes : public HashLanes<1, 7> {
 public:
  // The XOR of vertex_hash() of id(i) at position(i), an array of three coordinates in m, for i below `count`. O(count), some 3 ns
  // each where the processor has AVX2.
  template <class Id, class Position>
  static std::uint64_t combined(std::size_t count, Id id, Position position,
                                HashBlock hash_block = fastest()) {
    std::uint64_t hash = 0;
    std::size_t i = 0;
    for (Words words; i + kBlock <= count; i += kBlock) {
      for (std::size_t k = 0; k < kBlock; ++k) {
        words[0][k] = id(i + k);
        const std::array<double, 3> p = position(i + k);
        for (std::size_t axis = 0; axis < 3; ++axis) {
          const auto bits = std::bit_cast<std::uint64_t>(p[axis]);
          words[1 + 2 * axis][k] = static_cast<std::uint32_t>(bits);
          words[2 + 2 * axis][k] = static_cast<std::uint32_t>(bits >> 32);
        }
      }
      hash ^= hash_block(words);
    }
    for (; i < count; ++i) {
      const std::array<double, 3> p = position(i);
      hash ^= vertex_hash(id(i), p[0], p[1], p[2]);
    }
    return hash;
  }
};

// surface_vertex_hash() of many vertices.
class SurfaceVertexHashes : public HashLanes<4, 4> {
 public:
  // The XOR over `count` vertices; vertex i has three coordinates in `xyz`, from 3 i on.
  static std::uint64_t combined(std::size_t count, const std::uint32_t* ids, const float* xyz,
                                HashBlock hash_block = fastest()) {
    std::uint64_t hash = 0;
    std::size_t i = 0;
    for (Words words; i + kBlock <= count; i += kBlock) {
      for (std::size_t k = 0; k < kBlock; ++k) {
        words[0][k] = ids[i + k];
        for (std::size_t axis = 0; axis < 3; ++axis)
          words[1 + axis][k] = std::bit_cast<std::uint32_t>(xyz[3 * (i + k) + axis]);
      }
      hash ^= hash_block(words);
    }
    for (; i < count; ++i) hash ^= surface_vertex_hash(ids[i], xyz + 3 * i);
    return hash;
  }
};

}  // namespace incise::protocol
