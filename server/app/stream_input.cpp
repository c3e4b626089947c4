#include "server/app/stream_input.hpp"

#include <algorithm>
#include <array>

#include "protocol/blade_name.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/base/wording.hpp"
#include "server/stream/quoted.hpp"

namespace incise::app {
namespace {

input::TimedPose timed_pose(const protocol::PoseSample& sample, std::int64_t arrival_ns) {
  const protocol::Vec3& p = sample.position;
  const protocol::Quat& q = sample.orientation;
  return {{sample.source_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, sample.buttons}, arrival_ns};
}

template <class Number>
void fill(core::VertexPositions& buffer, std::span<const Number> numbers) {
  buffer.positions.resize(numbers.size() / 3);
  for (std::size_t i = 0; i < buffer.positions.size(); ++i)
    buffer.positions[i] = {numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]};
}

std::string_view name_or_default(std::string_view source_name) {
  return source_name.empty() ? protocol::kDefaultBladeName : source_name;
}

// blade "a"; blades "a" and "b".
std::string blades(const std::vector<std::string>& names) {
  std::string text = names.size() == 1 ? "blade " : "blades ";
  for (std::size_t i = 0; i < names.size(); ++i)
    text += (i == 0 ? "" : i + 1 < names.size() ? ", " : " and ") + stream::quoted(names[i]);
  return text;
}

std::string why_not(const loop::UndoAnswer& answer, std::optional<std::uint32_t> asker,
                    const std::string& silence) {
  const std::string until = "it is lifted, or has sent no pose for " + silence + " s";
  switch (answer.end) {
    case loop::UndoEnd::kInStroke:
      if (answer.source == asker)
        return "your blade was in its stroke all the time, so nothing was undone: end the stroke (buttons "
               "up, "
               "or StrokeControl End) and ask again";
      return blades(answer.blades) + (asker ? " is in a stroke" : " was in its stroke all the time") +
             ", so nothing was undone: ask again when " + until;
    case loop::UndoEnd::kBehind:
      return "the server was behind with its cuts all the time, so nothing was undone: ask again when they "
             "are done";
    case loop::UndoEnd::kReset:
      return "the mesh was reset first: there is no stroke to undo";
    case loop::UndoEnd::kBegun:
      return "a stroke has begun since, of " + blades(answer.blades) +
             ", so nothing was undone: ask again when no blade cuts, and begin the next stroke when it is "
             "done";
    case loop::UndoEnd::kNoStroke:
      if (answer.was_reset)
        return "there is no stroke to undo: the mesh was reset, and what was cut before that is gone for "
               "good";
      return "there is no stroke to undo: only those since the server's start can be undone, as far back as "
             "it keeps states";
    case loop::UndoEnd::kOtherBlade:
      return "the last stroke is that of " + blades(answer.blades) +
             ", and your blade has none to undo: its operator or an admin may undo it";
    case loop::UndoEnd::kOtherCut:
      return blades(answer.blades) + (answer.blades.size() == 1 ? " has" : " have") +
             " cut since your last stroke began, and that would be undone, too: ask for both with "
             "Undo.others "
             "(on the page: Shift and a click on Undo), or leave it";
    case loop::UndoEnd::kDone:
      break;
  }
  return "";
}

}  // namespace

std::size_t StreamPoseInput::enqueue(std::span<const protocol::PoseSample> poses, std::int64_t arrival_ns) {
  std::array<input::TimedPose, 256> chunk;
  std::size_t queued = 0;
  while (queued < poses.size()) {
    const std::size_t count = std::min(chunk.size(), poses.size() - queued);
    for (std::size_t i = 0; i < count; ++i) chunk[i] = timed_pose(poses[queued + i], arrival_ns);
    const std::size_t fitted = source_.enqueue(std::span(chunk).first(count));
    queued += fitted;
    if (fitted < count) break;
  }
  return queued;
}

