#pragma once

#include <bit>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

namespace incise::mesh_io {

// Reads files in which line ends mean little and text may alternate with packed numbers: Gmsh, VTK, Medit.
// Keeps a view into `bytes`, which must outlive it.
class TokenReader {
 public:
  // `comment`: the character that starts a comment, which ends with the line; '\0': none.
  TokenReader(std::string_view bytes, std::string file_name, char comment = '\0')
      : bytes_(bytes), file_name_(std::move(file_name)), comment_(comment) {}

  // From here on value() reads packed numbers of this byte order, or text again.
  void set_text() { binary_ = false; }
  void set_binary(std::endian order) {
    binary_ = true;
    swap_ = order != std::endian::native;
  }
  bool is_binary() const { return binary_; }

  // Whether nothing but blanks and comments is left.
  bool at_end();
  // The next field, without moving; empty at the end.
  std::string_view peek();
  // The next field. The end of the file is an error: "FILE: ends where WHAT should be".
  std::string_view token(std::string_view what);
  // The rest of the current line, without blanks around it; moves to the next line.
  std::string_view line();
  // The next field as a number, which is finite and fills it.
  double number(std::string_view what);
  // The same, also "nan" and "inf".
  double any_number(std::string_view what);
  std::int64_t integer(std::string_view what);

  // A number of T's size from binary data, or a field of text that fits T.
  template <class T>
  T value(std::string_view what);
  // The number of things that follow, each of at least `least_bytes`, so that no declared count causes a larger
  // allocation than the file could fill. T: its type in a binary file.
  template <class T = std::int64_t>
  std::size_t count(std::string_view what, std::size_t least_bytes);
  // `least_bytes` of a thing that takes at least `text` bytes as text and `binary` bytes as packed numbers.
  std::size_t least(std::size_t text, std::size_t binary) const { return binary_ ? binary : text; }

  // The next `size` bytes.
  std::string_view take(std::size_t size, std::string_view what);
  // Moves past the next occurrence of `text`; false, without moving, if there is none.
  bool skip_past(std::string_view text);

  std::size_t remaining() const { return bytes_.size() - position_; }
  std::size_t position() const { return position_; }

  // Throws MeshError "FILE:LINE: message", for the field read last, or "FILE, byte N: message" in binary data.
  [[noreturn]] void fail(std::string_view message) const;
  const std::string& file_name() const { return file_name_; }

 private:
  void skip_blanks();
  [[noreturn]] void fail_short(std::string_view what) const;
  std::size_t checked_count(std::int64_t value, std::string_view what, std::size_t least_bytes) const;
  [[noreturn]] void fail_range(std::int64_t value, std::string_view what) const;

  std::string_view bytes_;
  std::string file_name_;
  std::size_t position_ = 0;
  std::size_t last_ = 0;  // where the last thing read began
  char comment_;
  bool binary_ = false, swap_ = false;
};

// A packed number at `bytes`; `swap`: its bytes are in reverse order.
template <class T>
T unpack(const char* bytes, bool swap) {
  char raw[sizeof(T)];
  for (std::size_t i = 0; i < sizeof(T); ++i) raw[i] = bytes[swap ? sizeof(T) - 1 - i : i];
  T value;
  std::memcpy(&value, raw, sizeof value);
  return value;
}

template <class T>
T TokenReader::value(std::string_view what) {
  if (binary_) return unpack<T>(take(sizeof(T), what).data(), swap_);
  if constexpr (std::floating_point<T>) {
    return static_cast<T>(number(what));
  } else {
    const std::int64_t value = integer(what);
    if (static_cast<std::int64_t>(static_cast<T>(value)) != value) fail_range(value, what);
    return static_cast<T>(value);
  }
}

template <class T>
std::size_t TokenReader::count(std::string_view what, std::size_t least_bytes) {
  return checked_count(static_cast<std::int64_t>(value<T>(what)), what, least_bytes);
}

}  // namespace incise::mesh_io
