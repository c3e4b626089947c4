// The commands of `incise` on files, as a user runs them: the built program, its exit codes and its messages.

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <csignal>
#include <cstring>
#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>

#include "protocol/capture.hpp"
#include "server/app/capture_journal.hpp"
#include "server/app/capture_lock.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/loop/checkpoint_file.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/support/bodies.hpp"
#include "tests/support/images.hpp"
#include "tests/support/run_program.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using tests::RunResult;

class Incise : public ::testing::Test {
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

  // A cube of 6 x 6 x 6 x 6 tetrahedra, 0.1 m, and a motion of a 0.14 m blade right through it, as CSV.
  void write_cube_and_sweep(double x = 0.37, std::size_t poses = 400) {
    mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
    std::string csv = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n";
    char line[256];
    for (const core::Pose& pose : tests::sweep_through(poses, 1000, x)) {
      std::snprintf(line, sizeof line, "%.9f,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%u\n",
                    static_cast<double>(pose.t_ns) * 1e-9, pose.position.x, pose.position.y, pose.position.z,
                    pose.orientation.w, pose.orientation.x, pose.orientation.y, pose.orientation.z,
                    pose.buttons);
      csv += line;
    }
    write("sweep.csv", csv);
  }
  // A capture again, with a step of a simulation before its first pose that makes the body half as wide again.
  void write_deformed(const std::string& capture, const std::string& mesh, const std::string& out) {
    const RecordedMotion motion = read_recorded_motion(dir_ / capture);
    CaptureJournal journal((dir_ / out).string(), *motion.header);
    loop::JournalRecord record;
    record.kind = loop::JournalRecord::Kind::kDeform;
    auto step = std::make_shared<core::VertexPositions>();
    step->positions = mesh_io::load_mesh(dir_ / mesh).mesh.positions;
    for (core::Vec3& p : step->positions) p.x *= 1.5;
    record.positions = step;
    journal.write(record);
    for (const MotionEvent& event : motion.events) {
      record = {};
      if (event.kind == MotionEvent::Kind::kEndStroke) record.kind = loop::JournalRecord::Kind::kEndStroke;
      record.source = event.source;
      record.arrival_ns = event.arrival_ns;
      record.pose = event.pose;
      journal.write(record);
    }
    journal.close();
  }
  // What a warning or an error has said.
  static bool says(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
  }
  static constexpr const char* kBlade = "0,0,0:0,0,-0.14";

  fs::path dir_;
};

// An error: this exit code, nothing on stdout, one line on stderr that holds `parts`.
void expect_error(const RunResult& result, int exit_code, const std::vector<std::string>& parts) {
  EXPECT_EQ(result.exit_code, exit_code) << result.err;
  EXPECT_EQ(result.out, "");
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  EXPECT_EQ(result.err.rfind("incise: ", 0), 0u) << result.err;
  for (const std::string& part : parts)
    EXPECT_NE(result.err.find(part), std::string::npos) << result.err << "lacks " << part;
}

TEST_F(Incise, WithoutArgumentsShowsItsCommands) {
  const RunResult result = run({});
  EXPECT_EQ(result.exit_code, 0);
  for (const char* command : {"cut", "replay", "info", "phantom", "export", "convert"}) {
    EXPECT_NE(result.out.find(command), std::string::npos) << command;
  }
  EXPECT_EQ(result.err, "");
  EXPECT_EQ(run({"--help"}).out, result.out);
  EXPECT_EQ(run({"cut", "--help"}).exit_code, 0);
  EXPECT_EQ(run({"--version"}).out.rfind("incise ", 0), 0u);
}

TEST_F(Incise, TheCommandHelpPrintsWhatTheOptionDoes) {
  EXPECT_EQ(run({"help"}).out, run({"--help"}).out);
  EXPECT_EQ(run({"help"}).exit_code, 0);
  for (const char* command : {"cut", "info", "help"}) {
    const RunResult result = run({"help", command});
    EXPECT_EQ(result.exit_code, 0);
    EXPECT_EQ(result.out, run({command, "--help"}).out);
    EXPECT_EQ(result.err, "");
  }
  // Every option is described by a sentence, or by the form of its value.
  for (const char* command : {"cut", "replay", "stream", "watch", "sessions"}) {
    std::istringstream lines(run({"help", command}).out);
    std::size_t described = 0;
    for (std::string line; std::getline(lines, line);) {
      if (line.size() < 31 || line[0] != ' ' || line[2] == ' ') continue;
      const std::string text = line.substr(30);
      if (line[29] != ' ' || text[0] == ' ' || text.starts_with("nats:") || text.starts_with("hx,")) continue;
      ++described;
      EXPECT_FALSE(std::islower(static_cast<unsigned char>(text[0]))) << command << ": " << line;
    }
    EXPECT_GT(described, 2u) << command;
  }
  expect_error(run({"help", "exprot"}), 2, {"unknown command exprot (did you mean export?)"});
  expect_error(run({"help", "--frob"}), 2, {"unknown option --frob", "incise help --help"});
}

TEST_F(Incise, AMistakeOnTheCommandLineNamesItAndTheHelp) {
  expect_error(run({"cot"}), 2, {"cot", "incise --help"});
  expect_error(run({"cut"}), 2, {"--mesh is required", "incise cut --help"});
  expect_error(run({"cut", "--mesh"}), 2, {"--mesh"});
  expect_error(run({"stream", "a.csv", "--to", "127.0.0.1:1", "--source", std::string(300, 'n')}), 2,
               {"--source: found a name of 300 bytes; accepted is one of at most 256"});
  expect_error(run({"cut", "--mesh", "a", "--poses", "b", "--out", "c.vtu", "--policy", "sharp"}), 2,
               {"--policy", "sharp"});
  expect_error(run({"cut", "--mesh", "a", "--poses", "b", "--out", "c.vtu", "--frob"}), 2, {"--frob"});
  expect_error(run({"replay"}), 2, {"capture", "replay --help"});
  // What was probably meant.
  expect_error(run({"cut", "--mesh", "a", "--pose", "b"}), 2,
               {"unknown option --pose (did you mean --poses?)"});
  expect_error(run({"cut", "--mesh", "a", "--motion=b"}), 2, {"unknown option --motion;", "cut --help"});
  expect_error(run({"phantom", "liver", "--ouput", "b"}), 2, {"did you mean --out?"});
  expect_error(run({"exprot", "b"}), 2, {"unknown command exprot (did you mean export?)"});
}

// 2: the command line is wrong, whatever the files hold. 1: it failed.
TEST_F(Incise, ExitStatusesTellAWrongCommandLineFromAFailure) {
  EXPECT_NE(run({"--help"}).out.find("Exit status: 0: success. 1: it failed"), std::string::npos);
  write_cube_and_sweep();
  const std::vector<std::string> cut{"cut", "--mesh", "cube", "--poses", "sweep.csv"};
  const auto with = [](std::vector<std::string> arguments, const std::vector<std::string>& more) {
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  };
  expect_error(run(cut), 2, {"--out is required"});
  expect_error(run(with(cut, {"--out", "o.vtu", "--policy", "compare"})), 2, {"leave out --out"});
  expect_error(run(with(cut, {"--out", "o.foo"})), 2, {"--out o.foo: cannot write \".foo\"; choose"});
  expect_error(run(with(cut, {"--out", "sweep.csv"})), 2, {"cannot write"});
  expect_error(run(with(cut, {"--out", "cube.node"})), 2, {"would overwrite"});
  expect_error(run(with(cut, {"--out", "o.vtu", "--blade", "1,2"})), 2, {"--blade: found \"1,2\""});
  expect_error(run({"convert", "sweep.csv", "--out", "c.capture"}), 2, {"no mesh to cut: give --mesh"});
  expect_error(run({"phantom", "kidney", "--out", "k.node"}), 2, {"found \"kidney\""});
  expect_error(run({"stream", "sweep.csv", "--to", "http://x"}), 2, {"server \"http://x\""});
  for (const auto& nothing : {"replay", "info"})
    expect_error(run({nothing, "nothing.tum"}), 1, {"nothing.tum: "});
  expect_error(run({"cut", "--mesh", "nothing", "--poses", "sweep.csv", "--out", "o.vtu"}), 1, {"nothing"});
  expect_error(run({"stream", "nothing.csv", "--to", "127.0.0.1:1"}), 1,
               {"nothing.csv: cannot be opened: No such file"});
  expect_error(run({"watch", "127.0.0.1:1", "--token-file", "nothing"}), 1,
               {"nothing: cannot be opened: No such file"});
}

TEST_F(Incise, ANumberOutOfRangeGetsOneShortLine) {
  write("a.tum", "0 0 0 0 0 0 0 1\n");
  const struct {
    std::vector<std::string> arguments;
    std::string expected;
  } cases[] = {
      {{"watch", "x", "--for", "-1"}, "--for: found -1; accepted is a number, 0 or more;"},
      {{"watch", "x", "--for", "1e400"}, "--for: found 1e400; accepted is a number, 0 or more;"},
      {{"watch", "x", "--give-up-after", "soon"},
       "--give-up-after: found soon; accepted is a number, 0 or more;"},
      {{"watch", "x", "--max-rate", "1e9"}, "--max-rate: found 1e9; accepted is a number from 0 to 10000;"},
      {{"watch", "x", "--until-revision", "-1"},
       "--until-revision: found -1; accepted is a whole number, 0 or more;"},
      {{"stream", "a.tum", "--to", "x", "--speed", "-0.5"},
       "--speed: found -0.5; accepted is a number from 0 to 1000;"},
      {{"devices", "--monitor", "--for", "nan"}, "--for: found nan; accepted is a number, 0 or more;"},
      {{"phantom", "slab", "--size", "10", "--out", "k.node"},
       "--size: found 10; accepted is a whole number from 500 to 20000000;"},
      {{"export", "a.capture", "--revision", "18446744073709551616", "--out", "k.node"},
       "--revision: found 18446744073709551616; accepted is a whole number from 0 to 18446744073709551615;"},
  };
  for (const auto& c : cases) {
    const RunResult result = run(c.arguments);
    expect_error(result, 2, {c.expected});
    EXPECT_LT(result.err.size(), 160u) << result.err;
  }
}

TEST_F(Incise, AFileOfTheWrongKindIsNamedAsThat) {
  write_cube_and_sweep();
  write("passwd", "root:x:0:0:root:/root:/bin/bash\n");
  expect_error(run({"info", "passwd"}), 1,
               {"passwd: not a file that incise knows; it knows a mesh (.vtu", "TUM"});
  for (const char* command : {"export", "replay"}) {
    std::vector<std::string> arguments{command, "cube.node"};
    if (command[0] == 'e') arguments.insert(arguments.end(), {"--out", "o.vtu"});
    expect_error(run(arguments), 1,
                 {"cube.node: is not a capture; incised records one", "incise convert makes one"});
  }
  write("c.json", R"({"mesh": {"phantom": "liver"}})");
  const RunResult config = run({"info", "c.json"});
  EXPECT_EQ(config.exit_code, 0);
  EXPECT_EQ(std::count(config.out.begin(), config.out.end(), '\n'), 2) << config.out;
  EXPECT_NE(config.out.find("configuration of incised"), std::string::npos) << config.out;
  EXPECT_NE(config.out.find("liver (phantom)"), std::string::npos) << config.out;
  write("empty.tum", "");
  expect_error(run({"info", "empty.tum"}), 1, {"empty.tum: holds no poses: the file is empty"});
  write("header.csv", "t_s,x_m,y_m,z_m\n");
  expect_error(run({"info", "header.csv"}), 1, {"header.csv: holds no poses: no samples behind the header"});
  expect_error(run({"cut", "--mesh", "cube", "--poses", "empty.tum", "--out", "o.vtu"}), 1,
               {"empty.tum: the file is empty; accepted are TUM lines"});
}

