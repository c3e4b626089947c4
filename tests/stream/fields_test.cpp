// Fields of the body, as viewers get them.

#include <gtest/gtest.h>

#include <string>
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
  EXPECT_TRUE(again.welcome.resumed);
  EXPECT_EQ(again.field_messages, 0u);
  back.fields = {"rest", "cell"};
  Viewer other(s.server.tcp_port(), back);
  ASSERT_TRUE(other.follow(s.loop.revision()));
  EXPECT_FALSE(other.welcome.resumed);
  EXPECT_EQ(other.fields.all()[0].values, again.fields.all()[0].values);
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
