#include "server/input/openigtlink/openigtlink_input.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <chrono>
#include <deque>
#include <map>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <utility>

#include "protocol/net/net_stream.hpp"
#include "server/base/clock.hpp"
#include "server/input/limited_log.hpp"
#include "server/input/openigtlink/message.hpp"
#include "server/input/openigtlink/surface_message.hpp"

namespace incise::input {
namespace {

namespace asio = boost::asio;
namespace link = openigtlink;
using asio::ip::tcp;
using boost::system::error_code;
using SharedBytes = std::shared_ptr<const std::vector<std::uint8_t>>;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

constexpr std::size_t kMostPeers = 16;
constexpr std::size_t kMostTools = 32;    // names that one connection may bring
constexpr std::size_t kMostWaiting = 64;  // messages for one peer
constexpr std::uint64_t kMostSkipped = std::uint64_t{1}
                                       << 30;  // bytes of a message that is not ours, such as an image
constexpr int kMostFaults = 32;                // in a row: then the peer speaks something else
constexpr std::int64_t kSecond_ns = 1'000'000'000, kWriteTime_ns = 30 * kSecond_ns;
constexpr std::chrono::milliseconds kTick{20};
constexpr std::chrono::seconds kConnectTime{5}, kRetry{2};
constexpr const char* kDeviceName = "Incise";

struct Counts {
  std::uint64_t connections = 0, messages = 0, poses = 0, skipped = 0, bad_headers = 0, bad_crc = 0,
                bad_shape = 0, bad_values = 0, stretched = 0, no_blade = 0, clock_restarts = 0, refused = 0,
                unfinished = 0, surfaces = 0;
};

// A device name of one connection.
struct Tool {
  std::optional<PoseSource> source;
  bool engaged = true;
  bool waiting = false;  // for room in the queue
  std::int64_t released_ns = 0;
  std::int64_t arrival_ns = 0;  // of the last pose; 0: there was none
  std::int64_t source_ns = 0;   // of the last pose
  std::int64_t offset_ns = 0;   // from the peer's clock to source time

  void release() {
    if (source) released_ns = monotonic_ns();
    source.reset();
  }
};

// Source time of a pose: the peer's clock, where it gives one. A clock that was set back goes on from where it was.
std::int64_t source_time(Tool& tool, std::int64_t stamp_ns, std::int64_t arrival_ns, Counts& counts) {
  const std::int64_t passed = std::max<std::int64_t>(arrival_ns - tool.arrival_ns, 1);
  if (stamp_ns == 0) return tool.arrival_ns == 0 ? arrival_ns : tool.source_ns + passed;
  if (tool.arrival_ns != 0 && stamp_ns + tool.offset_ns < tool.source_ns - kSecond_ns) {
    tool.offset_ns = tool.source_ns + passed - stamp_ns;
    ++counts.clock_restarts;
  }
  return stamp_ns + tool.offset_ns;
}

std::string text_of(const error_code& error) {
  return error == asio::error::eof ? "the peer has closed it" : error.message();
}

}  // namespace

// All but the constructor, stop(), status() and what SurfaceFeed calls runs on thread_.
struct OpenIgtLinkInput::Impl {
  // One connection.
  struct Peer : std::enable_shared_from_this<Peer> {
    Peer(Impl& of, boost::beast::tcp_stream connected, std::string peer_name)
        : owner(of), stream(std::move(connected)), name(std::move(peer_name)) {
      streaming = owner.options.surface == "always";
    }

    Impl& owner;
    boost::beast::tcp_stream stream;
    const std::string name;
    std::map<std::string, Tool> tools;
    std::deque<SharedBytes> outbox;  // the first is being written
    std::int64_t write_began_ns = 0;
    bool closed = false;
    int faults = 0;
    std::int64_t part_began_ns = 0;  // since when the rest of a message is waited for; 0: it is not
    // What it wants of the surface, and what it got.
    bool streaming = false, wants_one = false;
    std::int64_t interval_ns = 0, sent_ns = 0;
    std::uint64_t sent_state = 0;
    bool sent_any = false;

    void close() {
      closed = true;
      error_code ignored;
      stream.socket().close(ignored);
    }

    // ---- Out ----

