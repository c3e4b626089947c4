#pragma once

#include <cstddef>
#include <tuple>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"

namespace incise::core {

// Parts the tissue at edges where it hangs together beside them alone: around such an edge there are two fans of tetrahedra or more, and four
// boundary faces or more, so the boundary is no manifold there. A vertex on the edge in all fans but one leaves each fan an edge of its own.
// Close behind the blade many an edge is pinched until the rest of the faces at its ends opens, so a vertex is looked at when the blade has
// left it. And many another is until the hand comes by again, so an edge waits until the blade has gone on for long, or the stroke ends.
class PinchedEdges {
 public:
  PinchedEdges(CutContext& cut, MeshEditor& editor) : cut_(cut), mesh_(cut.mesh), editor_(editor) {}

  void clear();
  // A face at v has just opened: edges there are looked at later.
  void list(VertexId v);
  void begin() { next_bared_ = next_vertex_ = next_edge_ = 0; }
  // Deals with what the blade has left. True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);

  void archive(Archive& io);

 private:
  // A vertex and an edge, and how far the blade has to have travelled in the stroke before they are looked at.
  struct ListedVertex {
    VertexId vertex;
    double ripe_at_m;
  };
  struct PinchedEdge {
    VertexId a, b;
    double ripe_at_m;
  };
  struct Fan {
    std::size_t size;
    TetId tet;  // one of it
    bool operator<(const Fan& other) const { return std::tie(size, tet) < std::tie(other.size, other.tet); }
  };
  bool is_ripe(double ripe_at_m) const { return !cut_.has_front || cut_.path.travel_m() >= ripe_at_m; }
  void find_pinched(VertexId v);
  void part(VertexId a, VertexId b);
  void list_fans(VertexId a, VertexId b);
  bool try_parting(TetId fan, VertexId a, VertexId b);

  CutContext& cut_;
  const TetMesh& mesh_;
  MeshEditor& editor_;
  // Those that the blade has come to first are first in the lists.
  std::vector<ListedVertex> vertices_;  // each once: CutWorkspace::VertexMarks::listed
  std::vector<PinchedEdge> edges_;
  // How far this batch is, in MeshEditor::bared() and in the lists.
  std::size_t next_bared_ = 0, next_vertex_ = 0, next_edge_ = 0;
  std::vector<VertexId> ends_;  // scratch, like all below
  std::vector<Corner> star_;
  std::vector<TetId> around_, ring_;
  std::vector<Fan> fans_;
};

}  // namespace incise::core
