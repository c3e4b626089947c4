#include "server/mesh_io/field.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

constexpr std::string_view kOwn[] = {"tet_id",    "region",           "piece",   kCutMask,
                                     "cut_faces", "min_dihedral_deg", "volume",  "origin_0",
                                     "origin_1",  "origin_2",         "origin_3"};

// What the four of these begin with that write_cut_mesh() adds for a body that was filled from a surface.
constexpr std::string_view kOrigins = "origin_";

std::string title(Field::On on, std::string_view name) {
  return (on == Field::On::kVertices ? "the vertex field " : "the tetrahedron field ") + in_quotes(name);
}

}  // namespace

bool has_control_character(std::string_view name) {
  return std::any_of(name.begin(), name.end(),
                     [](unsigned char c) { return c < 0x20 && c != '\t' && c != '\n' && c != '\r'; });
}

bool is_own_array(std::string_view name) {
  return std::ranges::find(kOwn, name) != std::end(kOwn);
}

std::string title(const Field& field) {
  return title(field.on, field.name);
}

void FieldCollector::leave_out(Field::On on, std::string_view name, const std::string& why) {
  warnings_.push_back(file_ + ": " + title(on, name.substr(0, core::kMaxFieldName)) + " is left out: " + why);
}

void FieldCollector::add(Field::On on, RawArray array, std::size_t rows,
                         const std::vector<std::uint32_t>* pick) {
  if (!wanted()) return;
  const auto refuse = [&](const std::string& why) { leave_out(on, array.name, why); };
  if (on == Field::On::kTets && is_own_array(array.name)) {
    if (!own_file_) return refuse("results have an array of this name of their own; rename it");
    if (!array.name.starts_with(kOrigins) || std::exchange(origins_seen_, true)) return;
    warnings_.push_back(
        file_ +
        ": origin_0 to origin_3 are left out: they name triangles of the surface that the body "
        "was filled from, which this file does not hold; to keep the surface's texture, cut the "
        "surface file itself, with all strokes in one motion");
    return;
  }
  if (array.name.empty() || array.name.size() > core::kMaxFieldName)
    return refuse("its name has " + std::to_string(array.name.size()) + " bytes; accepted are 1 to " +
                  std::to_string(core::kMaxFieldName));
  if (has_control_character(array.name)) return refuse("its name has a control character");
  if (std::any_of(fields_->begin(), fields_->end(),
                  [&](const Field& f) { return f.on == on && f.name == array.name; }))
    return refuse("there is another one of this name before it");
  if (array.components < 1 || array.components > core::kMaxFieldComponents)
    return refuse("it has " + std::to_string(array.components) + " components; accepted are 1 to " +
                  std::to_string(core::kMaxFieldComponents));
  if (array.values.size() != rows * array.components)
    return refuse("it has " + std::to_string(array.values.size()) + " numbers; " + std::to_string(rows) +
                  " times " + std::to_string(array.components) + " are expected");
  Field field{array.name, on, array.components, {}};
  if (array.whole) {
    const auto beyond = std::find_if(array.values.begin(), array.values.end(),
                                     [](double x) { return !(x >= -2147483648.0 && x <= 2147483647.0); });
    if (beyond != array.values.end())
      return refuse("the whole number " + to_text(*beyond) + " in it is beyond 32 bits");
    auto& values = field.values.emplace<std::vector<std::int32_t>>();
    values.reserve(array.values.size());
    for (const double x : array.values) values.push_back(static_cast<std::int32_t>(x));
  } else {
    auto& values = field.values.emplace<std::vector<float>>();
    values.reserve(array.values.size());
    // Beyond what a float holds: infinite.
    for (const double x : array.values) {
      constexpr double kMost = std::numeric_limits<float>::max();
      values.push_back(std::abs(x) > kMost ? std::copysign(std::numeric_limits<float>::infinity(),
                                                           static_cast<float>(x > 0 ? 1 : -1))
                                           : static_cast<float>(x));
    }
  }
  fields_->push_back(pick == nullptr ? std::move(field) : rows_of(field, *pick));
}

}  // namespace incise::mesh_io
