#pragma once

// OpenIGTLink messages made and sent by the OpenIGTLink library, for tests.

#include <igtlClientSocket.h>
#include <igtlMessageHeader.h>
#include <igtlPolyDataMessage.h>
#include <igtlQuaternionTrackingDataMessage.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTrackingDataMessage.h>
#include <igtlTransformMessage.h>
#include <igtl_util.h>

#include <algorithm>
#include <csignal>
#include <cstdint>
#include <set>
#include <string>
#include <vector>

namespace incise::tests {

using Packed = std::vector<std::uint8_t>;

// The same message with a header of version 2: with an extended header and metadata around the content, as the
// documentation has them. Debian's library (1.11) writes version 1 alone; the CRC is its.
inline Packed as_version_2(const Packed& version_1) {
  constexpr std::size_t kHeader = 58;
  const std::string key = "TransformStatus", value = "OK, with a text of odd length!!";
  Packed body;
  const auto number = [&](std::uint64_t n, int bytes) {
    for (int i = bytes - 1; i >= 0; --i) body.push_back(static_cast<std::uint8_t>(n >> 8 * i));
  };
  number(12, 2);                         // of the extended header
  number(2 + 8, 2);                      // of the metadata's header
  number(key.size() + value.size(), 4);  // of the metadata
  number(7, 4);                          // the message's number
  body.insert(body.end(), version_1.begin() + kHeader, version_1.end());
  number(1, 2);
  number(key.size(), 2);
  number(3, 2);  // US-ASCII
  number(value.size(), 4);
  body.insert(body.end(), key.begin(), key.end());
  body.insert(body.end(), value.begin(), value.end());
  Packed message(version_1.begin(), version_1.begin() + kHeader - 16);
  message[1] = 2;
  const std::uint64_t crc = ::crc64(body.data(), body.size(), 0);
  for (const std::uint64_t n : {std::uint64_t{body.size()}, crc}) {
    for (int i = 7; i >= 0; --i) message.push_back(static_cast<std::uint8_t>(n >> 8 * i));
  }
  message.insert(message.end(), body.begin(), body.end());
  return message;
}

inline Packed pack(igtl::MessageBase& message, const std::string& device, std::int64_t t_ns,
                   int version = 1) {
  igtl::TimeStamp::Pointer time = igtl::TimeStamp::New();
  time->SetTimeInNanoseconds(static_cast<igtlUint64>(t_ns));
  message.SetDeviceName(device.c_str());
  message.SetTimeStamp(time);
  message.Pack();
  const auto* const bytes = static_cast<const std::uint8_t*>(message.GetPackPointer());
  Packed packed(bytes, bytes + message.GetPackSize());
  return version == 1 ? packed : as_version_2(packed);
}

struct PlacedTool {
  std::string name;
  float x = 0, y = 0, z = 0;  // mm
  float q[4] = {0, 0, 0, 1};  // x y z w
};

inline void fill(igtl::Matrix4x4& matrix, PlacedTool tool) {
  igtl::QuaternionToMatrix(tool.q, matrix);
  matrix[0][3] = tool.x;
  matrix[1][3] = tool.y;
  matrix[2][3] = tool.z;
}

inline Packed transform(const PlacedTool& tool, std::int64_t t_ns, int version = 1) {
  igtl::Matrix4x4 matrix;
  fill(matrix, tool);
  const auto message = igtl::TransformMessage::New();
  message->SetMatrix(matrix);
  return pack(*message, tool.name, t_ns, version);
}

inline Packed tdata(const std::vector<PlacedTool>& tools, std::int64_t t_ns, int version = 1) {
  const auto message = igtl::TrackingDataMessage::New();
  for (const PlacedTool& tool : tools) {
    igtl::TrackingDataElement::Pointer element = igtl::TrackingDataElement::New();
    igtl::Matrix4x4 matrix;
    fill(matrix, tool);
    element->SetName(tool.name.c_str());
    element->SetType(igtl::TrackingDataElement::TYPE_6D);
    element->SetMatrix(matrix);
    message->AddTrackingDataElement(element);
  }
  return pack(*message, "Tracker", t_ns, version);
}

inline Packed qtdata(const std::vector<PlacedTool>& tools, std::int64_t t_ns, int version = 1) {
  const auto message = igtl::QuaternionTrackingDataMessage::New();
  for (const PlacedTool& tool : tools) {
    igtl::QuaternionTrackingDataElement::Pointer element = igtl::QuaternionTrackingDataElement::New();
    element->SetName(tool.name.c_str());
    element->SetType(igtl::QuaternionTrackingDataElement::TYPE_6D);
    element->SetPosition(tool.x, tool.y, tool.z);
    element->SetQuaternion(tool.q[0], tool.q[1], tool.q[2], tool.q[3]);
    message->AddQuaternionTrackingDataElement(element);
  }
  return pack(*message, "Tracker", t_ns, version);
}

inline Packed string_message(const std::string& device, const std::string& text, int version = 1) {
  const auto message = igtl::StringMessage::New();
  message->SetString(text.c_str());
  return pack(*message, device, 0, version);
}

inline Packed status(const std::string& device, int code) {
  const auto message = igtl::StatusMessage::New();
  message->SetCode(code);
  message->SetErrorName("name");
  message->SetStatusString("text");
  return pack(*message, device, 0);
}

inline Packed get_polydata() {
  const auto message = igtl::GetPolyDataMessage::New();
  return pack(*message, "Viewer", 0);
}

// A peer that connects, on the library's own socket.
class LibraryPeer {
 public:
  explicit LibraryPeer(int port) {
    std::signal(SIGPIPE, SIG_IGN);
    connected_ = socket_->ConnectToServer("127.0.0.1", port) == 0;
    socket_->SetReceiveTimeout(20'000);
  }
  ~LibraryPeer() { close(); }
  bool connected() const { return connected_; }
  bool send(const Packed& bytes) { return socket_->Send(bytes.data(), static_cast<int>(bytes.size())) == 1; }
  void close() { socket_->CloseSocket(); }
  // The next message's type; empty at the end. header_ has the rest.
  std::string receive_header() {
    header_->InitPack();
    const int got = socket_->Receive(header_->GetPackPointer(), header_->GetPackSize());
    if (got != header_->GetPackSize()) return "";
    header_->Unpack();
    return header_->GetDeviceType();
  }
  // The body of the message whose header has been read. False where its CRC is wrong.
  bool receive_body(igtl::MessageBase& message) {
    message.SetMessageHeader(header_);
    message.AllocatePack();
    socket_->Receive(message.GetPackBodyPointer(), message.GetPackBodySize());
    return (message.Unpack(1) & igtl::MessageHeader::UNPACK_BODY) != 0;
  }
  void skip_body() { socket_->Skip(header_->GetBodySizeToRead()); }
  std::string device() const { return header_->GetDeviceName(); }

 private:
  igtl::ClientSocket::Pointer socket_ = igtl::ClientSocket::New();
  igtl::MessageHeader::Pointer header_ = igtl::MessageHeader::New();
  bool connected_ = false;
};

// What a POLYDATA message says.
struct SurfaceSeen {
  bool good = false;
  std::size_t points = 0, triangles = 0;
  std::size_t cut = 0;  // of the points
  std::set<float> pieces;
  float low[3] = {1e9F, 1e9F, 1e9F}, high[3] = {-1e9F, -1e9F, -1e9F};
};

inline SurfaceSeen seen(igtl::PolyDataMessage& message) {
  SurfaceSeen surface;
  surface.good = message.GetPoints() && message.GetPolygons() && message.GetNumberOfAttributes() == 2 &&
                 message.GetAttribute(0)->GetSize() == message.GetAttribute(1)->GetSize();
  if (!surface.good) return surface;
  surface.points = static_cast<std::size_t>(message.GetPoints()->GetNumberOfPoints());
  surface.triangles = message.GetPolygons()->GetNumberOfCells();
  for (unsigned i = 0; i < surface.points; ++i) {
    float p[3];
    message.GetPoints()->GetPoint(i, p);
    for (int axis = 0; axis < 3; ++axis) {
      surface.low[axis] = std::min(surface.low[axis], p[axis]);
      surface.high[axis] = std::max(surface.high[axis], p[axis]);
    }
    float piece = -1, cut = -1;
    message.GetAttribute(0)->GetNthData(i, &piece);
    message.GetAttribute(1)->GetNthData(i, &cut);
    surface.pieces.insert(piece);
    surface.cut += cut == 1;
    surface.good = surface.good && (cut == 0 || cut == 1);
  }
  for (unsigned i = 0; i < surface.triangles; ++i) {
    igtlUint32 corners[3] = {};
    surface.good = surface.good && message.GetPolygons()->GetCellSize(i) == 3;
    message.GetPolygons()->GetCell(i, corners);
    for (const igtlUint32 corner : corners) surface.good = surface.good && corner < surface.points;
  }
  surface.good = surface.good && std::string(message.GetAttribute(0)->GetName()) == "piece" &&
                 std::string(message.GetAttribute(1)->GetName()) == "cut";
  return surface;
}

}  // namespace incise::tests
