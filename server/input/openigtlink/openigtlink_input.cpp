#include "server/input/openigtlink/openigtlink_input.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <chrono>
#include <mutex>
#include <set>
#include <thread>
#include <utility>

#include "protocol/net/listen_error.hpp"
#include "protocol/net/net_stream.hpp"
#include "server/base/clock.hpp"
#include "server/input/openigtlink/peer.hpp"
#include "server/input/openigtlink/surface_sender.hpp"

namespace incise::input {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using boost::system::error_code;
using openigtlink::Peer;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

constexpr std::size_t kMaxPeers = 16;
constexpr std::chrono::milliseconds kTick{20};
constexpr std::chrono::seconds kConnectTime{5}, kRetry{2};

}  // namespace

// Everything but the constructor, stop(), status() and what SurfaceFeed calls runs on thread_.
struct OpenIgtLinkInput::Impl {
  Impl(PoseSources& sources, OpenIgtLinkOptions given, SurfaceFeed feed)
      : options(std::move(given)), context{io, sources, options}, surfaces(context, std::move(feed), peers) {
    if (options.port >= 0) take_port();
  }

  void start() {
    if (acceptor) listen();
    for (const std::string& place : options.connect)
      asio::co_spawn(io, keep_connected(place), asio::detached);
    tick();
    thread = std::thread([this] { io.run(); });
  }

  void take_port() {
    try {
      const tcp::endpoint endpoint(asio::ip::make_address(options.address),
                                   static_cast<std::uint16_t>(options.port));
      acceptor.emplace(io, endpoint.protocol());
      acceptor->set_option(tcp::acceptor::reuse_address(true));
      acceptor->bind(endpoint);
      port = acceptor->local_endpoint().port();
    } catch (const boost::system::system_error& error) {
      throw net::cannot_listen("openigtlink.port", options.address, options.port, error.code());
    }
  }

  void listen() {
    error_code error;
    acceptor->listen(asio::socket_base::max_listen_connections, error);
    // Two programs can take the same port, but not both listen.
    if (error) throw net::cannot_listen("openigtlink.port", options.address, port, error);
    asio::co_spawn(io, accept(), asio::detached);
  }

  void stop() {
    if (!thread.joinable()) return;
    surfaces.stop();
    io.stop();
    thread.join();
    for (const auto& peer : peers) peer->release_tools();
    publish();
  }

  // ---- Connections ----

  asio::awaitable<void> accept() {
    for (;;) {
      auto [error, socket] = co_await acceptor->async_accept(kTuple);
      if (error) {
        // Out of descriptors, most likely.
        asio::steady_timer pause(io, std::chrono::milliseconds(200));
        co_await pause.async_wait(kTuple);
        continue;
      }
      error_code ignored;
      const auto from = socket.remote_endpoint(ignored);
      const std::string name = from.address().to_string() + ":" + std::to_string(from.port());
      if (peers.size() >= kMaxPeers) {
        ++context.counts.refused;
        context.log_fault(spdlog::level::warn, name,
                          " refused: " + std::to_string(kMaxPeers) + " peers are connected");
        continue;  // the socket closes here
      }
      asio::co_spawn(io, serve(boost::beast::tcp_stream(std::move(socket)), name, false),
                     [](std::exception_ptr) {});
    }
  }

  // `ask`: ask the peer for poses, if the configuration says so.
  asio::awaitable<void> serve(boost::beast::tcp_stream stream, std::string name, bool ask) {
    error_code ignored;
    stream.socket().set_option(tcp::no_delay(true), ignored);
    // Notices a peer that vanishes without closing.
    stream.socket().set_option(asio::socket_base::keep_alive(true), ignored);
    const auto peer = std::make_shared<Peer>(context, std::move(stream), std::move(name));
    peers.insert(peer);
    ++context.counts.connections;
    context.log_event(peer->name(), " connected");
    if (ask && options.ask_for != "nothing") {
      // At most a frame each millisecond (0 would mean: as fast as it can), in its own coordinates.
      std::vector<std::uint8_t> body(36);
      body[3] = 1;
      peer->send(options.ask_for == "TDATA" ? "STT_TDATA" : "STT_QTDATA", body);
    }
    try {
      co_await peer->run();
    } catch (const std::exception& error) {
      context.log_fault(spdlog::level::err, peer->name(), std::string(": ") + error.what());
      peer->release_tools();
      peer->close();
    }
    peers.erase(peer);
  }

