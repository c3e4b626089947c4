#include "server/mesh_io/tet_repair.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <tuple>

#include "server/core/geometry/predicates.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_topology.hpp"

namespace incise::mesh_io {
namespace {

using core::HalfFace;
using core::kNone;
using core::MeshData;
using core::TetId;
using core::Vec3;
using core::VertexId;

// core::orient3d is exact for magnitudes from 1e-90 to 1e+90, products of three included. Bodies stay far inside that.
constexpr double kLargest = 1e+60, kSmallest = 1e-60;
// More bad tetrahedra than this mean a tangled mesh, not a mesher's slip: one in fifty, or sixteen.
constexpr double kMaxBadShare = 0.02;
constexpr std::size_t kMaxBadCount = 16;
// Vertices, of what is to be fetched: in a file the tetrahedra of a star lie anywhere.
constexpr VertexId kStarsAhead = 2;

// Of faces 2 and 3, whose vertices have changed places.
void exchange_last_two(std::uint8_t& mask) {
  mask = static_cast<std::uint8_t>((mask & 3u) | (mask >> 2 & 1u) << 3 | (mask >> 3 & 1u) << 2);
}

class TetRepair {
 public:
  TetRepair(MeshData& mesh, const std::string& file, int index_base, std::vector<std::string>& warnings)
      : mesh_(mesh),
        file_(file),
        names_(mesh, file, index_base),
        topology_(mesh, names_),
        warnings_(warnings) {}

  // What is left of the original ones.
  KeptElements kept() && { return std::move(kept_); }

  void run() {
    kept_.vertices.resize(mesh_.positions.size());
    std::iota(kept_.vertices.begin(), kept_.vertices.end(), 0u);
    kept_.tets.resize(mesh_.tets.size());
    std::iota(kept_.tets.begin(), kept_.tets.end(), 0u);
    check_positions();
    check_tets();
    topology_.match_faces();
    topology_.list_stars();
    removed_.assign(mesh_.tets.size(), 0);
    // Most meshes are sound, and looking takes a fraction of the repair.
    if (topology_.turned() > 0 || !bad_tets().empty()) {
      orient();
      fix_bad_tets();
    }
    const bool loose = note_loose_vertices();
    drop_unused_vertices();
    // The two sides of a cut lie on each other.
    if (mesh_.cut_masks.empty()) note_coincident_vertices();
    mesh_.opposite.clear();
    if (!loose) mesh_.opposite = topology_.opposites();
  }

 private:
  void warn(const std::string& message) { warnings_.push_back(file_ + ": " + message); }

  double volume(TetId t) const {
    const auto& v = mesh_.tets[t];
    const auto& p = mesh_.positions;
    return core::signed_volume(p[v[0]], p[v[1]], p[v[2]], p[v[3]]);
  }
  bool is_positive(TetId t) const {
    const auto& v = mesh_.tets[t];
    const auto& p = mesh_.positions;
    return core::orient3d(p[v[0]], p[v[1]], p[v[2]], p[v[3]]) > 0;
  }

  // What is wrong with a tetrahedron that is not positive.
  std::string flaw(TetId t) const {
    return names_.tet(t) + " (" + names_.place(mesh_.tets[t]) + ") is " +
           (volume(t) < 0 ? "inverted" : "flat") + ", volume " + to_text(volume(t)) + " m^3";
  }

  void check_positions() {
    for (VertexId v = 0; v < mesh_.positions.size(); ++v) {
      Vec3& p = mesh_.positions[v];
      for (double* x : {&p.x, &p.y, &p.z}) {
        if (!std::isfinite(*x))
          names_.fail("vertex " + names_.number(v) + " has a coordinate that is not finite");
        if (std::abs(*x) > kLargest) {
          names_.fail(names_.place(v) + " lies beyond " + to_text(kLargest) +
                      " m: check the file's numbers and the scale");
        }
        if (std::abs(*x) < kSmallest) *x = 0;
      }
    }
  }

  void check_tets() {
    if (mesh_.tets.empty()) names_.fail("there is no tetrahedron");
    if (mesh_.tets.size() >= kNone / 16)
      names_.fail(std::to_string(mesh_.tets.size()) + " tetrahedra: at most " +
                  std::to_string(kNone / 16 - 1) + " fit");
    for (TetId t = 0; t < mesh_.tets.size(); ++t) {
      const auto& v = mesh_.tets[t];
      for (std::size_t i = 0; i < 4; ++i) {
        if (v[i] >= mesh_.positions.size()) {
          names_.fail(names_.tet(t) + " has vertex " + names_.number(v[i]) + "; the file has " +
                      names_.number(0) + " to " +
                      names_.number(static_cast<VertexId>(mesh_.positions.size() - 1)));
        }
        for (std::size_t j = 0; j < i; ++j) {
          if (v[i] == v[j])
            names_.fail(names_.tet(t) + " has " + names_.place(v[i]) + " twice: remove the tetrahedron");
        }
      }
    }
  }

