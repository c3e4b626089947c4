// The golden bytes in protocol/vectors: what this library writes, byte for byte, and what a client in another
// language can test itself with. Where the protocol changes on purpose: INCISE_WRITE_VECTORS=1 protocol_test
// --gtest_filter='Vectors.*' writes them again, and the difference is for review.

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "protocol/crc32c.hpp"
#include "protocol/framing.hpp"
#include "protocol/replica.hpp"
#include "protocol/state_hash.hpp"
#include "protocol/surface.hpp"
#include "protocol/volume_part.hpp"
#include "server/base/hex.hpp"
#include "tests/protocol/samples.hpp"

namespace incise::protocol {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

const fs::path kVectors = fs::path(INCISE_SOURCE_DIR) / "protocol" / "vectors";

bool writing() {
  return std::getenv("INCISE_WRITE_VECTORS") != nullptr;
}

std::string read_file(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  EXPECT_TRUE(in.good()) << path << " cannot be read";
  return {std::istreambuf_iterator<char>(in), {}};
}

// Compares with the file, or writes it.
void expect_file(const fs::path& path, const std::string& bytes) {
  if (writing()) {
    fs::create_directories(path.parent_path());
    std::ofstream(path, std::ios::binary) << bytes;
    return;
  }
  EXPECT_TRUE(read_file(path) == bytes) << path << " holds other bytes than are written today";
}

std::string text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

using incise::hex;
std::string hex(std::span<const std::byte> bytes) {
  std::ostringstream out;
  out << std::hex << std::setfill('0');
  for (const std::byte b : bytes) out << std::setw(2) << static_cast<int>(b);
  return out.str();
}

struct Sample {
  std::string name;
  Body body;
  std::size_t index;  // of its envelope
};

// The first 24 kinds and 5 extensions have an envelope of their own; what came later has the first one's, so that
// one more changes no bytes of others.
std::vector<Sample> all_messages() {
  constexpr std::size_t kKinds = 24, kExtensions = 5;
  std::vector<Sample> all;
  const auto& kinds = samples::messages();
  const auto& extended = samples::extended_messages();
  for (std::size_t i = 0; i < kinds.size(); ++i)
    all.push_back({kinds[i].first, kinds[i].second, i < kKinds ? i : 0});
  for (std::size_t i = 0; i < extended.size(); ++i)
    all.push_back({extended[i].first, extended[i].second, i < kExtensions ? kKinds + i : 0});
  return all;
}

TEST(Vectors, Messages) {
  for (const auto& [name, body, index] : all_messages()) {
    const Frame frame = encode(body, samples::envelope(index));
    expect_file(kVectors / "messages" / (name + ".bin"), text(frame.body()));
  }
}

// Texture coordinates of faces, on the surface of messages/SurfaceAsset.bin.
TEST(Vectors, SurfaceLookup) {
  const auto& all = samples::messages();
  const auto& asset = std::get<SurfaceAsset>(
      std::find_if(all.begin(), all.end(), [](const auto& m) { return m.first == "SurfaceAsset"; })->second);
  const SurfaceLookup lookup(asset);
  struct Face {
    const char* what;
    std::uint32_t origin;
    Corners rest;
  };
  const Face faces[] = {
      {"within its origin", 0, {{{0.004, 0.001, 0}, {0.009, 0.002, 0}, {0.008, 0.007, 0}}}},
      {"reaches into the next triangle", 0, {{{0.004, 0.002, 0}, {0.009, 0.004, 0}, {0.002, 0.008, 0}}}},
      {"over a seam", 0, {{{0.008, 0.002, 0}, {0.012, 0.003, -0.001}, {0.008, 0.006, 0}}}},
      {"beyond the seam", 2, {{{0.008, 0.002, 0}, {0.012, 0.003, -0.001}, {0.008, 0.006, 0}}}},
      {"above the surface", 1, {{{0.001, 0.009, 0.001}, {0.001, 0.002, 0.001}, {0.005, 0.006, 0.001}}}},
      {"a cut face", kNoId, {{{0.001, 0.009, 0.001}, {0.001, 0.002, 0.001}, {0.005, 0.006, 0.001}}}},
  };
  json out = json::array();
  for (const Face& face : faces) {
    json rest = json::array(), uvs;
    for (const Vec3& p : face.rest) rest.push_back({p.x, p.y, p.z});
    if (const auto found = lookup.uvs(face.origin, face.rest)) uvs = *found;
    out.push_back({{"what", face.what}, {"origin", face.origin}, {"rest", rest}, {"uvs", uvs}});
  }
  EXPECT_EQ(out[1]["uvs"][2][1], lookup.uvs(1, faces[1].rest)->at(2)[1]) << "neighbours agree";
  EXPECT_TRUE(out[5]["uvs"].is_null());
  expect_file(kVectors / "surface_lookup.json", out.dump(1) + "\n");
}

// flatc's own reading of the bytes: numbers have up to 12 digits.
TEST(Vectors, MessagesAsFlatcReadsThem) {
  const fs::path out = writing() ? kVectors / "messages" : fs::path(::testing::TempDir()) / "vectors_test";
  fs::create_directories(out);
  for (const auto& [name, body, index] : all_messages()) {
    const std::string command = std::string("'" INCISE_FLATC "' --json --raw-binary --strict-json -o '") +
                                out.string() + "' '" + INCISE_SOURCE_DIR + "/protocol/incise.fbs' -- '" +
                                (kVectors / "messages" / (name + ".bin")).string() + "'";
    ASSERT_EQ(std::system(command.c_str()), 0) << command;
    if (!writing()) {
      EXPECT_EQ(read_file(out / (name + ".json")), read_file(kVectors / "messages" / (name + ".json")))
          << name;
    }
  }
}

TEST(Vectors, MessagesDecodeToTheSamples) {
  if (writing()) GTEST_SKIP() << "writing";
  for (const auto& [name, body, index] : all_messages()) {
    const std::string bytes = read_file(kVectors / "messages" / (name + ".bin"));
    const DecodeResult result = decode(std::as_bytes(std::span(bytes)));
    ASSERT_TRUE(result) << name << ": " << result.error;
    EXPECT_EQ(result.message->envelope.sequence, index + 1);
    EXPECT_EQ(result.message->envelope.sent_ns, 123'456'789'000 + static_cast<std::int64_t>(index));
    EXPECT_EQ(text(encode(result.message->body, samples::envelope(index)).body()), bytes) << name;
  }
}

// ---- Hashes ----

json hash_vectors() {
  json out;
  struct Vertex {
    std::uint32_t id;
    double xyz[3];
  };
  for (const Vertex& v :
       {Vertex{0, {0, 0, 0}}, Vertex{1, {0.01, -0.02, 0.03}}, Vertex{0xfffffffe, {-0.0, 1e-300, 1e6}}}) {
    out["vertex"].push_back(
        {{"id", v.id}, {"position", v.xyz}, {"hash", hex(vertex_hash(v.id, v.xyz[0], v.xyz[1], v.xyz[2]))}});
  }
  struct Tet {
    std::uint32_t id, vertices[4];
    std::int32_t region;
    std::uint8_t cut_mask;
  };
  for (const Tet& t :
       {Tet{0, {0, 1, 2, 3}, 0, 0}, Tet{7, {3, 2, 1, 0}, -5, 9}, Tet{1u << 30, {9, 8, 7, 6}, 1, 15}}) {
    out["tetrahedron"].push_back({{"id", t.id},
                                  {"vertices", t.vertices},
                                  {"region", t.region},
                                  {"cut_mask", t.cut_mask},
                                  {"hash", hex(tet_hash(t.id, t.vertices, t.region, t.cut_mask))}});
  }
  struct Triangle {
    std::uint32_t id, vertices[3];
    std::uint8_t flags;
  };
  for (const Triangle& t : {Triangle{0, {1, 2, 3}, 0}, Triangle{31, {5, 7, 6}, 1}}) {
    out["triangle"].push_back({{"id", t.id},
                               {"vertices", t.vertices},
                               {"flags", t.flags},
                               {"hash", hex(triangle_hash(t.id, t.vertices, t.flags))}});
  }
  struct SurfaceVertex {
    std::uint32_t id;
    float xyz[3];
  };
  for (const SurfaceVertex& v : {SurfaceVertex{0, {0, 0, 0}}, SurfaceVertex{12, {0.5f, -0.25f, 0.1f}}}) {
    out["surface_vertex"].push_back(
        {{"id", v.id}, {"position", v.xyz}, {"hash", hex(surface_vertex_hash(v.id, v.xyz))}});
  }
  for (std::uint64_t revision = 0; revision <= 2; ++revision) {
    const Model model = samples::two_tets(revision);
    json state{{"revision", revision}, {"hash", hex(model.hash())}};
    for (const auto& p : model.positions) state["positions"].push_back(p);
    for (const auto& [id, t] : model.tets) {
      state["tetrahedra"].push_back(
          {{"id", id}, {"vertices", t.vertices}, {"region", t.region}, {"cut_mask", t.cut_mask}});
    }
    out["state"].push_back(state);
  }
  return out;
}

TEST(Vectors, Hashes) {
  expect_file(kVectors / "hashes.json", hash_vectors().dump(1) + "\n");
}

// ---- Streams ----

std::string tcp_bytes(const std::vector<Body>& bodies) {
  std::string out;
  for (std::size_t i = 0; i < bodies.size(); ++i) out += text(encode(bodies[i], samples::envelope(i)).tcp());
  return out;
}

// What a client holds after each message that brings it to a revision.
template <class R, class D>
json states_of(const std::string& stream, R& replica, std::uint64_t (R::*hash)() const) {
  json out = json::array();
  std::span<const std::byte> input = std::as_bytes(std::span(stream));
  FrameReader reader;
  while (reader.read(input) == FrameReader::Status::Complete) {
    const DecodeResult result = decode(reader.body());
    EXPECT_TRUE(result) << result.error;
    if (!result) return out;
    ApplyResult applied;
    bool new_state = false;
    if (const auto* begin = std::get_if<SnapshotBegin>(&result.message->body))
      applied = replica.begin(*begin);
    if (const auto* chunk = std::get_if<SnapshotChunk>(&result.message->body))
      applied = replica.chunk(*chunk);
    if (const auto* end = std::get_if<SnapshotEnd>(&result.message->body)) {
      applied = replica.end(*end);
      new_state = true;
    }
    if (const auto* delta = std::get_if<D>(&result.message->body)) {
      applied = replica.apply(*delta);
      new_state = true;
    }
    EXPECT_TRUE(applied) << applied.text;
    if (new_state) {
      out.push_back({{"revision", replica.revision()},
                     {"hash", hex((replica.*hash)())},
                     {"canonical_bytes", hex(replica.canonical_bytes())}});
    }
  }
  EXPECT_FALSE(reader.failed()) << reader.error();
  EXPECT_EQ(reader.pending_bytes(), 0u);
  EXPECT_TRUE(input.empty());
  return out;
}

TEST(Vectors, VolumeStream) {
  const std::string stream = tcp_bytes(samples::volume_stream());
  Replica replica;
  const json states = states_of<Replica, Delta>(stream, replica, &Replica::state_hash);
  ASSERT_EQ(states.size(), 3u);
  for (std::uint64_t r = 0; r < 3; ++r) EXPECT_EQ(states[r]["hash"], hex(samples::two_tets(r).hash()));
  expect_file(kVectors / "streams" / "volume.bin", stream);
  expect_file(kVectors / "streams" / "volume.json", states.dump(1) + "\n");
}

TEST(Vectors, SurfaceStream) {
  const std::string stream = tcp_bytes(samples::surface_stream());
  SurfaceReplica replica;
  const json states = states_of<SurfaceReplica, SurfaceDelta>(stream, replica, &SurfaceReplica::surface_hash);
  ASSERT_EQ(states.size(), 3u);
  expect_file(kVectors / "streams" / "surface.bin", stream);
  expect_file(kVectors / "streams" / "surface.json", states.dump(1) + "\n");
}

TEST(Vectors, VolumePartStream) {
  const std::string stream = tcp_bytes(samples::volume_part_stream());
  VolumePart replica;
  const json states = states_of<VolumePart, Delta>(stream, replica, &VolumePart::part_hash);
  ASSERT_EQ(states.size(), 3u);
  expect_file(kVectors / "streams" / "volume_part.bin", stream);
  expect_file(kVectors / "streams" / "volume_part.json", states.dump(1) + "\n");
}

// ---- Capture ----

class StringSink final : public CaptureSink {
 public:
  std::string bytes;
  std::error_code append(std::span<const std::byte> data) override {
    bytes += text(data);
    return {};
  }
  std::error_code truncate(std::uint64_t size) override {
    bytes.resize(size);
    return {};
  }
  std::error_code sync() override { return {}; }
};

TEST(Vectors, Capture) {
  StringSink sink;
  CaptureWriter writer(sink, samples::capture_header());
  for (const CaptureRecord& record : samples::capture_records()) writer.append(record);
  ASSERT_FALSE(writer.flush());
  const fs::path path = kVectors / "capture.incise";
  expect_file(path, sink.bytes);
  const std::string bytes = read_file(path);
  std::istringstream in(bytes);
  CaptureReader reader(in);
  CaptureRecord record;
  for (const CaptureRecord& expected : samples::capture_records()) {
    ASSERT_EQ(reader.next(record), CaptureReader::Status::Record) << reader.error();
    EXPECT_EQ(record, expected);
  }
  EXPECT_EQ(reader.next(record), CaptureReader::Status::End) << reader.error();
}

}  // namespace
}  // namespace incise::protocol
