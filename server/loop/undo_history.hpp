#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "server/core/mesh/delta.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/loop/journal_record.hpp"

namespace incise::loop {

// What the owner of a blade has done, as BladeNow has it. `name` is the object that came with the owner: another one of the same name has another.
struct BladeSums {
  std::shared_ptr<const std::string> name;
  std::uint64_t strokes = 0, cut_faces = 0;
};
using BladesSums = std::array<BladeSums, core::kMaxSources>;

// What a session had come to just before a stroke.
struct BeforeStroke {
  // The pose that began the stroke.
  std::uint32_t source = 0;
  std::int64_t t_ns = 0, arrival_ns = 0;
  std::uint64_t revision = 0;
  std::uint64_t strokes = 0, cut_faces = 0;  // so far; as LoopState's
  double cut_area_m2 = 0;
  BladesSums blades;  // by source
  // Whose stroke it is. A number may have had other owners.
  const std::string& name() const;
};

// A session that has gone back to where a stroke began; null where there was no stroke to undo.
struct Undone {
  std::uint64_t request = 0;
  BeforeStroke before;
  // The names of the blades that have cut something since, that stroke's own first. Without a session: of the blade that the last stroke is of; empty:
  // there is none.
  std::vector<std::string> blades;
  std::unique_ptr<core::CutSession> session;
  std::vector<core::HalfFace> cuts;  // all cut faces of its mesh
};

// The strokes that can be undone: saved states of a session, and the records that lead from these to where strokes begin. A state is
// saved where a stroke begins and the way there from the last one has become long, so that saving takes a fifth of the processor time at most, and going
// back some 50 ms more than reading a state. The oldest states are dropped when all takes more than `max_bytes`, but never the last one.
//
// Strokes that opened no face are passed over: what else they did goes along with the stroke before. Whose a stroke is, the name says that its blade's owner had.
//
// Thread: one, at a time: the one that runs the session.
class UndoHistory {
 public:
  explicit UndoHistory(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  // Before a record is applied to the session, for which no batch waits. O(1), and O(mesh) where a state is saved.
  void note(const JournalRecord& record, const core::CutSession& session);
  // After a step.
  void note(const core::Delta& delta);
  // The mesh is as loaded again (or the session cannot be followed any longer).
  void clear();

  // How many strokes can be undone, one after the other.
  std::size_t size() const { return undoable_; }
  // The stroke that began last, of those that have cut something; with a name, of that blade's. Null: none.
  const BeforeStroke* last(const std::string* name = nullptr) const;
  // The blades that have cut something since that stroke began: Undone::blades.
  std::vector<std::string> cut_since(const BeforeStroke& stroke) const;
  // The session as it was before that stroke; null: there is none. O(mesh).
  std::unique_ptr<core::CutSession> before(const BeforeStroke& stroke, const core::CutConfig& config) const;
  // The session has gone back there.
  void went_back(const BeforeStroke& stroke);

 private:
  struct Point {
    std::size_t records = 0;  // that lead there from the state
    BeforeStroke before;
    std::vector<std::string> cut;  // the blades that have cut something from here to the next point
  };
  struct Span {
    std::vector<std::byte> state;
    std::vector<JournalRecord> records;
    std::vector<Point> points;
    std::size_t bytes = 0;   // of all this
    bool whole = true;       // nothing after the records was left out
    double saved_cpu_s = 0;  // the thread's processor time when it began
  };
  void begin_span(const core::CutSession& session);
  void end_span();
  void drop_oldest(std::size_t more, std::size_t kept, std::vector<std::byte>& place);
  static void cut_back(Span& span, std::size_t records);
  void drop_last_point();
  void count_undoable();
  const Span* span_of(const BeforeStroke& stroke, std::size_t& point) const;

  const std::size_t max_bytes_;
  std::deque<Span> spans_;
  std::size_t strokes_ = 0;   // points in all spans
  std::size_t undoable_ = 0;  // points to which size() undos go back
  bool changed_ = false;      // something was cut since the last point
  double save_s_ = 0;         // what the last state took
  BeforeStroke now_;          // the sums so far
};

}  // namespace incise::loop
