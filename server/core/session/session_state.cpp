#include "server/core/session/session_state.hpp"

#include "server/base/check.hpp"

namespace incise::core {
namespace {

// More than a state has, so that it is written to one place; a body's grid and fields aside.
constexpr std::size_t kBytesPerTet = 96, kBytesPerVertex = 160;

}  // namespace

std::vector<std::byte> save_session(const CutSession& session, std::vector<std::byte> into) {
  INCISE_CHECK(session.backlog_batches() == 0, session.backlog_batches());
  const TetMesh& mesh = session.mesh();
  Archive out(std::move(into), kBytesPerTet * mesh.tet_slots() + kBytesPerVertex * mesh.vertex_slots());
  const_cast<CutSession&>(session).archive(out);  // NOLINT: an archive that writes changes nothing
  return out.take();
}

std::unique_ptr<CutSession> restore_session(std::span<const std::byte> bytes, const CutConfig& config,
                                            std::string& error) {
  auto session = std::make_unique<CutSession>(MeshData{}, config);
  Archive in(bytes);
  session->archive(in);
  in.demand(in.at_end(), "something follows its end");
  error = in.error();
  return in.failed() ? nullptr : std::move(session);
}

}  // namespace incise::core
