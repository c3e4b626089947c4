#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/surface_check.hpp"

namespace incise::mesh_io {

// How a closed surface is filled with tetrahedra.
struct FillOptions {
  // TetGen's switches (its manual, section 4.2) without a volume bound, which comes from target_tets; a bound
  // given here ("a0.5", cubic units of the file after scaling: m^3) is kept and target_tets ignored.
  std::string tetgen_switches = "pYq1.4";
  // Tetrahedra wanted, 0: no bound. The volume bound is tuned, in at most six runs, until the count is off by
  // no more than this share; if the surface's triangles are too fine for that, a warning says so.
  std::size_t target_tets = 60'000;
  double target_tolerance = 0.2;
  std::chrono::milliseconds time_limit{300'000};  // wall clock, for all runs together
  std::size_t memory_limit_mb = 8192;             // address space of the child
  // Where fills are kept; empty: $XDG_CACHE_HOME/incise or ~/.cache/incise. use_cache false: neither read nor
  // written.
  std::filesystem::path cache_dir;
  bool use_cache = true;
  // Where incise-tetgen is looked for first: a library's own directory, since the running program is then another one.
  std::filesystem::path tetgen_directory;
  // Called as TetGen enters a stage ("recovering boundaries") and twice a second: seconds since the start.
  std::function<void(std::string_view stage, double seconds)> progress;
};

struct Fill {
  core::MeshData mesh;  // as TetGen made it: see repair_tets
  bool from_cache = false;
};

// Fills a closed surface with tetrahedra by TetGen, in the program incise-tetgen: the one that the
// environment variable INCISE_TETGEN names, else the one in options.tetgen_directory, beside the running program, or on the
// PATH. The result is checked against the surface's volume. `file` names the surface in messages;
// `warnings` gets a line if the count is not within a quarter of the target. Throws MeshError if TetGen
// fails, dies, exceeds a limit or gives no or wrong tetrahedra. Thread: any.
Fill fill_surface(const ClosedSurface& closed, const std::string& file, const FillOptions& options,
                  std::vector<std::string>& warnings);

}  // namespace incise::mesh_io