TEST_F(Incise, CutWritesWhatItsReportSays) {
  write_cube_and_sweep();
  for (const char* policy : {"conforming", "croll"}) {
    const RunResult result = run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade,
                                  "--policy", policy, "--out", "cut.node", "--report", "report.json"});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    const json report = json::parse(tests::read_file(dir_ / "report.json"));
    std::vector<std::string> warnings;
    if (std::string(policy) == "croll")
      warnings.push_back(report["inverted"].dump() +
                         " tetrahedra are inverted, as the policy croll may leave them: --policy conforming "
                         "leaves none");
    warnings.emplace_back(
        "cut.node: does not say which faces are cuts, so a further cut takes them for the body's boundary; "
        ".vtu "
        "and .vtk say it");
    std::string printed;
    for (const std::string& warning : warnings) printed += "warning: " + warning + "\n";
    EXPECT_EQ(result.err, printed);
    EXPECT_EQ(report["warnings"].size(), 0u);
    for (const char* key : {"vertices",
                            "tets",
                            "pieces",
                            "cut_faces",
                            "cut_area",
                            "snaps",
                            "splits",
                            "removed_tets",
                            "volume_before",
                            "volume_after",
                            "min_dihedral_deg_before",
                            "min_dihedral_deg_after",
                            "deviation_max_h",
                            "deviation_mean_h",
                            "batches",
                            "events",
                            "cut_time_us",
                            "state_hash",
                            "inverted",
                            "vertices_before",
                            "tets_before",
                            "warnings",
                            "h"}) {
      EXPECT_TRUE(report.contains(key)) << key;
    }
    EXPECT_EQ(report["policy"], policy);
    EXPECT_EQ(report["tets_before"], 6 * 6 * 6 * 6);
    EXPECT_EQ(report["vertices_before"], 7 * 7 * 7);
    EXPECT_GT(report["batches"], 3);
    EXPECT_GE(report["cut_faces"], 50);
    EXPECT_NEAR(report["volume_before"].get<double>(), 1e-3, 1e-12);
    EXPECT_EQ(report["state_hash"].get<std::string>().size(), 16u);
    for (const char* key : {"p50", "p99", "max"}) EXPECT_GT(report["cut_time_us"][key], 0.0);

    if (std::string(policy) == "croll") continue;  // leaves inverted tetrahedra, which do not load
    const core::TetMesh again(mesh_io::load_mesh(dir_ / "cut.node").mesh);
    EXPECT_EQ(report["pieces"], 2);
    EXPECT_EQ(report["inverted"], 0);
    EXPECT_NEAR(report["volume_after"].get<double>(), 1e-3, 1e-6);
    EXPECT_NEAR(report["cut_area"].get<double>(), 0.01, 2e-4);
    EXPECT_EQ(core::validate(again), "");
    const core::CutReport measured = core::measure(again);
    EXPECT_EQ(report["tets"], measured.tets);
    EXPECT_EQ(report["vertices"], measured.vertices);
    EXPECT_EQ(report["pieces"], measured.pieces);
    EXPECT_DOUBLE_EQ(report["volume_after"], measured.volume);
    EXPECT_DOUBLE_EQ(report["min_dihedral_deg_after"], measured.min_dihedral_deg);
  }
}

TEST_F(Incise, InfoDescribesSurfacesOfVtk) {
  mesh_io::Surface triangle;
  triangle.positions = {{0, 0, 0}, {1, 0, 0}, {0, 2, 0}};
  triangle.triangles = {{0, 1, 2}};
  const mesh_io::CellArray piece[] = {{"piece", std::vector<std::uint32_t>{7}}};
  mesh_io::write_surface(dir_ / "a.vtp", triangle, piece);
  const RunResult result = run({"info", "a.vtp", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json facts = json::parse(result.out);
  EXPECT_EQ(facts["kind"], "surface, VTK poly data");
  EXPECT_EQ(facts["vertices"], 3);
  EXPECT_EQ(facts["faces"], 1);
  EXPECT_EQ(facts["box_file_units"]["max"], json::array({1.0, 2.0, 0.0}));
  EXPECT_EQ(facts["fields"].dump(), R"([{"components":1,"name":"piece","on":"faces","type":"uint32"}])");
  EXPECT_EQ(facts["fillable"], false);
  EXPECT_NE(run({"info", "a.vtp"}).out.find("piece, on faces, 1 uint32"), std::string::npos);
  const std::string bytes = tests::read_file(dir_ / "a.vtp");
  write("cut_off.vtp", bytes.substr(0, bytes.size() / 2));
  expect_error(run({"info", "cut_off.vtp"}), 1, {"cut_off.vtp"});
  mesh_io::write_mesh(dir_ / "tets.vtu", tests::cube(2));
  fs::rename(dir_ / "tets.vtu", dir_ / "tets.vtp");
  expect_error(run({"info", "tets.vtp"}), 1, {"type 'UnstructuredGrid'; PolyData is accepted"});
}

TEST_F(Incise, InfoTellsTheCornersOfABodyApartFarFromTheOrigin) {
  core::MeshData far = tests::cube(2);
  for (core::Vec3& p : far.positions) p = p + core::Vec3{1000, 0.5, -250000};
  mesh_io::write_mesh(dir_ / "far.vtu", far);
  const RunResult result = run({"info", "far.vtu"});
  EXPECT_TRUE(says(result.out, "(1000, 0.5, -250000) to (1000.1, 0.6, -249999.9)")) << result.out;
}

TEST_F(Incise, InfoDescribesVolumeImages) {
  // 3 x 2 x 1 voxels of 0.5 x 1 x 2 mm.
  const std::string header =
      "NRRD0004\ntype: short\ndimension: 3\nspace: RAS\nsizes: 3 2 1\nspace directions: (0.5,0,0) (0,1,0) "
      "(0,0,2)\nspace origin: (0,0,0)\nendian: little\nencoding: raw\n\n";
  write("ct.nrrd", header + std::string("\x00\x00\x01\x00\x02\x00\x03\x00\x04\x00\xff\xff", 12));
  const RunResult result = run({"info", "ct.nrrd", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json facts = json::parse(result.out);
  EXPECT_EQ(facts["kind"], "volume image");
  EXPECT_EQ(facts["voxels"], json::array({3, 2, 1}));
  EXPECT_EQ(facts["type"], "int16");
  EXPECT_EQ(facts["spacing_mm"], json::array({0.5, 1.0, 2.0}));
  EXPECT_EQ(facts["space"], "LPS");
  EXPECT_EQ(facts["box_mm"]["min"], json::array({-1.25, -1.5, -1.0}));
  EXPECT_EQ(facts["box_mm"]["max"], json::array({0.25, 0.5, 1.0}));
  EXPECT_EQ(facts["values"], json::array({-1.0, 4.0}));
  const RunResult text = run({"info", "ct.nrrd"});
  EXPECT_NE(text.out.find("0.5, 1, 2"), std::string::npos) << text.out;
  write("short.nrrd", header + "ab");
  expect_error(run({"info", "short.nrrd"}), 1, {"short.nrrd: has", "the header says 12 bytes"});
  expect_error(run({"info", "nothing.nii.gz"}), 1, {"nothing.nii.gz: No such file"});
}

TEST_F(Incise, CutIsTheSameEveryTimeAndInEveryFormat) {
  write_cube_and_sweep();
  std::vector<std::string> hashes;
  for (const char* out : {"a.vtu", "b.node", "c", "d.stl"}) {
    const RunResult result = run(
        {"cut", "--mesh", "cube.node", "--poses", "sweep.csv", "--blade", kBlade, "--out", out, "--json"});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    hashes.push_back(json::parse(result.out)["state_hash"]);
  }
  for (const std::string& hash : hashes) EXPECT_EQ(hash, hashes[0]);
  EXPECT_EQ(tests::read_file(dir_ / "b.node"), tests::read_file(dir_ / "c.node"));
  EXPECT_EQ(tests::read_file(dir_ / "b.ele"), tests::read_file(dir_ / "c.ele"));
  const std::string vtu = tests::read_file(dir_ / "a.vtu");
  for (const char* array : {"cut_mask", "cut_faces", "piece", "min_dihedral_deg", "region", "tet_id"}) {
    EXPECT_NE(vtu.find("Name=\"" + std::string(array) + "\""), std::string::npos) << array;
  }
}

TEST_F(Incise, RegionsSurviveACutInEveryFormat) {
  write_cube_and_sweep();
  core::MeshData cube = tests::cube(6);
  cube.regions.clear();
  // Two tissues whose border the cut crosses: left and right of the middle in y.
  for (const auto& tet : cube.tets) {
    double y = 0;
    for (const auto v : tet) y += cube.positions[v].y / 4;
    cube.regions.push_back(y < 0.05 ? 3 : 8);
  }
  const auto volumes = [](const core::MeshData& mesh) {
    std::map<int, double> sums;
    for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
      const auto& v = mesh.tets[t];
      const core::Vec3 o = mesh.positions[v[0]];
      sums[mesh.regions.empty() ? 0 : mesh.regions[t]] +=
          core::dot(core::cross(mesh.positions[v[1]] - o, mesh.positions[v[2]] - o),
                    mesh.positions[v[3]] - o) /
          6;
    }
    return sums;
  };
  const auto before = volumes(cube);
  ASSERT_EQ(before.size(), 2u);
  for (const char* ending : {".msh", ".msh2", ".vtk", ".vtu", ".mesh", ".node"}) {
    SCOPED_TRACE(ending);
    const std::string in = std::string("in") + ending, out = std::string("out") + ending;
    mesh_io::write_mesh(dir_ / in, cube);
    const RunResult result = run(
        {"cut", "--mesh", in, "--poses", "sweep.csv", "--blade", kBlade, "--out", out, "--report", "r.json"});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    const core::MeshData cut = mesh_io::load_mesh(dir_ / out).mesh;
    EXPECT_GT(cut.positions.size(), cube.positions.size());
    const auto after = volumes(cut);
    ASSERT_EQ(after.size(), 2u);
    for (const auto& [region, volume] : before)
      EXPECT_NEAR(after.at(region), volume, 0.02 * volume) << region;
  }
}

// The same motion in 2, 11 and 1,001 poses, at whatever rate: two pieces each time. Two poses a second apart, or a
// body crossed in two milliseconds, are no jumps when that is how the whole motion goes.
TEST_F(Incise, AMotionOfFewPosesCutsAsWellAsOneOfMany) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  for (const double duration_s : {0.002, 1.0, 30.0}) {
    for (const int poses : {2, 11, 1001}) {
      std::string csv = "t_s,x_m,y_m,z_m\n";
      char line[128];
      for (int i = 0; i < poses; ++i) {
        const double s = static_cast<double>(i) / (poses - 1);
        std::snprintf(line, sizeof line, "%.9f,0.041,%.17g,0.12\n", duration_s * s, -0.02 + 0.14 * s);
        csv += line;
      }
      write("straight.csv", csv);
      const RunResult result = run({"cut", "--mesh", "cube", "--poses", "straight.csv", "--blade", kBlade,
                                    "--out", "out.vtu", "--json"});
      ASSERT_EQ(result.exit_code, 0) << result.err;
      EXPECT_EQ(json::parse(result.out)["pieces"], 2) << poses << " poses in " << duration_s << " s";
    }
  }
}

// Two poses a second apart are a cut for `cut` and for `convert`, and the same one; a limit that the configuration sets is
// kept by both, and then both say that nothing was cut.
TEST_F(Incise, ConvertCutsWhatCutCuts) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  write("pass.tum", "0 0.041 -0.02 0.12 0 0 0 1\n1 0.041 0.12 0.12 0 0 0 1\n");
  const std::string start = R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": ")";
  write("always.json", start + "always\"}}");
  write("buttons.json", start + "buttons\"}}");  // which a motion without buttons holds
  write("strict.json", start + "always\", \"gap_limit_s\": 0.3}}");
  const auto convert = [&](const char* config) {
    return run({"convert", "pass.tum", "--mesh", "cube", "--config", config, "--out", "c.capture", "--json"});
  };
  const auto cut = [&](const char* config) {
    return run(
        {"cut", "--poses", "pass.tum", "--mesh", "cube", "--config", config, "--out", "c.vtu", "--json"});
  };
  for (const char* config : {"always.json", "buttons.json"}) {
    const RunResult made = convert(config);
    ASSERT_EQ(made.exit_code, 0) << made.err;
    const json converted = json::parse(made.out), report = json::parse(cut(config).out);
    EXPECT_GT(converted["batches"], 0) << config;
    EXPECT_EQ(converted["state_hash"], report["state_hash"]) << config;
    EXPECT_EQ(report["pieces"], 2);
    EXPECT_EQ(report["gap_limit_s"], 5.0);
    EXPECT_NE(made.err.find("raised cut.gap_limit_s from 0.25 to 5 s to suit the motion"), std::string::npos)
        << made.err;
    const RunResult replayed = run({"replay", "c.capture", "--verify", "--json"});
    EXPECT_EQ(replayed.exit_code, 0) << replayed.err;
    EXPECT_EQ(json::parse(replayed.out)["state_hash"], converted["state_hash"]);
  }
  const RunResult made = convert("strict.json"), nothing = cut("strict.json");
  EXPECT_EQ(made.exit_code, 0);
  EXPECT_EQ(nothing.exit_code, 3);
  EXPECT_EQ(json::parse(nothing.out)["gap_limit_s"], 0.3);
  for (const RunResult* result : {&made, &nothing}) {
    EXPECT_NE(result->err.find("warning: pass.tum: 1 jump began a new stroke: faster than"),
              std::string::npos)
        << result->err;
    EXPECT_NE(result->err.find("warning: nothing was cut: every step of pass.tum counts as a jump"),
              std::string::npos)
        << result->err;
  }
}

