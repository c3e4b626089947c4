#include "server/stream/guess_limiter.hpp"

#include <algorithm>
#include <cmath>

namespace incise::stream {

// An IPv4 address that came through a socket for IPv6 counts as itself.
GuessLimiter::Network GuessLimiter::network_of(const boost::asio::ip::address& address) {
  using boost::asio::ip::make_address_v4;
  using boost::asio::ip::v4_mapped;
  if (address.is_v4()) return {false, address.to_v4().to_uint()};
  const auto v6 = address.to_v6();
  if (v6.is_v4_mapped()) return {false, make_address_v4(v4_mapped, v6).to_uint()};
  std::uint64_t bits = 0;
  const auto bytes = v6.to_bytes();
  for (std::size_t i = 0; i < 8; ++i) bits = bits << 8 | bytes[i];
  return {true, bits};
}

std::int64_t GuessLimiter::closed_for(const boost::asio::ip::address& from, std::int64_t now_ns) {
  const auto found = guessers_.find(network_of(from));
  if (found == guessers_.end()) return 0;
  std::vector<std::int64_t>& taken = found->second.taken;
  std::erase_if(taken, [now_ns](std::int64_t until_ns) { return until_ns <= now_ns; });
  if (taken.size() < kSlots) return 0;
  return *std::min_element(taken.begin(), taken.end()) - now_ns;
}

std::int64_t GuessLimiter::note_wrong(const boost::asio::ip::address& from, std::int64_t now_ns) {
  const Network network = network_of(from);
  if (!guessers_.contains(network)) make_room();
  Guesser& guesser = guessers_[network];
  const double forgotten = static_cast<double>(now_ns - guesser.last_ns) / static_cast<double>(kForget_ns);
  guesser.last_ns = now_ns;
  static const double kSaturated =
      kFreeGuesses + 1 + std::log2(static_cast<double>(kMaxDelay_ns) / static_cast<double>(kFirstDelay_ns));
  guesser.wrong = std::min(std::max(guesser.wrong - forgotten, 0.0) + 1, kSaturated);
  const int beyond = static_cast<int>(std::ceil(guesser.wrong)) - kFreeGuesses;
  if (beyond <= 0) return 0;
  const std::int64_t delay_ns = std::min(kFirstDelay_ns << (beyond - 1), kMaxDelay_ns);
  guesser.taken.push_back(now_ns + static_cast<std::int64_t>(kSlotPart * static_cast<double>(delay_ns)));
  return delay_ns;
}

void GuessLimiter::make_room() {
  if (guessers_.size() < kMaxAddresses) return;
  guessers_.erase(std::min_element(guessers_.begin(), guessers_.end(), [](const auto& a, const auto& b) {
    return a.second.last_ns < b.second.last_ns;
  }));
}

}  // namespace incise::stream
