#pragma once

#include <cstdint>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/swept_triangle.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// Where the boundary is: a uniform grid of the tetrahedra that have boundary faces. A blade that enters the tissue,
// or a sweep that meets a part of it that it has not met before, is found here; from there on adjacency leads. Built
// at load, O(boundary); tetrahedra that get boundary faces later are added, those that lose them are just stale.
//
// In a body that a simulation deforms (server/core/session/vertex_mover.hpp) each vertex has an anchor, where it was when the
// tetrahedra around it were last entered. They are entered again when it has moved a tenth of a cell from there, so
// that the cost is that of what moved; what they leave behind is stale, and is dropped when the grid is rebuilt, once
// it has doubled or the body has grown out of it.
class BoundaryGrid {
 public:
  // How far a vertex may go from its anchor, in cells.
  static constexpr double kFromAnchor = 0.1;

  explicit BoundaryGrid(const TetMesh& mesh);
  // A copy with room to grow. O(boundary + cells).
  BoundaryGrid(const BoundaryGrid& other);
  BoundaryGrid(BoundaryGrid&&) = default;
  BoundaryGrid& operator=(BoundaryGrid&&) = default;

  // A grid of cells of `cell` m over the box, empty, for a body that deforms: no vertex has an anchor yet.
  BoundaryGrid(const Vec3& low, const Vec3& high, double cell);

  // Becomes such a grid, in the memory that it has. `nodes`: entries for which room is made at once.
  void begin_again(const Vec3& low, const Vec3& high, double cell, std::size_t nodes);

  // A box that holds the tissue.
  const Vec3& low() const { return low_; }
  const Vec3& high() const { return high_; }

  // Adds a tetrahedron that has got a boundary face. O(1).
  void add(const TetMesh& mesh, TetId t);
  // The same, with its vertices at these places.
  void add_at(TetId t, const Vec3 (&corners)[4]);

  // Whether the body deforms.
  bool anchored() const { return !anchors_.empty(); }
  // Whether the tetrahedra at v have to be entered again when it lies at p, where it then has to have its anchor.
  bool leaves_anchor(const TetMesh& mesh, VertexId v, const Vec3& p) const {
    const double most = kFromAnchor * cell_;
    return squared_length(p - (v < anchors_.size() ? anchors_[v] : mesh.position(v))) > most * most;
  }
  // The vertices that have no anchor yet, which a cut has made, get theirs where they are.
  void give_anchors(const TetMesh& mesh) {
    while (anchors_.size() < mesh.vertex_slots())
      set_anchor(mesh.position(static_cast<VertexId>(anchors_.size())));
  }
  void move_anchor(VertexId v, const Vec3& p) { anchors_[v] = p; }
  void set_anchor(const Vec3& p) { anchors_.push_back(p); }  // of the next vertex
  bool contains(const Vec3& p) const;
  // Whether so much is stale that it should be rebuilt.
  bool overgrown() const { return nodes_.size() > 2 * nodes_when_built_ + 65536; }
  void built() { nodes_when_built_ = nodes_.size(); }
  // All entries, stale ones and repetitions included.
  std::size_t entries() const { return nodes_.size(); }
  TetId entry(std::size_t i) const { return nodes_[i].tet; }

  // Appends boundary tetrahedra near the triangle: every one that meets it, some others, and some twice. Cells that the same
  // search (known by its serial) has already taken for another triangle are left out. Cost: the cells that the triangle passes
  // (cells are 2 h wide) and the boundary in them; clipped to the mesh's bounding box. Removes stale entries from the
  // cells' lists, or they would grow with every cut.
  void near(const TetMesh& mesh, const SweptTriangle& triangle, std::uint32_t search,
            std::vector<TetId>& out);

  // Calls visit(tet) for the boundary tetrahedra of all cells that the box meets: every one that meets the box, some others, some
  // more than once, and some that are dead or have lost their boundary face. O(cells of the box, and what they hold).
  template <class Visit>
  void visit_box(const Vec3& low, const Vec3& high, Visit visit) const;
  // The width of a cell, m.
  double cell() const { return cell_; }

  // Lists keep their order: the search meets tetrahedra in it, and ids follow.
  void archive(Archive& io, const TetMesh& mesh);

