#include "client/client.hpp"

#include <algorithm>
#include <atomic>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <condition_variable>
#include <deque>
#include <optional>
#include <thread>
#include <utility>

#include "client/link.hpp"
#include "server/base/clock.hpp"

namespace incise::client {
namespace {

using boost::system::error_code;
using std::chrono::duration;
using std::chrono::duration_cast;
using std::chrono::milliseconds;
using std::chrono::steady_clock;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr milliseconds kGoodbye{500};
constexpr std::chrono::seconds kPingEvery{1};
constexpr std::int64_t kSilence_ns = 15'000'000'000;  // with a ping a second unanswered, nobody is there
constexpr int kMostResyncs = 5;                       // in a row: another snapshot would not help
constexpr std::size_t kPingsForOffset = 16;
constexpr const char* kOtherHash = "the replica's hash, computed anew, is another";

steady_clock::duration seconds_of(double s) {
  return duration_cast<steady_clock::duration>(duration<double>(s));
}

template <class F, class... Args>
void call(const F& callback, Args&&... args) {
  if (callback) callback(std::forward<Args>(args)...);
}

}  // namespace

struct Client::Impl {
  Impl(std::string host_name, std::uint16_t port_number, Options given, Callbacks given_callbacks)
      : host(std::move(host_name)),
        port(port_number),
        options(std::move(given)),
        callbacks(std::move(given_callbacks)),
        volume(options.max_vertices, options.max_tets),
        view(options.view),
        outbox_wake(io),
        ping_timer(io),
        retry_timer(io),
        goodbye_timer(io) {}

  // ---- The life of the connection; the client's thread ----

  asio::awaitable<void> live() {
    milliseconds pause{100};
    for (;;) {
      std::string failure;
      try {
        co_await connect_once();
        pause = milliseconds(100);
        co_await serve();
        failure = take_failure();
      } catch (const ConnectError& error) {
        failure = error.what();
      }
      const bool again = end_connection(failure);
      if (!again) break;
      retry_timer.expires_after(pause);
      co_await retry_timer.async_wait(kTuple);
      pause = std::min(2 * pause, milliseconds(2000));
      if (closing) break;
    }
    const std::scoped_lock lock(mutex);
    current_status = Status::kClosed;
    started = true;
    changed.notify_all();
  }

  std::string take_failure() {
    const std::scoped_lock lock(mutex);
    return std::exchange(ending, {});
  }

  // Whether to connect again.
  bool end_connection(const std::string& failure) {
    if (link) link->close();
    link.reset();
    ping_timer.cancel();
    outbox_wake.cancel();
    bool again = false, had_session = false;
    {
      const std::scoped_lock lock(mutex);
      had_session = current_status == Status::kConnected && !closed;  // whoever closes it knows
      again = options.reconnect && started && !closing;
      error_text = failure;
      current_status = again ? Status::kReconnecting : Status::kClosed;
      if (!again) started = true;  // an answer, too, for whoever waits for the first connection
      outbox.clear();
      outbox_bytes = 0;
      changed.notify_all();
    }
    if (had_session) call(callbacks.on_disconnect, failure);
    return again;
  }

