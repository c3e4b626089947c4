#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// A face that may be the last one between two parts, but that had to stay closed: its sides still hung together.
struct HeldFace {
  HalfFace face;
  Vec3 middle;   // where it was: edits may have put another face in its place
  double off_m;  // from the sweep that met it
  bool meets;    // an older cut
};

// Such faces, each once however often it is held: a table says where in the list a face is. Of more than kMost the oldest quarter is
// forgotten, so that room for the next one costs nothing.
class HeldFaces {
 public:
  // In the folds of a brain a stroke holds some 2,000.
  static constexpr std::size_t kMost = 4096;
  // One that is looked at again is the same if its middle has moved no farther than this by itself.
  static constexpr double kSame_h = 0.1;

  HeldFaces() : table_(kTable, 0) { faces_.reserve(kMost); }

  std::size_t size() const { return faces_.size(); }
  bool empty() const { return faces_.empty(); }
  const HeldFace& operator[](std::size_t i) const { return faces_[i]; }

  void push(const HeldFace& held) {
    std::size_t at = find(held.face);
    if (table_[at] != 0) {
      faces_[table_[at] - 1u] = held;
      return;
    }
    if (faces_.size() == kMost) {
      faces_.erase(faces_.begin(), faces_.begin() + kMost / 4);
      enter_all();
      at = find(held.face);
    }
    faces_.push_back(held);
    table_[at] = static_cast<std::uint16_t>(faces_.size());
  }

  void clear() {
    if (faces_.empty()) return;
    faces_.clear();
    enter_all();
  }

  // Before the body moves: leaves out what is another face by now. Afterwards: where they are.
  void leave_out_changed(const TetMesh& mesh, double same_m) {
    const std::size_t before = faces_.size();
    std::erase_if(faces_, [&](const HeldFace& held) {
      return !mesh.alive(tet_of(held.face)) || distance(mesh.face_middle(held.face), held.middle) > same_m;
    });
    if (faces_.size() != before) enter_all();
  }
  void note_middles(const TetMesh& mesh) {
    for (HeldFace& held : faces_) held.middle = mesh.face_middle(held.face);
  }

  void archive(Archive& io, const TetMesh& mesh) {
    io.list(faces_, 37, [&](HeldFace& held) {
      io(held.face);
      io(held.middle);
      io(held.off_m);
      io(held.meets);
      io.demand(tet_of(held.face) < mesh.tet_slots(), "a held face of no tetrahedron");
    });
    io.demand(faces_.size() <= kMost, "more held faces than are kept");
    if (!io.reads()) return;
    if (io.failed()) faces_.clear();
    enter_all();
  }

 private:
  static constexpr unsigned kTableBits = 13;
  static constexpr std::size_t kTable = std::size_t{1} << kTableBits;

  // The entry of a face, or the free one that would be its.
  std::size_t find(HalfFace face) const {
    std::size_t at = face * 2654435761u >> (32 - kTableBits);
    while (table_[at] != 0 && faces_[table_[at] - 1u].face != face) at = (at + 1) % kTable;
    return at;
  }
  void enter_all() {
    table_.assign(kTable, 0);
    for (std::size_t i = 0; i < faces_.size(); ++i)
      table_[find(faces_[i].face)] = static_cast<std::uint16_t>(i + 1);
  }

  std::vector<HeldFace> faces_;       // the newest last
  std::vector<std::uint16_t> table_;  // by a face's hash: 1 + where it is
};

}  // namespace incise::core
