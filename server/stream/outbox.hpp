#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "server/stream/counters.hpp"
#include "server/stream/transport.hpp"

namespace incise::stream {

// What one peer is to be sent, in order of urgency: the newest force, control messages (answers, reports,
// statistics), the state (snapshots and deltas). One write is under way at a time. Control messages are bounded here,
// the state by the one who adds it (FeedFollower), who looks at state_bytes() first.
//
// Thread: the stream thread alone, as everything of a peer. Owns: the frames that wait or are being written.
class Outbox {
 public:
  class Owner {
   public:
    // The peer leaves too much unread; `what` says what.
    virtual void on_too_slow(const std::string& what) = 0;
    // A write has ended, so there is room.
    virtual void on_written() = 0;
    // The last frame is out.
    virtual void on_last_written() = 0;
    virtual void on_write_failed() = 0;
    // Keeps outbox and transport alive while a callback may come.
    virtual std::shared_ptr<void> keep() = 0;

   protected:
    ~Owner() = default;
  };

  Outbox(Transport& transport, Owner& owner, SharedCounters& counters)
      : transport_(transport), owner_(owner), counters_(counters) {}

  // A control message.
  void send(SharedFrame frame);
  // An Error that does not end the connection.
  void complain(protocol::ErrorCode code, const std::string& text, std::uint64_t in_reply_to);
  void send_state(SharedFrame frame);
  // Replaces the force before, where that still waits.
  void send_force(const protocol::Force& force);
  // Behind everything that waits; nothing is sent after it.
  void send_last(SharedFrame frame);
  // Drops what waits and is not being written.
  void drop_control();
  void drop_state();
  // Writes nothing more.
  void close() { closed_ = true; }
  // The peer cannot keep up with what the caller sends.
  void give_up(const std::string& why) { owner_.on_too_slow(why); }

  // Waiting and being written.
  std::size_t control_bytes() const { return control_bytes_; }
  std::size_t state_bytes() const { return state_bytes_; }
  // When the write under way began; 0: there is none.
  std::int64_t write_began_ns() const { return write_began_ns_; }
  std::shared_ptr<void> keep() const { return owner_.keep(); }

 private:
  void write();
  void on_written(boost::system::error_code error);
  // Moves frames to writing_, as many as one write may have.
  void gather(std::deque<SharedFrame>& from, std::size_t& writing, std::size_t& total);

  Transport& transport_;
  Owner& owner_;
  SharedCounters& counters_;
  std::deque<SharedFrame> control_, state_;
  std::size_t control_bytes_ = 0, state_bytes_ = 0;
  std::optional<protocol::Force> force_;
  std::vector<SharedFrame> writing_;
  std::size_t writing_control_ = 0, writing_state_ = 0;  // bytes
  std::int64_t write_began_ns_ = 0;
  bool ending_ = false;  // the last frame is in
  bool closed_ = false;
};

}  // namespace incise::stream
