#pragma once

#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace incise::input {

// JSON with comments; a key that occurs twice in one object is refused, since JSON does not say which counts. Throws
// std::runtime_error with file, place and fault in one line.
nlohmann::ordered_json parse_json(std::string_view text, const std::string& file);
// For errors: a value in one line of at most 80 characters; a number with the fewest digits that identify it.
std::string shown(const nlohmann::ordered_json& value);
std::string text_of(double number);

// A value in a JSON file that knows its place, so that an error names file, key, what was found and what is accepted.
// Thread: any one. Owns: nothing; file and document must outlive it.
class JsonNode {
 public:
  using Json = nlohmann::ordered_json;

  JsonNode(const Json& json, std::string key, const std::string& file)
      : json_(&json), key_(std::move(key)), file_(&file) {}
  [[noreturn]] void refuse(const std::string& accepted) const;
  [[noreturn]] void refuse(const std::string& found, const std::string& accepted) const;
  // Refuses anything but an object, and keys other than these.
  const JsonNode& only(std::initializer_list<const char*> keys) const;
  bool has(const char* key) const { return json_->is_object() && json_->contains(key); }
  // The member; an error if it is absent.
  JsonNode at(const char* key) const;
  std::vector<JsonNode> list(std::size_t least, std::size_t most) const;

  double number(double least, double most) const;
  std::int64_t integer(std::int64_t least, std::int64_t most) const;
  std::string text(std::size_t least, std::size_t most) const;
  bool truth() const;
  // Index of the value among the words.
  std::size_t word(std::initializer_list<const char*> words) const;
  bool is_text() const { return json_->is_string(); }

 private:
  const Json* json_;
  std::string key_;
  const std::string* file_;
};

}  // namespace incise::input
