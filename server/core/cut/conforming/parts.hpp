#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/films.hpp"

namespace incise::core {

// Follows what hangs together on one side of a face, other than through faces that are about to open (TetMarks::pending), and says what it is.
class Parts {
 public:
  explicit Parts(CutContext& cut) : cut_(cut), mesh_(cut.mesh), pass_(cut.workspace), films_(cut) {}

  // To be called when the mesh has changed.
  void begin() {
    judged_.clear();
    films_.begin();
  }

  // kHangsTogether: with the other side. kCrumb: seen to its end, no part of the tissue. kSmall: seen to its end. kLarge: more than was to be looked at.
  enum class Part { kHangsTogether, kCrumb, kSmall, kLarge };
  // What a part that is seen to its end has to be. kInside: no film, and to reach away from the sweep. kThick: thicker than a film in the mean, that
  // alone; and to reach away. kBeside: beside the sweep, on one side of it, no film and deep.
  enum class Rule { kInside, kThick, kBeside };
  // What is on the side of `from`, when `other` is on the other. Stops after some more than `most` tetrahedra.
  Part look(TetId from, TetId other, Rule rule, std::size_t most);
  // What look() has seen, all of the part if that is kCrumb or kSmall.
  std::span<const TetId> seen() const { return queue_; }

 private:
  // A part that has been followed to its end: a hash of its tetrahedra and of their faces that are about to open, in whatever order, and what it is. Most are
  // met again, from another of their faces.
  struct Judged {
    std::uint64_t hash;
    Rule rule;
    Part part;
  };

  Part judge(Rule rule);
  Extent extent() const;
  bool grows_as_film(std::size_t i);

  CutContext& cut_;
  const TetMesh& mesh_;
  TetPass pass_;
  Films films_;
  std::vector<TetId> queue_;
  std::vector<Judged> judged_;           // since the mesh last changed
  std::size_t inner_ = 0, counted_ = 0;  // of the queue's first ones, so many reach into the tissue
};

}  // namespace incise::core
