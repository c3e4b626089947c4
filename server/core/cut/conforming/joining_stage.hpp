#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::core {

// Continues sweeps so that they meet: what is nearer than a quarter of an element is one. A sweep that begins or ends near an older
// cut, or before the body's boundary, goes on until it is through; to either side, where the boundary beside it is near; and along the blade, where its
// heel or its tip runs before one of them. Where an older one ended near what is swept now, or had its heel or its tip there, its last strip is part of
// what is swept, and goes on likewise; and where large elements have left a gap in the strip at an end.
class JoiningStage {
 public:
  explicit JoiningStage(CutContext& cut) : cut_(cut), mesh_(cut.mesh), gathered_(cut.workspace) {}

  void clear();  // a new stroke
  void begin(const Batch& batch);
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);

  // The sweep so far goes along with the tissue.
  void move(const AffineMotion& motion);
  void archive(Archive& io);

 private:
  // A part of the sweep's edge, and where it would go on from there.
  struct Part {
    // kEnd: of a line at which it begins or ends, straight ahead; kAside: to the boundary beside it; kRim: of the heel's or the tip's way, along the blade.
    enum Kind : std::uint8_t { kEnd, kAside, kRim };
    Vec3 from, to, direction;
    Kind kind;
    // Whether the other one begins where this ends.
    bool precedes(const Part& other) const {
      return to == other.from && direction == other.direction && kind == other.kind;
    }
  };
  // A face of an older cut or of the boundary, in front of a blade that moves on.
  struct Wall {
    std::array<Vec3, 3> corners;
    Box box;
    Vec3 normal;    // twice its area long
    double facing;  // how far the direction is off its plane: the sine
    bool is_cut;
  };
  struct Triangle {
    Vec3 a, b, c;
  };
  // A box that lies along what the batch has swept: across it, along the blade, along its motion. A blade is long and lies along no axis, and most of what is
  // in an upright box around it is nowhere near.
  struct Around {
    std::array<Vec3, 3> axes{};
    std::array<double, 3> low{}, high{};
    // Whether p may be within that reach of it.
    bool is_within(double reach_m, const Vec3& p) const {
      for (std::size_t i = 0; i < 3; ++i) {
        const double at = dot(axes[i], p);
        if (at + reach_m < low[i] || at - reach_m > high[i]) return false;
      }
      return true;
    }
  };
  // A part of a line with a wall ahead, so far away.
  struct Walled {
    std::size_t part;
    double ahead_m;
  };
  void list(const BladeLine& line, const Vec3& direction);
  void list(const Vec3& from, const Vec3& to, const Vec3& direction, Part::Kind kind);
  void list_rims(const Batch& batch);
  void begin_strip(const BladeLine& line);
  void follow_strip(const BladeLine& line);
  void end_strip(const BladeLine& line);
  void keep_beginning();
  void keep(std::span<const BladeLine> lines, double travel_m);
  bool turns_back(const BladeLine& line, const Vec3& direction) const;
  void keep_turn(const BladeLine& line);
  void enclose_swept();
  bool comes_near(const SweepEnd& end) const;
  static double strip_m(const SweepEnd& end);
  bool comes_near(const SweepEnd& end, std::uint32_t part) const;
  void take_up(SweepEnd& end, std::uint32_t part);
  bool take_up_rims(WorkBudget& budget);
  bool take_up(const SweptMemory::Quad& quad, SweptMemory::End end, std::uint32_t part);
  bool go_on_beyond(const SweptMemory::Quad& quad, SweptMemory::End end, std::uint32_t part);
  bool covers(const Vec3& p) const;
  bool meets_gap(SweepEnd& end, std::uint32_t part);
  bool is_open(const Vec3& p);
  void gather_walls();
  enum class Of { kAll, kCuts, kSkin };
  double wall_ahead(const Vec3& p, const Vec3& direction, Of of = Of::kAll) const;
  void extend_rim(const Part& part);
  bool skin_is_near(const Vec3& p) const;
  bool sweep_ahead(const Vec3& p, const Vec3& direction, double& ahead_m) const;
  bool is_ahead(const Wall& wall, const Part& part) const;
  void close_last();
  bool is_closed_by_walls() const;
  bool too_many_are_free() const;
  void extend(const Vec3& a, const Vec3& b, const Vec3& direction, double ahead_m);

  CutContext& cut_;
  const TetMesh& mesh_;
  Vec3 direction_{};              // in which the sweep went last; 0: in none
  std::vector<BladeLine> strip_;  // the sweep's latest lines, or the first ones while it has just begun
  bool begins_ = false;
  std::vector<Part> parts_;
  double ahead_at_end_m_ = 0;    // wall_ahead() at the end of the last part
  std::vector<Triangle> swept_;  // by the batch
  Box in_reach_;                 // an upright box around all that may be within reach of it
  Around around_;                // around it
  // Of the last parts, that follow each other.
  std::vector<Walled> walled_;
  std::vector<std::size_t> free_;  // straight ahead of these there is no wall
  std::size_t next_ = 0, next_end_ = 0;
  std::uint32_t next_end_part_ = 0;  // of that end
  double end_strip_m_ = 0;           // its strip_m()
  std::size_t own_rims_ = 0;         // parts of this stroke's own rims that were looked at
  std::size_t next_quad_ = 0;        // of what is remembered, whose rims are looked at
  std::vector<Wall> walls_;          // near the parts before walls_end_
  std::size_t walls_end_ = 0;
  TetPass gathered_;
};

}  // namespace incise::core
