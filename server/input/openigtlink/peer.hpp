#pragma once

#include <boost/asio/awaitable.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/base/clock.hpp"
#include "server/input/limited_log.hpp"
#include "server/input/openigtlink/message.hpp"
#include "server/input/openigtlink/openigtlink_input.hpp"
#include "server/input/openigtlink/pose_clock.hpp"
#include "server/input/pose_sources.hpp"

namespace incise::input::openigtlink {

using SharedBytes = std::shared_ptr<const std::vector<std::uint8_t>>;

// The name that our messages carry.
inline constexpr const char* kDeviceName = "Incise";

// What happened so far, over all connections: NetworkStatus::counts.
struct Counts {
  std::uint64_t connections = 0, messages = 0, poses = 0, skipped = 0, bad_headers = 0, bad_crc = 0,
                bad_shape = 0, bad_values = 0, stretched = 0, no_blade = 0, clock_restarts = 0, refused = 0,
                unfinished = 0, surfaces = 0;
};

// What all peers share. Thread: the one that runs `io`.
struct PeerContext {
  boost::asio::io_context& io;
  PoseSources& sources;
  const OpenIgtLinkOptions& options;
  Counts counts{};
  LimitedLog events{}, faults{};

  // Lines about the peer "address:port", limited together with all of its address.
  void log_event(const std::string& peer, const std::string& line) {
    events.write(spdlog::level::info, address_of(peer), "openigtlink: " + peer + line, monotonic_ns());
  }
  void log_fault(spdlog::level::level_enum level, const std::string& peer, const std::string& line) {
    faults.write(level, address_of(peer), "openigtlink: " + peer + line, monotonic_ns());
  }
  static std::string address_of(const std::string& peer) { return peer.substr(0, peer.rfind(':')); }

  // The shortest time between two surfaces to one peer.
  std::int64_t surface_interval_ns() const { return static_cast<std::int64_t>(1e9 / options.surface_hz); }
};

// A tool that one connection reports, by its device name.
struct Tool {
  std::optional<PoseSource> source;
  bool engaged = true;
  bool waiting = false;  // for room in the queue
  std::int64_t released_ns = 0;
  std::int64_t arrival_ns = 0;  // of the last pose; 0: there was none
  PoseClock clock;

  void release();
};

// One connection: reads poses, engagement and requests; sends surfaces.
//
// Thread: the one that runs the context's `io`. Owns: the socket, the tools.
class Peer : public std::enable_shared_from_this<Peer> {
 public:
  Peer(PeerContext& context, boost::beast::tcp_stream stream, std::string name);

  const std::string& name() const { return name_; }
  bool closed() const { return closed_; }
  // The names of its tools that have a blade.
  std::vector<std::string> sources() const;

  // Reads until the connection ends.
  boost::asio::awaitable<void> run();
  void close();
  void release_tools() { tools_.clear(); }
  // Releases silent tools; closes the connection if a message is not finished, or not read, in time.
  void check_deadlines(std::int64_t now_ns);

  void send(const char* type, std::span<const std::uint8_t> body);
  // Whether it wants the surface, and does not have the one of this state.
  bool wants_surface(std::uint64_t state, std::int64_t now_ns) const;
  void send_surface(const SharedBytes& surface, std::uint64_t state, std::int64_t now_ns);

 private:
  void send(SharedBytes bytes);
  void write();
  boost::asio::awaitable<std::string> read_message();
  boost::asio::awaitable<std::string> read_part(std::span<std::uint8_t> part);
  boost::asio::awaitable<std::string> skip(const std::string& type, std::uint64_t bytes);
  boost::asio::awaitable<void> handle_body(const Header& header);
  void answer_surface_request(const Message& message);
  void count_fault(const Decoded& decoded);
  void note_bad_tools(const Message& message, const std::string& device);
  Tool* tool_of(const std::string& device);
  void engage(std::string device, const std::string& text);
  boost::asio::awaitable<void> pause();
  boost::asio::awaitable<bool> open_source(Tool& tool, const std::string& name);
  boost::asio::awaitable<void> enqueue(const ToolPose& pose, std::int64_t stamp_ns, std::int64_t arrival_ns);

  PeerContext& context_;
  boost::beast::tcp_stream stream_;
  const std::string name_;
  std::map<std::string, Tool> tools_;
  std::vector<std::uint8_t> body_;  // of the message at hand
  std::deque<SharedBytes> outbox_;  // the first is being written
  std::int64_t write_began_ns_ = 0;
  bool closed_ = false;
  int faults_ = 0;  // in a row
  std::int64_t part_began_ns_ =
      0;  // since when we wait for the rest of a message; 0: we do not; < 0: too late
  // Which surfaces it wants, and which one it has.
  bool streaming_ = false, wants_one_ = false;
  std::int64_t interval_ns_ = 0, sent_ns_ = 0;
  std::uint64_t sent_state_ = 0;
  bool sent_any_ = false;
};

}  // namespace incise::input::openigtlink
