#include "server/core/cut/cut_memory.hpp"

#include <utility>

#include "protocol/state_hash.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {
namespace {

// A vertex this near to what was swept was put there.
constexpr double kPut_h = 0.02;
constexpr std::uint32_t kVersion = 2;
constexpr std::uint32_t kMostStrokes = 1U << 31;

std::uint64_t fingerprint(const MeshData& mesh) {
  protocol::ElementHash hash(static_cast<std::uint32_t>(mesh.positions.size()));
  for (const Vec3& p : mesh.positions) {
    for (const double x : {p.x, p.y, p.z}) hash.add(x);
  }
  for (const auto& tet : mesh.tets) {
    for (const VertexId v : tet) hash.add(v);
  }
  return hash.value();
}

struct Header {
  std::uint32_t version = kVersion;
  std::uint64_t fingerprint = 0;
  std::uint32_t strokes = 0;

  void archive(Archive& io) {
    io(version);
    io(fingerprint);
    io(strokes);
    io.demand(version == kVersion, "it is of another version");
    io.demand(strokes <= kMostStrokes, "there were more strokes than are counted");
  }
};

struct Memory {
  SweepEnds ends;
  SweptMemory swept;
  HeldFaces held, ribs, necks;

  void archive(Archive& io, const TetMesh& mesh) {
    ends.archive(io);
    swept.archive(io);
    for (HeldFaces* faces : {&held, &ribs, &necks}) faces->archive(io, mesh);
  }
};

// The number that each tetrahedron has once those before it that are gone are left out.
std::vector<TetId> numbers_without_gaps(const TetMesh& mesh) {
  std::vector<TetId> numbers(mesh.tet_slots(), kNone);
  TetId next = 0;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t)) numbers[t] = next++;
  }
  return numbers;
}

HeldFaces renumbered(const HeldFaces& faces, std::span<const TetId> numbers) {
  HeldFaces to;
  for (std::size_t i = 0; i < faces.size(); ++i) {
    HeldFace held = faces[i];
    const TetId t = numbers[tet_of(held.face)];
    if (t == kNone) continue;
    held.face = half_face(t, face_of(held.face));
    to.push(held);
  }
  return to;
}

}  // namespace

std::vector<std::byte> save_cut_memory(const CutWorkspace& workspace, const TetMesh& mesh,
                                       std::uint32_t strokes, const MeshData& exported) {
  if (workspace.swept.quads().empty() && workspace.ends.size() == 0) return {};
  const std::vector<TetId> numbers = numbers_without_gaps(mesh);
  Memory memory{workspace.ends, workspace.swept, renumbered(workspace.held, numbers),
                renumbered(workspace.ribs, numbers), renumbered(workspace.necks, numbers)};
  memory.ends.lose_anchors();
  memory.swept.lose_anchors();
  Header header{kVersion, fingerprint(exported), strokes};
  Archive out;
  header.archive(out);
  memory.archive(out, mesh);
  return out.take();
}

bool has_its_cut_memory(const MeshData& mesh) {
  if (mesh.cut_memory.empty()) return false;
  Archive in(mesh.cut_memory);
  Header header;
  header.archive(in);
  return !in.failed() && header.fingerprint == fingerprint(mesh);
}

bool restore_cut_memory(std::span<const std::byte> bytes, const TetMesh& mesh, CutWorkspace& workspace,
                        std::uint32_t& strokes) {
  Archive in(bytes);
  Header header;
  Memory memory;
  header.archive(in);
  memory.archive(in, mesh);
  in.demand(in.at_end(), "something follows its end");
  if (in.failed()) return false;
  memory.ends.lose_anchors();
  memory.swept.lose_anchors();
  strokes = header.strokes;
  workspace.ends = std::move(memory.ends);
  workspace.swept = std::move(memory.swept);
  workspace.held = std::move(memory.held);
  workspace.ribs = std::move(memory.ribs);
  workspace.necks = std::move(memory.necks);
  const double reach_m = kPut_h * mesh.mean_edge_length();
  std::size_t looked_at = 0;
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v)
    workspace.vertices[v].surface = workspace.swept.stroke_at(mesh.position(v), reach_m, looked_at);
  return true;
}

}  // namespace incise::core
