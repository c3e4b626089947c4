#include "client/link.hpp"

#include <array>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/error.hpp>
#include <boost/asio/ssl/host_name_verification.hpp>
#include <boost/asio/this_coro.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/http/error.hpp>

#include "protocol/net/web_socket.hpp"

namespace incise::client {
namespace {

namespace beast = boost::beast;
namespace ssl = asio::ssl;
using boost::system::error_code;
using net::NetStream;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

// A TLS stream refers to this.
struct TlsContext {
  ssl::context context{ssl::context::tls_client};
  std::string certified_names;  // of a certificate that is for other names than the server's
};

class TcpLink final : public Link {
 public:
  TcpLink(NetStream stream, std::shared_ptr<void> tls) : tls_(std::move(tls)), stream_(std::move(stream)) {}

  asio::awaitable<Received> read() override {
    for (;;) {
      const auto status = reader_.read(input_);
      if (status == protocol::FrameReader::Status::Complete) co_return Received::message(reader_.body());
      if (status == protocol::FrameReader::Status::Failed) co_return Received::end(reader_.error());
      const auto [ec, n] = co_await stream_.async_read_some(asio::buffer(buffer_), kTuple);
      if (ec) co_return Received::end(ec.message());
      input_ = std::span<const std::byte>(buffer_).first(n);
    }
  }

  asio::awaitable<error_code> write(const protocol::Frame& frame) override {
    const auto bytes = frame.tcp();
    const auto [ec, n] =
        co_await asio::async_write(stream_, asio::buffer(bytes.data(), bytes.size()), kTuple);
    co_return ec;
  }

  void close() override { stream_.close(); }

 private:
  std::shared_ptr<void> tls_;
  NetStream stream_;
  protocol::FrameReader reader_;
  std::array<std::byte, 65536> buffer_;
  std::span<const std::byte> input_;
};

class WebSocketLink final : public Link {
 public:
  WebSocketLink(NetStream stream, std::shared_ptr<void> tls)
      : tls_(std::move(tls)), socket_(std::move(stream)) {
    socket_.set_max_bytes(protocol::kMaxMessageBytes);
  }

  asio::awaitable<error_code> shake_hands(std::string host) {
    const error_code error = co_await socket_.shake_hands(std::move(host), "/ws");
    if (!error) socket_.stream().tcp().expires_never();
    co_return error;
  }

  asio::awaitable<Received> read() override {
    const error_code error = co_await socket_.read();
    co_return error ? Received::end(error.message()) : Received::message(socket_.message());
  }

  asio::awaitable<error_code> write(const protocol::Frame& frame) override {
    return socket_.write(frame.body());
  }

  void close() override { socket_.stream().close(); }

