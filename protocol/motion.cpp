#include "protocol/motion.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <istream>
#include <limits>
#include <optional>
#include <sstream>
#include <string_view>
#include <system_error>
#include <utility>

#include "protocol/limits.hpp"

namespace incise::protocol {
namespace {

enum Column : std::size_t { kT, kX, kY, kZ, kQw, kQx, kQy, kQz, kButton, kColumns };
constexpr std::array<std::string_view, kColumns> kNames{"t_s", "x_m", "y_m", "z_m",   "qw",
                                                        "qx",  "qy",  "qz",  "button"};
// The columns of a TUM line.
constexpr std::array<Column, 8> kTum{kT, kX, kY, kZ, kQx, kQy, kQz, kQw};
constexpr double kMotionQuaternionTolerance = 0.1;
// How far back a clock must go to count as restarted, how soon the next sample must follow, and the pause in between.
constexpr std::int64_t kRestart_ns = 1'000'000'000;
constexpr const char* kTumLine = "t x y z qx qy qz qw";
constexpr const char* kCsvHeader = "t_s,x_m,y_m,z_m[,qw,qx,qy,qz][,button]";

std::string fields_text(std::size_t n) {
  return std::to_string(n) + (n == 1 ? " field" : " fields");
}

// At most 40 printable characters of a field, in quotes: a binary file read as text must not spill into a message.
std::string in_quotes(std::string_view field) {
  std::string text = "'";
  for (const char c : field.substr(0, 40)) text += c >= ' ' && c <= '~' ? c : '?';
  return text + (field.size() > 40 ? "...'" : "'");
}

std::string_view trim(std::string_view text) {
  constexpr std::string_view kSpace = " \t\r\n";
  const std::size_t first = text.find_first_not_of(kSpace);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kSpace) - first + 1);
}