  asio::awaitable<void> connect_once() {
    const auto deadline = steady_clock::now() + seconds_of(options.connect_timeout_s);
    link = std::shared_ptr<Link>(co_await open_link(host, port, options, deadline));
    asio::steady_timer late(io, deadline);
    late.async_wait([this, weak = std::weak_ptr<Link>(link)](error_code ec) {
      if (ec) return;
      if (const auto same = weak.lock()) {
        note_ending("no Welcome in time");
        same->close();
      }
    });
    protocol::Hello hello;
    hello.role = options.role;
    hello.view = view;
    hello.client_name = options.client_name;
    hello.client_version = INCISE_VERSION;
    hello.token = options.token;
    hello.max_rate_hz = options.max_rate_hz;
    hello.box = options.box;
    hello.source_name = options.source_name;
    hello.blade = options.blade;
    // Coming back, the blade may still be held by the connection that was lost.
    hello.take_over = options.take_over || reconnecting;
    if (reconnecting && state_is_whole) {
      hello.resume_session = current_session;
      hello.resume_revision = held_revision;
    }
    const protocol::Frame frame = protocol::encode(hello, {++sequence, monotonic_ns()});
    const error_code written = co_await link->write(frame);
    if (written) throw_failure(written.message());
    const Link::Received received = co_await link->read();
    late.cancel();
    if (!received.closed.empty()) {
      const bool silent = received.closed == error_code(asio::error::eof).message();
      throw_failure(silent && !options.tls ? kMaybeTls : received.closed);
    }
    last_received_ns = monotonic_ns();
    const protocol::DecodeResult decoded = protocol::decode(received.body);
    if (!decoded) throw_failure(decoded.error);
    if (const auto* error = std::get_if<protocol::Error>(&decoded.message->body)) throw_failure(error->text);
    if (const auto* bye = std::get_if<protocol::Bye>(&decoded.message->body)) throw_failure(bye->text);
    const auto* answer = std::get_if<protocol::Welcome>(&decoded.message->body);
    if (!answer) throw_failure(std::string("Welcome expected, received ") + name_of(decoded.message->body));
    on_welcome(*answer);
  }

  [[noreturn]] void throw_failure(const std::string& what) {
    std::string why = take_failure();
    if (why.empty()) why = what;
    throw ConnectError(host + ":" + std::to_string(port) + ": " + why);
  }

  void note_ending(const std::string& why) {
    const std::scoped_lock lock(mutex);
    if (ending.empty()) ending = why;
  }

  asio::awaitable<void> serve() {
    asio::co_spawn(io, write_all(link), asio::detached);
    asio::co_spawn(io, ping_all(link), asio::detached);
    const std::shared_ptr<Link> mine = link;
    for (;;) {
      const Link::Received received = co_await mine->read();
      if (!received.closed.empty()) {
        note_ending("connection lost: " + received.closed);
        co_return;
      }
      const Arrival arrival{monotonic_ns(), 0, received.body.size()};
      last_received_ns = arrival.received_ns;
      protocol::DecodeResult decoded = protocol::decode(received.body);
      if (!decoded) {
        note_ending("the server sent what is no message: " + decoded.error);
        co_return;
      }
      const bool go_on = handle(*decoded.message, arrival);
      if (!go_on) co_return;
    }
  }

  asio::awaitable<void> write_all(std::shared_ptr<Link> mine) {
    for (;;) {
      std::shared_ptr<const protocol::Frame> frame;
      {
        const std::scoped_lock lock(mutex);
        if (!outbox.empty()) {
          frame = std::move(outbox.front());
          outbox.pop_front();
        }
      }
      if (!frame) {
        if (link != mine) co_return;
        outbox_wake.expires_at(steady_clock::time_point::max());
        co_await outbox_wake.async_wait(kTuple);
        if (link != mine) co_return;
        continue;
      }
      const error_code ec = co_await mine->write(*frame);
      {
        const std::scoped_lock lock(mutex);
        outbox_bytes -= std::min(outbox_bytes, frame->tcp().size());
        counts.bytes_out += frame->tcp().size();
        changed.notify_all();
      }
      if (ec) {
        mine->close();
        co_return;
      }
    }
  }

  asio::awaitable<void> ping_all(std::shared_ptr<Link> mine) {
    while (link == mine) {
      if (monotonic_ns() - last_received_ns > kSilence_ns) {
        note_ending("the server is silent");
        mine->close();
        co_return;
      }
      queue(protocol::Ping{++ping_nonce, monotonic_ns()});
      ping_timer.expires_after(kPingEvery);
      co_await ping_timer.async_wait(kTuple);
    }
  }

  // ---- Messages ----

  // False: the connection is over.
  bool handle(const protocol::Message& message, Arrival arrival) {
    arrival.sent_ns = message.envelope.sent_ns;
    {
      const std::scoped_lock lock(mutex);
      ++counts.messages_in;
      counts.bytes_in += arrival.bytes;
    }
    return std::visit([&](const auto& body) { return on(body, arrival); }, message.body);
  }

