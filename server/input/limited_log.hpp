#pragma once

#include <spdlog/common.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>

namespace incise::input {

// Log lines that peers can cause. From each address so many at once, then one in so many seconds, so that one address cannot
// hide what another does. Of the lines left out the last is written when its address may write again, with the number
// of the others: by the next write() from there or by flush(), which the owner calls every second or so.
//
// Thread: any. Memory: bounded. Beyond kMaxAddresses that are busy, the rest share one limit.
class LimitedLog {
 public:
  struct Limit {
    double at_once = 10, each_s = 5;
  };
  static constexpr std::size_t kMaxAddresses = 64;
  using Write = std::function<void(spdlog::level::level_enum, const std::string&)>;

  // To spdlog.
  LimitedLog() : LimitedLog(Limit{}) {}
  explicit LimitedLog(Limit limit);
  LimitedLog(Write write, Limit limit) : write_(std::move(write)), limit_(limit) {}

  void write(spdlog::level::level_enum level, const std::string& address, const std::string& line,
             std::int64_t now_ns);
  void flush(std::int64_t now_ns);

 private:
  struct Address {
    double used = 0;           // of what may be written at once
    std::int64_t last_ns = 0;  // when that was right
    spdlog::level::level_enum level = spdlog::level::info;
    std::string last_line;       // of those left out
    std::uint64_t left_out = 0;  // since a line was written
  };
  double used_at(const Address& address, std::int64_t now_ns) const;
  bool may_write(Address& address, std::int64_t now_ns) const;
  void write_left_out(Address& address);
  Address& address_of(const std::string& name, std::int64_t now_ns);

  const Write write_;
  const Limit limit_;
  std::mutex mutex_;  // of all below
  std::map<std::string, Address> addresses_;
  Address others_;
};

}  // namespace incise::input
