#include "server/core/session/session_state.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <span>
#include <string>

#include "server/core/mesh/validate.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

CutConfig config(Policy policy) {
  CutConfig c;
  c.policy = policy;
  c.blade = {{0, 0, -0.02}, {0, 0, 0.08}};
  return c;
}

MeshData body() {
  MeshData mesh = testing::shaken_box(8, 6, 6, 1, 0.1, 0.01);
  mesh.regions.assign(mesh.tets.size(), 0);
  for (std::size_t t = 0; t < mesh.tets.size(); ++t)
    mesh.regions[t] = mesh.positions[mesh.tets[t][0]].z > 0.03 ? 1 : 0;
  return mesh;
}

// What happens to a session, one call after another: two blades at once, on bent paths that cross each other and their
// own cuts, one of them lifted now and then in the middle of the tissue, and going back in its cut for a while.
std::vector<std::function<void(CutSession&)>> happenings() {
  std::vector<std::function<void(CutSession&)>> calls;
  for (int i = 0; i <= 400; ++i) {
    const double s = i / 400.0;
    const auto pose = [&](std::uint32_t source, const Vec3& at, double along, bool engaged) {
      const double tilt = 0.15 * std::sin(9 * along);
      const Pose made{
          1'000'000 + 4'000'000ll * i, at, {std::cos(tilt), std::sin(tilt), 0, 0}, engaged ? 1u : 0u};
      calls.emplace_back([=](CutSession& session) { session.push(source, made); });
    };
    const auto back = [s](double from, double by) {
      return s < from ? s : s < from + by ? 2 * from - s : s - 2 * by;
    };
    const double first = back(0.5, 0.1), second = back(0.75, 0.08);
    pose(0, {-0.01 + 0.13 * first, 0.03 + 0.015 * std::sin(9 * first), 0}, first, i % 150 != 149);
    // On its way back its tip goes a little deeper.
    pose(1, {0.04 + 0.02 * std::sin(9 * second), 0.07 - 0.09 * second, second < s ? 0.0003 : 0}, second,
         true);
    if (i == 230)
      calls.emplace_back([](CutSession& session) { session.set_blade(1, {{0, 0, 0}, {0, 0, 0.03}}); });
    if (i == 310) calls.emplace_back([](CutSession& session) { session.end_stroke(0); });
  }
  calls.emplace_back([](CutSession& session) { session.end_stroke(0), session.end_stroke(1); });
  return calls;
}

void commit_all(CutSession& session, std::vector<std::uint64_t>& hashes) {
  WorkBudget budget = WorkBudget::unlimited();
  Delta delta;
  while (session.advance(budget, delta) == CutSession::Progress::kCommitted) {
    EXPECT_EQ(delta.revision, hashes.size() + 1);
    hashes.push_back(delta.state_hash);
    // Pieces and opened faces are not in the hash.
    hashes.back() ^= 0x9e3779b97f4a7c15u * delta.cut_faces;
    for (const Delta::Piece& piece : delta.pieces)
      hashes.back() ^= 0x9e3779b97f4a7c15u * piece.id + piece.tet + piece.tets;
  }
}

std::unique_ptr<CutSession> restored(const CutSession& session) {
  std::string error;
  const auto bytes = save_session(session);
  auto again = restore_session(bytes, session.config(), error);
  EXPECT_TRUE(again) << error;
  EXPECT_TRUE(!again || save_session(*again) == bytes);
  return again;
}

class SessionStateOf : public ::testing::TestWithParam<Policy> {};
INSTANTIATE_TEST_SUITE_P(, SessionStateOf, ::testing::Values(Policy::kConforming, Policy::kCroll),
                         [](const auto& p) { return p.param == Policy::kCroll ? "croll" : "conforming"; });

