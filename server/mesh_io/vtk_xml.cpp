#include "server/mesh_io/vtk_xml.hpp"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {
namespace {

// Deflate packs at most 1,032 bytes in one (RFC 1951: 258 bytes in two bits).
constexpr std::size_t kMostInflation = 1032;
constexpr std::size_t kMaxDepth = 64;
constexpr std::size_t kMaxShown = 40;  // characters of what is wrong

// By character; 0xff: no digit.
constexpr std::array<std::uint8_t, 256> kBase64 = [] {
  std::array<std::uint8_t, 256> digits{};
  digits.fill(0xff);
  constexpr std::string_view kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  for (std::size_t i = 0; i < kDigits.size(); ++i)
    digits[static_cast<unsigned char>(kDigits[i])] = static_cast<std::uint8_t>(i);
  return digits;
}();

unsigned base64_digit(char c) {
  return kBase64[static_cast<unsigned char>(c)];
}

// The bytes of an array: raw, or in base64. A header that is encoded by itself ends with padding, and the next group
// follows: so padding only shortens its own group.
class ByteSource {
 public:
  ByteSource(std::string_view text, bool base64, std::string what)
      : text_(text), base64_(base64), what_(std::move(what)) {}

  // Valid until the next call.
  std::string_view take(std::size_t size) {
    if (!base64_) {
      if (text_.size() - position_ < size) fail_short(size);
      position_ += size;
      return text_.substr(position_ - size, size);
    }
    // Four characters give three bytes; checked before the allocation.
    if (size > rest_.size() + (text_.size() - position_) / 4 * 3 + 3) fail_short(size);
    bytes_.resize(size);
    for (std::size_t at = 0; at < size;) {
      if (rest_.empty()) {
        at = take_groups(at);
        if (at == size) break;
        next_group(size);
      }
      const std::size_t count = std::min(size - at, rest_.size());
      std::copy_n(rest_.begin(), count, &bytes_[at]);
      rest_.erase(0, count);
      at += count;
    }
    return bytes_;
  }

 private:
  // Whole groups without blanks or padding, as long as they last.
  std::size_t take_groups(std::size_t at) {
    while (bytes_.size() - at >= 3 && text_.size() - position_ >= 4) {
      const char* const c = &text_[position_];
      const unsigned d[4] = {base64_digit(c[0]), base64_digit(c[1]), base64_digit(c[2]), base64_digit(c[3])};
      if ((d[0] | d[1] | d[2] | d[3]) > 63) break;
      bytes_[at] = static_cast<char>(d[0] << 2 | d[1] >> 4);
      bytes_[at + 1] = static_cast<char>((d[1] << 4 | d[2] >> 2) & 0xff);
      bytes_[at + 2] = static_cast<char>((d[2] << 6 | d[3]) & 0xff);
      at += 3;
      position_ += 4;
    }
    return at;
  }
  void next_group(std::size_t size) {
    unsigned bits = 0;
    int digits = 0, padding = 0;
    while (digits + padding < 4) {
      if (position_ == text_.size()) fail_short(size);
      const char c = text_[position_++];
      if (c == ' ' || (c >= '\t' && c <= '\r')) continue;
      const unsigned digit = base64_digit(c);
      if (c == '=' && digits >= 2) {
        ++padding;
      } else if (digit > 63 || padding > 0) {
        throw MeshError(what_ + " is not base64: " + in_quotes(std::string_view(&c, 1)));
      } else {
        bits = bits << 6 | digit;
        ++digits;
      }
    }
    bits <<= 6 * padding;
    for (int i = 0; i < 3 - padding; ++i) rest_ += static_cast<char>(bits >> (16 - 8 * i) & 0xff);
  }
  [[noreturn]] void fail_short(std::size_t size) const {
    throw MeshError(what_ + " ends too early: " + std::to_string(size) + " bytes should follow");
  }

  std::string_view text_;
  bool base64_;
  std::string what_;
  std::size_t position_ = 0;
  std::string rest_;   // decoded and not consumed
  std::string bytes_;  // of the last take()
};

struct Tag {
  std::string name;
  std::map<std::string, std::string, std::less<>> attributes;
  bool closing = false, empty = false;

