#include "protocol/framing.hpp"

#include <gtest/gtest.h>
#include <malloc.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <random>

#include "tests/protocol/samples.hpp"

namespace incise::protocol {
namespace {

using Bytes = std::vector<std::byte>;

Bytes copy(std::span<const std::byte> bytes) {
  return {bytes.begin(), bytes.end()};
}

// Decodes what encode() made, and hands back the body. Spans point into `frame`'s bytes or into the result.
template <class T>
T round_trip(const T& message, DecodeResult& result) {
  const Frame frame = encode(message, {7, 8});
  result = decode(frame.body());
  EXPECT_TRUE(result) << result.error;
  if (!result) return {};
  EXPECT_EQ(result.message->envelope.sequence, 7u);
  EXPECT_EQ(result.message->envelope.sent_ns, 8);
  // The body stands 4 bytes into the frame, so decode() has made an aligned copy: the spans outlive `frame`.
  EXPECT_TRUE(result.message->storage);
  return std::get<T>(result.message->body);
}

std::string error_of(const Body& body) {
  const DecodeResult result = decode(encode(body).body());
  EXPECT_FALSE(result) << name_of(body) << " was accepted";
  EXPECT_EQ(result.code, ErrorCode::BadFrame);
  return result.error;
}

// A list that has grown must have its new last one read, too.
TEST(Framing, EveryReasonCodeAndCauseComesBack) {
  DecodeResult kept;
  for (int reason = 0; reason <= static_cast<int>(ByeReason::Refused); ++reason)
    EXPECT_EQ(static_cast<int>(round_trip(Bye{static_cast<ByeReason>(reason), ""}, kept).reason), reason);
  for (int code = 0; code <= static_cast<int>(ErrorCode::NotRecorded); ++code)
    EXPECT_EQ(static_cast<int>(round_trip(Error{static_cast<ErrorCode>(code), "", false, 0}, kept).code),
              code);
  for (int cause = 0; cause <= static_cast<int>(SnapshotCause::Subscribe); ++cause) {
    SnapshotBegin begin;
    begin.cause = static_cast<SnapshotCause>(cause);
    EXPECT_EQ(static_cast<int>(round_trip(begin, kept).cause), cause);
  }
}

TEST(Framing, EveryMessageComesBackTheSame) {
  ASSERT_EQ(samples::messages().size(), std::variant_size_v<Body>);
  std::size_t index = 0;
  for (const auto& [name, body] : samples::messages()) {
    EXPECT_EQ(body.index(), index++);
    EXPECT_EQ(name, name_of(body));
    const Frame frame = encode(body, samples::envelope(index));
    const DecodeResult result = decode(frame.body());
    ASSERT_TRUE(result) << name << ": " << result.error;
    EXPECT_EQ(result.message->body.index(), body.index());
    // The encoder is deterministic, so equal bytes are equal fields.
    const Frame again = encode(result.message->body, result.message->envelope);
    EXPECT_TRUE(std::ranges::equal(frame.tcp(), again.tcp())) << name;
  }
}

TEST(Framing, WhatIsRecordedComesThrough) {
  PoseReport sent;
  sent.accepted = 7;
  sent.recorded = 5;
  sent.recorded_source_ns = -3;
  sent.recording = Recording::Stopped;
  DecodeResult result;
  const PoseReport got = round_trip(sent, result);
  EXPECT_EQ(got.accepted, 7u);
  EXPECT_EQ(got.recorded, 5u);
  EXPECT_EQ(got.recorded_source_ns, -3);
  EXPECT_EQ(got.recording, Recording::Stopped);
  Welcome hail;
  hail.recording = Recording::On;
  EXPECT_EQ(round_trip(hail, result).recording, Recording::On);
  Stats stats;
  stats.recording = static_cast<Recording>(3);
  EXPECT_NE(error_of(stats).find("Stats.recording: 3"), std::string::npos) << error_of(stats);
}

TEST(Framing, HelloKeepsItsFields) {
  const auto& sent = std::get<Hello>(samples::messages()[0].second);
  DecodeResult result;
  const Hello got = round_trip(sent, result);
  EXPECT_EQ(got.role, Role::Operator);
  EXPECT_EQ(got.view, View::Volume);
  EXPECT_EQ(got.client_name, "sample client");
  EXPECT_EQ(got.token, "not a secret");
  EXPECT_EQ(got.resume_session, 0x1122334455667788u);
  EXPECT_EQ(got.resume_revision, 1u);
  EXPECT_EQ(got.max_rate_hz, 60.0f);
  EXPECT_EQ(got.box, sent.box);
  EXPECT_EQ(got.source_name, "right hand");
  EXPECT_TRUE(got.take_over);
  EXPECT_EQ(got.blade_rate_hz, 60);
  EXPECT_EQ(got.blade, sent.blade);
  EXPECT_EQ(got.resume_hash, 0u);
  Hello back = sent;
  back.resume_hash = 0xfedcba9876543210;
  EXPECT_EQ(round_trip(back, result).resume_hash, 0xfedcba9876543210u);
}

TEST(Framing, PosesKeepTheirBitsEvenWhereTheyAreNoNumbers) {
  // A pose with a NaN is for the input to refuse, pose by pose; the message around it is fine.
  std::vector<PoseSample> poses(3);
  poses[1].position.y = std::numeric_limits<double>::quiet_NaN();
  poses[2].orientation = {0.1, 0.2, 0.3, 0.4};
  poses[2].buttons = 0x80000001;
  poses[2].source_ns = -5;
  DecodeResult result;
  const PoseBatch got = round_trip(PoseBatch{poses}, result);
  ASSERT_EQ(got.poses.size(), 3u);
  EXPECT_EQ(std::memcmp(got.poses.data(), poses.data(), poses.size() * sizeof(PoseSample)), 0);
}

TEST(Framing, DeltaKeepsItsArraysAndSteps) {
  const auto& sent = std::get<Delta>(samples::messages()[12].second);
  DecodeResult result;
  const Delta got = round_trip(sent, result);
  EXPECT_EQ(got.base_revision, 0u);
  EXPECT_EQ(got.revision, 2u);
  EXPECT_EQ(got.steps, sent.steps);
  EXPECT_TRUE(std::ranges::equal(got.moved_positions, std::vector<double>{-0.001, 0, 0}));
  EXPECT_EQ(got.first_added, 5u);
  EXPECT_TRUE(std::ranges::equal(got.provenance_b, std::vector<std::uint32_t>{1, 2, 3, 1}));
  EXPECT_TRUE(std::ranges::equal(got.tets.ids, std::vector<std::uint32_t>{0, 1, 2}));
  EXPECT_TRUE(std::ranges::equal(got.tets.regions, std::vector<std::int32_t>{7, -2, 7}));
  EXPECT_TRUE(std::ranges::equal(got.piece_names, std::vector<std::uint32_t>{1}));
  EXPECT_EQ(got.first_new_tet, 2u);
  EXPECT_EQ(got.state_hash, samples::two_tets(2).hash());
}

TEST(Framing, AlignedBytesAreDecodedInPlace) {
  const Frame frame = encode(samples::messages()[12].second);
  std::vector<std::uint64_t> aligned((frame.body().size() + 7) / 8);
  std::memcpy(aligned.data(), frame.body().data(), frame.body().size());
  const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(aligned.data()),
                                         frame.body().size());
  const DecodeResult result = decode(bytes);
  ASSERT_TRUE(result) << result.error;
  EXPECT_FALSE(result.message->storage);
  const auto& delta = std::get<Delta>(result.message->body);
  EXPECT_GE(static_cast<const void*>(delta.moved_positions.data()), static_cast<const void*>(bytes.data()));
  EXPECT_LT(static_cast<const void*>(delta.moved_positions.data()),
            static_cast<const void*>(bytes.data() + bytes.size()));
}

TEST(Framing, ALaterVersionsErrorCodeReadsAsUnknown) {
  const DecodeResult result = decode(encode(Error{static_cast<ErrorCode>(999), "new", true, 0}).body());
  ASSERT_TRUE(result) << result.error;
  EXPECT_EQ(std::get<Error>(result.message->body).code, ErrorCode::Unknown);
  EXPECT_EQ(std::get<Error>(result.message->body).text, "new");
  EXPECT_STREQ(name_of(static_cast<ErrorCode>(999)), "?");
  EXPECT_STREQ(name_of(ErrorCode::BladeTaken), "BladeTaken");
}

// ---- What is refused ----

TEST(Framing, CapsComeFirst) {
  const Frame frame = encode(Ping{1, 2});
  EXPECT_EQ(decode(frame.body(), frame.body().size()).code, ErrorCode::Unknown);
  const DecodeResult result = decode(frame.body(), frame.body().size() - 1);
  EXPECT_FALSE(result);
  EXPECT_EQ(result.code, ErrorCode::TooLong);
  EXPECT_NE(result.error.find("accepted are at most"), std::string::npos) << result.error;
  EXPECT_FALSE(decode({}));
}

TEST(Framing, AMessageOverTheCapIsNotEncoded) {
  const std::vector<double> positions(3 * ((kMaxMessageBytes / 24) + 1));
  SnapshotChunk chunk;
  chunk.positions = positions;
  EXPECT_THROW(encode(chunk), std::length_error);
}

TEST(Framing, SemanticErrorsNameTheField) {
  const std::vector<std::uint32_t> one{1}, two{1, 2}, descending{2, 1}, huge{kMaxVertices};
  const std::vector<double> three{0, 0, 0}, four{0, 0, 0, 0};
  const std::vector<double> nan{0, std::numeric_limits<double>::quiet_NaN(), 0}, far{0, 0, 1e9};
  const std::vector<double> half{0.5}, beyond{1.5};
  const std::vector<std::uint8_t> mask{1}, bad_mask{16};
  const std::vector<std::int32_t> region{0};
  Delta good;
  good.revision = 1;

  struct Case {
    const char* field;
    Body body;
  };
  std::vector<Case> cases;
  const auto delta = [&](const char* field, auto change) {
    Delta d = good;
    change(d);
    cases.push_back({field, d});
  };
  delta("Delta.revision", [&](Delta& d) { d.revision = 0; });
  delta("Delta.moved_positions", [&](Delta& d) { d.moved_ids = two, d.moved_positions = three; });
  delta("Delta.moved_positions", [&](Delta& d) { d.moved_ids = one, d.moved_positions = nan; });
  delta("Delta.moved_positions", [&](Delta& d) { d.moved_ids = one, d.moved_positions = far; });
  delta("Delta.moved_ids", [&](Delta& d) { d.moved_ids = huge, d.moved_positions = three; });
  delta("Delta.moved_ids", [&](Delta& d) { d.moved_ids = descending, d.moved_positions = three; });
  delta("Delta.added_positions", [&](Delta& d) { d.added_positions = three; });
  delta("Delta.added_positions", [&](Delta& d) {
    d.added_positions = four, d.provenance_a = one, d.provenance_b = one, d.provenance_t = half;
  });
  delta("Delta.provenance_a",
        [&](Delta& d) { d.added_positions = three, d.provenance_b = one, d.provenance_t = half; });
  delta("Delta.provenance_t", [&](Delta& d) {
    d.added_positions = three, d.provenance_a = one, d.provenance_b = one, d.provenance_t = beyond;
  });
  delta("Delta.tets.vertices", [&](Delta& d) { d.tets = {one, two, region, mask, mask}; });
  const std::vector<std::uint32_t> vertices{0, 1, 2, 3};
  delta("Delta.tets.regions", [&](Delta& d) { d.tets = {one, vertices, {}, mask, mask}; });
  delta("Delta.tets.cut_masks", [&](Delta& d) { d.tets = {one, vertices, region, {}, mask}; });
  delta("Delta.tets.boundary_masks", [&](Delta& d) { d.tets = {one, vertices, region, mask, {}}; });
  delta("Delta.tets.*_masks", [&](Delta& d) { d.tets = {one, vertices, region, bad_mask, mask}; });
  delta("Delta.removed_tets", [&](Delta& d) { d.removed_tets = descending; });
  delta("Delta.boundary_upserted", [&](Delta& d) { d.boundary_upserted = descending; });
  delta("Delta.piece_sizes", [&](Delta& d) { d.piece_ids = one; });
  delta("Delta.piece_tets", [&](Delta& d) { d.piece_ids = one, d.piece_sizes = one, d.piece_tets = two; });
  delta("Delta.piece_tets",
        [&](Delta& d) { d.piece_ids = one, d.piece_sizes = one, d.piece_tets = one, d.piece_names = one; });
  delta("Delta.piece_names", [&](Delta& d) { d.piece_ids = one, d.piece_sizes = one, d.piece_names = two; });
  delta("Delta.blend_vertices", [&](Delta& d) { d.blend_ids = one, d.blend_vertices = two; });
  delta("Delta.blend_weights", [&](Delta& d) { d.blend_ids = one, d.blend_vertices = vertices; });
  const std::vector<double> weights{0.5, 0.5, 0, std::numeric_limits<double>::infinity()};
  delta("Delta.blend_weights",
        [&](Delta& d) { d.blend_ids = one, d.blend_vertices = vertices, d.blend_weights = weights; });
  delta("Delta.round_blends", [&](Delta& d) { d.round_added = one; });
  delta("Delta.vertex_count", [&](Delta& d) { d.vertex_count = kNoId; });
  delta("Delta.steps.revision", [&](Delta& d) { d.steps.resize(1), d.steps[0].revision = 2; });
  delta("Delta.steps.revision", [&](Delta& d) { d.steps.resize(2); });
  delta("Delta.steps", [&](Delta& d) { d.steps.resize(kMaxStepsPerDelta + 1); });
  delta("Delta.steps.cut_area_m2", [&](Delta& d) {
    d.steps.resize(1), d.steps[0].revision = 1;
    d.steps[0].cut_area_m2 = std::numeric_limits<double>::infinity();
  });

  SurfaceDelta surface;
  surface.revision = 1;
  const std::vector<float> flat{0, 0, 0, 0};
  surface.vertices = {one, flat};
  cases.push_back({"SurfaceDelta.vertices.positions", surface});
  surface.vertices = {};
  surface.triangles = {one, two, mask, one, region};
  cases.push_back({"SurfaceDelta.triangles.vertices", surface});
  const std::vector<std::uint32_t> triangle{0, 1, 2};
  surface.triangles = {one, triangle, {}, one, region};
  cases.push_back({"SurfaceDelta.triangles.flags", surface});
  surface.triangles = {one, triangle, mask, {}, region};
  cases.push_back({"SurfaceDelta.triangles.pieces", surface});

  Hello hello;
  hello.role = static_cast<Role>(4);
  cases.push_back({"Hello.role", hello});
  hello = {};
  hello.view = static_cast<View>(3);
  cases.push_back({"Hello.view", hello});
  hello = {};
  hello.client_name.assign(kMaxNameBytes + 1, 'x');
  cases.push_back({"Hello.client_name", hello});
  hello = {};
  hello.token.assign(kMaxTokenBytes + 1, 'x');
  cases.push_back({"Hello.token", hello});
  hello = {};
  hello.max_rate_hz = -1;
  cases.push_back({"Hello.max_rate_hz", hello});
  hello.max_rate_hz = std::numeric_limits<float>::quiet_NaN();
  cases.push_back({"Hello.max_rate_hz", hello});
  hello = {};
  hello.box = Box{{1, 0, 0}, {0, 1, 1}};
  cases.push_back({"Hello.box", hello});
  hello = {};
  hello.blade = BladeEdge{{0, 0, 0.1}, {0, 0, 0.1}};
  cases.push_back({"Hello.blade", hello});
  hello.blade = BladeEdge{{0, 0, 0.1}, {0, 0, 1.5e4}};
  cases.push_back({"Hello.blade", hello});
  Welcome welcome;
  welcome.engage_button = 32;
  cases.push_back({"Welcome.engage_button", welcome});
  welcome = {};
  welcome.frame_rate_hz = std::numeric_limits<double>::infinity();
  cases.push_back({"Welcome.frame_rate_hz", welcome});
  welcome = {};
  welcome.mesh.name.assign(kMaxNameBytes + 1, 'x');
  cases.push_back({"Welcome.mesh.name", welcome});
  const std::vector<PoseSample> many(kMaxPosesPerBatch + 1);
  cases.push_back({"PoseBatch.poses", PoseBatch{many}});
  cases.push_back({"StrokeControl.action", StrokeControl{static_cast<StrokeAction>(3), 0}});
  Force force;
  force.force_n.x = std::numeric_limits<double>::quiet_NaN();
  cases.push_back({"Force.force_n", force});
  force = {};
  force.contact = LocalContact{};
  force.contact->stiffness_n_per_m = std::numeric_limits<double>::infinity();
  cases.push_back({"Force.contact.stiffness_n_per_m", force});
  force = {};
  force.torque_n_m = Vec3{std::numeric_limits<double>::quiet_NaN(), 0, 0};
  cases.push_back({"Force.torque_n_m", force});
  BladePose pose;
  pose.force_n = Vec3{0, std::numeric_limits<double>::infinity(), 0};
  cases.push_back({"BladePose.force_n", pose});
  BladeLoad load;
  load.contact = static_cast<BladeContact>(3);
  cases.push_back({"BladeLoad.contact", load});
  load = {};
  load.ids = one;
  cases.push_back({"BladeLoad.forces", load});
  SnapshotBegin begin;
  begin.piece_ids = one;
  cases.push_back({"SnapshotBegin.piece_names", begin});
  cases.push_back(
      {"SnapshotBegin.view", SnapshotBegin{View::None, 0, SnapshotCause::Join, 0, 0, 0, 0, {}, {}, {}, {}}});
  cases.push_back(
      {"SnapshotBegin.chunks",
       SnapshotBegin{View::Volume, 0, SnapshotCause::Join, kMaxSnapshotChunks + 1, 0, 0, 0, {}, {}, {}, {}}});
  cases.push_back({"SnapshotBegin.tet_count",
                   SnapshotBegin{View::Volume, 0, SnapshotCause::Join, 1, 0, kNoId, 0, {}, {}, {}, {}}});
  SnapshotChunk chunk;
  chunk.positions = four;
  cases.push_back({"SnapshotChunk.positions", chunk});
  chunk = {};
  chunk.tets = {one, vertices, region, mask, mask};
  chunk.tet_pieces = two;
  cases.push_back({"SnapshotChunk.tet_pieces", chunk});
  Positions positions;
  positions.ids = one;
  cases.push_back({"Positions.ids", positions});
  positions.f64 = four;
  cases.push_back({"Positions.f64", positions});
  positions.f64 = three;
  positions.f32 = std::span(flat).first(3);
  cases.push_back({"Positions.f64", positions});
  Stats stats;
  stats.json.assign(kMaxStatsJsonBytes + 1, ' ');
  cases.push_back({"Stats.json", stats});
  cases.push_back({"ReplayControl.speed", ReplayControl{ReplayAction::Play, "", 0, 0}});
  cases.push_back({"ReplayControl.action", ReplayControl{static_cast<ReplayAction>(6), "", 1, 0}});
  cases.push_back({"Error.text", Error{ErrorCode::Internal, std::string(kMaxTextBytes + 1, 'x'), false, 0}});

  for (const Case& c : cases) {
    const std::string error = error_of(c.body);
    EXPECT_TRUE(error.starts_with(std::string(c.field) + ": "))
        << "expected " << c.field << ", got: " << error;
    EXPECT_EQ(error.find('\n'), std::string::npos);
  }
}

// Found by fuzzing: FlatBuffers' verifier takes a vector whose elements are not aligned for their type.
TEST(Framing, ABoxMayBeFlatAndNotInsideOut) {
  for (double Vec3::*axis : {&Vec3::x, &Vec3::y, &Vec3::z}) {
    Hello hello;
    hello.box = Box{{1, 1, 1}, {2, 2, 2}};
    hello.box->max.*axis = 1;
    EXPECT_TRUE(decode(encode(hello).body()));
    hello.box->max.*axis = 0.5;
    EXPECT_NE(error_of(hello).find("Hello.box: min above max"), std::string::npos);
  }
}

TEST(Framing, ATimelineHasAnEntryOfEachKindForEveryRevisionInOrder) {
  ReplayState state;
  state.capture = "a.capture";
  state.revision_ms = {20, 40, 40};
  state.revision_sources = {0, 1, 0};
  state.revision_strokes = {1, 1, 0};
  DecodeResult result;
  const ReplayState got = round_trip(state, result);
  EXPECT_EQ(got.revision_ms, state.revision_ms);
  EXPECT_EQ(got.revision_sources, state.revision_sources);
  EXPECT_EQ(got.revision_strokes, state.revision_strokes);
  state.revision_ms = {20, 40, 39};
  EXPECT_NE(error_of(state).find("ReplayState.revision_ms"), std::string::npos) << error_of(state);
  state.revision_ms = {20, 40};
  EXPECT_NE(error_of(state).find("ReplayState.revision_sources"), std::string::npos) << error_of(state);
  state.revision_ms = {20, 40, 41};
  state.revision_strokes = {};
  EXPECT_NE(error_of(state).find("ReplayState.revision_strokes"), std::string::npos) << error_of(state);
}

TEST(Framing, StatisticsAreNumbers) {
  for (auto Stats::*field : {&Stats::frame_work_p99_us, &Stats::pose_to_delta_p99_us}) {
    Stats stats;
    stats.*field = std::numeric_limits<float>::quiet_NaN();
    EXPECT_NE(error_of(stats).find("accepted are finite numbers"), std::string::npos);
  }
}

TEST(Framing, ElementsThatAreNotAlignedAreRefused) {
  // Doubles whose low half reads as 3: an offset that is 4 too large finds an array of 3 elements there.
  const std::vector<double> numbers(6, std::bit_cast<double>(0x3ff0000000000003u));
  Positions positions;
  positions.f64 = numbers;
  const Bytes good = copy(encode(positions).body());
  std::size_t misaligned = 0;
  for (std::size_t at = 0; at + 4 <= good.size(); at += 4) {
    Bytes bytes = good;
    std::uint32_t word = 0;
    std::memcpy(&word, &bytes[at], 4);
    word += 4;
    std::memcpy(&bytes[at], &word, 4);
    if (decode(bytes).error == "Positions.f64: not aligned to 8 bytes") ++misaligned;
  }
  EXPECT_EQ(misaligned, 1u);
}

TEST(Framing, EveryTruncationOfEveryMessageIsRefused) {
  for (const auto& [name, body] : samples::messages()) {
    const Bytes whole = copy(encode(body).body());
    for (std::size_t n = 0; n < whole.size(); ++n) {
      const DecodeResult result = decode(std::span(whole).first(n));
      // The last bytes may be padding, which no field needs.
      if (result) {
        EXPECT_GE(n + 8, whole.size()) << name << " cut to " << n << " of " << whole.size();
      } else {
        EXPECT_FALSE(result.error.empty());
      }
    }
  }
}

TEST(Framing, FlippedBitsAreRefusedWithAReasonOrGiveAMessageThatKeepsThePromises) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  std::size_t refused = 0;
  for (const auto& [name, body] : samples::messages()) {
    const Bytes whole = copy(encode(body).body());
    for (int i = 0; i < 2000; ++i) {
      Bytes bytes = whole;
      for (std::uint64_t n = 1 + random() % 3; n > 0; --n) {
        bytes[random() % bytes.size()] ^= static_cast<std::byte>(1u << random() % 8);
      }
      const DecodeResult result = decode(bytes);
      if (!result) {
        ++refused;
        EXPECT_FALSE(result.error.empty());
        continue;
      }
      // What was accepted can be sent on, and reads the same.
      const Frame again = encode(result.message->body, result.message->envelope);
      EXPECT_TRUE(decode(again.body())) << name;
    }
  }
  EXPECT_GT(refused, 5000u);
}

