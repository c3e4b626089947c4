#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "server/app/config.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {

// How a recorded motion cuts a mesh without a server: `incise cut` and `incise convert` do it in the same way and warn of
// the same things.

struct Box {
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  void add(const core::Vec3& p) { core::extend(p, low, high); }
  double diagonal() const { return low.x > high.x ? 0 : core::distance(low, high); }
  std::string text() const;
};
Box box_of(const core::MeshData& mesh);

// Holds the button that engages the blade in each pose of a motion without buttons, as `incise stream` does: nothing would
// be cut otherwise.
void hold_button(RecordedMotion& motion, const Config& config);

// Raises the limits beyond which a step counts as a jump where they do not suit a text motion, whose rate and units
// nobody has stated: where more than a tenth of its steps would be jumps. A limit becomes a multiple of what is usual in
// the motion. One that the configuration sets to something else than the default stays, and those of a capture stay.
// Returns what was raised, as a sentence without its end; empty where nothing was.
std::string suit_limits(Config& config, const RecordedMotion& motion, double body_size_m);

// Does to a session what a motion says.
class MotionRun {
 public:
  // All must outlive this. `name` is the motion's in warnings.
  MotionRun(core::CutSession& session, const RecordedMotion& motion, const Config& config, std::string name)
      : session_(session), motion_(motion), config_(config), name_(std::move(name)) {}

  struct Options {
    bool deformations = true;  // false: they are passed over, being of another mesh's vertices
    std::function<void(const MotionEvent&)> event;              // the session has taken it
    std::function<void(const core::Delta&, double us)> commit;  // a batch, and how long it took
  };
  // Every event, then the end of each stroke that is open, each followed by all that it calls for.
  void run(const Options& options, Progress& progress);

  std::uint64_t poses_taken() const { return count(core::PoseVerdict::kAccepted) + jumps(); }
  // Poses refused, jumps, poses that look like millimetres; and, where `cut_faces` is 0, why nothing was cut.
  std::vector<std::string> warnings(std::uint32_t cut_faces, const Box& body) const;

 private:
  void handle(const MotionEvent& event, const Options& options);
  void commit_all(const Options& options);
  std::uint64_t count(core::PoseVerdict verdict) const {
    return verdicts_[static_cast<std::size_t>(verdict)];
  }
  std::uint64_t jumps() const { return count(core::PoseVerdict::kNewStroke); }
  std::string why_nothing_was_cut(const Box& body) const;
  std::string units_hint(bool nothing_was_cut, const Box& body) const;

  core::CutSession& session_;
  const RecordedMotion& motion_;
  const Config& config_;
  const std::string name_;
  core::Delta delta_;
  std::array<std::uint64_t, core::kPoseVerdicts> verdicts_{};
  std::uint64_t batches_ = 0;
  bool engaged_ = false;  // some pose was
  Box tool_, swept_;      // of the poses' positions; of the blade's lines in all batches
};

}  // namespace incise::app
