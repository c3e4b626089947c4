#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/core/stroke/swept_surface.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using namespace incise::core::testing;

constexpr double kPi = 3.14159265358979323846;

CutConfig cutting_config(const Blade& blade) {
  CutConfig config;
  config.blade = blade;
  config.always_engaged = true;
  config.speed_limit_m_s = 1e9;
  config.gap_limit_s = 1e9;
  return config;
}

// Sets of vertices that hang together.
class Components {
 public:
  explicit Components(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0u); }
  std::uint32_t find(std::uint32_t v) {
    while (parent_[v] != v) v = parent_[v] = parent_[parent_[v]];
    return v;
  }
  void join(std::uint32_t a, std::uint32_t b) { parent_[find(a)] = find(b); }

 private:
  std::vector<std::uint32_t> parent_;
};

// A session that is cut by blade lines as they stand: the tool's frame is the world's, each line becomes a pose that
// takes a blade along z to it.
class Cut {
 public:
  Cut(const MeshData& mesh, double blade_m, Preference prefer = Preference::kBalanced,
      double batch_h = CutConfig{}.batch_h)
      : session_(mesh, with(cutting_config({{0, 0, 0}, {0, 0, blade_m}}), prefer, batch_h)),
        volume_before_(measure(session_.mesh()).volume) {}

  // The blade with its heel at `heel`, pointing along `direction` (of any length).
  void pose(const Vec3& heel, const Vec3& direction) {
    const Vec3 d = normalized(direction);
    const Vec3 axis = cross({0, 0, 1}, d);
    Quat q{1 + d.z, axis.x, axis.y, axis.z};
    if (q.w < 1e-9) q = {0, 1, 0, 0};
    const double n = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    t_ns_ += 1'000'000;
    ASSERT_TRUE(accepted(session_.push(0, {t_ns_, heel, {q.w / n, q.x / n, q.y / n, q.z / n}, 1})));
    drain();
  }
  // Straight on from `from` to `to` in `poses` steps.
  void sweep(const Vec3& from, const Vec3& to, const Vec3& direction, int poses) {
    for (int i = 0; i <= poses; ++i) pose(lerp(from, to, static_cast<double>(i) / poses), direction);
  }
  void lift() {
    session_.end_stroke(0);
    drain();
  }
  void set_budget(std::int64_t units, bool validate_stops = true) {
    budget_ = units;
    validate_stops_ = validate_stops;
  }

  const TetMesh& mesh() const { return session_.mesh(); }
  std::uint32_t piece(TetId t) const { return session_.piece(t); }
  const CutCounts& totals() const { return totals_; }
  const std::vector<std::uint64_t>& hashes() const { return hashes_; }
  // The most units that one call went beyond its budget.
  std::int64_t most_beyond() const { return most_beyond_; }
  // Units of all of it.
  std::int64_t work() const { return work_; }
  const std::vector<Delta::Piece>& last_pieces() const { return pieces_; }

