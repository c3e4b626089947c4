#include "server/stream/access.hpp"

#include "protocol/limits.hpp"

namespace incise::stream {
namespace {

// Takes the same time wherever the two differ, and whatever their lengths.
bool equal_in_constant_time(const std::string& a, const std::string& b) {
  std::size_t difference = a.size() ^ b.size();
  for (std::size_t i = 0; i < protocol::kMaxTokenBytes; ++i) {
    const auto x = static_cast<unsigned char>(i < a.size() ? a[i] : 0);
    const auto y = static_cast<unsigned char>(i < b.size() ? b[i] : 0);
    difference |= static_cast<std::size_t>(x ^ y);
  }
  return difference == 0;
}

// So that a client whose token is not looked at does not come back a thousand times a second, ahead of others from
// its address.
constexpr std::int64_t kNotLookedAtHold_ns = 1'000'000'000;

}  // namespace

Access::Answer Access::ask(const boost::asio::ip::address& from, const std::string& token,
                           const std::function<bool(const AccessToken&)>& opens, std::int64_t now_ns) {
  const auto held = [this](std::int64_t ns) { return *held_ < kMaxHeld ? ns : 0; };
  if (tokens_.empty()) return {Verdict::kGranted};
  if (token.empty()) return {Verdict::kNoToken};
  if (const std::int64_t closed_ns = guesses_.closed_for(from, now_ns); closed_ns > 0) {
    return {Verdict::kNotLookedAt, held(kNotLookedAtHold_ns), closed_ns};
  }
  bool known = false, opened = false;
  for (const AccessToken& one : tokens_) {
    const bool same = equal_in_constant_time(one.token, token);
    known |= same;
    opened |= same && opens(one);
  }
  if (opened) return {Verdict::kGranted};
  if (known) return {Verdict::kOtherRole};
  return {Verdict::kWrong, held(guesses_.note_wrong(from, now_ns))};
}

std::shared_ptr<void> Access::hold() {
  ++*held_;
  return {nullptr, [held = held_](void*) { --*held; }};
}

}  // namespace incise::stream
