#include "server/stream/simulator_positions.hpp"

#include <string>

namespace incise::stream {

using protocol::ErrorCode;

std::optional<Refusal> SimulatorPositions::offer(const protocol::Positions& positions, const Mirror& mirror,
                                                 PeerInput& input, std::int64_t arrival_ns) {
  const std::size_t count = (positions.f32.size() + positions.f64.size()) / 3;
  const std::uint64_t end = positions.ids.empty() ? std::uint64_t{positions.first} + count
                                                  : positions.ids.back() + std::uint64_t{1};
  const auto refused = [](const std::string& why) {
    return Refusal{ErrorCode::BadRequest, "Positions: " + why};
  };
  if (count == 0) return refused("of no vertex; accepted are one or more");
  if (end > mirror.volume().vertex_count()) {
    return refused("vertex " + std::to_string(end - 1) + " does not exist; the body has " +
                   std::to_string(mirror.volume().vertex_count()) + " vertices, the first is 0");
  }
  if (positions.revision > mirror.revision()) {
    return refused("computed for revision " + std::to_string(positions.revision) + "; the newest is " +
                   std::to_string(mirror.revision()));
  }
  if (!input_) input_ = input.open_positions();
  if (!input_)
    return Refusal{ErrorCode::NotAvailable, "Positions: another simulator sets them; stop that one first"};
  input_->offer(positions, arrival_ns);
  return std::nullopt;
}

std::optional<protocol::PositionsReport> SimulatorPositions::report(const PublishedDelta& step) {
  if (!input_) return std::nullopt;
  const core::Deformation& d = step.delta.deformation;
  protocol::PositionsReport report;
  report.frame = d.frame;
  report.revision = step.delta.revision;
  report.moved = d.moved;
  report.passed_over = d.passed_over;
  report.held = d.held;
  report.taken = ++taken_;
  report.skipped = input_->skipped();
  return report;
}

}  // namespace incise::stream