  // What must hold whatever was cut.
  void expect_sound(double volume_tolerance = 2e-4) const {
    EXPECT_EQ(validate(mesh()), "");
    const CutReport report = measure(mesh());
    EXPECT_EQ(report.inverted, 0u);
    EXPECT_NEAR(report.volume / volume_before_, 1.0, volume_tolerance);
  }
  SweptSurface swept() const {
    SweptSurface surface;
    for (const auto& stroke : strokes_) add_sweep(surface, stroke, 1e-3 * mesh().mean_edge_length());
    surface.build();
    return surface;
  }
  // Of the cut faces from the surface swept.
  Deviation cut_deviation() const { return deviation(mesh(), swept()); }
  // How many pieces one through-cut makes of `uncut`, at least and at most: the components of its vertices on either side, joined by
  // edges that stay on it. Those of one or two vertices, and those that nowhere reach far from the surface, may stay with a neighbour;
  // those that hang together only nearer to the surface than a cut is closed may come apart.
  std::pair<std::uint32_t, std::uint32_t> expected_pieces(const MeshData& uncut) const {
    const SweptSurface surface = swept();
    const double h = TetMesh(uncut).mean_edge_length();
    const std::size_t n = uncut.positions.size();
    std::vector<std::uint32_t> size(n, 0);
    std::vector<bool> above(n), reaches(n, false), used(n, false);
    std::vector<double> off_m(n);
    Components all(n), far(n);
    for (std::uint32_t v = 0; v < n; ++v) {
      Vec3 closest;
      std::uint32_t triangle = 0;
      surface.closest(uncut.positions[v], 1e9, closest, triangle);
      above[v] = surface[triangle].signed_distance(uncut.positions[v]) >= 0;
      off_m[v] = distance(uncut.positions[v], closest);
    }
    const auto is_far = [&](VertexId v) { return off_m[v] > 0.25 * h; };
    for (const auto& tet : uncut.tets) {
      for (const auto& edge : kEdgeVertices) {
        const VertexId a = tet[edge[0]], b = tet[edge[1]];
        used[a] = used[b] = true;
        if (above[a] != above[b]) continue;
        all.join(a, b);
        if (is_far(a) && is_far(b)) far.join(a, b);
      }
    }
    for (std::uint32_t v = 0; v < n; ++v) {
      size[all.find(v)] += used[v];
      if (used[v] && off_m[v] > 0.35 * h) reaches[all.find(v)] = true;
    }
    std::pair<std::uint32_t, std::uint32_t> count{};
    std::vector<std::uint32_t> far_parts(n, 0);
    for (std::uint32_t v = 0; v < n; ++v) {
      if (used[v] && is_far(v) && far.find(v) == v) ++far_parts[all.find(v)];
    }
    for (std::uint32_t v = 0; v < n; ++v) {
      count.first += size[v] >= 3 && reaches[v];
      if (size[v] >= 1) count.second += std::max(1u, far_parts[v]);
    }
    return count;
  }

 private:
  static CutConfig with(CutConfig config, Preference prefer, double batch_h) {
    config.prefer = prefer;
    config.batch_h = batch_h;
    return config;
  }
  void drain() {
    Delta delta;
    for (;;) {
      WorkBudget budget{budget_};
      const auto progress = session_.advance(budget, delta);
      most_beyond_ = std::max(most_beyond_, -budget.left);
      work_ += budget_ - budget.left;
      if (progress == CutSession::Progress::kIdle) return;
      if (progress == CutSession::Progress::kSpent) {
        if (validate_stops_ && ++stops_ % 16 == 0) {
          ASSERT_EQ(validate(mesh()), "") << "after a stop within a batch";
        }
        continue;
      }
      hashes_.push_back(delta.state_hash);
      pieces_.insert(pieces_.end(), delta.pieces.begin(), delta.pieces.end());
      const CutCounts& c = session_.committed_counts();
      totals_.snaps += c.snaps;
      totals_.splits += c.splits;
      totals_.failed += c.failed;
      totals_.cut_faces += delta.cut_faces;
      totals_.cut_area += delta.cut_area;
      const Batch& batch = session_.committed_batch();
      if (batch.number == 1) strokes_.emplace_back();
      auto& lines = strokes_.back();
      lines.insert(lines.end(), batch.lines.begin() + (batch.number == 1 ? 0 : 1), batch.lines.end());
    }
  }

  CutSession session_;
  double volume_before_;
  std::int64_t t_ns_ = 0;
  std::int64_t budget_ = INT64_MAX, most_beyond_ = 0, work_ = 0;
  bool validate_stops_ = true;
  std::uint32_t stops_ = 0;
  CutCounts totals_;
  std::vector<std::uint64_t> hashes_;
  std::vector<Delta::Piece> pieces_;
  std::vector<std::vector<BladeLine>> strokes_;
};

