#include "server/stream/http.hpp"

#include <algorithm>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <cctype>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>

#include "server/base/clock.hpp"
#include "server/stream/origin.hpp"
#include "server/stream/pause.hpp"
#include "server/stream/peer.hpp"

namespace incise::stream {
namespace {

namespace beast = boost::beast;
namespace http = beast::http;
using boost::system::error_code;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr std::uint32_t kMaxHeaderBytes = 16 * 1024;
constexpr std::chrono::seconds kRequestTime{15};

struct Answer {
  http::status status = http::status::ok;
  std::string type = "text/plain; charset=utf-8";
  std::string body;
  std::int64_t retry_after_s = 0;
};

std::string_view view_of(beast::string_view s) {
  return {s.data(), s.size()};
}

template <class Message>
void set_common(Message& message, const HttpRequest& request) {
  message.version(request.version());
  message.keep_alive(request.keep_alive());
  message.set(http::field::server, "incised");
  message.set("X-Content-Type-Options", "nosniff");
  message.set("X-Frame-Options", "SAMEORIGIN");
  // The page's own files and its connections back here; its icon is a data: address. The list of sessions shows pictures from anywhere.
  const bool pictures = request.target().starts_with("/sessions.html");
  message.set(
      "Content-Security-Policy",
      std::string("default-src 'self'; img-src 'self' data:") + (pictures ? " http: https:" : "") +
          "; connect-src 'self' ws: wss:; object-src 'none'; base-uri 'none'; frame-ancestors 'self'");
}

void metric(std::string& out, const char* name, const char* type, const char* help, std::uint64_t value) {
  out += std::string("# HELP incise_stream_") + name + ' ' + help + "\n# TYPE incise_stream_" + name + ' ' +
         type + "\nincise_stream_" + name + ' ' + std::to_string(value) + '\n';
}

std::string stream_metrics(const SharedCounters& c) {
  std::string out;
  metric(out, "revision", "gauge", "Revision that clients can see.", c.revision);
  metric(out, "sessions", "gauge", "Peers that are connected and welcomed.", c.peers);
  metric(out, "connections", "gauge", "Open connections.", c.connections);
  metric(out, "accepted_total", "counter", "Connections accepted.", c.accepted);
  metric(out, "refused_total", "counter",
         "Connections refused before Welcome, and requests without the token they need.", c.refused);
  metric(out, "wrong_tokens_total", "counter", "Tokens that were wrong.", c.wrong_tokens);
  metric(out, "tokens_not_looked_at_total", "counter",
         "Tokens not looked at, from addresses that had guessed too often.", c.tokens_not_looked_at);
  metric(out, "resets_total", "counter", "Resets by an admin.", c.resets);
  metric(out, "undos_total", "counter", "Strokes that operators and admins have undone.", c.undos);
  metric(out, "takeovers_total", "counter", "Blades that an operator took from another.", c.takeovers);
  metric(out, "handovers_total", "counter", "Blades that their operators handed over.", c.handovers);
  metric(out, "deltas_total", "counter", "Deltas encoded.", c.deltas);
  metric(out, "bytes_out_total", "counter", "Bytes of messages sent.", c.bytes_out);
  metric(out, "bytes_in_total", "counter", "Bytes of messages received.", c.bytes_in);
  metric(out, "messages_in_total", "counter", "Messages received.", c.messages_in);
  metric(out, "bad_messages_total", "counter", "Messages that could not be read.", c.bad_messages);
  metric(out, "coalesced_total", "counter", "Deltas that cover several steps.", c.coalesced);
  metric(out, "snapshots_total", "counter", "Snapshots sent.", c.snapshots);
  metric(out, "slow_snapshots_total", "counter", "Snapshots for peers that fell behind.", c.slow_snapshots);
  metric(out, "slow_disconnects_total", "counter", "Peers disconnected because they did not read.",
         c.slow_disconnects);
  metric(out, "resumed_total", "counter", "Peers that came back and needed no snapshot.", c.resumed);
  metric(out, "half_open_closed_total", "counter", "Connections closed before Hello to make room for others.",
         c.half_open_closed);
  metric(out, "part_bytes", "gauge", "Bytes kept for peers with a box of interest.", c.part_bytes);
  metric(out, "box_turns_total", "counter", "Deltas made for one peer's box of interest.", c.box_turns);
  metric(out, "box_turns_nanoseconds_total", "counter", "Processor time that these took.", c.box_turns_ns);
  metric(out, "box_coalesced_total", "counter", "Those of them that cover several steps.", c.box_coalesced);
  metric(out, "boxes_refused_total", "counter", "Boxes of interest refused for lack of memory or time.",
         c.boxes_refused);
  metric(out, "ring_bytes", "gauge", "Bytes of the deltas kept for resuming.", c.ring_bytes);
  return out;
}

// The answer to a path that the server itself serves; nothing for other paths, which may be files.
std::optional<Answer> answer(const PeerContext& context, std::string_view path) {
  const Providers& providers = context.providers;
  const SharedCounters& counters = *context.counters;
  if (path == "/healthz") {
    // The text is ours, without characters to escape.
    const std::string trouble = providers.trouble ? providers.trouble() : std::string();
    const protocol::Recording recording = context.recording.state;
    // A server that only fails to record still cuts: nobody should restart it. Why it does, /stats says: paths are not for everybody.
    const std::string status = !trouble.empty()                            ? trouble
                               : recording == protocol::Recording::Stopped ? "poses are not recorded"
                                                                           : "ok";
    return Answer{trouble.empty() ? http::status::ok : http::status::service_unavailable, "application/json",
                  "{\"status\":\"" + status + "\",\"recording\":\"" + protocol::name_of(recording) +
                      "\",\"revision\":" + std::to_string(counters.revision) +
                      ",\"sessions\":" + std::to_string(counters.peers) + "}\n"};
  }
  if (path == "/metrics") {
    return Answer{
        http::status::ok, "text/plain; version=0.0.4; charset=utf-8",
        (providers.metrics_text ? providers.metrics_text() : std::string()) + stream_metrics(counters)};
  }
  if (path == "/captures") {
    std::string list;
    for (const std::string& name :
         providers.library ? providers.library->names() : std::vector<std::string>()) {
      list += list.empty() ? "\"" : ",\"";
      for (const char c : name) list += c == '"' || c == '\\' ? std::string{'\\', c} : std::string{c};
      list += '"';
    }
    return Answer{http::status::ok, "application/json", "[" + list + "]\n"};
  }
  if (path == "/sessions" && providers.sessions_json)
    return Answer{http::status::ok, "application/json", providers.sessions_json() + "\n"};
  if (path == "/stats" && providers.stats_json) {
    return Answer{http::status::ok, "application/json", providers.stats_json()};
  }
  if (path == "/stats" || path == "/ws") {
    return Answer{path == "/ws" ? http::status::upgrade_required : http::status::not_found,
                  "text/plain; charset=utf-8",
                  path == "/ws" ? "/ws is a WebSocket: send an upgrade request\n" : "not found\n"};
  }
  return std::nullopt;
}

// The token of "Authorization: Bearer TOKEN"; empty without one.
std::string bearer_token(const HttpRequest& request) {
  constexpr std::string_view kScheme = "bearer ";
  const std::string_view given = view_of(request[http::field::authorization]);
  if (!beast::iequals(given.substr(0, kScheme.size()), {kScheme.data(), kScheme.size()})) return {};
  const std::size_t begin = given.find_first_not_of(' ', kScheme.size());
  return begin == std::string_view::npos ? std::string() : std::string(given.substr(begin));
}

// Which tokens open a path; null where it needs none.
std::function<bool(const AccessToken&)> opening(const PeerContext& context, std::string_view path) {
  if (path == "/stats" || path == "/metrics") return [](const AccessToken&) { return true; };
  if (context.providers.documents.contains(path))
    return [](const AccessToken& token) { return !token.roles.empty(); };
  if (path != "/captures" && !(path == "/sessions" && context.providers.sessions_json)) return nullptr;
  return [](const AccessToken& token) {
    return std::any_of(token.roles.begin(), token.roles.end(), [](protocol::Role role) {
      return role == protocol::Role::Viewer || role == protocol::Role::Admin;
    });
  };
}

Answer refusal(const Access::Answer& access) {
  using Verdict = Access::Verdict;
  Answer answer;
  answer.status = http::status::unauthorized;
  answer.body = "a token is needed: Authorization: Bearer TOKEN\n";
  if (access.verdict == Verdict::kWrong) answer.body = "the token is wrong\n";
  if (access.verdict == Verdict::kOtherRole) {
    answer.status = http::status::forbidden;
    answer.body = "the token does not open this\n";
  }
  if (access.verdict == Verdict::kNotLookedAt) {
    answer.status = http::status::too_many_requests;
    answer.body = "too many wrong tokens from this address\n";
    answer.retry_after_s = 1 + access.come_back_ns / 1'000'000'000;
  }
  return answer;
}

// RFC 6455, 4.1: 16 bytes in base64.
bool is_websocket_key(std::string_view key) {
  const auto is_digit = [](unsigned char c) { return std::isalnum(c) != 0 || c == '+' || c == '/'; };
  return key.size() == 24 && key.ends_with("==") && std::all_of(key.begin(), key.end() - 2, is_digit);
}

asio::awaitable<bool> send_answer(NetStream& stream, const HttpRequest& request, Answer answer) {
  http::response<http::string_body> response(answer.status, request.version());
  set_common(response, request);
  response.set(http::field::content_type, answer.type);
  response.set(http::field::cache_control, "no-store");
  if (answer.status == http::status::method_not_allowed) response.set(http::field::allow, "GET, HEAD");
  if (answer.status == http::status::unauthorized) {
    response.set(http::field::www_authenticate, "Bearer realm=\"incised\"");
  }
  if (answer.retry_after_s > 0) response.set(http::field::retry_after, std::to_string(answer.retry_after_s));
  response.body() = std::move(answer.body);
  response.prepare_payload();
  if (request.method() == http::verb::head) response.body().clear();
  const auto [ec, n] = co_await http::async_write(stream, response, kTuple);
  co_return !ec && response.keep_alive();
}

// Not a coroutine: g++ 12 destroys an aggregate made within a co_await expression twice.
asio::awaitable<bool> send_text(NetStream& stream, const HttpRequest& request, http::status status,
                                const char* text) {
  return send_answer(stream, request, Answer{status, "text/plain; charset=utf-8", text, 0});
}

asio::awaitable<bool> send_refusal(NetStream& stream, const HttpRequest& request,
                                   const Access::Answer& access) {
  return send_answer(stream, request, refusal(access));
}

asio::awaitable<bool> send_document(NetStream& stream, const HttpRequest& request, const Document& document) {
  http::response<http::span_body<const char>> response(http::status::ok, request.version());
  set_common(response, request);
  response.set(http::field::content_type, document.type);
  response.set(http::field::cache_control, "no-store");
  response.body() = {document.body->data(), document.body->size()};
  response.prepare_payload();
  if (request.method() == http::verb::head) response.body() = {};
  const auto [ec, n] = co_await http::async_write(stream, response, kTuple);
  co_return !ec && response.keep_alive();
}

asio::awaitable<bool> send_file(NetStream& stream, const HttpRequest& request,
                                const StaticFiles::File& file) {
  const bool packed = !file.packed_path.empty() &&
                      view_of(request[http::field::accept_encoding]).find("gzip") != std::string_view::npos;
  const std::string etag = packed ? file.packed_etag : file.etag;
  const bool unchanged = view_of(request[http::field::if_none_match]) == etag;
  http::response<http::file_body> response(http::status::ok, request.version());
  http::response<http::empty_body> head(unchanged ? http::status::not_modified : http::status::ok,
                                        request.version());
  const auto set = [&](auto& message) {
    set_common(message, request);
    message.set(http::field::content_type, file.mime_type);
    message.set(http::field::etag, etag);
    if (!file.packed_path.empty()) message.set(http::field::vary, "Accept-Encoding");
    if (packed) message.set(http::field::content_encoding, "gzip");
    message.set(http::field::cache_control, file.cache_control);
  };
  set(response);
  set(head);
  error_code error;
  response.body().open((packed ? file.packed_path : file.path).c_str(), beast::file_mode::scan, error);
  if (error) {
    co_return co_await send_text(stream, request, http::status::not_found, "not found\n");
  }
  if (unchanged || request.method() == http::verb::head) {
    if (!unchanged) head.content_length(response.body().size());
    http::response_serializer<http::empty_body> serializer(head);
    const auto [ec, n] = co_await http::async_write_header(stream, serializer, kTuple);
    co_return !ec && head.keep_alive();
  }
  response.prepare_payload();
  const auto [ec, n] = co_await http::async_write(stream, response, kTuple);
  co_return !ec && response.keep_alive();
}

// Reads a request; nothing where the connection is to be closed: it ended, or sent a bad request, which this answers.
asio::awaitable<std::optional<HttpRequest>> read_request(NetStream& stream, beast::flat_buffer& buffer) {
  http::request_parser<http::string_body> parser;
  parser.header_limit(kMaxHeaderBytes);
  parser.body_limit(kMaxHeaderBytes);
  stream.tcp().expires_after(kRequestTime);
  const auto [ec, n] = co_await http::async_read(stream, buffer, parser, kTuple);
  if (!ec) co_return parser.release();
  if (ec == http::error::header_limit || ec == http::error::body_limit ||
      (ec.category() == make_error_code(http::error::end_of_stream).category() &&
       ec != http::error::end_of_stream && ec != http::error::partial_message)) {
    const http::status status = ec == http::error::header_limit
                                    ? http::status::request_header_fields_too_large
                                : ec == http::error::body_limit ? http::status::payload_too_large
                                                                : http::status::bad_request;
    HttpRequest none;
    none.version(11);
    none.keep_alive(false);
    co_await send_text(stream, none, status, "the request could not be read\n");
  }
  co_return std::nullopt;
}

// Whether the request may be answered. A refusal is counted and logged.
Access::Answer check_token(PeerContext& context, const HttpRequest& request, std::string_view path,
                           const asio::ip::tcp::endpoint& peer) {
  const std::function<bool(const AccessToken&)> opens = opening(context, path);
  if (!opens) return {};
  const Access::Answer access =
      context.access.ask(peer.address(), bearer_token(request), opens, monotonic_ns());
  if (access.verdict != Access::Verdict::kGranted) {
    ++context.counters->refused;
    context.note_refusal(access, peer.address(), std::string(path), name_of(peer));
  }
  return access;
}

asio::awaitable<bool> serve_request(PeerContext& context, const StaticFiles& files, NetStream& stream,
                                    const HttpRequest& request, const asio::ip::tcp::endpoint& peer) {
  if (request.method() != http::verb::get && request.method() != http::verb::head) {
    co_return co_await send_text(stream, request, http::status::method_not_allowed, "GET and HEAD only\n");
  }
  const std::string_view target = view_of(request.target());
  const std::string_view path = target.substr(0, target.find('?'));
  const Access::Answer access = check_token(context, request, path, peer);
  if (access.verdict != Access::Verdict::kGranted) {
    if (access.hold_ns > 0) {
      const auto held = context.access.hold();
      co_await pause(std::chrono::nanoseconds(access.hold_ns));
      stream.tcp().expires_after(kRequestTime);
    }
    co_return co_await send_refusal(stream, request, access);
  }
  if (std::optional<Answer> own = answer(context, path)) {
    co_return co_await send_answer(stream, request, std::move(*own));
  }
  const auto& documents = context.providers.documents;
  if (const auto document = documents.find(path); document != documents.end()) {
    co_return co_await send_document(stream, request, document->second);
  }
  if (const std::optional<StaticFiles::File> file = files.find(target)) {
    co_return co_await send_file(stream, request, *file);
  }
  if (path == "/") {
    co_return co_await send_text(
        stream, request, http::status::not_found,
        "this server has no page: build it (./dev build) or name its folder (listen.viewer_directory)\n");
  }
  co_return co_await send_text(stream, request, http::status::not_found, "not found\n");
}

}  // namespace

asio::awaitable<void> serve_http(PeerContext& context, PeerDirectory& peers, const StaticFiles& files,
                                 NetStream stream, Ticket ticket) {
  beast::flat_buffer buffer;
  bool go_on = true;
  while (go_on) {
    const std::optional<HttpRequest> request = co_await read_request(stream, buffer);
    if (!request) break;
    const std::string_view target = view_of(request->target());
    if (beast::websocket::is_upgrade(*request) && target.substr(0, target.find('?')) == "/ws") {
      if (!origin_allowed(view_of((*request)[http::field::origin]), view_of((*request)[http::field::host]),
                          context.config.allowed_origins)) {
        co_await send_text(stream, *request, http::status::forbidden,
                           "pages from this origin may not connect: see listen.allowed_origins\n");
        break;
      }
      if (!is_websocket_key(view_of((*request)[http::field::sec_websocket_key]))) {
        co_await send_text(stream, *request, http::status::bad_request,
                           "Sec-WebSocket-Key must be 16 bytes in base64\n");
        break;
      }
      std::unique_ptr<Transport> transport = co_await accept_websocket(std::move(stream), *request);
      if (!transport) co_return;
      const auto peer = std::make_shared<Peer>(context, peers, std::move(transport), std::move(ticket));
      co_await peer->run();
      co_return;
    }
    go_on = co_await serve_request(context, files, stream, *request, ticket.address());
  }
  stream.shut_down(asio::ip::tcp::socket::shutdown_both);
}

}  // namespace incise::stream
