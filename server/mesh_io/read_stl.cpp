// STL, ASCII and binary.
#include <algorithm>
#include <string>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/surface_reading.hpp"

namespace incise::mesh_io {
namespace {

using core::Vec3;
using core::VertexId;

constexpr std::size_t kStlHeader = 84, kStlTriangle = 50;

Surface read_binary_stl(const std::string& bytes, std::size_t count, const std::string& file) {
  Surface surface;
  surface.positions.reserve(3 * count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      const char* corner = bytes.data() + kStlHeader + kStlTriangle * i + 12 * (k + 1);
      const Vec3 p{load<float>(corner), load<float>(corner + 4), load<float>(corner + 8)};
      if (!core::is_finite(p)) {
        throw MeshError(file + ": triangle " + std::to_string(i) + ", corner " + std::to_string(k) +
                        ": a coordinate is not finite");
      }
      surface.positions.push_back(p);
    }
    const auto v = static_cast<VertexId>(3 * i);
    surface.triangles.push_back({v, v + 1, v + 2});
  }
  return surface;
}

Surface read_ascii_stl(const std::string& text, const std::string& file) {
  LineReader in(text, file, '\0');
  Surface surface;
  int corners = -1;  // of the open loop; -1: no loop is open
  bool in_solid = false;
  while (in.next()) {
    const std::string_view word = in.field(0);
    if (equals_ignoring_case(word, "vertex")) {
      if (corners < 0) in.fail("'vertex' outside of 'outer loop'");
      if (corners == 3) in.fail("a fourth vertex in a facet; STL has triangles only");
      surface.positions.push_back(read_point(in, 1));
      ++corners;
    } else if (equals_ignoring_case(word, "outer")) {
      if (corners >= 0) in.fail("'outer loop' inside of another");
      corners = 0;
    } else if (equals_ignoring_case(word, "endloop")) {
      if (corners != 3)
        in.fail("a facet of " + std::to_string(std::max(corners, 0)) + " vertices; it has three");
      const auto v = static_cast<VertexId>(surface.positions.size());
      surface.triangles.push_back({v - 3, v - 2, v - 1});
      corners = -1;
    } else if (equals_ignoring_case(word, "solid")) {
      in_solid = true;
    } else if (equals_ignoring_case(word, "endsolid")) {
      in_solid = false;
    } else if (!equals_ignoring_case(word, "facet") && !equals_ignoring_case(word, "endfacet")) {
      in.fail("'solid', 'facet', 'outer loop', 'vertex', 'endloop', 'endfacet' or 'endsolid' expected");
    }
  }
  if (corners >= 0 || in_solid) {
    throw MeshError(file + ": ends after line " + std::to_string(in.line()) +
                    " without 'endsolid': the file is cut short");
  }
  return surface;
}

}  // namespace

Surface read_stl(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  const std::string bytes = read_whole_file(path);
  const std::string file = path.string();
  // Many binary files begin with "solid" too, so the size decides first.
  const std::size_t count = bytes.size() >= kStlHeader ? load<std::uint32_t>(bytes.data() + 80) : 0;
  const bool binary_size = bytes.size() >= kStlHeader && bytes.size() == kStlHeader + kStlTriangle * count;
  if (binary_size) return finish(read_binary_stl(bytes, count, file), path);
  const std::size_t begin = bytes.find_first_not_of(" \t\r\n");
  if (begin != std::string::npos && equals_ignoring_case(std::string_view(bytes).substr(begin, 5), "solid") &&
      bytes.find('\0') == std::string::npos) {
    return finish(read_ascii_stl(bytes, file), path);
  }
  if (bytes.size() < kStlHeader || bytes.size() < kStlHeader + kStlTriangle * count) {
    throw MeshError(file + ": neither ASCII STL (it does not start with 'solid') nor binary STL (" +
                    (bytes.size() < kStlHeader
                         ? "shorter than its header of 84 bytes)"
                         : std::to_string(count) + " triangles take " +
                               std::to_string(kStlHeader + kStlTriangle * count) + " bytes, the file has " +
                               std::to_string(bytes.size()) + ")"));
  }
  warnings.push_back(file + ": " + std::to_string(bytes.size() - kStlHeader - kStlTriangle * count) +
                     " bytes after the last of " + std::to_string(count) + " triangles are not read");
  return finish(read_binary_stl(bytes, count, file), path);
}

}  // namespace incise::mesh_io