// For a motion at a hand's rate the limits stay as they are, even if it is irregular: the server's are the same.
TEST_F(Incise, LimitsStayWhereFewStepsAreBeyondThem) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  std::string csv = "t_s,x_m,y_m,z_m\n";
  for (int i = 0; i < 200; ++i) {  // two strokes with a silence between them, then a leap
    const double t = 0.01 * i + (i >= 100 ? 1 : 0), x = i < 100 ? 0.041 : 0.067;
    csv += std::to_string(t) + "," + std::to_string(x) + "," + std::to_string(-0.02 + 0.0014 * (i % 100)) +
           ",0.12\n";
  }
  csv += "3.01,0.9,0.9,0.9\n";
  write("two.csv", csv);
  const RunResult result =
      run({"cut", "--mesh", "cube", "--poses", "two.csv", "--blade", kBlade, "--out", "out.vtu", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json report = json::parse(result.out);
  EXPECT_EQ(report["pieces"], 3);
  EXPECT_EQ(report["gap_limit_s"], 0.25);
  EXPECT_EQ(report["speed_limit_m_s"], 2.0);
  EXPECT_FALSE(report.contains("raised_limits"));
  EXPECT_NE(result.err.find("2 jumps began a new stroke"), std::string::npos) << result.err;
}

TEST_F(Incise, OddTimesAreSkippedOrRefused) {
  write_cube_and_sweep();
  std::string csv = tests::read_file(dir_ / "sweep.csv");
  csv.insert(csv.find('\n', csv.size() / 2) + 1, "0.5,0.04,0.02,0.1,1,0,0,0,1\n");
  write("odd.csv", csv);
  const std::vector<std::string> cut{"cut",     "--mesh", "cube",  "--poses", "odd.csv",
                                     "--blade", kBlade,   "--out", "o.vtu"};
  const std::vector<std::string> convert{"convert", "odd.csv", "--mesh", "cube", "--out", "o.capture"};
  for (std::vector<std::string> arguments : {cut, convert}) {
    const RunResult result = run(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_NE(result.err.find("warning: odd.csv: skipped 1 of 401 samples: its time does not rise (line "),
              std::string::npos)
        << result.err;
    arguments.push_back("--strict");
    expect_error(run(arguments), 1, {"odd.csv:", "time 0.5 s after 1.", "accepted are rising times"});
  }
  // A capture keeps what was recorded; only --strict minds.
  write("twice.tum", "0 0.041 -0.02 0.12 0 0 0 1\n0.1 0.041 0.02 0.12 0 0 0 1\n");
  ASSERT_EQ(run({"convert", "twice.tum", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  EXPECT_EQ(run({"cut", "--mesh", "cube", "--poses", "a.capture", "--out", "o.vtu", "--strict"}).exit_code,
            0);
}

// A recording whose clock restarts half-way: both halves cut, and nothing between them.
TEST_F(Incise, AClockThatRestartsKeepsTheSecondHalf) {
  write_cube_and_sweep();
  const std::string csv = tests::read_file(dir_ / "sweep.csv");
  std::istringstream lines(csv);
  std::string restarted, line;
  for (int i = -1; std::getline(lines, line); ++i) {
    const auto comma = line.find(',');
    const double t_s = i < 0 ? 0 : std::stod(line.substr(0, comma));
    restarted += (i < 200 ? line : std::to_string(t_s - 1.2) + line.substr(comma)) + "\n";
  }
  write("restarted.csv", restarted);
  RunResult result = run(
      {"cut", "--mesh", "cube", "--poses", "restarted.csv", "--blade", kBlade, "--out", "o.vtu", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json report = json::parse(result.out);
  EXPECT_EQ(report["poses_taken"], 400);
  EXPECT_NE(report["warnings"].dump().find("restarted.csv: the clock restarts once (line 202: "),
            std::string::npos)
      << report["warnings"];
  ASSERT_EQ(run({"convert", "restarted.csv", "--mesh", "cube", "--out", "r.capture"}).exit_code, 0);
  result = run({"replay", "r.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  result = run({"info", "r.capture", "--json"});
  EXPECT_EQ(json::parse(result.out)["poses"], 400) << result.out;
}

TEST_F(Incise, MillimetresAreRecognised) {
  write_cube_and_sweep();
  std::string metres = "t_s,x_m,y_m,z_m\n", millimetres = metres;
  for (int i = 0; i <= 100; ++i) {
    millimetres += std::to_string(0.01 * i) + ",41," + std::to_string(-20 + 1.4 * i) + ",120\n";
    metres += std::to_string(0.01 * i) + ",0.041," + std::to_string(-0.02 + 0.0014 * i) + ",0.12\n";
  }
  write("mm.csv", millimetres);
  write("m.csv", metres);
  RunResult result =
      run({"cut", "--mesh", "cube", "--poses", "mm.csv", "--blade", kBlade, "--out", "out.vtu"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_NE(result.err.find(
                "mm.csv: the tool's way spans 140 m, the body 0.1732 m: these poses look like millimetres"),
            std::string::npos)
      << result.err;
  mesh_io::write_mesh(dir_ / "large.node", tests::cube(6, 100));
  result = run({"cut", "--mesh", "large", "--poses", "m.csv", "--blade", kBlade, "--out", "out.vtu"});
  EXPECT_NE(result.err.find("this mesh looks like millimetres; give --config a file with {\"mesh\": "
                            "{\"scale_to_metres\": 0.001}}, which makes it 0.1732 m long"),
            std::string::npos)
      << result.err;
  // Both may be meant.
  mesh_io::write_mesh(dir_ / "middle.node", tests::cube(6, 20));
  result = run({"cut", "--mesh", "middle", "--poses", "m.csv", "--blade", kBlade, "--out", "out.vtu"});
  EXPECT_NE(
      result.err.find("this mesh looks like centimetres or millimetres; give --config a file with {\"mesh\": "
                      "{\"scale_to_metres\": 0.01 or 0.001}}, which makes it 0.3464 m or 0.03464 m long"),
      std::string::npos)
      << result.err;
  result = run({"cut", "--mesh", "cube", "--poses", "m.csv", "--blade", kBlade, "--out", "out.vtu"});
  EXPECT_EQ(result.err.find("millimetres"), std::string::npos) << result.err;
}

// The deviation, computed independently: the distance of each cut face's corners and middle from the nearest of
// three rectangles that the poses swept, in the mean edge length of the mesh that was given. The body has small elements
// in its middle, as a tumour has.
TEST_F(Incise, TheReportsDeviationIsWhatAJudgeMeasures) {
  core::MeshData body = tests::cube(14, 2);
  for (core::Vec3& p : body.positions) {
    for (double* x : {&p.x, &p.y, &p.z})
      *x = 0.05 * (1 + std::copysign(std::pow(std::abs(*x - 1), 3.5), *x - 1));
  }
  mesh_io::write_mesh(dir_ / "graded.node", body);
  struct Rectangle {
    core::Vec3 corner, along, across;  // motion and blade
  };
  constexpr double kSide = 0.16;
  std::vector<Rectangle> swept;
  std::string csv = "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n";
  for (core::Quat q : {core::Quat{0.8, 0.3, -0.4, 0.3}, {0.5, -0.6, 0.2, 0.6}, {0.3, 0.7, 0.5, -0.4}}) {
    const double norm = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    q = {q.w / norm, q.x / norm, q.y / norm, q.z / norm};
    const core::Vec3 along = core::rotate(q, {1, 0, 0}), down = core::rotate(q, {0, 0, -1});
    const core::Vec3 first = core::Vec3{0.0532, 0.0467, 0.0489} - (kSide / 2) * along - (kSide / 2) * down;
    for (int i = 0; i <= 100; ++i) {
      const core::Vec3 p = first + (kSide / 100 * i) * along;
      char line[256];
      std::snprintf(line, sizeof line, "%.9f,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g\n",
                    3.0 * static_cast<double>(swept.size()) + 0.01 * i, p.x, p.y, p.z, q.w, q.x, q.y, q.z);
      csv += line;
    }
    swept.push_back({first, kSide * along, kSide * down});
  }
  write("three.csv", csv);
  const RunResult result = run({"cut", "--mesh", "graded", "--poses", "three.csv", "--blade",
                                "0,0,0:0,0,-0.16", "--out", "out.vtk", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json report = json::parse(result.out);

  const std::string vtk = tests::read_file(dir_ / "out.vtk");
  const core::MeshData cut = mesh_io::load_mesh(dir_ / "out.vtk").mesh;
  const std::size_t at = vtk.find('\n', vtk.find("cut_mask"));
  ASSERT_NE(at, std::string::npos);
  const std::string values =
      vtk.substr(vtk.compare(at + 1, 6, "LOOKUP") == 0 ? vtk.find('\n', at + 1) + 1 : at + 1);
  const core::TetMesh before(mesh_io::load_mesh(dir_ / "graded.node").mesh);
  const double h = before.mean_edge_length();
  double worst = 0, sum = 0;
  std::size_t samples = 0;
  const auto look_at = [&](const core::Vec3& p) {
    double nearest = 1e300;
    for (const Rectangle& r : swept) {
      const core::Vec3 w = p - r.corner;
      const double s = std::clamp(core::dot(w, r.along) / core::squared_length(r.along), 0.0, 1.0);
      const double t = std::clamp(core::dot(w, r.across) / core::squared_length(r.across), 0.0, 1.0);
      nearest = std::min(nearest, core::length(w - s * r.along - t * r.across));
    }
    worst = std::max(worst, nearest);
    sum += nearest;
    ++samples;
  };
  ASSERT_EQ(cut.tets.size(), report["tets"]);
  for (std::size_t t = 0; t < cut.tets.size(); ++t) {
    for (int f = 0; f < 4; ++f) {
      if (!(static_cast<unsigned char>(values[t]) >> f & 1)) continue;
      std::vector<core::Vec3> corners;
      for (int v = 0; v < 4; ++v) {
        if (v != f) corners.push_back(cut.positions[cut.tets[t][static_cast<std::size_t>(v)]]);
      }
      for (int i = 0; i <= 6; ++i) {
        for (int j = 0; i + j <= 6; ++j)
          look_at((i / 6.0) * corners[0] + (j / 6.0) * corners[1] + ((6 - i - j) / 6.0) * corners[2]);
      }
    }
  }
  ASSERT_GT(samples, 1000u);
  EXPECT_NEAR(report["h"].get<double>(), h, 1e-12);
  EXPECT_GT(worst / h, 1e-3);
  EXPECT_NEAR(report["deviation_max_h"].get<double>(), worst / h, 1e-6);
  EXPECT_NEAR(report["deviation_mean_h"].get<double>(), sum / static_cast<double>(samples) / h, 1e-9);
}

// As a shell's <(command) gives them.
TEST_F(Incise, MotionsAndCapturesComeThroughPipes) {
  write_cube_and_sweep();
  write("empty.tum", "");
  write("c.json", "{}");
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  ASSERT_EQ(::mkfifo((dir_ / "pipe").c_str(), 0600), 0);
  const auto through_pipe = [&](const std::string& file, const std::vector<std::string>& arguments) {
    const tests::Started started = tests::start_program("incise", arguments, dir_, dir_ / "stdout.txt");
    std::ofstream(dir_ / "pipe", std::ios::binary) << tests::read_file(dir_ / file);
    return tests::end_of(started);
  };
  const std::vector<std::string> cut = {"cut",   "--mesh", "cube",   "--blade", kBlade,
                                        "--out", "o.vtu",  "--json", "--poses"};
  const auto of = [&](const std::string& name) {
    auto all = cut;
    all.push_back(name);
    return all;
  };
  for (const char* file : {"sweep.csv", "a.capture"}) {
    const RunResult piped = through_pipe(file, of("pipe")), direct = run(of(file));
    ASSERT_EQ(piped.exit_code, 0) << piped.err;
    EXPECT_EQ(json::parse(piped.out)["state_hash"], json::parse(direct.out)["state_hash"]);
    const RunResult info = through_pipe(file, {"info", "pipe", "--json"});
    ASSERT_EQ(info.exit_code, 0) << info.err;
    EXPECT_EQ(json::parse(info.out)["poses"], 400);
  }
  EXPECT_EQ(through_pipe("a.capture", {"replay", "pipe", "--mesh", "cube", "--verify"}).exit_code, 0);
  expect_error(through_pipe("empty.tum", of("pipe")), 1, {"pipe: the file is empty"});
  expect_error(through_pipe("c.json", {"info", "pipe"}), 1,
               {"pipe: not a motion or a capture; save anything else"});
}

TEST_F(Incise, CutComparesThePolicies) {
  write_cube_and_sweep();
  const std::vector<std::string> compare{"cut",     "--mesh", "cube",     "--poses", "sweep.csv",
                                         "--blade", kBlade,   "--policy", "compare"};
  auto as_json = compare;
  as_json.insert(as_json.end(), {"--json", "--report", "r.json"});
  const RunResult result = run(as_json);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json reports = json::parse(result.out);
  EXPECT_EQ(json::parse(tests::read_file(dir_ / "r.json")), reports);
  ASSERT_EQ(reports.size(), 4u);
  EXPECT_EQ(reports[0]["policy"], "croll");
  for (std::size_t i = 1; i < 4; ++i) EXPECT_EQ(reports[i]["inverted"], 0);
  EXPECT_LE(reports[1]["tets"], reports[1]["tets_before"]);
  EXPECT_EQ(reports[2]["pieces"], 2);
  EXPECT_EQ(reports[3]["pieces"], 2);
  EXPECT_GT(reports[3]["splits"], reports[2]["splits"]);
  // Each entry equals the result of the command with that policy alone.
  auto alone = compare;
  alone.back() = "conforming";
  alone.insert(alone.end(), {"--prefer", "exact", "--json", "--out", "out.vtu"});
  EXPECT_EQ(json::parse(run(alone).out)["state_hash"], reports[3]["state_hash"]);
  const RunResult table = run(compare);
  EXPECT_NE(table.out.find("croll   no-growth    balanced       exact"), std::string::npos) << table.out;
  auto with_prefer = compare;
  with_prefer.insert(with_prefer.end(), {"--prefer", "exact"});
  expect_error(run(with_prefer), 2, {"--policy compare cuts with every --prefer"});
  auto with_out = compare;
  with_out.insert(with_out.end(), {"--out", "out.vtu"});
  expect_error(run(with_out), 2, {"--policy compare writes no mesh", "--out"});
  auto without_out = compare;
  without_out.resize(7);
  expect_error(run(without_out), 2, {"--out is required"});
}

TEST_F(Incise, ABladeThatMissesIsAWarningThatSaysWhereItWas) {
  write_cube_and_sweep(3.0);
  const RunResult result =
      run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", "out.vtu"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_NE(result.err.find("warning: nothing was cut: the blade swept (0.2"), std::string::npos)
      << result.err;
}

// A folder that takes no files is found before the work, and named.
TEST_F(Incise, AnOutputInAFolderThatTakesNoFilesIsRefusedAtOnce) {
  write_cube_and_sweep();
  expect_error(
      run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", "/proc/x.vtu"}), 1,
      {"--out /proc/x.vtu: files cannot be made in /proc (", "); choose another directory"});
}

// Here croll moves a vertex and opens nothing: "nothing was cut" alone would read as if the mesh were the one that was read.
TEST_F(Incise, ACutThatOpensNothingButChangesTheMeshSaysSo) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(6));
  std::string graze;
  for (int i = 0; i < 20; ++i)
    graze += std::to_string(0.01 * i) + " 0.037 " + std::to_string(-0.0021 + 0.0003 * i) + " 0.12 0 0 0 1\n";
  write("graze.tum", graze);
  for (const bool touches : {true, false}) {
    const RunResult result =
        run({"cut", "--mesh", "cube", "--poses", "graze.tum", "--blade",
             touches ? "0,0,0:0,0,-0.14" : "5,0,0:5,0,-0.14", "--policy", "croll", "--out", "out.vtu"});
    EXPECT_EQ(result.exit_code, 3);
    EXPECT_NE(
        result.err.find(
            touches ? "warning: nothing was cut, though the mesh has changed (vertices were moved): the blade"
                    : "warning: nothing was cut: the blade"),
        std::string::npos)
        << result.err;
  }
}

TEST_F(Incise, PosesTooFarAwayAreRejectedAsThat) {
  write_cube_and_sweep();
  write("far.tum", "0 20000 0 0 0 0 0 1\n0.01 20000.01 0 0 0 0 0 1\n");
  const RunResult result =
      run({"cut", "--mesh", "cube", "--poses", "far.tum", "--blade", kBlade, "--out", "out"});
  EXPECT_NE(result.err.find("2 poses were rejected: not finite or more than 10 km from the origin"),
            std::string::npos)
      << result.err;
  EXPECT_NE(
      result.err.find("nothing was cut: the poses of far.tum that were not rejected do not move the blade"),
      std::string::npos)
      << result.err;
  EXPECT_EQ(result.err.find("never moved"), std::string::npos) << result.err;
}

TEST_F(Incise, CuttingAgainWhereABodyIsCutIsAWarningThatSaysSo) {
  write_cube_and_sweep();
  const auto cut = [&](const std::string& mesh, const std::string& out, const std::string& blade) {
    return run({"cut", "--mesh", mesh, "--poses", "sweep.csv", "--blade", blade, "--out", out});
  };
  ASSERT_EQ(cut("cube", "once", kBlade).exit_code, 0);
  const RunResult again = cut("once", "twice", kBlade);
  EXPECT_EQ(again.exit_code, 3);
  EXPECT_NE(
      again.err.find(
          "warning: nothing was cut: the blade of sweep.csv met the body, but what it swept is cut already"),
      std::string::npos)
      << again.err;
  EXPECT_EQ(again.err.find("check the blade"), std::string::npos) << again.err;
  // One that ends above the body met nothing.
  const RunResult above = cut("once", "twice", "0,0,0:0,0,-0.001");
  EXPECT_EQ(above.exit_code, 3);
  EXPECT_NE(above.err.find("check the blade, units and frames"), std::string::npos) << above.err;
}

// A slit under a lid, and in another run a stroke around the lid that ends in the slit. What comes with the saved body is no part of the second report.
TEST_F(Incise, ACutOnASavedCutIsJoinedToIt) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(12));
  std::string slit, around;
  for (int i = 0; i <= 30; ++i) {
    char line[128];
    std::snprintf(line, sizeof line, "%g %g 0.02 0.053 %.17g 0 0 %.17g\n", 0.02 * i, 0.02 + 0.002 * i,
                  std::sqrt(0.5), std::sqrt(0.5));
    slit += line;
  }
  for (int i = 0; i <= 80; ++i) {
    const double angle = 2 * std::numbers::pi * i / 80;
    char line[128];
    std::snprintf(line, sizeof line, "%g %.9g %.9g 0.113 0 0 0 1\n", 0.02 * i, 0.05 + 0.025 * std::cos(angle),
                  0.05 + 0.025 * std::sin(angle));
    around += line;
  }
  write("slit.tum", slit);
  write("around.tum", around);
  const auto cut = [&](const std::string& mesh, const std::string& poses, const std::string& out) {
    const RunResult result =
        run({"cut", "--mesh", mesh, "--poses", poses, "--blade", "0,0,0:0,0,-0.06", "--out", out, "--json"});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(result.err, "");
    return json::parse(result.out);
  };
  for (const std::string ending : {".vtu", ".vtk"}) {
    const json first = cut("cube", "slit.tum", "slit" + ending);
    EXPECT_EQ(first["pieces"], 1);
    const json second = cut("slit" + ending, "around.tum", "lid" + ending);
    EXPECT_EQ(second["pieces"], 2) << ending;
    // The lid's side: 2 pi 2.5 cm by 4.7 cm.
    EXPECT_NEAR(second["cut_area"].get<double>(), 0.00738, 0.0004);
    EXPECT_LE(second["deviation_max_h"], 0.3);
    EXPECT_LE(second["deviation_mean_h"], 0.02);
  }
}

TEST_F(Incise, ABladeMuchLongerThanTheBodyIsRefused) {
  write_cube_and_sweep();
  const std::string fault = " is 120 m long, the body 0.1732 m: this looks like millimetres; divide by 1000";
  expect_error(
      run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", "0,0,0:0,0,-120", "--out", "out.vtu"}),
      2, {"--blade" + fault});
  write("long.json", R"({"blade": {"heel": [0, 0, 0], "tip": [0, 0, -120]}, "mesh": {"path": "cube.node"}})");
  expect_error(
      run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--config", "long.json", "--out", "out.vtu"}), 1,
      {"the blade" + fault});
  expect_error(run({"convert", "sweep.csv", "--config", "long.json", "--out", "out.capture"}), 1,
               {"the blade" + fault});
  EXPECT_FALSE(std::filesystem::exists(dir_ / "out.vtu"));
  EXPECT_FALSE(std::filesystem::exists(dir_ / "out.capture"));
  // The mesh is in metres, and is scaled once more.
  write("scaled.json", R"({"mesh": {"path": "cube.node", "scale_to_metres": 0.001}})");
  expect_error(
      run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--config", "scaled.json", "--out", "out.vtu"}),
      1,
      {"the blade is 0.05 m long, the body 0.0001732 m: this looks like millimetres; divide by 1000, or "
       "leave out "
       "mesh.scale_to_metres (0.001) if the mesh is in metres already"});
}

TEST_F(Incise, NothingThatIsReadIsOverwritten) {
  write_cube_and_sweep();
  const auto bytes = [&](const char* name) {
    std::ifstream in(dir_ / name, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  const std::string motion = bytes("sweep.csv"), mesh = bytes("cube.node");
  for (const char* out : {"cube.node", "cube", "./cube.ele"}) {
    expect_error(run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", out}), 2,
                 {"would overwrite", "choose another name"});
  }
  expect_error(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "sweep.csv"}), 2, {"would overwrite"});
  write("c.json", R"({"mesh": {"path": "cube.node"}})");
  const std::string config = bytes("c.json");
  for (const char* out : {"c.json", "cube.ele"}) {
    expect_error(run({"convert", "sweep.csv", "--config", "c.json", "--out", out}), 2,
                 {"--out " + std::string(out) + ": would overwrite"});
  }
  fs::create_hard_link(dir_ / "sweep.csv", dir_ / "same.csv");
  for (const char* report : {"cube.node", "cube.ele", "sweep.csv", "same.csv", "c.json"}) {
    expect_error(
        run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--config", "c.json", "--out", "out.vtu",
             "--report", report}),
        2, {"--report " + std::string(report) + ": would overwrite", "which is read; choose another name"});
  }
  EXPECT_EQ(bytes("c.json"), config);
  EXPECT_EQ(bytes("sweep.csv"), motion);
  EXPECT_EQ(bytes("cube.node"), mesh);
}

TEST_F(Incise, NoOutputOverwritesAnother) {
  write_cube_and_sweep();
  for (const auto& [out, report] : {std::pair{"out.vtu", "./out.vtu"},
                                    {"out", "out.ele"},
                                    {"out.node", "out.ele"},
                                    {"out.NODE", "out.NODE.ele"},
                                    {"out.obj", "out.mtl"}}) {
    expect_error(
        run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", out, "--report",
             report}),
        2,
        {"--report " + std::string(report) + ": would overwrite", "which --out writes; choose another name"});
    EXPECT_FALSE(fs::exists(dir_ / out));
  }
}

// A mesh or a capture replaces what had its name: a device would be gone, or get two files beside it.
TEST_F(Incise, OnlyRegularFilesAreReplaced) {
  write_cube_and_sweep();
  fs::create_symlink("/dev/null", dir_ / "null");
  fs::create_symlink("/dev/null", dir_ / "null.vtu");
  fs::create_directory(dir_ / "pair.ele");
  for (const auto& [out, fault] : {std::pair{"null", "is a device or a pipe; accepted is"},
                                   {"null.vtu", "is a device or a pipe; accepted is"},
                                   {"pair", "pair.ele: is a directory"}}) {
    expect_error(run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", out}), 1,
                 {"--out ", fault});
    expect_error(run({"phantom", "slab", "--size", "500", "--out", out}), 1, {"--out ", fault});
  }
  expect_error(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "null"}), 1,
               {"--out null: is a device or a pipe"});
  EXPECT_FALSE(fs::exists(dir_ / "null.node"));
  EXPECT_TRUE(fs::is_symlink(dir_ / "null.vtu"));
  // A file of that name is not what an OUT without an ending writes.
  write("plain", "");
  expect_error(run({"phantom", "slab", "--size", "500", "--out", "plain"}), 2,
               {"--out plain: is a file; without an ending it names TetGen's pair", "plain.node and .ele"});
  // A report is only written, so it may go to one.
  EXPECT_EQ(run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", "out.vtu",
                 "--report", "null"})
                .exit_code,
            0);
}

TEST_F(Incise, TheFilesThatWereWrittenAreNamed) {
  write_cube_and_sweep();
  for (const auto& [out, written] : {std::pair{"o", "o.node, o.ele"},
                                     {"p.ele", "p.node, p.ele"},
                                     {"q.vtu", "q.vtu"},
                                     {"r.obj", "r.obj, r.mtl"}}) {
    const RunResult result =
        run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", out});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    EXPECT_NE(result.out.find("written                " + std::string(written) + "\n"), std::string::npos)
        << result.out;
    std::istringstream names(written);
    for (std::string name; std::getline(names >> std::ws, name, ',');)
      EXPECT_TRUE(fs::exists(dir_ / name)) << name;
  }
}

TEST_F(Incise, CutSaysWhatIsWrongWithWhatItIsGiven) {
  write_cube_and_sweep();
  const std::vector<std::string> good{"cut", "--mesh", "cube", "--poses", "sweep.csv", "--out", "out.vtu"};
  const auto with = [&](std::size_t at, const std::string& value, std::vector<std::string> more = {}) {
    auto arguments = good;
    if (at > 0) arguments[at] = value;
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  };
  expect_error(with(2, "nothing"), 1, {"nothing", "no such file"});
  expect_error(with(2, "sweep.csv"), 1, {"sweep.csv"});
  expect_error(with(4, "nothing.csv"), 1, {"nothing.csv", "cannot be opened"});
  expect_error(with(4, "."), 1, {"directory"});
  expect_error(with(4, "cube.node"), 1, {"cube.node"});
  expect_error(with(6, "nowhere/out.vtu"), 1,
               {"--out nowhere/out.vtu", "does not exist", "mkdir -p nowhere"});
  expect_error(with(6, "."), 1, {"--out"});
  expect_error(with(6, "out.docx"), 2, {"--out", ".docx", ".vtu"});
  expect_error(with(0, "", {"--report", "nowhere/r.json"}), 1, {"--report nowhere/r.json", "does not exist"});
  expect_error(with(0, "", {"--blade", "0,0,0"}), 2, {"--blade", "\"0,0,0\"", "hx,hy,hz:tx,ty,tz"});
  expect_error(with(0, "", {"--blade", "0,0,0:0,0,0"}), 2, {"--blade"});
  expect_error(with(0, "", {"--blade", "0,0,0:0,0,x"}), 2, {"--blade"});
  expect_error(with(0, "", {"--blade", "0,0,0:0,0,1,2"}), 2, {"--blade"});
  expect_error(with(0, "", {"--config", "none.json"}), 1, {"none.json", "cannot be opened"});
  write("bad.json", "{\"cut\": {\"batch_h\": -1}}");
  expect_error(with(0, "", {"--config", "bad.json"}), 1, {"bad.json: cut.batch_h", "-1"});
  write("empty.csv", "");
  expect_error(with(4, "empty.csv"), 1, {"empty.csv"});
  EXPECT_FALSE(fs::exists(dir_ / "out.vtu"));
}

TEST_F(Incise, ConvertReplayAndExportAgree) {
  write_cube_and_sweep();
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always"}})");
  RunResult result = run(
      {"convert", "sweep.csv", "--mesh", "cube", "--config", "c.json", "--out", "sweep.capture", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json converted = json::parse(result.out);
  result = run({"replay", "sweep.capture", "--verify", "--json"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  const json replayed = json::parse(result.out);
  EXPECT_TRUE(replayed["verified"]);
  EXPECT_EQ(replayed["state_hash"], converted["state_hash"]);
  EXPECT_EQ(replayed["compared"], converted["batches"]);
  EXPECT_EQ(run({"replay", "sweep.capture", "--verify"}).exit_code, 0);

  result = run({"cut", "--mesh", "cube", "--poses", "sweep.capture", "--out", "out.node", "--json"});
  EXPECT_EQ(json::parse(result.out)["state_hash"], converted["state_hash"]);
  result = run({"export", "sweep.capture", "--out", "exported.node", "--json"});
  EXPECT_EQ(json::parse(result.out)["state_hash"], converted["state_hash"]);
  EXPECT_EQ(tests::read_file(dir_ / "exported.ele"), tests::read_file(dir_ / "out.ele"));

  EXPECT_EQ(run({"export", "sweep.capture", "--revision", "0", "--out", "start.node"}).exit_code, 0);
  EXPECT_EQ(mesh_io::load_mesh(dir_ / "start.node").mesh.tets, tests::cube(6).tets);
  expect_error(run({"export", "sweep.capture", "--revision", "100000", "--out", "x.node"}), 1,
               {"--revision", "100000"});
  expect_error(run({"replay", "sweep.csv"}), 1, {"sweep.csv", "capture", "convert"});
  mesh_io::write_mesh(dir_ / "other.node", tests::cube(5));
  expect_error(run({"replay", "sweep.capture", "--mesh", "other"}), 1, {"another mesh", "--mesh"});
}

// A simulation's positions are of the mesh that they were recorded with, wherever that lies now.
TEST_F(Incise, ASimulationsPositionsAreKeptInTheirOwnMeshAndElsewhereLeftOutWithAWarning) {
  write_cube_and_sweep();
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always"}})");
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--config", "c.json", "--out", "still.capture"})
                .exit_code,
            0);
  write_deformed("still.capture", "cube.node", "moved.capture");
  const RunResult exported = run({"export", "moved.capture", "--out", "moved.vtu", "--json"});
  ASSERT_EQ(exported.exit_code, 0) << exported.err;
  const json state = json::parse(exported.out)["state_hash"];
  EXPECT_NE(state, json::parse(run({"replay", "still.capture", "--json"}).out)["state_hash"]);
  fs::create_directory(dir_ / "elsewhere");
  for (const char* end : {"cube.node", "cube.ele"}) fs::copy(dir_ / end, dir_ / "elsewhere");
  for (const std::vector<std::string>& mesh : {std::vector<std::string>{}, {"--mesh", "elsewhere/cube"}}) {
    std::vector<std::string> arguments{"convert", "moved.capture", "--out", "again.capture", "--json"};
    arguments.insert(arguments.end(), mesh.begin(), mesh.end());
    const RunResult made = run(arguments);
    ASSERT_EQ(made.exit_code, 0) << made.err;
    EXPECT_EQ(json::parse(made.out)["state_hash"], state);
    EXPECT_EQ(json::parse(made.out)["warnings"], json::array());
    EXPECT_EQ(json::parse(run({"replay", "again.capture", "--verify", "--json"}).out)["state_hash"], state);
  }
  mesh_io::write_mesh(dir_ / "other.node", tests::cube(5));
  const std::string left_out =
      "moved.capture: the simulation's positions in the capture were left out (1 step)";
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{"convert", "moved.capture", "--mesh", "other", "--out", "x.capture"},
        {"cut", "--mesh", "cube", "--poses", "moved.capture", "--out", "x.vtu"},
        {"feel", "moved.capture", "--mesh", "cube"}}) {
    const RunResult result = run(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_TRUE(says(result.err, "warning: " + left_out)) << arguments[0] << ": " << result.err;
  }
}

// Where the body is when nothing is met.
TEST_F(Incise, ABladeThatMissesADeformedBodyIsToldWhereThatIs) {
  write_cube_and_sweep(3.0);
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always"}})");
  const RunResult still =
      run({"convert", "sweep.csv", "--mesh", "cube", "--config", "c.json", "--out", "still.capture"});
  EXPECT_TRUE(says(still.err, "the mesh fills (0, 0, 0) to (0.1, 0.1, 0.1) (metres)")) << still.err;
  write_deformed("still.capture", "cube.node", "moved.capture");
  const RunResult moved = run({"convert", "moved.capture", "--out", "x.capture"});
  EXPECT_TRUE(says(moved.err, "the mesh fills (0, 0, 0) to (0.15, 0.1, 0.1) (metres)")) << moved.err;
}

TEST_F(Incise, ABodyOneTetrahedronThickIsNotSaidToBeCutAlready) {
  core::MeshData one;
  one.positions = {{0, 0, 0}, {0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}};
  one.tets = {{0, 1, 2, 3}};
  mesh_io::write_mesh(dir_ / "one.node", one);
  write("pass.tum", "0 0.03 -0.02 0.12 0 0 0 1\n0.5 0.03 0.12 0.12 0 0 0 1\n");
  const RunResult result =
      run({"cut", "--mesh", "one", "--poses", "pass.tum", "--blade", kBlade, "--out", "x.vtu"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_TRUE(says(result.err, "or is where the body is only one tetrahedron thick, which is not parted"))
      << result.err;
}

// Whatever ends it: the capture that was there stays, and nothing else does, but where it is killed outright.
TEST_F(Incise, AnInterruptedConversionLeavesTheCaptureThatWasThere) {
  write_cube_and_sweep(0.37, 100'000);
  write("keep.capture", "what was there");
  for (const int signal : {SIGINT, SIGTERM, SIGKILL}) {
    const tests::Started started =
        tests::start_program("incise", {"convert", "sweep.csv", "--mesh", "cube", "--out", "keep.capture"},
                             dir_, dir_ / "stdout.txt");
    const auto parts = [&] {
      return std::count_if(fs::directory_iterator(dir_), fs::directory_iterator(), [](const auto& entry) {
        return entry.path().filename().string().starts_with("keep.capture.tmp");
      });
    };
    for (int i = 0; i < 60'000 && parts() == 0; ++i) ::usleep(1000);
    ASSERT_EQ(parts(), 1);
    ::kill(started.child, signal);
    const RunResult result = tests::end_of(started);
    if (signal == SIGKILL) {
      EXPECT_EQ(result.exit_code, 128 + SIGKILL);
    } else {
      expect_error(result, 1, {"interrupted: keep.capture was not written"});
      EXPECT_EQ(parts(), 0);
      EXPECT_FALSE(fs::exists(dir_ / "keep.capture.lock"));
    }
    EXPECT_EQ(tests::read_file(dir_ / "keep.capture"), "what was there");
  }
}

TEST_F(Incise, ALinkIsFollowed) {
  write_cube_and_sweep();
  fs::create_directory(dir_ / "elsewhere");
  for (const char* name : {"out.vtu", "out.capture"}) {
    write(std::string("elsewhere/") + name, "what was there");
    fs::create_symlink(fs::path("elsewhere") / name, dir_ / name);
  }
  ASSERT_EQ(
      run({"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade, "--out", "out.vtu"}).exit_code,
      0);
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "out.capture"}).exit_code, 0);
  for (const char* name : {"out.vtu", "out.capture"}) {
    EXPECT_TRUE(fs::is_symlink(dir_ / name));
    EXPECT_GT(fs::file_size(dir_ / "elsewhere" / name), 100u);
  }
}

TEST_F(Incise, ACaptureThatWasNotClosedIsAWarning) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  EXPECT_EQ(run({"replay", "a.capture", "--verify"}).err, "");
  // Without its last record, the end mark.
  const std::string whole = tests::read_file(dir_ / "a.capture");
  std::size_t end = whole.size();
  do {
    write("open.capture", whole.substr(0, --end));
  } while (!json::parse(run({"info", "open.capture", "--json"}).out)["warnings"].empty());
  for (const std::vector<std::string>& how : {std::vector<std::string>{}, {"--verify"}, {"--json"}}) {
    std::vector<std::string> arguments{"replay", "open.capture"};
    arguments.insert(arguments.end(), how.begin(), how.end());
    const RunResult result = run(arguments);
    EXPECT_EQ(result.exit_code, 0);
    EXPECT_NE(result.err.find("warning: open.capture: was not closed"), std::string::npos) << result.err;
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  }
  // So does whatever else reads it, and a capture that is made of it has an end mark.
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always"}})");
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{"export", "open.capture", "--out", "x.vtu"},
        {"convert", "open.capture", "--out", "x.capture"},
        {"cut", "--mesh", "cube", "--poses", "open.capture", "--config", "c.json", "--out", "x.vtu"},
        {"feel", "open.capture", "--mesh", "cube", "--config", "c.json"}}) {
    const RunResult text = run(arguments);
    EXPECT_TRUE(says(text.err, "warning: open.capture: was not closed")) << arguments[0] << ": " << text.err;
    EXPECT_EQ(says(text.out, "closed                 no"), arguments[0] == "convert") << text.out;
    std::vector<std::string> with_json = arguments;
    with_json.emplace_back("--json");
    const json result = json::parse(run(with_json).out);
    ASSERT_TRUE(result.contains("warnings")) << arguments[0];
    EXPECT_TRUE(says(result["warnings"].dump(), "open.capture: was not closed")) << result;
    if (arguments[0] == "convert") {
      EXPECT_EQ(result["closed"], false);
    }
  }
  const json closed = json::parse(run({"convert", "x.capture", "--out", "y.capture", "--json"}).out);
  EXPECT_EQ(closed["closed"], true);
  EXPECT_FALSE(says(closed["warnings"].dump(), "was not closed")) << closed;
}

