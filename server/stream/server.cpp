#include "server/stream/server.hpp"

#include <sys/eventfd.h>
#include <unistd.h>

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <chrono>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <variant>

#include "server/base/check.hpp"
#include "server/base/thread_name.hpp"
#include "server/stream/handoff_queue.hpp"
#include "server/stream/http.hpp"
#include "server/stream/pause.hpp"
#include "server/stream/peers.hpp"
#include "server/stream/ports.hpp"

namespace incise::stream {
namespace {

using asio::ip::tcp;
using boost::system::error_code;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr int kMaxAtOnce = 256;  // taken from the queue before peers get their deltas

// What the loop hands over.
using Published =
    std::variant<std::monostate, std::shared_ptr<const PublishedDelta>, std::shared_ptr<const ReceivedDelta>,
                 std::shared_ptr<const InitialState>, NewFieldValues, protocol::Force>;

}  // namespace

struct Server::Impl {
  Impl(std::unique_ptr<Ports> given, ServerFacts facts, const InitialState& initial, PeerInput& input,
       Providers providers)
      : ports(std::move(given)),
        files(config.viewer_directory),
        event_fd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
        wake(io),
        context(io, config, std::move(facts), input, std::move(providers)),
        admission(config, context.counters),
        peers(context) {
    if (event_fd < 0) throw std::system_error(errno, std::generic_category(), "eventfd");
    wake.assign(event_fd);
    ports->listen();
    if (tcp_acceptor) tcp_port = tcp_acceptor->local_endpoint().port();
    if (http_acceptor) http_port = http_acceptor->local_endpoint().port();
    peers.reset(std::make_shared<const InitialState>(initial));
  }

  // ---- The loop's side ----

  void publish(Published what) {
    queue.push(std::move(what));
    if (!awake.exchange(true)) {
      const std::uint64_t one = 1;
      // It fails only when the counter is full, and then the reader is awake.
      [[maybe_unused]] const auto written = ::write(event_fd, &one, sizeof one);
    }
  }

  // ---- The stream thread ----

  void drain() {
    // First, so that one who pushes after our last look at the queue finds the flag down and wakes us again.
    awake.exchange(false);
    Published what;
    bool moved = false;
    for (int popped = 0; popped < kMaxAtOnce && queue.pop(what); ++popped) {
      if (const auto* delta = std::get_if<std::shared_ptr<const PublishedDelta>>(&what)) {
        moved = true;
        peers.apply(*delta);
      } else if (const auto* received = std::get_if<std::shared_ptr<const ReceivedDelta>>(&what)) {
        moved = true;
        peers.apply(*received);
      } else if (auto* values = std::get_if<NewFieldValues>(&what)) {
        moved = true;
        context.live.set_field(std::move(*values));
      } else if (const auto* force = std::get_if<protocol::Force>(&what)) {
        peers.send_force(*force);
      } else {
        peers.reset(std::get<std::shared_ptr<const InitialState>>(std::move(what)));
      }
      what = {};  // releases the delta
    }
    if (moved) peers.advance_all();
    // Through the io_context, so that peers are read in between.
    if (queue.size() > 0 && !awake.exchange(true)) asio::post(io, [this] { drain(); });
  }

  void wait_for_work() {
    wake.async_read_some(asio::buffer(&wake_count, sizeof wake_count), [this](error_code error, std::size_t) {
      if (error == asio::error::operation_aborted) return;
      drain();
      wait_for_work();
    });
  }

  // With TLS if there is a certificate. Nothing if the client's handshake fails.
  asio::awaitable<std::optional<NetStream>> secure(NetStream::Tcp tcp) {
    if (!tls) co_return NetStream(std::move(tcp));
    NetStream stream(std::move(tcp), *tls);
    stream.tcp().expires_after(
        std::chrono::milliseconds(static_cast<std::int64_t>(config.handshake_timeout_s * 1000)));
    const error_code ec = co_await stream.secure(asio::ssl::stream_base::server);
    if (ec) co_return std::nullopt;
    co_return std::move(stream);
  }

  asio::awaitable<void> serve(NetStream::Tcp tcp, Ticket ticket, bool web) {
    std::optional<NetStream> stream = co_await secure(std::move(tcp));
    if (!stream) co_return;
    if (web) {
      co_await serve_http(context, peers, files, std::move(*stream), std::move(ticket));
      co_return;
    }
    const auto peer =
        std::make_shared<Peer>(context, peers, make_tcp_transport(std::move(*stream)), std::move(ticket));
    co_await peer->run();
  }

  asio::awaitable<void> accept(tcp::acceptor& acceptor, bool web) {
    for (;;) {
      auto [ec, socket] = co_await acceptor.async_accept(kTuple);
      if (ec == asio::error::operation_aborted || !acceptor.is_open()) co_return;
      if (ec) {
        // Out of descriptors, most likely. The connected peers go on, and some will leave.
        co_await pause(std::chrono::milliseconds(100));
        continue;
      }
      std::optional<Ticket> ticket = admission.admit(socket);
      if (!ticket) continue;  // the socket closes here
      socket.set_option(tcp::no_delay(true), ec);
      // A failure ends that connection only.
      asio::co_spawn(io, serve(NetStream::Tcp(std::move(socket)), std::move(*ticket), web),
                     [](std::exception_ptr) {});
    }
  }

  void start() {
    INCISE_CHECK(!thread.joinable());
    // The first client finds everything published by now.
    while (queue.size() > 0) drain();
    if (tcp_acceptor) asio::co_spawn(io, accept(*tcp_acceptor, false), asio::detached);
    if (http_acceptor) asio::co_spawn(io, accept(*http_acceptor, true), asio::detached);
    wait_for_work();
    peers.start_clock();
    thread = std::thread([this] {
      name_thread("stream");
      io.run();
    });
  }

