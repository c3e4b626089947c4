#pragma once

#include <boost/asio/awaitable.hpp>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "server/stream/peer_input.hpp"

namespace incise::stream {

namespace asio = boost::asio;

// The blade that an operator holds: its poses go in here, and reports of what became of them come out.
//
// Thread: the stream thread. Owns: the blade, from hold() to release().
class OperatorBlade {
 public:
  void hold(std::unique_ptr<PoseInput> input, std::string source_name);
  // Ends the stroke and frees the blade.
  void release() { input_.reset(); }

  bool held() const { return input_ != nullptr; }
  const PoseInput* input() const { return input_.get(); }
  const std::string& source_name() const { return source_name_; }

  // Queues the poses for the loop, in order. While the queue is full it waits, so that nothing more is read from the
  // peer. `engage_button`: the bit that stands for an engaged blade, -1 where it always is.
  asio::awaitable<void> enqueue(const protocol::PoseBatch& batch, std::uint64_t sequence,
                                std::int64_t arrival_ns, int engage_button);
  // All poses from here on are engaged, whatever their buttons say, until end_stroke().
  void engage() { engaged_ = true; }
  asio::awaitable<void> end_stroke(std::int64_t arrival_ns);

  // What became of the poses so far; nothing where that is what the last report said.
  std::optional<protocol::PoseReport> next_report(protocol::Recording recording);
  // The peer knows this without a report.
  void note_reported(protocol::Recording recording) { last_report_.recording = recording; }

 private:
  std::unique_ptr<PoseInput> input_;
  std::string source_name_;
  bool engaged_ = false;       // by message
  std::uint64_t offered_ = 0;  // poses queued since Welcome
  struct Offered {
    std::uint64_t sequence, offered;
  };
  std::deque<Offered> unsettled_;  // messages with poses that the loop has not counted yet
  std::uint64_t through_sequence_ = 0;
  protocol::PoseReport last_report_;
};

}  // namespace incise::stream
