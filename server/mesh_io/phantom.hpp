#pragma once

#include <optional>
#include <string_view>

#include "server/mesh_io/surface.hpp"
#include "server/mesh_io/tetgen_fill.hpp"

namespace incise::mesh_io {

// Bodies that are generated: the same arguments give the same bits.
enum class PhantomKind {
  kLiver,     // 0.19 m long: two lobes, a notch between them, a vessel-like tunnel (genus 1)
  kCylinder,  // radius 25 mm, height 100 mm along z: the paper's (Croll 2007, section 3)
  kSlab,      // 100 x 60 x 20 mm
};

// How many tetrahedra a phantom can have.
inline constexpr std::size_t kMinPhantomTets = 500, kMaxPhantomTets = 20'000'000;

// "liver", "cylinder" or "slab"; nothing for any other name.
std::optional<PhantomKind> phantom_kind(std::string_view name);

// The closed surface of a phantom, metres, with triangles of the size that suits a fill of `target_tets`
// tetrahedra. Throws MeshError if target_tets is not kMinPhantomTets to kMaxPhantomTets.
Surface make_phantom_surface(PhantomKind kind, std::size_t target_tets);

// The phantom filled with about options.target_tets tetrahedra (fill_surface); every tetrahedron positive.
// Throws MeshError if TetGen fails.
core::MeshData make_phantom(PhantomKind kind, const FillOptions& options, std::vector<std::string>& warnings);

// Puts the tetrahedra with a face at the outside into a region of their own: a capsule, or skin, one element thick. O(mesh).
void add_capsule(core::MeshData& mesh, std::int32_t region);

}  // namespace incise::mesh_io
