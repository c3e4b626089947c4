#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

namespace incise::mesh_io {

// The bytes of a regular file. Throws MeshError if it is missing, not a regular file, empty or unreadable.
std::string read_whole_file(const std::filesystem::path& path);

// Writes `bytes` to a temporary file beside `path` and renames it there, so that a reader never sees half a
// file. Throws MeshError naming the path and the system's reason.
void write_whole_file(const std::filesystem::path& path, std::string_view bytes);

struct FileToWrite {
  const std::filesystem::path& path;
  std::string_view bytes;
};
// As write_whole_file; none is renamed before all are written: on a full disk none is there.
void write_whole_files(std::initializer_list<FileToWrite> files);

// Appends a number: a double in 17 significant digits, which read back as the same double.
void append_number(std::string& text, double number);
void append_number(std::string& text, std::int64_t number);

// With A to Z as a to z; nothing else changes.
std::string lowercase(std::string_view text);

// The end of a message about a count that is too large for the rest of a file.
extern const char* const kFit;

// At most 40 printable characters of a field, in quotes, for a message: a binary file read as text must not spill into
// it.
std::string in_quotes(std::string_view field);

// Walks over the lines of a text file that are not blank and not comments, split into fields.
// Keeps views into `text`, which must outlive it.
class LineReader {
 public:
  // `comment`: the character that starts a comment, which ends with the line; '\0': none.
  LineReader(std::string_view text, std::string file_name, char comment = '#');

  // Moves to the next line with a field. False at the end of the text.
  bool next();
  // As next(), but the end of the text is an error: "FILE: ends where WHAT should be".
  void require(std::string_view what);

  const std::vector<std::string_view>& fields() const { return fields_; }
  std::size_t size() const { return fields_.size(); }
  std::string_view field(std::size_t i) const { return fields_[i]; }
  // Field i as a number; `what` names it in the error. A number is finite and fills its field.
  double number(std::size_t i, std::string_view what) const;
  std::int64_t integer(std::size_t i, std::string_view what) const;
  // Field i as a count: an integer in [0, limit].
  std::size_t count(std::size_t i, std::string_view what, std::size_t limit) const;
  // Field i as a count of things that each take at least `least_bytes` of the rest of the file: more cannot follow.
  std::size_t count_of_rest(std::size_t i, std::string_view what, std::size_t least_bytes) const;

  std::size_t line() const { return line_; }
  // Bytes from the end of the current line to the end of the text: bounds any declared count.
  std::size_t remaining() const { return text_.size() - position_; }
  std::size_t position() const { return position_; }

  // Throws MeshError "FILE:LINE: message".
  [[noreturn]] void fail(std::string_view message) const;

 private:
  std::string_view text_;
  std::string file_name_;
  std::vector<std::string_view> fields_;
  std::size_t position_ = 0;
  std::size_t line_ = 0;
  char comment_;
};

}  // namespace incise::mesh_io