 private:
  std::shared_ptr<void> tls_;
  net::WebSocket socket_;
};

[[noreturn]] void fail(const std::string& host, std::uint16_t port, const std::string& what) {
  throw ConnectError(host + ":" + std::to_string(port) + ": " + what);
}

asio::awaitable<std::unique_ptr<Link>> finish(NetStream stream, std::shared_ptr<void> tls,
                                              const std::string& host, std::uint16_t port,
                                              TransportKind kind) {
  if (kind == TransportKind::kTcp) {
    stream.tcp().expires_never();
    co_return std::make_unique<TcpLink>(std::move(stream), std::move(tls));
  }
  const bool tls_used = tls != nullptr;
  auto link = std::make_unique<WebSocketLink>(std::move(stream), std::move(tls));
  const bool literal_v6 = host.find(':') != std::string::npos;
  const std::string name = (literal_v6 ? "[" + host + "]" : host) + ":" + std::to_string(port);
  const error_code ec = co_await link->shake_hands(name);
  if (ec) {
    const bool silent = ec == beast::http::error::end_of_stream || ec == asio::error::eof;
    const bool no_http = ec == beast::http::error::bad_version || ec == beast::http::error::bad_status ||
                         ec == beast::http::error::bad_line_ending;
    fail(host, port,
         "cannot open a WebSocket: " +
             (silent && !tls_used ? std::string(kMaybeTls)
              : no_http
                  ? "the port does not speak HTTP: use incised's HTTP port (7480 where its configuration "
                    "says nothing else), or no ws:// before this one"
                  : ec.message()));
  }
  co_return link;
}

std::shared_ptr<TlsContext> make_tls(const std::string& host, std::uint16_t port, const Options& options) {
  auto tls = std::make_shared<TlsContext>();
  tls->context.set_verify_mode(ssl::verify_peer);
  error_code ec;
  if (options.ca_file.empty()) {
    tls->context.set_default_verify_paths(ec);
  } else {
    tls->context.load_verify_file(options.ca_file, ec);
  }
  if (ec) fail(host, port, "certificates " + options.ca_file + ": " + ec.message());
  return tls;
}

// The names and addresses that a certificate is for, as far as a message has room for them.
std::string names_of(X509* certificate) {
  constexpr int kMaxNames = 8;
  std::string text;
  const std::unique_ptr<GENERAL_NAMES, decltype(&GENERAL_NAMES_free)> names(
      static_cast<GENERAL_NAMES*>(X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr)),
      &GENERAL_NAMES_free);
  const int count = names ? sk_GENERAL_NAME_num(names.get()) : 0;
  for (int k = 0; k < std::min(count, kMaxNames); ++k) {
    const GENERAL_NAME* const name = sk_GENERAL_NAME_value(names.get(), k);
    if (name->type != GEN_DNS && name->type != GEN_IPADD) continue;
    const ASN1_STRING* const value = name->type == GEN_DNS ? name->d.dNSName : name->d.iPAddress;
    const unsigned char* const bytes = ASN1_STRING_get0_data(value);
    const auto size = static_cast<std::size_t>(ASN1_STRING_length(value));
    std::string one;
    if (name->type == GEN_DNS) {
      // The server's bytes: what a terminal cannot show is left out.
      for (std::size_t i = 0; i < size; ++i)
        one += bytes[i] > ' ' && bytes[i] < 127 ? static_cast<char>(bytes[i]) : '?';
    } else if (asio::ip::address_v4::bytes_type v4{}; size == v4.size()) {
      std::copy_n(bytes, size, v4.begin());
      one = asio::ip::address_v4(v4).to_string();
    } else if (asio::ip::address_v6::bytes_type v6{}; size == v6.size()) {
      std::copy_n(bytes, size, v6.begin());
      one = asio::ip::address_v6(v6).to_string();
    }
    if (!one.empty()) text += (text.empty() ? "" : ", ") + one;
  }
  return count > kMaxNames ? text + ", ..." : text;
}

// As ssl::host_name_verification, and keeps the names of a certificate that is trusted but for others.
void verify_name(NetStream::Tls& stream, const std::string& host, TlsContext& tls) {
  stream.set_verify_callback(
      [check = ssl::host_name_verification(host), &tls](bool trusted, ssl::verify_context& verify) {
        if (check(trusted, verify)) return true;
        if (trusted) {
          X509_STORE_CTX_set_error(verify.native_handle(), X509_V_ERR_HOSTNAME_MISMATCH);
          tls.certified_names = names_of(X509_STORE_CTX_get_current_cert(verify.native_handle()));
        }
        return false;
      });
}

// Why TLS failed, and what to do.
std::string tls_failure(const error_code& ec, SSL* connection, const std::string& host,
                        const std::string& certified_names) {
  const long verdict = SSL_get_verify_result(connection);
  if (verdict == X509_V_ERR_HOSTNAME_MISMATCH) {
    return "TLS: the server's certificate is not for " + host +
           (certified_names.empty() ? std::string(": it names no host; it needs a subjectAltName")
                                    : "; it is for " + certified_names);
  }
  if (verdict != X509_V_OK) {
    return std::string("TLS: the server's certificate is not trusted: ") +
           X509_verify_cert_error_string(verdict) + "; give the file of the authority that signed it (--ca)";
  }
  std::string what = "TLS: " + ec.message();
  if (what.find("wrong version number") != std::string::npos) return what + ": the server does not use TLS";
  return what;
}

}  // namespace

asio::awaitable<OpenStream> open_stream(std::string host, std::uint16_t port, const Options& options,
                                        std::chrono::steady_clock::time_point deadline) {
  NetStream::Tcp tcp(co_await asio::this_coro::executor);
  tcp.expires_at(deadline);
  const error_code connect_error = co_await net::connect(tcp, host, std::to_string(port));
  if (connect_error) fail(host, port, connect_error.message());
  if (!options.tls) {
    OpenStream opened{nullptr, NetStream(std::move(tcp))};
    co_return opened;
  }
  auto tls = make_tls(host, port, options);
  NetStream secured(std::move(tcp), tls->context);
  SSL* const connection = secured.tls()->native_handle();
  SSL_set_tlsext_host_name(connection, host.c_str());
  verify_name(*secured.tls(), host, *tls);
  const error_code tls_error = co_await secured.secure(ssl::stream_base::client);
  if (tls_error) fail(host, port, tls_failure(tls_error, connection, host, tls->certified_names));
  OpenStream opened{std::move(tls), std::move(secured)};
  co_return opened;
}

asio::awaitable<std::unique_ptr<Link>> open_link(std::string host, std::uint16_t port, const Options& options,
                                                 std::chrono::steady_clock::time_point deadline) {
  OpenStream opened = co_await open_stream(host, port, options, deadline);
  co_return co_await finish(std::move(opened.stream), std::move(opened.tls), host, port, options.transport);
}

}  // namespace incise::client
