// An OpenIGTLink peer that has nothing of ours in it: the OpenIGTLink library, its messages and its sockets.
//
//   openigtlink_peer send PORT TYPE VERSION COUNT   connects and sends a pass through the liver, as TRANSFORM, TDATA, QTDATA
//   openigtlink_peer serve TYPE VERSION COUNT       waits to be asked (STT_TDATA, STT_QTDATA), then sends it
//   openigtlink_peer watch PORT                     asks for the surface and prints what it is

#include <igtlServerSocket.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "tests/input/openigtlink/library_peer.hpp"

namespace {

using namespace incise::tests;

// World-from-tool in mm, times 5 ms apart whatever the machine's clock says: a motion at 40 mm/s or so.
Packed pose(const std::string& type, int version, int i, int count) {
  const PlacedTool tool{"Scalpel", 30, -100 + 200.0F * static_cast<float>(i) / static_cast<float>(count - 1),
                        70};
  const std::int64_t t_ns = 1'700'000'000'000'000'000 + 5'000'000 * std::int64_t{i};
  if (type == "TRANSFORM") return transform(tool, t_ns, version);
  return type == "TDATA" ? tdata({tool}, t_ns, version) : qtdata({tool}, t_ns, version);
}

int send(int port, const std::string& type, int version, int count) {
  LibraryPeer peer(port);
  for (int i = 0; i < count; ++i) {
    if (!peer.connected() || !peer.send(pose(type, version, i, count))) return 1;
  }
  std::puts("sent");
  std::fflush(stdout);
  return ::pause();  // stays connected until a signal ends it
}

int serve(const std::string& type, int version, int count) {
  const auto listener = igtl::ServerSocket::New();
  int port = 29'100;
  while (listener->CreateServer(port) != 0) ++port;
  std::printf("port %d\n", port);
  std::fflush(stdout);
  const igtl::ClientSocket::Pointer socket = listener->WaitForConnection(120'000);
  if (socket.IsNull()) return 1;
  const auto header = igtl::MessageHeader::New();
  header->InitPack();
  socket->SetReceiveTimeout(60'000);
  socket->Receive(header->GetPackPointer(), header->GetPackSize());
  header->Unpack();
  if (std::string(header->GetDeviceType()) != "STT_" + type) return 1;
  for (int i = 0; i < count; ++i) {
    const Packed bytes = pose(type, version, i, count);
    if (socket->Send(bytes.data(), static_cast<int>(bytes.size())) != 1) return 1;
  }
  std::puts("sent");
  std::fflush(stdout);
  return ::pause();
}

int watch(int port) {
  LibraryPeer peer(port);
  if (!peer.connected() || !peer.send(get_polydata())) return 1;
  std::string type;
  while ((type = peer.receive_header()) != "POLYDATA") {
    if (type.empty()) return 1;
    peer.skip_body();
  }
  const auto message = igtl::PolyDataMessage::New();
  if (!peer.receive_body(*message)) return 1;
  const SurfaceSeen surface = seen(*message);
  std::printf("surface %s points %zu triangles %zu cut %zu pieces %zu x %.1f %.1f\n",
              surface.good ? "good" : "bad", surface.points, surface.triangles, surface.cut,
              surface.pieces.size(), static_cast<double>(surface.low[0]),
              static_cast<double>(surface.high[0]));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "";
  if (command == "send" && argc == 6)
    return send(std::atoi(argv[2]), argv[3], std::atoi(argv[4]), std::atoi(argv[5]));
  if (command == "serve" && argc == 5) return serve(argv[2], std::atoi(argv[3]), std::atoi(argv[4]));
  if (command == "watch" && argc == 3) return watch(std::atoi(argv[2]));
  return 2;
}
