#pragma once

// What a mesh file gives on its vertices or tetrahedra.

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "server/core/mesh/field.hpp"

namespace incise::mesh_io {

using core::Field;
// Whether a name has a character that XML cannot have, escaped or not: control characters but tab and the ends of lines.
bool has_control_character(std::string_view name);

// The array, on tetrahedra, in which write_cut_mesh() says which faces cuts have opened, as MeshData::cut_masks does.
inline constexpr std::string_view kCutMask = "cut_mask";
// The field data of a file in which MeshData::cut_memory is, byte by byte.
inline constexpr std::string_view kCutMemory = "incise_cut_memory";
// The vertex field in which write_cut_mesh() says where the material of a deformed body is at rest.
inline constexpr std::string_view kRestPosition = "rest_position";
// Whether write_cut_mesh() adds an array of this name, for each tetrahedron.
bool is_own_array(std::string_view name);

// "the vertex field 'temperature'", for messages.
std::string title(const Field& field);

// What a reader has found, on its way to become fields: an array of a file, in double precision.
struct RawArray {
  std::string name;
  std::size_t components = 1;
  bool whole = false;  // its type is an integer
  std::vector<double> values;
};

// Turns arrays of a file into fields. What cannot be one is left out, and a warning says why: a name that is empty, longer than
// kMaxFieldName, with control characters or there twice; more than kMaxFieldComponents; another number of values than `rows`; a whole number beyond 32
// bits. Numbers with a fraction become floats. Arrays on tetrahedra of names that Incise itself writes (tet_id, region, ...) are no fields.
class FieldCollector {
 public:
  // Null: nothing is kept.
  FieldCollector(std::vector<Field>* fields, const std::string& file, std::vector<std::string>& warnings)
      : fields_(fields), file_(file), warnings_(warnings) {}

  bool wanted() const { return fields_ != nullptr; }
  // Incise wrote the file: no warning for the arrays that it adds, but one where the link to a surface's texture is lost.
  void note_own_file() { own_file_ = true; }
  // `pick`: the rows that become the field's, where the file has others, too.
  void add(Field::On on, RawArray array, std::size_t rows, const std::vector<std::uint32_t>* pick = nullptr);
  // That an array was left out.
  void leave_out(Field::On on, std::string_view name, const std::string& why);

 private:
  std::vector<Field>* fields_;
  std::string file_;
  std::vector<std::string>& warnings_;
  bool own_file_ = false, origins_seen_ = false;
};

}  // namespace incise::mesh_io
