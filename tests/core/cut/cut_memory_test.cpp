#include "server/core/cut/cut_memory.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <random>

#include "server/core/session/cut_session.hpp"
#include "server/core/session/session_state.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

constexpr double kCell = 0.01;

CutConfig config() {
  CutConfig config;
  config.blade = {{0, 0, -kCell}, {0, 0, 4.5 * kCell}};
  config.always_engaged = true;
  config.speed_limit_m_s = config.gap_limit_s = 1e9;
  return config;
}

void drain(CutSession& session, Delta& delta) {
  WorkBudget budget = WorkBudget::unlimited();
  while (session.advance(budget, delta) != CutSession::Progress::kIdle) {
  }
}

// A slit along x, from outside into the body. Returns the number of its stroke.
std::uint32_t cut_at(CutSession& session, double y) {
  Delta delta;
  const std::int64_t from_ns = session.revision() == 0 ? 0 : 1'000'000'000;
  for (int i = 0; i <= 20; ++i) {
    const Pose pose{from_ns + 4'000'000 * (i + 1), {(-1.0 + 0.25 * i) * kCell, y, 0}, {}, 0};
    session.push(0, pose);
    drain(session, delta);
  }
  session.end_stroke(0);
  drain(session, delta);
  return delta.stroke;
}

MeshData box() {
  return testing::box(6, 6, 6, kCell);
}

MeshData cut_box() {
  CutSession session(box(), config());
  cut_at(session, 2.3 * kCell);
  return session.export_data();
}

TEST(CutMemory, IsEmptyWhereNoBladeHasBeen) {
  EXPECT_TRUE(CutSession(box(), config()).export_data().cut_memory.empty());
  EXPECT_FALSE(has_its_cut_memory(box()));
}

TEST(CutMemory, BelongsToThePointsAndTetrahedraItWasSavedWith) {
  const MeshData saved = cut_box();
  EXPECT_TRUE(has_its_cut_memory(saved));
  MeshData moved = saved;
  moved.positions[5].x += 1e-12;
  EXPECT_FALSE(has_its_cut_memory(moved));
  MeshData sorted = saved;
  std::swap(sorted.tets[3], sorted.tets[4]);
  EXPECT_FALSE(has_its_cut_memory(sorted));
  MeshData more = saved;
  more.positions.push_back({1, 1, 1});
  EXPECT_FALSE(has_its_cut_memory(more));
  // A session of such a body begins as one of a body whose cuts are known, and no more.
  MeshData forgotten = moved;
  forgotten.cut_memory.clear();
  EXPECT_EQ(save_session(CutSession(moved, config())), save_session(CutSession(forgotten, config())));
  EXPECT_NE(save_session(CutSession(saved, config())), save_session(CutSession(forgotten, config())));
}

TEST(CutMemory, StrokesAreNumberedOn) {
  CutSession first(box(), config());
  EXPECT_EQ(cut_at(first, 2.3 * kCell), 1u);
  EXPECT_EQ(cut_at(first, 3.3 * kCell), 2u);
  CutSession second(first.export_data(), config());
  EXPECT_EQ(cut_at(second, 1.3 * kCell), 3u);
  EXPECT_TRUE(has_its_cut_memory(second.export_data())) << "and can be saved again";
}

TEST(CutMemory, ACopyOfALoadedBodyKnowsAsMuch) {
  const MeshData saved = cut_box();
  const LoadedBody body(saved);
  EXPECT_EQ(save_session(CutSession(body, config())), save_session(CutSession(saved, config())));
  MeshData moved = saved;
  for (Vec3& p : moved.positions) p.z += 0.5;
  EXPECT_TRUE(LoadedBody(moved).cut_memory().empty());
}

// As long as nothing is cut, a session gives what it was given.
TEST(CutMemory, GoesThroughASessionThatCutsNothing) {
  const MeshData saved = cut_box();
  EXPECT_EQ(CutSession(saved, config()).export_data().cut_memory, saved.cut_memory);
}

// What blades have left goes with the tissue, and is the saved body's, wherever that is.
TEST(CutMemory, GoesWithABodyThatMoves) {
  CutSession session(cut_box(), config());
  const Vec3 by{0.02, -0.01, 0.03};
  auto positions = std::make_shared<VertexPositions>();
  positions->revision = session.revision();
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v)
    positions->positions.push_back(session.mesh().position(v) + by);
  session.deform(positions);
  Delta delta;
  drain(session, delta);
  const MeshData moved = session.export_data();
  EXPECT_TRUE(has_its_cut_memory(moved));
  const TetMesh rest(cut_box()), now(moved);
  std::uint32_t strokes = 0;
  CutWorkspace before(rest), after(now);
  ASSERT_TRUE(restore_cut_memory(cut_box().cut_memory, rest, before, strokes));
  ASSERT_TRUE(restore_cut_memory(moved.cut_memory, now, after, strokes));
  ASSERT_EQ(before.swept.quads().size(), after.swept.quads().size());
  for (std::size_t i = 0; i < before.swept.quads().size(); ++i) {
    const auto &was = before.swept.quads()[i], &is = after.swept.quads()[i];
    for (const auto& [from, to] : {std::pair{was.from, is.from}, std::pair{was.to, is.to}}) {
      EXPECT_LT(distance(from.heel + by, to.heel), 1e-9) << i;
      EXPECT_LT(distance(from.tip + by, to.tip), 1e-9) << i;
    }
  }
}

// The bytes are a file's. Whatever they are, the body can be cut.
TEST(CutMemory, DamagedBytesDoNoHarm) {
  const MeshData saved = cut_box();
  MeshData forgotten = saved;
  forgotten.cut_memory.clear();
  const std::vector<std::byte> without = save_session(CutSession(forgotten, config()));
  for (std::size_t size = 0; size < saved.cut_memory.size(); size += 1 + size / 7) {
    MeshData damaged = saved;
    damaged.cut_memory.resize(size);
    EXPECT_EQ(save_session(CutSession(damaged, config())), without) << size;
  }
  std::mt19937 random(1);
  for (int i = 0; i < 200; ++i) {
    MeshData damaged = saved;
    for (int n = 0; n < 3; ++n)
      damaged.cut_memory[16 + random() % (saved.cut_memory.size() - 16)] = static_cast<std::byte>(random());
    CutSession session(damaged, config());
    if (i % 10 == 0) cut_at(session, 3.4 * kCell);
  }
}

}  // namespace
}  // namespace incise::core
