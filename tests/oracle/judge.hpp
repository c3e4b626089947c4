#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/swept_surface.hpp"
#include "tests/oracle/sample_grid.hpp"
#include "tests/oracle/swept.hpp"

// An independent judge of what cuts leave: it knows the body as loaded, where the blades were, and the mesh that came out.
//
// The parts that geometry says are found by flooding the body's sample points, where the swept surfaces block ways between
// them. Nothing in a mesh of width h can follow geometry exactly, so two floods say what must be:
//
// - Two parts must be apart where the surfaces, with all gaps of up to kClosed_h closed, separate them, and each has at
//   least kDeepVolume_h3 that is farther from every surface than kDeep_h.
// - A part must stay connected if its connection runs through points farther than kNeck_h from every surface, and through no gap
//   that may be closed (kMayClose_h; also where a blade turns back before a surface and its stroke goes on).
//
// A piece of the mesh that is no part of the geometry after any of the strokes, or only one that is thinner than kThick_h, is a crumb (of kCrumb tetrahedra or fewer) or a fragment.
namespace incise::oracle {

inline constexpr double kClosed_h = 0.25;
inline constexpr double kMayClose_h = 0.6;  // gaps between the two may be closed
inline constexpr double kDeep_h = 0.3;
inline constexpr double kThick_h =
    0.125;  // a part that nowhere reaches this far from a surface, between two that are one, is no piece
inline constexpr double kDeepVolume_h3 = 0.25;
inline constexpr double kNeck_h = 0.5;
inline constexpr std::uint32_t kCrumb = 8;
inline constexpr double kAlone_h = 1.0;  // a sweep is alone where no other is nearer than this

// The body as loaded. Made once, judges any number of cuts.
struct Body {
  // `spacing_h`: of the sample points, by the mean edge length.
  explicit Body(const core::MeshData& mesh, double spacing_h = 0.125);

  Vec3 low, high;
  double h = 0;
  double volume = 0;
  double min_angle_deg = 0;
  std::uint32_t tets = 0;
  std::uint64_t crowded_edges = 0;  // with more than two boundary faces
  core::SweptSurface boundary;
  SampleGrid grid;
  std::vector<std::uint8_t> inside;
  Walls walls;                       // its boundary, where that passes between two points inside
  std::vector<std::uint32_t> parts;  // that are apart as loaded
  std::vector<float> off_skin2;      // by point: from its boundary, squared, up to kClosed_h

 private:
  Body(const core::MeshData& mesh, const core::TetMesh& tets, double spacing_h);
};

struct Verdict {
  std::string invalid;  // what is wrong with the mesh; empty: nothing
  std::uint32_t inverted = 0;
  std::uint32_t pieces = 0;   // of the mesh
  std::uint32_t parts = 0;    // that must be apart
  std::uint32_t joined = 0;   // parts that lie in a piece with another part
  double joined_h3 = 0;       // the volume of the largest of them
  std::uint32_t held_by = 0;  // the fewest faces that hold it and another one together; 0: more than 64
  std::uint32_t torn = 0;     // pieces too many that hold what must hang together
  std::uint32_t crumbs = 0, small_crumbs = 0, fragments = 0;  // small: of three tetrahedra or fewer
  double volume_change = 0;                                   // by the volume
  double growth = 0;                                          // new tetrahedra a cut face
  std::uint32_t cut_faces = 0;
  double min_angle_deg = 0;
  std::int64_t crowded_edges = 0;  // edges with more than two boundary faces, more than the body had
  // Of cut faces' vertices and centroids from all that was swept, by the mean edge length.
  double alone_max_h = 0, alone_mean_h = 0, merged_max_h = 0;
  Vec3 joined_at, torn_at, crumb_at, far_at;  // examples; joined_at: at one of held_by

  bool parted() const { return joined == 0 && torn == 0; }
  bool right() const { return invalid.empty() && inverted == 0 && parted() && crumbs == 0 && fragments == 0; }
};

Verdict judge(const Body& body, std::span<const Stroke> strokes, const core::TetMesh& result);
std::string to_string(const Verdict& verdict);

}  // namespace incise::oracle
