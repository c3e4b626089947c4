#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// Saves or restores members: each class lists in archive(Archive&) the members that later revisions depend
// on, and the same list writes and reads. Absent members are scratch, stamps that are only compared with later serial
// numbers, or follow from the rest. Little-endian.
//
// An archive that reads trusts none of its bytes: the first demand that fails is its error, after which values are 0.
class Archive {
 public:
  // Writes. `expected`: bytes for which room is made at once; what is not written costs nothing.
  explicit Archive(std::size_t expected = 0) { written_.reserve(expected); }
  // Writes into this, whose bytes do not matter.
  Archive(std::vector<std::byte> into, std::size_t expected) {
    // Nothing is copied where it is too small, and the next state, which is a little larger, fits.
    if (into.capacity() >= expected) {
      written_ = std::move(into);
    } else {
      into = {};
      written_.reserve(expected + expected / 8);
    }
  }
  // Reads.
  explicit Archive(std::span<const std::byte> bytes) : reads_(true), left_(bytes) {}

  bool reads() const { return reads_; }

  template <class T>
  requires(std::is_arithmetic_v<T> || std::is_enum_v<T>) void operator()(T& value) {
    if (!reads_) {
      if (written_.size() - size_ < sizeof value) written_.resize(size_ + kStep);
      std::memcpy(written_.data() + size_, &value, sizeof value);
      size_ += sizeof value;
    } else if (left_.size() < sizeof value) {
      demand(false, "it ends too early");
      value = {};
    } else {
      std::memcpy(&value, left_.data(), sizeof value);
      left_ = left_.subspan(sizeof value);
    }
  }
  void operator()(bool& value) {
    auto byte = static_cast<std::uint8_t>(value);
    (*this)(byte);
    demand(byte <= 1, "a flag is neither 0 nor 1");
    value = byte == 1;
  }
  void operator()(Vec3& v) {
    (*this)(v.x);
    (*this)(v.y);
    (*this)(v.z);
    demand(is_finite(v), "a coordinate is not finite");
  }
  // The count, then each element by `element`. `least_bytes`: the size of the smallest element, so that a wrong count allocates nothing.
  template <class T, class Element>
  void list(std::vector<T>& values, std::size_t least_bytes, Element element) {
    std::uint64_t count = values.size();
    (*this)(count);
    if (reads_) {
      demand(count <= left_.size() / least_bytes, "a list is longer than what is left");
      if (failed()) return;
      values.clear();
      values.reserve(count + count / 4 + 64);
      values.resize(count);
    }
    for (T& value : values) element(value);
  }

  // A condition on the bytes that are read; it has no effect while writing.
  void demand(bool met, const char* otherwise) {
    if (!met && reads_ && error_.empty()) error_ = otherwise;
  }
  bool failed() const { return !error_.empty(); }
  const std::string& error() const { return error_; }
  bool at_end() const { return left_.empty(); }

  std::vector<std::byte> take() {
    written_.resize(size_);
    return std::move(written_);
  }

 private:
  // Zeros are written so far ahead: few enough to be in the cache still when they are overwritten.
  static constexpr std::size_t kStep = 32 << 10;

  bool reads_ = false;
  std::span<const std::byte> left_;
  std::vector<std::byte> written_;  // longer than what is written
  std::size_t size_ = 0;            // of what is written
  std::string error_;
};

}  // namespace incise::core