TEST_F(Incise, ReplayNamesTheFirstBatchThatDiffers) {
  write_cube_and_sweep();
  write("c.json", R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always"}})");
  ASSERT_EQ(
      run({"convert", "sweep.csv", "--mesh", "cube", "--config", "c.json", "--out", "a.capture"}).exit_code,
      0);
  // The same mesh and marks, but another configuration in its header: the hashes must differ.
  write("d.json",
        R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always", "batch_h": 0.4}})");
  ASSERT_EQ(
      run({"convert", "sweep.csv", "--mesh", "cube", "--config", "d.json", "--out", "b.capture"}).exit_code,
      0);
  std::string a = tests::read_file(dir_ / "a.capture");
  const std::string b = tests::read_file(dir_ / "b.capture");
  // Header of b (its length stands at byte 12, its bytes from 20 on), records of a.
  const auto header_end = [](const std::string& capture) {
    std::uint32_t length = 0;
    std::memcpy(&length, capture.data() + 12, sizeof length);
    return std::size_t{20} + length;
  };
  write("mixed.capture", b.substr(0, header_end(b)) + a.substr(header_end(a)));
  const RunResult result = run({"replay", "mixed.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("is the first that differs"), std::string::npos) << result.err;
  EXPECT_NE(result.err.find("batch "), std::string::npos);
}

// Nothing is left to be compared, which is as it should be.
TEST_F(Incise, ACaptureWhoseStrokesWereAllResetIsVerified) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  const std::string path = (dir_ / "a.capture").string();
  const RecordedMotion motion = read_recorded_motion(path);
  {
    CaptureJournal journal(path, motion.good_bytes, motion.records);
    loop::JournalRecord reset;
    reset.kind = loop::JournalRecord::Kind::kReset;
    reset.session = motion.session + 1;
    journal.write(reset);
    journal.flush();
  }
  const RunResult result = run({"replay", "a.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 0) << result.out << result.err;
  const auto marks = std::to_string(motion.marks.size());
  EXPECT_NE(result.out.find("verified: " + marks + " of " + marks + " batches, " + marks +
                            " of them before a reset\n"),
            std::string::npos)
      << result.out;
  EXPECT_EQ(result.err.find("no batch marks"), std::string::npos) << result.err;
}

// A capture on a full disk may have poses whose marks are missing: what they cut is compared with nothing, and that is said.
TEST_F(Incise, AReplaySaysWhatWasNotComparedForWantOfMarks) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  EXPECT_EQ(run({"replay", "a.capture", "--verify"}).err.find("no mark"), std::string::npos);
  std::ifstream in(dir_ / "a.capture", std::ios::binary);
  protocol::CaptureReader reader(in);
  protocol::FileSink sink((dir_ / "b.capture").string(), true);
  protocol::CaptureWriter writer(sink, reader.header());
  std::uint64_t left_out = 0;
  for (protocol::CaptureRecord record; reader.next(record) == protocol::CaptureReader::Status::Record;) {
    const auto* mark = std::get_if<protocol::BatchMark>(&record);
    if (mark != nullptr && mark->revision > 1) {
      ++left_out;
    } else {
      writer.append(record);
    }
  }
  ASSERT_FALSE(writer.flush());
  ASSERT_GT(left_out, 1u);
  const RunResult result = run({"replay", "b.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("b.capture: " + std::to_string(left_out) + " batches have no mark"),
            std::string::npos)
      << result.err;
}

TEST_F(Incise, ACutSaysThatPosesWithoutTheButtonCutAsWell) {
  write_cube_and_sweep();
  const std::vector<std::string> command{"cut", "--mesh", "cube", "--poses", "sweep.csv", "--out", "a.vtu"};
  EXPECT_EQ(run(command).err.find("hold the button"), std::string::npos);
  std::ifstream in(dir_ / "sweep.csv");
  std::string csv{std::istreambuf_iterator<char>(in), {}};
  for (int pose = 0; pose < 3; ++pose) csv.replace(csv.find(",1\n"), 3, ",0\n");
  write("sweep.csv", csv);
  const RunResult result = run(command);
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("sweep.csv: 3 of 400 poses do not hold the button that engages the blade"),
            std::string::npos)
      << result.err;
}

// What came before a reset is compared as well, and what cannot be is counted and named.
TEST_F(Incise, AReplayIsVerifiedFromTheStartWhateverWasReset) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  std::ifstream in(dir_ / "a.capture", std::ios::binary);
  protocol::CaptureReader reader(in);
  std::vector<protocol::CaptureRecord> records;
  for (protocol::CaptureRecord record; reader.next(record) == protocol::CaptureReader::Status::Record;) {
    if (!std::holds_alternative<protocol::EndRecord>(record)) records.push_back(record);
  }
  const auto count = static_cast<int>(std::count_if(records.begin(), records.end(), [](const auto& record) {
    return std::holds_alternative<protocol::BatchMark>(record);
  }));
  ASSERT_GT(count, 3);
  // The motion, a reset, and the motion again; `change` is done to the marks before the reset.
  const auto write_twice = [&](const char* name, const std::function<void(protocol::BatchMark&)>& change) {
    protocol::FileSink sink((dir_ / name).string(), true);
    protocol::CaptureWriter writer(sink, reader.header());
    for (protocol::CaptureRecord record : records) {
      if (auto* mark = std::get_if<protocol::BatchMark>(&record)) change(*mark);
      writer.append(record);
    }
    writer.append(protocol::ResetRecord{12345, 0});
    for (const protocol::CaptureRecord& record : records) writer.append(record);
    ASSERT_FALSE(writer.flush());
  };
  write_twice("twice.capture", [](protocol::BatchMark&) {});
  RunResult result = run({"replay", "twice.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  const std::string all = std::to_string(2 * count), half = std::to_string(count);
  EXPECT_NE(
      result.out.find("verified: " + all + " of " + all + " batches, " + half + " of them before a reset\n"),
      std::string::npos)
      << result.out;
  result = run({"replay", "twice.capture", "--verify", "--json"});
  const json marks = json::parse(result.out)["marks"];
  EXPECT_EQ(marks, (json{{"in_capture", 2 * count},
                         {"compared", 2 * count},
                         {"compared_before_resets", count},
                         {"undone", 0},
                         {"behind_gaps", 0}}));
  write_twice("wrong.capture",
              [](protocol::BatchMark& mark) { mark.state_hash ^= mark.revision == 2 ? 1 : 0; });
  result = run({"replay", "wrong.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("is the first that differs before reset 1: revision 2 was recorded with hash "),
            std::string::npos)
      << result.err;
  EXPECT_EQ(result.out.find("verified"), std::string::npos) << result.out;

  // The last half of the motion is undone.
  const auto poses = [](const protocol::CaptureRecord& record) {
    return std::holds_alternative<protocol::PoseRecord>(record);
  };
  const auto middle =
      std::find_if(records.begin() + static_cast<std::ptrdiff_t>(records.size() / 2), records.end(), poses);
  ASSERT_NE(middle, records.end());
  std::uint64_t revision = 0;
  for (auto record = records.begin(); record != middle; ++record)
    if (const auto* mark = std::get_if<protocol::BatchMark>(&*record)) revision = mark->revision;
  const auto& pose = std::get<protocol::PoseRecord>(*middle);
  records.push_back(
      protocol::UndoRecord{12346, 0, pose.source, pose.pose.source_ns, pose.arrival_ns, revision});
  {
    protocol::FileSink sink((dir_ / "undone.capture").string(), true);
    protocol::CaptureWriter writer(sink, reader.header());
    for (const protocol::CaptureRecord& record : records) writer.append(record);
    ASSERT_FALSE(writer.flush());
  }
  result = run({"replay", "undone.capture", "--verify"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("verified: " + std::to_string(revision) + " of " + half + " batches; " +
                            std::to_string(static_cast<std::uint64_t>(count) - revision) +
                            " were undone, and a replay leaves them out\n"),
            std::string::npos)
      << result.out;
}

TEST_F(Incise, ATornCaptureIsReplayedUpToItsEndAndACorruptOneRefused) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  const std::string whole = tests::read_file(dir_ / "a.capture");
  write("torn.capture", whole.substr(0, whole.size() - 37));
  RunResult result = run({"replay", "torn.capture", "--json"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("warning: torn.capture: cut off"), std::string::npos) << result.err;
  EXPECT_FALSE(json::parse(result.out)["closed"]);
  std::string corrupt = whole;
  corrupt[whole.size() / 2] = static_cast<char>(corrupt[whole.size() / 2] ^ 0x10);
  write("corrupt.capture", corrupt);
  for (const char* command : {"replay", "feel", "cut"}) {
    std::vector<std::string> arguments{command, "corrupt.capture", "--mesh", "cube"};
    if (command[0] == 'c')
      arguments = {"cut", "--poses", "corrupt.capture", "--mesh", "cube", "--out", "o.vtu"};
    expect_error(run(arguments), 1,
                 {"corrupt.capture", "incise replay and export use what is before it with --until-damage",
                  "incise convert --until-damage makes a whole capture of that"});
  }
  expect_error(run({"export", "corrupt.capture", "--out", "a.vtu"}), 1,
               {"corrupt.capture", "--until-damage"});
}

TEST_F(Incise, WhatIsBeforeTheDamageOfACaptureIsUsedWhereThatIsAskedFor) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  const std::string whole = tests::read_file(dir_ / "a.capture");
  std::string damaged = whole;
  damaged[whole.size() / 2] = static_cast<char>(damaged[whole.size() / 2] ^ 0x10);
  write("damaged.capture", damaged);
  const RunResult all = run({"replay", "a.capture", "--json"});
  const RunResult result = run({"replay", "damaged.capture", "--until-damage", "--verify", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json facts = json::parse(result.out);
  EXPECT_TRUE(facts["verified"]);
  EXPECT_GT(facts["poses"], 0);
  EXPECT_LT(facts["poses"], json::parse(all.out)["poses"]);
  const auto poses = std::to_string(facts["poses"].get<int>());
  EXPECT_NE(result.err.find("warning: damaged.capture: damaged (offset "), std::string::npos) << result.err;
  EXPECT_NE(result.err.find("what is before is used: " + poses + " poses, with marks up to revision "),
            std::string::npos)
      << result.err;
  // The revision before the damage is the same in either; a capture made of what is left is whole.
  ASSERT_EQ(run({"export", "damaged.capture", "--until-damage", "--out", "left.vtu"}).exit_code, 0);
  const std::string compared = std::to_string(facts["compared"].get<int>());
  ASSERT_EQ(run({"export", "damaged.capture", "--until-damage", "--revision", compared, "--out", "a.vtu"})
                .exit_code,
            0);
  ASSERT_EQ(run({"export", "a.capture", "--revision", compared, "--out", "b.vtu"}).exit_code, 0);
  EXPECT_EQ(tests::read_file(dir_ / "a.vtu"), tests::read_file(dir_ / "b.vtu"));
  ASSERT_EQ(run({"convert", "damaged.capture", "--until-damage", "--mesh", "cube", "--out", "left.capture"})
                .exit_code,
            0);
  const RunResult left = run({"replay", "left.capture", "--verify", "--json"});
  ASSERT_EQ(left.exit_code, 0) << left.err;
  EXPECT_EQ(json::parse(left.out)["poses"], facts["poses"]);
  // Without a good header there is nothing before it.
  std::string headless = whole;
  headless[30] = static_cast<char>(headless[30] ^ 0x10);
  write("headless.capture", headless);
  const RunResult none = run({"replay", "headless.capture", "--until-damage"});
  EXPECT_EQ(none.exit_code, 1);
  EXPECT_EQ(none.err.find("--until-damage"), std::string::npos) << none.err;
}

TEST_F(Incise, ACaptureThatAServerWritesIsNotOverwritten) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  const std::string before = tests::read_file(dir_ / "a.capture");
  {
    const CaptureLock server(dir_ / "a.capture");
    expect_error(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}), 1,
                 {"--out: a.capture is being written by another incised (process "});
    EXPECT_EQ(tests::read_file(dir_ / "a.capture"), before);
  }
  EXPECT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  EXPECT_FALSE(fs::exists(dir_ / "a.capture.lock"));
}

// Holders of a blade have clocks of their own, and a capture has poses that were rejected, too.
// When poses reached the server is in what convert makes of a capture, too: incise feel and players go by that.
TEST_F(Incise, ConvertKeepsWhenPosesArrived) {
  write_cube_and_sweep();
  protocol::CaptureHeader header;
  header.config_json = R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}, "cut": {"engage": "always"}})";
  {
    protocol::FileSink sink((dir_ / "a.capture").string(), true);
    protocol::CaptureWriter writer(sink, header);
    for (int i = 0; i < 100; ++i) {
      protocol::PoseRecord record;
      record.pose.source_ns = 5'000'000'000 + 1'000'000 * i;
      record.pose.position = {0.041, -0.02 + 0.0014 * i, 0.12};
      record.pose.orientation = {1, 0, 0, 0};
      record.arrival_ns = 70'000'000'000 + 3'000'000 * i;
      writer.append(record);
    }
    writer.append(protocol::EndRecord{});
    ASSERT_FALSE(writer.flush());
  }
  const RunResult made = run({"convert", "a.capture", "--mesh", "cube", "--out", "b.capture"});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  const auto poses = [&](const char* name) {
    std::vector<protocol::PoseRecord> all;
    std::ifstream in(dir_ / name, std::ios::binary);
    protocol::CaptureReader reader(in);
    protocol::CaptureRecord record;
    while (reader.next(record) == protocol::CaptureReader::Status::Record) {
      if (const auto* pose = std::get_if<protocol::PoseRecord>(&record)) all.push_back(*pose);
    }
    return all;
  };
  EXPECT_EQ(poses("b.capture").size(), 100u);
  EXPECT_TRUE(poses("b.capture") == poses("a.capture"));
}

