#include "tests/oracle/judge.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <utility>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/stroke/swept_surface.hpp"
#include "tests/oracle/fewest_faces.hpp"

namespace incise::oracle {
namespace {

using core::kNone;
using core::TetId;
using core::VertexId;

constexpr std::size_t kMostHeldBy = 64;

std::array<Vec3, 2> bounds(const core::MeshData& mesh) {
  Vec3 low = mesh.positions.at(0), high = low;
  for (const Vec3& p : mesh.positions) core::extend(p, low, high);
  return {low, high};
}

std::uint64_t count_crowded_edges(const core::TetMesh& mesh) {
  std::vector<std::uint64_t> edges;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) != kNone) continue;
      const auto v = mesh.face_vertices(core::half_face(t, f));
      for (int k = 0; k < 3; ++k) {
        const auto [a, b] = std::minmax(v[k], v[(k + 1) % 3]);
        edges.push_back(std::uint64_t{a} << 32 | b);
      }
    }
  }
  std::sort(edges.begin(), edges.end());
  std::uint64_t crowded = 0;
  for (std::size_t i = 0; i < edges.size();) {
    std::size_t end = i;
    while (end < edges.size() && edges[end] == edges[i]) ++end;
    crowded += end - i > 2;
    i = end;
  }
  return crowded;
}

template <class Visit>
void for_each_live_tet(const core::TetMesh& mesh, Visit visit) {
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    const auto& v = mesh.vertices(t);
    const Vec3 p[4] = {mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]), mesh.position(v[3])};
    visit(t, p);
  }
}

// The parts that some walls leave of a body, and how they lie in the pieces of the mesh.
struct Parts {
  std::uint32_t count = 0;
  std::vector<std::uint32_t> of;                   // by point
  std::vector<std::uint64_t> points, deep, thick;  // by part
  struct Shared {
    std::uint64_t points = 0, thick = 0;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Shared> in_piece;  // by part and piece

  void lay_out(const SampleGrid& grid, const Walls& walls, const std::vector<std::uint8_t>& inside) {
    count = flood(grid, walls, inside, of);
  }
  void compare(const std::vector<std::uint32_t>& piece_at, const std::vector<float>& off2, double deep2,
               double thick2 = 0) {
    points.assign(count, 0);
    thick.assign(count, 0);
    deep.assign(count, 0);
    for (std::size_t i = 0; i < of.size(); ++i) {
      if (of[i] == kNone) continue;
      ++points[of[i]];
      deep[of[i]] += off2[i] > deep2;
      thick[of[i]] += off2[i] > thick2;
      if (piece_at[i] == kNone) continue;
      Shared& shared = in_piece[{of[i], piece_at[i]}];
      ++shared.points;
      shared.thick += off2[i] > thick2;
    }
  }
};

class Judge {
 public:
  Judge(const Body& body, std::span<const Stroke> strokes, const core::TetMesh& mesh)
      : body_(body), strokes_(strokes), mesh_(mesh), h_(body.h) {
    const double around = 2 * kMayClose_h * h_;
    const Vec3 margin{around, around, around};
    const Vec3 low = body.low - margin, high = body.high + margin;
    surface_ = swept_surface(strokes, h_, 0.01 * h_, low, high);
    block();
    for (std::uint32_t i = 0; i < surface_.size(); ++i) {
      const auto& c = surface_[i].triangle.corners;
      tree_.add_quad({c[0], c[1]}, {c[0], c[2]}, 1, 1, i, false);
    }
    tree_.build();
    const IsNear is_near = [this](const Vec3& p, double reach, std::uint32_t stroke, double travel) {
      return body_.boundary.is_within(p, reach) || has_other(p, reach, stroke, travel);
    };
    for (const Triangle& t : rim_fins(strokes, 0.125 * h_, kClosed_h * h_, low, high, false, is_near)) {
      block(closed_, t);
      const auto& c = t.corners;
      fins_.add_quad({c[0], c[1]}, {c[0], c[2]}, 1, 1, 0, false);
    }
    fins_.build();
    for (const Triangle& t : rim_fins(strokes, 0.125 * h_, kMayClose_h * h_, low, high, true, is_near))
      block(may_close_, t);
  }