// A block of 8 x 8 x 8 cells of width 1, its vertices shaken so that nothing is aligned.
MeshData block() {
  return shaken_box(8, 8, 8, 7, 0.15);
}

std::uint32_t pieces(const Cut& cut) {
  return measure(cut.mesh()).pieces;
}

TEST(ConformingCutter, through_cut_makes_two_pieces_and_says_so) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 10, -2}, {0, 0, 1}, 40);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
  ASSERT_EQ(cut.last_pieces().size(), 1u);
  const auto label = cut.last_pieces()[0];
  std::uint32_t labelled = 0;
  for (TetId t = 0; t < cut.mesh().tet_slots(); ++t)
    labelled += cut.mesh().alive(t) && cut.piece(t) == label.id;
  EXPECT_EQ(labelled, label.tets);
  EXPECT_LT(labelled, cut.mesh().live_tets());
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
  EXPECT_NEAR(cut.totals().cut_area, 64, 1.5);
  EXPECT_EQ(cut.totals().failed, 0u);
}

TEST(ConformingCutter, stops_anywhere_with_the_same_result) {
  const auto run = [](std::int64_t units) {
    Cut cut(block(), 12);
    cut.set_budget(units);
    cut.sweep({4.13, -2, -2}, {3.4, 10, -2}, {0.1, 0, 1}, 25);
    cut.lift();
    return cut.hashes();
  };
  const auto unlimited = run(INT64_MAX);
  ASSERT_GT(unlimited.size(), 5u);
  for (const std::int64_t units : {1, 7, 100, 5000})
    EXPECT_EQ(run(units), unlimited) << units << " units a call";
}

// What cannot be interrupted is a frame's delay: a unit is some 50 ns. Neither the length of the blade nor the size of
// the mesh or of what is cut off may show in it.
TEST(ConformingCutter, no_step_goes_far_beyond_the_budget) {
  constexpr std::int64_t kMost = 1000;
  for (const int n : {8, 20}) {
    Cut cut(shaken_box(n, n, n, 7, 0.15), n + 4);
    cut.set_budget(1, false);
    cut.sweep({0.513 * n, -2, -2}, {0.43 * n, n + 2.0, -2}, {0.1, 0, 1}, 40);
    cut.lift();
    EXPECT_EQ(pieces(cut), 2u);
    // Over what is cut already, where everything is at the boundary.
    cut.sweep({0.43 * n, n + 2.0, -2}, {0.518 * n, -2, -2}, {0.1, 0, 1}, 40);
    cut.lift();
    EXPECT_LE(cut.most_beyond(), kMost) << n;
  }
}

// Which pieces there are costs what the smaller one holds, whatever the larger one does.
TEST(ConformingCutter, the_same_corner_costs_the_same_in_a_larger_mesh) {
  std::vector<double> work;
  for (const int n : {12, 36}) {
    Cut cut(shaken_box(n, n, n, 7, 0.15), 12);
    const Vec3 blade = normalized({0, 1, -0.7});
    // The heel passes well outside.
    for (int i = 0; i <= 20; ++i) cut.pose(Vec3{-3 + 0.5 * i, 7 - 0.5 * i, -1} - 6.0 * blade, blade);
    cut.lift();
    EXPECT_EQ(pieces(cut), 2u) << n;
    ASSERT_EQ(cut.last_pieces().size(), 1u) << n;
    EXPECT_LT(cut.last_pieces()[0].tets, cut.mesh().live_tets() / 4) << n;
    work.push_back(static_cast<double>(cut.work()));
  }
  EXPECT_NEAR(work[1] / work[0], 1.0, 0.25) << work[0] << " and " << work[1] << " units";
}