TEST_F(Incise, InfoSumsTheMotionOfEachHolder) {
  constexpr std::int64_t kMs = 1'000'000;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  protocol::FileSink sink((dir_ / "a.capture").string(), true);
  protocol::CaptureWriter writer(sink, {});
  const auto pose = [&](std::int64_t t_ns, double x, std::uint32_t source = 0) {
    protocol::PoseRecord record;
    record.source = source;
    record.pose.source_ns = t_ns;
    record.pose.position = {x, 0, 0};
    record.pose.orientation = {1, 0, 0, 0};
    writer.append(record);
  };
  for (const std::int64_t origin : {1'000'000 * kMs, 10 * kMs, 5'000'000 * kMs}) {
    if (origin == 10 * kMs) writer.append(protocol::StrokeRecord{0, protocol::StrokeAction::HandOver, 0, 0});
    if (origin == 5'000'000 * kMs) writer.append(protocol::BladeRecord{0, 0, {}});
    for (int i = 0; i <= 100; ++i) {
      pose(origin + i * kMs, 1e-3 * i);
      if (i == 50) pose(origin + i * kMs, 7);  // again at that time: rejected
    }
    pose(origin + 150 * kMs, nan);
  }
  pose(std::numeric_limits<std::int64_t>::min(), 0, 1);
  pose(std::numeric_limits<std::int64_t>::max(), 0.5, 1);
  pose(1, nan, 2);
  EXPECT_FALSE(writer.flush());
  const RunResult result = run({"info", "a.capture", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const json sources = json::parse(result.out)["sources"];
  ASSERT_EQ(sources.size(), 3u);
  EXPECT_EQ(sources[0]["poses"], 3 * 103);
  EXPECT_EQ(sources[0]["poses_not_finite"], 3);
  EXPECT_NEAR(sources[0]["duration_s"].get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(sources[0]["longest_gap_s"].get<double>(), 1e-3, 1e-9);
  EXPECT_NEAR(sources[0]["rate_hz"].get<double>(), 1000, 1);
  EXPECT_NEAR(sources[0]["path_m"].get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(sources[0]["fastest_m_s"].get<double>(), 1, 1e-6);
  EXPECT_NEAR(sources[1]["duration_s"].get<double>(), 0x1p64 * 1e-9, 1e3);
  EXPECT_NEAR(sources[1]["path_m"].get<double>(), 0.5, 1e-9);
  EXPECT_FALSE(sources[1].contains("poses_not_finite"));
  EXPECT_EQ(sources[2]["path_m"], 0.0);
  EXPECT_EQ(sources[2]["poses_not_finite"], 1);
}

TEST_F(Incise, InfoKnowsWhatAFileIs) {
  write_cube_and_sweep();
  const auto facts = [&](const std::string& file) {
    const RunResult result = run({"info", file, "--json"});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return result.exit_code == 0 ? json::parse(result.out) : json();
  };
  json mesh = facts("cube");
  EXPECT_EQ(mesh["kind"], "tetrahedral mesh");
  EXPECT_EQ(mesh["tets"], 1296);
  EXPECT_EQ(mesh["boundary_faces"], 6 * 72);
  json motion = facts("sweep.csv");
  EXPECT_EQ(motion["kind"], "motion, CSV");
  EXPECT_EQ(motion["poses"], 400);
  EXPECT_NEAR(motion["sources"][0]["rate_hz"].get<double>(), 1000, 1);
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  json capture = facts("a.capture");
  EXPECT_EQ(capture["kind"], "capture");
  EXPECT_EQ(capture["poses"], 400);
  EXPECT_TRUE(capture["closed"]);
  ASSERT_EQ(run({"phantom", "slab", "--size", "600", "--out", "slab.stl"}).exit_code, 0);
  loop::Checkpoint checkpoint;
  checkpoint.revision = 7;
  checkpoint.state.resize(100);
  loop::write_checkpoint((dir_ / "a.capture.checkpoint-0").string(), checkpoint);
  const json resumed = facts("a.capture.checkpoint-0");
  EXPECT_EQ(resumed["kind"], "checkpoint of a capture");
  EXPECT_EQ(resumed["revision"], 7);
  std::string damaged = tests::read_file(dir_ / "a.capture.checkpoint-0");
  damaged.back() = 1;
  write("damaged.checkpoint-0", damaged);
  expect_error(run({"info", "damaged.checkpoint-0"}), 1, {"damaged.checkpoint-0: is damaged", "--resume"});
  json surface = facts("slab.stl");
  EXPECT_EQ(surface["kind"], "surface");
  EXPECT_TRUE(surface["fillable"]);
  // What a .glb looks like is listed, and it is a mesh to cut like another.
  ASSERT_EQ(run({"phantom", "slab", "--size", "600", "--out", "slab.glb"}).exit_code, 0);
  json glb = facts("slab.glb");
  EXPECT_TRUE(glb["fillable"]);
  EXPECT_EQ(glb["corners_have"], json::array({"normals"}));
  ASSERT_EQ(glb["materials"].size(), 1u);
  EXPECT_EQ(glb["materials"][0]["name"], "outside");
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "slab.glb", "--out", "glb.capture"}).exit_code, 0);
  ASSERT_EQ(run({"export", "glb.capture", "--revision", "0", "--out", "again.glb"}).exit_code, 0);
  EXPECT_TRUE(facts("again.glb")["fillable"]);
  write("c.json", "{}");
  EXPECT_EQ(facts("c.json")["kind"], "configuration");
  write("relay.json", R"({"relay": {"upstream": "127.0.0.1:7450"}})");
  EXPECT_EQ(facts("relay.json")["kind"], "configuration of incise-relay");
  EXPECT_EQ(facts("relay.json")["follows"], "127.0.0.1:7450");
  write("relay2.json", R"({"relay": {"upstraem": "127.0.0.1:7450"}})");
  expect_error(run({"info", "relay2.json"}), 1,
               {"relay2.json: unknown key \"relay.upstraem\"", "upstream_http_port"});
  write("spec.json", R"({"bodies": ["a.vtu", "b.vtu"], "motions": ["m.csv"]})");
  EXPECT_EQ(facts("spec.json")["kind"], "specification of incise sweep");
  EXPECT_EQ(facts("spec.json")["bodies"], 2);
  write("manifest.json", R"({"format": 1, "spec": {}, "samples": 9, "complete": true, "shards": []})");
  EXPECT_EQ(facts("manifest.json")["kind"], "manifest of a data set of incise sweep");
  EXPECT_EQ(facts("manifest.json")["samples"], 9);
  write("notes.txt", "what else there is\n");
  expect_error(run({"info", "notes.txt"}), 1,
               {"not a file that incise knows", "checkpoint", "incise-relay", "device profile", "report"});
  for (const char* file : {"cube", "sweep.csv", "a.capture", "slab.stl", "slab.glb", "c.json"}) {
    EXPECT_EQ(run({"info", file}).exit_code, 0) << file;
  }
  expect_error(run({"info", "nothing"}), 1, {"nothing", "no such file"});
}

// By material's name: area on the body, and whether faces have it.
std::map<std::string, double> areas_by_material(const mesh_io::Surface& surface) {
  std::map<std::string, double> areas;
  for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
    const auto& v = surface.triangles[t];
    const core::Vec3& a = surface.positions[v[0]];
    areas[surface.look.materials[surface.look.material_of[t]].name] +=
        0.5 * length(cross(surface.positions[v[1]] - a, surface.positions[v[2]] - a));
  }
  return areas;
}

