#include "client/client.hpp"

#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/post.hpp>
#include <utility>

#include "client/client_impl.hpp"

namespace incise::client {
namespace {

using boost::system::error_code;
using std::chrono::duration;
constexpr std::chrono::milliseconds kGoodbye{500};

}  // namespace

Client::Impl::Impl(std::string host_name, std::uint16_t port_number, Options given, Callbacks given_callbacks)
    : host(std::move(host_name)),
      port(port_number),
      options(std::move(given)),
      callbacks(std::move(given_callbacks)),
      state(options.max_vertices, options.max_tets, options.view, options.full_check_interval),
      outbox_wake(io),
      ping_timer(io),
      retry_timer(io),
      goodbye_timer(io) {}

void Client::Impl::run_for(Clock::duration time) {
  if (io.stopped()) io.restart();
  if (time <= Clock::duration::zero()) {
    io.poll();
  } else {
    io.run_one_for(time);
    io.poll();
  }
}

void Client::Impl::start() {
  asio::co_spawn(io, live(), asio::detached);
  if (options.background) thread = std::thread([this] { io.run(); });
  // connect_timeout_s runs in the coroutine; a resolver that hangs is the one thing it cannot end.
  const bool answered = wait([this] { return started; }, options.connect_timeout_s + 1);
  std::string why;
  protocol::ErrorCode code{};
  {
    const std::scoped_lock lock(mutex);
    // Reconnecting: it was welcomed, and lost the connection before this thread woke.
    if (current_status == Status::kConnected || (answered && current_status == Status::kReconnecting)) return;
    code = refusal;
    why = answered ? error_text : host + ":" + std::to_string(port) + ": no answer in time";
  }
  stop();
  throw ConnectError(why, code);
}

void Client::Impl::close() {
  {
    const std::scoped_lock lock(mutex);
    if (closed) return;
    closed = true;
  }
  send(protocol::Bye{protocol::ByeReason::Done, ""});
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

void Client::Impl::stop() {
  io.stop();
  if (thread.joinable()) thread.join();
  const std::scoped_lock lock(mutex);
  current_status = Status::kClosed;
  closed = true;
  changed.notify_all();
}

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
  return impl_->send(protocol::StrokeControl{protocol::StrokeAction::Engage, source_ns}) != 0;
}

std::uint64_t Client::send_model(const protocol::BladeModel& model) {
  return impl_->send_model(model);
}
std::uint64_t Client::send_positions(const protocol::Positions& positions) {
  return impl_->send_positions(positions);
}

bool Client::end_stroke(std::int64_t source_ns) {
  return impl_->send(protocol::StrokeControl{protocol::StrokeAction::End, source_ns}) != 0;
}

std::uint64_t Client::send_field(const protocol::FieldValues& values) {
  return impl_->send(values);
}
bool Client::subscribe(protocol::View view, float max_rate_hz) {
  return impl_->send(protocol::Subscribe{view, max_rate_hz, impl_->options.box, impl_->options.fields}) != 0;
}

bool Client::reset() {
  return impl_->send(protocol::Reset{}) != 0;
}

bool Client::undo(bool others) {
  return impl_->send(protocol::Undo{others}) != 0;
}

Status Client::status() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->current_status;
}

std::string Client::last_error() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->error_text;
}

protocol::ByeReason Client::goodbye() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->bye_reason;
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
  return impl_->state.revision();
}
std::int64_t Client::clock_offset_ns() const {
  return impl_->server_clock.offset_ns();
}
std::int64_t Client::round_trip_ns() const {
  return impl_->server_clock.round_trip_ns();
}

bool Client::wait_for_revision(std::uint64_t revision, double timeout_s) {
  return impl_->wait([&] { return impl_->state.whole() && impl_->state.revision() >= revision; }, timeout_s);
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
  return impl_->state.mutex();
}
const protocol::FieldReplica& Client::fields() const {
  return impl_->state.fields();
}
const protocol::Replica& Client::volume() const {
  return impl_->state.volume();
}
const protocol::SurfaceReplica& Client::surface() const {
  return impl_->state.surface();
}
const protocol::VolumePart& Client::part() const {
  return impl_->state.part();
}

}  // namespace incise::client
