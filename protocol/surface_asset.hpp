#pragma once

// The surface that a body was filled from: which of its triangles a boundary face of the body lies in (its origin), and what its
// texture coordinates, normals and colours are there.

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::protocol {

using Corners = std::array<Vec3, 3>;

// Finds the origin of boundary faces. It is a function of where the face's material is in the body at rest, and of nothing else: the same
// after a resume, in any replica and for any history.
//
// Thread: any, once it is built. Owns: the triangles, in a tree of boxes (some 150 bytes each).
class OriginTree {
 public:
  // `positions`: x y z of each vertex. `triangles`: three vertices each. O(n log n) for n triangles.
  OriginTree(std::span<const double> positions, std::span<const std::uint32_t> triangles);

  // The triangle nearest to the middle of these corners, of those that face the same way (of all, where none does); of several
  // equally near the one with the lowest index. kNoId without triangles. `near`: one that is probably near, to look less; it does not change
  // the result. O(log n).
  std::uint32_t origin_of(const Corners& rest, std::uint32_t near = kNoId) const;

  std::uint32_t size() const { return static_cast<std::uint32_t>(triangles_.size()); }

 private:
  struct Triangle {
    Corners corners;
    Vec3 normal;  // of any length
    std::uint32_t index;
  };
  // Its left child is the next node. A leaf has triangles first ... first + count.
  struct Node {
    Vec3 low, high;
    std::uint32_t first = 0, count = 0, right = 0;
  };
  struct Best {
    double squared_distance;
    std::uint32_t index;
  };
  void build(std::uint32_t begin, std::uint32_t end);
  void search(const Vec3& p, const Vec3* facing, Best& best) const;

  std::vector<Triangle> triangles_;   // in the order of the leaves
  std::vector<std::uint32_t> place_;  // in triangles_, by index
  std::vector<Node> nodes_;
};

// The weights of a triangle's corners that give the point of its plane nearest to `p`; they add up to 1. A point beyond an edge has a
// negative one.
std::array<double, 3> barycentric(const Corners& triangle, const Vec3& p);

// Looks up what the asset's surface has at points of the body at rest.
//
// Thread: any, once it is built. Owns: 12 bytes a triangle. Refers to the arrays of the asset.
class SurfaceLookup {
 public:
  // O(n log n) for n triangles.
  explicit SurfaceLookup(const SurfaceAsset& asset);

  // A place on the surface: weights of the corners of one triangle.
  struct Place {
    std::uint32_t triangle = 0;
    std::array<double, 3> weights{};
  };
  // Where `rest` is. Begins in the triangle `origin` and goes on across the edge that `rest` is farthest beyond, but across no seam, where
  // texture coordinates or materials differ: there the place is beyond the last triangle's edge. So all corners of a face have places in one
  // chart of the texture, and faces that share a corner, and no seam, have it at the same place. O(1).
  Place find(std::uint32_t origin, const Vec3& rest) const;

  // What an array of the asset by corner, with N numbers for each, is at the corners of a face. Nothing where the face has no origin, or the
  // asset no such array.
  template <std::size_t N, class T>
  std::optional<std::array<std::array<float, N>, 3>> at(std::span<const T> values, std::uint32_t origin,
                                                        const Corners& rest) const {
    if (values.empty() || origin >= neighbours_.size()) return std::nullopt;
    std::array<std::array<float, N>, 3> out{};
    for (std::size_t i = 0; i < 3; ++i) {
      const Place place = find(origin, rest[i]);
      for (std::size_t n = 0; n < N; ++n) {
        double sum = 0;
        for (std::size_t k = 0; k < 3; ++k)
          sum +=
              place.weights[k] * static_cast<double>(values[(std::size_t{place.triangle} * 3 + k) * N + n]);
        out[i][n] = static_cast<float>(sum);
      }
    }
    return out;
  }
  // Texture coordinates u v of a face's corners:
  //   const auto uvs = lookup.uvs(triangle.origin, surface.rest_corners(triangle));
  std::optional<std::array<std::array<float, 2>, 3>> uvs(std::uint32_t origin, const Corners& rest) const {
    return at<2>(asset_.uvs, origin, rest);
  }
  // The corners of a triangle, metres.
  Corners corners(std::uint32_t triangle) const;
  // Whether find() stops at the triangle's edge opposite to corner k: a seam, or the surface's border.
  bool is_seam(std::uint32_t triangle, std::size_t k) const { return neighbours_[triangle][k] == kNoId; }

 private:
  const SurfaceAsset asset_;
  std::vector<std::array<std::uint32_t, 3>>
      neighbours_;  // across the edge opposite to corner k; kNoId: a seam
};

}  // namespace incise::protocol
