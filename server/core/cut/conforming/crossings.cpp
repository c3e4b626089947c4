#include "server/core/cut/conforming/crossings.hpp"

#include <algorithm>

namespace incise::core {

void Crossings::begin_batch() {
  begin_collection();
  for (std::uint32_t c = 0; c < list_.size(); ++c) {
    CutWorkspace::VertexMarks& marks = cut_.workspace.vertices[list_[c].a];
    list_[c].next = marks.crossings == collection_ ? marks.first_crossing : kNone;
    marks.crossings = collection_;
    marks.first_crossing = c;
  }
}

// Which of the collection is of the edge (a, b), a < b; kNone: none is.
std::uint32_t Crossings::find(VertexId a, VertexId b) const {
  const CutWorkspace::VertexMarks& marks = cut_.workspace.vertices[a];
  if (marks.crossings != collection_) return kNone;
  std::uint32_t c = marks.first_crossing;
  while (c != kNone && list_[c].b != b) c = list_[c].next;
  return c;
}

bool Crossings::is_inside(VertexId a, VertexId b) const {
  const std::uint32_t c = find(std::min(a, b), std::max(a, b));
  return c != kNone && list_[c].inside && list_[c].batch == cut_.batch;
}

void Crossings::add(VertexId a, VertexId b, TetId t, std::uint32_t triangle, double at, bool inside) {
  if (b < a) {
    std::swap(a, b);
    at = 1 - at;
  }
  CutWorkspace::VertexMarks& marks = cut_.workspace.vertices[a];
  if (marks.crossings != collection_) {
    marks.crossings = collection_;
    marks.first_crossing = kNone;
  }
  if (find(a, b) != kNone) return;
  list_.push_back(
      {std::min(at, 1 - at), at, a, b, t, triangle, marks.first_crossing, cut_.batch, false, inside});
  marks.first_crossing = static_cast<std::uint32_t>(list_.size() - 1);
}

void Crossings::drop_done() {
  std::erase_if(list_, [](const Crossing& c) { return c.done; });
}

void Crossings::clinging(std::vector<VertexId>& out) const {
  for (const Crossing& crossing : list_) out.insert(out.end(), {crossing.a, crossing.b});
}

void Crossings::archive(Archive& io) {
  const TetMesh& mesh = cut_.mesh;
  io.list(list_, 36, [&](Crossing& c) {
    io(c.nearness);
    io(c.at);
    io(c.a);
    io(c.b);
    io(c.tet);
    io(c.triangle);
    io(c.batch);
    io.demand(c.a < mesh.vertex_slots() && c.b < mesh.vertex_slots() && c.tet < mesh.tet_slots(),
              "a crossing of an edge that does not exist");
    // A crossing of an earlier batch is looked for again; one of a later batch would not be.
    io.demand(c.batch <= cut_.batch, "a crossing of a later batch");
    io.demand(c.nearness == c.nearness && c.at >= 0 && c.at <= 1, "a crossing beyond its edge");
    if (io.reads()) c.done = c.inside = false;
  });
}

}  // namespace incise::core