std::vector<std::string_view> split_at(char separator, std::string_view line) {
  std::vector<std::string_view> fields;
  for (std::size_t end; (end = line.find(separator)) != std::string_view::npos; line.remove_prefix(end + 1)) {
    fields.push_back(trim(line.substr(0, end)));
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
  MotionReader(std::istream& in, const std::string& name, Times times)
      : in_(in), name_(name), samples_(name, times) {}

  Motion read() {
    std::string_view line;
    while (next_line(line)) {
      if (line.starts_with('#')) continue;
      if (!known_) {
        known_ = true;
        // Spreadsheets that write decimal commas separate by semicolons.
        const std::size_t end = line.find_first_of(",;");
        motion_.csv = end != std::string_view::npos;
        if (motion_.csv) separator_ = line[end];
        if (motion_.csv) {
          read_names(line);
          continue;
        }
        check_first_tum(line);
        motion_.has_orientation = true;
      }
      const auto fields = motion_.csv ? split_at(separator_, line) : split_spaces(line);
      motion_.csv ? take_csv(fields) : take_tum(fields);
      add_sample();
    }
    if (samples_.size() == 0) fail_without_samples();
    samples_.finish(motion_);
    return std::move(motion_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw MotionError(name_ + ":" + std::to_string(line_number_) + ": " + what);
  }

  // The first line can be no part of a motion.
  [[noreturn]] void fail_unknown(const std::string& what) const {
    throw NotAMotion(name_ + ":" + std::to_string(line_number_) + ": " + what);
  }

  [[noreturn]] void fail_without_samples() const {
    const std::string what = line_number_ == 0 ? "the file is empty"
                             : !known_         ? "no samples, only comments and empty lines"
                                               : "no samples behind the header";
    throw EmptyMotion(name_ + ": " + what + "; accepted are TUM lines (" + kTumLine +
                      ") or CSV with the header " + kCsvHeader);
  }

  void check_first_tum(std::string_view line) const {
    const std::string_view first = line.substr(0, line.find_first_of(" \t"));
    if (!parse_number(first)) {
      fail_unknown("not a motion: it begins with " + in_quotes(first) + "; accepted are TUM lines (" +
                   kTumLine + ") or CSV with the header " + kCsvHeader);
    }
  }

  // The next line that is not empty, without the space around it; false at the end.
  bool next_line(std::string_view& line) {
    for (;;) {
      text_.clear();
      int c;
      while ((c = in_.get()) != std::istream::traits_type::eof() && c != '\n') {
        if (text_.size() == kMaxMotionLineBytes) {
          ++line_number_;
          const std::string what = "line of more than " + std::to_string(kMaxMotionLineBytes) + " bytes";
          if (!known_) fail_unknown(what + "; accepted are the lines of a motion");
          fail(what);
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
    const auto names = split_at(separator_, line);
    if (parse_number(names.front())) {
      fail_unknown("the first line of a CSV has the columns' names, in any order; it should be " +
                   std::string(kCsvHeader) + ", found " + in_quotes(line));
    }
    for (std::size_t i = 0; i < names.size(); ++i) {
      const auto known = std::find(kNames.begin(), kNames.end(), names[i]);
      if (known == kNames.end()) continue;
      std::optional<std::size_t>& place = place_[static_cast<std::size_t>(known - kNames.begin())];
      if (place) fail("column " + std::string(names[i]) + " twice");
      place = i;
    }
    names_ = names.size();
    for (const Column c : {kT, kX, kY, kZ}) {
      if (!place_[c]) {
        fail_unknown("no column " + std::string(kNames[c]) + "; accepted are " + kCsvHeader +
                     " in the first line, found " + in_quotes(line));
      }
    }
    const bool any = place_[kQw] || place_[kQx] || place_[kQy] || place_[kQz];
    motion_.has_orientation = place_[kQw] && place_[kQx] && place_[kQy] && place_[kQz];
    if (any && !motion_.has_orientation)
      fail("only some of the columns qw, qx, qy, qz; accepted are all or none");
    motion_.has_buttons = place_[kButton].has_value();
  }

  void take_csv(const std::vector<std::string_view>& fields) {
    if (fields.size() != names_) {
      fail(fields_text(fields.size()) + " where the header has " + std::to_string(names_));
    }
    for (std::size_t c = 0; c < kColumns; ++c) {
      if (place_[c]) take(static_cast<Column>(c), fields[*place_[c]]);
    }
  }

  void take_tum(const std::vector<std::string_view>& fields) {
    if (fields.size() != kTum.size()) {
      fail(fields_text(fields.size()) + ", accepted are 8: " + kTumLine);
    }
    for (std::size_t i = 0; i < kTum.size(); ++i) take(kTum[i], fields[i]);
  }

  void take(Column column, std::string_view text) {
    if (column == kT) {
      const auto ns = parse_seconds(text);
      if (!ns) {
        fail("t_s is " + in_quotes(text) + ", accepted are seconds within +-9e9" +
             (text.find(',') != std::string_view::npos ? " with a decimal point" : ""));
      }
      sample_.source_ns = *ns;
      return;
    }
    const auto value = parse_number(text);
    if (!value) {
      fail(std::string(kNames[column]) + " is " + in_quotes(text) + ", accepted are finite numbers" +
           (text.find(',') != std::string_view::npos ? " with a decimal point" : ""));
    }
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
          fail("button is " + in_quotes(text) + ", accepted are whole numbers from 0 to 4294967295");
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
    if (samples_.size() >= kMaxMotionSamples)
      fail("more than " + std::to_string(kMaxMotionSamples) + " samples");
    samples_.add(sample_, line_number_);
  }

  std::istream& in_;
  const std::string& name_;
  RisingSamples samples_;
  std::size_t line_number_ = 0;
  std::string text_;
  bool known_ = false;    // the format
  char separator_ = ',';  // of a CSV
  std::array<std::optional<std::size_t>, kColumns> place_;
  std::size_t names_ = 0;
  PoseSample sample_;
  Motion motion_;
};

}  // namespace

void RisingSamples::fail(std::size_t line, const std::string& what) const {
  throw MotionError(name_ + (line > 0 ? ":" + std::to_string(line) : "") + ": " + what);
}

void RisingSamples::add(PoseSample sample, std::size_t line) {
  const std::int64_t file_ns = sample.source_ns;
  if (std::exchange(begins_clock_, false)) take_up_clock(file_ns, line);
  if (__builtin_add_overflow(file_ns, shift_ns_, &sample.source_ns))
    fail(line, "t_s is out of range after the clock's restart");
  if (!samples_.empty() && sample.source_ns <= samples_.back().source_ns) {
    handle_earlier(sample, file_ns, line);
    return;
  }
  skip_early();
  samples_.push_back(sample);
}

void RisingSamples::take_up_clock(std::int64_t file_ns, std::size_t line) {
  skip_early();
  const std::int64_t last_ns = samples_.back().source_ns;
  shift_ns_ = 0;
  std::int64_t then_ns = 0;
  if (file_ns <= last_ns && (__builtin_add_overflow(last_ns, kRestart_ns, &then_ns) ||
                             __builtin_sub_overflow(then_ns, file_ns, &shift_ns_)))
    fail(line, "its times and those of the blade's holder before cannot be joined");
  restarts_.push_back(samples_.size());
}

// A sample that is not later than the last one kept: the clock has restarted, or the sample is skipped.
void RisingSamples::handle_earlier(const PoseSample& sample, std::int64_t file_ns, std::size_t line) {
  const std::string times =
      "time " + seconds_text(file_ns) + " after " + seconds_text(samples_.back().source_ns - shift_ns_);
  if (times_ == Times::kRefuse) fail(line, times + ", accepted are rising times");
  if (early_ && continues(file_ns)) {
    restart(sample, file_ns);
    return;
  }
  skip_early();
  early_ = Early{sample, file_ns, (line > 0 ? "line " + std::to_string(line) + ": " : "") + times};
}

// Whether a sample follows the one that came early, as after a restart of the clock.
bool RisingSamples::continues(std::int64_t file_ns) const {
  const std::int64_t last_ns = samples_.back().source_ns;
  if (early_->sample.source_ns >= last_ns - kRestart_ns || file_ns <= early_->file_ns) return false;
  const auto step_ns = static_cast<std::uint64_t>(file_ns) - static_cast<std::uint64_t>(early_->file_ns);
  std::int64_t shift_ns = 0;  // times of far apart ages cannot be joined
  return step_ns <= kRestart_ns && last_ns < INT64_MAX - 2 * kRestart_ns &&
         !__builtin_sub_overflow(last_ns + 2 * kRestart_ns, file_ns, &shift_ns);
}

void RisingSamples::restart(PoseSample sample, std::int64_t file_ns) {
  const std::int64_t last_ns = samples_.back().source_ns;
  if (clock_restarts_++ == 0) first_restart_ = early_->where;
  restarts_.push_back(samples_.size());
  early_->sample.source_ns = last_ns + kRestart_ns;
  sample.source_ns = early_->sample.source_ns + (file_ns - early_->file_ns);
  shift_ns_ = sample.source_ns - file_ns;
  samples_.push_back(early_->sample);
  samples_.push_back(sample);
  early_.reset();
}

// The early sample, if there is one, was not the beginning of a restart.
void RisingSamples::skip_early() {
  if (early_ && not_rising_++ == 0) first_skipped_ = early_->where;
  early_.reset();
}

void RisingSamples::finish(Motion& motion) {
  skip_early();
  motion.warning = warning();
  motion.samples = std::move(samples_);
  motion.restarts = std::move(restarts_);
  motion.not_rising = not_rising_;
}

std::string RisingSamples::warning() const {
  std::string text;
  if (not_rising_ > 0)
    text = skipped_warning(name_, not_rising_, samples_.size() + not_rising_, first_skipped_);
  if (const std::size_t n = clock_restarts_; n > 0) {
    text += (text.empty() ? name_ + ": " : "; ") + "the clock restarts " +
            (n == 1 ? "once (" : std::to_string(n) + " times (first ") + first_restart_ +
            "): what follows is kept as a new stroke, a second later";
  }
  return text;
}

std::string seconds_text(std::int64_t ns) {
  // Unsigned, so that the most negative number has an absolute value.
  const std::uint64_t all = ns < 0 ? -static_cast<std::uint64_t>(ns) : static_cast<std::uint64_t>(ns);
  std::string text = (ns < 0 ? "-" : "") + std::to_string(all / 1'000'000'000);
  std::string digits = std::to_string(1'000'000'000 + all % 1'000'000'000);
  digits.front() = '.';
  digits.erase(digits.find_last_not_of('0') + 1);
  if (digits.size() > 1) text += digits;
  return text + " s";
}

std::string skipped_warning(const std::string& name, std::size_t skipped, std::size_t samples,
                            const std::string& first) {
  return name + ": skipped " + std::to_string(skipped) + " of " + std::to_string(samples) +
         (skipped == 1 ? " samples: its time does not rise (" : " samples: their times do not rise (first ") +
         first + "); --strict refuses such files";
}

Motion read_motion(std::istream& in, const std::string& name, Times times) {
  return MotionReader(in, name, times).read();
}

Motion read_motion(const std::string& path, Times times) {
  return read_motion(*open_motion(path), path, times);
}

std::unique_ptr<std::istream> open_motion(const std::string& path) {
  auto file = std::make_unique<std::ifstream>(path, std::ios::binary);
  if (!*file) throw MotionError(path + ": cannot be opened: " + std::generic_category().message(errno));
  if (file->tellg() != std::streampos(-1)) return file;
  file->clear();
  auto bytes = std::make_unique<std::stringstream>();
  *bytes << file->rdbuf();
  bytes->clear();  // nothing came
  return bytes;
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
