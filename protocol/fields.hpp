#pragma once

// The fields that a client of view Volume has asked for, as they are at the revision of its Replica.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "protocol/messages.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

struct Field {
  FieldFacts facts;
  // facts.components for each id of a vertex or tetrahedron, from 0 on; those of ids without one are meaningless.
  std::variant<std::vector<float>, std::vector<std::int32_t>> values;

  std::size_t rows() const {
    return std::visit([this](const auto& v) { return v.size() / facts.components; }, values);
  }
};

// What a client asks for with these names ("*": all), of what there is, in its order. Names that do not exist go to `unknown`.
std::vector<std::uint32_t> fields_named(std::span<const std::string> names, std::span<const FieldFacts> there,
                                        std::vector<std::string>& unknown);

// Follows snapshots, deltas and new values beside a Replica, each after that has taken it. A snapshot replaces all fields once it is
// whole, new values one of them.
//
// Thread: one, at a time. Owns: the values.
class FieldReplica {
 public:
  // As a server has them: no snapshot needed.
  void load(std::vector<Field> fields);

  // `there`: Welcome.fields.
  ApplyResult begin(const SnapshotBegin& snapshot, std::span<const FieldFacts> there);
  // Of the snapshot that has begun, else new ones.
  ApplyResult values(const FieldValues& part, const Replica& replica);
  // `replica` has taken the end.
  ApplyResult end(const Replica& replica);
  // Of the whole mesh, not of a box. Where it is refused, what is held stays as it was.
  ApplyResult apply(const Delta& delta);
  // Holds none.
  void clear();

  const std::vector<Field>& all() const { return fields_; }
  // To be changed by a server. What is there keeps its size.
  Field& at(std::uint32_t place) { return fields_[place]; }
  // Null: there is none of this name.
  const Field* find(const std::string& name, FieldOn on) const;

 private:
  ApplyResult take(const FieldValues& part, Field& field) const;

  std::vector<Field> fields_;
  std::vector<std::uint32_t> places_;  // of these, in Welcome.fields
  // Of the snapshot that is on its way.
  bool in_snapshot_ = false;
  std::vector<Field> next_;
  std::vector<std::uint32_t> next_places_;
  std::size_t coming_ = 0;        // whose values come
  std::optional<Field> renewed_;  // new values of one that have come so far
};

// The values of a field in messages of about `elements` rows each.
class FieldWriter {
 public:
  FieldWriter(const Field& field, std::uint32_t place, std::uint64_t revision, std::size_t elements);
  // The next message; false behind the last. A field without rows has none.
  bool next();
  // Valid until the field changes.
  const FieldValues& message() const { return message_; }

 private:
  const Field& field_;
  const std::size_t elements_;
  std::size_t row_ = 0;
  FieldValues message_;
};

}  // namespace incise::protocol
