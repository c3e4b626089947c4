#pragma once

// A host simulation that fails in all ways that a program behind a network can, for tests of what must hold meanwhile.

#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <random>
#include <thread>
#include <vector>

#include "client/client.hpp"

namespace incise::e2e {

// It moves the body a little, 60 times a second, takes the blades' loads and answers with models of its own. Every now and
// then it does something else for a while. Thread: its own.
class FailingSimulation {
 public:
  enum Mood { kFine, kStalls, kDies, kNotANumber, kLate, kFloods, kMoods };
  static constexpr const char* kNames[kMoods] = {"fine", "stalls", "dies", "NaN", "late", "floods"};

  FailingSimulation(std::uint16_t port, std::uint64_t seed)
      : thread_([this, port, seed](const std::stop_token& stop) { run(stop, port, seed); }) {}

  // How often each mood came.
  std::uint64_t count(Mood mood) const { return counts_[mood]; }
  std::uint64_t connections() const { return connections_; }

 private:
  void run(const std::stop_token& stop, std::uint16_t port, std::uint64_t seed) {
    using std::chrono::milliseconds;
    std::mt19937_64 random(seed);
    std::unique_ptr<client::Client> client;
    while (!stop.stop_requested()) {
      const auto mood = static_cast<Mood>(random() % kMoods);
      ++counts_[mood];
      const auto until = std::chrono::steady_clock::now() + milliseconds(50 + random() % 400);
      if (mood == kDies && client) {
        client->drop_connection();
        client.reset();
      }
      while (!stop.stop_requested() && std::chrono::steady_clock::now() < until) {
        if (mood == kStalls || mood == kDies) {
          std::this_thread::sleep_for(milliseconds(20));  // what has come is not read either
          continue;
        }
        // The server ends a session that floods or sends NaN: then there is another one.
        if (!client || client->status() == client::Status::kClosed) {
          std::this_thread::sleep_for(milliseconds(20));
          client = connect(port);
        }
        if (!client) continue;
        client->poll(mood == kFloods ? 0 : 0.016);
        send(*client, mood);
      }
    }
  }

  std::unique_ptr<client::Client> connect(std::uint16_t port) {
    client::Options options;
    options.role = protocol::Role::Simulator;
    options.load_rate_hz = 240;
    options.background = false;
    client::Callbacks callbacks;
    callbacks.on_blade_load = [this](const protocol::BladeLoad& load) {
      load_ = load;
      load_.ids = {};
      load_.forces = {};
    };
    try {
      auto client = client::Client::connect("127.0.0.1", port, options, callbacks);
      ++connections_;
      return client;
    } catch (const client::ConnectError&) {  // the server stands still just now
      return nullptr;
    }
  }

  void send(client::Client& client, Mood mood) {
    std::vector<float> positions;
    protocol::Positions message;
    message.frame = ++frame_;
    client.read([&](const protocol::Replica& mesh) {
      message.revision = mood == kLate ? 0 : mesh.revision();
      positions.assign(mesh.rest_positions().begin(), mesh.rest_positions().end());
    });
    if (positions.empty()) return;
    const float stretch = 0.02F * std::sin(0.1F * static_cast<float>(frame_));
    for (std::size_t i = 2; i < positions.size(); i += 3) positions[i] *= 1 + stretch;
    if (mood == kNotANumber && frame_ % 4 == 0) positions[frame_ % positions.size()] = std::nanf("");
    message.f32 = positions;
    client.send_positions(message);
    if (load_.server_ns == 0) return;
    const std::array<double, 9> stiffness{
        100, 0, 0, 0, 100, 0, 0, 0, mood == kNotANumber ? std::nan("") : 400};
    protocol::BladeModel model;
    model.source = load_.source;
    model.server_ns = mood == kLate ? load_.server_ns - 2'000'000'000 : load_.server_ns;
    model.point = {load_.tool.x, load_.tool.y, load_.tool.z + 0.001};
    model.stiffness = stiffness;
    model.valid_for_ns = 40'000'000;
    client.send_model(model);
  }

  std::array<std::atomic<std::uint64_t>, kMoods> counts_{};
  std::atomic<std::uint64_t> connections_{0};
  std::uint64_t frame_ = 0;
  protocol::BladeLoad load_;
  std::jthread thread_;
};

}  // namespace incise::e2e
