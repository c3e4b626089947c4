#include "protocol/motion.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <istream>
#include <limits>
#include <optional>
#include <string_view>

#include "protocol/limits.hpp"

namespace incise::protocol {
namespace {

enum Column : std::size_t { kT, kX, kY, kZ, kQw, kQx, kQy, kQz, kButton, kColumns };
constexpr std::array<std::string_view, kColumns> kNames{"t_s", "x_m", "y_m", "z_m",   "qw",
                                                        "qx",  "qy",  "qz",  "button"};
// The columns of a TUM line.
constexpr std::array<Column, 8> kTum{kT, kX, kY, kZ, kQx, kQy, kQz, kQw};
constexpr double kMotionQuaternionTolerance = 0.1;

std::string_view trim(std::string_view text) {
  constexpr std::string_view kSpace = " \t\r\n";
  const std::size_t first = text.find_first_not_of(kSpace);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kSpace) - first + 1);
}

std::vector<std::string_view> split_commas(std::string_view line) {
  std::vector<std::string_view> fields;
  for (std::size_t comma; (comma = line.find(',')) != std::string_view::npos; line.remove_prefix(comma + 1)) {
    fields.push_back(trim(line.substr(0, comma)));
  }
  fields.push_back(trim(line));
  return fields;
}

std::vector<std::string_view> split_spaces(std::string_view line) {
  std::vector<std::string_view> fields;
  for (line = trim(line); !line.empty(); line = trim(line)) {
    const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
    fields.push_back(line.substr(0, end));
    line.remove_prefix(end);
  }
  return fields;
}

std::optional<double> parse_number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

// Seconds to nanoseconds. Plain decimals keep every digit down to the nanosecond, which a double cannot for
// times since 1970.
std::optional<std::int64_t> parse_seconds(std::string_view text) {
  const std::optional<double> approximate = parse_number(text);
  if (!approximate || std::abs(*approximate) > 9e9) return std::nullopt;
  if (text.find_first_of("eE") != std::string_view::npos) return std::llround(*approximate * 1e9);
  const bool negative = text.starts_with('-');
  if (negative || text.starts_with('+')) text.remove_prefix(1);
  std::int64_t ns = 0;
  std::size_t digits_after = 0;
  bool after = false;
  for (const char c : text) {
    if (c == '.') {
      after = true;
    } else if (digits_after < 9) {
      ns = 10 * ns + (c - '0');
      digits_after += after ? 1 : 0;
    }
  }
  for (; digits_after < 9; ++digits_after) ns *= 10;
  return negative ? -ns : ns;
}

class MotionReader {
 public:
  MotionReader(std::istream& in, const std::string& name) : in_(in), name_(name) {}

