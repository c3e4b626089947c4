#include "server/stream/operator_blade.hpp"

#include <span>
#include <utility>
#include <vector>

#include "server/stream/pause.hpp"

namespace incise::stream {
namespace {

// Times of poses change with every pose, which `accepted` tells, too.
bool same(const protocol::PoseReport& a, const protocol::PoseReport& b) {
  return a.through_sequence == b.through_sequence && a.accepted == b.accepted &&
         a.not_finite == b.not_finite && a.not_unit == b.not_unit && a.time_not_rising == b.time_not_rising &&
         a.queue_full == b.queue_full && a.backlog_segments == b.backlog_segments &&
         a.recorded == b.recorded && a.recording == b.recording;
}

}  // namespace

void OperatorBlade::hold(std::unique_ptr<PoseInput> input, std::string source_name) {
  input_ = std::move(input);
  source_name_ = std::move(source_name);
}

asio::awaitable<void> OperatorBlade::enqueue(const protocol::PoseBatch& batch, std::uint64_t sequence,
                                             std::int64_t arrival_ns, int engage_button) {
  std::span<const protocol::PoseSample> poses = batch.poses;
  std::vector<protocol::PoseSample> engaged;  // with the button that Engage stands for
  if (engaged_ && engage_button >= 0) {
    engaged.assign(poses.begin(), poses.end());
    for (protocol::PoseSample& pose : engaged) pose.buttons |= 1u << engage_button;
    poses = engaged;
  }
  while (!poses.empty() && input_) {
    poses = poses.subspan(input_->enqueue(poses, arrival_ns));
    if (!poses.empty()) co_await pause(kQueueRetry);
  }
  offered_ += batch.poses.size();
  unsettled_.push_back({sequence, offered_});
}

asio::awaitable<void> OperatorBlade::end_stroke(std::int64_t arrival_ns) {
  engaged_ = false;
  while (input_ && !input_->end_stroke(arrival_ns)) co_await pause(kQueueRetry);
}

std::optional<protocol::PoseReport> OperatorBlade::next_report(protocol::Recording recording) {
  const PoseTotals totals = input_->totals();
  while (!unsettled_.empty() && unsettled_.front().offered <= totals.settled()) {
    through_sequence_ = unsettled_.front().sequence;
    unsettled_.pop_front();
  }
  protocol::PoseReport report;
  report.through_sequence = through_sequence_;
  report.accepted = totals.accepted;
  report.not_finite = totals.not_finite;
  report.not_unit = totals.not_unit;
  report.time_not_rising = totals.time_not_rising;
  report.queue_full = totals.queue_full;
  report.too_fast = totals.too_fast;
  report.last_source_ns = totals.last_source_ns;
  report.backlog_segments = totals.backlog_segments;
  report.recorded = totals.recorded;
  report.recorded_source_ns = totals.recorded_source_ns;
  report.recording = recording;
  if (same(report, last_report_)) return std::nullopt;
  last_report_ = report;
  return report;
}

}  // namespace incise::stream
