#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "protocol/messages.hpp"
#include "server/replay/recorded_motion.hpp"

namespace incise::replay {

// The speeds that a viewer may ask for.
inline constexpr float kLeastSpeed = 0.05f, kMostSpeed = 1000;

// A recorded motion that cuts a mesh again, event by event. Thread: one, at a time. Owns: the session.
class Replay {
 public:
  // `fresh`: makes a session of the uncut mesh, with that configuration. `blades`: those of the first sources, where they differ from `cut.blade`.
  using Fresh = std::function<std::unique_ptr<core::CutSession>()>;
  Replay(Fresh fresh, const core::CutConfig& cut, std::vector<core::Blade> blades, RecordedMotion motion);
  // The same; `mesh` and its `fields` must outlive this.
  Replay(const core::MeshData& mesh, const core::CutConfig& cut, std::vector<core::Blade> blades,
         RecordedMotion motion, std::span<const core::Field> fields = {});

  // Back to the uncut mesh.
  void restart();
  // Commits a batch that waits, into `delta`, or applies the next event. Whether a batch was committed.
  bool advance(core::Delta& delta);

  const core::CutSession& session() const { return *session_; }
  const RecordedMotion& motion() const { return motion_; }
  std::uint64_t revision() const { return session_->revision(); }
  std::uint64_t last_revision() const { return last_revision_; }
  bool at_end() const { return next_ == motion_.events.size() && session_->backlog_batches() == 0; }
  // When the next event arrived, on the recording's clock with long silences left out; ns.
  std::int64_t due_ns() const {
    return next_ < motion_.events.size() ? clock_ns_ + pause_ns(next_) : clock_ns_;
  }
  std::int64_t clock_ns() const { return clock_ns_; }
  // Writes revision_ms, revision_sources and revision_strokes, of the revisions that the recording marks. O(events).
  void describe(protocol::ReplayState& state) const;

 private:
  std::int64_t pause_ns(std::size_t event) const;

  Fresh fresh_;
  core::CutConfig cut_;
  std::vector<core::Blade> blades_;
  RecordedMotion motion_;
  std::unique_ptr<core::CutSession> session_;
  std::size_t next_ = 0;
  std::int64_t clock_ns_ = 0;
  std::uint64_t last_revision_ = 0;
};

}  // namespace incise::replay
