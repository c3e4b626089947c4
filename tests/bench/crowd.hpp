#pragma once

// Many peers at once on one thread, with plain sockets: they cost the machine as little as possible, so that the
// server is what is measured.

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "protocol/framing.hpp"

namespace incise::bench {

// The most descriptors that this process may have from here on: the soft limit is raised to the hard one.
std::size_t raise_descriptor_limit();

class Crowd {
 public:
  struct Options {
    int viewers = 0;                                // read all the time, answer pings
    protocol::View view = protocol::View::Surface;  // of theirs
    std::optional<protocol::Box> box;               // of theirs
    int stalled = 0;                                // ask for view Volume, and read nothing
    int silent = 0;                                 // connect, and say nothing at all
  };
  // Connects them all to 127.0.0.1; waits until the viewers are welcomed. Throws std::runtime_error where one of those is not.
  Crowd(std::uint16_t port, const Options& options);
  ~Crowd();
  Crowd(const Crowd&) = delete;
  Crowd& operator=(const Crowd&) = delete;

  // Viewers whose connections have ended, and silent ones.
  int viewers_lost() const { return viewers_lost_; }
  int silent_closed() const { return silent_closed_; }
  // Viewers that were told that there is no box for them.
  std::uint64_t boxes_refused() const { return boxes_refused_; }
  // Waits until each viewer that is left has that revision; false after `seconds`.
  bool wait_for_revision(std::uint64_t revision, double seconds) const;
  // Ends the reading. From "cut" to "arrived here" of each delta of each viewer, ms (the latest step of it).
  const std::vector<double>& stop();

 private:
  struct Peer {
    int fd = -1;
    bool reads = false;
    std::atomic<std::uint64_t> revision{0};
    protocol::FrameReader reader;
  };
  Peer& connect(std::uint16_t port, bool reads, int receive_buffer);
  void run();
  void read(Peer& peer);
  void take(Peer& peer, std::span<const std::byte> body, std::int64_t received_ns);
  void drop(Peer& peer);

  int epoll_ = -1;
  std::vector<std::unique_ptr<Peer>> peers_;
  std::atomic<int> welcomed_{0}, viewers_lost_{0}, silent_closed_{0};
  std::atomic<std::uint64_t> boxes_refused_{0};
  std::atomic<bool> stop_{false};
  std::vector<double> latencies_ms_;
  std::vector<std::byte> buffer_ = std::vector<std::byte>(1 << 18);
  std::thread thread_;
};

}  // namespace incise::bench