  Verdict run() {
    report();
    label();
    const Parts must = must_be_apart();
    find_joined(must);
    find_torn();
    find_crumbs(must);
    measure_deviation();
    return verdict_;
  }

 private:
  void block(Walls& walls, const Triangle& t) {
    body_.grid.crossed_by(t, [&](std::size_t index, int axis, const Vec3&) {
      walls[index] |= static_cast<std::uint8_t>(1u << axis);
    });
  }

  // The ways that the surface crosses, and how far the points around are off it: crossings are samples of it, no farther apart
  // than the grid's points.
  void block() {
    closed_ = body_.walls;
    off2_.assign(body_.grid.size(), INFINITY);
    Walls sampled(body_.grid.size(), 0);
    const double reach = (kNeck_h + 0.25) * h_;
    for (const SweptPart& part : surface_) {
      body_.grid.crossed_by(part.triangle, [&](std::size_t index, int axis, const Vec3& where) {
        const auto bit = static_cast<std::uint8_t>(1u << axis);
        closed_[index] |= bit;
        if (sampled[index] & bit) return;
        sampled[index] |= bit;
        body_.grid.within(where, reach, [&](std::size_t at, double d2) {
          off2_[at] = std::min(off2_[at], static_cast<float>(d2));
        });
      });
    }
    may_close_ = closed_;
  }

  void report() {
    verdict_.invalid = core::validate(mesh_);
    const core::CutReport report = core::measure(mesh_);
    verdict_.inverted = report.inverted;
    verdict_.pieces = report.pieces;
    verdict_.volume_change = report.volume / body_.volume - 1;
    verdict_.cut_faces = report.cut_faces;
    verdict_.growth =
        (static_cast<double>(report.tets) - static_cast<double>(body_.tets)) / std::max(report.cut_faces, 1u);
    verdict_.min_angle_deg = report.min_dihedral_deg;
    verdict_.crowded_edges = static_cast<std::int64_t>(count_crowded_edges(mesh_)) -
                             static_cast<std::int64_t>(body_.crowded_edges);
  }

  // The mesh's piece at each point.
  void label() {
    std::uint32_t count = 0;
    labels_ = core::label_pieces(mesh_, &count);
    piece_tets_.assign(count, 0);
    example_.assign(count, kNone);
    piece_at_.assign(body_.grid.size(), kNone);
    for_each_live_tet(mesh_, [&](TetId t, const Vec3(&p)[4]) {
      ++piece_tets_[labels_[t]];
      example_[labels_[t]] = t;
      body_.grid.in_tet(p, [&](std::size_t at) { piece_at_[at] = labels_[t]; });
    });
    for (std::size_t i = 0; i < piece_at_.size(); ++i) {
      if (!body_.inside[i]) piece_at_[i] = kNone;
    }
  }

  // Parts that must be apart and share a piece. Deep points alone say where a part lies: near a surface, the mesh may be on
  // either side.
  void find_joined(const Parts& parts) {
    const double point_h3 = std::pow(body_.grid.spacing() / h_, 3);
    std::vector<std::map<std::uint32_t, std::uint64_t>> deep_in(
        parts.count);  // by part: points in each piece
    std::vector<std::size_t> somewhere(parts.count, 0);
    for (std::size_t i = 0; i < parts.of.size(); ++i) {
      if (parts.of[i] == kNone || piece_at_[i] == kNone || !is_deep(i)) continue;
      ++deep_in[parts.of[i]][piece_at_[i]];
      somewhere[parts.of[i]] = i;
    }
    // By piece: its parts, those that were apart as loaded told apart.
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<std::uint32_t>> in_piece;
    for (std::uint32_t part = 0; part < parts.count; ++part) {
      if (static_cast<double>(parts.deep[part]) * point_h3 < kDeepVolume_h3) continue;
      ++verdict_.parts;
      for (const auto& [piece, points] : deep_in[part]) {
        if (static_cast<double>(points) * point_h3 >= kDeepVolume_h3)
          in_piece[{piece, body_.parts[somewhere[part]]}].push_back(part);
      }
    }
    std::pair<std::uint32_t, std::uint32_t> largest_joined;  // the part, and its piece
    for (const auto& [piece, list] : in_piece) {
      const auto largest = *std::max_element(list.begin(), list.end(), [&](std::uint32_t a, std::uint32_t b) {
        return parts.points[a] < parts.points[b];
      });
      for (std::uint32_t part : list) {
        if (part == largest) continue;
        ++verdict_.joined;
        const double volume = static_cast<double>(parts.points[part]) * point_h3;
        if (volume <= verdict_.joined_h3) continue;
        verdict_.joined_h3 = volume;
        verdict_.joined_at = body_.grid.point(somewhere[part]);
        largest_joined = {part, piece.first};
      }
    }
    if (verdict_.joined > 0) find_held_by(parts, largest_joined.first, largest_joined.second);
  }

