#include "server/input/haply/haply_input.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core/error.hpp>
#include <chrono>
#include <mutex>
#include <optional>
#include <thread>

#include "protocol/net/web_socket.hpp"
#include "server/base/clock.hpp"
#include "server/input/force_guard.hpp"
#include "server/input/limited_log.hpp"

namespace incise::input {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
using boost::system::error_code;
using net::WebSocket;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

constexpr std::size_t kMostBytes = 1 << 20;  // of a state message
constexpr int kMostFaults = 32;              // in a row: then it is some other service
constexpr std::chrono::seconds kConnectTime{5}, kAnswerTime{1}, kRetry{2};
constexpr std::chrono::milliseconds kNoDevice{200}, kStopTime{500};

struct Counts {
  std::uint64_t connections = 0, messages = 0, poses = 0, bad_messages = 0, no_blade = 0, forces_written = 0,
                forces_failed = 0;
};

}  // namespace

// Everything but the constructor, stop() and status() runs on `thread`.
struct HaplyInput::Impl {
  Impl(PoseSources& of, haptics::ForceSlots& slots, HaplyOptions given)
      : sources(of), forces(slots), options(std::move(given)), guard(options.max_force_n) {
    std::string place = options.url.substr(options.url.find("://") + 3);
    path = place.find('/') == std::string::npos ? "/" : place.substr(place.find('/'));
    place = place.substr(0, place.find('/'));
    host = place.substr(0, place.rfind(':'));
    service = place.substr(place.rfind(':') + 1);
    publish();
    asio::co_spawn(io, run(), asio::detached);
    thread = std::thread([this] {
      options.on_thread();
      io.run();
    });
  }

  void stop() {
    if (!thread.joinable()) return;
    asio::post(io, [this] {
      stopping = true;
      pause.cancel();
      limit.expires_after(kStopTime);
      limit.async_wait([this](boost::system::error_code error) {
        if (!error) io.stop();
      });
    });
    thread.join();
    lose();
    publish();
  }

  asio::awaitable<void> run() {
    bool complained = false;
    while (!stopping) {
      WebSocket ws{net::NetStream(net::NetStream::Tcp(io))};
      std::string why = co_await connect(ws);
      if (why.empty()) {
        complained = false;
        ++counts.connections;
        connected = true;
        log(spdlog::level::info, "connected to " + options.url);
        why = co_await serve(ws);
        connected = false;
        lose();
        publish();
        if (!stopping) log(spdlog::level::warn, options.url + ": " + why);
      } else if (!complained) {
        spdlog::warn("haply: cannot connect to {}: {}; trying again every {} s", options.url, why,
                     kRetry.count());
        complained = true;
      }
      if (!stopping) co_await wait(kRetry);
      events.flush(monotonic_ns());
    }
    limit.cancel();
  }

  void log(spdlog::level::level_enum level, const std::string& line) {
    events.write(level, options.url, "haply: " + line, monotonic_ns());
  }

  template <class Duration>
  asio::awaitable<void> wait(Duration time) {
    pause.expires_after(time);
    co_await pause.async_wait(kTuple);
  }

  asio::awaitable<std::string> connect(WebSocket& ws) {
    ws.stream().tcp().expires_after(kConnectTime);
    const error_code connect_error = co_await net::connect(ws.stream().tcp(), host, service);
    if (connect_error) co_return connect_error.message();
    ws.send_text();
    ws.set_max_bytes(kMostBytes);
    const error_code error = co_await ws.shake_hands(host + ":" + service, path);
    co_return error ? error.message() : std::string();
  }

  // Reads states and sends commands in turn. Returns why it ended.
  asio::awaitable<std::string> serve(WebSocket& ws) {
    const auto period = std::chrono::nanoseconds(static_cast<std::int64_t>(1e9 / options.rate_hz));
    auto due = std::chrono::steady_clock::now();
    bool first = true;
    int faults = 0;
    while (!stopping) {
      ws.stream().tcp().expires_after(kAnswerTime);
      const error_code error = co_await ws.read();
      if (error) co_return error == beast::error::timeout ? "no answer for a second" : error.message();
      const auto message = ws.message();
      const std::string_view text(reinterpret_cast<const char*>(message.data()), message.size());
      faults = co_await handle_message(text) ? 0 : faults + 1;
      if (faults >= kMostFaults) co_return std::to_string(faults) + " bad messages in a row";

      due = std::max(due + period, std::chrono::steady_clock::now());
      if (!device.empty() && !stopping) {
        pause.expires_at(due);
        co_await pause.async_wait(kTuple);
      } else if (!stopping) {
        co_await wait(kNoDevice);
      }
      if (stopping) break;
      if (std::string failed = co_await command(ws, first); !failed.empty()) co_return failed;
      first = false;
      if (++turns % 64 == 1 || device.empty()) publish();
    }
    // The last command is no force. Its answer shows that it arrived: closing a connection with an answer unread resets it,
    // and what the service had not read is lost.
    if (!device.empty()) {
      const std::string failed = co_await command(ws, false);
      ws.stream().tcp().expires_after(kAnswerTime);
      if (failed.empty()) co_await ws.read();
    }
    co_return std::string("ended");
  }