// A session that is saved and restored at every seventh call, even during strokes, gives the same result as one that
// never was.
TEST_P(SessionStateOf, RestoredSessionsGoOnToTheSameBits) {
  const MeshData mesh = body();
  CutSession whole(mesh, config(GetParam()));
  auto broken = std::make_unique<CutSession>(mesh, config(GetParam()));
  std::vector<std::uint64_t> wanted, hashes;
  int restores = 0, in_stroke = 0;
  const auto calls = happenings();
  for (std::size_t i = 0; i < calls.size(); ++i) {
    calls[i](whole);
    commit_all(whole, wanted);
    calls[i](*broken);
    commit_all(*broken, hashes);
    if (i % 7 != 0) continue;
    in_stroke += broken->in_stroke(0) && broken->in_stroke(1);
    broken = restored(*broken);
    ASSERT_TRUE(broken);
    ++restores;
  }
  EXPECT_EQ(hashes, wanted);
  EXPECT_GT(wanted.size(), 15u);
  EXPECT_GT(in_stroke, 80);
  EXPECT_EQ(save_session(*broken), save_session(whole));
  EXPECT_EQ(validate(broken->mesh(), GetParam() == Policy::kConforming), "");
}

// A session that is copied from what another one began with is the same, whatever has become of that one since.
TEST_P(SessionStateOf, SessionsOfALoadedBodyAreThoseOfItsMesh) {
  MeshData mesh = body();
  // Two tetrahedra that touch the body in a vertex and in an edge: vertices get copies.
  const auto n = static_cast<VertexId>(mesh.positions.size());
  for (const Vec3& p : {Vec3{-1, 0, 0}, Vec3{-1, 0.1, 0}, Vec3{-1, 0, 0.1}, Vec3{-1, 0.1, 0.1}})
    mesh.positions.push_back(p);
  mesh.tets.push_back({0, n, n + 1, n + 2});
  mesh.tets.push_back({0, 1, n + 3, n});
  for (int i = 0; i < 2; ++i) {
    const auto& t = mesh.tets.back();
    if (signed_volume(mesh.positions[t[0]], mesh.positions[t[1]], mesh.positions[t[2]],
                      mesh.positions[t[3]]) < 0)
      std::swap(mesh.tets.back()[2], mesh.tets.back()[3]);
    std::swap(mesh.tets.back(), mesh.tets[mesh.tets.size() - 2]);
  }
  mesh.regions.resize(mesh.tets.size(), 2);
  std::vector<Field> fields(1);
  fields[0] = {"x", Field::On::kVertices, 1, std::vector<float>(mesh.positions.size())};
  for (std::size_t v = 0; v < mesh.positions.size(); ++v)
    std::get<0>(fields[0].values)[v] = static_cast<float>(mesh.positions[v].x);
  const LoadedBody loaded(mesh, fields);
  ASSERT_GT(loaded.mesh().initial_vertex_copies(), 0u);
  CutSession made(mesh, config(GetParam()), fields), copied(loaded, config(GetParam()));
  const std::vector<std::byte> as_loaded = save_session(made);
  std::vector<std::uint64_t> wanted, hashes;
  for (const auto& call : happenings()) {
    call(made);
    commit_all(made, wanted);
    call(copied);
    commit_all(copied, hashes);
  }
  EXPECT_EQ(hashes, wanted);
  EXPECT_GT(wanted.size(), 15u);
  EXPECT_EQ(save_session(copied), save_session(made));
  EXPECT_EQ(copied.mesh().compute_state_hash(), copied.mesh().state_hash());
  EXPECT_EQ(save_session(CutSession(loaded, config(GetParam()))), as_loaded);
}