  template <class Other>
  bool on(const Other&, const Arrival&) {
    return true;  // of a later version, or not for us
  }

  bool on(const protocol::Welcome& body, const Arrival&) {
    on_welcome(body);
    return true;
  }

  void on_welcome(const protocol::Welcome& body) {
    {
      const std::scoped_lock lock(mutex);
      last_welcome = body;
      last_report = {};
      current_status = Status::kConnected;
      error_text.clear();
      if (reconnecting) ++counts.reconnects;
      started = true;
      changed.notify_all();
    }
    current_session = body.session;
    if (!body.resumed) {
      state_is_whole = false;
      awaiting_snapshot = true;
    }
    reconnecting = true;  // whatever connection comes after this one
    call(callbacks.on_welcome, body);
  }

  bool on(const protocol::SnapshotBegin& begin, const Arrival&) {
    view = begin.view;
    boxed = begin.box.has_value();
    snapshot_cause = begin.cause;
    return took(change_state([&](auto& replica) { return replica.begin(begin); }));
  }

  bool on(const protocol::SnapshotChunk& chunk, const Arrival&) {
    std::uint32_t done = 0, total = 0;
    const protocol::ApplyResult result = change_state([&](auto& replica) {
      protocol::ApplyResult r = replica.chunk(chunk);
      done = replica.chunks_done();
      total = replica.chunks_total();
      return r;
    });
    const bool fine = took(result);
    if (result) call(callbacks.on_snapshot_progress, done, total);
    return fine;
  }

  bool on(const protocol::SnapshotEnd& end, const Arrival&) {
    const protocol::ApplyResult result = change_state([&](auto& replica) { return replica.end(end); });
    if (!result) return took(result);
    state_is_whole = true;
    awaiting_snapshot = false;
    resyncs_in_a_row = 0;
    moved_to(end.revision, 0, true);
    call(callbacks.on_snapshot, end, snapshot_cause);
    return true;
  }

  bool on(const protocol::Delta& delta, const Arrival& arrival) {
    if (awaiting_snapshot) return true;  // sent before the server knew
    protocol::ApplyResult result = locked([&] { return boxed ? part.apply(delta) : volume.apply(delta); });
    if (result && due_for_full_check(delta) &&
        (boxed ? part.compute_part_hash() != part.part_hash()
               : volume.compute_state_hash() != volume.state_hash())) {
      result = {protocol::ApplyError::HashMismatch, kOtherHash};
    }
    if (!result) return took(result);
    moved_to(delta.revision, delta.steps.size(), false);
    if (boxed) {
      call(callbacks.on_part_delta, part, delta, arrival);
    } else {
      call(callbacks.on_delta, volume, delta, arrival);
    }
    return true;
  }

  bool on(const protocol::SurfaceDelta& delta, const Arrival& arrival) {
    if (awaiting_snapshot) return true;
    protocol::ApplyResult result = locked([&] { return surface.apply(delta); });
    if (result && due_for_full_check(delta) && surface.compute_surface_hash() != surface.surface_hash())
      result = {protocol::ApplyError::HashMismatch, kOtherHash};
    if (!result) return took(result);
    moved_to(delta.revision, delta.steps.size(), false);
    call(callbacks.on_surface_delta, surface, delta, arrival);
    return true;
  }

  // Whether the delta crosses a revision at which the replica is to be hashed anew.
  template <class D>
  bool due_for_full_check(const D& delta) const {
    const std::uint64_t every = options.full_check_interval;
    return every > 0 && delta.revision / every != delta.base_revision / every;
  }

  // Changes the replica of the view in force.
  template <class F>
  protocol::ApplyResult change_state(F&& change) {
    return locked([&] {
      if (view == protocol::View::Surface) return change(surface);
      return boxed ? change(part) : change(volume);
    });
  }

  template <class F>
  protocol::ApplyResult locked(F&& change) {
    const std::scoped_lock lock(state_mutex);
    return change();
  }

