// Strokes that are undone, and fields, while the server is killed and started again.

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "tests/e2e/process.hpp"
#include "tests/e2e/recovery.hpp"

namespace incise::e2e {
namespace {

// An operator's connection that cuts straight across the body, at x as a part of its width.
struct Hand {
  Hand(const ServedSession& session, const std::string& blade) {
    for (const core::Vec3& p : session.body().loaded.mesh.positions) extend(p, low, high);
    client::Options options;
    options.role = protocol::Role::Operator;
    options.view = protocol::View::None;
    options.source_name = blade;
    client::Callbacks callbacks;
    callbacks.on_error = [this](const protocol::Error& error) {
      const std::scoped_lock lock(mutex);
      refusal = error.text;
    };
    link = client::Client::connect("127.0.0.1", session.tcp_port(), options, callbacks);
  }
  void cut(double x, double from = 0, double to = 1) {
    EXPECT_TRUE(link->wait_for_report(send_cut(x, from, to), 60));
  }
  // From a part of the way to another. Lifts the blade at the end of the way. Returns the number of the message.
  std::uint64_t send_cut(double x, double from = 0, double to = 1) {
    std::vector<protocol::PoseSample> poses;
    for (int i = static_cast<int>(200 * from); i <= static_cast<int>(200 * to); ++i) {
      const double s = i / 200.0;
      poses.push_back(
          {clock_ns += 4'000'000,
           {low.x + x * (high.x - low.x), low.y + (1.2 * s - 0.1) * (high.y - low.y), high.z + 0.01},
           {1, 0, 0, 0},
           i < 200 ? 1u : 0u,
           0});
    }
    return link->send_poses(poses);
  }
  // What it says to Undo; empty: it is done.
  std::string undo(const client::Client& viewer, bool others = false) {
    const std::uint64_t epoch = viewer.welcome().session;
    link->undo(others);
    std::string said;
    EXPECT_TRUE(wait_for([&] {
      const std::scoped_lock lock(mutex);
      said = refusal;
      return !said.empty() || viewer.welcome().session != epoch;
    }));
    refusal.clear();
    return said;
  }
  core::Vec3 low{1, 1, 1}, high{-1, -1, -1};
  std::int64_t clock_ns = 1'000'000'000;
  std::mutex mutex;
  std::string refusal;
  std::unique_ptr<client::Client> link;
};

Held settled(const ServedSession& session, const client::Client& viewer) {
  EXPECT_TRUE(wait_for([&] {
    return session.stat("/backlog/batches") == 0.0 && viewer.revision() == session.stat("/revision") &&
           last_mark_and_gaps(session.capture()).first == viewer.revision();
  }));
  return held(viewer);
}

constexpr const char* kNoStroke =
    "Undo: there is no stroke to undo: only those since the server's start can be undone, as far back as it "
    "keeps states";

// Without a page: by hand, or in a script that cuts the same body again and again.
TEST(Undo, TheCommandsUndoAndResetSayWhatHappenedOrWhyNothingDid) {
  ServedSession session("undo_commands", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  const std::string server = "127.0.0.1:" + std::to_string(session.tcp_port());
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(viewer->wait_for_revision(0, 60));
  const Held uncut = held(*viewer);
  const auto cut = [&] {
    Hand hand(session, "left");
    hand.cut(0.4);
    return settled(session, *viewer);
  };
  EXPECT_GT(cut().revision, 0u);
  Process undo({"incise", "undo", server});
  EXPECT_EQ(undo.wait(), 0);
  EXPECT_EQ(
      undo.rest(),
      "administrator \"incise undo\" has undone the last stroke of blade \"left\": the body is as it was at "
      "revision 0\n");
  EXPECT_EQ(settled(session, *viewer), uncut);
  Process again({"incise", "undo", server});
  EXPECT_EQ(again.wait(), 1) << "there is no stroke to undo";
  EXPECT_EQ(again.rest(), "");

  cut();
  Process reset({"incise", "reset", server, "--json"});
  EXPECT_EQ(reset.wait(), 0);
  EXPECT_EQ(reset.rest(), R"({"event":"reset","revision":0,"by":"incise reset","role":"admin"})"
                          "\n");
  EXPECT_TRUE(wait_for([&] { return viewer->revision() == 0; }));
  EXPECT_EQ(held(*viewer), uncut);
}

// Strokes are undone one after the other, cutting goes on, and a server that is killed at once resumes what was left, under
// its epoch; also where the newest checkpoint is of what was undone.
TEST(Recovery, WhatWasUndoneStaysUndone) {
  for (const char* checkpoints :
       {R"(, "checkpoint_replay_s": 1000)", R"(, "checkpoint_replay_s": 0.000001)"}) {
    SCOPED_TRACE(checkpoints);
    ServedSession session("undo", 4000, checkpoints);
    ASSERT_TRUE(session.start(false)) << session.log();
    auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    ASSERT_TRUE(viewer->wait_for_revision(0, 60));
    std::vector<Held> before{held(*viewer)};
    {
      Hand hand(session, "blade");
      EXPECT_EQ(hand.undo(*viewer), kNoStroke);
      for (const double x : {0.3, 0.6, 0.8}) {
        hand.cut(x);
        before.push_back(settled(session, *viewer));
        ASSERT_GT(before.back().revision, before[before.size() - 2].revision);
      }
      Hand other(session, "another");
      EXPECT_EQ(other.undo(*viewer),
                "Undo: the last stroke is that of blade \"blade\", and your blade has none to undo: its "
                "operator or an "
                "admin may undo it");
      EXPECT_EQ(hand.undo(*viewer), "");
      EXPECT_EQ(settled(session, *viewer), before[2]);
      EXPECT_EQ(hand.undo(*viewer), "");
      EXPECT_EQ(settled(session, *viewer), before[1]);
    }
    session.kill();
    ASSERT_TRUE(session.start(true)) << session.log();
    EXPECT_EQ(what_the_server_has(session), before[1]) << session.log();
    // Going on from there, and back again in the server that has resumed.
    {
      viewer = client::Client::connect("127.0.0.1", session.tcp_port());
      ASSERT_TRUE(viewer->wait_for_revision(before[1].revision, 60));
      Hand hand(session, "blade");
      hand.cut(0.6);
      EXPECT_EQ(settled(session, *viewer), before[2]) << "as if it had not been undone";
      EXPECT_EQ(hand.undo(*viewer), "");
      EXPECT_EQ(settled(session, *viewer), before[1]);
      // What is left was cut before the start. The server may not have counted the last undo yet: then this one does nothing.
      EXPECT_TRUE(wait_for([&] {
        hand.link->undo();
        const std::scoped_lock lock(hand.mutex);
        return hand.refusal == kNoStroke;
      }));
      EXPECT_EQ(settled(session, *viewer), before[1]);
    }
    session.kill();
    ASSERT_TRUE(session.start(true)) << session.log();
    EXPECT_EQ(what_the_server_has(session), before[1]) << session.log();
  }
}

// Two hands at once: neither takes back what the other has done since, neither waits for the other, and everybody is told who undid what.
TEST(Recovery, OneHandDoesNotUndoWhatTheOtherHasCutSince) {
  ServedSession session("undo_two", 4000, "");
  session.set_cut(R"(, "gap_limit_s": 3600)");  // no hand is too slow here
  ASSERT_TRUE(session.start(false)) << session.log();
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(viewer->wait_for_revision(0, 60));
  EXPECT_FALSE(viewer->welcome().restart);
  const Held before = held(*viewer);
  Hand left(session, "left"), right(session, "right");
  left.cut(0.3, 0, 0.5);
  EXPECT_EQ(right.undo(*viewer),
            "Undo: blade \"left\" is in a stroke, so nothing was undone: ask again when it is lifted, or has "
            "sent no "
            "pose for 3600 s");
  right.cut(0.7);
  const Held one = settled(session, *viewer);
  left.cut(0.3, 0.5, 1);
  const Held both = settled(session, *viewer);
  ASSERT_GT(both.revision, one.revision);
  EXPECT_EQ(
      right.undo(*viewer),
      "Undo: blade \"left\" has cut since your last stroke began, and that would be undone, too: ask for "
      "both with Undo.others (on the page: Shift and a click on Undo), or leave it");
  EXPECT_EQ(settled(session, *viewer), both);
  EXPECT_EQ(left.undo(*viewer).rfind("Undo: blade \"right\" has cut since your last stroke began, ", 0), 0u);
  for (const char* blade : {"/blades/0", "/blades/1"}) {
    EXPECT_GT(session.stat(std::string(blade) + "/cut_faces"), 10.0) << blade;
    EXPECT_GT(session.stat(std::string(blade) + "/poses"), 150.0) << blade;
    EXPECT_EQ(session.stat(std::string(blade) + "/strokes"), 1.0) << blade;
  }
  EXPECT_GE(session.stat("/pieces"), 2.0);

  EXPECT_EQ(right.undo(*viewer, true), "");
  const Held left_half = settled(session, *viewer);
  EXPECT_LT(left_half.revision, both.revision);
  EXPECT_EQ(viewer->welcome().restart,
            (protocol::Restart{
                protocol::RestartKind::Undo, protocol::Role::Operator, "right", 1, "right", {"left"}}));
  EXPECT_TRUE(wait_for([&] { return left.link->welcome().restart.has_value(); })) << "the other hand, too";
  EXPECT_EQ(left.undo(*viewer), "");
  EXPECT_EQ(settled(session, *viewer), before);
  right.cut(0.5);
  settled(session, *viewer);
  // The capture knows who they were.
  Process info({"incise", "info", session.capture()});
  const std::string said = info.rest();
  EXPECT_NE(said.find("\"right\": poses "), std::string::npos) << said;
  {
    client::Options options;
    options.role = protocol::Role::Admin;
    options.view = protocol::View::None;
    options.client_name = "ward 3";
    const auto admin = client::Client::connect("127.0.0.1", session.tcp_port(), options);
    EXPECT_EQ(admin->welcome().restart, viewer->welcome().restart) << "who joins later may ask, too";
    admin->reset();
    EXPECT_TRUE(wait_for([&] {
      return viewer->welcome().restart ==
             protocol::Restart{protocol::RestartKind::Reset, protocol::Role::Admin, "ward 3", 0, ""};
    }));
    EXPECT_TRUE(wait_for([&] { return right.link->welcome().restart == viewer->welcome().restart; }));
    EXPECT_GT(right.link->report().accepted, 150u) << "what became of its poses is still known";
  }
  for (const char* line : {"blade \"left\" is held by \"incise", "blade \"right\" is held by \"incise",
                           "an undo is asked for by \"incise", ", blade \"right\""})
    EXPECT_NE(session.log().find(line), std::string::npos) << line << '\n' << session.log();
  right.link.reset();
  EXPECT_TRUE(wait_for([&] { return session.log().find("blade \"right\" is free: ") != std::string::npos; }));
}

// Whichever of two hands began last, each can undo; everybody is told whose cuts went along, and no figure counts them any longer. A hand that is silent within
// its stroke is not in the way.
TEST(Recovery, EachOfTwoHandsCanUndoItsOwnLastStroke) {
  ServedSession session("undo_each", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(viewer->wait_for_revision(0, 60));
  const Held before = held(*viewer);
  Hand left(session, "left"), right(session, "right");
  left.cut(0.3);
  right.cut(0.7);
  settled(session, *viewer);
  EXPECT_GT(session.stat("/blades/1/cut_faces"), 10.0);
  EXPECT_EQ(left.undo(*viewer, true), "");
  EXPECT_EQ(settled(session, *viewer), before);
  EXPECT_EQ(viewer->welcome().restart,
            (protocol::Restart{
                protocol::RestartKind::Undo, protocol::Role::Operator, "left", 0, "left", {"right"}}));
  for (const char* blade : {"/blades/0", "/blades/1"}) {
    EXPECT_TRUE(wait_for([&] { return session.stat(std::string(blade) + "/cut_faces") == 0.0; })) << blade;
    EXPECT_EQ(session.stat(std::string(blade) + "/strokes"), 0.0) << blade;
  }

  left.cut(0.3, 0, 0.5);
  const Held left_half = settled(session, *viewer);
  right.cut(0.7);
  settled(session, *viewer);
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_EQ(right.undo(*viewer), "")
      << "the other one has been silent for longer than the gap between strokes";
  EXPECT_GE(settled(session, *viewer).revision, left_half.revision);

  client::Options options;
  options.role = protocol::Role::Admin;
  options.view = protocol::View::None;
  client::Client::connect("127.0.0.1", session.tcp_port(), options)->reset();
  EXPECT_TRUE(wait_for([&] { return viewer->revision() == 0; }));
  EXPECT_EQ(
      left.undo(*viewer),
      "Undo: there is no stroke to undo: the mesh was reset, and what was cut before that is gone for good");
}

// The server has not cut the stroke yet when it is asked, and has to know of it all the same: it said that there was none.
TEST(Recovery, AnUndoRightBehindAStrokeIsOfThatStroke) {
  ServedSession session("undo_at_once", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(viewer->wait_for_revision(0, 60));
  const Held before = held(*viewer);
  Hand hand(session, "blade");
  for (const double x : {0.3, 0.6}) {
    hand.send_cut(x);
    EXPECT_EQ(hand.undo(*viewer), "");
    EXPECT_EQ(settled(session, *viewer), before);
  }
}

// By name and kind, at the revision of a viewer.
using FieldsHeld = std::vector<std::pair<protocol::FieldFacts, decltype(protocol::Field::values)>>;

FieldsHeld fields_of(const client::Client& viewer) {
  return viewer.read_fields([](const protocol::FieldReplica& fields) {
    FieldsHeld out;
    for (const protocol::Field& field : fields.all()) out.emplace_back(field.facts, field.values);
    return out;
  });
}

// What somebody who joins now gets.
FieldsHeld fields_for_a_newcomer(const ServedSession& session) {
  client::Options options;
  options.fields = {"*"};
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port(), options);
  EXPECT_TRUE(viewer->wait_for_revision(0, 60));
  return fields_of(*viewer);
}

// A field that was the rest position still is; one that was random is as random as it was: no new extremes; regions follow.
void expect_sound(const ServedSession& session, const FieldsHeld& fields) {
  ASSERT_EQ(fields.size(), 6u);
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(viewer->wait_for_revision(0, 60));
  viewer->read([&](const protocol::Replica& mesh) {
    const auto& rest = std::get<0>(fields[0].second);
    const auto& label = std::get<1>(fields[1].second);
    const auto& region = std::get<1>(fields[3].second);
    ASSERT_EQ(rest.size(), mesh.positions().size());
    std::vector<bool> used(mesh.vertex_count(), false);
    mesh.for_each_tet([&](std::uint32_t t) {
      EXPECT_EQ(region.at(t), mesh.region(t) + 10);
      for (const std::uint32_t v : mesh.vertices(t)) used[v] = true;
    });
    for (std::uint32_t v = 0; v < mesh.vertex_count(); ++v) {
      EXPECT_EQ(label[v] % 7, 3) << "none but those that were there";
      for (std::size_t k = 0; used[v] && k < 3; ++k)
        ASSERT_NEAR(rest[3 * v + k], mesh.rest_positions()[3 * v + k], 1e-6) << "vertex " << v;
    }
  });
}

// Fields of the body's file come to viewers and newcomers alike, to the bit: while it is cut, after an undo, after kill -9 and
// a resume, and after a reset, as loaded.
TEST(Recovery, FieldsGoWithTheMaterialThroughUndoAndResume) {
  for (const char* checkpoints :
       {R"(, "checkpoint_replay_s": 1000)", R"(, "checkpoint_replay_s": 0.000001)"}) {
    SCOPED_TRACE(checkpoints);
    ServedSession session("fields", 4000, checkpoints);
    const core::MeshData& mesh = session.body().loaded.mesh;
    std::vector<float> rest, noise;
    std::vector<std::int32_t> label, region;
    for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
      const core::Vec3& p = mesh.positions[v];
      rest.insert(rest.end(), {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
      noise.push_back(static_cast<float>((v * 2654435761u) % 1000));
      label.push_back(static_cast<std::int32_t>(7 * v + 3));
    }
    for (std::size_t t = 0; t < mesh.tets.size(); ++t)
      region.push_back(mesh.regions.empty() ? 10 : mesh.regions[t] + 10);
    using On = core::Field::On;
    mesh_io::write_mesh(session.file("body.vtu"), mesh,
                        std::vector<core::Field>{{"rest", On::kVertices, 3, rest},
                                                 {"label", On::kVertices, 1, label},
                                                 {"noise", On::kVertices, 1, noise},
                                                 {"tissue", On::kTets, 1, region}});
    session.use_body("body.vtu");
    ASSERT_TRUE(session.start(false)) << session.log();
    client::Options options;
    options.fields = {"*"};
    options.reconnect = true;
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port(), options);
    ASSERT_TRUE(viewer->wait_for_revision(0, 60));
    const std::uint64_t epoch = viewer->welcome().session;
    const FieldsHeld loaded = fields_of(*viewer);
    ASSERT_EQ(loaded.size(), 6u);
    EXPECT_EQ(std::get<0>(loaded[0].second), rest);
    EXPECT_EQ(std::get<1>(loaded[3].second), region);
    FieldsHeld once;
    {
      const std::string path =
          std::string("PYTHONPATH=") + INCISE_SOURCE_DIR + "/client/python:" + INCISE_PYTHON_DIR;
      const std::string script = std::string(INCISE_SOURCE_DIR) + "/tests/e2e/python_fields.py";
      Process python({"/usr/bin/env", path, "/usr/bin/python3", script, std::to_string(session.tcp_port())});
      ASSERT_EQ(python.line("joined"), "joined");
      Hand hand(session, "blade");
      hand.cut(0.3);
      settled(session, *viewer);
      once = fields_of(*viewer);
      EXPECT_NE(once, loaded);
      hand.cut(0.6);
      settled(session, *viewer);
      EXPECT_EQ(fields_for_a_newcomer(session), fields_of(*viewer)) << "carried by deltas, or by the server";
      expect_sound(session, fields_of(*viewer));
      EXPECT_EQ(python.line("ok"), "ok");
      EXPECT_EQ(python.line("set"), "set");
      EXPECT_TRUE(wait_for([&] { return fields_of(*viewer)[4].second != once[4].second; }));
      EXPECT_EQ(fields_for_a_newcomer(session), fields_of(*viewer)) << "as a client has set it";
      EXPECT_EQ(hand.undo(*viewer), "");
      settled(session, *viewer);
      EXPECT_EQ(fields_of(*viewer), once);
      hand.cut(0.8);
      settled(session, *viewer);
    }
    const FieldsHeld last = fields_of(*viewer);
    EXPECT_EQ(fields_for_a_newcomer(session), last);
    session.kill();
    ASSERT_TRUE(session.start(true)) << session.log();
    EXPECT_EQ(fields_for_a_newcomer(session), last) << session.log();
    ASSERT_TRUE(wait_for([&] { return viewer->status() == client::Status::kConnected; }));
    EXPECT_NE(viewer->welcome().session, epoch);
    EXPECT_EQ(fields_of(*viewer), last);
    {
      Hand hand(session, "blade");
      hand.cut(0.5);
      settled(session, *viewer);
      EXPECT_EQ(fields_for_a_newcomer(session), fields_of(*viewer));
      expect_sound(session, fields_of(*viewer));
    }
    options.role = protocol::Role::Admin;
    options.view = protocol::View::None;
    EXPECT_TRUE(client::Client::connect("127.0.0.1", session.tcp_port(), options)->reset());
    EXPECT_TRUE(wait_for([&] { return viewer->revision() == 0; }));
    EXPECT_EQ(fields_of(*viewer), loaded);
  }
}

}  // namespace
}  // namespace incise::e2e
