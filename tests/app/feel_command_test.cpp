// `incise feel`, as a user runs it: the built program, its files, exit codes and messages.

#include <gtest/gtest.h>

#include <boost/property_tree/ptree.hpp>
#include <boost/property_tree/xml_parser.hpp>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "server/app/capture_journal.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/support/bodies.hpp"
#include "tests/support/run_program.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using tests::RunResult;

class Feel : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ = tests::fresh_directory(::testing::UnitTest::GetInstance()->current_test_info()->name());
  }
  void TearDown() override {
    if (!HasFailure()) fs::remove_all(dir_);
  }

  RunResult run(const std::vector<std::string>& arguments) {
    return tests::run_program("incise", arguments, dir_);
  }
  void write(const std::string& name, const std::string& text) {
    std::ofstream(dir_ / name, std::ios::binary) << text;
  }
  std::string bytes(const std::string& name) { return tests::read_file(dir_ / name); }

  // The phantom slab, whose flat top is at z = 0.02.
  void write_slab() {
    const RunResult made = run({"phantom", "slab", "--size", "2000", "--out", "slab.node"});
    ASSERT_EQ(made.exit_code, 0) << made.err;
  }
  // A tool whose blade, 5 cm below it, goes straight down in 1 s at 1 kHz: its tip from 1 mm above the slab to `depth_m`.
  static std::string press(double depth_m, const char* line_format) {
    std::string text;
    for (int i = 0; i <= 1000; ++i) {
      char line[160];
      std::snprintf(line, sizeof line, line_format, 0.001 * i, 0.07 + 0.001 - (0.001 + depth_m) * 0.001 * i);
      text += line;
    }
    return text;
  }
  void write_press(double depth_m) {
    write("press.csv",
          "t_s,x_m,y_m,z_m,button\n" + press(depth_m, "%.3f,0.05,0.03,%.17g,0\n"));  // not engaged
  }

  // A table by the names of its columns; the source's name is left out.
  std::vector<std::map<std::string, double>> rows(const std::string& name) {
    std::istringstream text(bytes(name));
    const auto fields = [](const std::string& line) {
      std::vector<std::string> all;
      std::istringstream in(line);
      for (std::string field; std::getline(in, field, ',');) all.push_back(field);
      return all;
    };
    std::string line;
    std::getline(text, line);
    const std::vector<std::string> names = fields(line);
    std::vector<std::map<std::string, double>> table;
    while (std::getline(text, line)) {
      const std::vector<std::string> values = fields(line);
      EXPECT_EQ(values.size(), names.size()) << line;
      auto& row = table.emplace_back();
      for (std::size_t i = 0; i < std::min(names.size(), values.size()); ++i) {
        if (names[i] != "source") row[names[i]] = std::stod(values[i]);
      }
    }
    return table;
  }

  fs::path dir_;
};

void expect_error(const RunResult& result, int exit_code, const std::vector<std::string>& parts) {
  EXPECT_EQ(result.exit_code, exit_code) << result.err;
  EXPECT_EQ(result.out, "");
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  for (const std::string& part : parts)
    EXPECT_NE(result.err.find(part), std::string::npos) << result.err << "lacks " << part;
}

