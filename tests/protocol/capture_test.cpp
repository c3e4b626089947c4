#include "protocol/capture.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "protocol/crc32c.hpp"
#include "protocol/limits.hpp"
#include "tests/protocol/samples.hpp"

namespace incise::protocol {
namespace {

using Status = CaptureReader::Status;

// A sink in memory whose nth call fails, having written half of what it was given.
class FailingSink final : public CaptureSink {
 public:
  std::string bytes;
  int fail_at = -1;  // counts all calls; -1: never
  int fail_times = 1;

  std::error_code append(std::span<const std::byte> data) override {
    const bool bad = fails();
    bytes.append(reinterpret_cast<const char*>(data.data()), bad ? data.size() / 2 : data.size());
    return bad ? std::make_error_code(std::errc::no_space_on_device) : std::error_code();
  }
  std::error_code truncate(std::uint64_t size) override {
    if (fails()) return std::make_error_code(std::errc::io_error);
    bytes.resize(size);
    return {};
  }
  std::error_code sync() override { return {}; }

 private:
  bool fails() {
    const int call = calls_++;
    return fail_at >= 0 && call >= fail_at && call < fail_at + fail_times;
  }
  int calls_ = 0;
};

std::string sample_capture() {
  FailingSink sink;
  CaptureWriter writer(sink, samples::capture_header());
  for (const CaptureRecord& record : samples::capture_records()) writer.append(record);
  EXPECT_FALSE(writer.flush());
  return sink.bytes;
}

struct Outcome {
  std::vector<CaptureRecord> records;
  Status status = Status::Record;
  std::string error;
  std::uint64_t good_bytes = 0;
  bool closed = false;
};

Outcome read_all(const std::string& bytes) {
  std::istringstream in(bytes);
  CaptureReader reader(in);
  Outcome out;
  CaptureRecord record;
  while ((out.status = reader.next(record)) == Status::Record) out.records.push_back(record);
  out.error = reader.error();
  out.good_bytes = reader.good_bytes();
  out.closed = reader.closed();
  return out;
}

// Where the header ends and each record after it.
std::vector<std::size_t> boundaries(const std::string& bytes) {
  std::uint32_t length = 0;
  std::memcpy(&length, &bytes[12], 4);
  std::vector<std::size_t> ends{20 + std::size_t{length}};
  while (ends.back() < bytes.size()) {
    std::memcpy(&length, &bytes[ends.back()], 4);
    ends.push_back(ends.back() + 9 + length);
  }
  return ends;
}

TEST(Capture, ComesBackTheSame) {
  const std::string bytes = sample_capture();
  std::istringstream in(bytes);
  CaptureReader reader(in);
  ASSERT_TRUE(reader.header_ok()) << reader.error();
  EXPECT_EQ(reader.header().mesh_path, "meshes/two_tets.node");
  EXPECT_EQ(reader.header().mesh_content_hash, "crc32c:0a1b2c3d");
  EXPECT_EQ(reader.header().session, 0x1122334455667788u);
  EXPECT_EQ(reader.header().created_unix_ns, 1'795'000'000'000'000'000);
  EXPECT_EQ(reader.header().software, "incised 0.1.0");
  EXPECT_EQ(reader.header().config_json, R"({"frame_hz":1000})");
  const Outcome outcome = read_all(bytes);
  EXPECT_EQ(outcome.status, Status::End) << outcome.error;
  EXPECT_TRUE(outcome.closed);
  EXPECT_EQ(outcome.good_bytes, bytes.size());
  const auto expected = samples::capture_records();
  ASSERT_EQ(outcome.records.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(outcome.records[i], expected[i]) << i;
}

TEST(Capture, HeaderMustHoldJson) {
  FailingSink sink;
  CaptureHeader header = samples::capture_header();
  header.config_json = "{";
  EXPECT_THROW(CaptureWriter(sink, header), std::invalid_argument);
  header.config_json = "[1]";
  EXPECT_THROW(CaptureWriter(sink, header), std::invalid_argument);
}

TEST(Capture, PositionsMustBeThreeForEachVertex) {
  FailingSink sink;
  CaptureWriter writer(sink, samples::capture_header());
  EXPECT_THROW(writer.append(PositionsRecord{0, 0, 0, 0, 0, {}, {1, 2}}), std::length_error);
  EXPECT_THROW(writer.append(PositionsRecord{0, 0, 0, 0, 0, {1, 2}, {1, 2, 3}}), std::length_error);
}

TEST(Capture, PositionsOfFloatsAreStoredAsFloats) {
  const auto bytes_of = [](const PositionsRecord& record) {
    FailingSink sink;
    CaptureWriter writer(sink, samples::capture_header());
    EXPECT_FALSE(writer.flush());
    const std::size_t before = sink.bytes.size();
    writer.append(record);
    EXPECT_FALSE(writer.flush());
    const Outcome outcome = read_all(sink.bytes);
    EXPECT_EQ(outcome.status, Status::End) << outcome.error;
    EXPECT_EQ(outcome.records, std::vector<CaptureRecord>{record});
    return sink.bytes.size() - before;
  };
  PositionsRecord record{900, 1, 5, 77, 3, {}, {0.5, -0.25, 3}};
  const std::size_t as_doubles = bytes_of(record);
  record.single = true;
  EXPECT_EQ(bytes_of(record), as_doubles - 12);
  record.first = 0;
  record.ids = {3};
  EXPECT_EQ(bytes_of(record), as_doubles - 8);
}

TEST(Capture, ATornTailIsToldAtEveryOffset) {
  const std::string bytes = sample_capture();
  const std::vector<std::size_t> ends = boundaries(bytes);
  ASSERT_EQ(ends.size(), samples::capture_records().size() + 1);
  for (std::size_t n = 1; n < bytes.size(); ++n) {
    const Outcome outcome = read_all(bytes.substr(0, n));
    const std::size_t whole =
        static_cast<std::size_t>(std::upper_bound(ends.begin(), ends.end(), n) - ends.begin());
    if (whole == 0) {
      EXPECT_EQ(outcome.status, Status::Torn) << "cut to " << n << ": " << outcome.error;
      continue;
    }
    EXPECT_EQ(outcome.records.size(), whole - 1) << "cut to " << n;
    EXPECT_EQ(outcome.good_bytes, ends[whole - 1]);
    const bool at_boundary = ends[whole - 1] == n;
    EXPECT_EQ(outcome.status, at_boundary ? Status::End : Status::Torn) << "cut to " << n;
    EXPECT_FALSE(outcome.closed);
    if (!at_boundary) {
      EXPECT_TRUE(outcome.error.starts_with("offset " + std::to_string(ends[whole - 1]) + ": "))
          << outcome.error;
    }
  }
  EXPECT_EQ(read_all("").status, Status::Corrupt);
}

TEST(Capture, ATornRecordIsSaidInWhole) {
  const std::string bytes = sample_capture();
  const Outcome outcome = read_all(bytes.substr(0, bytes.size() - 1));
  EXPECT_NE(outcome.error.find("the last record is incomplete (by its own account it has "),
            std::string::npos)
      << outcome.error;
  EXPECT_NE(outcome.error.find(" bytes from there on hold no good record"), std::string::npos)
      << outcome.error;
}

TEST(Capture, ATailOfZerosIsTorn) {
  // What some file systems leave after a loss of power: the length is there, the data is not.
  const std::string bytes = sample_capture();
  for (const std::size_t zeros : {1u, 9u, 4096u}) {
    const Outcome outcome = read_all(bytes + std::string(zeros, '\0'));
    EXPECT_EQ(outcome.status, Status::Torn);
    EXPECT_EQ(outcome.good_bytes, bytes.size());
    EXPECT_EQ(outcome.records.size(), samples::capture_records().size());
  }
}

TEST(Capture, EveryFlippedBitIsFound) {
  const std::string bytes = sample_capture();
  const std::vector<std::size_t> ends = boundaries(bytes);
  const std::size_t last = ends[ends.size() - 2];
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    for (int bit = 0; bit < 8; ++bit) {
      std::string bad = bytes;
      bad[at] = static_cast<char>(bad[at] ^ 1 << bit);
      const Outcome outcome = read_all(bad);
      const std::size_t whole =
          static_cast<std::size_t>(std::upper_bound(ends.begin(), ends.end(), at) - ends.begin());
      ASSERT_NE(outcome.status, Status::End) << "byte " << at << " bit " << bit;
      ASSERT_FALSE(outcome.error.empty());
      if (whole == 0) continue;  // in the header
      // Nothing before it is lost, nothing behind it is believed.
      EXPECT_EQ(outcome.records.size(), whole - 1);
      EXPECT_EQ(outcome.good_bytes, ends[whole - 1]);
      EXPECT_EQ(outcome.status, at < last ? Status::Corrupt : Status::Torn)
          << "byte " << at << ": " << outcome.error;
    }
  }
}

TEST(Capture, RefusesWhatIsNoCapture) {
  const std::string good = sample_capture();
  const auto with = [&](std::size_t at, std::uint32_t value) {
    std::string bytes = good;
    std::memcpy(&bytes[at], &value, 4);
    return bytes;
  };
  EXPECT_NE(read_all("solid cube").error.find("INCISCAP"), std::string::npos);
  EXPECT_NE(read_all(with(8, 2)).error.find("capture version 2, accepted is 1"), std::string::npos);
  EXPECT_NE(read_all(with(12, kMaxCaptureHeaderBytes + 1)).error.find("accepted are at most"),
            std::string::npos);
  // A header that is whole and yet not one of ours.
  for (const char* json : {"", "{", "[]", "7", R"({"format":"other"})", R"({"format":"incise-capture"})",
                           R"({"format":"incise-capture","mesh":{"path":1,"content_hash":""}})"}) {
    std::string bytes = good.substr(0, 12);
    const std::uint32_t length = static_cast<std::uint32_t>(std::strlen(json));
    const std::uint32_t crc = crc32c(std::as_bytes(std::span(json, length)));
    bytes.append(reinterpret_cast<const char*>(&length), 4);
    bytes.append(reinterpret_cast<const char*>(&crc), 4);
    const Outcome outcome = read_all(bytes + json);
    EXPECT_EQ(outcome.status, Status::Corrupt) << json;
    EXPECT_NE(outcome.error.find("header"), std::string::npos) << outcome.error;
  }
}

TEST(Capture, IsToldByItsFirstBytes) {
  std::istringstream good(sample_capture()), other("time x y z\n"), empty("");
  EXPECT_EQ(capture_beginning(good), CaptureBeginning::Whole);
  EXPECT_EQ(capture_beginning(other), CaptureBeginning::Other);
  EXPECT_EQ(capture_beginning(empty), CaptureBeginning::Torn) << "a crash may have left nothing";
  EXPECT_EQ(capture_beginning("INCIS"), CaptureBeginning::Torn);
  EXPECT_EQ(capture_beginning("INCISION"), CaptureBeginning::Other);
  // Whoever asked can read on, also where the file was shorter than the first bytes.
  EXPECT_TRUE(CaptureReader(good).header_ok());
  std::string word;
  EXPECT_TRUE(other >> word && word == "time");
  EXPECT_EQ(empty.tellg(), 0);
}

// A record as bytes, its checksum right.
std::string record_bytes(std::uint8_t type, const std::string& payload) {
  const std::string body = static_cast<char>(type) + payload;
  const auto length = static_cast<std::uint32_t>(payload.size());
  const std::uint32_t crc = crc32c(std::as_bytes(std::span(body)));
  std::string out(reinterpret_cast<const char*>(&length), 4);
  out.append(reinterpret_cast<const char*>(&crc), 4);
  return out + body;
}

TEST(Capture, UnknownRecordTypesArePassedOver) {
  const std::string good = sample_capture();
  const std::size_t header = boundaries(good)[0];
  const std::string bytes =
      good.substr(0, header) + record_bytes(200, "from a later version") + good.substr(header);
  std::istringstream in(bytes);
  CaptureReader reader(in);
  CaptureRecord record;
  ASSERT_EQ(reader.next(record), Status::Record);
  EXPECT_TRUE(std::holds_alternative<PoseRecord>(record));
  EXPECT_EQ(reader.unknown_records(), 1u);
  EXPECT_EQ(reader.records(), 2u);
}

TEST(Capture, WrongContentsUnderARightChecksumAreCorrupt) {
  const std::string good = sample_capture();
  const std::size_t header = boundaries(good)[0];
  for (const std::uint8_t type : std::initializer_list<std::uint8_t>{1, 2, 3, 5, 6, 7, 8, 9}) {
    for (const std::size_t size : {std::size_t{0}, std::size_t{3}}) {
      const Outcome outcome = read_all(good.substr(0, header) + record_bytes(type, std::string(size, '\1')));
      EXPECT_EQ(outcome.status, Status::Corrupt) << int{type};
      EXPECT_NE(outcome.error.find("type " + std::to_string(type)), std::string::npos) << outcome.error;
    }
  }
  // A stroke action and a bool that do not exist.
  std::string stroke(21, '\0');
  stroke[4] = 3;
  EXPECT_EQ(read_all(good.substr(0, header) + record_bytes(2, stroke)).status, Status::Corrupt);
  // Positions whose count says more than there is: nothing is allocated for it.
  std::string positions(41, '\0');
  std::memset(&positions[36], 0xff, 4);
  EXPECT_EQ(read_all(good.substr(0, header) + record_bytes(7, positions)).status, Status::Corrupt);
  // A flag that does not exist.
  std::string flags(41, '\0');
  EXPECT_EQ(read_all(good.substr(0, header) + record_bytes(7, flags)).status, Status::End);
  flags[40] = 4;
  EXPECT_EQ(read_all(good.substr(0, header) + record_bytes(7, flags)).status, Status::Corrupt);
}

TEST(Capture, EveryStrokeActionComesBack) {
  for (const auto action : {StrokeAction::Engage, StrokeAction::End, StrokeAction::HandOver}) {
    FailingSink sink;
    CaptureWriter writer(sink, samples::capture_header());
    writer.append(StrokeRecord{1, action, 2, 3});
    EXPECT_FALSE(writer.flush());
    EXPECT_EQ(read_all(sink.bytes).records, (std::vector<CaptureRecord>{StrokeRecord{1, action, 2, 3}}));
  }
}

// A server that goes on with a capture writes behind its end.
TEST(Capture, IsClosedOnlyWhereItsEndIsTheLastRecord) {
  FailingSink sink;
  CaptureWriter writer(sink, samples::capture_header());
  for (const bool closed : {true, false, true}) {
    if (closed) {
      writer.append(EndRecord{writer.records()});
    } else {
      writer.append(CheckpointRecord{7});
    }
    EXPECT_FALSE(writer.flush());
    EXPECT_EQ(read_all(sink.bytes).closed, closed);
  }
}

TEST(Capture, AGoodRecordIsFoundAtTheVeryEnd) {
  const std::string good = sample_capture();
  std::string wrong = record_bytes(1, std::string(10, 'x'));
  wrong.back() ^= 1;
  EXPECT_EQ(read_all(good + wrong).status, Status::Torn);
  constexpr int kTypes = std::variant_size_v<CaptureRecord>;
  for (int type = 1; type <= kTypes; ++type) {
    EXPECT_EQ(read_all(good + wrong + record_bytes(static_cast<std::uint8_t>(type), "")).status,
              Status::Corrupt)
        << "of type " << type;
  }
  for (const int type : {0, kTypes + 1})
    EXPECT_EQ(read_all(good + wrong + record_bytes(static_cast<std::uint8_t>(type), "")).status,
              Status::Torn);
}

TEST(Capture, MutationsNeverCrashTheReader) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  const std::string good = sample_capture();
  for (int i = 0; i < 3000; ++i) {
    std::string bytes = good;
    for (std::uint64_t n = 1 + random() % 8; n > 0; --n) {
      const std::size_t at = random() % bytes.size();
      switch (random() % 4) {
        case 0:
          bytes[at] = static_cast<char>(random());
          break;
        case 1:
          bytes.erase(at, random() % 16);
          break;
        case 2:
          bytes.insert(at, random() % 16, static_cast<char>(random()));
          break;
        default:
          bytes.insert(at, bytes.substr(random() % bytes.size(), random() % 100));
          break;
      }
    }
    const Outcome outcome = read_all(bytes);
    EXPECT_NE(outcome.status, Status::Record);
    if (outcome.status != Status::End) {
      EXPECT_FALSE(outcome.error.empty());
    }
  }
}

// ---- The writer when I/O fails ----

TEST(Capture, EveryFailingCallLeavesWholeRecordsAndLosesNone) {
  const auto records = samples::capture_records();
  const std::string expected = sample_capture();
  for (int fail_at = 0; fail_at < 24; ++fail_at) {
    FailingSink sink;
    sink.fail_at = fail_at;
    sink.fail_times = 2;
    CaptureWriter writer(sink, samples::capture_header());
    for (const CaptureRecord& record : records) {
      writer.append(record);
      writer.flush();  // may fail: the buffer keeps what was not written
    }
    for (int attempt = 0; writer.pending_bytes() > 0 && attempt < 5; ++attempt) writer.flush();
    EXPECT_EQ(sink.bytes, expected) << "call " << fail_at;
    EXPECT_EQ(writer.written_bytes(), expected.size());
    EXPECT_EQ(writer.records(), records.size());
  }
}

TEST(Capture, WhatIsDroppedLeavesAGapRecordAndAReadableFile) {
  FailingSink sink;
  CaptureWriter writer(sink, samples::capture_header());
  writer.append(samples::capture_records()[0]);
  ASSERT_FALSE(writer.flush());
  sink.fail_at = 1;  // the next call
  writer.append(samples::capture_records()[0]);
  writer.append(samples::capture_records()[2]);
  EXPECT_EQ(writer.flush(), std::errc::no_space_on_device);
  const CaptureWriter::Dropped dropped = writer.drop_pending();
  EXPECT_EQ(dropped.records, 2u);
  EXPECT_EQ(dropped.bytes, 9u + 80u + 9u + 37u);
  writer.append(GapRecord{dropped.records, dropped.bytes, 1, 2, "disk full"});
  ASSERT_FALSE(writer.flush());
  EXPECT_EQ(writer.records(), 2u);
  const Outcome outcome = read_all(sink.bytes);
  EXPECT_EQ(outcome.status, Status::End) << outcome.error;
  ASSERT_EQ(outcome.records.size(), 2u);
  EXPECT_EQ(std::get<GapRecord>(outcome.records[1]).records, 2u);
}

TEST(Capture, ADroppedBufferKeepsAHeaderThatWasNeverWritten) {
  FailingSink sink;
  sink.fail_at = 0;
  CaptureWriter writer(sink, samples::capture_header());
  writer.append(samples::capture_records()[0]);
  EXPECT_TRUE(writer.flush());
  writer.drop_pending();
  writer.append(samples::capture_records()[2]);
  EXPECT_FALSE(writer.flush());
  const Outcome outcome = read_all(sink.bytes);
  EXPECT_EQ(outcome.status, Status::End) << outcome.error;
  EXPECT_EQ(outcome.records.size(), 1u);
}

TEST(Capture, AFileIsResumedBehindItsLastWholeRecord) {
  const auto path = (std::filesystem::path(::testing::TempDir()) / "capture_test_resume.incise").string();
  {
    FileSink sink(path, true);
    CaptureWriter writer(sink, samples::capture_header());
    for (int i = 0; i < 3; ++i) writer.append(samples::capture_records()[0]);
    ASSERT_FALSE(writer.flush());
    ASSERT_FALSE(writer.sync());
  }
  std::filesystem::resize_file(path, std::filesystem::file_size(path) - 5);  // a torn last record
  std::uint64_t good = 0, count = 0;
  {
    std::ifstream in(path, std::ios::binary);
    CaptureReader reader(in);
    CaptureRecord record;
    while (reader.next(record) == Status::Record) {
    }
    good = reader.good_bytes();
    count = reader.records();
  }
  EXPECT_EQ(count, 2u);
  {
    FileSink sink(path, false);
    CaptureWriter writer(sink, good, count);
    writer.append(EndRecord{writer.records()});
    ASSERT_FALSE(writer.flush());
  }
  std::ifstream in(path, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  const Outcome outcome = read_all(bytes);
  EXPECT_EQ(outcome.status, Status::End) << outcome.error;
  ASSERT_EQ(outcome.records.size(), 3u);
  EXPECT_EQ(std::get<EndRecord>(outcome.records[2]).records, 2u);
  EXPECT_TRUE(outcome.closed);
  std::filesystem::remove(path);
}

TEST(Capture, AFileThatCannotBeOpenedIsNamed) {
  try {
    FileSink sink("/nowhere/at/all.incise", true);
    FAIL();
  } catch (const std::system_error& e) {
    EXPECT_NE(std::string(e.what()).find("/nowhere/at/all.incise"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace incise::protocol
