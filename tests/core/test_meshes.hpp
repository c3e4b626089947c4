#pragma once

// Small meshes, random numbers and checks that the core's tests share.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "protocol/state_hash.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::core::testing {

// Random numbers that are the same everywhere (Steele, Lea and Flood 2014, "SplitMix"). Tests print the seed.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint64_t next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  std::uint32_t below(std::uint32_t n) { return static_cast<std::uint32_t>(next() % n); }
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(next() >> 11) * 0x1p-53);
  }
  Vec3 in_box(const Vec3& low, const Vec3& high) {
    const double x = uniform(low.x, high.x), y = uniform(low.y, high.y), z = uniform(low.z, high.z);
    return {x, y, z};
  }
  Vec3 direction() {
    for (;;) {
      const Vec3 v = in_box({-1, -1, -1}, {1, 1, 1});
      const double l = length(v);
      if (l > 0.1 && l <= 1) return (1 / l) * v;
    }
  }

 private:
  std::uint64_t state_;
};

// One tetrahedron, positive.
inline MeshData one_tet() {
  return {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {{0, 1, 2, 3}}, {}};
}

// Two that share the face (1, 2, 3).
inline MeshData two_tets() {
  return {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}}, {{0, 1, 2, 3}, {1, 2, 3, 4}}, {}};
}

// n tetrahedra in a closed ring around the edge (0, 1).
inline MeshData ring_of_tets(int n) {
  MeshData mesh{{{0, 0, -1}, {0, 0, 1}}, {}, {}};
  for (int i = 0; i < n; ++i) {
    const double angle = 2 * 3.14159265358979323846 * i / n;
    mesh.positions.push_back({std::cos(angle), std::sin(angle), 0});
  }
  for (int i = 0; i < n; ++i) {
    const auto a = static_cast<VertexId>(2 + i), b = static_cast<VertexId>(2 + (i + 1) % n);
    mesh.tets.push_back({0, a, b, 1});
  }
  return mesh;
}

// A box of nx x ny x nz cubes with side `cell`, its lowest corner at `low`, six tetrahedra a cube around its
// diagonal (Kuhn 1960). The vertex (i, j, k) is number (k (ny + 1) + j) (nx + 1) + i.
inline MeshData box(int nx, int ny, int nz, double cell = 1, const Vec3& low = {}) {
  MeshData mesh;
  for (int k = 0; k <= nz; ++k) {
    for (int j = 0; j <= ny; ++j) {
      for (int i = 0; i <= nx; ++i)
        mesh.positions.push_back(low + cell * Vec3{double(i), double(j), double(k)});
    }
  }
  const auto vertex = [&](int i, int j, int k) {
    return static_cast<VertexId>((k * (ny + 1) + j) * (nx + 1) + i);
  };
  constexpr int kOrders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {1, 0, 2}, {2, 1, 0}};
  for (int k = 0; k < nz; ++k) {
    for (int j = 0; j < ny; ++j) {
      for (int i = 0; i < nx; ++i) {
        for (int o = 0; o < 6; ++o) {
          int at[3] = {i, j, k};
          std::array<VertexId, 4> tet{vertex(i, j, k)};
          for (int step = 0; step < 3; ++step) {
            ++at[kOrders[o][step]];
            tet[static_cast<std::size_t>(step) + 1] = vertex(at[0], at[1], at[2]);
          }
          if (o >= 3) std::swap(tet[2], tet[3]);  // odd orders are left-handed
          mesh.tets.push_back(tet);
        }
      }
    }
  }
  return mesh;
}

// The same with every vertex moved by up to `amount` cells in each direction: 0.1 keeps all tetrahedra
// positive.
inline MeshData shaken_box(int nx, int ny, int nz, std::uint64_t seed, double amount = 0.1, double cell = 1) {
  MeshData mesh = box(nx, ny, nz, cell);
  Random random(seed);
  const double d = amount * cell;
  for (Vec3& p : mesh.positions) p += random.in_box({-d, -d, -d}, {d, d, d});
  return mesh;
}

// The folder of real meshes and motions; empty where the environment names none.
inline std::string data_folder() {
  const char* folder = std::getenv("INCISE_DATA");
  return folder != nullptr ? folder : "";
}

// A real mesh, in millimetres, from there.
inline MeshData real_mesh(const std::string& name) {
  mesh_io::LoadOptions options;
  options.scale_to_metres = 0.001;
  return mesh_io::load_mesh(data_folder() + "/meshes/" + name, options).mesh;
}

