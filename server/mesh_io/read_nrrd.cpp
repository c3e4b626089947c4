// NRRD (https://teem.sourceforge.net/nrrd/format.html): lines "field: value" up to an empty line, then voxels, or in another file.
#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <sstream>
#include <string_view>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/read_materials.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/volume_image.hpp"

namespace incise::mesh_io {
namespace {

constexpr std::size_t kMaxAxes = 16;  // as in teem

std::string trimmed(std::string_view text) {
  const std::size_t begin = text.find_first_not_of(" \t\r");
  if (begin == text.npos) return {};
  return std::string(text.substr(begin, text.find_last_not_of(" \t\r") + 1 - begin));
}

std::string shown(const std::string& text) {
  std::string out = "\"";
  for (const char c : text.substr(0, 60)) out += static_cast<unsigned char>(c) < 32 || c == '"' ? '?' : c;
  return out + (text.size() > 60 ? "...\"" : "\"");
}

// The header's fields, by their names in small letters.
class Fields {
 public:
  Fields(const std::string& head, const std::string& name) : name_(name) {
    if (!head.starts_with("NRRD")) throw MeshError(name + ": is not NRRD: it does not begin with that word");
    std::size_t at = head.find('\n');
    const std::string magic = trimmed(head.substr(0, at == head.npos ? 12 : at));
    if (magic.size() != 8 || !magic.starts_with("NRRD000") || magic[7] < '1' || magic[7] > '5')
      throw MeshError(name + ": begins with " + shown(magic) + "; accepted are NRRD0001 to NRRD0005");
    while (at != head.npos) {
      const std::size_t begin = at + 1;
      at = head.find('\n', begin);
      const std::string line =
          trimmed(std::string_view(head).substr(begin, at == head.npos ? at : at - begin));
      if (line.empty()) {
        end_ = at == head.npos ? head.size() : at + 1;
        has_end_ = at != head.npos;
        return;
      }
      read_line(line);
    }
    end_ = head.size();
  }

  const std::string* find(const std::string& field) const {
    const auto found = fields_.find(field);
    return found == fields_.end() ? nullptr : &found->second;
  }
  const std::string& at(const std::string& field) const {
    if (const std::string* value = find(field)) return *value;
    throw MeshError(name_ + ": the header has no field " + shown(field));
  }
  [[noreturn]] void refuse(const std::string& field, const std::string& accepted) const {
    throw MeshError(name_ + ": " + field + ": found " + shown(at(field)) + "; accepted is " + accepted);
  }
  // Behind the empty line.
  std::size_t end() const { return end_; }
  bool has_end() const { return has_end_; }

 private:
  void read_line(const std::string& line) {
    if (line[0] == '#') return;
    const std::size_t colon = line.find(':');
    if (colon == line.npos)
      throw MeshError(name_ + ": the header has the line " + shown(line) + "; accepted is \"field: value\"");
    if (line.compare(colon, 2, ":=") == 0) return;  // a key of somebody's own
    std::string field = lowercase(trimmed(line.substr(0, colon)));
    static const std::map<std::string, std::string> other_names = {{"datafile", "data file"},
                                                                   {"lineskip", "line skip"},
                                                                   {"byteskip", "byte skip"},
                                                                   {"centerings", "centers"}};
    if (const auto other = other_names.find(field); other != other_names.end()) field = other->second;
    if (!fields_.emplace(field, trimmed(line.substr(colon + 1))).second)
      throw MeshError(name_ + ": the header has the field " + shown(field) + " twice");
  }