  std::string_view get(std::string_view key, std::string_view otherwise = {}) const {
    const auto found = attributes.find(key);
    return found == attributes.end() ? otherwise : std::string_view(found->second);
  }
};

std::string unescaped(std::string_view text) {
  static const std::pair<std::string_view, char> entities[] = {
      {"&lt;", '<'}, {"&gt;", '>'}, {"&amp;", '&'}, {"&quot;", '"'}, {"&apos;", '\''}};
  std::string out;
  while (!text.empty()) {
    const auto entity = std::find_if(std::begin(entities), std::end(entities),
                                     [&](const auto& e) { return text.starts_with(e.first); });
    const bool known = entity != std::end(entities);
    out += known ? entity->second : text[0];
    text.remove_prefix(known ? entity->first.size() : 1);
  }
  return out;
}

// The tags of a VTK file and the text between them: as much of XML as such files have (no document types, no
// namespaces). The appended data of a VTK file need not be XML at all, so no XML library reads all of them.
class XmlScanner {
 public:
  XmlScanner(std::string_view text, std::string file) : text_(text), file_(std::move(file)) {}

  // Moves to the next tag; false at the end of the text.
  bool next(Tag& tag) {
    while (true) {
      const std::size_t open = text_.find('<', position_);
      if (open == text_.npos) return false;
      last_ = position_ = open;
      if (text_.substr(open).starts_with("<!--")) {
        skip("-->");
      } else if (text_.substr(open).starts_with("<?")) {
        skip("?>");
      } else {
        read_tag(tag);
        return true;
      }
    }
  }
  // The text from here to the next tag.
  std::string_view text() const {
    return text_.substr(position_, std::min(text_.find('<', position_), text_.size()) - position_);
  }
  std::string_view rest() const { return text_.substr(position_); }
  void move_to(std::size_t position) { position_ = position; }
  std::size_t position() const { return position_; }

  [[noreturn]] void fail(const std::string& message) const { throw MeshError(where() + ": " + message); }
  std::string where() const {
    const auto line = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(last_), '\n');
    return file_ + ":" + std::to_string(line);
  }

 private:
  void skip(std::string_view end) {
    const std::size_t found = text_.find(end, position_);
    if (found == text_.npos) fail("'" + std::string(end) + "' is missing");
    position_ = found + end.size();
  }

  void read_tag(Tag& tag) {
    tag = {};
    const std::size_t close = find_close();
    std::string_view inside = text_.substr(position_ + 1, close - position_ - 1);
    position_ = close + 1;
    if (inside.starts_with('/')) {
      tag.closing = true;
      inside.remove_prefix(1);
    }
    if (inside.ends_with('/')) {
      tag.empty = true;
      inside.remove_suffix(1);
    }
    tag.name = word(inside);
    while (true) {
      const std::string key(word(inside));
      if (key.empty()) break;
      if (!is_name(key)) fail("is damaged, or not XML: a tag holds " + in_quotes(key.substr(0, kMaxShown)));
      if (!inside.starts_with('=')) fail("the attribute " + in_quotes(key) + " has no value");
      inside.remove_prefix(1);
      const char quote = inside.empty() ? '\0' : inside[0];
      const std::size_t end = quote == '"' || quote == '\'' ? inside.find(quote, 1) : inside.npos;
      if (end == inside.npos) fail("the value of the attribute " + in_quotes(key) + " is not in quotes");
      tag.attributes[key] = unescaped(inside.substr(1, end - 1));
      inside.remove_prefix(end + 1);
    }
  }

  // Of an attribute, as VTK's files have them: ASCII.
  static bool is_name(std::string_view text) {
    return std::all_of(text.begin(), text.end(), [](char c) {
      return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
             c == ':' || c == '-' || c == '.';
    });
  }

  // The '>' that ends the tag: not one inside quotes.
  std::size_t find_close() const {
    char quote = '\0';
    for (std::size_t i = position_; i < text_.size(); ++i) {
      const char c = text_[i];
      if (quote != '\0') {
        if (c == quote) quote = '\0';
      } else if (c == '"' || c == '\'') {
        quote = c;
      } else if (c == '>') {
        return i;
      }
    }
    fail("a tag has no end: the file is cut short");
  }