// A cube of 10 cm with fat above muscle, cut from top to bottom: skin, texture and inside of each region, in both formats.
TEST_F(Incise, FilesWithMaterialsHaveThoseOfTheRegions) {
  write_cube_and_sweep();
  core::MeshData body = tests::cube(6);
  body.regions.clear();
  double top = 0;
  for (const core::Vec3& p : body.positions) top = std::max(top, p.z);
  for (const auto& tet : body.tets) {
    double z = 0;
    for (const auto v : tet) z += body.positions[v].z / 4;
    body.regions.push_back(z > top / 2 ? 7 : 3);
  }
  mesh_io::write_mesh(dir_ / "body.vtu", body);
  write("c.json", R"({"mesh": {"path": "body.vtu"}, "cut": {"engage": "always"},
    "blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.14]}, "materials": [
      {"region": 7, "tissue": "fat", "inside": {"texture": "fat.png"}},
      {"region": 3, "tissue": "muscle", "inside": {"colour": [0.5, 0.25, 1], "roughness": 0.75}}]})");
  const std::vector<std::string> cut{"cut",       "--mesh",   "body.vtu", "--poses",
                                     "sweep.csv", "--config", "c.json",   "--out"};
  const auto with = [](std::vector<std::string> arguments, const std::vector<std::string>& more) {
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  };
  expect_error(run(with(cut, {"a.glb"})), 1, {"c.json: materials, region 7, inside.texture: ", "fat.png"});
  EXPECT_FALSE(fs::exists(dir_ / "a.glb"));
  EXPECT_EQ(run(with(cut, {"a.vtu"})).exit_code, 0) << "which has no textures";
  write("fat.png", tests::tiny_png());
  write("again.mtl", "newmtl precious\n");
  expect_error(run(with(cut, {"again.obj"})), 1, {"again.mtl: would be overwritten"});
  ASSERT_EQ(run(with(cut, {"a.glb"})).exit_code, 0);
  ASSERT_EQ(run(with(cut, {"a.obj"})).exit_code, 0);
  ASSERT_EQ(run(with(cut, {"a.obj"})).exit_code, 0) << "its own .mtl is replaced";
  ASSERT_EQ(run({"convert", "sweep.csv", "--config", "c.json", "--out", "a.capture"}).exit_code, 0);
  ASSERT_EQ(run({"export", "a.capture", "--config", "c.json", "--out", "b.glb"}).exit_code, 0);
  for (const char* file : {"a.glb", "a.obj", "b.glb"}) {
    std::vector<std::string> warnings;
    const mesh_io::Surface surface = mesh_io::read_surface(dir_ / file, warnings);
    EXPECT_TRUE(warnings.empty()) << warnings[0];
    const auto areas = areas_by_material(surface);
    ASSERT_EQ(areas.size(), 4u) << file;
    // Half of a side of 10 cm, twice; three sides of the outside are half a region's, and one is all of it.
    EXPECT_NEAR(areas.at("inside_7_fat"), 0.01, 0.002) << file;
    EXPECT_NEAR(areas.at("inside_3_muscle"), 0.01, 0.002) << file;
    EXPECT_NEAR(areas.at("outside_7_fat"), 0.03, 0.002) << file;
    EXPECT_NEAR(areas.at("outside_3_muscle"), 0.03, 0.002) << file;
    for (const mesh_io::Material& material : surface.look.materials) {
      if (material.name == "inside_7_fat") {
        ASSERT_NE(material.image, nullptr) << file;
        EXPECT_EQ(*material.image, tests::tiny_png());
      } else {
        EXPECT_EQ(material.image, nullptr) << file << " " << material.name;
      }
      if (material.name == "inside_3_muscle") {
        EXPECT_NEAR(material.diffuse[0], 0.5, 1e-4);
        EXPECT_NEAR(material.diffuse[2], 1, 1e-4);
      }
    }
    // The image is put on in squares of 5 cm: as long on the texture as on the body.
    for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
      if (surface.look.materials[surface.look.material_of[t]].name != "inside_7_fat") continue;
      for (std::size_t k = 0; k < 3; ++k) {
        const auto &a = surface.look.uvs[3 * t + k], &b = surface.look.uvs[3 * t + (k + 1) % 3];
        const double on_texture = std::hypot(a[0] - b[0], a[1] - b[1]);
        const double on_body = length(surface.positions[surface.triangles[t][k]] -
                                      surface.positions[surface.triangles[t][(k + 1) % 3]]);
        EXPECT_NEAR(on_texture, on_body / 0.05, 0.2 * on_body / 0.05) << file;
      }
    }
  }
  std::ifstream obj(dir_ / "a.obj");
  std::string line;
  int switches = 0;
  while (std::getline(obj, line)) switches += line.starts_with("usemtl") ? 1 : 0;
  EXPECT_EQ(switches, 4) << "faces come by material";
  // A capture does not know where the textures are, and says so.
  const RunResult without = run({"export", "a.capture", "--out", "c.glb"});
  EXPECT_EQ(without.exit_code, 0);
  EXPECT_NE(without.err.find("name its file with --config"), std::string::npos) << without.err;
}

