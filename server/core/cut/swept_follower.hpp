#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/cut/line_anchor.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

// Takes what blades have swept along when a host simulation moves the body: later strokes then find it where the tissue is that it went through. Each line
// goes as the vertices near two of its points do, is stretched with them, and stays straight. What lies in the air goes with the tissue that is nearest. Where
// that has gone apart, as at a cut that gapes, it is forgotten.
class SweptFollower {
 public:
  SweptFollower(const TetMesh& mesh, CutWorkspace& workspace) : mesh_(mesh), workspace_(workspace) {}

  // Looks for the vertices near lines that have none. Only what was swept since the last time costs something: some 10 us a line.
  void begin();
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);
  // Then where lines go as vertices go to these places, by vertex. Some 1 us a line. True: done; false: the budget is spent.
  bool work_out(std::span<const Vec3> places, WorkBudget& budget);
  // Just before vertices move, and just after.
  void note();
  void follow();

 private:
  struct Near {
    double distance2;
    VertexId vertex;
    bool operator<(const Near& other) const {
      return distance2 != other.distance2 ? distance2 < other.distance2 : vertex < other.vertex;
    }
  };

  struct Moved {
    BladeLine line;
    LineAnchor anchor;
  };

  // A line, its anchor, and those of the one before, with which it may be one; null: none.
  struct Line {
    BladeLine* line;
    LineAnchor* anchor;
    const BladeLine* line_before;
    const LineAnchor* anchor_before;
    bool goes_on_from_before() const { return line_before != nullptr && *line_before == *line; }
  };

  template <class Visit>
  bool each_line(std::size_t& next, Visit visit);
  void set(LineAnchor& anchor, const BladeLine& line, WorkBudget& budget);
  void find_near(const Vec3& p, LineAnchor::Point& point, WorkBudget& budget);
  bool look_near(const Vec3& p, WorkBudget& budget);
  void look_anywhere(const Vec3& p, WorkBudget& budget);
  void consider(VertexId v, const Vec3& p);
  bool is_there(VertexId v) const { return v != kNone && mesh_.is_used(v); }
  void move(BladeLine& line, LineAnchor& anchor, std::span<const Vec3> places) const;
  bool note_strain(LineAnchor::Point& point, std::span<const Vec3> places) const;

  const TetMesh& mesh_;
  CutWorkspace& workspace_;
  std::size_t next_ = 0;      // line that has to be looked at
  std::vector<Moved> moved_;  // where the first lines go, so far
  std::vector<Near> near_;    // scratch
};

}  // namespace incise::core
