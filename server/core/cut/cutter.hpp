#pragma once

#include <cstdint>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/affine_motion.hpp"
#include "server/core/stroke/stroke_builder.hpp"
#include "server/core/util/archive.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

// What a batch did.
struct CutCounts {
  std::uint32_t events = 0;        // crossings of the sweep with mesh edges that were dealt with
  std::uint32_t snaps = 0;         // vertices moved onto the swept surface
  std::uint32_t splits = 0;        // edges split at the crossing
  std::uint32_t failed = 0;        // crossings that could be neither snapped nor split
  std::uint32_t removed_tets = 0;  // flat ones, all four vertices on the swept surface
  std::uint32_t repairs = 0;       // quality operations: smoothed vertices, flips, collapses
  std::uint32_t cut_faces = 0;     // interior faces opened
  double cut_area = 0;             // their area, one side, m^2
  double max_deviation_h = 0;      // of opened faces' vertices from the swept surface
  std::uint32_t pending = 0;       // crossings and faces that wait for the blade to pass
};

// A cut policy at work for one source. A batch is begun once, then advanced until it is done; each return leaves a
// valid mesh. What is done, and where parts end, never depends on the budgets.
class Cutter {
 public:
  virtual ~Cutter() = default;
  // Takes the next batch; the one before must be done.
  virtual void begin(const Batch& batch) = 0;
  enum class Progress {
    kSpent,  // the budget is spent; work is left
    kPart,   // a part of the batch is done that is worth a delta of its own; work is left
    kDone
  };
  virtual Progress advance(WorkBudget& budget) = 0;
  // Of the batch begun last, or of its last part.
  virtual const CutCounts& counts() const = 0;
  // Between two batches: appends the vertices, some more than once, that what the stroke has pending relies on. Until it is done they
  // may only be moved all together, and follow() has to say so.
  virtual void clinging(std::vector<VertexId>& /*out*/) const {}
  // They have been moved, and what the stroke has swept goes along. The next batch's lines are where the tissue is now.
  virtual void follow(const AffineMotion& /*motion*/) {}
  // The batch begun last, as far as the policy needs to know.
  virtual BatchNumber last() const { return {}; }
  // Between two batches: what later ones depend on.
  virtual void archive(Archive& /*io*/) {}
  // Between two batches: brings what the next one is likely to work on into the processor's caches, from which the milliseconds
  // since the last one have driven it. Changes nothing.
  virtual void prefetch() {}
};

}  // namespace incise::core
