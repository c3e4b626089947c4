#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "server/stream/counters.hpp"
#include "server/stream/stream_config.hpp"

namespace incise::stream {

namespace asio = boost::asio;

class Ticket;

// Lets connections in: counts them, and bounds those that have not said Hello.
//
// Thread: the stream thread.
class Admission {
 public:
  Admission(const StreamConfig& config, std::shared_ptr<SharedCounters> counters);
  // Admits a connection. Where too many have not said Hello, the oldest of those is closed. Nothing once stop() was
  // called. The socket stays the caller's.
  std::optional<Ticket> admit(asio::ip::tcp::socket& socket);
  void stop() { stopping_ = true; }

 private:
  friend class Ticket;
  // Connections that have not said Hello, in the order in which they came. The descriptors are duplicates, so that a
  // number here is never another connection's, whatever happens to the connection's own descriptor.
  struct HalfOpen {
    ~HalfOpen();
    void close(std::map<std::uint64_t, int>::iterator which);
    std::map<std::uint64_t, int> sockets;
  };
  // Tickets share these: connections that never end are destroyed with the io_context, after this.
  struct Shared {
    std::shared_ptr<SharedCounters> counters;
    HalfOpen half_open;
    std::uint32_t max_peers, max_handshakes;
  };
  std::shared_ptr<Shared> shared_;
  bool stopping_ = false;
};

// One connection's place in the counts. Moves.
class Ticket {
 public:
  Ticket(Ticket&& other) noexcept;
  Ticket& operator=(Ticket&&) = delete;
  ~Ticket();
  // It has said Hello. Takes one of the max_sessions places for peers; false where all are taken.
  bool take_place();
  // It has been told goodbye: its place is free.
  void free_place();
  // Its number among all connections.
  std::uint64_t number() const { return number_; }
  const asio::ip::tcp::endpoint& address() const { return address_; }

 private:
  friend class Admission;
  Ticket(std::shared_ptr<Admission::Shared> shared, std::uint64_t number, asio::ip::tcp::endpoint address);
  void leave_half_open();

  std::shared_ptr<Admission::Shared> shared_;
  std::uint64_t number_;
  asio::ip::tcp::endpoint address_;
  bool has_place_ = false;
};

}  // namespace incise::stream