  // Floods each body over its faces so that neighbours see a shared face from opposite sides, then makes the body
  // right-handed by its total volume. A tetrahedron that is still negative is folded over its neighbours: no order of its
  // indices is right.
  void orient() {
    std::vector<std::uint8_t> seen(mesh_.tets.size(), 0), flip(mesh_.tets.size(), 0);
    std::vector<TetId> body;
    std::size_t flipped = 0;
    TetId first_flipped = kNone;
    for (TetId seed = 0; seed < mesh_.tets.size(); ++seed) {
      if (seen[seed]) continue;
      body.assign(1, seed);
      seen[seed] = 1;
      double total = 0;
      for (std::size_t i = 0; i < body.size(); ++i) {
        const TetId t = body[i];
        total += flip[t] ? -volume(t) : volume(t);
        for (int f = 0; f < 4; ++f) {
          const HalfFace h = core::half_face(t, f), g = topology_.opposite(h);
          if (g == kNone) continue;
          const bool turned = topology_.sorted_face(h).odd == topology_.sorted_face(g).odd;
          const auto wanted = static_cast<std::uint8_t>(flip[t] ^ static_cast<std::uint8_t>(turned));
          const TetId n = core::tet_of(g);
          if (!seen[n]) {
            seen[n] = 1;
            flip[n] = wanted;
            body.push_back(n);
          } else if (flip[n] != wanted) {
            names_.fail(names_.tet(t) + " and " + names_.number(n) +
                        " share a face in a body that cannot be oriented (" + names_.place(mesh_.tets[t]) +
                        "): some of its tetrahedra are turned inside out, remesh it");
          }
        }
      }
      const std::uint8_t turn = total < 0 ? 1 : 0;
      for (const TetId t : body) {
        if ((flip[t] ^ turn) == 0) continue;
        std::swap(mesh_.tets[t][2], mesh_.tets[t][3]);
        if (!mesh_.cut_masks.empty()) exchange_last_two(mesh_.cut_masks[t]);
        if (flipped++ == 0 || t < first_flipped) first_flipped = t;
      }
    }
    if (flipped == 0) return;
    if (flipped == mesh_.tets.size()) {
      warn("all " + std::to_string(flipped) +
           " tetrahedra are left-handed: two vertices of each are exchanged");
    } else {
      warn(std::to_string(flipped) + " of " + std::to_string(mesh_.tets.size()) +
           " tetrahedra are left-handed (the first: " + names_.tet(first_flipped) +
           "): two vertices of each are exchanged");
    }
    topology_.match_faces();  // exchanging vertices renumbered the faces
  }

  std::vector<TetId> bad_tets() const {
    std::vector<TetId> bad;
    for (TetId t = 0; t < mesh_.tets.size(); ++t) {
      if (!removed_[t] && !is_positive(t)) bad.push_back(t);
    }
    return bad;
  }

  void fix_bad_tets() {
    std::vector<TetId> bad = bad_tets();
    if (bad.empty()) return;
    const auto limit = std::max(
        kMaxBadCount, static_cast<std::size_t>(kMaxBadShare * static_cast<double>(mesh_.tets.size())));
    if (bad.size() > limit) {
      names_.fail(std::to_string(bad.size()) + " of " + std::to_string(mesh_.tets.size()) +
                  " tetrahedra are flat or folded over their neighbours (the first: " + names_.tet(bad[0]) +
                  ", " + names_.place(mesh_.tets[bad[0]]) + ", volume " + to_text(volume(bad[0])) +
                  " m^3): remesh it");
    }
    mark_boundary_vertices();
    // A move can fix several, and a removal can expose others at the boundary: repeat until nothing changes.
    for (bool progress = true; progress && !bad.empty();) {
      progress = false;
      for (const TetId t : bad) {
        if (!is_positive(t) && nudge(t)) progress = true;
      }
      bad = bad_tets();
      if (progress) continue;
      for (const TetId t : bad) {
        if (!topology_.on_boundary(t)) continue;
        remove(t);
        progress = true;
      }
      std::erase_if(bad, [this](TetId t) { return removed_[t] != 0; });
    }
    if (!bad.empty()) {
      names_.fail(flaw(bad[0]) +
                  ", inside the body, and no small move of a vertex fixes it: remesh it there");
    }
    compact();
  }

  void mark_boundary_vertices() {
    boundary_.assign(mesh_.positions.size(), 0);
    for (HalfFace h = 0; h < static_cast<HalfFace>(4 * mesh_.tets.size()); ++h) {
      if (topology_.opposite(h) != kNone) continue;
      for (const VertexId v : topology_.sorted_face(h).v) boundary_[v] = 1;
    }
  }