    void send(SharedBytes bytes) {
      if (closed) return;
      if (outbox.size() >= kMostWaiting) {
        owner.log(owner.faults, spdlog::level::warn, name, "  asks, and does not read: it is let go");
        close();
        return;
      }
      outbox.push_back(std::move(bytes));
      if (outbox.size() == 1) write();
    }
    void write() {
      write_began_ns = monotonic_ns();
      asio::async_write(stream, asio::buffer(*outbox.front()),
                        [peer = shared_from_this()](error_code error, std::size_t) {
                          if (error || peer->closed) return peer->close();
                          peer->outbox.pop_front();
                          if (!peer->outbox.empty()) peer->write();
                        });
    }
    void send(const char* type, std::span<const std::uint8_t> body) {
      send(std::make_shared<const std::vector<std::uint8_t>>(link::encode(type, kDeviceName, 0, body)));
    }
    // Whether a surface is due.
    bool wants_surface(std::uint64_t state, std::int64_t now) const {
      if (closed || !outbox.empty() || now - sent_ns < owner.surface_interval_ns()) return false;
      if (wants_one) return true;
      return streaming && now - sent_ns >= interval_ns && (!sent_any || state != sent_state);
    }

    // ---- In ----

    asio::awaitable<void> run() {
      std::array<std::uint8_t, link::kHeaderBytes> head{};
      std::vector<std::uint8_t> body;
      std::string why;
      while (why.empty()) {
        // The first byte may take as long as it likes.
        const auto [error, begun] = co_await stream.async_read_some(asio::buffer(head), kTuple);
        if (error) {
          why = text_of(error);
          break;
        }
        why = co_await read_part(std::span(head).subspan(begun));
        if (!why.empty()) break;
        const auto header = link::read_header(head, why);
        if (!header) {
          ++owner.counts.bad_headers;
          break;
        }
        ++owner.counts.messages;
        if (link::kind_of(header->type) == link::Kind::kOther) {
          why = co_await skip(header->type, header->body_bytes);
          continue;
        }
        if (header->body_bytes > link::kMaxBodyBytes) {
          ++owner.counts.bad_shape;
          why = header->type + " of " + std::to_string(header->body_bytes) + " bytes, accepted are " +
                std::to_string(link::kMaxBodyBytes);
          break;
        }
        body.resize(header->body_bytes);
        why = co_await read_part(body);
        if (!why.empty()) break;
        co_await handle_body(*header, body);
        if (faults >= kMostFaults) why = std::to_string(faults) + " bad messages in a row";
      }
      tools.clear();
      if (!closed) close();
      owner.log(owner.events, spdlog::level::info, name, ": connection ended: " + why);
    }

    // Reads the rest of what has begun, which tick() gives a deadline. Empty, or why the connection must end.
    asio::awaitable<std::string> read_part(std::span<std::uint8_t> part) {
      part_began_ns = monotonic_ns();
      const auto [error, bytes] =
          co_await asio::async_read(stream, asio::buffer(part.data(), part.size()), kTuple);
      const bool late = std::exchange(part_began_ns, 0) < 0;
      if (late) co_return "it began a message and did not send the rest";
      co_return error ? text_of(error) : std::string();
    }

    // A message that is not for us. Empty, or why the connection must end.
    asio::awaitable<std::string> skip(const std::string& type, std::uint64_t bytes) {
      ++owner.counts.skipped;
      if (bytes > kMostSkipped) co_return type + " of " + std::to_string(bytes) + " bytes";
      std::vector<std::uint8_t> scrap(static_cast<std::size_t>(std::min<std::uint64_t>(bytes, 64 * 1024)));
      while (bytes > 0) {
        const auto part = static_cast<std::size_t>(std::min<std::uint64_t>(bytes, scrap.size()));
        std::string why = co_await read_part(std::span(scrap).first(part));
        if (!why.empty()) co_return why;
        bytes -= part;
      }
      co_return std::string();
    }

    void fault(const link::Decoded& decoded) {
      ++faults;
      ++(decoded.fault == link::Fault::kCrc     ? owner.counts.bad_crc
         : decoded.fault == link::Fault::kShape ? owner.counts.bad_shape
                                                : owner.counts.bad_values);
      owner.log(owner.faults, spdlog::level::warn, name, ": message ignored: " + decoded.error);
    }

