// Fields of the body, as viewers get them.

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "tests/stream/mini_loop.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::FieldOn;
using protocol::Role;
using protocol::SnapshotCause;
using protocol::View;

protocol::Hello asking(std::vector<std::string> fields) {
  protocol::Hello h = hello(Role::Viewer, View::Volume);
  h.fields = std::move(fields);
  return h;
}

using Values = std::vector<decltype(protocol::Field::values)>;
Values values(const protocol::FieldReplica& fields) {
  Values out;
  for (const protocol::Field& field : fields.all()) out.push_back(field.values);
  return out;
}

// Takes messages until `done`; false at the end of the stream.
template <class Done>
bool take_until(Viewer& viewer, const Done& done) {
  while (!done()) {
    auto received = viewer.peer.receive();
    if (!received || !viewer.take(received->message.body)) return false;
  }
  return true;
}

TEST(StreamFields, WhoJoinsEarlyAndWhoJoinsLateHoldTheSame) {
  TestServer s;
  const core::MeshData mesh = box_mesh(6);
  Viewer early(s.server.tcp_port(), asking({"*"}));
  ASSERT_TRUE(early.follow(0));
  ASSERT_EQ(early.welcome.fields.size(), 3u);
  EXPECT_EQ(early.welcome.fields[0], (protocol::FieldFacts{"rest", FieldOn::Vertices, 3, false}));
  EXPECT_EQ(early.welcome.fields[2], (protocol::FieldFacts{"cell", FieldOn::Tets, 1, true}));
  const std::vector<core::Field> loaded = fields_of(mesh);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(early.fields.all()[i].values, loaded[i].values);
  s.cut(3);
  ASSERT_TRUE(early.follow(s.loop.revision()));
  EXPECT_GT(early.deltas, 3u);
  Viewer late(s.server.tcp_port(), asking({"label", "rest", "cell"}));
  ASSERT_TRUE(late.follow(s.loop.revision()));
  EXPECT_EQ(late.deltas, 0u);
  EXPECT_EQ(values(late.fields), values(early.fields));
  EXPECT_NE(values(late.fields), (Values{loaded[0].values, loaded[1].values, loaded[2].values}));
  const auto& rest = std::get<0>(late.fields.find("rest", FieldOn::Vertices)->values);
  for (std::uint32_t v = 0; v < late.replica.vertex_count(); ++v) {
    for (std::size_t k = 0; k < 3; ++k)
      ASSERT_NEAR(rest[3 * v + k], late.replica.positions()[3 * v + k], 1e-7) << "vertex " << v;
  }
}

TEST(StreamFields, OnlyThoseThatWereAskedForAreSent) {
  TestServer s;
  s.cut();
  Viewer none(s.server.tcp_port());
  ASSERT_TRUE(none.follow(s.loop.revision()));
  EXPECT_EQ(none.field_messages, 0u);
  EXPECT_EQ(none.welcome.fields.size(), 3u);
  Viewer one(s.server.tcp_port(), asking({"cell"}));
  ASSERT_TRUE(one.follow(s.loop.revision()));
  ASSERT_EQ(one.fields.all().size(), 1u);
  EXPECT_EQ(one.fields.all()[0].facts.name, "cell");
  EXPECT_TRUE(one.errors.empty());

  // Another choice brings a snapshot; the same one again brings none.
  protocol::Subscribe more{View::Volume, 0, std::nullopt, {"cell", "label"}};
  one.whole = false;
  ASSERT_TRUE(one.peer.send(more, 2));
  ASSERT_TRUE(take_until(one, [&] { return one.whole; }));
  EXPECT_EQ(one.causes, (std::vector<SnapshotCause>{SnapshotCause::Join, SnapshotCause::Subscribe}));
  EXPECT_EQ(one.fields.all().size(), 2u);
  more.fields = {"label", "cell", "cell"};
  ASSERT_TRUE(one.peer.send(more, 3));
  s.cut();
  ASSERT_TRUE(one.follow(s.loop.revision()));
  EXPECT_EQ(one.causes.size(), 2u);
  EXPECT_EQ(one.fields.all().size(), 2u);
}

TEST(StreamFields, WhatCannotBeHadIsSaidAndTheRestComes) {
  TestServer s;
  Viewer wrong(s.server.tcp_port(), asking({"pressure", "label"}));
  ASSERT_TRUE(wrong.follow(0));
  ASSERT_TRUE(take_until(wrong, [&] { return !wrong.errors.empty(); }));
  EXPECT_EQ(wrong.errors[0],
            "fields: the body has none called \"pressure\"; it has \"rest\", \"label\", \"cell\"");
  ASSERT_EQ(wrong.fields.all().size(), 1u);

  protocol::Hello boxed = asking({"*"});
  boxed.box = protocol::Box{{0, 0, 0}, {0.02, 0.02, 0.02}};
  RawPeer part(s.server.tcp_port());
  ASSERT_TRUE(part.send(boxed));
  auto error = part.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).text,
            "fields: they come with the view Volume, and without a box");
  auto end = part.receive_until<protocol::SnapshotEnd>();
  EXPECT_TRUE(end);
}

