#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace incise::mesh_io {

// SHA-256 (FIPS 180-4) of what is added, in order. Numbers are hashed as in memory, little-endian.
class ContentHash {
 public:
  ContentHash();
  ~ContentHash();
  // Goes on from what the other one has.
  ContentHash(const ContentHash& other);
  ContentHash& operator=(const ContentHash&) = delete;

  void add(const void* bytes, std::size_t count);
  void add(std::uint64_t number) { add(&number, sizeof number); }
  // A length before the contents: ("ab", "c") and ("a", "bc") differ.
  void add(std::string_view text) {
    add(static_cast<std::uint64_t>(text.size()));
    add(text.data(), text.size());
  }
  template <class T>
  void add(const std::vector<T>& values) {
    add(static_cast<std::uint64_t>(values.size()));
    add(values.data(), values.size() * sizeof(T));
  }

  // 64 hexadecimal digits. Once.
  std::string hex();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace incise::mesh_io