// Each component has a label of its own.
TEST(ConformingCutter, labels_are_those_of_the_components) {
  Cut cut(shaken_box(10, 10, 10, 3, 0.15), 16);
  for (const double at : {2.13, 7.47, 5.02, 5.0, 8.9}) {
    for (const bool across : {false, true}) {
      const Vec3 from = across ? Vec3{-2, at, -3} : Vec3{at, -2, -3},
                 to = across ? Vec3{12, at, -3} : Vec3{at, 12, -3};
      cut.sweep(from, to, {0, 0, 1}, 30);
      cut.lift();
      std::uint32_t count = 0;
      const auto components = label_pieces(cut.mesh(), &count);
      std::vector<std::uint32_t> label(count, kNone);
      for (TetId t = 0; t < cut.mesh().tet_slots(); ++t) {
        if (!cut.mesh().alive(t)) continue;
        if (label[components[t]] == kNone) label[components[t]] = cut.piece(t);
        ASSERT_EQ(label[components[t]], cut.piece(t)) << "tetrahedron " << t << ", cut at " << at;
      }
      std::vector<std::uint32_t> sorted = label;
      std::sort(sorted.begin(), sorted.end());
      EXPECT_TRUE(std::adjacent_find(sorted.begin(), sorted.end()) == sorted.end()) << "cut at " << at;
    }
  }
  EXPECT_GE(pieces(cut), 16u);
}

TEST(ConformingCutter, beside_an_older_cut_there_is_nothing_to_cut) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 10, -2}, {0, 0, 1}, 40);
  cut.lift();
  const std::uint32_t tets = cut.mesh().live_tets();
  const double h = cut.mesh().mean_edge_length();
  cut.sweep({4.13 + 0.05 * h, 10, -2}, {4.13 + 0.05 * h, -2, -2}, {0, 0, 1}, 40);
  cut.lift();
  cut.expect_sound(1e-3);
  EXPECT_EQ(pieces(cut), 2u);
  EXPECT_LE(cut.mesh().live_tets(), tets + tets / 8);
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
}

TEST(ConformingCutter, the_same_motion_in_any_number_of_poses) {
  double area = 0;
  for (const int poses : {1, 10, 200, 5000}) {
    Cut cut(block(), 12);
    cut.sweep({4.13, -2, -2}, {4.13, 10, -2}, {0.05, 0, 1}, poses);
    cut.lift();
    cut.expect_sound();
    EXPECT_EQ(pieces(cut), 2u) << poses;
    EXPECT_LE(cut.cut_deviation().max_h, 0.1) << poses;
    const double now = measure(cut.mesh()).cut_area;
    if (area > 0) {
      EXPECT_NEAR(now / area, 1.0, 0.01) << poses;
    }
    area = now;
  }
}

// Batches far thinner than a tetrahedron: what a split or a flip makes well behind the blade still knows the surface there.
TEST(ConformingCutter, the_same_bend_in_batches_of_any_size) {
  for (int round = 0; round < 40; ++round) {
    const double x = 3.4 + 0.03 * round, bend = 0.4 + 0.05 * round, lean = 0.01 * round;
    for (const double batch_h : {0.02, 0.25, 1.0, 4.0}) {
      Cut cut(block(), 12, Preference::kBalanced, batch_h);
      for (int i = 0; i <= 100; ++i) {
        const double u = i / 100.0;
        cut.pose({x + bend * std::sin(kPi * u), -2 + 12 * u, -2}, {lean, 0, 1});
      }
      cut.lift();
      cut.expect_sound();
      // In the last ones what is cut off is two wedges that hang together only nearer to the surface than a cut is closed.
      const auto [least, most] = cut.expected_pieces(block());
      EXPECT_LE(most, round < 38 ? 2u : 3u);
      EXPECT_GE(pieces(cut), least) << "round " << round << ", batches of " << batch_h << " h";
      EXPECT_LE(pieces(cut), most) << "round " << round << ", batches of " << batch_h << " h";
    }
  }
}

