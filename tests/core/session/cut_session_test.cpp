#include "server/core/session/cut_session.hpp"

#include <gtest/gtest.h>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::PlainModel;
using testing::Random;

constexpr std::int64_t kMs = 1000000;
constexpr double kCell = 0.01;

MeshData body() {
  return testing::shaken_box(8, 6, 6, 1, 0.1, kCell);
}

CutConfig config(Policy policy = Policy::kConforming) {
  CutConfig c;
  c.policy = policy;
  c.blade = {{0, 0, -0.02}, {0, 0, 0.08}};
  return c;
}

Pose at(std::int64_t t_ms, double x, double y, bool engaged = true) {
  return {t_ms * kMs, {x, y, 0}, {}, engaged ? 1u : 0u};
}

// Pushes a straight engaged motion across the body at height y, in `poses` poses from `t_ms` on.
void push_stroke(CutSession& session, std::uint32_t source, std::int64_t t_ms, double y, int poses = 50) {
  for (int i = 0; i <= poses; ++i) {
    EXPECT_TRUE(accepted(session.push(source, at(t_ms + 4 * i, -0.01 + 0.1 * i / poses, y, i < poses))));
  }
}

std::vector<Delta> run_all(CutSession& session) {
  std::vector<Delta> deltas;
  WorkBudget budget = WorkBudget::unlimited();
  for (;;) {
    Delta delta;
    const auto progress = session.advance(budget, delta);
    if (progress == CutSession::Progress::kIdle) return deltas;
    EXPECT_EQ(progress, CutSession::Progress::kCommitted);
    deltas.push_back(std::move(delta));
  }
}

std::string build_error(const MeshData& mesh, const Field& field) {
  try {
    const CutSession session(mesh, config(), std::span(&field, 1));
  } catch (const MeshError& error) {
    return error.what();
  }
  return "no error";
}

TEST(CutSessionFields, ThoseOfAnotherMeshAreRefusedByName) {
  const MeshData mesh = body();
  const std::size_t points = mesh.positions.size(), tets = mesh.tets.size();
  const auto floats = [](std::size_t n) { return std::vector<float>(n, 1.0f); };
  const auto whole = [](std::size_t n) { return std::vector<std::int32_t>(n, 1); };
  EXPECT_EQ(build_error(mesh, {"a", Field::On::kVertices, 3, floats(3 * points)}), "no error");
  EXPECT_EQ(build_error(mesh, {"a", Field::On::kTets, 1, whole(tets)}), "no error");
  EXPECT_EQ(
      build_error(mesh, {"dose", Field::On::kVertices, 1, floats(5)}),
      "the vertex field 'dose' has 5 values; accepted are " + std::to_string(points) + ", 1 for each vertex");
  EXPECT_EQ(build_error(mesh, {"dose", Field::On::kVertices, 3, floats(3 * points + 1)}),
            "the vertex field 'dose' has " + std::to_string(3 * points + 1) + " values; accepted are " +
                std::to_string(3 * points) + ", 3 for each vertex");
  EXPECT_EQ(build_error(mesh, {"label", Field::On::kTets, 1, whole(tets + 1)}),
            "the tetrahedron field 'label' has " + std::to_string(tets + 1) + " values; accepted are " +
                std::to_string(tets) + ", 1 for each tetrahedron");
  for (const std::size_t components : {std::size_t{0}, kMaxFieldComponents + 1}) {
    EXPECT_EQ(build_error(mesh, {"a", Field::On::kVertices, components, floats(points * components)}),
              "the vertex field 'a' has " + std::to_string(components) + " components; accepted are 1 to 9");
  }
  EXPECT_EQ(build_error(mesh, {"", Field::On::kTets, 1, floats(tets)}),
            "the tetrahedron field '' has a name of 0 bytes; accepted are 1 to 256");
  const Field field{"dose", Field::On::kVertices, 1, floats(5)};
  EXPECT_THROW(LoadedBody(mesh, std::span(&field, 1)), MeshError);
}

class CutSessionOf : public ::testing::TestWithParam<Policy> {};