TEST_F(Incise, WhatCannotBeWrittenToItsEndIsRemoved) {
  write_cube_and_sweep();
  const std::vector<std::string> cut = {"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade};
  const auto with = [](std::vector<std::string> all, const std::vector<std::string>& more) {
    all.insert(all.end(), more.begin(), more.end());
    return all;
  };
  ASSERT_EQ(run(with(cut, {"--out", "whole", "--report", "whole.json"})).exit_code, 0);
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "whole.capture"}).exit_code, 0);
  // A limit on the size of files stands for a full disk.
  const auto limited = [&](std::uintmax_t bytes, const std::vector<std::string>& arguments) {
    rlimit before{};
    ::getrlimit(RLIMIT_FSIZE, &before);
    const rlimit less{bytes, before.rlim_max};
    const auto handler = std::signal(SIGXFSZ, SIG_IGN);
    ::setrlimit(RLIMIT_FSIZE, &less);
    RunResult result = run(arguments);
    ::setrlimit(RLIMIT_FSIZE, &before);
    std::signal(SIGXFSZ, handler);
    return result;
  };
  ASSERT_LT(fs::file_size(dir_ / "whole.node"), fs::file_size(dir_ / "whole.ele"));
  expect_error(limited(fs::file_size(dir_ / "whole.ele") - 1, with(cut, {"--out", "part"})), 1,
               {"part.ele: cannot be written"});
  expect_error(limited(fs::file_size(dir_ / "whole.json") / 2,
                       with(cut, {"--policy", "compare", "--report", "part.json"})),
               1, {"part.json: cannot be written"});
  EXPECT_EQ(limited(fs::file_size(dir_ / "whole.capture") / 2,
                    {"convert", "sweep.csv", "--mesh", "cube", "--out", "part.capture"})
                .exit_code,
            1);
  for (const auto& entry : fs::directory_iterator(dir_))
    EXPECT_FALSE(entry.path().filename().string().starts_with("part")) << entry.path();
}