  Motion read() {
    std::string_view line;
    while (next_line(line)) {
      if (line.starts_with('#')) continue;
      if (!known_) {
        known_ = true;
        csv_ = line.find(',') != std::string_view::npos;
        if (csv_) {
          read_names(line);
          continue;
        }
        motion_.has_orientation = true;
      }
      const auto fields = csv_ ? split_commas(line) : split_spaces(line);
      csv_ ? take_csv(fields) : take_tum(fields);
      add_sample();
    }
    if (motion_.samples.empty())
      fail("no sample; accepted are TUM lines (t x y z qx qy qz qw) or CSV with a header");
    return std::move(motion_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw MotionError(name_ + ":" + std::to_string(line_number_) + ": " + what);
  }

  // The next line that is not empty, without the space around it; false at the end.
  bool next_line(std::string_view& line) {
    for (;;) {
      text_.clear();
      int c;
      while ((c = in_.get()) != std::istream::traits_type::eof() && c != '\n') {
        if (text_.size() == kMaxMotionLineBytes) {
          ++line_number_;
          fail("line of more than " + std::to_string(kMaxMotionLineBytes) + " bytes");
        }
        text_.push_back(static_cast<char>(c));
      }
      if (c == std::istream::traits_type::eof() && text_.empty()) return false;
      ++line_number_;
      line = text_;
      if (line_number_ == 1 && line.starts_with("\xef\xbb\xbf")) line.remove_prefix(3);  // byte order mark
      line = trim(line);
      if (!line.empty()) return true;
    }
  }

  void read_names(std::string_view line) {
    const auto names = split_commas(line);
    for (std::size_t i = 0; i < names.size(); ++i) {
      const auto known = std::find(kNames.begin(), kNames.end(), names[i]);
      if (known == kNames.end()) continue;
      std::optional<std::size_t>& place = place_[static_cast<std::size_t>(known - kNames.begin())];
      if (place) fail("column " + std::string(names[i]) + " twice");
      place = i;
    }
    names_ = names.size();
    for (const Column c : {kT, kX, kY, kZ}) {
      if (!place_[c])
        fail("no column " + std::string(kNames[c]) + "; accepted are t_s,x_m,y_m,z_m[,qw,qx,qy,qz][,button]");
    }
    const bool any = place_[kQw] || place_[kQx] || place_[kQy] || place_[kQz];
    motion_.has_orientation = place_[kQw] && place_[kQx] && place_[kQy] && place_[kQz];
    if (any && !motion_.has_orientation)
      fail("only some of the columns qw, qx, qy, qz; accepted are all or none");
    motion_.has_buttons = place_[kButton].has_value();
  }

  void take_csv(const std::vector<std::string_view>& fields) {
    if (fields.size() != names_) {
      fail(std::to_string(fields.size()) + " fields where the header has " + std::to_string(names_));
    }
    for (std::size_t c = 0; c < kColumns; ++c) {
      if (place_[c]) take(static_cast<Column>(c), fields[*place_[c]]);
    }
  }

  void take_tum(const std::vector<std::string_view>& fields) {
    if (fields.size() != kTum.size()) {
      fail(std::to_string(fields.size()) + " fields, accepted are 8: t x y z qx qy qz qw");
    }
    for (std::size_t i = 0; i < kTum.size(); ++i) take(kTum[i], fields[i]);
  }

  void take(Column column, std::string_view text) {
    if (column == kT) {
      const auto ns = parse_seconds(text);
      if (!ns) fail("t_s is '" + std::string(text) + "', accepted are seconds within +-9e9");
      sample_.source_ns = *ns;
      return;
    }
    const auto value = parse_number(text);
    if (!value)
      fail(std::string(kNames[column]) + " is '" + std::string(text) + "', accepted are finite numbers");
    if (column >= kX && column <= kZ && std::abs(*value) > kMaxCoordinate) {
      fail(std::string(kNames[column]) + " is " + std::string(text) +
           ", accepted are coordinates within +-1e6 m");
    }
    switch (column) {
      case kX:
        sample_.position.x = *value;
        break;
      case kY:
        sample_.position.y = *value;
        break;
      case kZ:
        sample_.position.z = *value;
        break;
      case kQw:
        sample_.orientation.w = *value;
        break;
      case kQx:
        sample_.orientation.x = *value;
        break;
      case kQy:
        sample_.orientation.y = *value;
        break;
      case kQz:
        sample_.orientation.z = *value;
        break;
      default:
        if (*value < 0 || *value > std::numeric_limits<std::uint32_t>::max() ||
            *value != std::floor(*value)) {
          fail("button is '" + std::string(text) + "', accepted are whole numbers from 0 to 4294967295");
        }
        sample_.buttons = static_cast<std::uint32_t>(*value);
    }
  }

  void add_sample() {
    if (motion_.has_orientation) {
      Quat& q = sample_.orientation;
      const double length = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
      if (!(std::abs(length - 1) <= kMotionQuaternionTolerance)) {
        fail("quaternion of length " + std::to_string(length) + ", accepted are 0.9 to 1.1");
      }
      q = {q.w / length, q.x / length, q.y / length, q.z / length};
    }
    if (!motion_.samples.empty()) {
      const PoseSample& last = motion_.samples.back();
      if (sample_ == last) {
        ++motion_.repeated;
        return;
      }
      if (sample_.source_ns <= last.source_ns) {
        fail("time " + std::to_string(sample_.source_ns) + " ns after " + std::to_string(last.source_ns) +
             " ns, accepted are rising times");
      }
    }
    if (motion_.samples.size() == kMaxMotionSamples) {
      fail("more than " + std::to_string(kMaxMotionSamples) + " samples");
    }
    motion_.samples.push_back(sample_);
  }

  std::istream& in_;
  const std::string& name_;
  std::size_t line_number_ = 0;
  std::string text_;
  bool known_ = false;  // the format
  bool csv_ = false;
  std::array<std::optional<std::size_t>, kColumns> place_;
  std::size_t names_ = 0;
  PoseSample sample_;
  Motion motion_;
};

}  // namespace

Motion read_motion(std::istream& in, const std::string& name) {
  return MotionReader(in, name).read();
}

Motion read_motion(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) throw MotionError(path + ": cannot be opened");
  return read_motion(in, path);
}

BladeEdge parse_blade(const std::string& option, const std::string& text) {
  double number[6] = {};
  const char* at = text.data();
  const char* const end = at + text.size();
  bool good = true;
  for (int i = 0; i < 6 && good; ++i) {
    const auto [next, error] = std::from_chars(at, end, number[i]);
    const char wanted = i == 2 ? ':' : ',';
    good = error == std::errc() && std::abs(number[i]) <= kMaxBladeCoordinate &&
           (i == 5 ? next == end : next != end && *next == wanted);
    at = next + 1;
  }
  const BladeEdge blade{{number[0], number[1], number[2]}, {number[3], number[4], number[5]}};
  if (!good || blade.heel == blade.tip) {
    throw MotionError(
        option + ": found \"" + text +
        "\"; accepted is hx,hy,hz:tx,ty,tz, heel and tip in the tool's frame in metres, each from "
        "-10000 to 10000, and not the same point");
  }
  return blade;
}

}  // namespace incise::protocol
