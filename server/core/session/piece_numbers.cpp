#include "server/core/session/piece_numbers.hpp"

#include <algorithm>

#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::core {
namespace {

struct Part {
  std::uint32_t id = 0, tets = 0;
};

template <class IdOf>
std::vector<std::uint32_t> numbers(const TetMesh& mesh, const IdOf& id_of) {
  std::uint32_t count = 0, most = 0;
  std::vector<std::uint32_t> out = label_pieces(mesh, &count);
  std::vector<Part> parts(count);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    Part& part = parts[out[t]];
    if (part.tets++ == 0) part.id = id_of(t);
    most = std::max(most, part.id);
  }
  std::vector<std::uint32_t> keeper(count == 0 ? 0 : std::size_t{most} + 1, kNone);  // of each id: the part
  for (std::uint32_t p = 0; p < count; ++p) {
    std::uint32_t& kept = keeper[parts[p].id];
    if (kept == kNone || parts[p].tets > parts[kept].tets) kept = p;
  }
  std::vector<std::uint32_t> number(count);
  for (std::uint32_t p = 0; p < count; ++p) number[p] = keeper[parts[p].id] == p ? parts[p].id : ++most;
  for (std::uint32_t& piece : out)
    if (piece != kNone) piece = number[piece];
  return out;
}

}  // namespace

std::vector<std::uint32_t> piece_numbers(const CutSession& session) {
  return numbers(session.mesh(), [&](TetId t) { return session.piece(t); });
}

std::vector<std::uint32_t> piece_numbers(const TetMesh& mesh) {
  return numbers(mesh, [](TetId) { return 0u; });
}

}  // namespace incise::core
