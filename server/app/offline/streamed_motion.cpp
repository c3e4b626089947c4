#include "server/app/offline/streamed_motion.hpp"

#include <cstdint>
#include <istream>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "client/cli/usage.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/base/wording.hpp"
#include "server/replay/recorded_motion.hpp"

namespace incise::app {
namespace {

using client::StreamCommand;
using replay::MotionEvent;
using PosesOfSources = std::map<std::uint32_t, std::size_t>;

// "source 1 (200 poses), source 2 (1 pose)"
std::string listed(const PosesOfSources& sources) {
  std::string text;
  for (const auto& [source, poses] : sources) {
    text += (text.empty() ? "source " : ", source ") + std::to_string(source) + " (" +
            counted(poses, "pose", "poses") + ")";
  }
  return text;
}

// The source that is sent. What is not sent is named, unless the user has chosen.
std::uint32_t choose_source(const StreamCommand& command, const replay::RecordedMotion& motion) {
  const std::string name = command.poses.string();
  std::optional<std::uint32_t> first;
  PosesOfSources sources;
  for (const MotionEvent& event : motion.events) {
    if (event.kind != MotionEvent::Kind::kPose) continue;
    if (!first) first = event.source;
    ++sources[event.source];
  }
  if (!first) throw std::runtime_error(name + ": there is no pose in it");
  if (command.from_source) {
    if (sources.contains(*command.from_source)) return *command.from_source;
    throw std::runtime_error("--from-source: found " + std::to_string(*command.from_source) + "; " + name +
                             " has poses of " + listed(sources));
  }
  sources.erase(*first);
  if (!sources.empty()) {
    print_warnings({name + ": sends the poses of source " + std::to_string(*first) + ", not those of " +
                    listed(sources) + "; --from-source N sends those of source N"});
  }
  return *first;
}

protocol::PoseSample sample_of(const core::Pose& pose) {
  const core::Vec3& p = pose.position;
  const core::Quat& q = pose.orientation;
  return {pose.t_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, pose.buttons};
}

protocol::Motion read_capture_of(std::istream& in, const StreamCommand& command, protocol::Times times) {
  const std::string name = command.poses.string();
  const replay::RecordedMotion recorded =
      replay::read_capture(in, name, nullptr, replay::IfDamaged::kEndThere);
  print_warnings(recorded.warnings);
  const std::uint32_t source = choose_source(command, recorded);
  protocol::RisingSamples samples(name, times);
  for (const MotionEvent& event : recorded.events) {
    if (event.source != source) continue;
    if (event.kind == MotionEvent::Kind::kPose) {
      samples.add(sample_of(event.pose));
    } else if (event.kind != MotionEvent::Kind::kDeform) {
      samples.begin_clock();  // a stroke's end, or another holder, whose clock may have another origin
    }
  }
  protocol::Motion motion;
  motion.has_buttons = true;
  samples.finish(motion);
  return motion;
}

}  // namespace

protocol::Motion read_streamed_motion(const StreamCommand& command) {
  const std::string name = command.poses.string();
  const protocol::Times times = command.strict ? protocol::Times::kRefuse : protocol::Times::kSkip;
  const std::unique_ptr<std::istream> in = protocol::open_motion(name);
  const bool capture = replay::begins_as_capture(*in, name);
  if (!capture && command.from_source)
    throw client::UsageError("--from-source: " + name + " is no capture; its poses have one source");
  protocol::Motion motion =
      capture ? read_capture_of(*in, command, times) : protocol::read_motion(*in, name, times);
  if (!motion.warning.empty()) print_warnings({motion.warning});
  if (motion.samples.empty()) throw std::runtime_error(name + ": there is no pose in it");
  return motion;
}

}  // namespace incise::app
