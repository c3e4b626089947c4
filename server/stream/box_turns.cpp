#include "server/stream/box_turns.hpp"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <chrono>
#include <ctime>

#include "server/base/clock.hpp"
#include "server/stream/counters.hpp"

namespace incise::stream {

void TimeShare::spend(std::int64_t cost_ns, std::int64_t now_ns) {
  free_at_ns_ = std::max(free_at_ns_, now_ns - kSaved_ns) +
                static_cast<std::int64_t>(static_cast<double>(cost_ns) / share_);
}

void BoxTurns::ask(const std::shared_ptr<BoxHolder>& holder) {
  queue_.push_back({holder, monotonic_ns()});
  schedule();
}

// Those that no longer want a turn must not hold up the rest.
void BoxTurns::forget_gone() {
  while (!queue_.empty()) {
    const auto holder = queue_.front().holder.lock();
    if (holder && holder->wants_box_turn()) return;
    if (holder) holder->skip_box_turn();
    queue_.pop_front();
  }
}

bool BoxTurns::has_room() {
  forget_gone();
  return queue_.empty() || monotonic_ns() - queue_.front().since_ns < kMaxWait_ns / 2;
}

// kMaxWait_ns after the first one asked, and as long after a peer last lost its box.
std::int64_t BoxTurns::overdue_at_ns() const {
  return std::max(queue_.front().since_ns, refused_ns_) + kMaxWait_ns;
}

// One turn at a time, each behind what the thread has to do by then: it reads messages and sends deltas in between.
void BoxTurns::schedule() {
  if (!scheduled_) forget_gone();
  if (scheduled_ || queue_.empty()) return;
  scheduled_ = true;
  const std::int64_t now = monotonic_ns();
  const std::int64_t at =
      std::min(std::max(share_.free_at_ns(), queue_.front().since_ns + kBehind_ns), overdue_at_ns());
  if (at <= now) {
    asio::post(io_, [this] { serve(); });
    return;
  }
  timer_.expires_after(std::chrono::nanoseconds(at - now));
  timer_.async_wait([this](boost::system::error_code error) {
    if (!error) serve();
  });
}

void BoxTurns::serve() {
  scheduled_ = false;
  forget_gone();
  if (queue_.empty()) return;
  const std::int64_t now = monotonic_ns();
  if (now >= overdue_at_ns()) {
    refused_ns_ = now;
    refuse_costliest();
  } else if (now >= std::max(share_.free_at_ns(), queue_.front().since_ns + kBehind_ns)) {
    const auto holder = queue_.front().holder.lock();
    queue_.pop_front();
    const std::int64_t before = clock_ns(CLOCK_THREAD_CPUTIME_ID);
    if (holder && holder->make_box_delta()) {
      const std::int64_t cost = clock_ns(CLOCK_THREAD_CPUTIME_ID) - before;
      holder->last_turn_ns_ = cost;
      share_.spend(cost, monotonic_ns());
      ++counters_.box_turns;
      counters_.box_turns_ns += static_cast<std::uint64_t>(cost);
    }
  }
  schedule();
}

void BoxTurns::refuse_costliest() {
  std::shared_ptr<BoxHolder> costliest;
  for (const Waiting& waiting : queue_) {
    const auto holder = waiting.holder.lock();
    if (holder && holder->wants_box_turn() &&
        (!costliest || holder->last_turn_ns_ >= costliest->last_turn_ns_)) {
      costliest = holder;
    }
  }
  if (costliest) costliest->lose_box();
}

}  // namespace incise::stream