  asio::awaitable<std::string> command(WebSocket& ws, bool first) {
    core::Vec3 force;
    if (slot && !stopping) {
      slot->read(newest);
      force = turned_to_device(options.placement, guard.pass(newest, monotonic_ns()));
    }
    const std::string text =
        device.empty() ? haply_query() : haply_force(device, force, options.version, first);
    ws.stream().tcp().expires_after(kAnswerTime);
    const error_code error = co_await ws.write(std::as_bytes(std::span(text)));
    if (!error) {
      counts.forces_written += !device.empty();
      co_return std::string();
    }
    ++counts.forces_failed;
    guard.failed();
    if (slot) slot->write_failed();
    co_return error == beast::error::timeout ? "it does not read" : error.message();
  }

  // False if the message was not a state.
  asio::awaitable<bool> handle_message(std::string_view text) {
    const std::int64_t arrival_ns = monotonic_ns();
    ++counts.messages;
    events.flush(arrival_ns);
    std::string error;
    const std::optional<HaplyState> state = read_haply_state(text, options.device, options.grip, error);
    if (!state) {
      ++counts.bad_messages;
      log(spdlog::level::warn, "message ignored: " + error);
      co_return false;
    }
    if (state->device != device) {
      lose();
      device = state->device;
      publish();
    }
    if (device.empty() || !hold()) co_return true;
    TimedPose pose;
    pose.arrival_ns = arrival_ns;
    pose.pose.t_ns = last_ns = std::max(arrival_ns, last_ns + 1);
    pose.pose.position = world_from_device(options.placement, state->position);
    pose.pose.orientation = world_from_device(options.placement, state->orientation);
    pose.pose.buttons = state->buttons;
    ++counts.poses;
    // A full queue: the loop is far behind. Meanwhile nothing is sent, and the service releases the device.
    while (source->enqueue(std::span(&pose, 1)) == 0 && !stopping)
      co_await wait(std::chrono::milliseconds(1));
    co_return true;
  }

  // Whether this has a blade; opens one if need be.
  bool hold() {
    if (source) return true;
    source = sources.open(options.source);
    if (!source) {
      ++counts.no_blade;
      log(spdlog::level::warn, "no blade for " + options.source + ": it is in use, or all " +
                                   std::to_string(core::kMaxSources) + " are");
      return false;
    }
    slot = &forces[source->number()];
    slot->device_came(options.max_force_n);
    newest = {};
    publish();
    return true;
  }

  void lose() {
    if (slot) slot->device_lost();
    slot = nullptr;
    source.reset();
    device.clear();
  }

  void publish() {
    NetworkStatus status{"haply", {}, {}};
    status.peers.push_back({options.url, connected, {}});
    if (source) status.peers.front().sources.push_back(options.source);
    status.counts = {{"connections", counts.connections},
                     {"messages", counts.messages},
                     {"poses", counts.poses},
                     {"bad_messages", counts.bad_messages},
                     {"no_blade", counts.no_blade},
                     {"forces_written", counts.forces_written},
                     {"forces_failed", counts.forces_failed}};
    const std::scoped_lock lock(status_mutex);
    told = std::move(status);
  }

  PoseSources& sources;
  haptics::ForceSlots& forces;
  const HaplyOptions options;
  std::string host, service, path;
  asio::io_context io{1};
  asio::steady_timer pause{io}, limit{io};
  bool stopping = false, connected = false;
  std::string device;  // the id of the Inverse3 that is there
  std::optional<PoseSource> source;
  haptics::ForceSlot* slot = nullptr;  // while there is a source
  haptics::ForceCommand newest;
  ForceGuard guard;
  std::int64_t last_ns = 0;
  std::uint64_t turns = 0;
  Counts counts;
  LimitedLog events;
  mutable std::mutex status_mutex;
  NetworkStatus told;  // guarded by status_mutex
  std::thread thread;
};

HaplyInput::HaplyInput(PoseSources& sources, haptics::ForceSlots& forces, HaplyOptions options)
    : impl_(std::make_unique<Impl>(sources, forces, std::move(options))) {}

HaplyInput::~HaplyInput() {
  stop();
}

void HaplyInput::stop() {
  impl_->stop();
}

NetworkStatus HaplyInput::status() const {
  const std::scoped_lock lock(impl_->status_mutex);
  return impl_->told;
}

}  // namespace incise::input