// Two poses of a capture between which the blade goes right through. Their boxes meet, so neither units nor frames are to blame.
TEST_F(Feel, PosesOnEitherSideOfTheBodyAreSaidToBeFarApart) {
  write_slab();
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.05]}, "cut": {"engage": "always"}})");
  write("two.csv", "t_s,x_m,y_m,z_m\n0,0.05,-0.05,0.05\n1,0.05,0.2,0.05\n");
  ASSERT_EQ(
      run({"convert", "two.csv", "--mesh", "slab", "--config", "c.json", "--out", "two.capture"}).exit_code,
      0);
  const RunResult result = run({"feel", "two.capture", "--mesh", "slab"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_NE(
      result.err.find("no contact: the blade came near the body, but at no pose is it in there; forces are "
                      "computed at poses, and these are up to 1 s apart"),
      std::string::npos)
      << result.err;
  EXPECT_EQ(result.err.find("units"), std::string::npos) << result.err;
}

// The elastic foundation: under a point, and for each metre of edge inside (material.hpp).
TEST_F(Feel, APressedBladeFeelsTheMaterialsConstants) {
  write_slab();
  write_press(0.004);
  const struct { double point_n_m, edge_n_m2; } materials[] = {{300, 40e3}, {600, 40e3}, {300, 120e3}};
  for (const auto& material : materials) {
    write("c.json",
          json{{"haptics", {{"stiffness_n_m", material.point_n_m}, {"stiffness_pa", material.edge_n_m2}}}}
              .dump());
    const RunResult result =
        run({"feel", "press.csv", "--mesh", "slab", "--config", "c.json", "--out", "f.csv", "--json"});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    const auto table = rows("f.csv");
    ASSERT_EQ(table.size(), 1001u);
    std::size_t compared = 0;
    for (const auto& row : table) {
      const double depth = 0.02 - (row.at("z_m") - 0.05);
      EXPECT_EQ(row.at("contact"), depth > 1e-9 ? 1 : 0) << depth;
      EXPECT_EQ(row.at("inside"), 0);
      if (depth < 0.001) continue;
      const double expected = (material.point_n_m + material.edge_n_m2 * depth) * depth;
      EXPECT_NEAR(row.at("f_n"), expected, 0.05 * expected) << depth;
      EXPECT_NEAR(row.at("fz_n"), expected, 0.05 * expected) << depth;
      EXPECT_NEAR(row.at("depth_m"), depth, 1e-5);
      EXPECT_NEAR(row.at("edge_inside_m"), depth, 1e-5);
      ++compared;
    }
    EXPECT_GE(compared, 590u);
    const json blade = json::parse(result.out)["blades"][0];
    const double peak = (material.point_n_m + material.edge_n_m2 * 0.004) * 0.004;
    EXPECT_NEAR(blade["peak_force_n"].get<double>(), peak, 0.05 * peak);
    EXPECT_NEAR(blade["peak_time_s"].get<double>(), 1.0, 0.01);
    // The work against the spring that grows with depth.
    const double work = 0.5 * material.point_n_m * 1.6e-5 + material.edge_n_m2 * 6.4e-8 / 3;
    EXPECT_NEAR(blade["work_by_hand_j"].get<double>(), work, 0.05 * work);
    EXPECT_NEAR(blade["contact_s"].get<double>(), 0.8, 0.01);
    EXPECT_EQ(blade["punctures"].size(), 0u);
  }
}

// Two poses on either side of the body are felt as the motion between them, sampled by a device, is.
TEST_F(Feel, ACoarseMotionIsFeltBetweenItsPoses) {
  write_slab();
  const char* const format = "%.3f %.17g 0.03 0.06 %.17g 0 0 %.17g\n";
  const auto motion = [&](int steps) {
    std::string text;
    for (int i = 0; i <= steps; ++i) {
      const double u = static_cast<double>(i) / steps, half_angle = 0.2 * u;
      char line[160];
      std::snprintf(line, sizeof line, format, u, -0.05 + 0.2 * u, std::sin(half_angle),
                    std::cos(half_angle));
      text += line;
    }
    return text;
  };
  const auto feel = [&](int steps) {
    write("pass.tum", motion(steps));
    const RunResult result = run({"feel", "pass.tum", "--mesh", "slab", "--out", "f.csv", "--json"});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(rows("f.csv").size(), 1001u);
    const json report = json::parse(result.out);
    EXPECT_EQ(report["interpolated_poses"], 1000 - steps);
    return report["blades"][0];
  };
  const json fine = feel(1000);
  EXPECT_GT(fine["peak_force_n"].get<double>(), 0.5);
  for (const int steps : {1, 5}) {
    const json coarse = feel(steps);
    for (const char* key : {"peak_force_n", "mean_force_in_contact_n", "inside_s", "work_by_hand_j"})
      EXPECT_NEAR(coarse[key].get<double>(), fine[key].get<double>(), 0.02 * fine[key].get<double>()) << key;
  }
}

// Nothing is felt on the way of a jump, nor does a button count as held before it is at both ends.
TEST_F(Feel, AJumpIsNotInterpolated) {
  write_slab();
  std::string text = "t_s,x_m,y_m,z_m,button\n";
  for (int i = 0; i < 40; ++i) {
    char line[96];
    const bool far = i >= 20;
    std::snprintf(line, sizeof line, "%.3f,%.3f,0.03,0.06,%d\n", 0.01 * i + (far ? 5 : 0), far ? 0.3 : -0.2,
                  i % 2);
    text += line;
  }
  write("jump.csv", text);
  write("c.json", "{}");
  const RunResult result =
      run({"feel", "jump.csv", "--mesh", "slab", "--config", "c.json", "--out", "f.csv", "--json"});
  EXPECT_EQ(result.exit_code, 3) << result.err;
  const auto table = rows("f.csv");
  EXPECT_EQ(table.size(), 40u + 38u * 9u);
  std::size_t engaged = 0;
  for (const auto& row : table) engaged += row.at("engaged") != 0;
  EXPECT_EQ(engaged, 20u);
}

// An engaged point holds up to the puncture force.
TEST_F(Feel, APunctureIsFoundAtItsForce) {
  write_slab();
  write("press.tum", press(0.01, "%.3f 0.05 0.03 %.17g 0 0 0 1\n"));
  write("c.json", R"({"haptics": {"puncture_n": 1.2, "toughness_j_m2": 20}})");
  const RunResult result = run({"feel", "press.tum", "--mesh", "slab", "--config", "c.json", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json blade = json::parse(result.out)["blades"][0];
  ASSERT_EQ(blade["punctures"].size(), 1u) << result.out;
  EXPECT_NEAR(blade["punctures"][0]["force_n"].get<double>(), 1.2, 0.06);
  EXPECT_GT(blade["inside_s"], 0.5);
}

// A capsule over parenchyma is felt as a pop: the point presses up to what the capsule holds, then meets what lies below alone, which tears by
// its toughness. The shipped materials say how large both are.
TEST_F(Feel, ACapsuleOverParenchymaIsFeltAsAPop) {
  ASSERT_EQ(run({"phantom", "slab", "--size", "20000", "--capsule", "--out", "slab.node"}).exit_code, 0);
  write("press.tum", press(0.012, "%.3f 0.05 0.03 %.17g 0 0 0 1\n"));
  const std::string tissues = (fs::path(INCISE_SOURCE_DIR) / "config" / "tissues.json").string();
  const RunResult result =
      run({"feel", "press.tum", "--mesh", "slab", "--config", tissues, "--out", "f.csv", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json blade = json::parse(result.out)["blades"][0];
  ASSERT_EQ(blade["punctures"].size(), 1u) << result.out;
  EXPECT_NEAR(blade["punctures"][0]["force_n"].get<double>(), 1.5, 0.075);
  const double at = blade["punctures"][0]["time_s"];
  // Below it the edge inside resists with its toughness, much less than the capsule did while little is inside: the drop.
  double least = 100, before = 0;
  for (const auto& row : rows("f.csv")) {
    if (row.at("time_s") <= at - 5e-4) before = std::max(before, row.at("tissue_f_n"));
    if (row.at("time_s") < at || row.at("time_s") > at + 0.02) continue;
    least = std::min(least, row.at("tissue_f_n"));
    EXPECT_LE(row.at("tissue_f_n"), 164 * row.at("edge_inside_m") + 0.05) << row.at("time_s");
  }
  EXPECT_NEAR(before, 1.5, 0.075);
  EXPECT_LT(least, 0.6 * before);
  // Without the capsule the same motion finds no such peak at the surface.
  ASSERT_EQ(run({"phantom", "slab", "--size", "20000", "--out", "bare.node"}).exit_code, 0);
  const RunResult bare = run({"feel", "press.tum", "--mesh", "bare", "--config", tissues, "--json"});
  ASSERT_EQ(bare.exit_code, 0) << bare.err;
  const json punctures = json::parse(bare.out)["blades"][0]["punctures"];
  for (const json& puncture : punctures) EXPECT_LT(puncture["force_n"].get<double>(), 0.7) << bare.out;
}

// With cut.engage "resistance" the blade cuts from where the tissue yields: what it has only pressed on stays whole, and is felt
// as whole when it comes again.
TEST_F(Feel, ABladeThatIsHeldBackCutsNothing) {
  write_slab();
  std::string text = "t_s,x_m,y_m,z_m,button\n";
  const auto row = [&](int i, double x, double z) {
    char line[128];
    std::snprintf(line, sizeof line, "%.3f,%.6f,0.03,%.6f,1\n", 0.001 * i, x, z);
    text += line;
  };
  // 2 mm deep, which the surface holds; across; and once more the same way.
  for (int i = 0; i <= 300; ++i) row(i, 0.03, 0.071 - 1e-5 * i);
  for (int i = 301; i <= 700; ++i) row(i, 0.03 + 1e-4 * (i - 300), 0.068);
  for (int i = 701; i <= 1100; ++i) row(i, 0.07 - 1e-4 * (i - 700), 0.068);
  write("across.csv", text);
  const auto pieces = [&](const char* engage) {
    write("c.json", json{{"cut", {{"engage", engage}}}, {"haptics", {{"puncture_n", 3}}}}.dump());
    const RunResult result =
        run({"feel", "across.csv", "--mesh", "slab", "--config", "c.json", "--out", "f.csv", "--json"});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    double uncut = 1;
    for (const auto& r : rows("f.csv"))
      if (r.at("time_s") > 0.75 && r.at("edge_inside_m") > 0)
        uncut = std::min(uncut, r.at("edge_uncut_m") / r.at("edge_inside_m"));
    return uncut;
  };
  EXPECT_EQ(pieces("resistance"), 1);
  EXPECT_LT(pieces("buttons"), 0.5);
}

TEST_F(Feel, ACaptureFeelsAsTheTextDoesAndTheSameEveryTime) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  std::string tum;
  for (const core::Pose& pose : tests::sweep_through(400)) {
    char line[256];
    std::snprintf(line, sizeof line, "%.3f %.17g %.17g %.17g %.17g %.17g %.17g %.17g\n",
                  static_cast<double>(pose.t_ns) * 1e-9, pose.position.x, pose.position.y, pose.position.z,
                  pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w);
    tum += line;
  }
  write("sweep.tum", tum);
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "haptics": {"toughness_j_m2": 20}})");
  ASSERT_EQ(run({"convert", "sweep.tum", "--mesh", "cube", "--config", "c.json", "--out", "sweep.capture"})
                .exit_code,
            0);
  const auto feel = [&](const std::string& motion, const std::string& to) {
    std::vector<std::string> arguments{"feel",  motion,      "--mesh", "cube",
                                       "--out", to + ".csv", "--svg",  to + ".svg"};
    if (motion != "sweep.capture") arguments.insert(arguments.end(), {"--config", "c.json"});
    const RunResult result = run(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(result.err, "");
  };
  feel("sweep.tum", "a");
  feel("sweep.tum", "b");
  feel("sweep.capture", "c");
  for (const char* other : {"b", "c"}) {
    EXPECT_EQ(bytes("a.csv"), bytes(std::string(other) + ".csv")) << other;
    EXPECT_EQ(bytes("a.svg"), bytes(std::string(other) + ".svg")) << other;
  }
  EXPECT_GT(rows("a.csv").size(), 390u);
}

// The second of two passes through the same place is in an open cut: friction alone.
TEST_F(Feel, ForcesKnowWhatHasBeenCut) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  std::string tum;
  for (int pass = 0; pass < 2; ++pass) {
    for (int i = 0; i < 700; ++i) {
      char line[128];
      std::snprintf(line, sizeof line, "%.3f 0.037 %.17g 0.12 0 0 0 1\n", 2.0 * pass + 0.001 * i,
                    -0.02 + 0.0002 * i);
      tum += line;
    }
  }
  write("twice.tum", tum);
  ASSERT_EQ(
      run({"feel", "twice.tum", "--mesh", "cube", "--blade", "0,0,0:0,0,-0.14", "--out", "f.csv"}).exit_code,
      0);
  double most[2] = {0, 0};
  for (const auto& row : rows("f.csv")) {
    double& largest = most[row.at("time_s") > 1.5 ? 1 : 0];
    largest = std::max(largest, row.at("tissue_f_n"));
    EXPECT_LE(row.at("f_n"), 3.3 + 1e-6);  // haptics.max_force_n
  }
  EXPECT_GT(most[0], 10);
  EXPECT_LT(most[1], 0.3 * most[0]);
}

TEST_F(Feel, WithoutContactItSaysSo) {
  write_slab();
  write("far.tum", "0 0.5 0 0.5 0 0 0 1\n0.1 0.51 0 0.5 0 0 0 1\n0.2 0.52 0 0.5 0 0 0 1\n");
  const RunResult result = run({"feel", "far.tum", "--mesh", "slab", "--out", "f.csv", "--svg", "f.svg"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_NE(result.out.find("no contact"), std::string::npos) << result.out;
  EXPECT_NE(result.err.find("warning: no contact: the blade was in (0.5"), std::string::npos) << result.err;
  const auto table = rows("f.csv");
  ASSERT_EQ(table.size(), 201u);
  for (const auto& row : table) {
    for (const char* zero : {"f_n", "fx_n", "fy_n", "fz_n", "tissue_f_n", "depth_m", "contact", "inside"})
      EXPECT_EQ(row.at(zero), 0) << zero;
  }
}

TEST_F(Feel, WhatCannotBeReadOrWrittenGetsOneLine) {
  write_slab();
  write_press(0.002);
  const auto feel = [&](const char* motion, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments{"feel", motion, "--mesh", "slab"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  };
  expect_error(run({"feel", "press.csv"}), 2, {"--mesh is required", "incise feel --help"});
  expect_error(run({"feel", "press.csv", "--mesh", "none"}), 1, {"none"});
  expect_error(feel("none.csv"), 1, {"none.csv: cannot be opened"});
  write("nan.tum", "0 0.05 0.03 0.07 0 0 0 1\n0.1 nan 0.03 0.07 0 0 0 1\n");
  expect_error(feel("nan.tum"), 1, {"nan.tum:2: x_m is 'nan', accepted are finite numbers"});
  write("empty.csv", "");
  expect_error(feel("empty.csv"), 1, {"empty.csv: the file is empty"});
  write("back.tum", "0 0.05 0.03 0.07 0 0 0 1\n1 0.05 0.03 0.07 0 0 0 1\n0.5 0.05 0.03 0.07 0 0 0 1\n");
  expect_error(feel("back.tum", {"--strict"}), 1, {"back.tum:", "time 0.5 s after 1 s"});
  EXPECT_NE(feel("back.tum").err.find("skipped 1 of 3 samples"), std::string::npos);
  expect_error(feel("press.csv", {"--blade", "1,2"}), 2, {"--blade"});
  expect_error(feel("press.csv", {"--out", "no/f.csv"}), 1,
               {"--out no/f.csv: the directory no does not exist"});
  expect_error(feel("press.csv", {"--out", "press.csv"}), 2, {"would overwrite"});
  expect_error(feel("press.csv", {"--svg", "./slab.ele"}), 2, {"would overwrite"});
  expect_error(feel("press.csv", {"--out", "f", "--svg", "./f"}), 2,
               {"--svg ./f: would overwrite f, which --out writes; choose another name"});
  write("bad.json", R"({"haptics": {"stiffness_n_m": -1}})");
  expect_error(feel("press.csv", {"--config", "bad.json"}), 1, {"bad.json: haptics.stiffness_n_m", "-1"});
}

// Two blades in one capture: a curve for each, by name, in well-formed XML.
TEST_F(Feel, SeveralBladesGetACurveEach) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  const json config{{"cut", {{"engage", "always"}}},
                    {"sources", json::array({{{"name", "left <&\"'>"}}, {{"name", "right, too"}}})}};
  protocol::CaptureHeader header;
  header.mesh_path = "cube";
  header.config_json = config.dump();
  CaptureJournal capture((dir_ / "two.capture").string(), header);
  for (const std::uint32_t source : {0u, 1u}) {
    loop::JournalRecord opened;
    opened.kind = loop::JournalRecord::Kind::kOpened;
    opened.source = source;
    opened.blade = {{0, 0, 0}, {0, 0, -0.03 - 0.01 * source}};
    capture.write(opened);
  }
  for (int i = 0; i < 300; ++i) {
    for (const std::uint32_t source : {0u, 1u}) {
      loop::JournalRecord record;
      record.source = source;
      record.arrival_ns = 1'000'000 * (i + 5'000);
      record.pose.t_ns = 1'000'000 * (i + 70'000 * static_cast<std::int64_t>(source));  // clocks of their own
      record.pose.position = {0.02 + 0.0002 * i, source == 0 ? 0.03 : 0.07, 0.12};
      capture.write(record);
    }
  }
  capture.close();
  const RunResult result =
      run({"feel", "two.capture", "--mesh", "cube", "--out", "f.csv", "--svg", "f.svg", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json report = json::parse(result.out);
  ASSERT_EQ(report["blades"].size(), 2u);
  EXPECT_EQ(report["blades"][0]["name"], "left <&\"'>");
  EXPECT_NEAR(report["duration_s"].get<double>(), 0.299, 1e-9);
  EXPECT_GT(report["blades"][1]["peak_force_n"], report["blades"][0]["peak_force_n"]);
  EXPECT_NE(bytes("f.csv").find(",\"right, too\","), std::string::npos);

  boost::property_tree::ptree svg;
  std::istringstream text(bytes("f.svg"));
  ASSERT_NO_THROW(boost::property_tree::read_xml(text, svg));
  std::size_t curves = 0;
  std::string words;
  for (const auto& [name, element] : svg.get_child("svg")) {
    curves += element.get("<xmlattr>.class", "").rfind("blade ", 0) == 0;
    if (name != "g") continue;
    for (const auto& [key, entry] : element)
      if (key == "g") words += entry.get("text", "") + "|";
  }
  EXPECT_EQ(curves, 2u);
  EXPECT_NE(words.find("left <&\"'>|right, too|"), std::string::npos) << words;
}

}  // namespace
}  // namespace incise::app
