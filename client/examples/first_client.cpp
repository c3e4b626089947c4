// Sends a recorded motion to an incised and follows what it cuts: first_client [PORT [MOTION]].
#include <cstdio>
#include <cstdlib>
#include <exception>

#include "client/client.hpp"
#include "protocol/motion.hpp"

int main(int argc, char** argv) try {
  using namespace incise;
  const auto port = static_cast<std::uint16_t>(argc > 1 ? std::atoi(argv[1]) : 7450);
  const auto motion = protocol::read_motion(argc > 2 ? argv[2] : "config/demo_motion.csv");
  client::Options options;
  options.role = protocol::Role::Operator;
  const auto client = client::Client::connect("127.0.0.1", port, options);
  const auto sequence = client->send_poses(motion.samples);
  if (!client->wait_for_report(sequence, 30)) return 1;  // the loop has taken all of them
  if (!client->wait_for_revision(1, 5)) return 1;        // the first delta is here; others follow
  client->read([](const protocol::Replica& mesh) { std::printf("%u tetrahedra\n", mesh.live_tets()); });
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s: %s\n", argv[0], error.what());
  return 1;
}
