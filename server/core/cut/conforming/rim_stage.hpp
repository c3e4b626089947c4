#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"

namespace incise::core {

// A line of the blade at which a sweep begins or ends; one at which it turns sharply; the way of the heel or the tip.
enum class Rim : std::uint8_t { kLine, kTurn, kWay };

// Puts vertices where the rim of the sweep pierces faces: the paper's second move, to the front and back planes, in general.
class RimStage {
 public:
  RimStage(CutContext& cut, MeshEditor& editor)
      : cut_(cut), mesh_(cut.mesh), editor_(editor), around_(cut.workspace) {}

  // Notes the faces of t that a stretch of the rim pierces.
  void probe(TetId t, const Vec3& from, const Vec3& to, Rim rim);
  void clear() { list_.clear(); }

  void begin() { next_ = 0; }
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);

  void clinging(std::vector<VertexId>& out) const;
  // What is listed goes along with the tissue.
  void move(const AffineMotion& motion);
  void archive(Archive& io);

 private:
  // The rim pierces a face.
  struct Piercing {
    HalfFace side;  // the face as it was then
    std::array<VertexId, 3> face;
    Vec3 point;     // where
    Vec3 from, to;  // the stretch of the rim
    Rim rim;
    bool again;  // found on the second look
    bool done;
  };

  bool passes_by(TetId t, const Vec3& from, const Vec3& to) const;
  bool stands_for(VertexId v, const Vec3& point) const;
  bool is_listed(HalfFace other, const Vec3& from) const;
  bool handle(const Piercing& piercing);
  bool put(VertexId v, const Piercing& piercing, double limit, bool& fair);
  bool split_for(const Piercing& piercing);

  CutContext& cut_;
  const TetMesh& mesh_;
  MeshEditor& editor_;
  std::vector<Piercing> list_;
  std::size_t next_ = 0;
  VertexStar star_;
  std::vector<TetId> flat_;               // scratch
  TetPass around_;                        // what has been probed around a piercing
  std::vector<std::uint32_t> star_tets_;  // scratch
};

}  // namespace incise::core
