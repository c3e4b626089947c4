#pragma once

// What is behind Client. Not installed: Asio stays in here.

#include <algorithm>
#include <atomic>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <utility>

#include "client/client.hpp"
#include "client/clock_estimate.hpp"
#include "client/held_state.hpp"
#include "client/link.hpp"

namespace incise::client {

// Thread: as each part says.
struct Client::Impl {
  using Clock = std::chrono::steady_clock;

  Impl(std::string host_name, std::uint16_t port_number, Options given, Callbacks given_callbacks);

  // ---- From any thread but the client's ----

  // Connects; throws ConnectError.
  void start();
  void close();
  void stop();
  // Waits until `done()` holds, which it calls with `mutex` held. False when the time is over or the client is
  // closed.
  template <class Done>
  bool wait(Done&& done, double timeout_s);
  // Without a thread of the client's own: does its work.
  void run_for(Clock::duration time);

  // ---- From any thread (client_send.cpp) ----

  // Queues a message; returns its sequence, 0 without a connection.
  std::uint64_t send(const protocol::Body& body);
  std::uint64_t send_poses(std::span<const protocol::PoseSample> poses);
  std::uint64_t send_positions(const protocol::Positions& positions);
  std::uint64_t send_model(const protocol::BladeModel& model);
  // With `mutex` held.
  std::uint64_t append(const protocol::Body& body);
  void wake_writer();

  // ---- The client's thread: the connection (client_connection.cpp) ----

  // Connects, serves, and connects again if the options say so, until the client is closed.
  asio::awaitable<void> live();
  asio::awaitable<void> connect_once();
  protocol::Hello hello() const;
  // Cleans up; returns whether to connect again.
  bool end_connection(const std::string& failure);
  asio::awaitable<void> serve();
  asio::awaitable<void> write_all(std::shared_ptr<Link> mine);
  asio::awaitable<void> ping_all(std::shared_ptr<Link> mine);
  // The first reason for the connection's end counts.
  void note_failure(const std::string& why);
  std::string take_failure();
  [[noreturn]] void throw_failure(const std::string& what,
                                  protocol::ErrorCode code = protocol::ErrorCode::Unknown);

  // ---- The client's thread: messages (client_messages.cpp) ----

  // False: the connection is over.
  bool dispatch(const protocol::Message& message, Arrival arrival);
  void on_welcome(const protocol::Welcome& welcome);
  bool on(const protocol::Welcome& welcome, const Arrival&);
  bool on(const protocol::SnapshotBegin& begin, const Arrival&);
  bool on(const protocol::SnapshotChunk& chunk, const Arrival&);
  bool on(const protocol::FieldValues& values, const Arrival&);
  bool on(const protocol::SnapshotEnd& end, const Arrival&);
  bool on(const protocol::Delta& delta, const Arrival& arrival);
  bool on(const protocol::SurfaceDelta& delta, const Arrival& arrival);
  bool on(const protocol::Ping& ping, const Arrival& arrival);
  bool on(const protocol::Pong& pong, const Arrival& arrival);
  bool on(const protocol::Error& error, const Arrival&);
  bool on(const protocol::Bye& bye, const Arrival&);
  bool on(const protocol::PoseReport& report, const Arrival&);
  bool on(const protocol::PositionsReport& report, const Arrival&);
  bool on(const protocol::BladeLoad& load, const Arrival&);
  bool on(const protocol::Force& force, const Arrival&);
  bool on(const protocol::Stats& stats, const Arrival&);
  // Of a later version, or not for this client.
  template <class Other>
  bool on(const Other&, const Arrival&) {
    return true;
  }
  // The replica has refused a part of the state: asks for a snapshot, unless that has not helped.
  bool resync(const protocol::ApplyResult& result);
  // The replica has changed.
  void note_moved(std::size_t steps, bool snapshot);

  // ---- Members ----

  const std::string host;
  const std::uint16_t port;
  const Options options;
  const Callbacks callbacks;

  asio::io_context io{1};
  std::thread thread;
  HeldState state;
  ClockEstimate server_clock;

  // The client's thread's.
  std::shared_ptr<Link> link;
  asio::steady_timer outbox_wake, ping_timer, retry_timer, goodbye_timer;
  std::uint64_t epoch = 0;    // Welcome.session
  bool reconnecting = false;  // there has been a Welcome
  int resyncs_in_a_row = 0;
  std::uint64_t ping_nonce = 0;
  std::int64_t last_received_ns = 0;

  std::atomic<bool> closing{false};

  mutable std::mutex mutex;  // of all below
  std::condition_variable changed;
  Status current_status = Status::kReconnecting;
  bool started = false;  // the first attempt has ended, in success or not
  bool closed = false;   // by close()
  std::string error_text, failure;
  protocol::ByeReason bye_reason = protocol::ByeReason::Unknown;
  protocol::ErrorCode refusal = protocol::ErrorCode::Unknown;  // why the last attempt to connect was refused
  protocol::Welcome last_welcome;
  protocol::PoseReport last_report;
  Counters counts;
  std::uint64_t sequence = 0;
  std::deque<std::shared_ptr<const protocol::Frame>> outbox;
  std::size_t outbox_bytes = 0;
};

template <class F, class... Args>
void call(const F& callback, Args&&... args) {
  if (callback) callback(std::forward<Args>(args)...);
}

inline std::chrono::steady_clock::duration seconds_of(double s) {
  return std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(s));
}

template <class Done>
bool Client::Impl::wait(Done&& done, double timeout_s) {
  const auto deadline = Clock::now() + seconds_of(timeout_s);
  std::unique_lock lock(mutex);
  if (options.background) {
    changed.wait_until(lock, deadline, [&] { return done() || current_status == Status::kClosed; });
    return done();
  }
  while (!done() && current_status != Status::kClosed && Clock::now() < deadline) {
    lock.unlock();
    run_for(std::min<Clock::duration>(deadline - Clock::now(), std::chrono::milliseconds(10)));
    lock.lock();
  }
  return done();
}

}  // namespace incise::client