TEST(ConformingCutter, twisted_sweep_through) {
  Cut cut(block(), 14);
  for (int i = 0; i <= 60; ++i) {
    const double u = i / 60.0, angle = 0.8 * (u - 0.5);
    const Vec3 d{std::sin(angle), 0, std::cos(angle)};
    cut.pose(Vec3{4.1, -2 + 12 * u, 4} - 7.0 * d, d);
  }
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
  EXPECT_LE(cut.cut_deviation().mean_h, 0.01);
}

TEST(ConformingCutter, tip_inside_the_tissue_leaves_one_piece) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, 13}, {4.13, 5.3, 13}, {0, 0, -1}, 40);  // the tip 1 below the upper side
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 1u);
  EXPECT_GT(cut.totals().cut_faces, 10u);
  EXPECT_NEAR(measure(cut.mesh()).cut_area, 7 * 5.3, 0.1 * 7 * 5.3);
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
}

TEST(ConformingCutter, stop_and_go_on) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 4, -2}, {0, 0, 1}, 20);
  for (int i = 0; i < 200; ++i) cut.pose({4.13, 4, -2}, {0, 0, 1});
  EXPECT_EQ(pieces(cut), 1u);
  cut.sweep({4.13, 4, -2}, {4.13, 10, -2}, {0, 0, 1}, 20);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
}

TEST(ConformingCutter, back_up_and_go_on) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 5, -2}, {0, 0, 1}, 30);
  cut.sweep({4.13, 5, -2}, {4.13, 2, -2}, {0, 0, 1}, 20);
  cut.sweep({4.13, 2, -2}, {4.13, 10, -2}, {0, 0, 1}, 40);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
}

TEST(ConformingCutter, tremble_in_place_adds_nothing_much) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 4, -2}, {0, 0, 1}, 20);
  Random random(11);
  const std::uint32_t before = cut.mesh().live_tets();
  for (int i = 0; i < 2000; ++i) {
    cut.pose({4.13 + 0.05 * (random.uniform(-0.5, 0.5)), 4 + 0.3 * (random.uniform(-0.5, 0.5)), -2},
             {0, 0, 1});
  }
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 1u);
  EXPECT_LT(cut.mesh().live_tets(), before + 300);
}

// A hand that rests with the blade in the tissue trembles: sweeping the same place costs no more after a minute.
TEST(ConformingCutter, trembling_costs_no_more_the_longer_it_lasts) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 4, -2}, {0, 0, 1}, 20);
  auto tremble = [&cut, t = 0.0](int poses) mutable {
    const std::int64_t before = cut.work();
    for (int i = 0; i < poses; ++i) {
      t += 0.001;
      const auto wave = [t](double hz, double phase) { return 0.2 * std::sin(6.2832 * hz * t + phase); };
      cut.pose({4.13 + wave(8.3, 1), 4 + wave(9.7, 2), -2 + wave(11.9, 3)},
               {0.01 * wave(10.1, 4), 0.01 * wave(7.7, 5), 1});
    }
    return cut.work() - before;
  };
  tremble(4000);
  const std::int64_t early = tremble(4000);
  tremble(16000);
  EXPECT_LT(tremble(4000), early + early / 4);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 1u);
  EXPECT_LT(cut.cut_deviation().max_h, 0.15);
}

// Back along the cut, closer to it than the retrace tolerance, and on from there: nothing is left between.
TEST(ConformingCutter, back_over_the_cut_and_on_leaves_no_bridge) {
  for (const double beside : {0.0, 0.01, 0.03, 0.06, 0.2}) {
    for (const int poses : {4, 30, 400}) {
      Cut cut(block(), 12);
      cut.sweep({4.13, -2, -2}, {4.13, 4, -2}, {0, 0, 1}, poses);
      cut.sweep({4.13, 4, -2}, {4.13 + beside, 1, -2}, {0, 0, 1}, poses);
      cut.sweep({4.13 + beside, 1, -2}, {4.13 - beside, 4.04, -2}, {0, 0, 1}, poses);
      cut.sweep({4.13 - beside, 4.04, -2}, {4.13, 3.9, -2}, {0, 0, 1}, poses);
      cut.sweep({4.13, 3.9, -2}, {4.13, 10, -2}, {0, 0, 1}, poses);
      cut.lift();
      cut.expect_sound();
      EXPECT_EQ(pieces(cut), 2u) << beside << ", " << poses;
    }
  }
}

