#include "protocol/fields.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "protocol/carry.hpp"
#include "tests/protocol/samples.hpp"

namespace incise::protocol {
namespace {

const std::vector<FieldFacts> kThere = {{"temperature", FieldOn::Vertices, 1, false},
                                        {"label", FieldOn::Vertices, 1, true},
                                        {"fibres", FieldOn::Tets, 3, false},
                                        {"label", FieldOn::Tets, 1, true}};

TEST(Fields, NamesChooseThoseOnVerticesAndOnTetrahedraInTheServersOrder) {
  std::vector<std::string> unknown;
  const auto named = [&](std::vector<std::string> names) {
    unknown.clear();
    return fields_named(names, kThere, unknown);
  };
  using Places = std::vector<std::uint32_t>;
  EXPECT_EQ(named({}), Places());
  EXPECT_EQ(named({"fibres", "temperature", "fibres"}), (Places{0, 2}));
  EXPECT_EQ(named({"label"}), (Places{1, 3}));
  EXPECT_EQ(named({"*"}), (Places{0, 1, 2, 3}));
  EXPECT_TRUE(unknown.empty());
  EXPECT_EQ(named({"label", "pressure"}), (Places{1, 3}));
  EXPECT_EQ(unknown, std::vector<std::string>{"pressure"});
}

// A replica of two tetrahedra, five vertices, with all fields but the last, as a snapshot brings them.
class FieldsTest : public ::testing::Test {
 protected:
  FieldsTest() {
    for (const Body& body : samples::volume_stream()) {
      if (const auto* begin = std::get_if<SnapshotBegin>(&body)) {
        EXPECT_TRUE(replica.begin(*begin));
      }
      if (const auto* chunk = std::get_if<SnapshotChunk>(&body)) {
        EXPECT_TRUE(replica.chunk(*chunk));
      }
      if (const auto* end = std::get_if<SnapshotEnd>(&body)) {
        EXPECT_TRUE(replica.end(*end));
      }
    }
  }
  SnapshotBegin begin(std::span<const std::uint32_t> places) {
    SnapshotBegin snapshot;
    snapshot.fields = places;
    return snapshot;
  }
  ApplyResult floats(std::uint32_t field, std::uint32_t first, const std::vector<float>& numbers,
                     bool last = false) {
    return fields.values({field, first, numbers, {}, replica.revision(), last}, replica);
  }
  ApplyResult whole(std::uint32_t field, std::uint32_t first, const std::vector<std::int32_t>& numbers,
                    bool last = false) {
    return fields.values({field, first, {}, numbers, replica.revision(), last}, replica);
  }
  void load() {
    ASSERT_TRUE(fields.begin(begin(kPlaces), kThere));
    ASSERT_TRUE(floats(0, 0, {0, 1, 2}));
    ASSERT_TRUE(floats(0, 3, {3, 4}));
    ASSERT_TRUE(whole(1, 0, {10, 11, 12, 13, 14}));
    ASSERT_TRUE(floats(2, 0, {1, 2, 3, 4, 5, 6}));
    ASSERT_TRUE(fields.end(replica));
  }

