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
    kNoToken,      // one is needed
    kOtherRole,    // a token that does not open this
    kWrong,        // no token of ours
    kNotLookedAt,  // from an address that has guessed too often
  };
  struct Answer {
    Verdict verdict = Verdict::kGranted;
    std::int64_t hold_ns = 0;       // how long to hold the answer back
    std::int64_t come_back_ns = 0;  // kNotLookedAt: how long it is so
  };
  // `opens`: whether a token that we know opens what is asked for.
  Answer ask(const boost::asio::ip::address& from, const std::string& token,
             const std::function<bool(const AccessToken&)>& opens, std::int64_t now_ns);

  // Counts an answer that is held back for as long as the result lives. Of kMaxHeld at once each holds a socket; ask() wants
  // no others held.
  static constexpr std::size_t kMaxHeld = 64;
  std::shared_ptr<void> hold();

 private:
  const std::vector<AccessToken>& tokens_;
  GuessLimiter guesses_;
  // Shared with what hold() gave out, which may be destroyed later than this.
  std::shared_ptr<std::size_t> held_ = std::make_shared<std::size_t>(0);
};

}  // namespace incise::stream