// What a client holds: plain arrays to which deltas are applied. Its hash is computed from scratch.
class PlainModel {
 public:
  explicit PlainModel(const TetMesh& mesh) {
    for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
      positions_.push_back(mesh.position(v));
      rest_.push_back(mesh.rest_position(v));
    }
    for (TetId t = 0; t < mesh.tet_slots(); ++t) {
      if (!mesh.alive(t)) continue;
      tets_[t] = mesh.state(t);
      regions_[t] = mesh.region(t);
      for (int f = 0; f < 4; ++f) {
        if (mesh.opposite(half_face(t, f)) == kNone) boundary_[half_face(t, f)] = face(tets_[t], f);
      }
    }
  }
  void apply(const Delta& delta) {
    ASSERT_EQ(delta.moved.size(), delta.moved_positions.size());
    for (std::size_t i = 0; i < delta.moved.size(); ++i)
      positions_.at(delta.moved[i]) = delta.moved_positions[i];
    ASSERT_EQ(delta.first_added, positions_.size());
    ASSERT_EQ(delta.added_positions.size(), delta.provenance.size());
    for (std::size_t i = 0; i < delta.added_positions.size(); ++i) {
      const Provenance& from = delta.provenance[i];
      EXPECT_LT(from.a, delta.first_added + i);
      EXPECT_LT(from.b, delta.first_added + i);
      positions_.push_back(delta.added_positions[i]);
    }
    carry(delta);
    for (TetId t : delta.removed) EXPECT_EQ(tets_.erase(t), 1u) << "removed " << t << " that was not there";
    ASSERT_LE(delta.elders.size(), delta.upserted.size());
    for (std::size_t i = 0; i < delta.upserted.size(); ++i) {
      const TetState& tet = delta.upserted[i];
      const std::size_t old = delta.upserted.size() - delta.elders.size();
      EXPECT_EQ(i < old, tets_.contains(tet.id));
      EXPECT_TRUE(i < old || regions_.at(delta.elders[i - old]) == tet.region) << "tetrahedron " << tet.id;
    }
    for (const TetState& tet : delta.upserted) {
      tets_[tet.id] = tet;
      regions_[tet.id] = tet.region;
    }
    for (HalfFace h : delta.boundary_removed) EXPECT_EQ(boundary_.erase(h), 1u) << "boundary face " << h;
    for (HalfFace h : delta.boundary_upserted) {
      const auto tet = tets_.find(tet_of(h));
      ASSERT_NE(tet, tets_.end());
      boundary_[h] = face(tet->second, face_of(h));
    }
  }
  std::uint64_t hash() const {
    std::uint64_t hash = 0;
    for (std::size_t v = 0; v < positions_.size(); ++v) {
      hash ^= protocol::vertex_hash(static_cast<std::uint32_t>(v), positions_[v].x, positions_[v].y,
                                    positions_[v].z);
    }
    for (const auto& [id, t] : tets_) hash ^= protocol::tet_hash(id, t.vertices.data(), t.region, t.cut_mask);
    return hash;
  }
  // Compares everything with the mesh itself.
  void expect_equals(const TetMesh& mesh) const {
    ASSERT_EQ(positions_.size(), mesh.vertex_slots());
    for (VertexId v = 0; v < mesh.vertex_slots(); ++v)
      ASSERT_EQ(positions_[v], mesh.position(v)) << "vertex " << v;
    for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
      ASSERT_LT(length(rest_[v] - mesh.rest_position(v)), 1e-6 * mesh.mean_edge_length())
          << "the material of vertex " << v;
    }
    ASSERT_EQ(tets_.size(), mesh.live_tets());
    std::size_t boundary = 0;
    for (const auto& [id, t] : tets_) {
      ASSERT_LT(id, mesh.tet_slots());
      ASSERT_TRUE(mesh.alive(id)) << id;
      ASSERT_EQ(t, mesh.state(id)) << "tetrahedron " << id;
      for (int f = 0; f < 4; ++f) {
        if (mesh.opposite(half_face(id, f)) != kNone) continue;
        ++boundary;
        const auto found = boundary_.find(half_face(id, f));
        ASSERT_NE(found, boundary_.end()) << "boundary face " << f << " of tetrahedron " << id;
        ASSERT_EQ(found->second, face(t, f)) << "boundary face " << f << " of tetrahedron " << id;
      }
    }
    ASSERT_EQ(boundary_.size(), boundary);
    ASSERT_EQ(hash(), mesh.state_hash());
  }
  const std::map<TetId, TetState>& tets() const { return tets_; }

 private:
  // A field that is linear in the rest positions: they themselves. From provenance and blends alone.
  void carry(const Delta& delta) {
    const std::vector<Vec3> before = rest_;
    const auto& blends = delta.blends;
    rest_.resize(before.size() + delta.provenance.size());
    std::set<VertexId> blended;
    for (std::size_t i = 0; i < blends.size(); ++i) {
      ASSERT_LT(blends[i].vertex, rest_.size());
      ASSERT_TRUE(i == 0 || blends[i - 1].vertex < blends[i].vertex);
      rest_[blends[i].vertex] = {};
      for (std::size_t k = 0; k < 4; ++k)
        rest_[blends[i].vertex] += blends[i].weights[k] * before.at(blends[i].from[k]);
      blended.insert(blends[i].vertex);
    }
    for (std::size_t i = 0; i < delta.provenance.size(); ++i) {
      const Provenance& p = delta.provenance[i];
      if (!blended.contains(delta.first_added + static_cast<VertexId>(i)))
        rest_[before.size() + i] = (1 - p.t) * rest_[p.a] + p.t * rest_[p.b];
    }
  }
  static std::array<VertexId, 3> face(const TetState& t, int f) {
    return {t.vertices[kFaceVertices[f][0]], t.vertices[kFaceVertices[f][1]],
            t.vertices[kFaceVertices[f][2]]};
  }
  std::vector<Vec3> positions_, rest_;
  std::map<TetId, TetState> tets_;
  std::map<TetId, std::int32_t> regions_;  // of those that are gone, too
  std::map<HalfFace, std::array<VertexId, 3>> boundary_;
};

}  // namespace incise::core::testing
