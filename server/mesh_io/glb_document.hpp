#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/mesh_io/surface_reading.hpp"

namespace incise::mesh_io {

// Rows of numbers within the data of a .glb, all of them checked to be there.
struct Accessor {
  const char* first = nullptr;
  std::size_t rows = 0, stride = 0, columns = 0;
  std::uint64_t type = 0;  // glTF's number
  bool normalized = false;
  std::string name;  // "accessor 3", for messages

  double value(std::size_t row, std::size_t column) const {
    const char* at = first + row * stride;
    switch (type) {
      case 5121:
        return load<std::uint8_t>(at + column) / (normalized ? 255.0 : 1.0);
      case 5123:
        return load<std::uint16_t>(at + 2 * column) / (normalized ? 65535.0 : 1.0);
      case 5125:
        return load<std::uint32_t>(at + 4 * column);
      default:
        return static_cast<double>(load<float>(at + 4 * column));
    }
  }
};

// A .glb file: its JSON, and the data that this refers to, with every reference checked before anything is read there. All that
// is wrong throws MeshError, with the place in `what` or `name` ("node 3").
class GlbDocument {
 public:
  using Json = nlohmann::json;

  // `bytes` outlives it. Lines in `warnings` for what is left out.
  GlbDocument(const std::filesystem::path& path, std::string_view bytes, std::vector<std::string>& warnings);

  const Json& json() const { return json_; }
  std::size_t data_size() const { return data_.size(); }

  [[noreturn]] void fail(const std::string& message) const;
  void warn(const std::string& message) const;

  // Null where there is none.
  static const Json* find(const Json& object, const char* key);
  // Of an element of a list of references; the largest number where it is none, which refers to nothing.
  static std::size_t index(const Json& value);
  // A whole number, `otherwise` where there is none.
  std::size_t whole(const Json& object, const char* key, std::size_t otherwise,
                    const std::string& what) const;
  // Number i of one of the document's lists. `what` refers to it.
  const Json& item(const char* list, std::size_t i, const std::string& what) const;
  // N finite numbers, `otherwise` where there are none.
  template <std::size_t N>
  std::array<double, N> numbers(const Json& object, const char* key, const std::array<double, N>& otherwise,
                                const std::string& what) const {
    const Json* values = find(object, key);
    if (values == nullptr) return otherwise;
    std::array<double, N> out{};
    bool good = values->is_array() && values->size() == N;
    for (std::size_t i = 0; good && i < N; ++i) {
      good = (*values)[i].is_number();
      if (good) out[i] = (*values)[i].get<double>();
      good = good && std::isfinite(out[i]);
    }
    if (!good) fail(what + ": " + key + " is not " + std::to_string(N) + " finite numbers");
    return out;
  }

  // The bytes of bufferView i, and its stride; 0: none.
  std::pair<std::string_view, std::size_t> view(std::size_t i, const std::string& what) const;
  Accessor accessor(std::size_t i, const std::string& what) const;
  // An attribute of a primitive: `rows` of as many floats, or with `bytes_too` of normalized bytes or shorts, too. A colour may lack its alpha.
  // Null `first`: the primitive has none.
  Accessor attribute(const Json& attributes, const std::string& key, std::size_t rows, std::size_t columns,
                     bool bytes_too) const;
  // A value of it, which is finite.
  float finite(const Accessor& from, std::size_t row, std::size_t column) const;

 private:
  void split();
  // The part of the file that begins there, if it is of this kind; else without data().
  std::string_view chunk(std::size_t at, std::string_view kind) const;
  void check_extensions() const;

  std::filesystem::path path_;
  std::string_view bytes_, data_;
  std::vector<std::string>& warnings_;
  Json json_;
};

}  // namespace incise::mesh_io
