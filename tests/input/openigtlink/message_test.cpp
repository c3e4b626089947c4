// Our reading of messages against the OpenIGTLink library's writing, and the other way round.

#include "server/input/openigtlink/message.hpp"

#include <gtest/gtest.h>
#include <igtl_util.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <future>
#include <numbers>
#include <random>

#include "server/input/openigtlink/surface_message.hpp"
#include "tests/input/openigtlink/library_peer.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::input::openigtlink {
namespace {

using tests::Packed;
using tests::PlacedTool;

constexpr std::int64_t kTime_ns = 1'700'000'000'123'456'789;

PlacedTool scalpel() {
  const auto s = static_cast<float>(std::sin(0.3)), c = static_cast<float>(std::cos(0.3));
  return {"Scalpel", 12.5F, -3, 250, {0.6F * s, 0, 0.8F * s, c}};
}

Header header_of(const Packed& bytes) {
  std::string error;
  const auto header = read_header(std::span(bytes).first<kHeaderBytes>(), error);
  EXPECT_TRUE(header) << error;
  return header.value_or(Header{});
}

Decoded decoded(const Packed& bytes) {
  return decode(header_of(bytes), std::span(bytes).subspan(kHeaderBytes));
}

void expect_scalpel(const ToolPose& tool) {
  EXPECT_EQ(tool.name, "Scalpel");
  EXPECT_EQ(tool.position, (core::Vec3{12.5, -3, 250}));
  EXPECT_NEAR(tool.orientation.w, std::cos(0.3), 1e-6);
  EXPECT_NEAR(tool.orientation.x, 0.6 * std::sin(0.3), 1e-6);
  EXPECT_NEAR(tool.orientation.y, 0, 1e-6);
  EXPECT_NEAR(tool.orientation.z, 0.8 * std::sin(0.3), 1e-6);
}

TEST(OpenIgtLinkMessage, TheCrcIsTheLibrarys) {
  std::mt19937 random(1);
  for (std::size_t size : {0, 1, 7, 48, 1000}) {
    Packed bytes(size);
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
    EXPECT_EQ(crc64(bytes), ::crc64(bytes.data(), size, 0)) << size;
  }
}

TEST(OpenIgtLinkMessage, ReadsTheLibrarysPosesInBothHeaderVersions) {
  const PlacedTool other{"Other", 1, 2, 3, {0, 0, 0, 1}};
  for (int version : {1, 2}) {
    for (const Packed& bytes :
         {tests::transform(scalpel(), kTime_ns, version), tests::tdata({scalpel(), other}, kTime_ns, version),
          tests::qtdata({scalpel(), other}, kTime_ns, version)}) {
      const Header header = header_of(bytes);
      EXPECT_EQ(header.version, version);
      // As well as the library turns nanoseconds into its fractions.
      EXPECT_NEAR(static_cast<double>(timestamp_ns(header) - kTime_ns), 0, 20) << header.type;
      const Decoded got = decoded(bytes);
      ASSERT_TRUE(got.message) << got.error;
      EXPECT_EQ(got.message->kind, Kind::kPoses);
      EXPECT_EQ(got.message->stretched, 0u);
      ASSERT_EQ(got.message->tools.size(), header.type == "TRANSFORM" ? 1u : 2u) << header.type;
      expect_scalpel(got.message->tools[0]);
      EXPECT_EQ(got.message->tools.back().name, header.type == "TRANSFORM" ? "Scalpel" : "Other");
    }
  }
}

TEST(OpenIgtLinkMessage, EveryTurnOfAMatrixComesBackAsItsQuaternion) {
  std::mt19937 random(2);
  std::normal_distribution<float> normal;
  for (int i = 0; i < 300; ++i) {
    PlacedTool tool{"T", 0, 0, 0, {normal(random), normal(random), normal(random), normal(random)}};
    if (i % 3 == 0) tool.q[3] = 0;  // half turns
    const float n = std::sqrt(tool.q[0] * tool.q[0] + tool.q[1] * tool.q[1] + tool.q[2] * tool.q[2] +
                              tool.q[3] * tool.q[3]);
    for (float& part : tool.q) part /= n;
    const Decoded got = decoded(tests::transform(tool, kTime_ns));
    ASSERT_TRUE(got.message) << got.error;
    const core::Quat& q = got.message->tools[0].orientation;
    const double same = q.x * tool.q[0] + q.y * tool.q[1] + q.z * tool.q[2] + q.w * tool.q[3];
    EXPECT_NEAR(std::abs(same), 1, 1e-5) << i;
  }
}

TEST(OpenIgtLinkMessage, ReadsTextStatusAndWhatIsAskedOfTheSurface) {
  for (int version : {1, 2}) {
    const Decoded text = decoded(tests::string_message("Scalpel", "engaged", version));
    ASSERT_TRUE(text.message) << text.error;
    EXPECT_EQ(text.message->kind, Kind::kText);
    EXPECT_EQ(text.message->text, "engaged");
  }
  const Decoded status = decoded(tests::status("Scalpel", 16));
  ASSERT_TRUE(status.message) << status.error;
  EXPECT_EQ(status.message->kind, Kind::kStatus);
  EXPECT_EQ(status.message->status, 16);
  EXPECT_EQ(decoded(tests::get_polydata()).message->kind, Kind::kGetSurface);
  const std::uint8_t interval[] = {0, 0, 1, 0};
  const Decoded start = decoded(encode("STT_POLYDATA", "Viewer", 0, interval));
  EXPECT_EQ(start.message->kind, Kind::kStartSurface);
  EXPECT_EQ(start.message->interval_ms, 256u);
  EXPECT_EQ(decoded(encode("STT_POLYDATA", "Viewer", 0, {})).message->interval_ms, 0u);
  EXPECT_EQ(decoded(encode("STP_POLYDATA", "Viewer", 0, {})).message->kind, Kind::kStopSurface);
  EXPECT_EQ(kind_of("IMAGE"), Kind::kOther);
}

TEST(OpenIgtLinkMessage, AWrongBitAnywhereInABodyIsSeen) {
  for (const Packed& good : {tests::transform(scalpel(), kTime_ns, 2), tests::tdata({scalpel()}, kTime_ns)}) {
    for (std::size_t at = kHeaderBytes; at < good.size(); ++at) {
      Packed bad = good;
      bad[at] ^= 4;
      EXPECT_EQ(decoded(bad).fault, Fault::kCrc) << at;
    }
  }
}

// A message with a body of these bytes, and the CRC that they have.
Decoded with_body(const std::string& type, const Packed& body, std::uint16_t version = 1) {
  Header header{version, type, "D", 0, body.size(), crc64(body)};
  return decode(header, body);
}

TEST(OpenIgtLinkMessage, LengthsThatDoNotFitAreRefused) {
  for (const char* type : {"TRANSFORM", "TDATA", "QTDATA", "STRING", "STATUS"}) {
    for (const std::size_t size : {1, 3, 29, 47, 49, 51, 69, 71}) {
      if ((std::string(type) == "STRING" && size >= 4) || (std::string(type) == "STATUS" && size >= 30))
        continue;
      const Decoded got = with_body(type, Packed(size));
      EXPECT_EQ(got.fault, Fault::kShape) << type << ' ' << size;
      EXPECT_NE(got.error.find(type), std::string::npos) << got.error;
    }
  }
  EXPECT_EQ(with_body("STRING", {0, 3, 0, 5, 'a', 'b'}).fault, Fault::kShape);
  EXPECT_EQ(decode({1, "TRANSFORM", "D", 0, 48, 0}, Packed(40)).fault, Fault::kShape);
  // Extended header and metadata: none, too short a one, ones that reach beyond the body.
  EXPECT_EQ(with_body("TRANSFORM", Packed(11), 2).fault, Fault::kShape);
  const Packed good = tests::transform(scalpel(), kTime_ns, 2);
  const Packed body(good.begin() + kHeaderBytes, good.end());
  ASSERT_TRUE(with_body("TRANSFORM", body, 2).message);
  for (const std::size_t at : {0, 1, 2, 3, 4, 5, 6, 7}) {
    for (const int value : {0, 11, 0x7f, 0xff}) {
      Packed bad = body;
      if (bad[at] == value) continue;
      bad[at] = static_cast<std::uint8_t>(value);
      EXPECT_EQ(with_body("TRANSFORM", bad, 2).fault, Fault::kShape) << at << ' ' << value;
    }
  }
  // An empty body is a frame without tools.
  EXPECT_TRUE(with_body("TDATA", {}).message);
}

Packed matrix_body(const float (&m)[12]) {
  Packed body;
  for (const float value : m) {
    const auto bits = std::bit_cast<std::uint32_t>(value);
    for (int shift = 24; shift >= 0; shift -= 8) body.push_back(static_cast<std::uint8_t>(bits >> shift));
  }
  return body;
}

TEST(OpenIgtLinkMessage, AMatrixThatIsNoRotationIsMadeOneOrRefused) {
  const Decoded scaled = with_body("TRANSFORM", matrix_body({2, 0, 0, 0.1F, 2, 0, 0, 0, 1, 5, 6, 7}));
  ASSERT_TRUE(scaled.message);
  EXPECT_EQ(scaled.message->stretched, 1u);
  EXPECT_NEAR(scaled.message->tools[0].orientation.w, 1, 1e-12);
  EXPECT_EQ(scaled.message->tools[0].position, (core::Vec3{5, 6, 7}));
  constexpr float kNone = std::numeric_limits<float>::quiet_NaN(),
                  kEndless = std::numeric_limits<float>::infinity();
  for (const auto& body :
       {matrix_body({0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0}), matrix_body({1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0}),
        matrix_body({1, 0, 0, 0, 1, 0, 0, 0, -1, 0, 0, 0}),
        matrix_body({kNone, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}),
        matrix_body({1, 0, 0, 0, 1, 0, 0, 0, 1, kEndless, 0, 0}),
        matrix_body({1e30F, 0, 0, 0, 1e30F, 0, 0, 0, 1e30F, 0, 0, 0})}) {
    EXPECT_EQ(with_body("TRANSFORM", body).fault, Fault::kValues);
  }
  // One bad tool among good ones costs itself alone.
  PlacedTool still = scalpel();
  for (float& part : still.q) part = 0;
  const Decoded tools = decoded(tests::qtdata({still, scalpel()}, kTime_ns));
  ASSERT_TRUE(tools.message);
  EXPECT_EQ(tools.message->bad_tools, 1u);
  ASSERT_EQ(tools.message->tools.size(), 1u);
  expect_scalpel(tools.message->tools[0]);
}

TEST(OpenIgtLinkMessage, BytesThatAreNoHeaderAreRefused) {
  Packed bytes = tests::transform(scalpel(), kTime_ns);
  std::string error;
  const auto refused = [&](Packed bad) {
    error.clear();
    return !read_header(std::span(bad).first<kHeaderBytes>(), error) && !error.empty();
  };
  Packed bad = bytes;
  bad[1] = 0;
  EXPECT_TRUE(refused(bad));
  bad[0] = 0x47;  // "GET / HTTP"
  EXPECT_TRUE(refused(bad));
  bad = bytes;
  std::fill_n(bad.begin() + 2, 12, 0);
  EXPECT_TRUE(refused(bad));
  bad = bytes;
  bad[2] = 0xff;
  EXPECT_TRUE(refused(bad));
  // Names are for people, for JSON and for metrics.
  bad = bytes;
  bad[14] = '"';
  bad[15] = 0x80;
  bad[16] = '\n';
  EXPECT_EQ(header_of(bad).device, "___lpel");
}

TEST(OpenIgtLinkMessage, TheLibraryReadsWhatWeEncode) {
  const std::uint8_t body[] = {0};
  const Packed bytes = encode("RTS_POLYDATA", "Incise", 0, body);
  const auto header = igtl::MessageHeader::New();
  header->InitPack();
  ASSERT_EQ(static_cast<std::size_t>(header->GetPackSize()), kHeaderBytes);
  std::memcpy(header->GetPackPointer(), bytes.data(), kHeaderBytes);
  header->Unpack();
  EXPECT_STREQ(header->GetDeviceType(), "RTS_POLYDATA");
  EXPECT_STREQ(header->GetDeviceName(), "Incise");
  EXPECT_EQ(header->GetBodySizeToRead(), 1u);
  EXPECT_EQ(header_of(bytes).crc, ::crc64(const_cast<std::uint8_t*>(body), 1, 0));
}

TEST(OpenIgtLinkMessage, TheSurfaceOfACutBodyIsReadByTheLibrary) {
  stream::TestServer test;  // a cube of 60 mm
  test.cut(2);              // what the first one cuts off is thinner than a quarter of an element, and stays
  std::promise<stream::Server::SharedFrames> promise;
  test.server.request_surface([&](auto frames) { promise.set_value(std::move(frames)); });
  auto future = promise.get_future();
  ASSERT_EQ(future.wait_for(std::chrono::seconds(20)), std::future_status::ready);
  std::string error;
  auto frames = future.get();
  const auto surface = surface_of(frames, error);
  ASSERT_TRUE(surface) << error;
  const Placement mm{{0.01, 0, 0}, {0, 0, 0, 1}, 0.001};  // turned half about z, as RAS and LPS are
  Packed bytes = pack_surface(*surface, mm, "Incise");

  const auto header = igtl::MessageHeader::New();
  header->InitPack();
  std::memcpy(header->GetPackPointer(), bytes.data(), kHeaderBytes);
  header->Unpack();
  const auto message = igtl::PolyDataMessage::New();
  message->SetMessageHeader(header);
  message->AllocatePack();
  ASSERT_EQ(static_cast<std::size_t>(message->GetPackBodySize()), bytes.size() - kHeaderBytes);
  std::memcpy(message->GetPackBodyPointer(), bytes.data() + kHeaderBytes, bytes.size() - kHeaderBytes);
  ASSERT_TRUE(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY);
  const tests::SurfaceSeen seen = tests::seen(*message);
  EXPECT_TRUE(seen.good);
  EXPECT_EQ(seen.points, surface->vertices().size());
  EXPECT_EQ(seen.triangles, surface->triangles().size());
  EXPECT_EQ(seen.pieces.size(), 2u);
  std::set<std::uint32_t> cut;
  for (const auto& [id, triangle] : surface->triangles()) {
    if (triangle.flags & protocol::kTriangleCut)
      cut.insert(triangle.vertices.begin(), triangle.vertices.end());
  }
  EXPECT_GT(cut.size(), 0u);
  EXPECT_EQ(seen.cut, cut.size());
  EXPECT_NEAR(seen.low[0], -50, 0.01);
  EXPECT_NEAR(seen.high[0], 10, 0.01);
  EXPECT_NEAR(seen.low[1], -60, 0.01);
  EXPECT_NEAR(seen.high[2], 60, 0.01);
  frames.pop_back();
  EXPECT_FALSE(surface_of(frames, error));
}

}  // namespace
}  // namespace incise::input::openigtlink
