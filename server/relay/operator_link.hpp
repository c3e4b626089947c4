#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/relay/connection.hpp"
#include "server/stream/peer_input.hpp"

namespace incise::relay {

// An operator's blade, which the origin has: a connection of its own there.
//
// Thread: start() and leave() from any, and what else is public, too; the rest is the io_context's. Owns: the connection.
class OperatorLink final : public std::enable_shared_from_this<OperatorLink>, private Connection::Owner {
 public:
  struct Wanted {
    std::string source_name;
    std::optional<protocol::BladeEdge> blade;
    bool take_over = false;
  };
  using ForceSink = std::function<void(const protocol::Force&)>;  // called on the io_context's thread
  // Without an origin it ends at once.
  OperatorLink(asio::io_context& io, std::optional<Origin> origin, Wanted wanted, ForceSink force);

  // Tries until the origin answers, yes or no.
  void start();
  // Ends the running stroke and frees the blade.
  void leave();

  bool opening() const;
  std::optional<stream::BladeEnd> ended() const;
  // Of the blade, once it is open.
  std::uint32_t number() const;
  protocol::Vec3 heel() const;
  protocol::Vec3 tip() const;
  stream::PoseTotals totals() const;
  // Returns how many poses there was room for.
  std::size_t enqueue(std::span<const protocol::PoseSample> poses);
  bool end_stroke();
  void undo(protocol::Undo what, const stream::PeerInput::Later& later);

  const std::string& source_name() const { return wanted_.source_name; }
  std::chrono::nanoseconds round_trip() const;

 private:
  // What waits to be sent, in the order in which the operator sent it: poses, or an undo, or else the end of a stroke.
  struct Work {
    std::vector<protocol::PoseSample> poses;
    stream::PeerInput::Later undo;
    protocol::Undo undone;
  };
  void add(Work work);
  void connect();
  void send_waiting();
  void on_message(const protocol::Message& message) override;
  void on_end(const Connection::End& end, bool welcomed) override;

  asio::io_context& io_;
  const std::optional<Origin> origin_;
  const Wanted wanted_;
  const ForceSink force_;
  asio::steady_timer retry_;
  std::shared_ptr<Connection> connection_;
  std::map<std::uint64_t, stream::PeerInput::Later> undos_;  // by their messages' sequences
  bool left_ = false;

  mutable std::mutex mutex_;  // of all below
  protocol::Welcome welcome_;
  protocol::PoseReport report_;
  bool opening_ = true, sending_ = false;
  std::optional<stream::BladeEnd> end_;
  std::vector<Work> waiting_;
  std::size_t waiting_poses_ = 0;
  std::int64_t last_source_ns_ = 0, round_trip_ns_ = 0;
};

// The same as the input of the server here: the blade is free again when that goes.
std::unique_ptr<stream::PoseInput> lend(std::shared_ptr<OperatorLink> link);

// One thing that an administrator asks of the origin: Reset or Undo, over a connection for this alone.
//
// Thread: the io_context's.
void ask_origin(asio::io_context& io, const Origin& origin, protocol::Body what,
                stream::PeerInput::Later later);

}  // namespace incise::relay
