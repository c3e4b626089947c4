#pragma once

// What the tests of the frame loop share: a loop with all that it needs, and what it should come to.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "server/base/clock.hpp"
#include "server/loop/frame_loop.hpp"
#include "tests/support/bodies.hpp"

namespace incise::loop {

inline core::CutConfig config(core::Policy policy) {
  core::CutConfig made;
  made.policy = policy;
  made.blade = tests::long_blade();
  return made;
}

inline std::vector<input::TimedPose> timed(const std::vector<core::Pose>& poses) {
  std::vector<input::TimedPose> made;
  for (const core::Pose& pose : poses) made.push_back({pose, monotonic_ns()});
  return made;
}

// The hash of each revision.
using Hashes = std::map<std::uint64_t, std::uint64_t>;

inline Hashes without_loop(core::Policy policy, const core::MeshData& mesh,
                           const std::vector<core::Pose>& poses) {
  core::CutSession session(mesh, config(policy));
  Hashes hashes;
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  for (const core::Pose& pose : poses) session.push(0, pose);
  session.end_stroke(0);
  while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    hashes[delta.revision] = delta.state_hash;
  }
  return hashes;
}

// Reads nothing until it is asked to.
struct Kept : DeltaSink {
  void publish(std::shared_ptr<const PublishedDelta> delta) noexcept override {
    deltas.push_back(std::move(delta));
  }
  std::vector<std::shared_ptr<const PublishedDelta>> deltas;
};

// A loop with all that it needs.
struct Rig {
  Rig(core::Policy policy, const core::MeshData& mesh, const LoopOptions& options = {},
      std::size_t queue_capacity = 8192)
      : session(mesh, config(policy)),
        sources(tests::long_blade(), {}, queue_capacity),
        loop(session, sources, kept, nullptr, options) {}

  void read() {
    for (const auto& lease : kept.deltas) {
      hashes[lease->delta.revision] = lease->delta.state_hash;
      cut_faces += lease->delta.cut_faces;
      EXPECT_LE(lease->arrival_ns, lease->drain_ns);
      EXPECT_LE(lease->drain_ns, lease->cut_ns);
      EXPECT_EQ(lease->delta.revision, ++revision);
    }
    kept.deltas.clear();
  }

  core::CutSession session;
  input::PoseSources sources;
  Kept kept;
  FrameLoop loop;
  Hashes hashes;
  std::uint64_t revision = 0, cut_faces = 0;
};

// Keeps what a journal writes.
class Memory : public JournalSink {
 public:
  explicit Memory(std::vector<JournalRecord>& records) : records_(records) {}
  void write(const JournalRecord& record) override { records_.push_back(record); }
  void flush() override {}
  void sync() override {}
  void close() override {}

 private:
  std::vector<JournalRecord>& records_;
};

// A tip that presses on the top of a cube, at first until there is a force.
class Pressing {
 public:
  explicit Pressing(const LoopOptions& options)
      : session_(tests::cube(2), with_tip()),
        sources_(with_tip().blade),
        loop_(session_, sources_, kept_, nullptr, options),
        source_(sources_.open("blade")) {
    loop_.offer_forces({}, std::make_unique<haptics::Tissue>(tests::cube(2)), &sink_, nullptr);
  }
  // A pose, and the frame for it, whose deadline lies `ahead_ns` after now.
  void press(std::int64_t ahead_ns = 0) {
    input::TimedPose timed;
    timed.pose.t_ns = 1 + std::int64_t{++poses_} * 1'000'000;
    timed.pose.position = {0.05 + 1e-6 * poses_, 0.05, std::max(0.151 - 5e-5 * poses_, 0.148)};
    timed.arrival_ns = monotonic_ns();
    source_->enqueue(std::span(&timed, 1));
    loop_.frame(monotonic_ns() + ahead_ns);
  }
  const haptics::BladeForce& felt() const { return sink_.last; }

 private:
  static core::CutConfig with_tip() {
    core::CutConfig made = config(core::Policy::kConforming);
    made.blade = {{0, 0, 0}, {0, 0, -0.05}};
    return made;
  }
  struct Sink : haptics::ForceSink {
    void feel(const haptics::BladeForce& force) noexcept override { last = force; }
    haptics::BladeForce last;
  };
  core::CutSession session_;
  input::PoseSources sources_;
  Kept kept_;
  Sink sink_;
  FrameLoop loop_;
  std::optional<input::PoseSource> source_;
  int poses_ = 0;
};

// On a loaded machine frames hang by themselves, and then there is no force: it is tried again. Null: there was never one.
inline std::unique_ptr<Pressing> press_until_felt(const LoopOptions& options = {},
                                                  std::int64_t ahead_ns = 0) {
  for (int attempt = 0; attempt < 1000; ++attempt) {
    auto pressing = std::make_unique<Pressing>(options);
    for (int frame = 0; frame < 100; ++frame) {
      pressing->press(ahead_ns);
      if (pressing->felt().newtons.z != 0) return pressing;
    }
  }
  return nullptr;
}

}  // namespace incise::loop
