#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <deque>
#include <memory>

namespace incise::stream {

namespace asio = boost::asio;

struct SharedCounters;

// A share of one thread's time, for work of any length: after work that took t, the next may begin t / share later.
// Time that was not used is saved, up to kSaved_ns, and may be used at once.
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

// A peer with a box of interest, as BoxTurns sees it.
//
// Thread: the stream thread.
class BoxHolder {
 public:
  // Whether there is still a delta of its box to make.
  virtual bool wants_box_turn() const = 0;
  // There is none: it may ask again.
  virtual void skip_box_turn() = 0;
  // Makes and sends that delta. False where it can no longer be made.
  virtual bool make_box_delta() = 0;
  // There is no time for its box: it gets everything.
  virtual void lose_box() = 0;

 protected:
  ~BoxHolder() = default;

 private:
  friend class BoxTurns;
  std::int64_t last_turn_ns_ = 0;  // how long its last turn took
};

// Peers with a box of interest, in the order in which they asked for their deltas. Each such delta is made for one
// peer alone. So all of them together get a share of the stream thread's time (StreamConfig::box_share), and the
// thread does its other work between any two. A peer that waits gets everything since its last delta as one; when one
// has waited longer than kMaxWait_ns, the peer whose last turn took longest loses its box.
//
// Thread: the stream thread. Owns: the queue.
class BoxTurns {
 public:
  static constexpr std::int64_t kMaxWait_ns = 2'000'000'000;
  // How long after it was asked for a turn begins: peers without a box are served first.
  static constexpr std::int64_t kBehind_ns = 3'000'000;

  BoxTurns(asio::io_context& io, double share, SharedCounters& counters)
      : io_(io), timer_(io), share_(share), counters_(counters) {}

  // Calls holder->make_box_delta() later, when it is its turn.
  void ask(const std::shared_ptr<BoxHolder>& holder);
  // Whether there is time for another box.
  bool has_room();
  void cancel() { timer_.cancel(); }

 private:
  struct Waiting {
    std::weak_ptr<BoxHolder> holder;
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
  SharedCounters& counters_;
  std::deque<Waiting> queue_;
  bool scheduled_ = false;
  std::int64_t refused_ns_ = 0;  // when a peer last lost its box
};

}  // namespace incise::stream
