#include "server/wasm/body_file.hpp"

#include <ostream>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "protocol/framing.hpp"
#include "protocol/replica.hpp"
#include "server/replay/session_view.hpp"
#include "server/stream/delta_arrays.hpp"

namespace incise::wasm {
namespace {

void write(std::ostream& out, const protocol::Body& body) {
  const protocol::Frame frame = protocol::encode(body);
  out.write(reinterpret_cast<const char*>(frame.tcp().data()),
            static_cast<std::streamsize>(frame.tcp().size()));
}

void write_cut_memory(std::ostream& out, std::span<const std::byte> memory) {
  for (unsigned bits = 0; bits < 64; bits += 8)
    out.put(static_cast<char>(std::uint64_t{memory.size()} >> bits));
  out.write(reinterpret_cast<const char*>(memory.data()), static_cast<std::streamsize>(memory.size()));
}

void demand(bool met, const std::string& otherwise) {
  if (!met) throw std::runtime_error("the body's file: " + otherwise);
}

void demand(const protocol::ApplyResult& result) {
  demand(static_cast<bool>(result), result.text);
}

// Leaves the rest in `bytes`.
std::vector<std::byte> read_cut_memory(std::span<const std::byte>& bytes) {
  std::uint64_t size = 0;
  demand(bytes.size() >= sizeof size, "it is cut off");
  for (unsigned i = 0; i < sizeof size; ++i) size |= std::to_integer<std::uint64_t>(bytes[i]) << 8 * i;
  bytes = bytes.subspan(sizeof size);
  demand(size <= bytes.size(), "it is cut off");
  const auto memory = bytes.first(size);
  bytes = bytes.subspan(size);
  return {memory.begin(), memory.end()};
}

core::MeshData mesh_of(const protocol::Replica& replica) {
  core::MeshData mesh;
  mesh.positions.reserve(replica.vertex_count());
  for (std::uint32_t v = 0; v < replica.vertex_count(); ++v) {
    const auto [x, y, z] = replica.position(v);
    mesh.positions.push_back({x, y, z});
  }
  demand(replica.live_tets() == replica.tet_slots(), "tetrahedra are missing, as in a body that was cut");
  replica.for_each_tet([&](std::uint32_t t) {
    mesh.tets.push_back(replica.vertices(t));
    mesh.regions.push_back(replica.region(t));
    mesh.cut_masks.push_back(replica.cut_mask(t));
  });
  return mesh;
}

}  // namespace

void write_body(std::ostream& out, protocol::Welcome welcome, const core::CutSession& session,
                const protocol::SurfaceAsset* surface) {
  protocol::Replica replica;
  demand(stream::load_initial(replay::initial_state(session, 1), replica).empty(),
         "no client could hold this body");
  welcome.revision = 0;
  welcome.state_hash = replica.state_hash();
  write_cut_memory(out, session.export_data().cut_memory);
  write(out, welcome);
  protocol::SnapshotWriter writer(replica, protocol::SnapshotCause::Join);
  write(out, writer.begin());
  while (writer.next()) write(out, writer.chunk());
  write(out, writer.end());
  if (!surface) return;
  protocol::SurfaceAsset triangles;
  triangles.positions = surface->positions;
  triangles.triangles = surface->triangles;
  write(out, triangles);
}

BodyFile read_body(std::span<const std::byte> bytes) {
  BodyFile file;
  std::vector<std::byte> cut_memory = read_cut_memory(bytes);
  protocol::Replica replica;
  protocol::FrameReader reader;
  bool welcomed = false, complete = false;
  while (reader.read(bytes) == protocol::FrameReader::Status::Complete) {
    protocol::DecodeResult decoded = protocol::decode(reader.body());
    demand(static_cast<bool>(decoded), decoded.error);
    const protocol::Body& body = decoded.message->body;
    if (const auto* welcome = std::get_if<protocol::Welcome>(&body)) {
      file.welcome = *welcome;
      welcomed = true;
    } else if (const auto* begin = std::get_if<protocol::SnapshotBegin>(&body)) {
      demand(replica.begin(*begin));
    } else if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) {
      demand(replica.chunk(*chunk));
    } else if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
      demand(replica.end(*end));
      complete = true;
    } else if (const auto* surface = std::get_if<protocol::SurfaceAsset>(&body)) {
      file.origins = std::make_shared<const protocol::OriginTree>(surface->positions, surface->triangles);
    }
  }
  demand(welcomed && complete && !reader.failed() && reader.pending_bytes() == 0,
         reader.failed() ? reader.error() : "it is cut off");
  file.mesh = mesh_of(replica);
  file.mesh.cut_memory = std::move(cut_memory);
  return file;
}

}  // namespace incise::wasm