    asio::awaitable<void> handle_body(const link::Header& header, std::span<const std::uint8_t> body) {
      const std::int64_t arrival_ns = monotonic_ns();
      const link::Decoded decoded = link::decode(header, body);
      if (!decoded.message) {
        fault(decoded);
        co_return;
      }
      faults = 0;
      const link::Message& message = *decoded.message;
      switch (message.kind) {
        case link::Kind::kPoses:
          note_bad_tools(message, header.device);
          for (const link::ToolPose& pose : message.tools) {
            co_await enqueue(pose, link::timestamp_ns(header), arrival_ns);
          }
          break;
        case link::Kind::kText:
          engage(header.device, message.text);
          break;
        case link::Kind::kStatus:
          // The device is out of sight, or off: what the codes above 1 have in common.
          if (message.status != 1) release(header.device);
          break;
        case link::Kind::kGetSurface:
          wants_one = owner.options.surface != "never";
          break;
        case link::Kind::kStartSurface:
        case link::Kind::kStopSurface: {
          const bool offered = owner.options.surface != "never";
          streaming = offered && message.kind == link::Kind::kStartSurface;
          interval_ns = std::int64_t{message.interval_ms} * 1'000'000;
          sent_any = false;
          const std::uint8_t status = offered ? 0 : 1;
          send("RTS_POLYDATA", std::span(&status, 1));
          break;
        }
        case link::Kind::kOther:
          break;
      }
    }

    void note_bad_tools(const link::Message& message, const std::string& device) {
      owner.counts.bad_values += message.bad_tools;
      owner.counts.stretched += message.stretched;
      if (message.bad_tools > 0) {
        owner.log(owner.faults, spdlog::level::warn, name,
                  ": tools ignored whose numbers are no pose, of device " + device);
      } else if (message.stretched > 0) {
        owner.log(owner.faults, spdlog::level::warn, name,
                  ": a matrix of device " + device + " is no rotation; one near it is taken");
      }
    }

    // The device's state in this connection; null where it is not to be taken.
    Tool* tool_of(const std::string& device) {
      const auto& accepted = owner.options.devices;
      const bool known = tools.contains(device);
      if (!known &&
          ((!accepted.empty() && std::find(accepted.begin(), accepted.end(), device) == accepted.end()) ||
           tools.size() >= kMostTools)) {
        ++owner.counts.refused;
        return nullptr;
      }
      Tool& tool = tools[device];
      if (!known) tool.engaged = owner.options.engage == "always";
      return &tool;
    }

    // "NAME" and "NAME_engage" are the same device: nodes of a scene like to have names of their own.
    void engage(std::string device, const std::string& text) {
      if (owner.options.engage != "string") return;
      constexpr std::string_view kSuffix = "_engage";
      if (device.ends_with(kSuffix)) device.resize(device.size() - kSuffix.size());
      Tool* const tool = tool_of(device);
      if (!tool) return;
      tool->engaged = text == "1" || text == "true" || text == "on" || text == "engaged";
      // At once, for a peer may send poses only when they change.
      if (!tool->engaged && tool->source) tool->source->end_stroke(monotonic_ns());
    }

    void release(const std::string& device) {
      if (const auto found = tools.find(device); found != tools.end()) found->second.release();
    }

    asio::awaitable<void> pause() {
      asio::steady_timer timer(owner.io, std::chrono::milliseconds(1));
      co_await timer.async_wait(kTuple);
    }

    asio::awaitable<void> enqueue(const link::ToolPose& pose, std::int64_t stamp_ns,
                                  std::int64_t arrival_ns) {
      Tool* const tool = tool_of(pose.name);
      if (!tool) co_return;
      if (!tool->source) {
        // What was let go a moment ago is free when the loop has seen that.
        while (!(tool->source = owner.sources.open(pose.name)) &&
               monotonic_ns() - tool->released_ns < kSecond_ns / 4) {
          co_await pause();
        }
        if (!tool->source) {
          ++owner.counts.no_blade;
          owner.log(owner.faults, spdlog::level::warn, name,
                    ": no blade for device " + pose.name + ": it is taken, or all " +
                        std::to_string(core::kMaxSources) + " are");
          co_return;
        }
        tool->arrival_ns = tool->offset_ns = 0;
      }
      TimedPose timed;
      timed.arrival_ns = arrival_ns;
      timed.pose.t_ns = source_time(*tool, stamp_ns, arrival_ns, owner.counts);
      timed.pose.position = world_from_device(owner.options.world, pose.position);
      timed.pose.orientation = world_from_device(owner.options.world, pose.orientation);
      timed.pose.buttons = tool->engaged ? owner.options.engage_buttons : 0;
      tool->arrival_ns = arrival_ns;
      tool->source_ns = timed.pose.t_ns;
      ++owner.counts.poses;
      // A full queue: the loop is far behind. The rest waits in the socket.
      while (tool->source && !closed && tool->source->enqueue(std::span(&timed, 1)) == 0) {
        tool->waiting = true;
        co_await pause();
      }
      if (tool->waiting) tool->arrival_ns = monotonic_ns();
      tool->waiting = false;
    }
  };

