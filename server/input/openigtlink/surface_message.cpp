#include "server/input/openigtlink/surface_message.hpp"

#include <igtlPolyDataMessage.h>
#include <igtlTimeStamp.h>

#include <variant>

namespace incise::input::openigtlink {
namespace {

using Triangles = std::map<std::uint32_t, protocol::SurfaceReplica::Triangle>;

igtl::PolyDataAttribute::Pointer attribute(const char* name, const Triangles& triangles, auto value_of) {
  const auto attribute = igtl::PolyDataAttribute::New();
  attribute->SetType(igtl::PolyDataAttribute::CELL_SCALAR);
  attribute->SetName(name);
  std::vector<igtlFloat32> values;
  values.reserve(triangles.size());
  for (const auto& [id, triangle] : triangles) values.push_back(static_cast<igtlFloat32>(value_of(triangle)));
  attribute->SetSize(static_cast<igtlUint32>(values.size()));
  if (!values.empty()) attribute->SetData(values.data());
  return attribute;
}

}  // namespace

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
  std::map<std::uint32_t, igtlUint32> index;  // of a vertex among the message's points
  const auto points = igtl::PolyDataPointArray::New();
  points->SetNumberOfPoints(static_cast<int>(surface.vertices().size()));
  for (const auto& [id, vertex] : surface.vertices()) {
    const core::Vec3 p =
        device_from_world(peers, {vertex.position[0], vertex.position[1], vertex.position[2]});
    const auto i = static_cast<igtlUint32>(index.size());
    index.emplace_hint(index.end(), id, i);
    points->SetPoint(i, static_cast<igtlFloat32>(p.x), static_cast<igtlFloat32>(p.y),
                     static_cast<igtlFloat32>(p.z));
  }
  const auto polygons = igtl::PolyDataCellArray::New();
  for (const auto& [id, triangle] : surface.triangles()) {
    igtlUint32 corners[3];
    for (std::size_t i = 0; i < 3; ++i) corners[i] = index.at(triangle.vertices[i]);
    polygons->AddCell(3, corners);
  }
  const auto message = igtl::PolyDataMessage::New();
  igtl::TimeStamp::Pointer time = igtl::TimeStamp::New();
  time->GetTime();
  message->SetDeviceName(device.c_str());
  message->SetTimeStamp(time);
  message->SetPoints(points);
  message->SetPolygons(polygons);
  using Triangle = protocol::SurfaceReplica::Triangle;
  message->AddAttribute(attribute("piece", surface.triangles(), [](const Triangle& t) { return t.piece; }));
  message->AddAttribute(attribute("cut", surface.triangles(),
                                  [](const Triangle& t) { return t.flags & protocol::kTriangleCut; }));
  message->Pack();
  const auto* const bytes = static_cast<const std::uint8_t*>(message->GetPackPointer());
  return {bytes, bytes + message->GetPackSize()};
}

}  // namespace incise::input::openigtlink
