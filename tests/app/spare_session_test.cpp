#include "server/app/spare_session.hpp"

#include <gtest/gtest.h>

#include <thread>

#include "server/app/stream_setup.hpp"
#include "tests/support/bodies.hpp"

namespace incise::app {
namespace {

std::unique_ptr<core::CutSession> wait_for(SpareSession& spare) {
  std::unique_ptr<core::CutSession> session;
  while (!(session = spare.take())) std::this_thread::yield();
  return session;
}

core::CutConfig config() {
  core::CutConfig made;
  made.blade = tests::long_blade();
  return made;
}

void cut_through(core::CutSession& session) {
  for (const core::Pose& pose : tests::sweep_through(200)) session.push(0, pose);
  session.end_stroke(0);
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
  }
}

// One after the other, cut and given back, and each is the mesh as loaded: made of its arrays, or copied when these are gone.
class SpareSessionOf : public ::testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(, SpareSessionOf, ::testing::Bool(),
                         [](const auto& p) { return p.param ? "built" : "arrays"; });

TEST_P(SpareSessionOf, EachIsTheMeshAsLoaded) {
  Body body;
  body.loaded.mesh = tests::cube(3);
  body.loaded.fields = {
      {"label", core::Field::On::kTets, 1, std::vector<std::int32_t>(body.loaded.mesh.tets.size(), 7)}};
  const core::CutConfig cut = config();
  const core::CutSession plain(body.loaded.mesh, cut);
  if (GetParam()) {
    body.built = std::make_shared<const core::LoadedBody>(body.loaded.mesh, body.loaded.fields);
    body.loaded.mesh = {};
  }
  SpareSession spare(body, cut);
  EXPECT_EQ(spare.take(), nullptr) << "it has not begun to build";
  spare.start();
  for (int i = 0; i < 5; ++i) {
    std::unique_ptr<core::CutSession> session = wait_for(spare);
    EXPECT_EQ(session->revision(), 0u);
    EXPECT_EQ(session->mesh().state_hash(), plain.mesh().state_hash());
    EXPECT_TRUE(session->fields().all().empty()) << "the stream carries them";
    const auto shown = spare.shown();
    EXPECT_EQ(shown->mirror->volume().state_hash(), plain.mesh().state_hash());
    ASSERT_TRUE(shown->fields);
    EXPECT_EQ(shown->fields->at(0).values, body.loaded.fields[0].values);
    cut_through(*session);
    EXPECT_GT(session->revision(), 0u);
    spare.give_back(i % 2 == 0 ? std::move(session) : nullptr);
  }
}

TEST(SpareSession, EndsWhileItBuildsAndWithoutHavingBegun) {
  Body body;
  body.loaded.mesh = tests::cube(8);
  const core::CutConfig cut = config();
  { const SpareSession never(body, cut); }
  {
    SpareSession soon(body, cut);
    soon.start();
  }
}

// What a reset shows of a mirror as loaded is that, under another epoch, whatever the mirror that shows it has been through.
TEST(SpareSession, AMirrorIsResetToTheOneAsLoaded) {
  const core::MeshData mesh = tests::cube(3);
  const core::CutConfig cut = config();
  core::CutSession session(mesh, cut);
  auto loaded = std::make_shared<stream::Mirror>();
  loaded->reset(replay::initial_state(session, 1));
  stream::InitialState as_loaded;
  as_loaded.epoch = 77;
  as_loaded.mirror = loaded;
  cut_through(session);
  stream::Mirror mirror;
  mirror.reset(replay::initial_state(session, 2));
  mirror.reset(as_loaded);
  EXPECT_EQ(mirror.epoch(), 77u);
  EXPECT_EQ(mirror.revision(), 0u);
  EXPECT_EQ(mirror.volume().canonical_bytes(), loaded->volume().canonical_bytes());
  EXPECT_EQ(mirror.surface().canonical_bytes(), loaded->surface().canonical_bytes());
}

}  // namespace
}  // namespace incise::app