  static std::string_view word(std::string_view& text) {
    const auto blank = [](char c) { return c == ' ' || (c >= '\t' && c <= '\r'); };
    while (!text.empty() && blank(text[0])) text.remove_prefix(1);
    std::size_t end = 0;
    while (end < text.size() && !blank(text[end]) && text[end] != '=') ++end;
    const std::string_view found = text.substr(0, end);
    text.remove_prefix(end);
    while (!text.empty() && blank(text[0])) text.remove_prefix(1);
    return found;
  }

  std::string_view text_;
  std::string file_;
  std::size_t position_ = 0, last_ = 0;
};

template <class T>
void convert(std::string_view bytes, bool swap, std::vector<double>& values) {
  values.resize(bytes.size() / sizeof(T));
  const char* from = bytes.data();
  for (double& value : values) {
    T number;
    std::memcpy(&number, from, sizeof number);
    value = static_cast<double>(swap ? unpack<T>(from, true) : number);
    from += sizeof number;
  }
}

using Convert = void (*)(std::string_view, bool, std::vector<double>&);

Convert converter(std::string_view type) {
  static const std::pair<const char*, Convert> types[] = {
      {"Int8", convert<std::int8_t>},   {"UInt8", convert<std::uint8_t>},
      {"Int16", convert<std::int16_t>}, {"UInt16", convert<std::uint16_t>},
      {"Int32", convert<std::int32_t>}, {"UInt32", convert<std::uint32_t>},
      {"Int64", convert<std::int64_t>}, {"UInt64", convert<std::uint64_t>},
      {"Float32", convert<float>},      {"Float64", convert<double>}};
  for (const auto& [name, function] : types) {
    if (type == name) return function;
  }
  return nullptr;
}

class VtkXmlReader {
 public:
  VtkXmlReader(std::string_view bytes, const std::string& file, bool fields, VtkXmlKind kind)
      : file_(file), bytes_(bytes), xml_(bytes, file), fields_(fields), kind_(kind) {}

  VtkXmlContent read() {
    find_appended();
    Tag tag;
    std::vector<std::string> open;
    while (xml_.next(tag)) {
      if (tag.closing) {
        if (open.empty() || open.back() != tag.name)
          xml_.fail("the tag " + in_quotes("</" + tag.name + ">") + " closes nothing");
        open.pop_back();
        continue;
      }
      if (open.empty() && tag.name != "VTKFile")
        xml_.fail("a VTK XML file starts with '<VTKFile', found " + in_quotes("<" + tag.name));
      if (tag.name == "AppendedData")
        return {std::move(pieces_), std::move(field_data_)};  // what follows is not XML
      open_tag(tag, open.empty() ? "" : open.back());
      if (!tag.empty) open.push_back(tag.name);
      if (open.size() > kMaxDepth) xml_.fail("more than 64 tags inside of each other");
    }
    if (!open.empty()) throw MeshError(file_ + ": ends inside <" + open.back() + ">: the file is cut short");
    if (!has_file_tag_) throw MeshError(file_ + ": a VTK XML file starts with '<VTKFile'");
    return {std::move(pieces_), std::move(field_data_)};
  }

 private:
  // The appended data come last, but earlier arrays refer to them.
  void find_appended() {
    const std::size_t tag_begin = bytes_.find("<AppendedData");
    if (tag_begin == bytes_.npos) return;
    xml_.move_to(tag_begin);
    Tag tag;
    xml_.next(tag);
    const std::size_t underscore = bytes_.find('_', xml_.position());
    if (underscore == bytes_.npos) xml_.fail("the appended data do not start with '_'");
    const std::string_view encoding = tag.get("encoding", "base64");
    if (encoding != "raw" && encoding != "base64") {
      xml_.fail("appended data are encoded as " + in_quotes(encoding) + "; raw and base64 are accepted");
    }
    appended_base64_ = encoding == "base64";
    appended_ = bytes_.substr(underscore + 1);
    if (appended_base64_) appended_ = appended_.substr(0, appended_.find('<'));
    has_appended_ = true;
    xml_.move_to(0);
  }