stream::PoseTotals StreamPoseInput::totals() const {
  using core::PoseVerdict;
  const input::SourceCounts counts = source_.counts();
  stream::PoseTotals totals;
  totals.too_fast = counts.count(PoseVerdict::kNewStroke);
  totals.accepted = counts.count(PoseVerdict::kAccepted) + totals.too_fast;
  totals.not_finite = counts.count(PoseVerdict::kNotFinite);
  totals.not_unit = counts.count(PoseVerdict::kNotUnit);
  totals.time_not_rising = counts.count(PoseVerdict::kTimeNotIncreasing);
  totals.last_source_ns = counts.last_source_ns;
  totals.recorded = counts.recorded;
  totals.recorded_source_ns = counts.recorded_source_ns;
  if (stats_) totals.backlog_segments = static_cast<std::uint32_t>(stats_->state.load().backlog_segments);
  return totals;
}

void StreamPositionsInput::offer(const protocol::Positions& positions, std::int64_t arrival_ns) {
  const auto buffer = slot_.buffer();
  if (!buffer) return;
  buffer->frame = positions.frame;
  buffer->revision = positions.revision;
  buffer->source_ns = positions.source_ns;
  buffer->arrival_ns = arrival_ns;
  buffer->ids.assign(positions.ids.begin(), positions.ids.end());
  buffer->first = positions.first;
  buffer->single = positions.f64.empty();
  if (buffer->single) {
    fill(*buffer, positions.f32);
  } else {
    fill(*buffer, positions.f64);
  }
  slot_.offer(buffer);
}

std::unique_ptr<stream::PoseInput> StreamInput::open(std::string_view source_name,
                                                     const std::optional<protocol::BladeEdge>& own_edge) {
  std::optional<core::Blade> own;
  if (own_edge) own = replay::to_core(*own_edge);
  auto source = sources_.open(name_or_default(source_name), own);
  if (!source) return nullptr;
  const core::Blade blade = own ? *own : blade_of(config_, source->number());
  return std::make_unique<StreamPoseInput>(std::move(*source), blade, loop_ ? &loop_->stats() : nullptr);
}

bool StreamInput::is_held(std::string_view source_name) const {
  return sources_.is_held(name_or_default(source_name));
}

std::vector<std::string> StreamInput::holders() const {
  std::vector<std::string> names;
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    if (sources_.tally(source).open) names.push_back(sources_.name_of(source));
  return names;
}

std::string StreamInput::undo(const stream::UndoRequest& request, const Answer& answer) {
  if (!loop_ || !checkpointer_)
    return "this server does not offer it: capture.path or capture.checkpoint_replay_s is off";
  if (!checkpointer_->following()) return "the server has lost the way back; a Reset makes it possible again";
  loop::UndoWish wish{request.source, nullptr, request.others};
  if (request.source) wish.name = std::make_shared<const std::string>(sources_.name_of(*request.source));
  const bool waits = loop_->request_undo(std::move(wish), [this, request,
                                                           answer](const loop::UndoAnswer& end) {
    if (end.end == loop::UndoEnd::kDone) {
      const auto role = request.source ? protocol::Role::Operator : protocol::Role::Admin;
      std::vector<std::string> others(end.blades.begin() + 1, end.blades.end());
      others.resize(std::min<std::size_t>(others.size(), protocol::kMaxFields));
      undone_ = std::make_shared<const protocol::Restart>(protocol::Restart{
          protocol::RestartKind::Undo, role, request.by, end.source, end.blades.front(), std::move(others)});
      answer(std::nullopt);
    } else {
      answer(stream::Refusal{protocol::ErrorCode::NotAvailable,
                             "Undo: " + why_not(end, request.source, short_number(config_.cut.gap_limit_s))});
    }
  });
  return waits ? "" : "too many wait already: ask again when these are done";
}

std::unique_ptr<stream::PositionsInput> StreamInput::open_positions() {
  return positions_open_ ? nullptr : std::make_unique<StreamPositionsInput>(positions_, positions_open_);
}

}  // namespace incise::app