  std::string name_;
  std::map<std::string, std::string> fields_;
  std::size_t end_ = 0;
  bool has_end_ = false;
};

std::optional<double> number(const std::string& text) {
  double value = 0;
  const char* const begin = text.data() + (text.starts_with('+') ? 1 : 0);
  const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::optional<std::int64_t> whole(const std::string& text) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::vector<std::string> words(const std::string& text) {
  std::istringstream in(text);
  std::vector<std::string> out;
  for (std::string word; in >> word;) out.push_back(word);
  return out;
}

using Vector = std::array<double, 3>;

// "(1,0,0) (0,1,0) none": vectors of three numbers, or none.
std::optional<std::vector<std::optional<Vector>>> vectors(const std::string& text) {
  std::vector<std::optional<Vector>> out;
  for (std::size_t at = text.find_first_not_of(" \t"); at < text.size();
       at = text.find_first_not_of(" \t", at)) {
    if (text.compare(at, 4, "none") == 0) {
      out.emplace_back();
      at += 4;
      continue;
    }
    const std::size_t close = text.find(')', at);
    if (text[at] != '(' || close == text.npos) return std::nullopt;
    std::istringstream parts(text.substr(at + 1, close - at - 1));
    Vector vector{};
    std::size_t count = 0;
    for (std::string part; std::getline(parts, part, ','); ++count) {
      const std::optional<double> value = number(trimmed(part));
      if (!value || count == 3) return std::nullopt;
      vector[count] = *value;
    }
    if (count != 3) return std::nullopt;
    out.emplace_back(vector);
    at = close + 1;
  }
  return out;
}

VoxelType type_of(const Fields& fields) {
  static const std::map<std::string, VoxelType> types = {
      {"signed char", VoxelType::kInt8},
      {"int8", VoxelType::kInt8},
      {"int8_t", VoxelType::kInt8},
      {"uchar", VoxelType::kUint8},
      {"unsigned char", VoxelType::kUint8},
      {"uint8", VoxelType::kUint8},
      {"uint8_t", VoxelType::kUint8},
      {"short", VoxelType::kInt16},
      {"short int", VoxelType::kInt16},
      {"signed short", VoxelType::kInt16},
      {"signed short int", VoxelType::kInt16},
      {"int16", VoxelType::kInt16},
      {"int16_t", VoxelType::kInt16},
      {"ushort", VoxelType::kUint16},
      {"unsigned short", VoxelType::kUint16},
      {"unsigned short int", VoxelType::kUint16},
      {"uint16", VoxelType::kUint16},
      {"uint16_t", VoxelType::kUint16},
      {"int", VoxelType::kInt32},
      {"signed int", VoxelType::kInt32},
      {"int32", VoxelType::kInt32},
      {"int32_t", VoxelType::kInt32},
      {"uint", VoxelType::kUint32},
      {"unsigned int", VoxelType::kUint32},
      {"uint32", VoxelType::kUint32},
      {"uint32_t", VoxelType::kUint32},
      {"longlong", VoxelType::kInt64},
      {"long long", VoxelType::kInt64},
      {"long long int", VoxelType::kInt64},
      {"signed long long", VoxelType::kInt64},
      {"signed long long int", VoxelType::kInt64},
      {"int64", VoxelType::kInt64},
      {"int64_t", VoxelType::kInt64},
      {"ulonglong", VoxelType::kUint64},
      {"unsigned long long", VoxelType::kUint64},
      {"unsigned long long int", VoxelType::kUint64},
      {"uint64", VoxelType::kUint64},
      {"uint64_t", VoxelType::kUint64},
      {"float", VoxelType::kFloat},
      {"double", VoxelType::kDouble},
  };
  const auto found = types.find(lowercase(fields.at("type")));
  if (found == types.end()) fields.refuse("type", "a whole number of 8 to 64 bits, float or double");
  return found->second;
}

// What the axes of the array are: sizes, and which three of them are space.
struct Axes {
  std::vector<std::uint64_t> sizes;
  std::vector<std::optional<Vector>> directions;  // empty: not given
  std::array<std::size_t, 3> space{};
};

Axes axes_of(const Fields& fields, const std::string& name) {
  Axes axes;
  const std::optional<std::int64_t> dimension = whole(fields.at("dimension"));
  if (!dimension || *dimension < 1 || *dimension > static_cast<std::int64_t>(kMaxAxes))
    fields.refuse("dimension", "a whole number from 1 to 16");
  const auto count = static_cast<std::size_t>(*dimension);
  for (const std::string& word : words(fields.at("sizes"))) {
    const std::optional<std::int64_t> size = whole(word);
    if (!size || *size < 1) fields.refuse("sizes", "whole numbers from 1");
    axes.sizes.push_back(static_cast<std::uint64_t>(*size));
  }
  if (axes.sizes.size() != count)
    fields.refuse("sizes", "a number for each of the " + std::to_string(count) + " dimensions");
  if (fields.find("space directions")) {
    auto given = vectors(fields.at("space directions"));
    if (!given || given->size() != count)
      fields.refuse("space directions",
                    "a vector (x,y,z) or none for each of the " + std::to_string(count) + " dimensions");
    axes.directions = std::move(*given);
  }
  std::vector<std::string> kinds(count, "???");
  if (fields.find("kinds")) {
    kinds = words(lowercase(fields.at("kinds")));
    if (kinds.size() != count)
      fields.refuse("kinds", "a word for each of the " + std::to_string(count) + " dimensions");
  }
  std::vector<std::size_t> space;
  for (std::size_t a = 0; a < count; ++a) {
    const bool said = kinds[a] == "space" || kinds[a] == "domain",
               unsaid = kinds[a] == "???" || kinds[a] == "none";
    if ((said || unsaid) && (axes.directions.empty() || axes.directions[a])) space.push_back(a);
  }
  // What is said of an axis may be nothing: then those of one sample are the ones that are not space.
  for (std::size_t k = space.size(); k-- > 0 && space.size() > 3;)
    if (axes.sizes[space[k]] == 1) space.erase(space.begin() + static_cast<std::ptrdiff_t>(k));
  std::uint64_t others = 1;
  for (std::size_t a = 0; a < count; ++a)
    if (std::find(space.begin(), space.end(), a) == space.end()) others = std::max(others, axes.sizes[a]);
  if (space.size() != 3 || others != 1)
    throw MeshError(
        name + ": an image of " + std::to_string(space.size()) + " dimensions of space" +
        (others > 1 ? " with " + std::to_string(others) + " numbers at each place" : std::string()) +
        "; accepted are three dimensions with one number");
  std::copy(space.begin(), space.end(), axes.space.begin());
  return axes;
}

// Millimetres in a unit of the image's space.
Vector units_of(const Fields& fields, const Axes& axes) {
  const bool by_axis = fields.find("space units") == nullptr;
  const std::string* text = by_axis ? fields.find("units") : fields.find("space units");
  Vector mm = {1, 1, 1};
  if (!text) return mm;
  std::vector<std::string> found;
  for (std::size_t at = text->find('"'); at != text->npos; at = text->find('"', at)) {
    const std::size_t close = text->find('"', at + 1);
    if (close == text->npos) break;
    found.push_back(lowercase(text->substr(at + 1, close - at - 1)));
    at = close + 1;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t at = by_axis ? axes.space[i] : i;
    const std::string unit = at < found.size() ? found[at] : "";
    mm[i] = unit == "m" ? 1000 : unit == "cm" ? 10 : unit == "um" || unit == "microns" ? 1e-3 : 1;
  }
  return mm;
}

void place(const Fields& fields, const Axes& axes, ImageHeader& image) {
  // How the named spaces become LPS (and the same with a time, of which there is one).
  static const std::map<std::string, Vector> spaces = {
      {"right-anterior-superior", {-1, -1, 1}}, {"ras", {-1, -1, 1}},
      {"left-anterior-superior", {1, -1, 1}},   {"las", {1, -1, 1}},
      {"left-posterior-superior", {1, 1, 1}},   {"lps", {1, 1, 1}},
  };
  Vector to_lps = {1, 1, 1};
  if (const std::string* space = fields.find("space")) {
    const auto known = spaces.find(lowercase(*space));
    image.anatomical = known != spaces.end();
    if (image.anatomical) to_lps = known->second;
    if (space->find("-time") != space->npos || space->ends_with("T"))
      fields.refuse("space", "one without time");
  } else if (fields.find("space dimension") && fields.at("space dimension") != "3") {
    fields.refuse("space dimension", "3");
  }
  const Vector mm = units_of(fields, axes);
  Affine& m = image.mm_from_index;
  if (!axes.directions.empty()) {
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t i = 0; i < 3; ++i) m[i][j] = to_lps[i] * mm[i] * (*axes.directions[axes.space[j]])[i];
  } else {
    std::vector<std::string> spacings(axes.sizes.size(), "nan");
    if (fields.find("spacings")) spacings = words(fields.at("spacings"));
    if (spacings.size() != axes.sizes.size()) fields.refuse("spacings", "a number for each dimension");
    for (std::size_t j = 0; j < 3; ++j) {
      const std::string text = lowercase(spacings[axes.space[j]]);
      const std::optional<double> spacing = text == "nan" ? 1.0 : number(text);
      if (!spacing || *spacing == 0) fields.refuse("spacings", "numbers other than 0, or NaN");
      m[j][j] = to_lps[j] * mm[j] * *spacing;
    }
  }
  if (!fields.find("space origin")) return;
  const auto origin = vectors(fields.at("space origin"));
  if (!origin || origin->size() != 1 || !origin->front()) fields.refuse("space origin", "a vector (x,y,z)");
  for (std::size_t i = 0; i < 3; ++i) m[i][3] = to_lps[i] * mm[i] * (*origin->front())[i];
}

// Where the voxels begin: in this file, or in one beside it.
void find_data(const Fields& fields, const std::filesystem::path& path, ImageHeader& image) {
  const std::string name = path.string();
  const std::string encoding = lowercase(fields.at("encoding"));
  image.gzip = encoding == "gzip" || encoding == "gz";
  if (!image.gzip && encoding != "raw") fields.refuse("encoding", "raw or gzip");
  image.data = path;
  if (const std::string* file = fields.find("data file")) {
    if (file->starts_with("LIST") || file->find('%') != file->npos)
      fields.refuse("data file", "the name of one file");
    try {
      image.data = file_beside(path, *file, UINTMAX_MAX);
    } catch (const MeshError& error) {
      throw MeshError(name + ": data file: " + error.what());
    }
  } else {
    if (!fields.has_end())
      throw MeshError(name +
                      ": no empty line ends the header in its first 64 kB, and no field \"data file\" says "
                      "where the voxels are");
    image.begin = static_cast<std::int64_t>(fields.end());
  }
  const auto skip = [&](const char* field, std::int64_t least) -> std::int64_t {
    if (!fields.find(field)) return 0;
    const std::optional<std::int64_t> given = whole(fields.at(field));
    if (!given || *given < least || *given > (std::int64_t{1} << 40))
      fields.refuse(field, least < 0 ? "a whole number from 0, or -1 where the encoding is raw"
                                     : "a whole number from 0");
    return *given;
  };
  if (skip("line skip", 0) != 0) fields.refuse("line skip", "0: skip bytes instead");
  const std::int64_t bytes = skip("byte skip", image.gzip ? 0 : -1);
  if (bytes < 0)
    image.begin = -1;
  else
    image.skip = static_cast<std::uint64_t>(bytes);
}

}  // namespace

ImageHeader parse_nrrd(const std::string& head, const std::filesystem::path& path) {
  const std::string name = path.string();
  const Fields fields(head, name);
  ImageHeader image;
  const Axes axes = axes_of(fields, name);
  for (std::size_t i = 0; i < 3; ++i) image.size[i] = axes.sizes[axes.space[i]];
  image.type = type_of(fields);
  if (size_of(image.type) > 1) {
    const std::string endian = lowercase(fields.at("endian"));
    if (endian != "little" && endian != "big") fields.refuse("endian", "little or big");
    image.big_endian = endian == "big";
  }
  place(fields, axes, image);
  find_data(fields, path, image);
  return image;
}

}  // namespace incise::mesh_io
