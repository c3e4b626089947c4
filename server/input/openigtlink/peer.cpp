#include "server/input/openigtlink/peer.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/asio/write.hpp>
#include <chrono>
#include <utility>

#include "server/base/clock.hpp"

namespace incise::input::openigtlink {
namespace {

namespace asio = boost::asio;
using boost::system::error_code;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

constexpr std::size_t kMaxTools = 32;    // device names of one connection
constexpr std::size_t kMaxWaiting = 64;  // messages to one peer
constexpr std::uint64_t kMaxSkippedBytes = std::uint64_t{1}
                                           << 30;  // of a message that is not for us, such as an image
constexpr int kMaxFaults = 32;                     // in a row: after that the peer speaks something else
constexpr std::int64_t kSecond_ns = 1'000'000'000, kWriteTime_ns = 30 * kSecond_ns;

std::string text_of(const error_code& error) {
  return error == asio::error::eof ? "the peer closed it" : error.message();
}

}  // namespace

void Tool::release() {
  if (source) released_ns = monotonic_ns();
  source.reset();
}

Peer::Peer(PeerContext& context, boost::beast::tcp_stream stream, std::string name)
    : context_(context),
      stream_(std::move(stream)),
      name_(std::move(name)),
      streaming_(context.options.surface == "always") {}

std::vector<std::string> Peer::sources() const {
  std::vector<std::string> names;
  for (const auto& [name, tool] : tools_) {
    if (tool.source) names.push_back(name);
  }
  return names;
}

void Peer::close() {
  closed_ = true;
  error_code ignored;
  stream_.socket().close(ignored);
}

void Peer::check_deadlines(std::int64_t now_ns) {
  for (auto& [name, tool] : tools_) {
    const bool silent = static_cast<double>(now_ns - tool.arrival_ns) * 1e-9 > context_.options.silence_s;
    if (tool.source && !tool.waiting && silent) tool.release();
  }
  const auto message_time_ns = static_cast<std::int64_t>(context_.options.message_time_s * 1e9);
  if (part_began_ns_ > 0 && now_ns - part_began_ns_ > message_time_ns) {
    ++context_.counts.unfinished;
    part_began_ns_ = -1;
    close();
  }
  if (!outbox_.empty() && now_ns - write_began_ns_ > kWriteTime_ns) {
    context_.log_fault(spdlog::level::warn, name_, " does not read: connection closed");
    close();
  }
}

// ------------------------------------------------------------------------------------------------ writing

void Peer::send(SharedBytes bytes) {
  if (closed_) return;
  if (outbox_.size() >= kMaxWaiting) {
    context_.log_fault(spdlog::level::warn, name_, " sends requests and does not read: connection closed");
    close();
    return;
  }
  outbox_.push_back(std::move(bytes));
  if (outbox_.size() == 1) write();
}

void Peer::send(const char* type, std::span<const std::uint8_t> body) {
  send(std::make_shared<const std::vector<std::uint8_t>>(encode(type, kDeviceName, 0, body)));
}

void Peer::write() {
  write_began_ns_ = monotonic_ns();
  asio::async_write(stream_, asio::buffer(*outbox_.front()),
                    [peer = shared_from_this()](error_code error, std::size_t) {
                      if (error || peer->closed_) return peer->close();
                      peer->outbox_.pop_front();
                      if (!peer->outbox_.empty()) peer->write();
                    });
}

bool Peer::wants_surface(std::uint64_t state, std::int64_t now_ns) const {
  if (closed_ || !outbox_.empty() || now_ns - sent_ns_ < context_.surface_interval_ns()) return false;
  if (wants_one_) return true;
  return streaming_ && now_ns - sent_ns_ >= interval_ns_ && (!sent_any_ || state != sent_state_);
}

void Peer::send_surface(const SharedBytes& surface, std::uint64_t state, std::int64_t now_ns) {
  wants_one_ = false;
  sent_any_ = true;
  sent_ns_ = now_ns;
  sent_state_ = state;
  ++context_.counts.surfaces;
  send(surface);
}

// ------------------------------------------------------------------------------------------------ reading

asio::awaitable<void> Peer::run() {
  std::string why;
  while (why.empty()) why = co_await read_message();
  tools_.clear();
  if (!closed_) close();
  context_.log_event(name_, ": connection ended: " + why);
}

// Empty, or why the connection must end.
asio::awaitable<std::string> Peer::read_message() {
  std::array<std::uint8_t, kHeaderBytes> head{};
  // The first byte may take as long as it likes.
  const auto [error, begun] = co_await stream_.async_read_some(asio::buffer(head), kTuple);
  if (error) co_return text_of(error);
  std::string why = co_await read_part(std::span(head).subspan(begun));
  if (!why.empty()) co_return why;
  const auto header = read_header(head, why);
  if (!header) {
    ++context_.counts.bad_headers;
    co_return why;
  }
  ++context_.counts.messages;
  if (kind_of(header->type) == Kind::kOther) co_return co_await skip(header->type, header->body_bytes);
  if (header->body_bytes > kMaxBodyBytes) {
    ++context_.counts.bad_shape;
    co_return header->type + " of " + std::to_string(header->body_bytes) + " bytes, accepted are " +
        std::to_string(kMaxBodyBytes);
  }
  body_.resize(header->body_bytes);
  why = co_await read_part(body_);
  if (!why.empty()) co_return why;
  co_await handle_body(*header);
  if (faults_ >= kMaxFaults) why = std::to_string(faults_) + " bad messages in a row";
  co_return why;
}

// Reads the rest of what has begun; check_deadlines() limits the time. Empty, or why the connection must end.
asio::awaitable<std::string> Peer::read_part(std::span<std::uint8_t> part) {
  part_began_ns_ = monotonic_ns();
  const auto [error, bytes] =
      co_await asio::async_read(stream_, asio::buffer(part.data(), part.size()), kTuple);
  const bool late = std::exchange(part_began_ns_, 0) < 0;
  if (late) co_return "it began a message and did not send the rest";
  co_return error ? text_of(error) : std::string();
}

// Passes over a message that is not for us. Empty, or why the connection must end.
asio::awaitable<std::string> Peer::skip(const std::string& type, std::uint64_t bytes) {
  ++context_.counts.skipped;
  if (bytes > kMaxSkippedBytes) co_return type + " of " + std::to_string(bytes) + " bytes";
  std::vector<std::uint8_t> scrap(static_cast<std::size_t>(std::min<std::uint64_t>(bytes, 64 * 1024)));
  while (bytes > 0) {
    const auto part = static_cast<std::size_t>(std::min<std::uint64_t>(bytes, scrap.size()));
    std::string why = co_await read_part(std::span(scrap).first(part));
    if (!why.empty()) co_return why;
    bytes -= part;
  }
  co_return std::string();
}

asio::awaitable<void> Peer::handle_body(const Header& header) {
  const std::int64_t arrival_ns = monotonic_ns();
  const Decoded decoded = decode(header, body_);
  if (!decoded.message) {
    count_fault(decoded);
    co_return;
  }
  faults_ = 0;
  const Message& message = *decoded.message;
  switch (message.kind) {
    case Kind::kPoses:
      note_bad_tools(message, header.device);
      for (const ToolPose& pose : message.tools) co_await enqueue(pose, timestamp_ns(header), arrival_ns);
      break;
    case Kind::kText:
      engage(header.device, message.text);
      break;
    case Kind::kStatus:
      // All codes above 1 mean that the device is out of sight, or off.
      if (const auto tool = tools_.find(header.device); message.status != 1 && tool != tools_.end())
        tool->second.release();
      break;
    case Kind::kGetSurface:
      wants_one_ = context_.options.surface != "never";
      break;
    case Kind::kStartSurface:
    case Kind::kStopSurface:
      answer_surface_request(message);
      break;
    case Kind::kOther:
      break;
  }
}

void Peer::answer_surface_request(const Message& message) {
  const bool offered = context_.options.surface != "never";
  streaming_ = offered && message.kind == Kind::kStartSurface;
  interval_ns_ = std::int64_t{message.interval_ms} * 1'000'000;
  sent_any_ = false;
  const std::uint8_t status = offered ? 0 : 1;
  send("RTS_POLYDATA", std::span(&status, 1));
}

void Peer::count_fault(const Decoded& decoded) {
  ++faults_;
  ++(decoded.fault == Fault::kCrc     ? context_.counts.bad_crc
     : decoded.fault == Fault::kShape ? context_.counts.bad_shape
                                      : context_.counts.bad_values);
  context_.log_fault(spdlog::level::warn, name_, ": message ignored: " + decoded.error);
}

void Peer::note_bad_tools(const Message& message, const std::string& device) {
  context_.counts.bad_values += message.bad_tools;
  context_.counts.stretched += message.stretched;
  if (message.bad_tools > 0) {
    context_.log_fault(spdlog::level::warn, name_,
                       ": ignored tools of device " + device + " whose numbers are not a pose");
  } else if (message.stretched > 0) {
    context_.log_fault(spdlog::level::warn, name_,
                       ": a matrix of device " + device + " is not a rotation; the nearest rotation is used");
  }
}

// ------------------------------------------------------------------------------------------------ tools

// The tool of that name; null if the configuration or the limit excludes it.
Tool* Peer::tool_of(const std::string& device) {
  const auto& accepted = context_.options.devices;
  const bool known = tools_.contains(device);
  if (!known &&
      ((!accepted.empty() && std::find(accepted.begin(), accepted.end(), device) == accepted.end()) ||
       tools_.size() >= kMaxTools)) {
    ++context_.counts.refused;
    return nullptr;
  }
  Tool& tool = tools_[device];
  if (!known) tool.engaged = context_.options.engage == "always";
  return &tool;
}

// "NAME" and "NAME_engage" mean the same device: in a scene each node has a name of its own.
void Peer::engage(std::string device, const std::string& text) {
  if (context_.options.engage != "string") return;
  constexpr std::string_view kSuffix = "_engage";
  if (device.ends_with(kSuffix)) device.resize(device.size() - kSuffix.size());
  Tool* const tool = tool_of(device);
  if (!tool) return;
  tool->engaged = text == "1" || text == "true" || text == "on" || text == "engaged";
  // Now, not at the next pose: a peer may send poses only when they change.
  if (!tool->engaged && tool->source) tool->source->end_stroke(monotonic_ns());
}

asio::awaitable<void> Peer::pause() {
  asio::steady_timer timer(context_.io, std::chrono::milliseconds(1));
  co_await timer.async_wait(kTuple);
}

asio::awaitable<bool> Peer::open_source(Tool& tool, const std::string& name) {
  // A blade that was just released is free once the loop has seen it.
  while (!(tool.source = context_.sources.open(name)) && monotonic_ns() - tool.released_ns < kSecond_ns / 4)
    co_await pause();
  if (!tool.source) {
    ++context_.counts.no_blade;
    context_.log_fault(spdlog::level::warn, name_,
                       ": no blade for device " + name + ": it is in use, or all " +
                           std::to_string(core::kMaxSources) + " are");
    co_return false;
  }
  tool.arrival_ns = 0;
  tool.clock.begin();
  co_return true;
}

asio::awaitable<void> Peer::enqueue(const ToolPose& pose, std::int64_t stamp_ns, std::int64_t arrival_ns) {
  Tool* const tool = tool_of(pose.name);
  if (!tool) co_return;
  if (!tool->source && !co_await open_source(*tool, pose.name)) co_return;
  TimedPose timed;
  timed.arrival_ns = arrival_ns;
  const std::uint64_t restarts = tool->clock.restarts();
  timed.pose.t_ns = tool->clock.time_of(stamp_ns, arrival_ns);
  context_.counts.clock_restarts += tool->clock.restarts() - restarts;
  timed.pose.position = world_from_device(context_.options.world, pose.position);
  timed.pose.orientation = world_from_device(context_.options.world, pose.orientation);
  timed.pose.buttons = tool->engaged ? context_.options.engage_buttons : 0;
  tool->arrival_ns = arrival_ns;
  ++context_.counts.poses;
  // A full queue: the loop is far behind. The rest waits in the socket.
  while (tool->source && !closed_ && tool->source->enqueue(std::span(&timed, 1)) == 0) {
    tool->waiting = true;
    co_await pause();
  }
  if (tool->waiting) tool->arrival_ns = monotonic_ns();
  tool->waiting = false;
}

}  // namespace incise::input::openigtlink