  // What holds a part and others of its piece together.
  void find_held_by(const Parts& parts, std::uint32_t part, std::uint32_t piece) {
    std::vector<End> ends(mesh_.tet_slots(), End::kNone);
    for_each_live_tet(mesh_, [&](TetId t, const Vec3(&p)[4]) {
      if (labels_[t] != piece) return;
      body_.grid.in_tet(p, [&](std::size_t at) {
        if (parts.of[at] != kNone && is_deep(at)) ends[t] = parts.of[at] == part ? End::kOne : End::kOther;
      });
    });
    const std::vector<core::HalfFace> faces = fewest_faces_between(mesh_, ends, kMostHeldBy);
    verdict_.held_by = static_cast<std::uint32_t>(faces.size());
    if (!faces.empty()) verdict_.joined_at = mesh_.face_middle(faces.front());
  }

  // What hangs together far from every surface, and not through a gap that may be closed, and lies in several pieces.
  void find_torn() {
    const double neck2 = kNeck_h * kNeck_h * h_ * h_;
    std::vector<std::uint8_t> wanted(body_.grid.size());
    for (std::size_t i = 0; i < wanted.size(); ++i) wanted[i] = body_.inside[i] && off2_[i] > neck2;
    Parts parts;
    parts.lay_out(body_.grid, may_close_, wanted);
    parts.compare(piece_at_, off2_, neck2);
    std::map<std::uint32_t, std::uint32_t> pieces;
    // A point or two may lie in a bump that the boundary's own vertices have slid over.
    constexpr std::uint64_t kLeast = 4;
    for (const auto& [where, shared] : parts.in_piece) {
      if (shared.points < kLeast || ++pieces[where.first] < 2) continue;
      ++verdict_.torn;
      for (std::size_t i = 0; i < piece_at_.size(); ++i) {
        if (parts.of[i] == where.first && piece_at_[i] == where.second)
          verdict_.torn_at = body_.grid.point(i);
      }
    }
  }

  Parts must_be_apart() const {
    Parts must;
    must.lay_out(body_.grid, closed_, body_.inside);
    must.compare(piece_at_, off2_, kDeep_h * kDeep_h * h_ * h_, kThick_h * kThick_h * h_ * h_);
    return must;
  }

  // Which pieces are a part of the geometry, or several together: at least half of its points lie in parts that have half of theirs, or of
  // what is thick in them, in the piece.
  void find_parts(const Parts& must, std::vector<std::uint8_t>& is_part) const {
    const double deep2 = kDeep_h * kDeep_h * h_ * h_;
    Parts may, apart;
    may.lay_out(body_.grid, may_close_, body_.inside);
    may.compare(piece_at_, off2_, deep2, deep2);
    // What hangs together by a neck that is thinner than what is closed may come apart there.
    std::vector<std::uint8_t> wide(body_.grid.size());
    for (std::size_t i = 0; i < wide.size(); ++i) wide[i] = body_.inside[i] && !is_in_gap(i);
    apart.lay_out(body_.grid, may_close_, wide);
    apart.compare(piece_at_, off2_, deep2, deep2);
    const auto accept = [&](const Parts& parts, std::uint64_t least_thick) {
      std::vector<std::uint64_t> points_of(is_part.size(), 0), in_parts(is_part.size(), 0);
      for (const auto& [where, shared] : parts.in_piece) points_of[where.second] += shared.points;
      for (const auto& [where, shared] : parts.in_piece) {
        const auto [part, piece] = where;
        // The thin end of a wedge between two surfaces is one with them.
        const bool most_of_it =
            2 * shared.points >= parts.points[part] || 2 * shared.thick >= parts.thick[part];
        if (parts.thick[part] >= least_thick && most_of_it) in_parts[piece] += shared.points;
      }
      for (std::size_t piece = 0; piece < is_part.size(); ++piece) {
        if (in_parts[piece] > 0 && 2 * in_parts[piece] >= points_of[piece]) is_part[piece] = 1;
      }
    };
    accept(must, 1);
    accept(may, 16);
    accept(apart, 16);
  }

