#include "protocol/state_hash.hpp"

#include <gtest/gtest.h>

#include <array>
#include <bitset>
#include <cmath>
#include <unordered_set>
#include <vector>

#include "protocol/vertex_hashes.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using protocol::tet_hash;
using protocol::vertex_hash;

// Pinned: other languages compute these, and captures store them.
TEST(StateHash, GoldenValues) {
  EXPECT_EQ(vertex_hash(0, 0.0, 0.0, 0.0), 0xb682d46ee7d07fb5ull);
  EXPECT_EQ(vertex_hash(1, 0.5, -2.25, 1e-3), 0x77af85637985e8eeull);
  const std::uint32_t vertices[4] = {10, 11, 12, 4000000000u};
  EXPECT_EQ(tet_hash(7, vertices, -3, 0b0101), 0xa0d8d57c02a9e6b2ull);
}

// Many at once and the rest alone, on any processor and on this one.
TEST(StateHash, ManyVerticesHaveTheHashesOfEach) {
  using protocol::VertexHashes;
  const auto id = [](std::size_t i) { return static_cast<std::uint32_t>(i * 2654435761u + 7); };
  const auto position = [](std::size_t i) {
    const double x = static_cast<double>(i);
    return std::array{i % 5 == 0 ? -0.0 : std::sin(x), -1e-300 * x, 1e7 / (x + 1)};
  };
  std::uint64_t each = 0;
  for (std::size_t n = 0; n < 200; ++n) {
    EXPECT_EQ(VertexHashes::combined(n, id, position), each) << n;
    EXPECT_EQ(VertexHashes::combined(n, id, position, VertexHashes::hash_anywhere), each) << n;
    const auto p = position(n);
    each ^= vertex_hash(id(n), p[0], p[1], p[2]);
  }
}

TEST(StateHash, ManyVerticesOfASurfaceHaveTheHashesOfEach) {
  using protocol::SurfaceVertexHashes;
  std::vector<std::uint32_t> ids;
  std::vector<float> xyz;
  std::uint64_t each = 0;
  for (std::uint32_t n = 0; n < 200; ++n) {
    EXPECT_EQ(SurfaceVertexHashes::combined(n, ids.data(), xyz.data()), each) << n;
    EXPECT_EQ(SurfaceVertexHashes::combined(n, ids.data(), xyz.data(), SurfaceVertexHashes::hash_anywhere),
              each)
        << n;
    const auto x = static_cast<float>(n);
    ids.push_back(n * 2654435761u + 7);
    xyz.insert(xyz.end(), {n % 5 == 0 ? -0.0F : std::sin(x), -1e-30F * x, 1e7F / (x + 1)});
    each ^= protocol::surface_vertex_hash(ids.back(), &xyz[3 * std::size_t{n}]);
  }
}

TEST(StateHash, EveryFieldCounts) {
  std::unordered_set<std::uint64_t> hashes;
  const std::uint32_t a[4] = {1, 2, 3, 4}, turned[4] = {2, 3, 1, 4}, other[4] = {1, 2, 3, 5};
  hashes.insert(tet_hash(0, a, 0, 0));
  hashes.insert(tet_hash(1, a, 0, 0));
  hashes.insert(tet_hash(0, turned, 0, 0));
  hashes.insert(tet_hash(0, other, 0, 0));
  hashes.insert(tet_hash(0, a, 1, 0));
  hashes.insert(tet_hash(0, a, 0, 1));
  hashes.insert(vertex_hash(0, 1, 2, 3));
  hashes.insert(vertex_hash(1, 1, 2, 3));
  hashes.insert(vertex_hash(0, 2, 1, 3));
  hashes.insert(vertex_hash(0, 1, 2, std::nextafter(3.0, 4.0)));
  hashes.insert(vertex_hash(0, 0.0, 2, 3));
  hashes.insert(vertex_hash(0, -0.0, 2, 3));
  EXPECT_EQ(hashes.size(), 12u);
}

// One flipped bit of the input turns about half of the 64 bits.
TEST(StateHash, Avalanche) {
  testing::Random random(1);
  std::array<double, 64> turned{};
  double total = 0;
  int samples = 0;
  for (int i = 0; i < 2000; ++i) {
    const auto id = static_cast<std::uint32_t>(random.next());
    const auto bits = random.next();
    const double y = random.uniform(-1, 1), z = random.uniform(-1, 1);
    const std::uint64_t hash = vertex_hash(id, std::bit_cast<double>(bits), y, z);
    const auto bit = random.below(96);
    const std::uint64_t flipped =
        bit < 64 ? vertex_hash(id, std::bit_cast<double>(bits ^ (1ull << bit)), y, z)
                 : vertex_hash(id ^ (1u << (bit - 64)), std::bit_cast<double>(bits), y, z);
    const std::bitset<64> difference(hash ^ flipped);
    for (std::size_t k = 0; k < 64; ++k) turned[k] += difference[k] ? 1 : 0;
    total += static_cast<double>(difference.count());
    ++samples;
  }
  EXPECT_NEAR(total / samples, 32, 1);
  for (double n : turned) EXPECT_NEAR(n / samples, 0.5, 0.08);
}

TEST(StateHash, NoCollisionAmongTheElementsOfAMesh) {
  std::unordered_set<std::uint64_t> hashes;
  std::size_t count = 0;
  for (std::uint32_t id = 0; id < 200000; ++id, count += 2) {
    hashes.insert(vertex_hash(id, 0.001 * (id % 100), 0.001 * (id / 100 % 100), 0.001 * (id / 10000)));
    const std::uint32_t v[4] = {id, id + 1, id + 100, id + 10000};
    hashes.insert(tet_hash(id, v, 0, 0));
  }
  EXPECT_EQ(hashes.size(), count);
}

// XOR: the order of elements does not matter, a changed one is exchanged, and all out is zero again.
TEST(StateHash, IncrementalEqualsFromScratch) {
  TetMesh mesh(testing::box(2, 2, 2));
  const std::uint64_t start = mesh.state_hash();
  const Vec3 from = mesh.position(13);
  Delta delta;
  mesh.move_vertex(13, from + Vec3{0.1, 0, 0});
  mesh.commit(delta);
  EXPECT_NE(delta.state_hash, start);
  EXPECT_EQ(delta.state_hash, mesh.compute_state_hash());
  mesh.move_vertex(13, from);
  mesh.commit(delta);
  EXPECT_EQ(delta.state_hash, start);
}

}  // namespace
}  // namespace incise::core