TEST_P(CutSessionOf, OneRevisionABatchAndTheDeltasSayAll) {
  CutSession session(body(), config(GetParam()));
  PlainModel model(session.mesh());
  EXPECT_EQ(session.revision(), 0u);
  push_stroke(session, 0, 0, 0.0312);
  const std::size_t batches = session.backlog_batches();
  EXPECT_GT(batches, 3u);
  EXPECT_GE(session.backlog_segments(), batches - 1);
  const auto deltas = run_all(session);
  ASSERT_EQ(deltas.size(), batches);
  EXPECT_EQ(session.backlog_batches(), 0u);
  EXPECT_EQ(session.revision(), batches);
  for (std::size_t i = 0; i < deltas.size(); ++i) {
    const Delta& delta = deltas[i];
    EXPECT_EQ(delta.revision, i + 1);
    EXPECT_EQ(delta.source, 0u);
    EXPECT_EQ(delta.stroke, 1u);
    EXPECT_EQ(delta.batch, i + 1);
    EXPECT_EQ(delta.stroke_ended, i + 1 == deltas.size());
    if (i > 0) {
      EXPECT_EQ(delta.from, deltas[i - 1].to);
      EXPECT_EQ(delta.from_t_ns, deltas[i - 1].to_t_ns);
    }
    EXPECT_LT(delta.min_dihedral_deg, 180.1);
    model.apply(delta);
    EXPECT_EQ(model.hash(), delta.state_hash);
  }
  model.expect_equals(session.mesh());
  EXPECT_EQ(validate(session.mesh(), GetParam() == Policy::kConforming), "");
  EXPECT_GT(measure(session.mesh()).cut_faces, 50u);
  EXPECT_TRUE(session.committed_batch().ends_stroke);
}

// The budget decides when work is done, never what is done.
TEST_P(CutSessionOf, TheSameWithAnyBudget) {
  std::vector<std::uint64_t> expected;
  for (std::int64_t units : {INT64_MAX, std::int64_t{1}, std::int64_t{300}, std::int64_t{2000}}) {
    CutSession session(body(), config(GetParam()));
    push_stroke(session, 0, 0, 0.0287, 37);
    std::vector<std::uint64_t> hashes;
    Delta delta;
    std::size_t spent = 0;
    std::uint32_t opened = 0, opened_at_stops = 0;
    for (bool idle = false; !idle;) {
      WorkBudget budget{units};
      CutSession::Progress progress{};
      while ((progress = session.advance(budget, delta)) == CutSession::Progress::kCommitted) {
        hashes.push_back(delta.state_hash);
        EXPECT_LE(opened, session.committed_counts().cut_faces);
        opened = 0;
      }
      EXPECT_LE(opened, session.running_counts().cut_faces);
      opened = session.running_counts().cut_faces;
      opened_at_stops += opened;
      idle = progress == CutSession::Progress::kIdle;
      spent += idle ? 0 : 1;
      ASSERT_LT(spent, 2000000u) << "no progress";
    }
    if (units == INT64_MAX) {
      expected = hashes;
    } else {
      EXPECT_GE(spent, 2u);
      EXPECT_GT(opened_at_stops, 0u);
      EXPECT_EQ(hashes, expected) << units << " units a call";
    }
  }
}

// Poses pushed in other portions, while a batch is being cut: the same mesh.
TEST_P(CutSessionOf, TheSameHoweverPushingAndCuttingInterleave) {
  Random random(7);
  std::vector<std::uint64_t> expected;
  for (int run = 0; run < 4; ++run) {
    CutSession session(body(), config(GetParam()));
    std::vector<std::uint64_t> hashes;
    Delta delta;
    for (int i = 0; i <= 120; ++i) {
      if (run % 2 == 1) session.prefetch();
      session.push(0, at(2 * i, -0.01 + 0.1 * i / 120, 0.03 + 0.002 * std::sin(0.05 * i), i < 120));
      WorkBudget budget{run == 0 ? 0 : static_cast<std::int64_t>(random.below(4000))};
      while (session.advance(budget, delta) == CutSession::Progress::kCommitted)
        hashes.push_back(delta.state_hash);
    }
    for (const Delta& d : run_all(session)) hashes.push_back(d.state_hash);
    if (run == 0) expected = hashes;
    EXPECT_EQ(hashes, expected) << "run " << run;
  }
}