TEST(Framing, RandomBytesAreRefused) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  for (int i = 0; i < 5000; ++i) {
    Bytes bytes(random() % 300);
    for (std::byte& b : bytes) b = static_cast<std::byte>(random());
    if (bytes.size() >= 8 && i % 2) std::memcpy(&bytes[4], "INC1", 4);
    const DecodeResult result = decode(bytes);
    EXPECT_FALSE(result);
    EXPECT_FALSE(result.error.empty());
  }
}

// ---- The stream reader ----

TEST(FrameReader, CutsAStreamThatComesInAnyPieces) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  Bytes stream;
  std::vector<Frame> frames;
  for (int round = 0; round < 3; ++round) {
    for (const auto& [name, body] : samples::messages()) {
      frames.push_back(encode(body));
      stream.insert(stream.end(), frames.back().tcp().begin(), frames.back().tcp().end());
    }
  }
  for (int trial = 0; trial < 50; ++trial) {
    FrameReader reader;
    std::size_t at = 0, got = 0;
    const std::size_t longest = trial == 0 ? 1 : 1 + random() % 5000;
    while (at < stream.size()) {
      const std::size_t n = std::min<std::size_t>(1 + random() % longest, stream.size() - at);
      std::span<const std::byte> input(&stream[at], n);
      at += n;
      while (reader.read(input) == FrameReader::Status::Complete) {
        ASSERT_LT(got, frames.size());
        EXPECT_EQ(reinterpret_cast<std::uintptr_t>(reader.body().data()) % 8, 0u);
        EXPECT_TRUE(std::ranges::equal(reader.body(), frames[got].body())) << got;
        EXPECT_EQ(reader.pending_bytes(), 0u);
        ++got;
      }
      EXPECT_TRUE(input.empty());
      EXPECT_FALSE(reader.failed());
    }
    EXPECT_EQ(got, frames.size());
    EXPECT_EQ(reader.pending_bytes(), 0u);
  }
}

