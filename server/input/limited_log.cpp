#include "server/input/limited_log.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>

namespace incise::input {

LimitedLog::LimitedLog(Limit limit)
    : LimitedLog(
          [](spdlog::level::level_enum level, const std::string& line) { spdlog::log(level, "{}", line); },
          limit) {}

double LimitedLog::used_at(const Address& address, std::int64_t now_ns) const {
  const double seconds = 1e-9 * static_cast<double>(now_ns - address.last_ns);
  return std::max(0.0, address.used - seconds / limit_.each_s);
}

bool LimitedLog::may_write(Address& address, std::int64_t now_ns) const {
  address.used = used_at(address, now_ns);
  address.last_ns = now_ns;
  return address.used + 1 <= limit_.at_once;
}

// Addresses that have nothing left to say are forgotten where there is no room.
LimitedLog::Address& LimitedLog::address_of(const std::string& name, std::int64_t now_ns) {
  const auto known = addresses_.find(name);
  if (known != addresses_.end()) return known->second;
  if (addresses_.size() >= kMaxAddresses) {
    std::erase_if(addresses_, [&](const auto& entry) {
      return used_at(entry.second, now_ns) == 0 && entry.second.left_out == 0;
    });
  }
  if (addresses_.size() >= kMaxAddresses) return others_;
  return addresses_[name];
}

void LimitedLog::write(spdlog::level::level_enum level, const std::string& address, const std::string& line,
                       std::int64_t now_ns) {
  const std::scoped_lock lock(mutex_);
  Address& from = address_of(address, now_ns);
  const bool may = may_write(from, now_ns);
  if (may && from.left_out == 0) {
    from.used += 1;
    write_(level, line);
    return;
  }
  ++from.left_out;
  from.level = level;
  from.last_line = line;
  if (may) write_left_out(from);
}

void LimitedLog::flush(std::int64_t now_ns) {
  const std::scoped_lock lock(mutex_);
  const auto flush_one = [&](Address& address) {
    if (address.left_out > 0 && may_write(address, now_ns)) write_left_out(address);
  };
  for (auto& [name, address] : addresses_) flush_one(address);
  flush_one(others_);
}

void LimitedLog::write_left_out(Address& address) {
  address.used += 1;
  const std::uint64_t others = address.left_out - 1;
  write_(address.level, others == 0 ? address.last_line
                                    : fmt::format("{} ({} {} like this left out)", address.last_line, others,
                                                  others == 1 ? "line" : "lines"));
  address.left_out = 0;
  address.last_line.clear();
}

}  // namespace incise::input
