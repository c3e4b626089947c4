#pragma once

// What the stream needs of the input side. server/app joins it to input::PoseSources.

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/messages.hpp"
#include "server/stream/refusal.hpp"

namespace incise::stream {

// What became of one source's poses since it was opened: the sums in a PoseReport.
struct PoseTotals {
  std::uint64_t accepted = 0;  // including those in too_fast
  std::uint64_t not_finite = 0, not_unit = 0, time_not_rising = 0;
  std::uint64_t queue_full = 0;  // always 0; kept for the wire
  std::uint64_t too_fast = 0;    // accepted, but each began a new stroke
  std::int64_t last_source_ns = 0;
  std::uint32_t backlog_segments = 0;
  std::uint64_t recorded = 0;  // of the accepted ones
  std::int64_t recorded_source_ns = 0;

  // Poses whose fate is known.
  std::uint64_t settled() const { return accepted + not_finite + not_unit + time_not_rising + queue_full; }
};

// Why a blade at another server is gone. With a code it was refused so; with a reason the operator gets that goodbye; with neither the
// connection there was lost, and so is the operator's.
struct BladeEnd {
  protocol::ErrorCode code = protocol::ErrorCode::Unknown;
  protocol::ByeReason reason = protocol::ByeReason::Unknown;
  std::string text;
};

// An undo that is asked for: by the operator of blade `source`, whose stroke it has to be, or without one by an admin.
struct UndoRequest {
  std::optional<std::uint32_t> source;
  bool others = false;  // also where other blades have cut since that stroke began
  std::string by;       // Restart::by
};

// A blade that an operator holds. Destroying it ends the running stroke and frees the blade.
//
// Thread: the stream thread.
class PoseInput {
 public:
  virtual ~PoseInput() = default;
  // Another server has not answered yet: nothing else may be asked until it has.
  virtual bool opening() const { return false; }
  virtual std::optional<BladeEnd> ended() const { return std::nullopt; }
  virtual std::uint32_t number() const = 0;
  // Queues poses in order; returns how many there was room for. The peer is not read further until the rest is queued
  // too: no pose is dropped.
  virtual std::size_t enqueue(std::span<const protocol::PoseSample> poses, std::int64_t arrival_ns) = 0;
  // Ends the running stroke after the poses queued so far. False: no room, try again.
  virtual bool end_stroke(std::int64_t arrival_ns) = 0;
  virtual PoseTotals totals() const = 0;
  // The blade's edge in the tool's frame, metres.
  virtual protocol::Vec3 heel() const = 0;
  virtual protocol::Vec3 tip() const = 0;
};

// The body's positions, which one simulator sets. Destroying it leaves the body as it is.
//
// Thread: the stream thread.
class PositionsInput {
 public:
  virtual ~PositionsInput() = default;
  // Passes positions of existing vertices on to the loop.
  virtual void offer(const protocol::Positions& positions, std::int64_t arrival_ns) = 0;
  // Messages since it was opened that newer ones replaced before the loop had time.
  virtual std::uint64_t skipped() const = 0;
};

// Thread: all calls come from the stream thread.
class PeerInput {
 public:
  // Says that what was asked for cannot be, once that is known. From any thread; may never be called.
  using Later = std::function<void(Refusal)>;
  // The same, and nothing where it has been done. A relay does not say that.
  using Answer = std::function<void(std::optional<Refusal>)>;

  virtual ~PeerInput() = default;
  // Opens a blade by its source's name, with the server's shape or the operator's own. Null where it is held, or no
  // blade is free.
  virtual std::unique_ptr<PoseInput> open(std::string_view source_name,
                                          const std::optional<protocol::BladeEdge>& blade) = 0;
  // Whether a source of that name has its blade now: an operator, or a device of this server.
  virtual bool is_held(std::string_view source_name) const {
    static_cast<void>(source_name);
    return false;
  }
  // The names of the blades that are held now; none where that is not known.
  virtual std::vector<std::string> holders() const { return {}; }
  // As open(), once this server's own operator has left the blade to another, who asked to take it over.
  virtual std::unique_ptr<PoseInput> take_over(std::string_view source_name,
                                               const std::optional<protocol::BladeEdge>& blade) {
    return open(source_name, blade);
  }
  // Why simulators, and values of fields, are not for this server; empty: they are.
  virtual std::string no_simulators() const { return {}; }
  // Opens the body's positions. Null where another simulator sets them, or the server does not offer it.
  virtual std::unique_ptr<PositionsInput> open_positions() { return nullptr; }
  // Asks for the mesh as loaded. False where the server does not offer that. Server::publish_reset() follows when it
  // is done.
  virtual bool reset(const Later& later) {
    static_cast<void>(later);
    return false;
  }
  // Asks for the state before the last stroke. Server::publish_reset() follows when it is done. Empty and an answer later, or why it
  // cannot be.
  virtual std::string undo(const UndoRequest& request, const Answer& answer) {
    static_cast<void>(request), static_cast<void>(answer);
    return "this server does not offer it";
  }
};

}  // namespace incise::stream
