#pragma once

// Where a relay gets its session from: an incised or another relay over TCP (tcp_upstream.hpp), or whatever else carries the same messages.

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "client/client.hpp"
#include "protocol/framing.hpp"

namespace incise::relay {

// The state that a relay holds. Epoch 0: none.
struct Held {
  std::uint64_t epoch = 0, revision = 0, state_hash = 0;
  std::vector<std::uint32_t> fields;  // those of Welcome.fields that it holds
};

// A server that answers directly: for operators, who need a connection of their own, and for what it serves by HTTP.
struct Origin {
  std::string host;
  std::uint16_t tcp_port = 0, http_port = 0;
  client::Options options;  // transport, TLS, authority and token
  std::string http_option;  // what a person sets http_port with, for messages; "": it is known otherwise
};

// A session's messages, as they come.
//
// Thread: one that the maker chooses (for the one over TCP, that of its io_context); start() to stop(), and all calls of the sink, are there.
class Upstream {
 public:
  // What follows the session. It trusts nothing that comes: what does not fit, or leads to another hash than announced, it answers with
  // resync().
  class Sink {
   public:
    // The messages that a viewer of view Volume gets, without a box and with all fields ("*"), in that order (PROTOCOL.md, sections 3 and 4):
    //
    //   Welcome         at first, after every loss, and when the ids start again. `session` is the epoch's plain id: the
    //                   one that a viewer gets who asks for no fields. `resumed`: deltas follow from held(); else a snapshot does
    //   SnapshotBegin, SnapshotChunk, FieldValues, SnapshotEnd
    //   Delta           one revision, or several combined
    //   FieldValues     outside of a snapshot: somebody has set a field
    //   Stats           about once a second
    //   BladePose       may be left out, newer ones replace it
    //
    // Others are passed over. The message's arrays are valid during the call. Its times are in the sender's clock, which is `ahead_ns`
    // ahead of CLOCK_MONOTONIC here.
    virtual void on_message(const protocol::Message& message, std::int64_t ahead_ns) = 0;
    // Nothing comes for now; the upstream goes on trying. One line. Also before the first message, and again when the reason changes.
    virtual void on_lost(const std::string& why) = 0;
    // Where to go on after a loss. A sink that waits for a snapshot holds nothing.
    virtual Held held() const = 0;

   protected:
    ~Sink() = default;
  };

  virtual ~Upstream() = default;
  virtual void start(Sink& sink) = 0;
  virtual void stop() = 0;
  // What came was wrong: a snapshot is needed. Deltas until it begins are passed over.
  virtual void resync(const std::string& reason) = 0;
  // What comes cannot be followed: lets go of it, and looks again after a while. The sink hears on_lost(why). One that reads what only
  // servers publish need not.
  virtual void leave(const std::string& why) { static_cast<void>(why); }
  // Nothing while it is not known, or if there is none. From any thread.
  virtual std::optional<Origin> origin() const = 0;
  // For people, in logs and /stats: "tcp://host:7450". From any thread.
  virtual std::string name() const = 0;
  // To the origin and back; 0: not known.
  virtual std::chrono::nanoseconds round_trip() const { return {}; }
};

}  // namespace incise::relay
