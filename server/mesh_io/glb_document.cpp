// Binary glTF 2.0 (Khronos, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html).
#include "server/mesh_io/glb_document.hpp"

#include <algorithm>
#include <limits>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

constexpr const char* kSaveAgain = ": save it as binary glTF 2.0 (.glb) without it";
constexpr std::size_t kHeader = 12, kChunkHeader = 8;
// A parsed document takes many times the memory of its text. That of a body has some kB.
constexpr std::size_t kMaxJsonBytes = std::size_t{64} << 20;

std::size_t size_of_type(std::uint64_t type) {
  switch (type) {
    case 5120:
    case 5121:
      return 1;
    case 5122:
    case 5123:
      return 2;
    case 5125:
    case 5126:
      return 4;
    default:
      return 0;
  }
}

}  // namespace

GlbDocument::GlbDocument(const std::filesystem::path& path, std::string_view bytes,
                         std::vector<std::string>& warnings)
    : path_(path), bytes_(bytes), warnings_(warnings) {
  split();
  check_extensions();
}

void GlbDocument::fail(const std::string& message) const {
  throw MeshError(path_.string() + ": " + message);
}

void GlbDocument::warn(const std::string& message) const {
  warnings_.push_back(path_.string() + ": " + message);
}

void GlbDocument::split() {
  if (!bytes_.starts_with("glTF")) {
    const std::size_t first = bytes_.find_first_not_of(" \t\r\n\xef\xbb\xbf");
    if (first != bytes_.npos && bytes_[first] == '{')
      fail("is glTF as text, with its data elsewhere: save it as binary glTF 2.0 (.glb)");
    fail("is not binary glTF: it does not begin with 'glTF'");
  }
  if (bytes_.size() < kHeader) fail("ends inside its header: the file is cut short");
  const auto version = load<std::uint32_t>(bytes_.data() + 4);
  if (version == 1) fail("is glTF 1: save it as glTF 2.0");
  if (version != 2) {
    fail("says in its header that it is of version " + std::to_string(version) +
         ": it is damaged, or newer than glTF 2.0, which is read");
  }
  const std::size_t length = load<std::uint32_t>(bytes_.data() + 8);
  if (length > bytes_.size()) {
    fail("has " + std::to_string(bytes_.size()) + " bytes; its header says " + std::to_string(length) +
         ": the file is cut short");
  }
  if (length < bytes_.size()) {
    warn(std::to_string(bytes_.size() - length) + " bytes after the end that its header says are left out");
    bytes_ = bytes_.substr(0, length);
  }
  const std::string_view text = chunk(kHeader, "JSON");
  if (text.data() == nullptr) fail("its first part is not JSON");
  if (text.size() > kMaxJsonBytes)
    fail("its JSON has more than the " + std::to_string(kMaxJsonBytes >> 20) + " MB that are read");
  json_ = Json::parse(text.begin(), text.end(), nullptr, false);
  if (!json_.is_object()) fail("its JSON cannot be read");
  if (const std::size_t next = kHeader + kChunkHeader + text.size(); next < bytes_.size())
    data_ = chunk(next, std::string_view("BIN\0", 4));
  const Json* asset = find(json_, "asset");
  const Json* made = asset != nullptr ? find(*asset, "version") : nullptr;
  if (made == nullptr || !made->is_string() || !made->get_ref<const std::string&>().starts_with("2."))
    fail("its asset.version is not 2.0: save it as glTF 2.0");
}

std::string_view GlbDocument::chunk(std::size_t at, std::string_view kind) const {
  if (bytes_.size() - at < kChunkHeader) fail("ends where a part should begin: the file is cut short");
  const std::size_t length = load<std::uint32_t>(bytes_.data() + at);
  if (length > bytes_.size() - at - kChunkHeader) {
    fail("a part of " + std::to_string(length) + " bytes goes beyond the end: the file is cut short");
  }
  if (bytes_.substr(at + 4, 4) != kind) return {};
  return bytes_.substr(at + kChunkHeader, length);
}

void GlbDocument::check_extensions() const {
  const Json* required = find(json_, "extensionsRequired");
  if (required == nullptr) return;
  for (const Json& name : *required) {
    const std::string text = name.is_string() ? name.get<std::string>() : "";
    if (text == "EXT_texture_webp" || text.starts_with("KHR_materials_")) continue;
    const bool packed = text.find("compression") != text.npos || text.find("quantization") != text.npos;
    fail("needs the extension " + in_quotes(text) +
         (packed ? ", a compression" + std::string(kSaveAgain) : kSaveAgain));
  }
}

const GlbDocument::Json* GlbDocument::find(const Json& object, const char* key) {
  if (!object.is_object()) return nullptr;
  const auto found = object.find(key);
  return found == object.end() ? nullptr : &*found;
}

