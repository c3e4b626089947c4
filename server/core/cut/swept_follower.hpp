#pragma once

#include <cstddef>
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
  void begin() { next_ = 0; }
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);
  // Just before vertices move, and just after. Some 0.5 us a line.
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

  template <class Visit>
  void each_line(Visit visit);
  void set(LineAnchor& anchor, const BladeLine& line, WorkBudget& budget);
  void find_near(const Vec3& p, LineAnchor::Point& point, WorkBudget& budget);
  bool is_there(VertexId v) const { return v != kNone && mesh_.is_used(v); }
  void move(BladeLine& line, LineAnchor& anchor, const Vec3* before) const;
  bool note_strain(LineAnchor::Point& point, const Vec3* before) const;

  const TetMesh& mesh_;
  CutWorkspace& workspace_;
  std::size_t next_ = 0;      // quad or, behind these, end
  std::vector<Vec3> before_;  // where the vertices near each line were
  std::vector<Near> near_;    // scratch
};

}  // namespace incise::core
