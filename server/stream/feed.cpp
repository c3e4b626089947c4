#include "server/stream/feed.hpp"

#include <boost/asio/post.hpp>
#include <numeric>
#include <stdexcept>

#include "server/base/check.hpp"

namespace incise::stream {

void Feed::reset(std::shared_ptr<const InitialState> initial) {
  mirror_.reset(*initial);
  fields_.clear();
  if (initial->fields) {
    for (const core::Field& field : *initial->fields) fields_.push_back(facts_of(field));
  }
  fields_set_.assign(fields_.size(), 0);
  keeper_.reset(std::move(initial));
  ring_.clear();
  changes_.clear();
  coalesced_.clear();
}

void Feed::apply(const std::shared_ptr<const PublishedDelta>& delta) {
  keep(mirror_.apply(*delta));
  keeper_.apply(delta);
}

void Feed::apply(const std::shared_ptr<const ReceivedDelta>& delta) {
  keep(mirror_.apply(*delta));
  keeper_.apply(delta);
}

void Feed::keep(Mirror::Applied applied) {
  coalesced_.clear();
  changes_.append(std::move(applied.change));
  if (applied.step) {
    ring_.append(std::move(*applied.step));
  } else {
    ring_.clear();
  }
}

bool Feed::can_resume(std::uint64_t revision, std::uint64_t hash) const {
  const std::uint64_t head = mirror_.revision();
  if (!ring_.covers(revision, head)) return false;
  if (hash == 0) return true;
  return hash == (revision == head ? mirror_.volume().state_hash() : ring_.after(revision).base_hash);
}

void Feed::request_snapshot(protocol::View view, const std::optional<protocol::Box>& box, bool fields,
                            SnapshotKeeper::Ready ready) {
  keeper_.request(view, box, fields,
                  [&io = io_, ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
                    asio::post(io, [ready, snapshot = std::move(snapshot)] { ready(snapshot); });
                  });
}

std::optional<Refusal> Feed::set_field(const protocol::FieldValues& values) {
  using protocol::ErrorCode;
  const auto number = [](std::uint64_t n) { return std::to_string(n); };
  if (values.field >= fields_.size()) {
    return Refusal{ErrorCode::BadRequest, "field " + number(values.field) + "; the body has " +
                                              number(fields_.size()) + " (Welcome.fields)"};
  }
  const protocol::FieldFacts& facts = fields_[values.field];
  const bool on_vertices = facts.on == protocol::FieldOn::Vertices;
  const std::uint64_t most = on_vertices ? mirror_.volume().vertex_count() : mirror_.volume().tet_slots();
  const std::size_t numbers = facts.whole ? values.i32.size() : values.f32.size();
  const std::uint64_t end = values.first + std::uint64_t{numbers / facts.components};
  if (numbers == 0 || numbers % facts.components != 0 ||
      !(facts.whole ? values.f32.empty() : values.i32.empty()) || end > most ||
      values.revision > mirror_.revision()) {
    return Refusal{ErrorCode::BadRequest,
                   number(values.f32.size()) + " floats and " + number(values.i32.size()) +
                       " whole numbers from id " + number(values.first) + " at revision " +
                       number(values.revision) + "; accepted for this field are " + number(facts.components) +
                       (facts.whole ? " whole number(s)" : " float(s)") + " for each of one or more " +
                       (on_vertices ? "vertices" : "tetrahedra") + " below " + number(most) +
                       ", at a revision up to " + number(mirror_.revision())};
  }
  NewFieldValues given{values.field, values.first, values.revision, {}};
  if (facts.whole) {
    given.values = std::vector<std::int32_t>(values.i32.begin(), values.i32.end());
  } else {
    given.values = std::vector<float>(values.f32.begin(), values.f32.end());
  }
  if (!keeper_.set(std::move(given))) {
    return Refusal{ErrorCode::NotAvailable,
                   "those before it still wait to be taken; send them less often (these are passed over)"};
  }
  ++fields_set_[values.field];
  return std::nullopt;
}

std::uint64_t Feed::times_fields_set() const {
  return std::accumulate(fields_set_.begin(), fields_set_.end(), std::uint64_t{0});
}

void Feed::set_field(NewFieldValues values) {
  const std::uint32_t field = values.field;
  keeper_.set(std::move(values), true);
  ++fields_set_.at(field);
}

void Feed::request_fields(std::vector<std::uint32_t> fields, SnapshotKeeper::FieldsReady ready) {
  keeper_.request_fields(std::move(fields), [&io = io_, ready = std::move(ready)](
                                                std::uint64_t epoch, std::vector<SharedFrames> frames) {
    asio::post(io, [ready, epoch, frames = std::move(frames)]() mutable { ready(epoch, std::move(frames)); });
  });
}

SharedFrame Feed::coalesced(protocol::View view, std::uint64_t base) {
  const auto [place, is_new] = coalesced_.try_emplace({view, base});
  if (is_new) place->second = coalesce(ring_, view, base, mirror_.revision());
  return place->second;
}

SharedFrame Feed::part_delta(BoxPart& part) {
  const std::uint64_t base = part.revision(), head = mirror_.revision();
  if (!changes_.covers(base, head) || head - base > protocol::kMaxStepsPerDelta) return nullptr;
  protocol::MeshChange change = changes_.after(base);
  while (change.revision < head) change.append(changes_.after(change.revision));
  try {
    return mirror_.follow_part(part, change);
  } catch (const std::length_error&) {
    return nullptr;
  }
}

}  // namespace incise::stream
