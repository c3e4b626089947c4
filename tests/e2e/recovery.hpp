#pragma once

// What the tests of restarts compare: the state that a server has, and what its capture ends with.

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <fstream>
#include <functional>
#include <string>
#include <thread>
#include <utility>

#include "client/client.hpp"
#include "protocol/capture.hpp"
#include "tests/e2e/served_session.hpp"

namespace incise::e2e {

inline bool wait_for(const std::function<bool()>& condition) {
  for (int i = 0; i < 2000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

struct Held {
  std::uint64_t revision = 0, hash = 0;
  friend bool operator==(const Held&, const Held&) = default;
};

inline Held held(const client::Client& viewer) {
  return viewer.read([](const protocol::Replica& m) { return Held{m.revision(), m.compute_state_hash()}; });
}

inline Held what_the_server_has(const ServedSession& session) {
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  EXPECT_TRUE(viewer->wait_for_revision(0, 60));
  return held(*viewer);
}

// The last mark and the gaps of a capture.
inline std::pair<std::uint64_t, int> last_mark_and_gaps(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  std::pair<std::uint64_t, int> found{0, 0};
  while (reader.next(record) == protocol::CaptureReader::Status::Record) {
    if (const auto* mark = std::get_if<protocol::BatchMark>(&record)) found.first = mark->revision;
    if (const auto* undo = std::get_if<protocol::UndoRecord>(&record)) found.first = undo->revision;
    found.second += std::holds_alternative<protocol::GapRecord>(record);
  }
  return found;
}

}  // namespace incise::e2e