std::size_t GlbDocument::whole(const Json& object, const char* key, std::size_t otherwise,
                               const std::string& what) const {
  const Json* value = find(object, key);
  if (value == nullptr) return otherwise;
  if (!value->is_number_unsigned()) fail(what + ": " + key + " is not a whole number");
  return value->get<std::size_t>();
}

const GlbDocument::Json& GlbDocument::item(const char* list, std::size_t i, const std::string& what) const {
  const Json* items = find(json_, list);
  const std::size_t count = items != nullptr && items->is_array() ? items->size() : 0;
  if (i >= count) {
    fail(what + " refers to " + list + " " + std::to_string(i) + ", which does not exist; there are " +
         std::to_string(count) + ", counted from 0");
  }
  return (*items)[i];
}

std::size_t GlbDocument::index(const Json& value) {
  return value.is_number_unsigned() ? value.get<std::size_t>() : std::numeric_limits<std::size_t>::max();
}

std::pair<std::string_view, std::size_t> GlbDocument::view(std::size_t i, const std::string& what) const {
  const Json& json = item("bufferViews", i, what);
  const std::string name = "bufferView " + std::to_string(i);
  const std::size_t buffer_index = whole(json, "buffer", 0, name);
  const Json& buffer = item("buffers", buffer_index, name);
  if (buffer_index != 0 || find(buffer, "uri") != nullptr) {
    fail("the data of " + name +
         " are not in the file itself: save it as one .glb with everything in it, and not compressed");
  }
  const std::size_t size = std::min(data_.size(), whole(buffer, "byteLength", 0, "buffer 0"));
  const std::size_t offset = whole(json, "byteOffset", 0, name), length = whole(json, "byteLength", 0, name);
  if (offset > size || length > size - offset) {
    fail(name + " has " + std::to_string(length) + " bytes from byte " + std::to_string(offset) +
         "; the data end at " + std::to_string(size) + ": the file is damaged");
  }
  return {data_.substr(offset, length), whole(json, "byteStride", 0, name)};
}

Accessor GlbDocument::accessor(std::size_t i, const std::string& what) const {
  const Json& json = item("accessors", i, what);
  Accessor out;
  out.name = "accessor " + std::to_string(i);
  if (find(json, "sparse") != nullptr) fail(out.name + " is sparse" + kSaveAgain);
  if (find(json, "bufferView") == nullptr) fail(out.name + " (" + what + ") has no data" + kSaveAgain);
  const auto [bytes, stride] = view(whole(json, "bufferView", 0, out.name), out.name);
  out.type = whole(json, "componentType", 0, out.name);
  const Json* kind = find(json, "type");
  for (const auto& [known, columns] :
       {std::pair<const char*, std::size_t>{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}}) {
    if (kind != nullptr && *kind == known) out.columns = columns;
  }
  const std::size_t row = out.columns * size_of_type(out.type);
  if (row == 0) fail(out.name + " (" + what + ") is of a type that is not accepted there");
  out.stride = stride == 0 ? row : stride;
  out.rows = whole(json, "count", 0, out.name);
  const Json* normalized = find(json, "normalized");
  out.normalized = normalized != nullptr && *normalized == true;
  const std::size_t offset = whole(json, "byteOffset", 0, out.name);
  if (out.stride < row || out.stride > 255) fail(out.name + ": a byteStride of " + std::to_string(stride));
  if (offset > bytes.size() ||
      (out.rows > 0 &&
       (bytes.size() - offset < row || out.rows - 1 > (bytes.size() - offset - row) / out.stride))) {
    fail(out.name + " has " + std::to_string(out.rows) + " elements; its " + std::to_string(bytes.size()) +
         " bytes cannot hold them: the file is damaged");
  }
  out.first = bytes.data() + offset;
  return out;
}

Accessor GlbDocument::attribute(const Json& attributes, const std::string& key, std::size_t rows,
                                std::size_t columns, bool bytes_too) const {
  const Json* found = find(attributes, key.c_str());
  if (found == nullptr) return {};
  Accessor out = accessor(index(*found), key);
  const bool fits = out.columns == columns || (key == "COLOR_0" && out.columns == 3);
  const bool known =
      out.type == 5126 || (bytes_too && out.normalized && (out.type == 5121 || out.type == 5123));
  if (!fits || !known) fail(out.name + " (" + key + ") is of a type that is not accepted there");
  if (out.rows != rows) {
    fail(out.name + " (" + key + ") has " + std::to_string(out.rows) + " elements for " +
         std::to_string(rows) + " vertices");
  }
  return out;
}

float GlbDocument::finite(const Accessor& from, std::size_t row, std::size_t column) const {
  const auto value = static_cast<float>(from.value(row, column));
  if (!std::isfinite(value)) fail(from.name + ": element " + std::to_string(row) + " is not finite");
  return value;
}

}  // namespace incise::mesh_io