// Who comes back within the ring goes on with the fields that it carried; with another choice it gets a snapshot.
TEST(StreamFields, AResumeGoesOnWithTheSameChoiceOnly) {
  TestServer s;
  s.cut();
  Viewer first(s.server.tcp_port(), asking({"rest"}));
  ASSERT_TRUE(first.follow(s.loop.revision()));
  const std::uint64_t held = s.loop.revision();
  first.peer.vanish();
  s.cut();
  protocol::Hello back = asking({"rest"});
  back.resume_session = first.welcome.session;
  back.resume_revision = held;
  Viewer again(s.server.tcp_port(), back);
  again.replica = first.replica;
  again.fields = first.fields;
  again.whole = true;
  ASSERT_TRUE(again.follow(s.loop.revision()));
  const auto carried = again.fields.all()[0].values;
  ASSERT_TRUE(take_until(again, [&] { return again.fields_set == 1; }))
      << "somebody may have set it meanwhile";
  EXPECT_EQ(again.fields.all()[0].values, carried);
  EXPECT_TRUE(again.welcome.resumed);
  back.fields = {"rest", "cell"};
  Viewer other(s.server.tcp_port(), back);
  ASSERT_TRUE(other.follow(s.loop.revision()));
  EXPECT_FALSE(other.welcome.resumed);
  EXPECT_EQ(other.fields.all()[0].values, again.fields.all()[0].values);
}

// A simulator sets a field, before and after cuts: everybody who wants it gets it, and it follows the material from there.
TEST(StreamFields, WhatASimulatorSetsComesToAllAndIsCarried) {
  TestServer s;
  Viewer viewer(s.server.tcp_port(), asking({"*"})), labels(s.server.tcp_port(), asking({"label"}));
  ASSERT_TRUE(viewer.follow(0));
  ASSERT_TRUE(labels.follow(0));
  protocol::Hello h = hello(Role::Simulator, View::None);
  RawPeer simulator(s.server.tcp_port());
  ASSERT_TRUE(simulator.send(h));
  ASSERT_TRUE(simulator.receive_until<protocol::Welcome>());
  const auto set = [&](const std::vector<float>& rest, std::uint32_t first, std::uint64_t revision) {
    protocol::FieldValues values{0, first, rest, {}, revision, false};
    ASSERT_TRUE(simulator.send(values, 2));
  };
  const std::uint32_t n = viewer.replica.vertex_count();
  std::vector<float> twice = std::get<0>(viewer.fields.all()[0].values);
  for (float& x : twice) x *= 2;
  set(twice, 0, 0);
  ASSERT_TRUE(take_until(viewer, [&] { return viewer.fields_set == 1; }));
  EXPECT_EQ(std::get<0>(viewer.fields.all()[0].values), twice);
  s.cut();
  ASSERT_TRUE(viewer.follow(s.loop.revision()));
  // Of the uncut state, come late: vertices that the cut has made or given other material keep what they carry.
  std::vector<float> thrice = twice;
  for (float& x : thrice) x *= 1.5f;
  const std::vector<float> before = std::get<0>(viewer.fields.all()[0].values);
  set(thrice, 0, 0);
  ASSERT_TRUE(take_until(viewer, [&] { return viewer.fields_set == 2; }));
  const std::vector<float>& now = std::get<0>(viewer.fields.all()[0].values);
  ASSERT_GT(viewer.replica.vertex_count(), n);
  std::size_t kept = 0;
  for (std::size_t v = 0; v < viewer.replica.vertex_count(); ++v) {
    const bool set_now = v < n && now[3 * v] == thrice[3 * v] && now[3 * v + 2] == thrice[3 * v + 2];
    if (!set_now) {
      EXPECT_EQ(now[3 * v + 1], before[3 * v + 1]) << "vertex " << v;
      ++kept;
    }
  }
  EXPECT_GE(kept, viewer.replica.vertex_count() - n);
  EXPECT_LT(kept, n);
  set({7, 8, 9}, 5, s.loop.revision());  // one row
  ASSERT_TRUE(take_until(viewer, [&] { return viewer.fields_set == 3; }));
  EXPECT_EQ(std::get<0>(viewer.fields.all()[0].values)[16], 8);
  s.cut();
  ASSERT_TRUE(viewer.follow(s.loop.revision()));
  Viewer late(s.server.tcp_port(), asking({"*"}));
  ASSERT_TRUE(late.follow(s.loop.revision()));
  EXPECT_EQ(values(late.fields), values(viewer.fields));
  ASSERT_TRUE(labels.follow(s.loop.revision()));
  EXPECT_EQ(labels.fields_set, 0u) << "did not ask for it";
}

