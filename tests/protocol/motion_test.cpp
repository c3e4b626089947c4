#include "protocol/motion.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <random>
#include <sstream>

#include "protocol/limits.hpp"

namespace incise::protocol {
namespace {

Motion read(const std::string& text, Times times = Times::kSkip) {
  std::istringstream in(text);
  return read_motion(in, "m.csv", times);
}

std::string error_of(const std::string& text, Times times = Times::kSkip) {
  try {
    read(text, times);
  } catch (const MotionError& e) {
    return e.what();
  }
  ADD_FAILURE() << "accepted: " << text.substr(0, 200);
  return {};
}

TEST(Motion, ReadsTum) {
  const Motion m = read(
      "# timestamp tx ty tz qx qy qz qw\n"
      "1305031102.175304 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\n"
      "\n"
      "  1305031102.185300\t1.3543 0.6306 1.6360 0 0 0 1  \r\n");
  ASSERT_EQ(m.samples.size(), 2u);
  EXPECT_TRUE(m.has_orientation);
  EXPECT_FALSE(m.has_buttons);
  // To the nanosecond, which a double of that size does not hold.
  EXPECT_EQ(m.samples[0].source_ns, 1305031102175304000);
  EXPECT_EQ(m.samples[1].source_ns, 1305031102185300000);
  EXPECT_EQ(m.samples[0].position, (Vec3{1.3563, 0.6305, 1.6380}));
  const Quat& q = m.samples[0].orientation;
  EXPECT_NEAR(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z, 1, 1e-15);
  EXPECT_NEAR(q.w, -0.3986, 1e-4);
  EXPECT_NEAR(q.x, 0.6132, 1e-4);
  EXPECT_EQ(m.samples[1].orientation, (Quat{1, 0, 0, 0}));
}

TEST(Motion, ReadsCsvByTheNamesOfItsColumns) {
  const Motion m = read(
      "\xef\xbb\xbf button , z_m,y_m,x_m,t_s,comment,qw,qz,qy,qx\n"
      "# a pause\n"
      "1,3,2,1,0.5,first,0.5,-0.5,0.5,-0.5\n"
      "2147483648,3,2,1,6e-1,,1,0,0,0\n");
  ASSERT_EQ(m.samples.size(), 2u);
  EXPECT_EQ(m.samples[0], (PoseSample{500'000'000, {1, 2, 3}, {0.5, -0.5, 0.5, -0.5}, 1, 0}));
  EXPECT_EQ(m.samples[1].buttons, 0x80000000u);
}

TEST(Motion, ReadsCsvThatIsSeparatedBySemicolons) {
  const Motion m = read("t_s;x_m;y_m;z_m;comment\n0;1;2;3;a, b\n0.5;1;2;4;\n");
  ASSERT_EQ(m.samples.size(), 2u);
  EXPECT_EQ(m.samples[1].position, (Vec3{1, 2, 4}));
  EXPECT_EQ(read("t_s,x_m,y_m,z_m,comment\n0,1,2,3,a; b\n").samples.size(), 1u);
}

TEST(Motion, PositionsAloneAreEnough) {
  const Motion m = read("t_s,x_m,y_m,z_m\n-0.25,0,0,0\n0,0,0,1\n+0.000000001,0,0,2\n");
  ASSERT_EQ(m.samples.size(), 3u);
  EXPECT_FALSE(m.has_orientation);
  EXPECT_EQ(m.samples[0].source_ns, -250'000'000);
  EXPECT_EQ(m.samples[2].source_ns, 1);
  EXPECT_EQ(m.samples[2].orientation, (Quat{1, 0, 0, 0}));
}

TEST(Motion, SamplesWhoseTimeDoesNotRiseAreSkippedAndCountedInEveryFormat) {
  const struct {
    const char *csv, *tum;
    std::size_t kept, skipped;
    const char* warning;
  } cases[] = {
      {"t_s,x_m,y_m,z_m\n0,1,2,3\n0,1,2,3\n1,1,2,3\n",
       "#\n0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", 2, 1,
       "m.csv: skipped 1 of 3 samples: its time does not rise (line 3: time 0 s after 0 s); --strict "
       "refuses"},
      {"t_s,x_m,y_m,z_m\n0,1,2,3\n0.125,1,2,4\n0.125,1,2,5\n1,1,2,3\n",
       "#\n0 1 2 3 0 0 0 1\n0.125 1 2 4 0 0 0 1\n0.125 1 2 5 0 0 0 1\n1 1 2 3 0 0 0 1\n", 3, 1,
       "(line 4: time 0.125 s after 0.125 s)"},
      {"t_s,x_m,y_m,z_m\n2,1,2,3\n-1.5,1,2,4\n1.999999999,1,2,5\n3,1,2,3\n",
       "#\n2 1 2 3 0 0 0 1\n-1.5 1 2 4 0 0 0 1\n1.999999999 1 2 5 0 0 0 1\n3 1 2 3 0 0 0 1\n", 2, 2,
       "skipped 2 of 4 samples: their times do not rise (first line 3: time -1.5 s after 2 s)"},
  };
  for (const auto& c : cases) {
    for (const char* text : {c.csv, c.tum}) {
      const Motion m = read(text);
      EXPECT_EQ(m.samples.size(), c.kept) << text;
      EXPECT_EQ(m.not_rising, c.skipped) << text;
      EXPECT_NE(m.warning.find(c.warning), std::string::npos) << m.warning;
      std::istringstream in(text);
      EXPECT_THROW(read_motion(in, "m", Times::kRefuse), MotionError) << text;
    }
  }
  EXPECT_EQ(read("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n").warning, "");
}

TEST(Motion, AClockThatRestartsBeginsANewStroke) {
  const std::string csv =
      "t_s,x_m,y_m,z_m\n5,0,0,0\n5.01,0,0,1\n0,0,0,2\n0.01,0,0,3\n0.02,0,0,4\n0,0,0,9\n0.03,0,0,5\n";
  const Motion m = read(csv);
  ASSERT_EQ(m.samples.size(), 6u);
  EXPECT_EQ(m.restarts, std::vector<std::size_t>{2});
  EXPECT_EQ(m.not_rising, 1u) << "the sample at z = 9";
  const std::int64_t expected_ns[] = {5'000'000'000, 5'010'000'000, 6'010'000'000,
                                      6'020'000'000, 6'030'000'000, 6'040'000'000};
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(m.samples[i].source_ns, expected_ns[i]) << i;
    EXPECT_EQ(m.samples[i].position.z, static_cast<double>(i)) << i;
  }
  EXPECT_EQ(m.warning,
            "m.csv: skipped 1 of 7 samples: its time does not rise (line 7: time 0 s after 0.02 s); --strict "
            "refuses such files; the clock restarts once (line 4: time 0 s after 5.01 s): what follows is "
            "kept as a new stroke, a second later");
  EXPECT_EQ(error_of(csv, Times::kRefuse), "m.csv:4: time 0 s after 5.01 s, accepted are rising times");
  EXPECT_EQ(read(csv + "0,0,0,6\n").samples.size(), 6u) << "the last sample alone shows no restart";
  EXPECT_EQ(read("t_s,x_m,y_m,z_m\n3,0,0,0\n0,0,0,1\n0.5,0,0,2\n3,0,0,3\n0,0,0,4\n0.5,0,0,5\n").restarts,
            (std::vector<std::size_t>{1, 4}));
  // Ages apart, or beyond what a time may be: one line, or as before.
  EXPECT_EQ(read("t_s,x_m,y_m,z_m\n9e9,0,0,0\n-9e9,0,0,1\n-8999999999.5,0,0,2\n").samples.size(), 1u);
  EXPECT_EQ(error_of("t_s,x_m,y_m,z_m\n1e9,0,0,0\n0,0,0,1\n0.5,0,0,2\n8999999999,0,0,3\n"),
            "m.csv:5: t_s is out of range after the clock's restart");
}

TEST(Motion, TimesAreWrittenAsInTheFile) {
  EXPECT_EQ(seconds_text(1305031102175304000), "1305031102.175304 s");
  EXPECT_EQ(seconds_text(-1), "-0.000000001 s");
  EXPECT_EQ(seconds_text(0), "0 s");
  EXPECT_EQ(seconds_text(INT64_MIN), "-9223372036.854775808 s");
}

TEST(Motion, WhatIsNoMotionAtAllIsToldFromABrokenOne) {
  for (const char* text : {"root:x:0:0\n", "", "#\n", "a,b\n1,2\n", "<VTKFile>\n", "t_s,x_m,y_m,z_m\n"}) {
    std::istringstream in(text);
    EXPECT_THROW(read_motion(in, "m"), NotAMotion) << text;
  }
  for (const char* text : {"0 0 0\n", "t_s,x_m,y_m,z_m\n1,2\n"}) {
    std::istringstream in(text);
    try {
      read_motion(in, "m");
      ADD_FAILURE() << text;
    } catch (const NotAMotion& error) {
      ADD_FAILURE() << error.what();
    } catch (const MotionError&) {
    }
  }
}

TEST(Motion, ABladeLiesWithinTenKilometres) {
  const BladeEdge blade = parse_blade("--blade", "-10000,0,1:10000,2,3.5");
  EXPECT_EQ(blade.heel, (Vec3{-10000, 0, 1}));
  EXPECT_EQ(blade.tip, (Vec3{10000, 2, 3.5}));
  for (const char* text : {"0,0,0:10001,0,0", "-10001,0,0:0,0,0", "0,0,0:0,0,0", "0,0,0,1,0,0", "0,0,0:1,0",
                           "0,0,0:1,0,0,0", "", "a,0,0:1,0,0", "nan,0,0:1,0,0"}) {
    EXPECT_THROW(parse_blade("--blade", text), MotionError) << text;
  }
}

TEST(Motion, ErrorsNameFileLineAndWhatIsAccepted) {
  const std::string head = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n";
  struct Case {
    std::string text, expected;
  };
  const Case cases[] = {
      {"", "m.csv: the file is empty; accepted are TUM lines"},
      {"# nothing\n\n", "m.csv: no samples, only comments"},
      {head, "m.csv: no samples behind the header"},
      {"root:x:0:0\n", "m.csv:1: not a motion: it begins with 'root:x:0:0'"},
      {"0\n", "m.csv:1: 1 field, accepted are 8"},
      {"t_s,x_m,y_m\n", "m.csv:1: no column z_m; accepted are t_s,x_m"},
      {"0,1,2,3\n",
       "m.csv:1: the first line of a CSV has the columns' names, in any order; it should be t_s,x_m"},
      {"0;1;2;3\n", "m.csv:1: the first line of a CSV has the columns' names"},
      {"a,b\n", "m.csv:1: no column t_s"},
      {"t_s;x_m;y_m;z_m\n0;0,5;0;0\n",
       "m.csv:2: x_m is '0,5', accepted are finite numbers with a decimal point"},
      {"t_s;x_m;y_m;z_m\n0,5;1;0;0\n",
       "m.csv:2: t_s is '0,5', accepted are seconds within +-9e9 with a decimal point"},
      {"t_s,x_m,y_m,z_m,x_m\n", "m.csv:1: column x_m twice"},
      {"t_s,x_m,y_m,z_m,qw\n", "m.csv:1: only some of the columns qw, qx, qy, qz"},
      {head + "0,0,0,0,1,0,0,0\n", "m.csv:2: 8 fields where the header has 9"},
      {head + "0,0,0,0,1,0,0,0,0,0\n", "m.csv:2: 10 fields"},
      {head + "a,0,0,0,1,0,0,0,0\n", "m.csv:2: t_s is 'a', accepted are seconds"},
      {head + "1e300,0,0,0,1,0,0,0,0\n", "m.csv:2: t_s is '1e300'"},
      {head + "nan,0,0,0,1,0,0,0,0\n", "m.csv:2: t_s is 'nan'"},
      {head + "0,inf,0,0,1,0,0,0,0\n", "m.csv:2: x_m is 'inf', accepted are finite numbers"},
      {head + "0,,0,0,1,0,0,0,0\n", "m.csv:2: x_m is ''"},
      {head + "0,1.5x,0,0,1,0,0,0,0\n", "m.csv:2: x_m is '1.5x'"},
      {head + "0,0,2e6,0,1,0,0,0,0\n", "m.csv:2: y_m is 2e6, accepted are coordinates"},
      {head + "0,0,0,0,0,0,0,0,0\n", "m.csv:2: quaternion of length 0.000000, accepted are 0.9 to 1.1"},
      {head + "0,0,0,0,2,0,0,0,0\n", "m.csv:2: quaternion of length 2"},
      {head + "0,0,0,0,1,0,0,0,0.5\n", "m.csv:2: button is '0.5', accepted are whole numbers"},
      {head + "0,0,0,0,1,0,0,0,-1\n", "m.csv:2: button is '-1'"},
      {head + "0,0,0,0,1,0,0,0,4294967296\n", "m.csv:2: button is '4294967296'"},
      {head + "1e10,0,0,0,1,0,0,0,0\n", "m.csv:2: t_s is '1e10', accepted are seconds"},
      {head + "0,0,0,0,1,0,0,0,0\n\xef\xbb\xbf"
              "1,0,0,0,1,0,0,0,0\n",
       "m.csv:3: t_s is "},
      {"0 0 0 0 0 0 0\n", "m.csv:1: 7 fields, accepted are 8: t x y z qx qy qz qw"},
      {"0 0 0 0 0 0 0 1 0\n", "m.csv:1: 9 fields"},
      {"0 0 0 0 0 0 0 one\n", "m.csv:1: qw is 'one'"},
      {"0 0 0 0 0 0 0 1\n0 0 0 0\n", "m.csv:2: 4 fields"},
      {std::string(kMaxMotionLineBytes + 1, '1'), "m.csv:1: line of more than 4096 bytes"},
      {std::string("0 0 0 0 0 0 0 1\n\0 1", 19), "m.csv:2: "},
  };
  for (const Case& c : cases) {
    const std::string error = error_of(c.text);
    EXPECT_TRUE(error.starts_with(c.expected)) << "expected: " << c.expected << "\n     got: " << error;
    EXPECT_EQ(error.find('\n'), std::string::npos);
  }
  EXPECT_THROW(read_motion("/nowhere/motion.csv"), MotionError);
}

TEST(Motion, MutationsGiveAnErrorOrRisingUnitPoses) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  const std::string good =
      "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n0.000,0.1,0.2,0.3,1,0,0,0,0\n0.001,0.1,0.2,0.3,0.5,-0.5,0.5,-0.5,"
      "1\n"
      "0.002,0.1,0.2,0.3,0.5,-0.5,0.5,-0.5,1\n";
  constexpr char kLikely[] = "0123456789.,-+eE \n#\r\tnaif";
  int refused = 0;
  for (int i = 0; i < 20000; ++i) {
    std::string text = good;
    for (std::uint64_t n = 1 + random() % 4; n > 0; --n) {
      const std::size_t at = random() % text.size();
      switch (random() % 3) {
        case 0:
          text[at] = kLikely[random() % (sizeof kLikely - 1)];
          break;
        case 1:
          text.erase(at, 1 + random() % 8);
          break;
        default:
          text.insert(at, 1, static_cast<char>(random()));
          break;
      }
      if (text.empty()) text = " ";
    }
    std::istringstream in(text);
    try {
      const Motion m = read_motion(in, "m");
      for (std::size_t k = 0; k < m.samples.size(); ++k) {
        const Quat& q = m.samples[k].orientation;
        EXPECT_NEAR(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z, 1, 1e-12);
        if (k > 0) {
          EXPECT_GT(m.samples[k].source_ns, m.samples[k - 1].source_ns);
        }
      }
    } catch (const MotionError& e) {
      ++refused;
      EXPECT_TRUE(std::string(e.what()).starts_with("m:")) << e.what();
    }
  }
  EXPECT_GT(refused, 1000);
}

TEST(Motion, ReadsRecordingsOfRealHands) {
  const char* data = std::getenv("INCISE_DATA");
  if (data == nullptr) GTEST_SKIP() << "INCISE_DATA is not set: no recorded motions";
  struct Case {
    const char* file;
    std::size_t samples;
    bool orientation, buttons;
  };
  const Case cases[] = {{"geomagic_liver.csv", 2803, true, true},
                        {"dvrk_psm2.csv", 3420, true, false},
                        {"touch_tracking_b1.csv", 8320, false, true},
                        {"tum_fr1_xyz.csv", 3000, true, false}};
  for (const Case& c : cases) {
    const Motion m = read_motion(std::string(data) + "/motions/" + c.file);
    EXPECT_EQ(m.samples.size(), c.samples) << c.file;
    EXPECT_EQ(m.not_rising, 0u) << c.file;
    EXPECT_EQ(m.has_orientation, c.orientation) << c.file;
    EXPECT_EQ(m.has_buttons, c.buttons) << c.file;
  }
}

}  // namespace
}  // namespace incise::protocol