  void moved_to(std::uint64_t revision, std::size_t steps, bool snapshot) {
    resyncs_in_a_row = 0;
    const std::scoped_lock lock(mutex);
    held_revision = revision;
    counts.steps += steps;
    ++(snapshot ? counts.snapshots : counts.deltas);
    changed.notify_all();
  }

  // What to do about a part of the state that the replica refused: ask for a whole one, unless that has not
  // helped.
  bool took(const protocol::ApplyResult& result) {
    if (result) return true;
    awaiting_snapshot = true;
    {
      const std::scoped_lock lock(mutex);
      ++counts.resyncs;
    }
    call(callbacks.on_resync, result.text);
    if (++resyncs_in_a_row > kMostResyncs || result.error == protocol::ApplyError::LimitReached) {
      note_ending("cannot hold the server's state: " + result.text);
      closing = true;  // the next connection would not fare better
      return false;
    }
    protocol::Resync resync;
    resync.revision = held_revision;
    resync.reason = result.text.substr(0, protocol::kMaxNameBytes);
    queue(resync);
    return true;
  }

  bool on(const protocol::Ping& ping, const Arrival& arrival) {
    queue(protocol::Pong{ping.nonce, ping.sent_ns, arrival.received_ns});
    return true;
  }

  // Cristian 1989, "Probabilistic clock synchronization": the shortest way gives the best bound.
  bool on(const protocol::Pong& pong, const Arrival& arrival) {
    const std::int64_t way = arrival.received_ns - pong.ping_sent_ns;
    if (way < 0) return true;
    recent_ways.push_back({way, pong.received_ns - (pong.ping_sent_ns + way / 2)});
    if (recent_ways.size() > kPingsForOffset) recent_ways.pop_front();
    const Way best =
        *std::min_element(recent_ways.begin(), recent_ways.end(),
                          [](const Way& a, const Way& b) { return a.there_and_back < b.there_and_back; });
    clock_offset = best.offset;
    round_trip = best.there_and_back;
    return true;
  }

  bool on(const protocol::Error& error, const Arrival&) {
    if (error.fatal) note_ending(std::string(name_of(error.code)) + ": " + error.text);
    call(callbacks.on_error, error);
    return true;  // Bye follows a fatal one
  }

  bool on(const protocol::Bye& bye, const Arrival&) {
    note_ending(bye.text.empty() ? "the server said goodbye" : bye.text);
    // Who took the blade over, or told us to go, would be fought by coming back.
    if (bye.reason == protocol::ByeReason::HandedOver || bye.reason == protocol::ByeReason::Refused)
      closing = true;
    return false;
  }

  bool on(const protocol::PoseReport& report, const Arrival&) {
    {
      const std::scoped_lock lock(mutex);
      last_report = report;
      changed.notify_all();
    }
    call(callbacks.on_report, report);
    return true;
  }

  bool on(const protocol::PositionsReport& report, const Arrival&) {
    call(callbacks.on_positions_report, report);
    return true;
  }

  bool on(const protocol::Force& force, const Arrival&) {
    call(callbacks.on_force, force);
    return true;
  }

  bool on(const protocol::Stats& stats, const Arrival&) {
    call(callbacks.on_stats, stats);
    return true;
  }

  // ---- Sending; any thread ----

  // Puts a message into the outbox; returns its sequence, 0 without a connection.
  std::uint64_t queue(const protocol::Body& body) {
    std::uint64_t number = 0;
    {
      const std::scoped_lock lock(mutex);
      if (current_status != Status::kConnected) return 0;
      number = put(body);
    }
    wake_writer();
    return number;
  }

  // With mutex held.
  std::uint64_t put(const protocol::Body& body) {
    auto frame =
        std::make_shared<const protocol::Frame>(protocol::encode(body, {++sequence, monotonic_ns()}));
    outbox_bytes += frame->tcp().size();
    outbox.push_back(std::move(frame));
    return sequence;
  }

