#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <functional>
#include <memory>

namespace incise::stream {

namespace asio = boost::asio;

// Spaces out the deltas of a peer that asked for at most so many a second.
//
// Thread: the stream thread.
class DeltaPace {
 public:
  explicit DeltaPace(asio::io_context& io) : timer_(io) {}

  // 0: no limit. The next delta may go out at once.
  void set_rate(float max_hz);
  bool limited() const { return max_hz_ > 0; }
  // Whether a delta may go out now; if so it counts as sent. If not, calls `again` once one may, unless `keep`, which
  // keeps this alive, is gone by then.
  bool allow(const std::shared_ptr<void>& keep, std::function<void()> again);
  void cancel() { timer_.cancel(); }

 private:
  asio::steady_timer timer_;
  bool armed_ = false;
  float max_hz_ = 0;
  std::int64_t next_ns_ = 0;
};

}  // namespace incise::stream