  asio::awaitable<void> keep_connected(std::string place) {
    const std::size_t colon = place.rfind(':');
    const std::string host = place.substr(0, colon), service = place.substr(colon + 1);
    bool complained = false;
    for (;;) {
      boost::beast::tcp_stream stream(io);
      stream.expires_after(kConnectTime);
      const error_code error = co_await net::connect(stream, host, service);
      if (!error) {
        stream.expires_never();
        complained = false;
        co_await serve(std::move(stream), place, true);
      } else if (!complained) {
        spdlog::warn("openigtlink: cannot connect to {}: {}; trying again every {} s", place, error.message(),
                     kRetry.count());
        complained = true;
      }
      asio::steady_timer pause(io, kRetry);
      co_await pause.async_wait(kTuple);
    }
  }

  // ---- The clock ----

  void tick() {
    const std::int64_t now_ns = monotonic_ns();
    context.events.flush(now_ns);
    context.faults.flush(now_ns);
    for (const auto& peer : peers) peer->check_deadlines(now_ns);
    surfaces.offer(now_ns);
    publish();
    clock.expires_after(kTick);
    clock.async_wait([this](error_code error) {
      if (!error) tick();
    });
  }

  void publish() {
    NetworkStatus now{"openigtlink", {}, {}};
    for (const std::string& place : options.connect) now.peers.push_back({place, false, {}});
    for (const auto& peer : peers) {
      auto entry = std::find_if(now.peers.begin(), now.peers.end(),
                                [&](const NetworkStatus::Peer& p) { return p.name == peer->name(); });
      if (entry == now.peers.end()) entry = now.peers.insert(entry, {peer->name(), false, {}});
      entry->connected = !peer->closed();
      for (std::string& name : peer->sources()) entry->sources.push_back(std::move(name));
    }
    const openigtlink::Counts& counts = context.counts;
    now.counts = {{"connections", counts.connections},
                  {"messages", counts.messages},
                  {"poses", counts.poses},
                  {"skipped", counts.skipped},
                  {"bad_headers", counts.bad_headers},
                  {"bad_crc", counts.bad_crc},
                  {"bad_shape", counts.bad_shape},
                  {"bad_values", counts.bad_values},
                  {"no_rotation", counts.stretched},
                  {"no_blade", counts.no_blade},
                  {"clock_restarts", counts.clock_restarts},
                  {"refused", counts.refused},
                  {"unfinished", counts.unfinished},
                  {"surfaces", counts.surfaces}};
    const std::scoped_lock lock(status_mutex);
    status = std::move(now);
  }

  const OpenIgtLinkOptions options;
  asio::io_context io{1};
  openigtlink::PeerContext context;
  std::optional<tcp::acceptor> acceptor;
  std::uint16_t port = 0;
  asio::steady_timer clock{io};
  openigtlink::SurfaceSender::Peers peers;
  openigtlink::SurfaceSender surfaces;
  mutable std::mutex status_mutex;
  NetworkStatus status;  // guarded by status_mutex
  std::thread thread;
};

OpenIgtLinkInput::OpenIgtLinkInput(PoseSources& sources, OpenIgtLinkOptions options, SurfaceFeed surfaces)
    : impl_(std::make_unique<Impl>(sources, std::move(options), std::move(surfaces))) {}

OpenIgtLinkInput::~OpenIgtLinkInput() {
  stop();
}

void OpenIgtLinkInput::start() {
  impl_->start();
}

void OpenIgtLinkInput::stop() {
  impl_->stop();
}

std::uint16_t OpenIgtLinkInput::port() const {
  return impl_->port;
}

NetworkStatus OpenIgtLinkInput::status() const {
  const std::scoped_lock lock(impl_->status_mutex);
  return impl_->status;
}

}  // namespace incise::input
