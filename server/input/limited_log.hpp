#pragma once

#include <spdlog/common.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>

namespace incise::input {

// Log lines that peers can cause. From each address ten at once, then one in five seconds, so that one address cannot
// hide what another does. Of the lines left out the last is written when its address may write again, with the number
// of the others: by the next write() from there or by flush(), which the owner calls every second or so.
//
// Thread: any. Memory: bounded. Beyond kMaxAddresses that are busy, the rest share one limit.
class LimitedLog {
 public:
  static constexpr double kBurst = 10, kEach_s = 5;
  static constexpr std::size_t kMaxAddresses = 64;
  using Write = std::function<void(spdlog::level::level_enum, const std::string&)>;

  // To spdlog.
  LimitedLog();
  explicit LimitedLog(Write write) : write_(std::move(write)) {}

  void write(spdlog::level::level_enum level, const std::string& address, const std::string& line,
             std::int64_t now_ns);
  void flush(std::int64_t now_ns);

 private:
  struct Address {
    double tokens = kBurst;
    std::int64_t last_ns = 0;  // when tokens was right
    spdlog::level::level_enum level = spdlog::level::info;
    std::string last_line;       // of those left out
    std::uint64_t left_out = 0;  // since a line was written
  };
  static double tokens_at(const Address& address, std::int64_t now_ns);
  static void refill(Address& address, std::int64_t now_ns);
  void write_left_out(Address& address);
  Address& address_of(const std::string& name, std::int64_t now_ns);

  const Write write_;
  std::mutex mutex_;  // of all below
  std::map<std::string, Address> addresses_;
  Address others_;
};

}  // namespace incise::input