TEST_P(CutSessionOf, TwoBladesAtOnce) {
  CutSession session(body(), config(GetParam()));
  PlainModel model(session.mesh());
  for (int i = 0; i <= 100; ++i) {
    session.push(0, at(4 * i, -0.01 + 0.001 * i, 0.0216, i < 100));
    session.push(5, at(4 * i + 1, 0.09 - 0.001 * i, 0.0408, i < 100));
  }
  EXPECT_FALSE(session.in_stroke(0));
  std::uint32_t of_source[kMaxSources] = {};
  for (const Delta& delta : run_all(session)) {
    ++of_source[delta.source];
    EXPECT_EQ(delta.stroke, delta.source == 0 ? 1u : 2u);
    EXPECT_EQ(delta.batch, of_source[delta.source]);
    model.apply(delta);
  }
  model.expect_equals(session.mesh());
  EXPECT_GT(of_source[0], 3u);
  EXPECT_GT(of_source[5], 3u);
  EXPECT_EQ(validate(session.mesh(), GetParam() == Policy::kConforming), "");
}

INSTANTIATE_TEST_SUITE_P(Policies, CutSessionOf, ::testing::Values(Policy::kConforming, Policy::kCroll),
                         [](const auto& param) {
                           return param.param == Policy::kCroll ? "croll" : "conforming";
                         });

TEST(CutSession, RejectsWhatIsNotAPose) {
  CutSession session(body(), config());
  EXPECT_EQ(session.push(kMaxSources, at(0, 0, 0)), PoseVerdict::kUnknownSource);
  EXPECT_EQ(session.push(0xffffffffu, at(0, 0, 0)), PoseVerdict::kUnknownSource);
  EXPECT_EQ(session.push(7, at(0, 0, 0)), PoseVerdict::kAccepted);
  session.end_stroke(kMaxSources);
  session.end_stroke(2);  // had no stroke
  EXPECT_FALSE(session.in_stroke(kMaxSources));
  EXPECT_TRUE(session.in_stroke(7));
  Delta delta;
  WorkBudget budget = WorkBudget::unlimited();
  EXPECT_EQ(session.advance(budget, delta), CutSession::Progress::kIdle);
  EXPECT_EQ(session.revision(), 0u);
}

TEST(CutSession, ABladeThatVanishesEndsItsStroke) {
  CutSession session(body(), config());
  for (int i = 0; i < 60; ++i) session.push(1, at(4 * i, -0.01 + 0.0008 * i, 0.03));
  EXPECT_TRUE(session.in_stroke(1));
  session.end_stroke(1);
  EXPECT_FALSE(session.in_stroke(1));
  const auto deltas = run_all(session);
  ASSERT_FALSE(deltas.empty());
  EXPECT_TRUE(deltas.back().stroke_ended);
  EXPECT_EQ(validate(session.mesh()), "");
}

TEST(CutSession, AnotherBladeForASource) {
  CutSession session(body(), config());
  push_stroke(session, 2, 0, 0.031);
  run_all(session);
  const std::uint32_t faces = measure(session.mesh()).cut_faces;
  session.set_blade(2, {{0, 0, 5}, {0, 0, 6}});  // far above the body
  push_stroke(session, 2, 1000, 0.021);
  for (const Delta& delta : run_all(session)) EXPECT_EQ(delta.cut_faces, 0u);
  EXPECT_EQ(measure(session.mesh()).cut_faces, faces);
  session.set_blade(2, config().blade);
  push_stroke(session, 2, 2000, 0.021);
  run_all(session);
  EXPECT_GT(measure(session.mesh()).cut_faces, faces);
}

TEST(CutSession, TheDeltaReportsTheWorstAngleAroundWhatChanged) {
  CutSession session(body(), config(Policy::kCroll));
  push_stroke(session, 0, 0, 0.0312);
  for (const Delta& delta : run_all(session)) {
    double least = 180;
    for (const TetState& tet : delta.upserted) {
      least = std::min(least, measure_to_degrees(session.mesh().worst_dihedral(tet.id)));
    }
    if (delta.stroke_ended) {
      EXPECT_LE(delta.min_dihedral_deg, least + 1e-9);
    }
    EXPECT_EQ(delta.upserted.empty() && delta.moved.empty(), delta.min_dihedral_deg == 180);
  }
}

}  // namespace
}  // namespace incise::core