// A device's noise on a slow motion: steps that go back and forth across the cut far more than along it.
TEST(ConformingCutter, noise_beside_slow_motion_leaves_no_bridge) {
  for (const double noise : {0.01, 0.03, 0.05, 0.1}) {
    for (const double step : {0.004, 0.02}) {
      for (const bool to_and_fro : {false, true}) {
        Cut cut(block(), 12);
        Random random(5);
        int i = 0;
        for (double y = -2; y < 10; y += step) {
          const double side = to_and_fro ? (++i % 2 == 0 ? 1 : -1) : random.uniform(-1, 1);
          cut.pose({4.13 + noise * side, y, -2}, {0, 0, 1});
        }
        cut.lift();
        cut.expect_sound();
        EXPECT_EQ(pieces(cut), 2u) << noise << ", " << step << ", " << to_and_fro;
        EXPECT_LT(cut.mesh().live_tets(), 3500u) << noise << ", " << step << ", " << to_and_fro;
      }
    }
  }
}

TEST(ConformingCutter, lift_out_and_re_enter_in_the_old_cut) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 5, -2}, {0, 0, 1}, 30);
  cut.lift();
  EXPECT_EQ(pieces(cut), 1u);
  cut.sweep({4.13, 3, -2}, {4.13, 10, -2}, {0, 0, 1}, 30);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
}

TEST(ConformingCutter, across_an_older_cut_makes_four_pieces) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 10, -2}, {0, 0, 1}, 30);
  cut.lift();
  cut.sweep({-2, 3.87, -2}, {10, 3.87, -2}, {0, 0, 1}, 30);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 4u);
}

// One stroke all the way: what it has left behind is an old cut, and no part of what it sweeps now.
TEST(ConformingCutter, across_its_own_cut_makes_four_pieces) {
  for (const double slant : {0.0, 0.7, 1.6, -1.2}) {
    SCOPED_TRACE(slant);
    Cut cut(block(), 12);
    cut.sweep({4.13, -2, -2}, {4.13, 10, -2}, {0, 0, 1}, 60);
    cut.sweep({4.13, 10, -2}, {12, 10, -2}, {0, 0, 1}, 40);
    cut.sweep({12, 10, -2}, {12, 3.87 + slant, -2}, {0, 0, 1}, 30);
    cut.sweep({12, 3.87 + slant, -2}, {-2, 3.87 - slant, -2}, {0, 0, 1}, 60);
    cut.lift();
    cut.expect_sound();
    EXPECT_EQ(pieces(cut), 4u);
    EXPECT_LE(cut.cut_deviation().max_h, 0.05);
    EXPECT_LE(cut.cut_deviation().mean_h, 0.001);
  }
}

TEST(ConformingCutter, corner_cut_off) {
  Cut cut(block(), 20);
  cut.sweep({4.6, 10, -3}, {10, 4.6, -3}, {0, 0, 1}, 20);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
}

// Too small for a part, and its middle not 0.3 h off the sweep. More than half of a longer one comes off.
TEST(ConformingCutter, the_tip_of_a_spike_stays_on) {
  struct Spike {
    double height, cut_at;
    std::uint32_t pieces;
  };
  for (const Spike& spike : {Spike{2, 1, 1}, Spike{2, 1.3, 1}, Spike{4, 1.5, 2}}) {
    MeshData mesh = box(3, 3, 3);
    const auto top = [](int i, int j) { return static_cast<VertexId>((3 * 4 + j) * 4 + i); };
    const auto apex = static_cast<VertexId>(mesh.positions.size());
    mesh.positions.push_back({1.6, 1.3, 3 + spike.height});
    mesh.tets.push_back({apex, top(1, 1), top(2, 2), top(2, 1)});
    Cut cut(mesh, 5);
    cut.sweep({-1, -1, 3 + spike.cut_at}, {4, -1, 3 + spike.cut_at}, {0, 1, 0}, 20);
    cut.lift();
    cut.expect_sound();
    EXPECT_EQ(measure(cut.mesh()).pieces, spike.pieces)
        << "height " << spike.height << ", cut at " << spike.cut_at;
    EXPECT_EQ(cut.totals().cut_faces > 0, spike.pieces > 1);
  }
}