TEST(SessionState, WhatIsCutOffOrIsAnotherPolicysIsRefused) {
  CutSession session(body(), config(Policy::kConforming));
  std::vector<std::uint64_t> hashes;
  for (const auto& call : happenings()) {
    call(session);
    commit_all(session, hashes);
    if (hashes.size() == 9) break;
  }
  auto bytes = save_session(session);
  std::string error;
  EXPECT_TRUE(restore_session(bytes, session.config(), error)) << error;
  EXPECT_FALSE(restore_session(bytes, config(Policy::kCroll), error));
  EXPECT_EQ(error, "it is of another policy");
  for (std::size_t length = 0; length < bytes.size(); length += 997) {
    EXPECT_FALSE(restore_session(std::span(bytes).first(length), session.config(), error)) << length;
    EXPECT_FALSE(error.empty());
  }
  bytes.push_back({});
  EXPECT_FALSE(restore_session(bytes, session.config(), error));
}

// Seeds for tests/fuzz/corpus/session_state, of a mesh of a few tetrahedra: INCISE_WRITE_CORPUS names the folder.
TEST(SessionState, SmallSessionsAreRestored) {
  const char* folder = std::getenv("INCISE_WRITE_CORPUS");
  for (const Policy policy : {Policy::kConforming, Policy::kCroll}) {
    CutConfig small = config(policy);
    small.blade = {{0, 0, -1}, {0, 0, 2}};
    CutSession session(testing::shaken_box(1, 1, 1, 1, 0.1, 0.01), small);
    std::vector<std::uint64_t> hashes;
    for (int i = 0; i < 12; ++i) {
      session.push(0, {1 + 20'000'000ll * i, {-0.005 + 0.001 * i, 0.0042, 0}, {}, 1});
      commit_all(session, hashes);
      const auto again = restored(session);
      ASSERT_TRUE(again);
      if (folder != nullptr && i % 4 == 3) {
        const auto bytes = save_session(session);
        std::ofstream(
            std::string(folder) + (policy == Policy::kCroll ? "/croll_" : "/conforming_") + std::to_string(i),
            std::ios::binary)
            .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
      }
    }
  }
}

// Seeds of an older version would be refused at once, and the fuzzer would try nothing.
TEST(SessionState, TheFuzzersSeedsAreRestored) {
  int seeds = 0;
  for (const auto& seed :
       std::filesystem::directory_iterator(INCISE_SOURCE_DIR "/tests/fuzz/corpus/session_state")) {
    const std::string name = seed.path().filename().string();
    std::ifstream in(seed.path(), std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
    const Policy policy = name.starts_with("croll") ? Policy::kCroll : Policy::kConforming;
    std::string error;
    EXPECT_TRUE(restore_session(std::as_bytes(std::span(bytes)), config(policy), error))
        << name << ": " << error;
    ++seeds;
  }
  EXPECT_GE(seeds, 6);
}

// Damaged bytes are refused, or give a session that can be cut.
TEST(SessionState, WrongBytesDoNoHarm) {
  CutSession session(body(), config(Policy::kConforming));
  std::vector<std::uint64_t> hashes;
  const auto calls = happenings();
  for (std::size_t i = 0; i < 500; ++i) {
    calls[i](session);
    commit_all(session, hashes);
  }
  const auto bytes = save_session(session);
  constexpr std::uint64_t kSeed = 77;
  Random random(kSeed);
  int taken = 0;
  for (int round = 0; round < 400; ++round) {
    auto wrong = bytes;
    // Blades and cutters stand in the last bytes; half of the rounds go there.
    const auto tail = static_cast<std::uint32_t>(std::min<std::size_t>(bytes.size(), 40'000));
    const std::size_t at = round % 2 ? random.below(static_cast<std::uint32_t>(bytes.size()))
                                     : bytes.size() - 1 - random.below(tail);
    wrong[at] ^= std::byte{static_cast<unsigned char>(1 + random.below(255))};
    std::string error;
    const auto made = restore_session(wrong, session.config(), error);
    EXPECT_NE(made == nullptr, error.empty()) << "seed " << kSeed << ", round " << round;
    taken += made != nullptr;
    EXPECT_TRUE(!made || validate(made->mesh(), false).empty()) << "seed " << kSeed << ", round " << round;
  }
  EXPECT_LT(taken, 400);
}

}  // namespace
}  // namespace incise::core
