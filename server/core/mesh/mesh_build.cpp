#include <algorithm>
#include <cmath>
#include <string>

#include "server/core/mesh/face_matching.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/util/room.hpp"

// TetMesh: from a file's arrays or from a saved session, and back.
namespace incise::core {
namespace {

void check_tet(std::size_t t, const std::array<VertexId, 4>& v, std::size_t vertex_count) {
  const auto names = [&](int i) {
    return "tetrahedron " + std::to_string(t) + " names vertex " + std::to_string(v[i]);
  };
  for (int i = 0; i < 4; ++i) {
    if (v[i] >= vertex_count) throw MeshError(names(i) + " of " + std::to_string(vertex_count));
    for (int j = 0; j < i; ++j) {
      if (v[i] == v[j]) throw MeshError(names(i) + " twice");
    }
  }
}

[[noreturn]] void refuse_position(std::size_t v, const Vec3& p) {
  throw MeshError("vertex " + std::to_string(v) + " is at (" + std::to_string(p.x) + ", " +
                  std::to_string(p.y) + ", " + std::to_string(p.z) + "); accepted are finite coordinates");
}

}  // namespace

TetMesh::TetMesh(const MeshData& data) {
  const std::size_t vertex_count = data.positions.size(), tet_count = data.tets.size();
  if (vertex_count >= kNone / 2 || tet_count >= kNone / 16) {
    throw MeshError("the mesh has " + std::to_string(tet_count) + " tetrahedra; at most " +
                    std::to_string(kNone / 16 - 1) + " fit");
  }
  if (!data.regions.empty() && data.regions.size() != tet_count) {
    throw MeshError("regions given for " + std::to_string(data.regions.size()) + " of " +
                    std::to_string(tet_count) + " tetrahedra");
  }
  if (!data.cut_masks.empty() && data.cut_masks.size() != tet_count) {
    throw MeshError("faces of cuts given for " + std::to_string(data.cut_masks.size()) + " of " +
                    std::to_string(tet_count) + " tetrahedra");
  }
  reserve_room(vertices_, vertex_count);
  for (const Vec3& p : data.positions) {
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
      refuse_position(vertices_.size(), p);
    vertices_.push_back({p, kNone, 0});
  }
  reserve_room(tets_, tet_count);
  grow_to(cut_masks_, tet_count);
  for (std::size_t t = 0; t < tet_count; ++t) {
    const auto& v = data.tets[t];
    check_tet(t, v, vertex_count);
    for (const VertexId corner : v) vertices_[corner].tet = static_cast<TetId>(t);
    tets_.push_back({v, {kNone, kNone, kNone, kNone}});
  }
  live_tets_ = static_cast<std::uint32_t>(tet_count);
  take_regions(data.regions);
  has_regions_ = !regions_.empty();

  measure_edges();
  vertex_marks_.grow_to(vertex_count);
  tet_marks_.grow_to(tet_count);
  log_.grow_to(vertex_count, tet_count);
  // Until the log begins its first step all is new to it, and nothing is recorded.
  if (data.opposite.empty()) {
    build_adjacency();
  } else {
    take_adjacency(data.opposite);
  }
  for (TetId t = 0; t < data.cut_masks.size(); ++t)
    cut_masks_[t] = static_cast<std::uint8_t>(data.cut_masks[t] & boundary_mask(t));
  came_cut_ = std::ranges::any_of(cut_masks_, [](std::uint8_t mask) { return mask != 0; });
  find_boundary();
  if (data.opposite.empty()) split_initial_vertices();
  if (initial_vertex_copies_ > 0) find_boundary();
  log_.forget(vertex_slots(), tet_slots(), compute_state_hash());
}

// Most bodies are of one region, which is then kept once. Of each tetrahedron, or none.
void TetMesh::take_regions(std::span<const std::int32_t> regions) {
  regions_.clear();
  region_ = regions.empty() ? 0 : regions[0];
  if (std::all_of(regions.begin(), regions.end(), [this](std::int32_t r) { return r == region_; })) return;
  reserve_room(regions_, regions.size());
  regions_.assign(regions.begin(), regions.end());
}

TetMesh::TetMesh(const TetMesh& other)
    : vertices_(copy_with_room(other.vertices_)),
      at_boundary_(copy_with_room(other.at_boundary_)),
      rest_(other.deformed() ? copy_with_room(other.rest_) : std::vector<Vec3>()),
      tets_(copy_with_room(other.tets_)),
      cut_masks_(copy_with_room(other.cut_masks_)),
      regions_(other.regions_.empty() ? std::vector<std::int32_t>() : copy_with_room(other.regions_)),
      region_(other.region_),
      live_tets_(other.live_tets_),
      has_regions_(other.has_regions_),
      came_cut_(other.came_cut_),
      initial_vertex_copies_(other.initial_vertex_copies_),
      mean_edge_length_(other.mean_edge_length_),
      widest_local_h_(other.widest_local_h_) {
  vertex_marks_.grow_to(vertices_.size());
  tet_marks_.grow_to(tets_.size());
  log_.grow_to(vertices_.size(), tets_.size());
  log_.begin_as(other.log_, vertex_slots(), tet_slots());
}

// An edge counts once for each tetrahedron around it, which weighs it by the space it stands for.
void TetMesh::measure_edges() {
  std::vector<double> sums(vertices_.size(), 0.0);
  std::vector<std::uint32_t> counts(vertices_.size(), 0);
  double sum = 0;
  for (const Tet& tet : tets_) {
    for (const auto& edge : kEdgeVertices) {
      const VertexId a = tet.vertices[edge[0]], b = tet.vertices[edge[1]];
      const double l = distance(vertices_[a].position, vertices_[b].position);
      sum += l;
      sums[a] += l;
      sums[b] += l;
      ++counts[a];
      ++counts[b];
    }
  }
  for (std::size_t v = 0; v < vertices_.size(); ++v) {
    if (counts[v] > 0) vertices_[v].h = static_cast<float>(sums[v] / counts[v]);
  }
  mean_edge_length_ = tets_.empty() ? 0 : sum / (6.0 * static_cast<double>(tets_.size()));
  find_widest();
}

void TetMesh::find_widest() {
  float widest = 0;
  for (const Vertex& v : vertices_) widest = std::max(widest, v.h);
  widest_local_h_ = static_cast<double>(widest);
}

void TetMesh::take_adjacency(std::span<const HalfFace> opposite) {
  if (opposite.size() != 4 * tets_.size()) {
    throw MeshError("opposite half-faces given for " + std::to_string(opposite.size() / 4) + " of " +
                    std::to_string(tets_.size()) + " tetrahedra");
  }
  for (HalfFace h = 0; h < opposite.size(); ++h) {
    const HalfFace o = opposite[h];
    if (o != kNone && (o >= opposite.size() || opposite[o] != h))
      throw MeshError("half-face " + std::to_string(h) + " is not behind what it names");
    tets_[tet_of(h)].opposite[face_of(h)] = o;
  }
}

void TetMesh::build_adjacency() {
  match_faces(
      4 * tet_slots(), vertices_.size(), {}, [this](HalfFace h) { return face_vertices(h); },
      [this](HalfFace a, HalfFace b, bool) { link(a, b); },
      [this](std::span<const HalfFace> same) {
        const auto f = ascending(face_vertices(same[0]));
        throw MeshError("tetrahedra " + std::to_string(tet_of(same[0])) + ", " +
                        std::to_string(tet_of(same[1])) + " and " + std::to_string(tet_of(same[2])) +
                        " share the face (" + std::to_string(f[0]) + ", " + std::to_string(f[1]) + ", " +
                        std::to_string(f[2]) + ")");
      });
}

void TetMesh::find_boundary() {
  reserve_room(at_boundary_, vertices_.size());
  at_boundary_.assign(vertices_.size(), 0);
  for (HalfFace h = 0; h < 4 * tet_slots(); ++h) {
    if (!alive(tet_of(h)) || opposite(h) != kNone) continue;
    const bool cut = (cut_masks_[tet_of(h)] >> face_of(h) & 1) != 0;
    for (const VertexId v : face_vertices(h)) at_boundary_[v] |= cut ? kAtBoundary | kAtCut : kAtBoundary;
  }
}

// Real meshes have a few vertices where two parts merely touch.
void TetMesh::split_initial_vertices() {
  std::vector<std::uint32_t> incident(vertices_.size(), 0);
  for (const Tet& tet : tets_) {
    for (VertexId v : tet.vertices) ++incident[v];
  }
  std::vector<bool> pinched(vertices_.size(), false);
  bool any = false;
  for (VertexId v = 0; v < incident.size(); ++v) {
    if (incident[v] == 0) continue;
    star(v, star_scratch_);
    if (star_scratch_.size() != incident[v]) pinched[v] = any = true;
  }
  if (!any) return;
  begin_noting(4 * tets_.size());
  for (TetId t = 0; t < tet_slots(); ++t) {
    for (int i = 0; i < 4; ++i) {
      // With any face at it: only the tetrahedron counts here.
      if (pinched[tets_[t].vertices[i]]) note_side(tets_[t].vertices[i], half_face(t, i ^ 1));
    }
  }
  // The component of the star that comes first in the file keeps the vertex; the others get copies.
  for (const Noted::Star& noted : noted_.stars)
    vertices_[noted.vertex].tet = tet_of(noted_.sides[noted.first].side);
  const std::uint32_t slots = vertex_slots();
  split_noted_stars();
  initial_vertex_copies_ = vertex_slots() - slots;
}

MeshData TetMesh::export_data() const {
  MeshData data;
  std::vector<VertexId> renumbered(vertices_.size(), kNone);
  for (const Tet& tet : tets_) {
    if (tet.vertices[0] == kNone) continue;
    for (VertexId v : tet.vertices) renumbered[v] = 0;
  }
  for (VertexId v = 0; v < vertex_slots(); ++v) {
    if (renumbered[v] == kNone) continue;
    renumbered[v] = static_cast<VertexId>(data.positions.size());
    data.positions.push_back(vertices_[v].position);
  }
  for (TetId t = 0; t < tet_slots(); ++t) {
    if (!alive(t)) continue;
    const auto& v = tets_[t].vertices;
    data.tets.push_back({renumbered[v[0]], renumbered[v[1]], renumbered[v[2]], renumbered[v[3]]});
    data.regions.push_back(region(t));
    data.cut_masks.push_back(cut_mask(t));
  }
  if (std::ranges::all_of(data.cut_masks, [](std::uint8_t mask) { return mask == 0; }))
    data.cut_masks.clear();
  return data;
}

void TetMesh::archive(Archive& io) {
  io(mean_edge_length_);
  io(initial_vertex_copies_);
  io(has_regions_);
  log_.archive(io);
  io.list(vertices_, 32, [&](Vertex& v) {
    io(v.position);
    io(v.tet);
    io(v.h);
  });
  io.list(rest_, 24, [&](Vec3& rest) { io(rest); });
  io.list(tets_, 32, [&](Tet& t) {
    for (VertexId& v : t.vertices) io(v);
    for (HalfFace& o : t.opposite) io(o);
  });
  archive_attributes(io);
  if (!io.reads()) return;
  check_restored(io);
  if (io.failed()) return;
  grow_to(vertices_, vertices_.size());
  if (deformed()) grow_to(rest_, rest_.size());
  grow_to(tets_, tets_.size());
  grow_to(cut_masks_, tets_.size());
  find_boundary();
  find_widest();
  vertex_marks_.grow_to(vertices_.size());
  tet_marks_.grow_to(tets_.size());
  log_.grow_to(vertices_.size(), tets_.size());
  log_.begin_step(vertex_slots(), tet_slots());
  const std::string problem = validate(*this, false);
  io.demand(problem.empty(), problem.c_str());
}

void TetMesh::archive_attributes(Archive& io) {
  struct Attributes {
    std::int32_t region = 0;
    std::uint8_t cut_mask = 0;
  };
  std::vector<Attributes> attributes;
  if (!io.reads()) {
    attributes.reserve(cut_masks_.size());
    for (TetId t = 0; t < cut_masks_.size(); ++t) attributes.push_back({region(t), cut_masks_[t]});
  }
  io.list(attributes, 5, [&](Attributes& a) {
    io(a.region);
    io(a.cut_mask);
  });
  if (!io.reads()) return;
  std::vector<std::int32_t> regions;
  cut_masks_.clear();
  for (const Attributes& a : attributes) {
    regions.push_back(a.region);
    cut_masks_.push_back(a.cut_mask);
  }
  take_regions(regions);
}

// That no index leads astray; validate() looks at the rest.
void TetMesh::check_restored(Archive& io) {
  io.demand(tets_.size() < kNone / 16 && vertices_.size() < kNone / 2, "the mesh is too large");
  io.demand(cut_masks_.size() == tets_.size(), "attributes and tetrahedra differ in number");
  io.demand(rest_.empty() || rest_.size() == vertices_.size(),
            "rest positions and vertices differ in number");
  io.demand(mean_edge_length_ > 0 && std::isfinite(mean_edge_length_), "h is not positive");
  if (io.failed()) return;
  live_tets_ = 0;
  for (const Tet& t : tets_) {
    if (t.vertices[0] == kNone) continue;
    ++live_tets_;
    for (VertexId v : t.vertices) io.demand(v < vertex_slots(), "a tetrahedron names no vertex");
    for (HalfFace o : t.opposite) {
      io.demand(o == kNone || (tet_of(o) < tet_slots() && alive(tet_of(o))), "a neighbour does not exist");
    }
  }
  if (io.failed()) return;
  for (VertexId v = 0; v < vertex_slots(); ++v) {
    const TetId t = vertex_tet(v);
    io.demand(t == kNone || (t < tet_slots() && alive(t) && local_index(t, v) >= 0),
              "a vertex names a tetrahedron that does not have it");
    io.demand(vertices_[v].h >= 0 && std::isfinite(vertices_[v].h), "a local width is not a length");
  }
}

}  // namespace incise::core
