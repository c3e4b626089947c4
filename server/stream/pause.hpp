#pragma once

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/this_coro.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <chrono>

namespace incise::stream {

// Suspends the coroutine for `time`.
inline boost::asio::awaitable<void> pause(std::chrono::nanoseconds time) {
  boost::asio::steady_timer timer(co_await boost::asio::this_coro::executor, time);
  co_await timer.async_wait(boost::asio::as_tuple(boost::asio::use_awaitable));
}

// How long to wait before offering the loop again what its full queue did not take.
inline constexpr std::chrono::milliseconds kQueueRetry{1};

}  // namespace incise::stream
