#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/associated_executor.hpp>
#include <boost/system/error_code.hpp>
#include <cstddef>
#include <memory>
#include <type_traits>
#include <utility>

namespace incise::net {

namespace asio = boost::asio;
using boost::system::error_code;

// A completion handler, called once with an error and, where it wants one, a number of bytes. It hides the handler's type, so that what
// Asio builds around a handler is compiled once, not once for each operation of Beast's.
//
// Thread: its executor's.
class IoHandler {
 public:
  using executor_type = asio::any_io_executor;

  // `fallback` runs a handler that has no executor of its own.
  template <class Handler>
  IoHandler(Handler handler, const executor_type& fallback)
      : executor_(asio::get_associated_executor(handler, fallback)),
        held_(std::make_unique<HeldAs<Handler>>(std::move(handler))) {}

  executor_type get_executor() const noexcept { return executor_; }
  void operator()(error_code error, std::size_t bytes = 0) { Held::call(std::move(held_), error, bytes); }

 private:
  struct Held {
    virtual ~Held() = default;
    virtual void call_and_free(std::unique_ptr<Held> self, error_code error, std::size_t bytes) = 0;
    static void call(std::unique_ptr<Held> held, error_code error, std::size_t bytes) {
      Held& it = *held;
      it.call_and_free(std::move(held), error, bytes);
    }
  };
  template <class Handler>
  struct HeldAs final : Held {
    explicit HeldAs(Handler given) : handler(std::move(given)) {}
    void call_and_free(std::unique_ptr<Held> self, error_code error, std::size_t bytes) override {
      Handler local(std::move(handler));
      self.reset();  // the call may start the next operation, which needs memory too
      if constexpr (std::is_invocable_v<Handler, error_code, std::size_t>) {
        std::move(local)(error, bytes);
      } else {
        std::move(local)(error);
      }
    }
    Handler handler;
  };

  executor_type executor_;
  std::unique_ptr<Held> held_;
};

}  // namespace incise::net
