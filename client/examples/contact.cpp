// Renders forces for a device at this end, at its own rate: contact [PORT]. A device of yours takes the place of Device.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <thread>

#include "client/client.hpp"
#include "client/contact_renderer.hpp"

using namespace incise;

namespace {

std::int64_t now_ns() {
  return std::chrono::steady_clock::now().time_since_epoch().count();
}

// A hand that moves the tool down into the body and up again, once.
class Device {
 public:
  protocol::Vec3 position() {
    const double s = ++tick_ * 0.001;
    return {0.02, 0, 0.16 - 0.1 * (s < 1 ? s : 2 - s)};
  }
  bool open() const { return tick_ < 2000; }
  void apply(const protocol::Vec3& force_n) { largest_n_ = std::max(largest_n_, force_n.z); }
  double largest_n() const { return largest_n_; }

 private:
  int tick_ = 0;
  double largest_n_ = 0;
};

}  // namespace

int main(int argc, char** argv) try {
  const auto port = static_cast<std::uint16_t>(argc > 1 ? std::atoi(argv[1]) : 7450);
  client::ContactRenderer renderer;  // at most 3.3 N, 500 N/s
  client::Callbacks callbacks;
  callbacks.on_force = [&](const protocol::Force& force) { renderer.take(force, now_ns()); };
  client::Options options;
  options.role = protocol::Role::Operator;
  options.view = protocol::View::None;
  options.blade = protocol::BladeEdge{{0, 0, 0}, {0, 0, -0.05}};
  const auto client = client::Client::connect("127.0.0.1", port, options, callbacks);

  Device device;
  while (device.open()) {  // the device's own loop, 1 kHz
    const protocol::Vec3 tool = device.position();
    protocol::PoseSample pose;
    pose.source_ns = now_ns();
    pose.position = tool;
    client->send_poses({&pose, 1});
    device.apply(renderer.force(tool, now_ns()));
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  std::printf("largest force %.2f N\n", device.largest_n());
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s: %s\n", argv[0], error.what());
  return 1;
}
