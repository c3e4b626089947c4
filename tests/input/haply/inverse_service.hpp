#pragma once

// Stands in for Haply's Inverse Service: speaks as its documentation (3.5) says, an inventory first and then one state for
// each message. The exchange is written from that documentation, not recorded from a device.

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/websocket.hpp>
#include <functional>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace incise::tests {

// What the documentation gives as a whole state, with these values.
inline nlohmann::json inverse_state(double x, double y, double z, bool button) {
  using nlohmann::json;
  const json zero{{"x", 0}, {"y", 0}, {"z", 0}};
  return {
      {"inverse3",
       {{{"device_id", "049D"},
         {"state",
          {{"cursor_position", {{"x", x}, {"y", y}, {"z", z}}},
           {"cursor_velocity", zero},
           {"angular_position", {{"a0", 0}, {"a1", 0}, {"a2", 0}}},
           {"body_orientation", {{"w", 1}, {"x", 0}, {"y", 0}, {"z", 0}}},
           {"current_cursor_force", zero},
           {"control_mode", "idle"}}},
         {"status", {{"calibrated", true}, {"in_use", false}, {"power_supply", true}, {"ready", true}}}}}},
      {"wireless_verse_grip",
       {{{"device_id", "61548"},
         {"state",
          {{"orientation", {{"w", 1.0}, {"x", 0.0}, {"y", 0.0}, {"z", 0.0}}},
           {"buttons", {{"a", button}, {"b", false}, {"c", false}}},
           {"battery_level", 0.9},
           {"hall", 3}}}}}}};
}

class InverseService {
 public:
  // `next` gives the answer to message n (from 0) of a connection, a text of any kind; nothing: the service hangs up, or
  // where `mute` says so, answers no more.
  using Next = std::function<std::optional<std::string>(std::size_t n, const std::string& message)>;
  explicit InverseService(Next next, unsigned short at = 0)
      : next_(std::move(next)), acceptor_(io_, {boost::asio::ip::make_address("127.0.0.1"), at}) {
    port_ = acceptor_.local_endpoint().port();
    thread_ = std::thread([this] { run(); });
  }
  ~InverseService() {
    stopping_ = true;
    // Wakes what waits.
    boost::system::error_code ignored;
    boost::asio::ip::tcp::socket waker(io_);
    waker.connect({boost::asio::ip::make_address("127.0.0.1"), port_}, ignored);
    {
      const std::scoped_lock lock(mutex_);
      if (socket_) ::shutdown(*socket_, SHUT_RDWR);
    }
    thread_.join();
  }
  unsigned short port() const { return port_; }
  std::string url() const { return "ws://127.0.0.1:" + std::to_string(port_); }
  // All that came, in order.
  std::vector<std::string> messages() const {
    const std::scoped_lock lock(mutex_);
    return messages_;
  }

 private:
  void run() {
    while (!stopping_) {
      boost::system::error_code error;
      boost::asio::ip::tcp::socket socket(io_);
      acceptor_.accept(socket, error);
      if (error || stopping_) return;
      serve(std::move(socket));
    }
  }
  void serve(boost::asio::ip::tcp::socket socket) {
    boost::system::error_code error;
    socket.set_option(boost::asio::ip::tcp::no_delay(true), error);
    {
      const std::scoped_lock lock(mutex_);
      socket_ = socket.native_handle();
    }
    boost::beast::websocket::stream<boost::asio::ip::tcp::socket> ws(std::move(socket));
    ws.accept(error);
    std::string message;
    for (std::size_t n = 0; !error && !stopping_; ++n) {
      const std::optional<std::string> answer = next_(n, message);
      if (!answer) break;
      if (*answer != kMute) ws.write(boost::asio::buffer(*answer), error);
      boost::beast::flat_buffer buffer;
      if (!error) ws.read(buffer, error);
      if (error) break;
      message.assign(static_cast<const char*>(buffer.data().data()), buffer.size());
      const std::scoped_lock lock(mutex_);
      messages_.push_back(message);
    }
    const std::scoped_lock lock(mutex_);
    socket_.reset();
  }

 public:
  static constexpr const char* kMute = "mute";

 private:
  const Next next_;
  boost::asio::io_context io_;
  boost::asio::ip::tcp::acceptor acceptor_;
  unsigned short port_ = 0;
  std::atomic<bool> stopping_{false};
  mutable std::mutex mutex_;
  std::optional<int> socket_;          // guarded by mutex_
  std::vector<std::string> messages_;  // guarded by mutex_
  std::thread thread_;
};

// The force that a message brings; nothing where it brings none.
inline std::optional<std::vector<double>> force_of(const std::string& message, const char* field = "vector") {
  const auto json = nlohmann::json::parse(message, nullptr, false);
  if (!json.is_object() || !json.contains("inverse3")) return std::nullopt;
  const auto& force = json["inverse3"][0]["commands"]["set_cursor_force"][field];
  return std::vector<double>{force["x"], force["y"], force["z"]};
}

}  // namespace incise::tests
