#pragma once

#include <boost/asio/ip/address.hpp>
#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

namespace incise::stream {

// How long an address that guesses tokens has to wait. The answer to a wrong token is held back, from the fourth on and twice
// as long each time, up to kMaxDelay_ns; a right token is let in at once. A wrong token takes one of kSlots of its
// address, for kSlotPart of the time that its answer is held back and also where its sender hangs up; while all are taken, no
// token from there is looked at: else many connections at once would get round the delay. That a slot is free before its
// sender knows leaves it to others behind the same address. A wrong token is forgotten after kForget_ns.
//
// An IPv6 address counts by its first 64 bits, which are one subscriber's. A reverse proxy is one address.
//
// Thread: one. Memory: bounded, by kMaxAddresses; beyond, the address that has been quiet for the longest is forgotten.
class GuessLimiter {
 public:
  static constexpr std::int64_t kFirstDelay_ns = 250'000'000, kMaxDelay_ns = 4'000'000'000,
                                kForget_ns = 30'000'000'000;
  static constexpr int kFreeGuesses = 3;
  static constexpr double kSlotPart = 0.75;
  static constexpr std::size_t kSlots = 32, kMaxAddresses = 4096;

  // How long no token from there is looked at; 0: it may be.
  std::int64_t closed_for(const boost::asio::ip::address& from, std::int64_t now_ns);
  // A wrong token came from there; how long its answer is to be held back.
  std::int64_t note_wrong(const boost::asio::ip::address& from, std::int64_t now_ns);
  std::size_t addresses() const { return guessers_.size(); }

 private:
  using Network = std::pair<bool, std::uint64_t>;  // whether IPv6, its bits
  struct Guesser {
    double wrong = 0;  // as of last_ns, with what has been forgotten; saturates where the delay does
    std::int64_t last_ns = 0;
    std::vector<std::int64_t> taken;  // slots, until when
  };
  static Network network_of(const boost::asio::ip::address& address);
  void make_room();

  std::map<Network, Guesser> guessers_;
};

}  // namespace incise::stream