  // How many tetrahedra of a star are not positive, and the worst dihedral measure of the others.
  struct StarQuality {
    std::size_t bad = 0;
    double worst = -core::kInverted;
  };
  StarQuality star_quality(VertexId v) const {
    StarQuality quality;
    for (const TetId t : topology_.star(v)) {
      if (removed_[t]) continue;
      const auto& tet = mesh_.tets[t];
      const auto& p = mesh_.positions;
      if (is_positive(t)) {
        quality.worst =
            std::max(quality.worst, core::worst_dihedral(p[tet[0]], p[tet[1]], p[tet[2]], p[tet[3]]));
      } else {
        ++quality.bad;
      }
    }
    return quality;
  }

  // Moves one vertex of t so that fewer tetrahedra of its star are bad: away from the plane of the opposite
  // face, to a few heights, or (an interior vertex) towards the middle of its star. A boundary vertex moves
  // by no more than a twentieth of the edges around it, which a viewer does not see; an interior one by no
  // more than a third.
  bool nudge(TetId t) {
    std::optional<Vec3> best_position;
    VertexId best_vertex = kNone;
    double best_worst = 0;
    std::ptrdiff_t best_fixed = 0;
    for (int i = 0; i < 4; ++i) {
      const VertexId v = mesh_.tets[t][i];
      const auto& f = core::kFaceVertices[i];
      const Vec3 a = mesh_.positions[mesh_.tets[t][f[0]]], b = mesh_.positions[mesh_.tets[t][f[1]]],
                 c = mesh_.positions[mesh_.tets[t][f[2]]];
      const Vec3 start = mesh_.positions[v];
      const Vec3 inward = -core::normalized(core::cross(b - a, c - a));
      double edge = 0;
      Vec3 middle;
      for (const TetId s : topology_.star(v)) {
        for (const VertexId w : mesh_.tets[s]) {
          edge += core::distance(mesh_.positions[w], start) /
                  (3.0 * static_cast<double>(topology_.star(v).size()));
          if (w != v)
            middle += (1.0 / (3.0 * static_cast<double>(topology_.star(v).size()))) * mesh_.positions[w];
        }
      }
      const double height = core::dot(start - a, inward);
      const StarQuality before = star_quality(v);
      const double reach = (boundary_[v] ? 0.05 : 0.34) * edge;
      std::vector<Vec3> candidates;
      for (const double target : {0.002, 0.01, 0.03, 0.1})
        candidates.push_back(start + (target * edge - height) * inward);
      if (!boundary_[v]) {
        for (const double share : {0.1, 0.3, 1.0}) candidates.push_back(core::lerp(start, middle, share));
      }
      for (const Vec3& candidate : candidates) {
        if (!(core::distance(candidate, start) <= reach)) continue;
        mesh_.positions[v] = candidate;
        const StarQuality after = star_quality(v);
        const auto fixed = static_cast<std::ptrdiff_t>(before.bad) - static_cast<std::ptrdiff_t>(after.bad);
        if (fixed > best_fixed || (fixed > 0 && fixed == best_fixed && after.worst < best_worst)) {
          best_fixed = fixed;
          best_worst = after.worst;
          best_vertex = v;
          best_position = candidate;
        }
      }
      mesh_.positions[v] = start;
    }
    if (!best_position) return false;
    const double moved = core::distance(*best_position, mesh_.positions[best_vertex]);
    warn(flaw(t) + ": " + names_.place(best_vertex) + " is moved by " + to_text(moved) + " m");
    mesh_.positions[best_vertex] = *best_position;
    return true;
  }

  void remove(TetId t) {
    warn(flaw(t) + ", on the boundary: it is removed");
    removed_[t] = 1;
    topology_.detach(t);
    for (const VertexId v : mesh_.tets[t]) boundary_[v] = 1;
  }

  void compact() {
    TetId kept = 0;
    for (TetId t = 0; t < mesh_.tets.size(); ++t) {
      if (removed_[t]) continue;
      kept_.tets[kept] = t;
      mesh_.tets[kept] = mesh_.tets[t];
      if (!mesh_.regions.empty()) mesh_.regions[kept] = mesh_.regions[t];
      if (!mesh_.cut_masks.empty()) mesh_.cut_masks[kept] = mesh_.cut_masks[t];
      ++kept;
    }
    if (kept == mesh_.tets.size()) return;
    if (kept == 0) names_.fail("no tetrahedron of positive volume is left");
    mesh_.tets.resize(kept);
    kept_.tets.resize(kept);
    if (!mesh_.regions.empty()) mesh_.regions.resize(kept);
    if (!mesh_.cut_masks.empty()) mesh_.cut_masks.resize(kept);
    topology_.match_faces();
    topology_.list_stars();
  }