  // Between what calls back with surfaces, whenever it likes, and the end of this.
  struct Mailbox {
    std::mutex mutex;
    Impl* impl = nullptr;  // guarded by mutex; null: too late
  };

  Impl(PoseSources& of, OpenIgtLinkOptions given, SurfaceFeed feed)
      : sources(of), options(std::move(given)), surfaces(std::move(feed)) {
    mailbox->impl = this;
    if (options.port >= 0) listen();
    if (acceptor) asio::co_spawn(io, accept(), asio::detached);
    for (const std::string& place : options.connect)
      asio::co_spawn(io, keep_connected(place), asio::detached);
    tick();
    thread = std::thread([this] { io.run(); });
  }

  void listen() {
    try {
      const tcp::endpoint endpoint(asio::ip::make_address(options.address),
                                   static_cast<std::uint16_t>(options.port));
      acceptor.emplace(io, endpoint);
      port = acceptor->local_endpoint().port();
    } catch (const boost::system::system_error& error) {
      throw std::runtime_error("openigtlink: cannot listen on " + options.address + ":" +
                               std::to_string(options.port) + ": " + error.code().message());
    }
  }

  void stop() {
    {
      const std::scoped_lock lock(mailbox->mutex);
      mailbox->impl = nullptr;
    }
    if (!thread.joinable()) return;
    packer.join();
    io.stop();
    thread.join();
    for (const auto& peer : peers) peer->tools.clear();
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
      if (peers.size() >= kMostPeers) {
        ++counts.refused;
        log(faults, spdlog::level::warn, name,
            "  refused: " + std::to_string(kMostPeers) + " peers are connected");
        continue;  // the socket closes here
      }
      asio::co_spawn(io, serve(boost::beast::tcp_stream(std::move(socket)), name, false),
                     [](std::exception_ptr) {});
    }
  }

