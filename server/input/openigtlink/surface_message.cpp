#include "server/input/openigtlink/surface_message.hpp"

#include <unordered_map>
#include <variant>

#include "server/input/openigtlink/message.hpp"

namespace incise::input::openigtlink {
std::unique_ptr<protocol::SurfaceReplica> surface_of(
    std::span<const std::shared_ptr<const protocol::Frame>> frames, std::string& error) {
  auto surface = std::make_unique<protocol::SurfaceReplica>();
  bool whole = false;
  for (const auto& frame : frames) {
    const protocol::DecodeResult decoded = protocol::decode(frame->body());
    if (!decoded) {
      error = decoded.error;
      return nullptr;
    }
    const auto& body = decoded.message->body;
    protocol::ApplyResult result;
    if (const auto* begin = std::get_if<protocol::SnapshotBegin>(&body)) result = surface->begin(*begin);
    if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) result = surface->chunk(*chunk);
    if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
      result = surface->end(*end);
      whole = true;
    }
    if (!result) {
      error = result.text;
      return nullptr;
    }
  }
  if (!whole) error = "a snapshot without an end";
  return whole ? std::move(surface) : nullptr;
}

std::vector<std::uint8_t> pack_surface(const protocol::SurfaceReplica& surface, const Placement& peers,
                                       const std::string& device) {
  constexpr std::string_view kNames("piece\0cut\0", 10);  // of an even length, or a zero would follow
  // One component each. As cell scalars the library's readers would read nine each, beyond the end of the message.
  constexpr std::uint16_t kPointScalar = 0x0001;
  const auto points = static_cast<std::uint32_t>(surface.vertices().size());
  const auto cells = static_cast<std::uint32_t>(surface.triangles().size());
  Writer message("POLYDATA", device, timestamp_now(),
                 62 + std::size_t{20} * points + std::size_t{16} * cells);
  // Points; vertices, lines, polygons, strips, each with a number of cells and of bytes; attributes.
  for (const std::uint32_t count : {points, 0U, 0U, 0U, 0U, cells, 16 * cells, 0U, 0U, 2U})
    message.number(count);
  std::unordered_map<std::uint32_t, std::uint32_t> index;  // of a vertex among the points
  index.reserve(points);
  for (const auto& [id, vertex] : surface.vertices()) {
    const core::Vec3 p =
        device_from_world(peers, {vertex.position[0], vertex.position[1], vertex.position[2]});
    for (const double x : {p.x, p.y, p.z}) message.number(static_cast<float>(x));
    index.emplace(id, static_cast<std::uint32_t>(index.size()));
  }
  // A vertex belongs to one piece: its tetrahedra are connected by faces.
  std::vector<float> piece(points), cut(points);
  for (const auto& [id, triangle] : surface.triangles()) {
    message.number(std::uint32_t{3});
    for (const std::uint32_t vertex : triangle.vertices) {
      const std::uint32_t i = index.at(vertex);
      message.number(i);
      piece[i] = static_cast<float>(triangle.piece);
      if (triangle.flags & protocol::kTriangleCut) cut[i] = 1;
    }
  }
  for (int attribute = 0; attribute < 2; ++attribute) {
    message.number(kPointScalar);
    message.number(points);
  }
  message.text(kNames, kNames.size());
  for (const float value : piece) message.number(value);
  for (const float value : cut) message.number(value);
  return message.done();
}

}  // namespace incise::input::openigtlink