TEST(ConformingCutter, along_the_surface_outside_cuts_nothing) {
  const MeshData mesh = box(6, 6, 6);
  Cut cut(mesh, 10);
  cut.sweep({-1e-9, -2, -2}, {-1e-9, 8, -2}, {0, 0, 1}, 30);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(cut.mesh().live_tets(), mesh.tets.size());
  EXPECT_EQ(cut.totals().cut_faces, 0u);
}

TEST(ConformingCutter, in_the_plane_of_faces_through_vertices_along_edges) {
  // An unshaken box: the sweep runs exactly in a layer of faces.
  const MeshData mesh = box(6, 6, 6);
  Cut cut(mesh, 10);
  cut.sweep({3, -2, -2}, {3, 8, -2}, {0, 0, 1}, 30);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
  EXPECT_NEAR(measure(cut.mesh()).cut_area, 36, 1e-6);
  // Diagonally: through vertices and along the cells' diagonals.
  Cut diagonal(mesh, 10);
  diagonal.sweep({-1, -1, -2}, {7, 7, -2}, {0, 0, 1}, 30);
  diagonal.lift();
  diagonal.expect_sound();
  EXPECT_EQ(pieces(diagonal), 2u);
}

TEST(ConformingCutter, sharp_turn) {
  Cut cut(block(), 12);
  cut.sweep({4.13, -2, -2}, {4.13, 4.1, -2}, {0, 0, 1}, 30);
  cut.sweep({4.13, 4.1, -2}, {10, 4.1, -2}, {0, 0, 1}, 30);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
}

TEST(ConformingCutter, begins_and_ends_inside) {
  Cut cut(block(), 3);
  cut.sweep({4.1, 2, 2.5}, {4.1, 6, 2.5}, {0, 0, 1}, 30);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 1u);
  EXPECT_NEAR(measure(cut.mesh()).cut_area, 12, 1.2);
}

// Nothing is moved far: what the body has on one side of the surface stays there, down to slivers of it.
TEST(ConformingCutter, exact_moves_next_to_nothing) {
  const MeshData mesh = block();
  Cut cut(mesh, 12, Preference::kExact);
  cut.sweep({4.13, -2, -2}, {4.13, 10, -2}, {0.05, 0, 1}, 40);
  cut.lift();
  cut.expect_sound();
  EXPECT_EQ(pieces(cut), 2u);
  EXPECT_GT(cut.totals().splits, 20 * cut.totals().snaps);
  EXPECT_LE(cut.cut_deviation().max_h, 0.1);
  std::uint32_t moved_far = 0;
  for (VertexId v = 0; v < mesh.positions.size(); ++v)
    moved_far += distance(cut.mesh().position(v), mesh.positions[v]) > 0.1 * cut.mesh().mean_edge_length();
  EXPECT_LE(moved_far, mesh.positions.size() / 50);
}

// Where neither end of an edge can be moved, ragged faces open instead, whatever was decided there in batches before.
TEST(ConformingCutter, no_growth_comes_apart_in_many_batches) {
  int wrong = 0;
  for (std::uint32_t seed = 1; seed <= 40; ++seed) {
    const double slant = 0.1 * (seed % 7) - 0.3;
    Cut cut(shaken_box(8, 8, 8, seed, 0.2), 14, Preference::kNoGrowth);
    cut.sweep({4.13 - slant, -2, -3}, {4.13 + slant, 10, -3}, {0.5 * slant, 0, 1}, 80);
    cut.lift();
    cut.expect_sound(2e-3);
    wrong += pieces(cut) != 2u;
  }
  EXPECT_EQ(wrong, 0);
}