  // `ask`: for poses, where the configuration says so.
  asio::awaitable<void> serve(boost::beast::tcp_stream stream, std::string name, bool ask) {
    error_code ignored;
    stream.socket().set_option(tcp::no_delay(true), ignored);
    // A peer that vanishes without a word.
    stream.socket().set_option(asio::socket_base::keep_alive(true), ignored);
    const auto peer = std::make_shared<Peer>(*this, std::move(stream), std::move(name));
    peers.insert(peer);
    ++counts.connections;
    log(events, spdlog::level::info, peer->name, "  connected");
    if (ask && options.ask_for != "nothing") {
      // A frame each millisecond at most (0 would mean: as fast as it can), in its own coordinates.
      std::vector<std::uint8_t> body(36);
      body[3] = 1;
      peer->send(options.ask_for == "TDATA" ? "STT_TDATA" : "STT_QTDATA", body);
    }
    try {
      co_await peer->run();
    } catch (const std::exception& error) {
      log(faults, spdlog::level::err, peer->name, ": " + error.what());
      peer->tools.clear();
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

  // A line about the peer "address:port", limited with all of its address.
  static void log(LimitedLog& limited, spdlog::level::level_enum level, const std::string& peer,
                  const std::string& line) {
    limited.write(level, peer.substr(0, peer.rfind(':')), "openigtlink: " + peer + line, monotonic_ns());
  }

  void tick() {
    const std::int64_t now = monotonic_ns();
    events.flush(now);
    faults.flush(now);
    const auto message_time_ns = static_cast<std::int64_t>(options.message_time_s * 1e9);
    for (const auto& peer : peers) {
      for (auto& [name, tool] : peer->tools) {
        const bool silent = static_cast<double>(now - tool.arrival_ns) * 1e-9 > options.silence_s;
        if (tool.source && !tool.waiting && silent) tool.release();
      }
      if (peer->part_began_ns > 0 && now - peer->part_began_ns > message_time_ns) {
        ++counts.unfinished;
        peer->part_began_ns = -1;
        peer->close();
      }
      if (!peer->outbox.empty() && now - peer->write_began_ns > kWriteTime_ns) {
        log(faults, spdlog::level::warn, peer->name, "  does not read: it is let go");
        peer->close();
      }
    }
    offer_surface(now);
    publish();
    clock.expires_after(kTick);
    clock.async_wait([this](error_code error) {
      if (!error) tick();
    });
  }

  void publish() {
    NetworkStatus status{"openigtlink", {}, {}};
    for (const std::string& place : options.connect) status.peers.push_back({place, false, {}});
    for (const auto& peer : peers) {
      auto entry = std::find_if(status.peers.begin(), status.peers.end(),
                                [&](const NetworkStatus::Peer& p) { return p.name == peer->name; });
      if (entry == status.peers.end()) entry = status.peers.insert(entry, {peer->name, false, {}});
      entry->connected = !peer->closed;
      for (const auto& [name, tool] : peer->tools) {
        if (tool.source) entry->sources.push_back(name);
      }
    }
    status.counts = {{"connections", counts.connections},
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
    told = std::move(status);
  }

  // ---- The surface ----

  std::int64_t surface_interval_ns() const { return static_cast<std::int64_t>(1e9 / options.surface_hz); }

  void offer_surface(std::int64_t now) {
    const std::uint64_t state = surfaces.state();
    const bool current = surface && surface_state == state;
    bool wanted = false;
    for (const auto& peer : peers) {
      if (!peer->wants_surface(state, now)) continue;
      if (current) {
        send_surface(*peer, now);
      } else {
        wanted = true;
      }
    }
    // Where the mesh changes all the time, what is made is a little behind, and goes out all the same.
    if (!wanted || making || now - made_ns < surface_interval_ns()) return;
    making = true;
    made_ns = now;
    surfaces.request([box = mailbox, state](SurfaceFeed::Frames frames) {
      const std::scoped_lock lock(box->mutex);
      if (!box->impl) return;
      asio::post(box->impl->packer,
                 [impl = box->impl, frames = std::move(frames), state] { impl->pack(frames, state); });
    });
  }

  // Thread: the packer's.
  void pack(const SurfaceFeed::Frames& frames, std::uint64_t state) {
    std::string error;
    SharedBytes bytes;
    if (const auto whole = link::surface_of(frames, error)) {
      bytes = std::make_shared<const std::vector<std::uint8_t>>(
          link::pack_surface(*whole, options.world, kDeviceName));
    }
    asio::post(io, [this, bytes, state, error] {
      making = false;
      if (!bytes) {
        faults.write(spdlog::level::err, "", "openigtlink: no surface: " + error, monotonic_ns());
        return;
      }
      surface = bytes;
      surface_state = state;
      const std::int64_t now = monotonic_ns();
      for (const auto& peer : peers) {
        if (peer->wants_surface(state, now)) send_surface(*peer, now);
      }
    });
  }

  void send_surface(Peer& peer, std::int64_t now) {
    peer.wants_one = false;
    peer.sent_any = true;
    peer.sent_ns = now;
    peer.sent_state = surface_state;
    ++counts.surfaces;
    peer.send(surface);
  }

  PoseSources& sources;
  const OpenIgtLinkOptions options;
  const SurfaceFeed surfaces;
  asio::io_context io{1};
  asio::thread_pool packer{1};
  std::optional<tcp::acceptor> acceptor;
  std::uint16_t port = 0;
  asio::steady_timer clock{io};
  std::set<std::shared_ptr<Peer>> peers;
  Counts counts;
  LimitedLog events, faults;
  // The last surface that was packed, of the state when it was asked for or a later one.
  SharedBytes surface;
  std::uint64_t surface_state = 0;
  bool making = false;
  std::int64_t made_ns = 0;
  const std::shared_ptr<Mailbox> mailbox = std::make_shared<Mailbox>();
  mutable std::mutex status_mutex;
  NetworkStatus told;  // guarded by status_mutex
  std::thread thread;
};

OpenIgtLinkInput::OpenIgtLinkInput(PoseSources& sources, OpenIgtLinkOptions options, SurfaceFeed surfaces)
    : impl_(std::make_unique<Impl>(sources, std::move(options), std::move(surfaces))) {}

OpenIgtLinkInput::~OpenIgtLinkInput() {
  stop();
}

void OpenIgtLinkInput::stop() {
  impl_->stop();
}

std::uint16_t OpenIgtLinkInput::port() const {
  return impl_->port;
}

NetworkStatus OpenIgtLinkInput::status() const {
  const std::scoped_lock lock(impl_->status_mutex);
  return impl_->told;
}

}  // namespace incise::input