  void open_tag(const Tag& tag, const std::string& parent) {
    if (tag.name == "VTKFile") {
      read_file_tag(tag);
    } else if (tag.name == "Piece") {
      VtkXmlPiece piece;
      piece.points = count(tag, "NumberOfPoints");
      if (kind_ == VtkXmlKind::kPolyData) {
        for (const char* cells : {"NumberOfVerts", "NumberOfLines", "NumberOfStrips", "NumberOfPolys"})
          if (tag.attributes.contains(std::string_view(cells))) piece.cells += count(tag, cells);
      } else {
        piece.cells = count(tag, "NumberOfCells");
      }
      pieces_.push_back(std::move(piece));
    } else if (tag.name == "DataArray" && parent == "FieldData") {
      if (tag.get("Name") == kCutMemory) field_data_.push_back(read_array(tag, true));
    } else if (fields_ && !pieces_.empty() && is_other_array(tag)) {
      VtkXmlArray array;
      array.name = tag.get("Name");
      array.type = tag.get("type");
      if (parent == "CellData") pieces_.back().other_cell_data.push_back(std::move(array));
      if (parent == "PointData") pieces_.back().other_point_data.push_back(std::move(array));
    } else if (tag.name == "DataArray" && !pieces_.empty()) {
      VtkXmlPiece& piece = pieces_.back();
      if (parent == "Points") piece.point_arrays.push_back(read_array(tag));
      if (parent == "Cells") piece.cell_arrays.push_back(read_array(tag));
      const std::string name(tag.get("Name"));
      const bool region = tag.get("NumberOfComponents", "1") == "1" && find_region_array({&name, 1}) >= 0;
      const bool field = fields_ && converter(tag.get("type")) != nullptr;
      const bool wanted = region || field || name == kCutMask;
      if (parent == "CellData" && wanted) piece.cell_data.push_back(read_array(tag, !region));
      if (parent == "PointData" && field) piece.point_data.push_back(read_array(tag, true));
    }
  }

  // VTK writes arrays of texts as <Array>.
  static bool is_other_array(const Tag& tag) {
    return tag.name == "Array" || (tag.name == "DataArray" && converter(tag.get("type")) == nullptr);
  }

  void read_file_tag(const Tag& tag) {
    has_file_tag_ = true;
    const std::string accepted = kind_ == VtkXmlKind::kPolyData ? "PolyData" : "UnstructuredGrid";
    if (tag.get("type") != accepted) {
      xml_.fail("a VTK file of the type " + in_quotes(tag.get("type")) + "; " + accepted + " is accepted");
    }
    const std::string_view order = tag.get("byte_order", "LittleEndian"),
                           header = tag.get("header_type", "UInt32"), compressor = tag.get("compressor");
    if (order != "LittleEndian" && order != "BigEndian") {
      xml_.fail("the byte order " + in_quotes(order) + "; LittleEndian and BigEndian are accepted");
    }
    if (header != "UInt32" && header != "UInt64") {
      xml_.fail("the header type " + in_quotes(header) + "; UInt32 and UInt64 are accepted");
    }
    if (!compressor.empty() && compressor != "vtkZLibDataCompressor") {
      xml_.fail("the compressor " + in_quotes(compressor) + "; vtkZLibDataCompressor, or none, is accepted");
    }
    swap_ = (order == "BigEndian") != (std::endian::native == std::endian::big);
    header_size_ = header == "UInt64" ? 8 : 4;
    compressed_ = !compressor.empty();
  }

  std::size_t count(const Tag& tag, std::string_view key) const {
    const double value = number(tag.get(key), std::string(key));
    if (!(value >= 0 && value <= 4294967296.0) || value != std::floor(value)) {
      xml_.fail(std::string(key) + " is " + in_quotes(tag.get(key)) + ", not a count");
    }
    return static_cast<std::size_t>(value);
  }

  double number(std::string_view text, const std::string& what) const {
    TokenReader in(text, file_);
    try {
      return in.number(what);
    } catch (const MeshError&) {
      xml_.fail(what + " is " + in_quotes(text) + ", not a number");
    }
  }

