#include "protocol/fields.hpp"

#include <algorithm>
#include <exception>
#include <utility>

#include "protocol/apply_checks.hpp"
#include "protocol/carry.hpp"

namespace incise::protocol {

std::vector<std::uint32_t> fields_named(std::span<const std::string> names, std::span<const FieldFacts> there,
                                        std::vector<std::string>& unknown) {
  std::vector<std::uint32_t> places;
  for (const std::string& name : names) {
    bool found = name == "*";
    for (std::uint32_t i = 0; i < there.size(); ++i) {
      if (name != "*" && name != there[i].name) continue;
      found = true;
      places.push_back(i);
    }
    if (!found) unknown.push_back(name);
  }
  sort_unique(places);
  return places;
}

void FieldReplica::load(std::vector<Field> fields) {
  fields_ = std::move(fields);
  next_.clear();
}

void FieldReplica::clear() {
  fields_.clear();
  next_.clear();
}

ApplyResult FieldReplica::begin(const SnapshotBegin& snapshot, std::span<const FieldFacts> there) {
  next_.clear();
  places_.assign(snapshot.fields.begin(), snapshot.fields.end());
  coming_ = 0;
  for (const std::uint32_t place : places_) {
    if (place >= there.size())
      return refuse(ApplyError::BadIndex,
                    "a snapshot with field " + number(place) + " of " + number(there.size()));
    Field& field = next_.emplace_back(Field{there[place], {}});
    if (field.facts.whole) field.values.emplace<1>();
  }
  return {};
}

ApplyResult FieldReplica::values(const FieldValues& part) {
  while (coming_ < places_.size() && places_[coming_] != part.field) ++coming_;
  if (coming_ == places_.size())
    return refuse(ApplyError::OutOfOrder,
                  "values of field " + number(part.field) + ", which were not announced");
  Field& field = next_[coming_];
  const auto append = [&](auto& held, auto given, const auto& other) -> ApplyResult {
    const std::size_t components = field.facts.components;
    if (!other.empty() || given.empty() || given.size() % components != 0 ||
        part.first != held.size() / components) {
      return refuse(ApplyError::BadShape,
                    "values of the field " + field.facts.name + " from id " + number(part.first) + ": " +
                        number(given.size() + other.size()) + " numbers after those below id " +
                        number(held.size() / components));
    }
    held.insert(held.end(), given.begin(), given.end());
    return {};
  };
  if (auto* whole = std::get_if<std::vector<std::int32_t>>(&field.values))
    return append(*whole, part.i32, part.f32);
  return append(std::get<std::vector<float>>(field.values), part.f32, part.i32);
}

ApplyResult FieldReplica::end(const Replica& replica) {
  for (const Field& field : next_) {
    const bool fits = field.facts.on == FieldOn::Vertices ? field.rows() == replica.vertex_count()
                                                          : field.rows() >= replica.tet_slots();
    if (!fits) {
      return refuse(ApplyError::BadShape,
                    "the field " + field.facts.name + " came with " + number(field.rows()) + " rows");
    }
  }
  fields_ = std::exchange(next_, {});
  return {};
}

ApplyResult FieldReplica::apply(const Delta& delta) {
  if (fields_.empty()) return {};
  const std::size_t added = delta.provenance_t.size();
  for (const Field& field : fields_) {
    const std::string error = field.facts.on == FieldOn::Tets ? elders_error(delta, field.rows())
                              : field.rows() + added != delta.vertex_count
                                  ? "another number of vertices"
                                  : provenance_error(delta, field.rows());
    if (!error.empty()) return refuse(ApplyError::BadShape, "the field " + field.facts.name + ": " + error);
  }
  for (Field& field : fields_) {
    std::visit(
        [&](auto& values) {
          if (field.facts.on == FieldOn::Vertices) {
            carry(delta, field.facts.components, values);
          } else {
            carry_tets(delta, field.facts.components, values);
          }
        },
        field.values);
  }
  return {};
}

const Field* FieldReplica::find(const std::string& name, FieldOn on) const {
  const auto found = std::find_if(fields_.begin(), fields_.end(), [&](const Field& field) {
    return field.facts.name == name && field.facts.on == on;
  });
  return found == fields_.end() ? nullptr : &*found;
}

FieldWriter::FieldWriter(const Field& field, std::uint32_t place, std::size_t elements)
    : field_(field), elements_(elements) {
  message_.field = place;
}

bool FieldWriter::next() {
  const std::size_t rows = std::min(elements_, field_.rows() - row_);
  if (rows == 0) return false;
  const std::size_t components = field_.facts.components;
  message_.first = static_cast<std::uint32_t>(row_);
  if (const auto* whole = std::get_if<std::vector<std::int32_t>>(&field_.values)) {
    message_.i32 = std::span(*whole).subspan(components * row_, components * rows);
  } else {
    message_.f32 =
        std::span(std::get<std::vector<float>>(field_.values)).subspan(components * row_, components * rows);
  }
  row_ += rows;
  return true;
}

}  // namespace incise::protocol