TEST(FrameReader, RefusesLengthsThatLie) {
  for (const std::uint32_t length : {0u, 1u, 15u, (64u << 20) + 1, 0x7fffffffu, 0x80000000u, 0xffffffffu}) {
    Bytes bytes(4);
    std::memcpy(bytes.data(), &length, 4);
    FrameReader reader;
    std::span<const std::byte> input = bytes;
    EXPECT_EQ(reader.read(input), FrameReader::Status::Failed);
    EXPECT_TRUE(reader.failed());
    EXPECT_NE(reader.error().find("length prefix: " + std::to_string(length)), std::string::npos)
        << reader.error();
    EXPECT_EQ(reader.read(input), FrameReader::Status::Failed);
  }
  // What to do, and nothing else.
  FrameReader wrong_port;
  const Bytes answer{std::byte{'H'}, std::byte{'T'}, std::byte{'T'}, std::byte{'P'}};
  std::span<const std::byte> http = answer;
  EXPECT_EQ(wrong_port.read(http), FrameReader::Status::Failed);
  EXPECT_EQ(wrong_port.error(),
            "the port speaks HTTP, not the binary protocol: use the other port, or ws:// before this one");
  FrameReader stranger(kMaxHandshakeBytes);
  const std::uint32_t length = kMaxHandshakeBytes + 1;
  Bytes bytes(4);
  std::memcpy(bytes.data(), &length, 4);
  std::span<const std::byte> input = bytes;
  EXPECT_EQ(stranger.read(input), FrameReader::Status::Failed);
}

