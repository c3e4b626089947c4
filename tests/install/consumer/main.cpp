// consumer PORT: makes a mesh of the core from the state of the server there, and prints its number of tetrahedra.
#include <cstdio>
#include <cstdlib>

#include "client/client.hpp"
#include "server/core/mesh/tet_mesh.hpp"

int main(int, char** argv) {
  using namespace incise;
  const auto client =
      client::Client::connect("127.0.0.1", static_cast<std::uint16_t>(std::atoi(argv[1])), {});
  if (!client->wait_for_revision(0, 60)) return 1;
  core::MeshData mesh;
  client->read([&mesh](const protocol::Replica& replica) {
    for (std::uint32_t v = 0; v < replica.vertex_count(); ++v) {
      const auto p = replica.position(v);
      mesh.positions.push_back({p.x, p.y, p.z});
    }
    replica.for_each_tet([&](std::uint32_t t) { mesh.tets.push_back(replica.vertices(t)); });
  });
  std::printf("%u tetrahedra\n", core::TetMesh(mesh).live_tets());
}