  // Pieces that are no part of the geometry, neither of what all strokes have left nor of what the first ones had: that is a piece already when a
  // later stroke shaves it.
  void find_crumbs(const Parts& must) {
    std::vector<std::uint8_t> is_part(piece_tets_.size(), 0);
    find_parts(must, is_part);
    // The largest is what is left of the body, wherever it was cut.
    is_part[static_cast<std::size_t>(std::max_element(piece_tets_.begin(), piece_tets_.end()) -
                                     piece_tets_.begin())] = 1;
    for (std::size_t n = strokes_.size(); n-- > 1 && std::ranges::count(is_part, 0) > 0;) {
      Judge earlier(body_, strokes_.first(n), mesh_);
      earlier.label();
      earlier.find_parts(earlier.must_be_apart(), is_part);
    }
    for (std::size_t piece = 0; piece < piece_tets_.size(); ++piece) {
      if (is_part[piece]) continue;
      if (piece_tets_[piece] > kCrumb) {
        ++verdict_.fragments;
      } else {
        ++verdict_.crumbs;
        verdict_.small_crumbs += piece_tets_[piece] <= 3;
      }
      verdict_.crumb_at = mesh_.barycentre(example_[piece]);
    }
  }

  void measure_deviation() {
    if (tree_.size() == 0) return;
    double sum = 0;
    std::uint64_t alone = 0;
    const auto sample = [&](const Vec3& p) {
      Vec3 closest;
      std::uint32_t triangle = 0;
      const bool found = tree_.closest(p, 4 * h_, closest, triangle);
      const double off = found ? core::distance(p, closest) / h_ : 4.0;
      // What closes a gap is off all that was swept: there the sweep merges with a cut, or with the boundary.
      const bool alone_here = found && !fins_.is_within(p, off * h_) &&
                              !has_other(p, kAlone_h * h_, surface_[tree_[triangle].batch].stroke,
                                         surface_[tree_[triangle].batch].travel);
      if (alone_here) {
        sum += off;
        ++alone;
        if (off > verdict_.alone_max_h) verdict_.far_at = p;
        verdict_.alone_max_h = std::max(verdict_.alone_max_h, off);
      } else {
        verdict_.merged_max_h = std::max(verdict_.merged_max_h, off);
      }
    };
    for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
      if (!mesh_.alive(t)) continue;
      for (int f = 0; f < 4; ++f) {
        if (!(mesh_.cut_mask(t) >> f & 1)) continue;
        Vec3 middle{};
        for (VertexId v : mesh_.face_vertices(core::half_face(t, f))) {
          sample(mesh_.position(v));
          middle += (1.0 / 3.0) * mesh_.position(v);
        }
        sample(middle);
      }
    }
    verdict_.alone_mean_h = alone > 0 ? sum / static_cast<double>(alone) : 0;
  }

  // Whether something within `reach` was swept by another stroke, or at quite another time of this one.
  bool has_other(const Vec3& p, double reach, std::uint32_t stroke, double travel) const {
    return tree_.any_between(core::Points<1>({p}), reach, [&](std::uint32_t i) {
      const SweptPart& other = surface_[tree_[i].batch];
      if (other.stroke == stroke && std::abs(other.travel - travel) < 4 * h_) return false;
      return core::distance(core::closest_point(p, tree_[i]), p) <= reach;
    });
  }