  void stop() {
    if (!thread.joinable()) return;
    asio::post(io, [this] {
      error_code ignored;
      if (tcp_acceptor) tcp_acceptor->close(ignored);
      if (http_acceptor) http_acceptor->close(ignored);
      while (queue.size() > 0) drain();
      wake.cancel(ignored);
      admission.stop();
      peers.finish_all();
      const auto deadline = std::chrono::steady_clock::now() +
                            std::chrono::milliseconds(static_cast<std::int64_t>(config.stop_grace_s * 1000));
      wait_for_goodbyes(deadline);
    });
    thread.join();
  }

  // Ends the thread's work once every peer has gone or the grace is over. Other connections (HTTP, and those before
  // Hello) have nothing to lose.
  void wait_for_goodbyes(std::chrono::steady_clock::time_point deadline) {
    if (peers.empty() || std::chrono::steady_clock::now() >= deadline) {
      peers.close_all();
      io.stop();
      return;
    }
    stop_timer.expires_after(std::chrono::milliseconds(5));
    stop_timer.async_wait([this, deadline](error_code) { wait_for_goodbyes(deadline); });
  }

  void request_state(protocol::View view, const std::function<void(WholeState)>& ready) {
    const Feed& live = context.live;
    WholeState state;
    state.epoch = live.mirror().epoch();
    state.fields_set = live.times_fields_set();
    protocol::Welcome welcome = context.welcome_to(live);
    welcome.role = protocol::Role::Viewer;
    welcome.view = view;
    welcome.session = session_name(state.epoch, view, false, {});
    state.frames.push_back(make_frame(std::move(welcome)));
    context.live.request_snapshot(
        view, std::nullopt, view == protocol::View::Volume,
        [this, view, ready, state](const std::shared_ptr<const Snapshot>& snapshot) mutable {
          if (snapshot->epoch != state.epoch) {
            request_state(view, ready);  // there was a reset meanwhile
            return;
          }
          state.revision = snapshot->begin.revision;
          protocol::SnapshotBegin begin = snapshot->begin;
          std::vector<std::uint32_t> fields(snapshot->fields.size());
          std::iota(fields.begin(), fields.end(), 0u);
          begin.fields = fields;
          state.frames.push_back(make_frame(begin));
          state.frames.insert(state.frames.end(), snapshot->chunks.begin(), snapshot->chunks.end());
          for (const auto& values : snapshot->fields)
            state.frames.insert(state.frames.end(), values->begin(), values->end());
          state.frames.push_back(snapshot->end);
          ready(std::move(state));
        });
  }

  const std::unique_ptr<Ports> ports;
  const StreamConfig& config = ports->config;
  asio::io_context& io = ports->io;
  std::optional<asio::ssl::context>& tls = ports->tls;
  std::optional<tcp::acceptor>&tcp_acceptor = ports->tcp_acceptor, &http_acceptor = ports->http_acceptor;
  const StaticFiles files;
  int event_fd;
  asio::posix::stream_descriptor wake;  // owns event_fd
  std::uint64_t wake_count = 0;
  std::atomic<bool> awake{false};
  HandoffQueue<Published> queue;
  std::uint16_t tcp_port = 0, http_port = 0;
  asio::steady_timer stop_timer{io};
  PeerContext context;
  Admission admission;
  Peers peers;
  std::thread thread;
};

Server::Server(StreamConfig config, ServerFacts facts, const InitialState& initial, PeerInput& input,
               Providers providers)
    : Server(std::make_unique<Ports>(std::move(config)), std::move(facts), initial, input,
             std::move(providers)) {}

Server::Server(std::unique_ptr<Ports> ports, ServerFacts facts, const InitialState& initial, PeerInput& input,
               Providers providers)
    : impl_(
          std::make_unique<Impl>(std::move(ports), std::move(facts), initial, input, std::move(providers))) {}

Server::~Server() {
  stop();
}

void Server::start() {
  impl_->start();
}
void Server::stop() {
  impl_->stop();
}

void Server::publish(std::shared_ptr<const PublishedDelta> delta) noexcept {
  impl_->publish(std::move(delta));
}
void Server::publish(std::shared_ptr<const ReceivedDelta> delta) noexcept {
  impl_->publish(std::move(delta));
}
void Server::publish_field(NewFieldValues values) noexcept {
  impl_->publish(std::move(values));
}
void Server::publish_reset(std::shared_ptr<const InitialState> initial) noexcept {
  impl_->publish(std::move(initial));
}
void Server::publish_force(const protocol::Force& force) noexcept {
  impl_->publish(force);
}

void Server::request_surface(std::function<void(SharedFrames)> ready) {
  asio::post(impl_->io, [impl = impl_.get(), ready = std::move(ready)] {
    const auto unpack = [ready](const std::shared_ptr<const Snapshot>& snapshot) {
      SharedFrames frames{make_frame(snapshot->begin)};
      frames.insert(frames.end(), snapshot->chunks.begin(), snapshot->chunks.end());
      frames.push_back(snapshot->end);
      ready(std::move(frames));
    };
    impl->context.live.request_snapshot(protocol::View::Surface, std::nullopt, false, unpack);
  });
}

void Server::request_state(protocol::View view, std::function<void(WholeState)> ready) {
  asio::post(impl_->io,
             [impl = impl_.get(), view, ready = std::move(ready)] { impl->request_state(view, ready); });
}

std::uint16_t Server::tcp_port() const {
  return impl_->tcp_port;
}
std::uint16_t Server::http_port() const {
  return impl_->http_port;
}

StreamCounters Server::counters() const {
  StreamCounters out = impl_->context.counters->read();
  out.queued = impl_->queue.size();
  return out;
}

}  // namespace incise::stream
