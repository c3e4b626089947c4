#include "tests/stream/raw_peer.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

namespace incise::stream {
namespace {

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

}  // namespace

RawPeer::RawPeer(std::uint16_t port, int receive_buffer) {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (receive_buffer > 0) ::setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
  set_patience(fd);
  const sockaddr_in address = loopback(port);
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
    fd_ = fd;
  } else {
    ::close(fd);
  }
}

std::unique_ptr<RawPeer> RawPeer::accept(int listener) {
  std::unique_ptr<RawPeer> peer(new RawPeer);
  peer->fd_ = ::accept4(listener, nullptr, nullptr, SOCK_CLOEXEC);
  peer->set_patience(peer->fd_);
  return peer;
}

void RawPeer::set_patience(int fd) {
  const timeval patience{20, 0};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  ::setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
}

RawPeer::~RawPeer() {
  if (fd_ >= 0) ::close(fd_);
}

bool RawPeer::send(std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (n <= 0) return false;
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
  return true;
}

bool RawPeer::send(std::string_view text) {
  return send(std::as_bytes(std::span(text)));
}

bool RawPeer::send(const protocol::Body& body, std::uint64_t sequence) {
  const protocol::Frame frame = protocol::encode(body, {sequence, 0});
  return send(frame.tcp());
}

std::optional<RawPeer::Message> RawPeer::receive() {
  for (;;) {
    std::span<const std::byte> rest = std::span<const std::byte>(input_).subspan(used_);
    const auto status = reader_.read(rest);
    used_ = input_.size() - rest.size();
    if (status == protocol::FrameReader::Status::Complete) {
      Message out;
      out.bytes.assign(reader_.body().begin(), reader_.body().end());
      protocol::DecodeResult decoded = protocol::decode(out.bytes);
      if (!decoded) return std::nullopt;
      out.message = std::move(*decoded.message);
      return out;
    }
    if (status == protocol::FrameReader::Status::Failed) return std::nullopt;
    input_.resize(65536);
    used_ = 0;
    const ssize_t n = ::recv(fd_, input_.data(), input_.size(), 0);
    input_.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
    if (n <= 0) return std::nullopt;
  }
}

bool RawPeer::closes() {
  char buffer[4096];
  for (;;) {
    const ssize_t n = ::recv(fd_, buffer, sizeof buffer, 0);
    if (n == 0) return true;
    if (n < 0) return errno == ECONNRESET;
  }
}

std::string RawPeer::read_all(std::size_t enough) {
  std::string out;
  char buffer[65536];
  while (out.size() < enough) {
    const ssize_t n = ::recv(fd_, buffer, sizeof buffer, 0);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    out.append(buffer, static_cast<std::size_t>(n));
  }
  return out;
}

std::string RawPeer::read_head() {
  std::string head;
  while (head.find("\r\n\r\n") == std::string::npos) {
    const std::string more = read_all(1);
    if (more.empty()) break;
    head += more;
  }
  return head;
}

void RawPeer::vanish() {
  const linger now{1, 0};
  ::setsockopt(fd_, SOL_SOCKET, SO_LINGER, &now, sizeof now);
  ::close(std::exchange(fd_, -1));
}

void RawPeer::shut_down() {
  ::shutdown(fd_, SHUT_RDWR);
}

Listener::Listener() : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  const timeval patience{20, 0};  // for accept()
  ::setsockopt(fd_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  sockaddr_in address = loopback(0);
  if (::bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 || ::listen(fd_, 4) != 0)
    throw std::system_error(errno, std::generic_category(), "a listener on 127.0.0.1");
  socklen_t size = sizeof address;
  ::getsockname(fd_, reinterpret_cast<sockaddr*>(&address), &size);
  port_ = ntohs(address.sin_port);
}

Listener::~Listener() {
  ::close(fd_);
}

std::string http(std::uint16_t port, const std::string& target, const std::string& method,
                 const std::string& headers) {
  RawPeer peer(port);
  peer.send(method + " " + target + " HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n" + headers +
            "\r\n");
  return peer.read_all();
}

}  // namespace incise::stream
