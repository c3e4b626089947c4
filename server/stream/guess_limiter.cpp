#include "server/stream/guess_limiter.hpp"

#include <algorithm>
#include <cmath>

#include "server/stream/network.hpp"

namespace incise::stream {

std::int64_t GuessLimiter::closed_for(const boost::asio::ip::address& from, std::int64_t now_ns) {
  const auto found = guessers_.find(network_of(from));
  if (found == guessers_.end()) return 0;
  std::vector<std::int64_t>& taken = found->second.taken;
  std::erase_if(taken, [now_ns](std::int64_t until_ns) { return until_ns <= now_ns; });
  if (taken.size() < kSlots) return 0;
  return *std::min_element(taken.begin(), taken.end()) - now_ns;
}

std::int64_t GuessLimiter::note_wrong(const boost::asio::ip::address& from, std::int64_t now_ns) {
  const std::string network = network_of(from);
  if (!guessers_.contains(network)) make_room();
  Guesser& guesser = guessers_[network];
  const double forgotten = static_cast<double>(now_ns - guesser.last_ns) / static_cast<double>(kForget_ns);
  guesser.last_ns = now_ns;
  static const double saturated =
      kFreeGuesses + 1 + std::log2(static_cast<double>(kMaxDelay_ns) / static_cast<double>(kFirstDelay_ns));
  guesser.wrong = std::min(std::max(guesser.wrong - forgotten, 0.0) + 1, saturated);
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
