#include "server/mesh_io/text_file.hpp"

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <memory>
#include <utility>
#include <vector>

#include "server/base/unfinished_file.hpp"
#include "server/mesh_io/mesh_error.hpp"

namespace incise::mesh_io {
namespace {

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

[[noreturn]] void fail_to_write(const std::filesystem::path& path, const std::string& reason) {
  throw MeshError(path.string() + ": cannot be written: " + reason);
}

void write_temporary(const UnfinishedFile& to, std::string_view bytes) {
  std::unique_ptr<std::FILE, CloseFile> file(std::fopen(to.temporary().c_str(), "wb"));
  if (!file || std::fwrite(bytes.data(), 1, bytes.size(), file.get()) != bytes.size() ||
      std::fclose(file.release()) != 0)
    fail_to_write(to.path(), std::strerror(errno));
}

}  // namespace

const char* const kFit = " fit in the rest of the file: it is cut short, or the number is wrong";

std::string lowercase(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) c = static_cast<char>(c >= 'A' && c <= 'Z' ? c + 32 : c);
  return lower;
}

std::string in_quotes(std::string_view field) {
  std::string text = "'";
  for (const char c : field.substr(0, 40)) text += c >= ' ' && c <= '~' ? c : '?';
  return text + (field.size() > 40 ? "...'" : "'");
}

std::string to_text(double number) {
  char buffer[32];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, number).ptr;
  return {buffer, end};
}

std::string to_text(const core::Vec3& point) {
  char buffer[96];
  std::snprintf(buffer, sizeof buffer, "(%.9g, %.9g, %.9g)", point.x, point.y, point.z);
  return buffer;
}

std::string read_whole_file(const std::filesystem::path& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) throw MeshError(path.string() + ": no such file");
  // A FIFO or a device would block or never end.
  if (!std::filesystem::is_regular_file(status)) throw MeshError(path.string() + ": not a regular file");
  const std::unique_ptr<std::FILE, CloseFile> file(std::fopen(path.c_str(), "rb"));
  if (!file) throw MeshError(path.string() + ": cannot be opened: " + std::strerror(errno));
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw MeshError(path.string() + ": cannot be read: " + error.message());
  std::string bytes(size, '\0');
  bytes.resize(std::fread(bytes.data(), 1, bytes.size(), file.get()));
  if (std::ferror(file.get())) throw MeshError(path.string() + ": cannot be read: " + std::strerror(errno));
  if (bytes.empty()) throw MeshError(path.string() + ": the file is empty");
  return bytes;
}

void write_whole_file(const std::filesystem::path& path, std::string_view bytes) {
  write_whole_files({{path, bytes}});
}

void write_whole_files(std::initializer_list<FileToWrite> files) {
  std::vector<UnfinishedFile> written;
  for (const auto& [path, bytes] : files) write_temporary(written.emplace_back(path), bytes);
  for (UnfinishedFile& file : written) {
    if (const std::error_code error = file.finish()) fail_to_write(file.path(), error.message());
  }
}

void append_number(std::string& text, double number) {
  char buffer[40];
  text.append(buffer,
              std::to_chars(buffer, buffer + sizeof buffer, number, std::chars_format::general, 17).ptr);
}

void append_number(std::string& text, std::int64_t number) {
  char buffer[24];
  text.append(buffer, std::to_chars(buffer, buffer + sizeof buffer, number).ptr);
}

LineReader::LineReader(std::string_view text, std::string file_name, char comment)
    : text_(text), file_name_(std::move(file_name)), comment_(comment) {
  if (text_.starts_with("\xef\xbb\xbf")) position_ = 3;  // a byte order mark
}

bool LineReader::next() {
  fields_.clear();
  while (position_ < text_.size()) {
    ++line_;
    const auto end = std::min(text_.find('\n', position_), text_.size());
    std::string_view line = text_.substr(position_, end - position_);
    position_ = std::min(end + 1, text_.size());
    if (comment_ != '\0') line = line.substr(0, line.find(comment_));
    for (std::size_t i = 0; i < line.size();) {
      const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; };
      while (i < line.size() && blank(line[i])) ++i;
      const std::size_t begin = i;
      while (i < line.size() && !blank(line[i])) ++i;
      if (i > begin) fields_.push_back(line.substr(begin, i - begin));
    }
    if (!fields_.empty()) return true;
  }
  return false;
}

void LineReader::require(std::string_view what) {
  if (!next())
    throw MeshError(file_name_ + ": ends after line " + std::to_string(line_) + ", where " +
                    std::string(what) + " should be: the file is cut short");
}

double LineReader::number(std::size_t i, std::string_view what) const {
  if (i >= fields_.size()) fail(std::string(what) + " is missing");
  std::string_view field = fields_[i];
  if (field.starts_with('+')) field.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  // A number too small for a double is zero for any mesh; one too large is refused below.
  if (error == std::errc::result_out_of_range) {
    value = std::strtod(std::string(field).c_str(), nullptr);
  } else if (error != std::errc() || end != field.data() + field.size()) {
    fail(std::string(what) + " is " + in_quotes(fields_[i]) + ", not a number");
  }
  if (!std::isfinite(value))
    fail(std::string(what) + " is " + in_quotes(fields_[i]) + ", not a finite number");
  return value;
}

std::int64_t LineReader::integer(std::size_t i, std::string_view what) const {
  if (i >= fields_.size()) fail(std::string(what) + " is missing");
  std::string_view field = fields_[i];
  if (field.starts_with('+')) field.remove_prefix(1);
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size()) {
    fail(std::string(what) + " is " + in_quotes(fields_[i]) + ", not an integer");
  }
  return value;
}

std::size_t LineReader::count(std::size_t i, std::string_view what, std::size_t limit) const {
  const std::int64_t value = integer(i, what);
  if (value < 0 || static_cast<std::uint64_t>(value) > limit) {
    fail(std::string(what) + " is " + std::to_string(value) + "; accepted are 0 to " + std::to_string(limit));
  }
  return static_cast<std::size_t>(value);
}

std::size_t LineReader::count_of_rest(std::size_t i, std::string_view what, std::size_t least_bytes) const {
  const std::int64_t value = integer(i, what);
  const std::size_t limit = remaining() / least_bytes + 1;
  if (value < 0 || static_cast<std::uint64_t>(value) > limit) {
    fail(std::string(what) + " is " + std::to_string(value) + "; at most " + std::to_string(limit) + kFit);
  }
  return static_cast<std::size_t>(value);
}

void LineReader::fail(std::string_view message) const {
  throw MeshError(file_name_ + ":" + std::to_string(line_) + ": " + std::string(message));
}

}  // namespace incise::mesh_io
