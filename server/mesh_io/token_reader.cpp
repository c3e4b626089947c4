#include "server/mesh_io/token_reader.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

bool is_blank(char c) {
  return c == ' ' || (c >= '\t' && c <= '\r');
}

}  // namespace

void TokenReader::skip_blanks() {
  while (position_ < bytes_.size()) {
    if (is_blank(bytes_[position_])) {
      ++position_;
    } else if (comment_ != '\0' && bytes_[position_] == comment_) {
      position_ = std::min(bytes_.find('\n', position_), bytes_.size());
    } else {
      return;
    }
  }
}

bool TokenReader::at_end() {
  skip_blanks();
  return position_ == bytes_.size();
}

std::string_view TokenReader::peek() {
  skip_blanks();
  std::size_t end = position_;
  while (end < bytes_.size() && !is_blank(bytes_[end]) && (comment_ == '\0' || bytes_[end] != comment_))
    ++end;
  return bytes_.substr(position_, end - position_);
}

std::string_view TokenReader::token(std::string_view what) {
  const std::string_view field = peek();
  if (field.empty()) fail_short(what);
  last_ = position_;
  position_ += field.size();
  return field;
}

std::string_view TokenReader::line() {
  last_ = position_;
  const std::size_t end = std::min(bytes_.find('\n', position_), bytes_.size());
  std::string_view text = bytes_.substr(position_, end - position_);
  position_ = std::min(end + 1, bytes_.size());
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

double TokenReader::number(std::string_view what) {
  const double value = any_number(what);
  if (!std::isfinite(value))
    fail(std::string(what) + " is " + in_quotes(bytes_.substr(last_, position_ - last_)) +
         ", not a finite number");
  return value;
}

double TokenReader::any_number(std::string_view what) {
  const std::string_view all = token(what);
  const std::string_view field = all.starts_with('+') ? all.substr(1) : all;
  double value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  // A number too small for a double is zero for any mesh; one too large is refused below.
  if (error == std::errc::result_out_of_range) {
    value = std::strtod(std::string(field).c_str(), nullptr);
  } else if (error != std::errc() || end != field.data() + field.size()) {
    fail(std::string(what) + " is " + in_quotes(all) + ", not a number");
  }
  return value;
}

std::int64_t TokenReader::integer(std::string_view what) {
  const std::string_view all = token(what);
  const std::string_view field = all.starts_with('+') ? all.substr(1) : all;
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size()) {
    fail(std::string(what) + " is " + in_quotes(all) + ", not an integer");
  }
  return value;
}

std::string_view TokenReader::take(std::size_t size, std::string_view what) {
  last_ = position_;
  if (remaining() < size) fail_short(what);
  position_ += size;
  return bytes_.substr(last_, size);
}

bool TokenReader::skip_past(std::string_view text) {
  const std::size_t found = bytes_.find(text, position_);
  if (found == bytes_.npos) return false;
  position_ = found + text.size();
  return true;
}

std::size_t TokenReader::checked_count(std::int64_t value, std::string_view what,
                                       std::size_t least_bytes) const {
  const std::size_t limit = remaining() / least_bytes + 1;
  if (value < 0 || static_cast<std::uint64_t>(value) > limit) {
    fail(std::string(what) + " is " + std::to_string(value) + "; at most " + std::to_string(limit) + kFit);
  }
  return static_cast<std::size_t>(value);
}

void TokenReader::fail_range(std::int64_t value, std::string_view what) const {
  fail(std::string(what) + " is " + std::to_string(value) + ", out of range");
}

void TokenReader::fail_short(std::string_view what) const {
  throw MeshError(file_name_ + ": ends where " + std::string(what) + " should be: the file is cut short");
}

void TokenReader::fail(std::string_view message) const {
  if (binary_) {
    throw MeshError(file_name_ + ", byte " + std::to_string(last_) + ": " + std::string(message));
  }
  const auto line = 1 + std::count(bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(last_), '\n');
  throw MeshError(file_name_ + ":" + std::to_string(line) + ": " + std::string(message));
}

}  // namespace incise::mesh_io
