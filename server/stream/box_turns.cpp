#include "server/stream/box_turns.hpp"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <chrono>
#include <ctime>

#include "server/base/clock.hpp"
#include "server/stream/hub.hpp"
#include "server/stream/session.hpp"

namespace incise::stream {

void TimeShare::spend(std::int64_t cost_ns, std::int64_t now_ns) {
  free_at_ns_ = std::max(free_at_ns_, now_ns - kSaved_ns) +
                static_cast<std::int64_t>(static_cast<double>(cost_ns) / share_);
}

void BoxTurns::ask(const std::shared_ptr<Session>& session) {
  queue_.push_back({session, monotonic_ns()});
  schedule();
}

// Those that no longer want their turn are no reason to wait.
void BoxTurns::forget_gone() {
  while (!queue_.empty()) {
    const auto session = queue_.front().session.lock();
    if (session && session->wants_box_turn()) return;
    if (session) session->skip_box_turn();
    queue_.pop_front();
  }
}

bool BoxTurns::has_room() {
  forget_gone();
  return queue_.empty() || monotonic_ns() - queue_.front().since_ns < kMaxWait_ns / 2;
}

// When one has waited too long, and as long since the last one lost its box.
std::int64_t BoxTurns::overdue_at_ns() const {
  return std::max(queue_.front().since_ns, refused_ns_) + kMaxWait_ns;
}

// One turn at a time, each behind whatever the thread has to do by then: messages are read and deltas go out in between.
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
    const auto session = queue_.front().session.lock();
    queue_.pop_front();
    const std::int64_t before = clock_ns(CLOCK_THREAD_CPUTIME_ID);
    if (session && session->take_box_turn()) {
      const std::int64_t cost = clock_ns(CLOCK_THREAD_CPUTIME_ID) - before;
      session->set_box_cost(cost);
      share_.spend(cost, monotonic_ns());
      ++counters_.box_turns;
      counters_.box_turns_ns += static_cast<std::uint64_t>(cost);
    }
  }
  schedule();
}

void BoxTurns::refuse_costliest() {
  std::shared_ptr<Session> costliest;
  for (const Waiting& waiting : queue_) {
    const auto session = waiting.session.lock();
    if (session && session->wants_box_turn() &&
        (!costliest || session->box_cost_ns() >= costliest->box_cost_ns())) {
      costliest = session;
    }
  }
  if (costliest) costliest->lose_box();
}

}  // namespace incise::stream