  // `any`: numbers may be NaN or infinite as text, too; packed ones may always.
  VtkXmlArray read_array(const Tag& tag, bool any = false) {
    VtkXmlArray array;
    array.name = tag.get("Name");
    array.components = std::max<std::size_t>(
        1, tag.attributes.contains("NumberOfComponents") ? count(tag, "NumberOfComponents") : 1);
    const std::string what = xml_.where() + ": the array " + in_quotes(array.name);
    const Convert convert_bytes = converter(tag.get("type"));
    array.type = tag.get("type");
    array.whole = !array.type.starts_with("Float");
    if (!convert_bytes)
      throw MeshError(what + " is of type " + in_quotes(tag.get("type")) + ", which is not known");
    const std::string_view format = tag.get("format", "ascii");
    if (format == "ascii") {
      if (!tag.empty) read_ascii(what, any, array.values);
    } else if (format == "binary") {
      ByteSource source(tag.empty ? std::string_view{} : xml_.text(), true, what);
      std::string inflated;
      convert_bytes(read_bytes(source, what, inflated), swap_, array.values);
    } else if (format == "appended") {
      if (!has_appended_) throw MeshError(what + " is in appended data, and there are none");
      const std::size_t offset = count(tag, "offset");
      if (offset > appended_.size())
        throw MeshError(what + " has an offset behind the end: the file is cut short");
      ByteSource source(appended_.substr(offset), appended_base64_, what);
      std::string inflated;
      convert_bytes(read_bytes(source, what, inflated), swap_, array.values);
    } else {
      throw MeshError(what + " has the format " + in_quotes(format) +
                      "; ascii, binary and appended are accepted");
    }
    return array;
  }

  void read_ascii(const std::string& what, bool any, std::vector<double>& values) {
    const std::string_view text = xml_.text();
    // Lines are counted from the start of the file, in messages.
    TokenReader in(bytes_.substr(0, static_cast<std::size_t>(text.data() - bytes_.data()) + text.size()),
                   file_);
    in.take(static_cast<std::size_t>(text.data() - bytes_.data()), what);
    while (!in.at_end())
      values.push_back(any ? in.any_number("a value of an array") : in.number("a value of an array"));
  }

  std::uint64_t header_number(ByteSource& source) const {
    const std::string_view bytes = source.take(header_size_);
    return header_size_ == 8 ? unpack<std::uint64_t>(bytes.data(), swap_)
                             : unpack<std::uint32_t>(bytes.data(), swap_);
  }

  // Valid until `source` gives more, or `inflated` changes, which holds what was compressed.
  std::string_view read_bytes(ByteSource& source, const std::string& what, std::string& inflated) const {
    const std::uint64_t first = header_number(source);
    if (!compressed_) return source.take(first);
    // Compressed: the number of blocks, their size, the size of the last if it is shorter, then each compressed size.
    const std::uint64_t size = header_number(source), last = header_number(source);
    std::vector<std::uint64_t> packed;
    for (std::uint64_t i = 0; i < first; ++i) packed.push_back(header_number(source));
    for (std::uint64_t i = 0; i < first; ++i) {
      inflate_block(source.take(packed[i]), i + 1 == first && last > 0 ? last : size, what, inflated);
    }
    return inflated;
  }

  static void inflate_block(std::string_view packed, std::uint64_t size, const std::string& what,
                            std::string& out) {
    if (size > packed.size() * kMostInflation) {
      throw MeshError(what + ": a block of " + std::to_string(packed.size()) + " bytes cannot hold " +
                      std::to_string(size));
    }
    const std::size_t begin = out.size();
    out.resize(begin + size);
    uLongf written = size;
    const int status = uncompress(reinterpret_cast<Bytef*>(out.data() + begin), &written,
                                  reinterpret_cast<const Bytef*>(packed.data()), packed.size());
    if (status != Z_OK || written != size) throw MeshError(what + ": a compressed block is damaged");
  }

  std::string file_;
  std::string_view bytes_;
  XmlScanner xml_;
  bool fields_;
  VtkXmlKind kind_;
  std::vector<VtkXmlPiece> pieces_;
  std::vector<VtkXmlArray> field_data_;
  std::string_view appended_;
  bool has_appended_ = false, appended_base64_ = false, has_file_tag_ = false;
  bool swap_ = false, compressed_ = false;
  std::size_t header_size_ = 4;
};

}  // namespace

VtkXmlContent read_vtk_xml(std::string_view bytes, const std::string& file, bool fields, VtkXmlKind kind) {
  return VtkXmlReader(bytes, file, fields, kind).read();
}

}  // namespace incise::mesh_io
