#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <deque>
#include <memory>

namespace incise::stream {

namespace asio = boost::asio;

class Session;
struct HubCounters;

// A share of one thread's time, for work of any length: after a piece of work that took t, the next may begin t / share
// later. What was not used for a while may be used at once, up to kSaved_ns of it.
class TimeShare {
 public:
  static constexpr std::int64_t kSaved_ns = 50'000'000;

  explicit TimeShare(double share) : share_(share) {}
  // When the next piece of work may begin.
  std::int64_t free_at_ns() const { return free_at_ns_; }
  // Work that took `cost_ns` has ended.
  void spend(std::int64_t cost_ns, std::int64_t now_ns);

 private:
  double share_;
  std::int64_t free_at_ns_ = 0;
};

// Sessions with a box of interest, in the order in which they asked for their deltas. Each such delta is made for one session
// alone, so all of them together get a share of the stream thread's time (StreamConfig::box_share) and the thread's other work
// goes on between any two. A session that waits gets all that happened meanwhile as one delta; when one has waited for longer
// than kMaxWait_ns, the costliest loses its box.
//
// Thread: the stream thread. Owns: the queue.
class BoxTurns {
 public:
  static constexpr std::int64_t kMaxWait_ns = 2'000'000'000;
  // A turn begins so long after it was asked for: by then what goes to sessions without a box is on its way.
  static constexpr std::int64_t kBehind_ns = 3'000'000;

  BoxTurns(asio::io_context& io, double share, HubCounters& counters)
      : io_(io), timer_(io), share_(share), counters_(counters) {}

  // Calls session->take_box_turn() when it is its turn, later.
  void ask(const std::shared_ptr<Session>& session);
  // Whether another box can be taken on.
  bool has_room();
  void cancel() { timer_.cancel(); }

 private:
  struct Waiting {
    std::weak_ptr<Session> session;
    std::int64_t since_ns;
  };
  void forget_gone();
  std::int64_t overdue_at_ns() const;
  void schedule();
  void serve();
  void refuse_costliest();

  asio::io_context& io_;
  asio::steady_timer timer_;
  TimeShare share_;
  HubCounters& counters_;
  std::deque<Waiting> queue_;
  bool scheduled_ = false;
  std::int64_t refused_ns_ = 0;  // when a session last lost its box
};

}  // namespace incise::stream