  // Between a surface and the boundary, or between two surfaces, that are no farther apart than what is closed.
  bool is_in_gap(std::size_t at) const {
    const double off_m = std::sqrt(static_cast<double>(off2_[at]));
    const double to_skin_m = std::sqrt(static_cast<double>(body_.off_skin2[at]));
    return 2 * off_m <= kClosed_h * h_ || off_m + to_skin_m <= kClosed_h * h_;
  }
  bool is_deep(std::size_t at) const { return off2_[at] > kDeep_h * kDeep_h * h_ * h_; }

  const Body& body_;
  std::span<const Stroke> strokes_;
  const core::TetMesh& mesh_;
  const double h_;
  std::vector<SweptPart> surface_;
  core::SweptSurface tree_;  // of it; a triangle's batch says which one it is
  core::SweptSurface fins_;  // that close gaps
  Walls closed_, may_close_;
  std::vector<float> off2_;  // by point: from the nearest surface, squared, where it is near
  std::vector<std::uint32_t> labels_, piece_tets_, piece_at_;
  std::vector<TetId> example_;  // a tetrahedron of each piece
  Verdict verdict_;
};

}  // namespace

Body::Body(const core::MeshData& mesh, double spacing_h) : Body(mesh, core::TetMesh(mesh), spacing_h) {}

Body::Body(const core::MeshData& mesh, const core::TetMesh& loaded, double spacing_h)
    : low(bounds(mesh)[0]),
      high(bounds(mesh)[1]),
      h(loaded.mean_edge_length()),
      grid(low, high, spacing_h * loaded.mean_edge_length()) {
  const core::CutReport report = core::measure(loaded);
  volume = report.volume;
  tets = report.tets;
  min_angle_deg = report.min_dihedral_deg;
  crowded_edges = count_crowded_edges(loaded);
  inside.assign(grid.size(), 0);
  walls.assign(grid.size(), 0);
  off_skin2.assign(grid.size(), INFINITY);
  for_each_live_tet(loaded, [&](TetId t, const Vec3(&p)[4]) {
    grid.in_tet(p, [&](std::size_t at) { inside[at] = 1; });
    for (int f = 0; f < 4; ++f) {
      if (loaded.neighbor(t, f) != kNone) continue;
      const auto& k = core::kFaceVertices[f];
      boundary.add_quad({p[k[0]], p[k[1]]}, {p[k[0]], p[k[2]]}, 1, 1, 0, false);
      grid.crossed_by({{p[k[0]], p[k[1]], p[k[2]]}}, [&](std::size_t index, int axis, const Vec3& where) {
        walls[index] |= static_cast<std::uint8_t>(1u << axis);
        grid.within(where, kClosed_h * h, [&](std::size_t at, double d2) {
          off_skin2[at] = std::min(off_skin2[at], static_cast<float>(d2));
        });
      });
    }
  });
  boundary.build();
  flood(grid, walls, inside, parts);
}

Verdict judge(const Body& body, std::span<const Stroke> strokes, const core::TetMesh& result) {
  return Judge(body, strokes, result).run();
}

std::string to_string(const Verdict& v) {
  const std::string held_by =
      v.held_by > 0 ? ", by " + std::to_string(v.held_by) + (v.held_by == 1 ? " face" : " faces") : "";
  char text[512];
  std::snprintf(text, sizeof text,
                "%u pieces, %u parts: %u joined (%.2f h^3%s), %u torn, %u crumbs, %u fragments; %u inverted; "
                "volume %+.4f %%, "
                "growth %.2f, angle %.2f degrees, deviation alone %.3f (mean %.4f), merged %.3f h, %lld "
                "crowded edges%s%s",
                v.pieces, v.parts, v.joined, v.joined_h3, held_by.c_str(), v.torn, v.crumbs, v.fragments,
                v.inverted, 100 * v.volume_change, v.growth, v.min_angle_deg, v.alone_max_h, v.alone_mean_h,
                v.merged_max_h, static_cast<long long>(v.crowded_edges), v.invalid.empty() ? "" : "; ",
                v.invalid.c_str());
  return text;
}

}  // namespace incise::oracle
