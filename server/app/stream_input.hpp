#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "server/app/config.hpp"
#include "server/input/pose_sources.hpp"
#include "server/input/positions_slot.hpp"
#include "server/loop/frame_loop.hpp"
#include "server/stream/peer_input.hpp"

namespace incise::app {

// An operator's blade: its poses go from the wire to a pose source. Thread: the stream's.
class StreamPoseInput final : public stream::PoseInput {
 public:
  // `stats`, for the backlog, may be null.
  StreamPoseInput(input::PoseSource source, const core::Blade& blade, const loop::LoopStats* stats)
      : source_(std::move(source)), blade_(blade), stats_(stats) {}

  std::uint32_t number() const override { return source_.number(); }
  std::size_t enqueue(std::span<const protocol::PoseSample> poses, std::int64_t arrival_ns) override;
  bool end_stroke(std::int64_t arrival_ns) override { return source_.end_stroke(arrival_ns); }
  stream::PoseTotals totals() const override;
  protocol::Vec3 heel() const override { return {blade_.heel.x, blade_.heel.y, blade_.heel.z}; }
  protocol::Vec3 tip() const override { return {blade_.tip.x, blade_.tip.y, blade_.tip.z}; }

 private:
  input::PoseSource source_;
  const core::Blade blade_;
  const loop::LoopStats* const stats_;
};

// A simulator's positions, on their way from the wire to the slot that the loop reads. `open` is true while this lives.
// Thread: the stream's.
class StreamPositionsInput final : public stream::PositionsInput {
 public:
  StreamPositionsInput(input::PositionsSlot& slot, bool& open)
      : slot_(slot), open_(open), skipped_before_(slot.skipped()) {
    open_ = true;
  }
  ~StreamPositionsInput() override { open_ = false; }

  void offer(const protocol::Positions& positions, std::int64_t arrival_ns) override;
  std::uint64_t skipped() const override { return slot_.skipped() - skipped_before_; }

 private:
  input::PositionsSlot& slot_;
  bool& open_;
  const std::uint64_t skipped_before_;
};

// Connects what peers send to the pose sources, the positions' slot and the loop.
class StreamInput final : public stream::PeerInput {
 public:
  // All must outlive this. A source without a name is called protocol::kDefaultBladeName.
  StreamInput(input::PoseSources& sources, input::PositionsSlot& positions, const Config& config)
      : sources_(sources), positions_(positions), config_(config) {}
  // The loop that uses the poses, for its backlog and for resets; call before the first session.
  void join(loop::FrameLoop& loop) { loop_ = &loop; }
  // What can be undone; call before the first session. Null: nothing ever.
  void join(const loop::Checkpointer* checkpointer) { checkpointer_ = checkpointer; }

  std::unique_ptr<stream::PoseInput> open(std::string_view source_name,
                                          const std::optional<protocol::BladeEdge>& own_edge) override;
  std::unique_ptr<stream::PositionsInput> open_positions() override;
  bool is_held(std::string_view source_name) const override;
  std::vector<std::string> holders() const override;
  std::string undo(const stream::UndoRequest& request, const Answer& answer) override;
  bool reset(const Later& /*later*/) override { return loop_ && loop_->request_reset(); }
  // For the loop's thread, when an undo is done: who asked for it.
  std::shared_ptr<const protocol::Restart> undone() { return std::move(undone_); }

 private:
  input::PoseSources& sources_;
  input::PositionsSlot& positions_;
  bool positions_open_ = false;  // the stream thread's
  const Config& config_;
  loop::FrameLoop* loop_ = nullptr;
  const loop::Checkpointer* checkpointer_ = nullptr;
  std::shared_ptr<const protocol::Restart> undone_;  // the loop's thread
};

}  // namespace incise::app
