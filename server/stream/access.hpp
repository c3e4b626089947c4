#pragma once

#include <boost/asio/ip/address.hpp>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "server/stream/guess_limiter.hpp"
#include "server/stream/stream_config.hpp"

namespace incise::stream {

// Who may enter. Without tokens: everybody.
//
// Thread: the stream thread.
class Access {
 public:
  // `tokens` must outlive this.
  explicit Access(const std::vector<AccessToken>& tokens) : tokens_(tokens) {}

  enum class Verdict {
    kGranted,
    kNoToken,      // none was given, and one is needed
    kOtherRole,    // the token does not open this
    kWrong,        // not one of our tokens
    kNotLookedAt,  // its address has guessed too often
  };
  struct Answer {
    Verdict verdict = Verdict::kGranted;
    std::int64_t hold_ns = 0;       // how long to delay the answer
    std::int64_t come_back_ns = 0;  // kNotLookedAt: for how long that lasts
  };
  // `opens`: whether one of our tokens opens what is asked for.
  Answer ask(const boost::asio::ip::address& from, const std::string& token,
             const std::function<bool(const AccessToken&)>& opens, std::int64_t now_ns);

  // Counts a delayed answer while the result lives. Each keeps a socket; with kMaxHeld of them ask() delays no more.
  static constexpr std::size_t kMaxHeld = 64;
  std::shared_ptr<void> hold();

 private:
  const std::vector<AccessToken>& tokens_;
  GuessLimiter guesses_;
  // Shared with the results of hold(), which may outlive this.
  std::shared_ptr<std::size_t> held_ = std::make_shared<std::size_t>(0);
};

}  // namespace incise::stream