TEST(StreamFields, ValuesThatDoNotFitAreRefusedAndNothingElseHappens) {
  TestServer s;
  RawPeer simulator(s.server.tcp_port());
  ASSERT_TRUE(simulator.send(hello(Role::Simulator, View::None)));
  const auto answer = [](RawPeer& peer, const protocol::FieldValues& values) {
    EXPECT_TRUE(peer.send(values, 9));
    const auto error = peer.receive_until<protocol::Error>();
    return error ? std::get<protocol::Error>(error->message.body).text : "";
  };
  const std::vector<float> two{1, 2}, three{1, 2, 3};
  const std::vector<std::int32_t> one{1};
  EXPECT_EQ(answer(simulator, {3, 0, three, {}, 0, false}),
            "FieldValues: field 3; the body has 3 (Welcome.fields)");
  EXPECT_EQ(
      answer(simulator, {0, 0, two, {}, 0, false}),
      "FieldValues: 2 floats and 0 whole numbers from id 0 at revision 0; accepted for this field are 3 "
      "float(s) for each of one or more vertices below 343, at a revision up to 0");
  EXPECT_NE(answer(simulator, {1, 0, three, {}, 0, false}), "") << "floats for whole numbers";
  EXPECT_NE(answer(simulator, {1, 343, {}, one, 0, false}), "") << "beyond the last vertex";
  EXPECT_NE(answer(simulator, {1, 0xffffffff, {}, one, 0, false}), "");
  EXPECT_NE(answer(simulator, {1, 0, {}, one, 1, false}), "") << "of a revision to come";
  EXPECT_NE(answer(simulator, {1, 0, {}, {}, 0, false}), "");
  RawPeer viewer(s.server.tcp_port());
  ASSERT_TRUE(viewer.send(asking({"*"})));
  EXPECT_EQ(answer(viewer, {1, 0, {}, one, 0, false}), "FieldValues: only simulators and admins send them");
}

// A simulator that floods while the body is cut, a viewer that reads slowly, a reset: at rest all hold the same again.
TEST(StreamFields, AFloodOfValuesWhileItIsCutLeavesAllWithTheSame) {
  TestServer s;
  Viewer viewer(s.server.tcp_port(), asking({"*"}));
  ASSERT_TRUE(viewer.follow(0));
  std::atomic<bool> stop{false};
  std::thread flood([&] {
    RawPeer simulator(s.server.tcp_port());
    simulator.send(hello(Role::Simulator, View::None));
    std::vector<float> rest(3 * 343, 1);
    for (std::uint64_t sequence = 2; !stop; ++sequence) {
      for (float& x : rest) x += 0.25f;
      simulator.send(protocol::FieldValues{0, 0, rest, {}, 0, false}, sequence);
      std::this_thread::sleep_for(std::chrono::milliseconds(4));
    }
    simulator.shut_down();
  });
  for (int i = 0; i < 4; ++i) {
    s.cut();
    EXPECT_TRUE(viewer.follow(s.loop.revision()));
  }
  EXPECT_TRUE(take_until(viewer, [&] { return viewer.fields_set >= 4; }));
  stop = true;
  flood.join();
  s.cut();
  Viewer late(s.server.tcp_port(), asking({"*"}));
  ASSERT_TRUE(late.follow(s.loop.revision()));
  ASSERT_TRUE(viewer.follow(s.loop.revision()));
  // The last values may come after the last delta.
  ASSERT_TRUE(take_until(viewer, [&] { return values(viewer.fields) == values(late.fields); }));
}

// A viewer that read nothing while much was cut gets one coalesced delta, and holds the same fields as others.
TEST(StreamFields, CoalescedDeltasCarryThem) {
  StreamConfig config = test_config();
  config.outbox_bytes = 64 << 10;
  TestServer s(6, config);
  protocol::Hello slow = asking({"*"});
  slow.max_rate_hz = 2;
  Viewer rare(s.server.tcp_port(), slow);
  ASSERT_TRUE(rare.follow(0));
  s.cut(4);
  ASSERT_TRUE(rare.follow(s.loop.revision()));
  EXPECT_LT(rare.deltas, rare.steps);
  Viewer late(s.server.tcp_port(), asking({"*"}));
  ASSERT_TRUE(late.follow(s.loop.revision()));
  EXPECT_EQ(values(rare.fields), values(late.fields));
}

}  // namespace
}  // namespace incise::stream
