#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <system_error>
#include <vector>

#include "protocol/capture.hpp"

namespace incise::wasm {

// A capture in memory. Thread: one.
class Recording {
 public:
  explicit Recording(const protocol::CaptureHeader& header) : writer_(sink_, header) { flush(); }
  Recording(const Recording&) = delete;
  Recording& operator=(const Recording&) = delete;

  // False: it has just stopped, for want of room; nothing is added from then on.
  bool add(const protocol::CaptureRecord& record) {
    if (state_ != protocol::Recording::On) return true;
    writer_.append(record);
    return flush();
  }
  protocol::Recording state() const { return state_; }

  // All of it, closed.
  std::vector<std::byte> capture() const {
    Sink copy = sink_;
    copy.most_bytes = SIZE_MAX;
    protocol::CaptureWriter writer(copy, copy.bytes.size(), writer_.records());
    writer.append(protocol::EndRecord{writer_.records()});
    static_cast<void>(writer.flush());
    return std::move(copy.bytes);
  }

 private:
  struct Sink final : protocol::CaptureSink {
    std::error_code append(std::span<const std::byte> more) override {
      if (bytes.size() + more.size() > most_bytes) return std::make_error_code(std::errc::no_space_on_device);
      bytes.insert(bytes.end(), more.begin(), more.end());
      return {};
    }
    std::error_code truncate(std::uint64_t size) override {
      bytes.resize(static_cast<std::size_t>(size));
      return {};
    }
    std::error_code sync() override { return {}; }

    std::vector<std::byte> bytes;
    std::size_t most_bytes = std::size_t{256} << 20;  // hours of cutting
  };

  bool flush() {
    if (!writer_.flush()) return true;
    writer_.drop_pending();
    state_ = protocol::Recording::Stopped;
    return false;
  }

  protocol::Recording state_ = protocol::Recording::On;
  Sink sink_;
  protocol::CaptureWriter writer_;
};

}  // namespace incise::wasm
