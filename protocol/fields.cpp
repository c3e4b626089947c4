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
  clear();
  fields_ = std::move(fields);
}

void FieldReplica::clear() {
  *this = FieldReplica();
}

ApplyResult FieldReplica::begin(const SnapshotBegin& snapshot, std::span<const FieldFacts> there) {
  in_snapshot_ = true;
  renewed_.reset();
  next_.clear();
  next_places_.assign(snapshot.fields.begin(), snapshot.fields.end());
  coming_ = 0;
  for (const std::uint32_t place : next_places_) {
    if (place >= there.size()) {
      return refuse(ApplyError::BadIndex,
                    "a snapshot with field " + number(place) + " of " + number(there.size()));
    }
    Field& field = next_.emplace_back(Field{there[place], {}});
    if (field.facts.whole) field.values.emplace<1>();
  }
  return {};
}

// Appends the next rows.
ApplyResult FieldReplica::take(const FieldValues& part, Field& field) const {
  const std::size_t components = field.facts.components;
  const auto append = [&](auto& held, auto given, const auto& other) -> ApplyResult {
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

namespace {

ApplyResult check_rows(const Field& field, const Replica& replica) {
  const bool fits = field.facts.on == FieldOn::Vertices ? field.rows() == replica.vertex_count()
                                                        : field.rows() >= replica.tet_slots();
  if (fits) return {};
  return refuse(ApplyError::BadShape,
                "the field " + field.facts.name + " came with " + number(field.rows()) + " rows");
}

}  // namespace

ApplyResult FieldReplica::values(const FieldValues& part, const Replica& replica) {
  if (in_snapshot_) {
    while (coming_ < next_places_.size() && next_places_[coming_] != part.field) ++coming_;
    if (coming_ < next_places_.size()) return take(part, next_[coming_]);
    return refuse(ApplyError::OutOfOrder,
                  "values of field " + number(part.field) + ", which were not announced");
  }
  const auto place = std::find(places_.begin(), places_.end(), part.field);
  if (place == places_.end() || part.revision != replica.revision()) {
    return refuse(ApplyError::OutOfOrder, "values of field " + number(part.field) + " at revision " +
                                              number(part.revision) + ", at " + number(replica.revision()));
  }
  Field& held = fields_[static_cast<std::size_t>(place - places_.begin())];
  if (part.first == 0) {
    renewed_ = Field{held.facts, {}};
    if (held.facts.whole) renewed_->values.emplace<1>();
  }
  if (!renewed_ || renewed_->facts != held.facts)
    return refuse(ApplyError::OutOfOrder,
                  "values of the field " + held.facts.name + " without their beginning");
  ApplyResult result = take(part, *renewed_);
  if (result && part.last) result = check_rows(*renewed_, replica);
  if (result && part.last) held.values = std::move(renewed_->values);
  if (!result || part.last) renewed_.reset();
  return result;
}

ApplyResult FieldReplica::end(const Replica& replica) {
  in_snapshot_ = false;
  for (const Field& field : next_) {
    if (ApplyResult result = check_rows(field, replica); !result) return result;
  }
  fields_ = std::exchange(next_, {});
  places_ = std::exchange(next_places_, {});
  return {};
}

ApplyResult FieldReplica::apply(const Delta& delta) {
  renewed_.reset();
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

FieldWriter::FieldWriter(const Field& field, std::uint32_t place, std::uint64_t revision,
                         std::size_t elements)
    : field_(field), elements_(elements) {
  message_.field = place;
  message_.revision = revision;
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
  message_.last = row_ == field_.rows();
  return true;
}

}  // namespace incise::protocol