TEST(ConformingCutter, no_growth_adds_no_tetrahedron) {
  const MeshData mesh = block();
  Cut cut(mesh, 12, Preference::kNoGrowth);
  cut.sweep({4.13, -2, -2}, {3.3, 10, -2}, {0.2, 0, 1}, 30);
  cut.lift();
  EXPECT_EQ(validate(cut.mesh()), "");
  EXPECT_LE(cut.mesh().live_tets(), mesh.tets.size());
  EXPECT_EQ(cut.totals().splits, 0u);
  EXPECT_EQ(pieces(cut), 2u);
}

// Random through-cuts of real meshes: planar, twisted and bent ones.
class ThroughCuts : public ::testing::TestWithParam<const char*> {};

TEST_P(ThroughCuts, leave_sound_meshes_on_the_swept_surface) {
  if (data_folder().empty()) GTEST_SKIP() << "INCISE_DATA is not set: no real meshes";
  const MeshData mesh = real_mesh(GetParam());
  Vec3 low = mesh.positions[0], high = low;
  for (const Vec3& p : mesh.positions) {
    extend(p, low, high);
  }
  const Vec3 centre = 0.5 * (low + high);
  const double radius = 0.5 * distance(low, high);
  const double angle_in = measure(TetMesh(mesh)).min_dihedral_deg;
  std::int64_t more = 0, faces = 0;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    const auto centred = [&] { return random.uniform(-1, 1); };
    const Vec3 d = normalized({centred(), centred(), centred()});
    const Vec3 a = normalized(cross(d, {centred(), centred(), centred()}));
    const Vec3 n = cross(a, d);
    const Vec3 origin = centre + 0.3 * radius * centred() * n;
    const double twist = seed % 2 == 0 ? 0.8 * centred() : 0, bend = seed > 2 ? 0.2 * radius * centred() : 0;
    const int poses = seed == 1 ? 1 : 60;
    Cut cut(mesh, 2.6 * radius);
    for (int i = 0; i <= poses; ++i) {
      const double u = static_cast<double>(i) / poses;
      const Vec3 axis = std::cos(twist * (u - 0.5)) * a + std::sin(twist * (u - 0.5)) * n;
      const Vec3 middle = origin + 1.3 * radius * (2 * u - 1) * d + bend * std::sin(kPi * u) * n;
      cut.pose(middle - 1.3 * radius * axis, axis);
    }
    cut.lift();
    cut.expect_sound(1e-4);
    const auto [least, most] = cut.expected_pieces(mesh);
    EXPECT_GE(pieces(cut), least);
    EXPECT_LE(pieces(cut), most);
    const Deviation off = cut.cut_deviation();
    EXPECT_LE(off.max_h, 0.1);
    EXPECT_LE(off.mean_h, 0.01);
    if (angle_in > 6) {
      EXPECT_GE(measure(cut.mesh()).min_dihedral_deg, 5);
    }
    more += std::int64_t{cut.mesh().live_tets()} - static_cast<std::int64_t>(mesh.tets.size());
    faces += cut.totals().cut_faces;
  }
  // The coarsest have hardly a vertex that is not on a rough boundary, and may not leave it.
  if (mesh.tets.size() > 5000) {
    EXPECT_LE(2 * more, faces) << "new tetrahedra, for so many cut faces";
  }
}

INSTANTIATE_TEST_SUITE_P(Meshes, ThroughCuts,
                         ::testing::Values("seed_1720", "seed_3234", "armadillo_3717", "wound_1476",
                                           "bunny_27226", "intestine_52567"),
                         [](const auto& mesh) { return std::string(mesh.param); });

}  // namespace
}  // namespace incise::core