  // A tetrahedron that contains p, found from the boundary inwards; kNone where p is outside. O(mesh^(1/3)); adds to
  // `looked_at` the boundary tetrahedra that it took.
  TetId locate(const TetMesh& mesh, const Vec3& p, std::int64_t* looked_at = nullptr) const;

 private:
  struct Node {
    TetId tet;
    std::uint32_t next;
  };
  void check_restored(Archive& io, const TetMesh& mesh);
  void lay_out(const Vec3& low, const Vec3& high, double cell);
  std::int64_t cell_of(double x, int axis) const;
  // Where a cell is in head_ and taken_.
  std::size_t index_of(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return static_cast<std::size_t>((i * count_[1] + j) * count_[2] + k);
  }
  void take_cell(const TetMesh& mesh, std::size_t cell, std::vector<TetId>& out);
  template <class Visit>
  void visit_cell(std::int64_t i, std::int64_t j, std::int64_t k, Visit visit) const;

  Vec3 origin_;
  Vec3 low_, high_;
  double cell_ = 1, inverse_ = 1;
  std::int64_t count_[3] = {1, 1, 1};
  double slack_ =
      0.25;  // how far, in cells, a vertex may be from where it was when its tetrahedra were entered
  std::vector<std::uint32_t> head_;   // a list of nodes for each cell
  std::vector<std::uint32_t> taken_;  // by cell: the last search that took it
  std::vector<Node> nodes_;
  std::size_t nodes_when_built_ = 0;
  std::vector<Vec3> anchors_;  // by vertex; none while nothing has deformed the body
};

template <class Visit>
void BoundaryGrid::visit_cell(std::int64_t i, std::int64_t j, std::int64_t k, Visit visit) const {
  for (std::uint32_t n = head_[index_of(i, j, k)]; n != kNone; n = nodes_[n].next) visit(nodes_[n].tet);
}

template <class Visit>
void BoundaryGrid::visit_box(const Vec3& low, const Vec3& high, Visit visit) const {
  if (nodes_.empty() || low.x > high_.x || low.y > high_.y || low.z > high_.z || high.x < low_.x ||
      high.y < low_.y || high.z < low_.z)
    return;
  const double slack = slack_ * cell_;
  const std::int64_t last[3] = {cell_of(high.x + slack, 0), cell_of(high.y + slack, 1),
                                cell_of(high.z + slack, 2)};
  for (std::int64_t i = cell_of(low.x - slack, 0); i <= last[0]; ++i) {
    for (std::int64_t j = cell_of(low.y - slack, 1); j <= last[1]; ++j) {
      for (std::int64_t k = cell_of(low.z - slack, 2); k <= last[2]; ++k) visit_cell(i, j, k, visit);
    }
  }
}

// Follows the segment from p, inside tetrahedron `from` or on its surface, towards q. Calls visit(tet, t_in, t_out)
// for each tetrahedron passed, with the parameters between which the segment is in it. Returns the tetrahedron that
// q lies in; kNone where the segment leaves through the boundary before, or after `most` tetrahedra. O(tetrahedra passed).
template <class Visit>
TetId walk(const TetMesh& mesh, TetId from, const Vec3& p, const Vec3& q, Visit visit,
           std::uint32_t most = 100000) {
  const Vec3 d = q - p;
  double t_in = 0;
  TetId t = from;
  int entered = -1;
  for (std::uint32_t steps = 0; steps < most; ++steps) {
    const auto& v = mesh.vertices(t);
    double t_out = 2;
    int exit = -1;
    for (int f = 0; f < 4; ++f) {
      if (f == entered) continue;
      const auto& k = kFaceVertices[f];
      const Vec3& a = mesh.position(v[k[0]]);
      const Vec3 n = cross(mesh.position(v[k[1]]) - a, mesh.position(v[k[2]]) - a);
      const double speed = dot(n, d);
      if (speed <= 0) continue;
      const double at = dot(n, a - p) / speed;
      if (at < t_out) {
        t_out = at;
        exit = f;
      }
    }
    if (exit < 0 || t_out >= 1) {
      visit(t, t_in, 1.0);
      return t;
    }
    if (t_out < t_in) t_out = t_in;
    visit(t, t_in, t_out);
    const HalfFace o = mesh.opposite(half_face(t, exit));
    if (o == kNone) return kNone;
    t = tet_of(o);
    entered = face_of(o);
    t_in = t_out;
  }
  return kNone;
}

}  // namespace incise::core
