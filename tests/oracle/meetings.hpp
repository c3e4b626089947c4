#pragma once

#include <cstdint>
#include <memory>
#include <random>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "tests/oracle/judge.hpp"

// Random cuts that meet: loops that close, strokes that cross, end in an older cut or begin in one.
namespace incise::oracle {

// What the names say; of those with a gap or an overlap it is -0.25, 0, 0.5 or 2 h.
inline constexpr std::string_view kMeetingKinds[] = {
    "circle",   // closed, by a blade that reaches through the body
    "ellipse",  //
    "polygon",  // three to six corners
    "lasso",    // in from outside, around, and across its own way in
    "spiral",   // one turn and a quarter inwards, then straight out across the first turn
    "plunge",   // plunge, circle, withdraw
    "cone",     // the blade's tip stays, its heel goes around
    "nested",   // two circles around one another
    "grid",     // two or three strokes across two or three
    "square",   // four strokes that overshoot their corners
    "halves",   // two half circles
    "ends_in",  // a stroke that ends at an older cut
    "starts_in",
    "along",    // over an older cut again, up to 0.2 h off it
    "crosses",  // two strokes at any angle
    "lid",      // a slit that ends in the body, and a circle down to it
    "box",      // four strokes that end in the body, and a slit under them
    "rows",  // one stroke, to and fro through the body, by a short blade: each row below the one before, which it overlaps by 0 to 0.5 h
    "strips",  // the same, each row a stroke
    "helix",   // one stroke by a short blade, around and down through the body
};

struct Meeting {
  std::string kind;
  std::uint64_t seed = 0;
  double overlap_h = 0;
  double step_h = 0;        // between poses
  double batch_h = 0;       // CutConfig's
  bool along_axes = false;  // as random_meeting() was asked for
  core::Blade blade;
  std::vector<std::vector<core::Pose>> strokes;  // source times rise throughout

  std::string name() const;
};

// Depends on what it is given alone. `along_axes`: blades and strokes lie along the body's axes, in the planes of some of its
// vertices, as they do in a first script.
Meeting random_meeting(const core::MeshData& mesh, double h, std::string_view kind, std::uint64_t seed,
                       bool along_axes = false);

// A configuration whose stroke rules nothing runs into.
core::CutConfig meeting_config(const Meeting& meeting);
// Works until nothing waits, so much at a time.
void drain(core::CutSession& session, std::int64_t budget_units = INT64_MAX);
// Cuts with poses of source 0, then ends their stroke, so much work at a time.
void cut(std::span<const core::Pose> stroke, core::CutSession& session,
         std::int64_t budget_units = INT64_MAX);
// Cuts it, stroke by stroke, into a session that has meeting_config(), so much work at a time.
void cut(const Meeting& meeting, core::CutSession& session, std::int64_t budget_units = INT64_MAX);
// The same with as many strokes at once as there can be blades, pose by pose in turn, each by a blade of its own.
void cut_at_once(const Meeting& meeting, core::CutSession& session, std::int64_t budget_units = INT64_MAX);
// The same with each stroke in a session of its own, which begins with the body as the one before has left it.
std::unique_ptr<core::CutSession> cut_saved(const Meeting& meeting, const core::MeshData& mesh);
// What the judge is told.
std::vector<Stroke> strokes_of(const Meeting& meeting);

// The pose at which a blade from the origin along z has its heel there and points along `direction`.
core::Pose pose_along(const Vec3& heel, const Vec3& direction);

// Whole random numbers as parts of 1, the same with every library.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double uniform(double from, double to) {
    return from + (to - from) * static_cast<double>(engine_() >> 11) * 0x1p-53;
  }
  std::size_t below(std::size_t n) { return engine_() % n; }
  Vec3 direction();
  template <class T, std::size_t N>
  T one_of(const T (&list)[N]) {
    return list[below(N)];
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace incise::oracle
