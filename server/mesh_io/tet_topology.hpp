#pragma once

#include <array>
#include <cstdint>
#include <future>
#include <span>
#include <string>
#include <vector>

#include "server/core/mesh/face_matching.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::mesh_io {

// work(part) of a mesh of so many tetrahedra; of a large one in two halves at the same time, whose results are added.
template <class Work>
auto sum_in_halves(std::size_t tets, Work work) {
  constexpr std::size_t kLarge = 50'000;  // below, a thread costs more than it saves
  if (tets < kLarge) return work(core::MatchPart{});
  auto other = std::async(std::launch::async, [&work] { return work(core::MatchPart{1, 2}); });
  auto sum = work(core::MatchPart{0, 2});
  sum += other.get();
  return sum;
}

// The elements of a mesh as its file numbers them, for messages.
class TetNames {
 public:
  // `index_base`: the file's number of vertex 0 and of tetrahedron 0. Mesh and file must outlive this.
  TetNames(const core::MeshData& mesh, const std::string& file, int index_base)
      : mesh_(mesh), file_(file), base_(index_base) {}

  // Throws MeshError, its text beginning with the file's name.
  [[noreturn]] void fail(const std::string& message) const;
  std::string number(std::uint32_t index) const {
    return std::to_string(static_cast<std::int64_t>(index) + base_);
  }
  std::string tet(core::TetId t) const { return "tetrahedron " + number(t); }
  std::string place(core::VertexId v) const;
  std::string place(const std::array<core::VertexId, 4>& v) const;

 private:
  const core::MeshData& mesh_;
  const std::string& file_;
  const int base_;
};

// What is beside what in a mesh as read: the neighbour behind each face, the tetrahedra at each vertex. The mesh may change;
// match_faces() and list_stars() bring this up to date.
class TetTopology {
 public:
  TetTopology(const core::MeshData& mesh, const TetNames& names) : mesh_(mesh), names_(names) {}

  // Throws MeshError if more than two tetrahedra share a face, or two have the same vertices. O(n).
  void match_faces();
  // How many shared faces are seen from the same side by both.
  std::size_t turned() const { return turned_; }
  // The same face seen from the other side; kNone on the boundary.
  core::HalfFace opposite(core::HalfFace h) const { return opposite_[h]; }
  const std::vector<core::HalfFace>& opposites() const { return opposite_; }
  // For what will be read soon.
  void prefetch(core::TetId t) const {
    __builtin_prefetch(&opposite_[core::half_face(t, 0)]);
    __builtin_prefetch(&mesh_.tets[t]);
  }
  bool on_boundary(core::TetId t) const;
  // A removed tetrahedron's neighbours have no neighbour there.
  void detach(core::TetId t);

  // O(n).
  void list_stars();
  // The tetrahedra at v.
  std::span<const core::TetId> star(core::VertexId v) const {
    return {star_.data() + star_begin_[v], star_.data() + star_begin_[v + 1]};
  }

  // The vertices of a face in ascending order, and whether sorting took an odd permutation.
  struct SortedFace {
    std::array<core::VertexId, 3> v;
    bool odd;
  };
  SortedFace sorted_face(core::HalfFace h) const;

 private:
  std::array<core::VertexId, 3> face(core::HalfFace h) const {
    const auto& tet = mesh_.tets[core::tet_of(h)];
    const auto& f = core::kFaceVertices[core::face_of(h)];
    return {tet[f[0]], tet[f[1]], tet[f[2]]};
  }
  core::VertexId apex(core::HalfFace h) const { return mesh_.tets[core::tet_of(h)][core::face_of(h)]; }
  std::size_t match_faces(core::MatchPart part);
  void refuse_twins() const;
  [[noreturn]] void refuse_twins(core::HalfFace a, core::HalfFace b) const;
  [[noreturn]] void refuse_shared_face(std::span<const core::HalfFace> same) const;

  const core::MeshData& mesh_;
  const TetNames& names_;
  std::vector<core::HalfFace> opposite_;
  std::size_t turned_ = 0;
  std::vector<std::uint32_t> star_begin_;
  std::vector<core::TetId> star_;
};

}  // namespace incise::mesh_io
