// embed: cuts a cube with the core alone, cuts the saved body on, and undoes the first cut.
#include <algorithm>
#include <array>
#include <cstdio>
#include <exception>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/core/session/session_state.hpp"

using namespace incise::core;

namespace {

// A cube of n^3 small ones about the origin, each of six tetrahedra around a diagonal.
MeshData cube(std::uint32_t n, double edge_m) {
  MeshData mesh;
  const auto id = [n](const std::array<std::uint32_t, 3>& p) {
    return (p[0] * (n + 1) + p[1]) * (n + 1) + p[2];
  };
  const auto at = [&](std::uint32_t i) { return edge_m * (i / double(n) - 0.5); };
  for (std::uint32_t i = 0; i <= n; ++i) {
    for (std::uint32_t j = 0; j <= n; ++j) {
      for (std::uint32_t k = 0; k <= n; ++k) {
        mesh.positions.push_back({at(i), at(j), at(k)});
        if (i == n || j == n || k == n) continue;
        std::array<int, 3> axes{0, 1, 2};
        do {
          std::array<std::uint32_t, 3> corner{i, j, k};
          std::array<VertexId, 4> tet{id(corner)};
          for (std::size_t step = 0; step < 3; ++step) {
            ++corner[axes[step]];
            tet[step + 1] = id(corner);
          }
          mesh.tets.push_back(tet);
        } while (std::next_permutation(axes.begin(), axes.end()));
      }
    }
  }
  for (auto& t : mesh.tets) {  // (v1-v0)x(v2-v0).(v3-v0) > 0
    const auto& p = mesh.positions;
    if (dot(cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]), p[t[3]] - p[t[0]]) < 0) std::swap(t[2], t[3]);
  }
  return mesh;
}

// Works on what waits. An application hands the delta on: what is new and moved, to draw or to simulate.
void commit(CutSession& session, WorkBudget budget) {
  static Delta delta;  // its arrays are used again
  while (session.advance(budget, delta) == CutSession::Progress::kCommitted) std::fputc('.', stderr);
}

// A stroke of one second through the whole cube, in the plane x.
void cut(CutSession& session, double x, std::int64_t start_ns) {
  for (int i = 0; i <= 100; ++i) {
    const Pose pose{start_ns + i * 10'000'000, {x, -0.1 + 0.002 * i, 0.061}, {}, 1};
    if (const PoseVerdict verdict = session.push(0, pose); !accepted(verdict))
      std::fprintf(stderr, "%s\n", to_string(verdict));
    commit(session, {20'000});  // a frame: about a millisecond, then the hand comes first again
  }
  session.end_stroke(0);
  commit(session, WorkBudget::unlimited());
}

unsigned pieces(const CutSession& session) {
  return measure(session.mesh()).pieces;
}

}  // namespace

int main() try {
  CutConfig config;
  config.blade = {{0, 0, 0}, {0, 0, -0.12}};  // heel and tip in the tool's frame, metres
  auto session = std::make_unique<CutSession>(cube(6, 0.1), config);
  const std::vector<std::byte> before = save_session(*session);  // while no batch waits
  cut(*session, 0.0037, 0);
  const unsigned cut_once = pieces(*session);

  const MeshData body = session->export_data();  // to be saved, cut_masks and cut_memory with it
  CutSession later(body, config);
  cut(later, -0.02, 0);

  std::string error;
  session = restore_session(before, config, error);  // undo
  if (!session) throw std::runtime_error(error);
  std::printf("pieces: %u, %u after the second cut, %u after the undo\n", cut_once, pieces(later),
              pieces(*session));
} catch (const std::exception& error) {  // MeshError: of a mesh or a field that cannot be used
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
