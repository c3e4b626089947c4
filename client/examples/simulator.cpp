// The outline of a host simulation: follows the mesh, sends back where its vertices are now: simulator [PORT].
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <vector>

#include "client/client.hpp"

int main(int argc, char** argv) try {
  using namespace incise;
  const auto port = static_cast<std::uint16_t>(argc > 1 ? std::atoi(argv[1]) : 7450);
  client::Callbacks callbacks;
  callbacks.on_delta = [](const protocol::Replica&, const protocol::Delta& delta, const client::Arrival&) {
    // Update the solver here. Elements: delta.removed_tets, delta.tets. Its fields on the vertices: protocol::carry().
    // Vertices in delta.rest_ids stand for other material than before: mesh.rest_positions() says which.
    std::printf("revision %llu: %zu vertices moved\n", static_cast<unsigned long long>(delta.revision),
                delta.moved_ids.size());
  };
  callbacks.on_positions_report = [](const protocol::PositionsReport& report) {
    // These vertices did not move, or not all the way: they would have inverted an element, or touch the blade.
    std::printf("%zu vertices held\n", report.held.size());
  };
  client::Options options;
  options.role = protocol::Role::Simulator;
  const auto client = client::Client::connect("127.0.0.1", port, options, callbacks);
  for (int step = 1; step <= 20; ++step) {
    if (!client->wait_for_revision(0, 30)) return 1;  // after a reset or an undo the body comes again
    const std::uint64_t session = client->welcome().session;
    std::vector<float> positions;  // of all vertices, or of some, with Positions::ids
    const std::uint64_t revision = client->read([&](const protocol::Replica& mesh) {
      positions.assign(mesh.rest_positions().begin(), mesh.rest_positions().end());
      return mesh.revision();
    });
    for (std::size_t v = 0; v < positions.size(); v += 3)
      positions[v] *= 1 + 0.001F * static_cast<float>(step);
    protocol::Positions message;
    message.revision = revision;
    message.f32 = positions;
    client->send_positions(message);
    if (!client->wait_for_revision(revision + 1, 5) && client->welcome().session == session) return 1;
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s: %s\n", argv[0], error.what());
  return 1;
}