TEST_F(Incise, WhatCannotBePrintedIsAFailure) {
  write_cube_and_sweep();
  ASSERT_EQ(run({"convert", "sweep.csv", "--mesh", "cube", "--out", "a.capture"}).exit_code, 0);
  const std::vector<std::string> cut = {"cut", "--mesh", "cube", "--poses", "sweep.csv", "--blade", kBlade};
  auto compare = cut, report = cut;
  compare.insert(compare.end(), {"--policy", "compare"});
  report.insert(report.end(), {"--out", "out.vtu", "--json"});
  for (const std::vector<std::string>& arguments : {std::vector<std::string>{"--help"},
                                                    {"--version"},
                                                    {"cut", "--help"},
                                                    {},
                                                    {"info", "a.capture", "--json"},
                                                    {"replay", "a.capture"},
                                                    {"feel", "sweep.csv", "--mesh", "cube", "--json"},
                                                    compare,
                                                    report}) {
    SCOPED_TRACE(arguments.empty() ? "nothing" : arguments[0]);
    expect_error(tests::end_of(tests::start_program("incise", arguments, dir_, "/dev/full")), 1,
                 {"incise: the standard output could not be written to its end"});
  }
}

TEST_F(Incise, InfoNamesWhatItDescribes) {
  write("a.xyz", "nothing");
  expect_error(run({"info", "a.xyz"}), 1, {"it knows a mesh", ".glb", ".vtp", ".nii.gz", "a capture"});
  expect_error(run({"info", ""}), 2, {"FILE is empty; name a file"});
}

TEST_F(Incise, AMonitoredDeviceThatIsNotConnectedIsNamed) {
  expect_error(run({"devices", "--monitor", "--device", "1234:abcd"}), 1,
               {"--device 1234:abcd: is not connected"});
}

TEST_F(Incise, DoctorNamesWhatIsInTheWayAndTheRemedy) {
  // A port that is in use, a processor that does not exist, a place that cannot be written to.
  const int s = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(::bind(s, reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(::listen(s, 1), 0);
  ASSERT_EQ(::getsockname(s, reinterpret_cast<sockaddr*>(&address), &size), 0);
  write("bad.json",
        R"({"mesh": {"phantom": "slab"}, "loop": {"cpu": 1000}, "capture": {"path": "bad.json/a.capture"},
    "listen": {"http_port": 0, "tcp_port": )" +
            std::to_string(ntohs(address.sin_port)) + "}}");
  const RunResult bad = run({"doctor", "--config", "bad.json", "--json"});
  EXPECT_EQ(bad.exit_code, 1);
  std::map<std::string, json> findings;
  const json report = json::parse(bad.out);
  for (const json& finding : report["findings"]) findings[finding["what"]] = finding;
  for (const auto& [what, found] : {std::pair{"listen.tcp_port", "Address already in use"},
                                    {"processors", "loop.cpu is 1000"},
                                    {"capture.path", "bad.json: Not a directory"}}) {
    ASSERT_TRUE(findings.contains(what)) << bad.out;
    EXPECT_EQ(findings[what]["verdict"], "fault") << bad.out;
    EXPECT_NE(findings[what]["found"].get<std::string>().find(found), std::string::npos) << bad.out;
    EXPECT_TRUE(findings[what].contains("remedy")) << bad.out;
  }
  if (findings["real-time priority"]["verdict"] == "good") {  // no advice to get what is granted
    EXPECT_EQ(findings["wake-ups at 1 kHz"].value("remedy", "").find("real-time"), std::string::npos)
        << bad.out;
  }
  for (const char* what : {"configuration", "clock", "listen.http_port", "incise-tetgen"}) {
    EXPECT_EQ(findings[what]["verdict"], "good") << what << ": " << bad.out;
  }
  ::close(s);

  write("good.json", R"({"mesh": {"phantom": "slab"}, "listen": {"tcp_port": 0, "http_port": 0}})");
  const RunResult good = run({"doctor", "--config", "good.json"});
  EXPECT_EQ(good.exit_code, 0) << good.out << good.err;
  EXPECT_NE(good.out.find(": 0 faults, "), std::string::npos) << good.out;

  write("wrong.json", R"({"mesh": {"phantom": "spleen"}})");
  const RunResult wrong = run({"doctor", "--config", "wrong.json"});
  EXPECT_EQ(wrong.exit_code, 1);
  EXPECT_NE(wrong.out.find("fault    configuration"), std::string::npos) << wrong.out;
  EXPECT_NE(wrong.out.find("spleen"), std::string::npos) << wrong.out;
}

TEST_F(Incise, PhantomsAreTheSameEveryTime) {
  for (const char* out : {"a.node", "b.node"}) {
    const RunResult result = run({"phantom", "cylinder", "--size", "1500", "--out", out});
    ASSERT_EQ(result.exit_code, 0) << result.err;
  }
  EXPECT_EQ(tests::read_file(dir_ / "a.node"), tests::read_file(dir_ / "b.node"));
  EXPECT_EQ(tests::read_file(dir_ / "a.ele"), tests::read_file(dir_ / "b.ele"));
  expect_error(run({"phantom", "kidney", "--out", "k.node"}), 2, {"kidney", "liver"});
  expect_error(run({"phantom", "slab", "--size", "10", "--out", "k.node"}), 2, {"10"});
  expect_error(run({"phantom", "slab", "--out", "nowhere/k.node"}), 1, {"nowhere"});
}

TEST_F(Incise, CutsTheRealOrgansOfTheTestData) {
  const char* data = std::getenv("INCISE_DATA");
  if (!data) GTEST_SKIP() << "INCISE_DATA is not set: no real meshes";
  for (const char* name : {"liver_6564", "seed_1720", "armadillo_3717", "wound_1476"}) {
    const std::string mesh = std::string(data) + "/meshes/" + name;
    const json facts = json::parse(run({"info", mesh, "--json"}).out);
    const auto low = facts["box_m"]["min"].get<std::vector<double>>(),
               high = facts["box_m"]["max"].get<std::vector<double>>();
    // A plane through the middle: the blade along z, from below y to above it.
    std::string csv = "t_s,x_m,y_m,z_m\n";
    for (int i = 0; i <= 100; ++i) {
      const double s = i / 100.0;
      csv += std::to_string(s) + "," + std::to_string(0.53 * low[0] + 0.47 * high[0]) + "," +
             std::to_string(low[1] + (1.2 * s - 0.1) * (high[1] - low[1])) + "," + std::to_string(low[2]) +
             "\n";
    }
    write("plane.csv", csv);
    const double size = high[2] - low[2];
    const RunResult result = run({"cut", "--mesh", mesh, "--poses", "plane.csv", "--blade",
                                  "0,0," + std::to_string(-0.1 * size) + ":0,0," + std::to_string(1.1 * size),
                                  "--out", "out.vtu", "--json"});
    ASSERT_EQ(result.exit_code, 0) << name << ": " << result.err;
    const json report = json::parse(result.out);
    EXPECT_GE(report["pieces"], report["pieces_before"].get<int>() + 1) << name;
    EXPECT_EQ(report["inverted"], 0) << name;
    EXPECT_NEAR(report["volume_after"].get<double>() / report["volume_before"].get<double>(), 1.0, 1e-3)
        << name;
  }
}

}  // namespace
}  // namespace incise::app