  static constexpr std::uint32_t kPlaces[] = {0, 1, 2};
  static constexpr float kOne[] = {1};
  static constexpr std::int32_t kWhole[] = {1};
  Replica replica;
  FieldReplica fields;
};

TEST_F(FieldsTest, ASnapshotReplacesThemOnceItIsWhole) {
  load();
  ASSERT_EQ(fields.all().size(), 3u);
  EXPECT_EQ(std::get<0>(fields.all()[0].values), (std::vector<float>{0, 1, 2, 3, 4}));
  EXPECT_EQ(fields.find("label", FieldOn::Vertices), &fields.all()[1]);
  EXPECT_EQ(fields.find("label", FieldOn::Tets), nullptr) << "was not asked for";
  EXPECT_EQ(fields.find("fibres", FieldOn::Tets)->rows(), 2u);

  const std::uint32_t one[] = {3};
  ASSERT_TRUE(fields.begin(begin(one), kThere));
  ASSERT_TRUE(whole(3, 0, {8}));
  EXPECT_EQ(fields.all().size(), 3u) << "until the end";
  ASSERT_TRUE(fields.begin(begin({}), kThere));  // it broke off
  ASSERT_TRUE(fields.end(replica));
  EXPECT_TRUE(fields.all().empty());
}

TEST_F(FieldsTest, ASnapshotThatDoesNotFitIsRefusedAndWhatIsHeldStays) {
  load();
  const std::uint32_t beyond[] = {0, 4};
  EXPECT_EQ(fields.begin(begin(beyond), kThere).error, ApplyError::BadIndex);
  const auto refused = [&](const auto& send) {
    EXPECT_TRUE(fields.begin(begin(kPlaces), kThere));
    const ApplyResult result = send();
    EXPECT_FALSE(result);
    EXPECT_FALSE(result.text.empty());
    EXPECT_EQ(fields.all().size(), 3u);
  };
  refused([&] { return floats(3, 0, {1}); });                             // not announced
  refused([&] { return floats(0, 1, {1}); });                             // does not begin at 0
  refused([&] { return whole(0, 0, {1}); });                              // of the other kind
  refused([&] { return floats(0, 0, {}); });                              // empty
  refused([&] { return floats(2, 0, {1, 2}); });                          // no whole row
  refused([&] { return fields.values({1, 0, kOne, kWhole}, replica); });  // of both
  refused([&] {
    EXPECT_TRUE(whole(1, 0, {1}));
    return floats(0, 0, {1});  // out of order
  });
  refused([&] { return fields.end(replica); });  // nothing came
  refused([&] {
    EXPECT_TRUE(floats(0, 0, {0, 1, 2, 3, 4, 5}));  // a row more than there are vertices
    return fields.end(replica);
  });
}

TEST_F(FieldsTest, NewValuesReplaceAFieldOnceTheyAreWhole) {
  load();
  const auto label = [&] { return std::get<1>(fields.all()[1].values); };
  ASSERT_TRUE(whole(1, 0, {1, 2, 3}));
  EXPECT_EQ(label()[0], 10) << "not yet";
  ASSERT_TRUE(whole(1, 3, {4, 5}, true));
  EXPECT_EQ(label(), (std::vector<std::int32_t>{1, 2, 3, 4, 5}));
  EXPECT_FALSE(whole(1, 0, {1, 2, 3}, true)) << "too few";
  EXPECT_FALSE(whole(1, 3, {9, 9}, true)) << "without their beginning";
  EXPECT_FALSE(whole(3, 0, {9, 9}, true)) << "is not held";
  EXPECT_FALSE(floats(1, 0, {1, 2, 3, 4, 5}, true)) << "of the other kind";
  EXPECT_FALSE(fields.values({0, 0, kOne, {}, 7, true}, replica)) << "of another revision";
  ASSERT_TRUE(whole(1, 0, {7, 7, 7}));
  EXPECT_FALSE(floats(0, 3, {9, 9}, true)) << "another field's beginning came last";
  EXPECT_EQ(label(), (std::vector<std::int32_t>{1, 2, 3, 4, 5}));
  EXPECT_EQ(std::get<0>(fields.all()[0].values), (std::vector<float>{0, 1, 2, 3, 4}));
}

TEST_F(FieldsTest, DeltasCarryThemAsCarryDoes) {
  load();
  const auto& all = samples::extended_messages();
  const auto found =
      std::find_if(all.begin(), all.end(), [](const auto& sample) { return sample.first == "DeltaBlends"; });
  const Delta& delta = std::get<Delta>(found->second);
  std::vector<float> temperature{0, 1, 2, 3, 4}, fibres{1, 2, 3, 4, 5, 6};
  std::vector<std::int32_t> label{10, 11, 12, 13, 14};
  carry(delta, 1, temperature);
  carry(delta, 1, label);
  carry_tets(delta, 3, fibres);
  const ApplyResult applied = fields.apply(delta);
  ASSERT_TRUE(applied) << applied.text;
  EXPECT_EQ(std::get<0>(fields.all()[0].values), temperature);
  EXPECT_EQ(std::get<1>(fields.all()[1].values), label);
  EXPECT_EQ(std::get<0>(fields.all()[2].values), fibres);
  EXPECT_EQ(fields.all()[0].rows(), delta.vertex_count);
  EXPECT_FALSE(fields.apply(delta)) << "of another state";
  EXPECT_EQ(std::get<0>(fields.all()[0].values), temperature) << "and nothing changed";
}

TEST_F(FieldsTest, WhatAWriterSendsIsWhatIsHeld) {
  load();
  FieldReplica copy;
  ASSERT_TRUE(copy.begin(begin(kPlaces), kThere));
  std::size_t messages = 0;
  for (std::uint32_t place = 0; place < 3; ++place) {
    FieldWriter writer(fields.all()[place], place, replica.revision(), 2);
    for (; writer.next(); ++messages) ASSERT_TRUE(copy.values(writer.message(), replica));
    EXPECT_TRUE(writer.message().last);
  }
  ASSERT_TRUE(copy.end(replica));
  EXPECT_EQ(messages, 3u + 3 + 1);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(copy.all()[i].values, fields.all()[i].values);
}

}  // namespace
}  // namespace incise::protocol
