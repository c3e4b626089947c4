#pragma once

#include <boost/asio/ip/address.hpp>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace incise::stream {

// How long an address that guesses tokens has to wait. The answer to a wrong token is delayed from the fourth on,
// twice as long each time, up to kMaxDelay_ns; a right token is let in at once. Each wrong token takes one of its
// address's kSlots for kSlotPart of that delay, even if its sender hangs up. While all slots are taken, no token from
// the address is looked at; otherwise many connections at once would get round the delay. A slot is free before its
// sender has the answer, so that others behind the same address can use it. A wrong token is forgotten after
// kForget_ns.
//
// Addresses count by network_of(). A reverse proxy is one address.
//
// Thread: one. Memory: bounded by kMaxAddresses; beyond that, the address that has been quiet longest is forgotten.
class GuessLimiter {
 public:
  static constexpr std::int64_t kFirstDelay_ns = 250'000'000, kMaxDelay_ns = 4'000'000'000,
                                kForget_ns = 30'000'000'000;
  static constexpr int kFreeGuesses = 3;
  static constexpr double kSlotPart = 0.75;
  static constexpr std::size_t kSlots = 32, kMaxAddresses = 4096;

  // For how long no token from there is looked at; 0: it is.
  std::int64_t closed_for(const boost::asio::ip::address& from, std::int64_t now_ns);
  // Notes a wrong token from there. Returns how long to delay its answer.
  std::int64_t note_wrong(const boost::asio::ip::address& from, std::int64_t now_ns);
  std::size_t addresses() const { return guessers_.size(); }

 private:
  struct Guesser {
    double wrong = 0;  // wrong tokens as of last_ns, less those forgotten; saturates where the delay does
    std::int64_t last_ns = 0;
    std::vector<std::int64_t> taken;  // for each taken slot, until when
  };
  void make_room();

  std::map<std::string, Guesser> guessers_;  // by network_of()
};

}  // namespace incise::stream