  void wake_writer() {
    asio::post(io, [this] { outbox_wake.cancel(); });
  }

  std::uint64_t send_poses(std::span<const protocol::PoseSample> poses) {
    if (poses.empty()) return 0;
    std::uint64_t last = 0;
    {
      const std::scoped_lock lock(mutex);
      if (current_status != Status::kConnected || closing) return 0;
      if (outbox_bytes > 0 && outbox_bytes + poses.size_bytes() > options.max_outbox_bytes) return 0;
      while (!poses.empty()) {
        const std::size_t n = std::min(poses.size(), protocol::kMaxPosesPerBatch);
        last = put(protocol::PoseBatch{poses.first(n)});
        poses = poses.subspan(n);
      }
    }
    wake_writer();
    return last;
  }

  std::uint64_t send_positions(const protocol::Positions& positions) {
    std::uint64_t sent = 0;
    {
      const std::scoped_lock lock(mutex);
      if (current_status != Status::kConnected || closing || outbox_bytes > 0) return 0;
      sent = put(positions);
    }
    wake_writer();
    return sent;
  }

  // ---- Waiting; any thread but the client's ----

  template <class Done>
  bool wait(Done&& done, double timeout_s) {
    const auto deadline = steady_clock::now() + seconds_of(timeout_s);
    std::unique_lock lock(mutex);
    if (options.background) {
      changed.wait_until(lock, deadline, [&] { return done() || current_status == Status::kClosed; });
      return done();
    }
    while (!done() && current_status != Status::kClosed && steady_clock::now() < deadline) {
      lock.unlock();
      run_for(std::min<steady_clock::duration>(deadline - steady_clock::now(), milliseconds(10)));
      lock.lock();
    }
    return done();
  }

  void run_for(steady_clock::duration time) {
    if (io.stopped()) io.restart();
    if (time <= steady_clock::duration::zero()) {
      io.poll();
    } else {
      io.run_one_for(time);
      io.poll();
    }
  }

  void start() {
    asio::co_spawn(io, live(), asio::detached);
    if (options.background) thread = std::thread([this] { io.run(); });
    // connect_timeout_s runs in the coroutine; a resolver that hangs is the one thing it cannot end.
    const bool answered = wait([this] { return started; }, options.connect_timeout_s + 1);
    std::string why;
    {
      const std::scoped_lock lock(mutex);
      if (current_status == Status::kConnected) return;
      why = answered ? error_text : host + ":" + std::to_string(port) + ": no answer in time";
    }
    stop();
    throw ConnectError(why);
  }

  void close() {
    {
      const std::scoped_lock lock(mutex);
      if (closed) return;
      closed = true;
    }
    queue(protocol::Bye{protocol::ByeReason::Done, ""});
    asio::post(io, [this] {
      closing = true;
      retry_timer.cancel();
      // The server answers with its own Bye and ends the connection.
      goodbye_timer.expires_after(kGoodbye);
      goodbye_timer.async_wait([this](error_code) {
        if (link) link->close();
      });
    });
    wait([this] { return current_status == Status::kClosed; }, 2 * duration<double>(kGoodbye).count());
    stop();
  }

  void stop() {
    io.stop();
    if (thread.joinable()) thread.join();
    const std::scoped_lock lock(mutex);
    current_status = Status::kClosed;
    closed = true;
    changed.notify_all();
  }

  const std::string host;
  const std::uint16_t port;
  const Options options;
  const Callbacks callbacks;

  asio::io_context io{1};
  std::thread thread;

  // Guarded by state_mutex; changed by the client's thread alone, which may read without.
  mutable std::mutex state_mutex;
  protocol::Replica volume;
  protocol::SurfaceReplica surface;
  protocol::VolumePart part;