  // Vertices whose tetrahedra are not connected through faces, and the first of them.
  struct Loose {
    std::size_t count = 0;
    VertexId first = kNone;
    void operator+=(const Loose& other) {
      count += other.count;
      first = std::min(first, other.first);
    }
  };
  Loose loose_vertices(core::MatchPart part) const {
    std::vector<std::uint32_t> mark(mesh_.tets.size(), kNone);
    std::vector<TetId> reached;
    Loose loose;
    const auto vertices = static_cast<VertexId>(mesh_.positions.size());
    const VertexId ahead = kStarsAhead * part.count;
    for (VertexId v = part.index; v < vertices; v += part.count) {
      // What is beside a tetrahedron in a star is in that star, too: nothing else is read.
      if (v + ahead < vertices) {
        for (const TetId t : topology_.star(v + ahead)) {
          topology_.prefetch(t);
          __builtin_prefetch(&mark[t], 1);
        }
      }
      if (topology_.star(v).empty()) continue;
      reached.assign(1, topology_.star(v)[0]);
      mark[reached[0]] = v;
      for (std::size_t i = 0; i < reached.size(); ++i) {
        for (int f = 0; f < 4; ++f) {
          const HalfFace g = topology_.opposite(core::half_face(reached[i], f));
          if (g == kNone || mesh_.tets[reached[i]][f] == v || mark[core::tet_of(g)] == v) continue;
          mark[core::tet_of(g)] = v;
          reached.push_back(core::tet_of(g));
        }
      }
      if (reached.size() != topology_.star(v).size()) loose += {1, v};
    }
    return loose;
  }

  // Where parts of the body touch in a point or along an edge only. Whether there are any such vertices.
  bool note_loose_vertices() {
    const auto [count, first] =
        sum_in_halves(mesh_.tets.size(), [this](core::MatchPart part) { return loose_vertices(part); });
    if (count == 0) return false;
    warn((count == 1 ? "1 vertex is non-manifold: its"
                     : std::to_string(count) + " vertices are non-manifold: their") +
         " tetrahedra are not connected through faces (the first: " + names_.place(first) +
         "); each connected part gets a copy of its own");
    return true;
  }

  void drop_unused_vertices() {
    std::vector<VertexId> renumbered(mesh_.positions.size(), kNone);
    std::size_t unused = 0;
    VertexId kept = 0, first = kNone;
    for (VertexId v = 0; v < mesh_.positions.size(); ++v) {
      if (topology_.star(v).empty()) {
        if (unused++ == 0) first = v;
      } else {
        renumbered[v] = kept++;
      }
    }
    if (unused == 0) return;
    warn((unused == 1 ? std::string("1 vertex has") : std::to_string(unused) + " vertices have") +
         " no tetrahedron (the first: " + names_.place(first) + "): dropped");
    for (VertexId v = 0; v < mesh_.positions.size(); ++v) {
      if (renumbered[v] == kNone) continue;
      mesh_.positions[renumbered[v]] = mesh_.positions[v];
      kept_.vertices[renumbered[v]] = v;
    }
    mesh_.positions.resize(kept);
    kept_.vertices.resize(kept);
    for (auto& tet : mesh_.tets) {
      for (VertexId& v : tet) v = renumbered[v];
    }
  }

  void note_coincident_vertices() {
    std::vector<VertexId> order(mesh_.positions.size());
    std::iota(order.begin(), order.end(), VertexId{0});
    const auto& p = mesh_.positions;
    std::sort(order.begin(), order.end(), [&p](VertexId a, VertexId b) {
      return std::tie(p[a].x, p[a].y, p[a].z, a) < std::tie(p[b].x, p[b].y, p[b].z, b);
    });
    std::size_t count = 0;
    VertexId first = kNone;
    for (std::size_t i = 1; i < order.size(); ++i) {
      if (p[order[i]] == p[order[i - 1]] && count++ == 0) first = order[i];
    }
    if (count == 0) return;
    warn((count == 1 ? std::string("1 vertex lies") : std::to_string(count) + " vertices lie") +
         " exactly on another one (the first at " + to_text(p[first]) + "): the mesh is not connected there");
  }

  MeshData& mesh_;
  const std::string& file_;
  const TetNames names_;
  TetTopology topology_;
  std::vector<std::string>& warnings_;
  std::vector<std::uint8_t> boundary_;
  std::vector<std::uint8_t> removed_;
  KeptElements kept_;
};

}  // namespace

void repair_tets(core::MeshData& mesh, const std::string& file, int index_base,
                 std::vector<std::string>& warnings, KeptElements* kept) {
  TetRepair repair(mesh, file, index_base, warnings);
  repair.run();
  if (kept != nullptr) *kept = std::move(repair).kept();
}

}  // namespace incise::mesh_io
