#include "server/loop/undo_history.hpp"

#include <algorithm>
#include <string>

#include "server/base/clock.hpp"
#include "server/core/session/session_state.hpp"

namespace incise::loop {
namespace {

// A state is saved after so much of the thread's processor time, or five times what saving one takes.
constexpr double kLongWay_s = 0.05;
// Records after the last stroke's beginning matter only if another one begins: so many bytes of them are kept for that.
constexpr std::size_t kTail_bytes = 32u << 20;

std::size_t bytes_of(const JournalRecord& record) {
  const auto* positions = record.positions.get();
  return sizeof record + (positions ? 24 * positions->positions.size() + 4 * positions->ids.size() : 0);
}

bool is_input(const JournalRecord& record) {
  using Kind = JournalRecord::Kind;
  return record.kind == Kind::kOpened || record.kind == Kind::kPose || record.kind == Kind::kEndStroke ||
         record.kind == Kind::kDeform;
}

// Appends what is not there yet.
void add(std::vector<std::string>& names, const std::string& name) {
  if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
}

const std::string& name_of(const BladeSums& blade) {
  static const std::string none;
  return blade.name ? *blade.name : none;
}

bool same(const BeforeStroke& a, const BeforeStroke& b) {
  return a.source == b.source && a.t_ns == b.t_ns && a.arrival_ns == b.arrival_ns;
}

}  // namespace

const std::string& BeforeStroke::name() const {
  return name_of(blades[source]);
}

void UndoHistory::note(const JournalRecord& record, const core::CutSession& session) {
  if (!is_input(record)) return;
  if (record.kind == JournalRecord::Kind::kOpened && now_.blades[record.source].name != record.name)
    now_.blades[record.source] = {record.name, 0, 0};
  if (record.begins_stroke) {
    // Not while its stroke is under way: another blade's goes on, and a pose that ends one stroke and begins the next commits the rest of the first one only now.
    if (!changed_ && strokes_ > 0 && !session.in_stroke(spans_.back().points.back().before.source))
      drop_last_point();
    const double way_s = spans_.empty() ? 0 : thread_cpu_s() - spans_.back().saved_cpu_s;
    if (spans_.empty() || !spans_.back().whole || way_s > std::max(kLongWay_s, 5 * save_s_))
      begin_span(session);
    now_.source = record.source;
    now_.t_ns = record.pose.t_ns;
    now_.arrival_ns = record.arrival_ns;
    now_.revision = session.revision();
    spans_.back().points.push_back({spans_.back().records.size(), now_, {}});
    ++strokes_;
    ++now_.strokes;
    ++now_.blades[record.source].strokes;
    changed_ = false;
    count_undoable();
  }
  if (spans_.empty() || !spans_.back().whole) return;
  Span& span = spans_.back();
  span.records.push_back(record);
  // A copy: the source of positions has few buffers, and a long history would keep them all.
  if (record.positions)
    span.records.back().positions = std::make_shared<const core::VertexPositions>(*record.positions);
  span.bytes += bytes_of(record);
  if (span.bytes > span.state.size() + kTail_bytes) end_span();
}

void UndoHistory::note(const core::Delta& delta) {
  now_.cut_faces += delta.cut_faces;
  now_.cut_area_m2 += delta.cut_area;
  now_.blades[delta.source].cut_faces += delta.cut_faces;
  if (!delta.has_cut()) return;
  changed_ = true;
  const auto last =
      std::find_if(spans_.rbegin(), spans_.rend(), [](const Span& s) { return !s.points.empty(); });
  if (last == spans_.rend()) return;
  std::vector<std::string>& cut = last->points.back().cut;
  const std::size_t blades = cut.size();
  add(cut, name_of(now_.blades[delta.source]));
  if (cut.size() != blades) count_undoable();
}

void UndoHistory::clear() {
  spans_.clear();
  strokes_ = undoable_ = 0;
  changed_ = false;
  now_ = {};
}

void UndoHistory::begin_span(const core::CutSession& session) {
  if (!spans_.empty()) end_span();
  // The oldest go before a new state comes, which takes their place in memory.
  std::vector<std::byte> place;
  const std::size_t expected = spans_.empty() ? 0 : spans_.back().state.size();
  drop_oldest(expected, 0, place);
  const double before_s = thread_cpu_s();
  Span span;
  span.state = core::save_session(session, std::move(place));
  span.bytes = span.state.size();
  span.saved_cpu_s = thread_cpu_s();
  save_s_ = span.saved_cpu_s - before_s;
  spans_.push_back(std::move(span));
  drop_oldest(0, 1, place);
}

// Until there is room for so many bytes more, or only `kept` spans are left; the memory of the last one's state is left in `place`.
void UndoHistory::drop_oldest(std::size_t more, std::size_t kept, std::vector<std::byte>& place) {
  std::size_t bytes = more;
  for (const Span& s : spans_) bytes += s.bytes;
  while (bytes > max_bytes_ && spans_.size() > kept) {
    bytes -= spans_.front().bytes;
    strokes_ -= spans_.front().points.size();
    place = std::move(spans_.front().state);
    spans_.pop_front();
  }
}

void UndoHistory::cut_back(Span& span, std::size_t records) {
  for (std::size_t i = records; i < span.records.size(); ++i) span.bytes -= bytes_of(span.records[i]);
  span.records.resize(records);
}

// Leaves out what comes after its last point.
void UndoHistory::end_span() {
  Span& span = spans_.back();
  span.whole = false;
  cut_back(span, span.points.empty() ? 0 : span.points.back().records);
  span.records.shrink_to_fit();
}

void UndoHistory::drop_last_point() {
  spans_.back().points.pop_back();
  --strokes_;
  if (spans_.back().points.empty() && !spans_.back().whole) spans_.pop_back();
}

// As last() finds one stroke after the other. O(points), once a stroke.
void UndoHistory::count_undoable() {
  undoable_ = 0;
  std::vector<std::string> cut;  // the blades that have cut something from here to the last stroke found
  for (auto span = spans_.rbegin(); span != spans_.rend(); ++span) {
    for (auto point = span->points.rbegin(); point != span->points.rend(); ++point) {
      for (const std::string& blade : point->cut) add(cut, blade);
      if (std::find(cut.begin(), cut.end(), point->before.name()) == cut.end()) continue;
      ++undoable_;
      cut.clear();
    }
  }
}

const BeforeStroke* UndoHistory::last(const std::string* name) const {
  std::vector<std::string> cut;  // the blades that have cut something from here on
  for (auto span = spans_.rbegin(); span != spans_.rend(); ++span) {
    for (auto point = span->points.rbegin(); point != span->points.rend(); ++point) {
      for (const std::string& blade : point->cut) add(cut, blade);
      const std::string& own = point->before.name();
      if (name != nullptr && *name != own) continue;
      if (std::find(cut.begin(), cut.end(), own) != cut.end()) return &point->before;
    }
  }
  return nullptr;
}

std::vector<std::string> UndoHistory::cut_since(const BeforeStroke& stroke) const {
  std::vector<std::string> blades{stroke.name()};
  for (auto span = spans_.rbegin(); span != spans_.rend(); ++span) {
    for (auto point = span->points.rbegin(); point != span->points.rend(); ++point) {
      for (const std::string& blade : point->cut) add(blades, blade);
      if (same(point->before, stroke)) return blades;
    }
  }
  return blades;
}

const UndoHistory::Span* UndoHistory::span_of(const BeforeStroke& stroke, std::size_t& point) const {
  for (auto span = spans_.rbegin(); span != spans_.rend(); ++span) {
    for (point = span->points.size(); point-- > 0;) {
      if (same(span->points[point].before, stroke)) return &*span;
    }
  }
  return nullptr;
}

std::unique_ptr<core::CutSession> UndoHistory::before(const BeforeStroke& stroke,
                                                      const core::CutConfig& config) const {
  std::size_t point = 0;
  const Span* const span = span_of(stroke, point);
  if (!span) return nullptr;
  std::string error;
  auto session = core::restore_session(span->state, config, error);
  if (!session) return nullptr;
  core::Delta delta;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  for (std::size_t i = 0; i < span->points[point].records; ++i) {
    apply(*session, span->records[i]);
    while (session->advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    }
  }
  return session;
}

void UndoHistory::went_back(const BeforeStroke& stroke) {
  std::size_t point = 0;
  const Span* const found = span_of(stroke, point);
  if (!found) {
    clear();
    return;
  }
  while (&spans_.back() != found) {
    strokes_ -= spans_.back().points.size();
    spans_.pop_back();
  }
  Span& span = spans_.back();
  now_ = span.points[point].before;
  strokes_ -= span.points.size() - point;
  cut_back(span, span.points[point].records);
  span.points.resize(point);
  span.whole = true;
  changed_ = strokes_ > 0;  // or the point before would have been dropped for this one
  count_undoable();
}

}  // namespace incise::loop
