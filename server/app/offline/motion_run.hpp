#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "server/app/config.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {

// A pose's verdict for people; core::to_string() has the names that programs read in /stats and metrics.
std::string explained(core::PoseVerdict verdict);

// Cutting a mesh by a recorded motion, without a server: common to `incise cut`, `incise feel` and `incise convert`, with the same
// warnings.

struct Box {
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  void add(const core::Vec3& p) { core::extend(p, low, high); }
  bool meets(const Box& other) const {
    return low.x <= other.high.x && other.low.x <= high.x && low.y <= other.high.y && other.low.y <= high.y &&
           low.z <= other.high.z && other.low.z <= high.z;
  }
  double diagonal() const { return low.x > high.x ? 0 : core::distance(low, high); }
  std::string text() const;
};
Box box_of(const core::MeshData& mesh);
Box box_of(const core::TetMesh& mesh);  // as it is now: cut and deformed

// Sets the button that engages the blade in each pose of a motion without buttons, as `incise stream` does: otherwise
// nothing would be cut.
void hold_button(RecordedMotion& motion, const Config& config);

// Raises the limits beyond which a step counts as a jump, if more than a tenth of a text motion's steps would be jumps: its
// rate and units are unknown. A limit becomes a multiple of the motion's usual step. Limits that the configuration sets, and
// those of a capture, stay.
// Returns what was raised, for messages; empty: nothing.
std::string suit_limits(Config& config, const RecordedMotion& motion, double body_size_m);

// What is wrong with a blade that is more than 100 times as long as the body, to follow its name; empty: nothing.
std::string blade_fault(const core::Blade& blade, const Config& config, double body_size_m);
// With the longest one of a motion.
std::string blade_fault(const Config& config, const RecordedMotion& motion, double body_size_m);
// Throws std::runtime_error if there is such a fault.
void check_blade(const Config& config, const RecordedMotion& motion, double body_size_m);

// Applies a motion to a session.
class MotionRun {
 public:
  // All must outlive this. `name` is the motion in warnings.
  MotionRun(core::CutSession& session, const RecordedMotion& motion, const Config& config, std::string name)
      : session_(session),
        motion_(motion),
        config_(config),
        name_(std::move(name)),
        h_m_(session.mesh().mean_edge_length()) {}

  struct Options {
    bool deformations = true;  // false: skip them, because they name another mesh's vertices
    // Whether tissue holds the blade of this pose back, so that it does not cut though its button is held.
    std::function<bool(const MotionEvent&)> holds_back = {};
    // The session has handled it; `verdict` is a pose's.
    std::function<void(const MotionEvent&, core::PoseVerdict verdict)> event;
    std::function<void(const core::Delta&, double us)> commit;  // a batch, and how long it took
  };
  // Applies every event, then ends the open strokes; commits all batches after each.
  void run(const Options& options, Progress& progress);

  std::uint64_t poses_taken() const { return count(core::PoseVerdict::kAccepted) + jumps(); }
  // Poses rejected, jumps, positions left out, poses that look like millimetres; and, if `cut_faces` is 0, why nothing was cut. `body`: its
  // size as loaded.
  std::vector<std::string> warnings(std::uint32_t cut_faces, const Box& body) const;
  // What the blade swept in all batches. After run().
  const core::SweptSurface& swept() const { return swept_; }
  // Of these, poses rejected, jumps and positions left out.
  std::vector<std::string> pose_warnings() const;
  // That poses look like millimetres, or the mesh like those or centimetres; else empty. `nothing_met`: the blade met nothing.
  std::string units_hint(bool nothing_met, const Box& body) const;

 private:
  void handle(const MotionEvent& event, const Options& options);
  void commit_all(const Options& options);
  std::uint64_t count(core::PoseVerdict verdict) const {
    return verdicts_[static_cast<std::size_t>(verdict)];
  }
  std::uint64_t jumps() const { return count(core::PoseVerdict::kNewStroke); }
  std::string why_nothing_was_cut() const;
  bool met_the_body() const;

  core::CutSession& session_;
  const RecordedMotion& motion_;
  const Config& config_;
  const std::string name_;
  const double h_m_;  // before any cut
  core::Delta delta_;
  std::array<std::uint64_t, core::kPoseVerdicts> verdicts_{};
  std::uint64_t batches_ = 0, left_out_ = 0;  // left_out_: a simulation's steps
  bool engaged_ = false;                      // some pose was
  Box tool_, lines_;                          // of the poses' positions; of the blade's lines in all batches
  core::SweptSurface swept_;
  bool crossed_an_edge_ = false;
  bool changed_ = false;  // the mesh, in some batch
};

}  // namespace incise::app