  // The client's thread's.
  protocol::View view;  // in force
  bool boxed = false;   // likewise: the snapshot was of what touches a box
  std::shared_ptr<Link> link;
  asio::steady_timer outbox_wake, ping_timer, retry_timer, goodbye_timer;
  std::uint64_t current_session = 0;
  bool reconnecting = false;    // there has been a session
  bool state_is_whole = false;  // the replica has a state of current_session
  bool awaiting_snapshot = false;
  int resyncs_in_a_row = 0;
  protocol::SnapshotCause snapshot_cause = protocol::SnapshotCause::Join;
  std::uint64_t ping_nonce = 0;
  std::int64_t last_received_ns = 0;
  struct Way {
    std::int64_t there_and_back, offset;
  };
  std::deque<Way> recent_ways;

  std::atomic<bool> closing{false};
  std::atomic<std::uint64_t> held_revision{0};
  std::atomic<std::int64_t> clock_offset{0}, round_trip{0};

  mutable std::mutex mutex;  // of all below
  std::condition_variable changed;
  Status current_status = Status::kReconnecting;
  bool started = false;  // the first attempt has ended, one way or the other
  bool closed = false;   // by close()
  std::string error_text, ending;
  protocol::Welcome last_welcome;
  protocol::PoseReport last_report;
  Counters counts;
  std::uint64_t sequence = 0;
  std::deque<std::shared_ptr<const protocol::Frame>> outbox;
  std::size_t outbox_bytes = 0;
};

Client::Client(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

Client::~Client() {
  close();
}

std::unique_ptr<Client> Client::connect(const std::string& host, std::uint16_t port, Options options,
                                        Callbacks callbacks) {
  auto impl = std::make_unique<Impl>(host, port, std::move(options), std::move(callbacks));
  impl->start();
  return std::unique_ptr<Client>(new Client(std::move(impl)));
}

std::uint64_t Client::send_poses(std::span<const protocol::PoseSample> poses) {
  return impl_->send_poses(poses);
}

bool Client::engage(std::int64_t source_ns) {
  return impl_->queue(protocol::StrokeControl{protocol::StrokeAction::Engage, source_ns}) != 0;
}

std::uint64_t Client::send_positions(const protocol::Positions& positions) {
  return impl_->send_positions(positions);
}

bool Client::end_stroke(std::int64_t source_ns) {
  return impl_->queue(protocol::StrokeControl{protocol::StrokeAction::End, source_ns}) != 0;
}

bool Client::subscribe(protocol::View view, float max_rate_hz) {
  return impl_->queue(protocol::Subscribe{view, max_rate_hz, impl_->options.box}) != 0;
}

bool Client::reset() {
  return impl_->queue(protocol::Reset{}) != 0;
}

Status Client::status() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->current_status;
}

std::string Client::last_error() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->error_text;
}

protocol::Welcome Client::welcome() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->last_welcome;
}

protocol::PoseReport Client::report() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->last_report;
}

Counters Client::counters() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->counts;
}

std::uint64_t Client::revision() const {
  return impl_->held_revision;
}
std::int64_t Client::clock_offset_ns() const {
  return impl_->clock_offset;
}
std::int64_t Client::round_trip_ns() const {
  return impl_->round_trip;
}

bool Client::wait_for_revision(std::uint64_t revision, double timeout_s) {
  return impl_->wait([&] { return impl_->counts.snapshots > 0 && impl_->held_revision.load() >= revision; },
                     timeout_s);
}

bool Client::wait_for_report(std::uint64_t sequence, double timeout_s) {
  return impl_->wait([&] { return impl_->last_report.through_sequence >= sequence; }, timeout_s);
}

bool Client::poll(double timeout_s) {
  impl_->run_for(seconds_of(timeout_s));
  return status() != Status::kClosed;
}

void Client::close() {
  impl_->close();
}

void Client::drop_connection() {
  asio::post(impl_->io, [impl = impl_.get()] {
    if (impl->link) impl->link->close();
  });
}

std::mutex& Client::state_mutex() const {
  return impl_->state_mutex;
}
const protocol::Replica& Client::volume() const {
  return impl_->volume;
}
const protocol::SurfaceReplica& Client::surface() const {
  return impl_->surface;
}
const protocol::VolumePart& Client::part() const {
  return impl_->part;
}

}  // namespace incise::client