TEST(FrameReader, TakesTheShortestMessageAndTheLongest) {
  for (const std::uint32_t size : {std::uint32_t{kMinMessageBytes}, 1000u}) {
    FrameReader reader(1000);
    Bytes bytes(4 + size);
    std::memcpy(bytes.data(), &size, 4);
    std::span<const std::byte> input = bytes;
    EXPECT_EQ(reader.read(input), FrameReader::Status::Complete) << size;
    EXPECT_EQ(reader.body().size(), size);
  }
}

// A peer that announces 64 MB and sends nothing costs nothing. Large blocks are mapped one by one, and counted.
TEST(FrameReader, AnAnnouncedLengthAloneAllocatesNothing) {
  const std::size_t before = mallinfo2().hblkhd;
  FrameReader reader;
  Bytes bytes(8);
  const std::uint32_t size = kMaxMessageBytes;
  std::memcpy(bytes.data(), &size, 4);
  std::span<const std::byte> input = bytes;
  EXPECT_EQ(reader.read(input), FrameReader::Status::NeedMore);
  EXPECT_EQ(reader.pending_bytes(), 8u);
  EXPECT_LT(mallinfo2().hblkhd, before + (1u << 20));
}

TEST(FrameReader, TellsAStreamThatWasCutOff) {
  const Frame frame = encode(Ping{1, 2});
  FrameReader reader;
  std::span<const std::byte> input = frame.tcp().first(frame.tcp().size() - 1);
  EXPECT_EQ(reader.read(input), FrameReader::Status::NeedMore);
  EXPECT_EQ(reader.pending_bytes(), frame.tcp().size() - 1);
  EXPECT_TRUE(reader.body().empty());
}

}  // namespace
}  // namespace incise::protocol
