// incised as a user starts it: the built program, its exit codes and its messages.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <spawn.h>

#include <csignal>
#include <nlohmann/json.hpp>
#include <thread>

#include "server/app/certificate_check.hpp"
#include "server/app/config.hpp"
#include "server/base/clock.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/support/bodies.hpp"
#include "tests/support/run_program.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using tests::RunResult;

class Incised : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ = tests::fresh_directory(::testing::UnitTest::GetInstance()->current_test_info()->name());
    mesh_io::write_mesh(dir_ / "cube.node", tests::cube(4));
  }
  void TearDown() override {
    if (!HasFailure()) fs::remove_all(dir_);
  }
  RunResult run(const std::vector<std::string>& arguments) {
    return tests::run_program("incised", arguments, dir_);
  }
  void write(const std::string& name, const std::string& text) {
    std::ofstream(dir_ / name, std::ios::binary) << text;
  }

  // A server in the background; waits until it is ready.
  pid_t start(std::vector<std::string> arguments) {
    const std::string log = (dir_ / "log.txt").string(), program = std::string(INCISE_BIN_DIR) + "/incised";
    fs::remove(log);
    posix_spawn_file_actions_t files;
    posix_spawn_file_actions_init(&files);
    posix_spawn_file_actions_addopen(&files, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_APPEND, 0644);
    posix_spawn_file_actions_adddup2(&files, 1, 2);
    arguments.insert(arguments.begin(), program);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_t pid = -1;
    EXPECT_EQ(posix_spawn(&pid, program.c_str(), &files, nullptr, argv.data(), environ), 0);
    posix_spawn_file_actions_destroy(&files);
    while (tests::read_file(log).find("ready:") == std::string::npos) {
      if (waitpid(pid, nullptr, WNOHANG) == pid) {
        ADD_FAILURE() << tests::read_file(log);
        return -1;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    return pid;
  }
  static int stop(pid_t pid, int signal) {
    kill(pid, signal);
    int status = -1;
    waitpid(pid, &status, 0);
    return status;
  }
  std::string config(const std::string& more = "") const {
    return R"({"mesh": {"path": "cube.node"}, "listen": {"tcp_port": 0, "http_port": 0},
               "loop": {"realtime_priority": 0, "lock_memory": false}, "capture": {"path": "session.capture"})" +
           more + "}";
  }
  fs::path dir_;
};

TEST_F(Incised, WithoutArgumentsShowsItsOptions) {
  const RunResult result = run({});
  EXPECT_EQ(result.exit_code, 0);
  for (const char* option : {"--config", "--check", "--print-config", "--resume"}) {
    EXPECT_NE(result.out.find(option), std::string::npos) << option;
  }
  EXPECT_EQ(run({"--help"}).out, result.out);
  EXPECT_EQ(run({"--frob"}).exit_code, 2);
  EXPECT_EQ(run({"--resume"}).exit_code, 2);
}

TEST_F(Incised, WhatCannotBePrintedIsAFailure) {
  for (const char* option : {"--print-config", "--help", "--version"}) {
    const RunResult full = tests::end_of(tests::start_program("incised", {option}, dir_, "/dev/full"));
    EXPECT_EQ(full.exit_code, 1) << option;
    EXPECT_EQ(full.err.rfind("incised: the standard output could not be written to its end", 0), 0u)
        << full.err;
    EXPECT_EQ(std::count(full.err.begin(), full.err.end(), '\n'), 1) << full.err;
  }
}

TEST_F(Incised, PrintConfigPrintsAFileThatItTakes) {
  const RunResult printed = run({"--print-config"});
  ASSERT_EQ(printed.exit_code, 0);
  EXPECT_EQ(compact(parse_config(printed.out, "printed")), compact(Config{}));
}

TEST_F(Incised, CheckSaysGoodOrWhatIsNot) {
  write("good.json", config());
  RunResult result = run({"--check", "good.json"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.out, "good.json: good\n");
  write("bad.json", R"({"loop": {"rate_hz": 100}})");
  result = run({"--check", "bad.json"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_EQ(result.out, "");
  EXPECT_EQ(result.err,
            "incised: bad.json: loop.rate_hz: found 100; accepted is a number from 250 to 4000\n");
  write("none.json", R"({"mesh": {"path": "nowhere.node"}})");
  // A configuration that works, but not as it reads.
  write("absent.json", R"({"mesh": {"phantom": "slab"}, "materials": [{"region": 4, "tissue": "fat"}]})");
  result = run({"--check", "absent.json"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("absent.json: warning: materials: the mesh has no region 4"), std::string::npos)
      << result.out;
  EXPECT_TRUE(result.out.ends_with("absent.json: good\n")) << result.out;
  EXPECT_NE(run({"--check", "none.json"}).err.find("mesh.path"), std::string::npos);
  // A blade in millimetres, and a body where no blade goes: refused as it starts, too.
  write("long.json", R"({"mesh": {"phantom": "slab"}, "sources": [{"name": "a"},
      {"name": "b", "tip": [0, 0, -120]}]})");
  write("far.node", "4 3 0 0\n0 20000 0 0\n1 20000.1 0 0\n2 20000 0.1 0\n3 20000 0 0.1\n");
  write("far.ele", "1 4 0\n0 0 1 2 3\n");
  write("far.json", R"({"mesh": {"path": "far.node"}})");
  for (const auto& [file, fault] : {
           std::pair{"long.json", "sources[1]: the blade is 120 m long, the body"},
           std::pair{"long.json", "this looks like millimetres; divide by 1000"},
           std::pair{"far.json", "no pose may be more than 10 km from the origin"},
       }) {
    for (const char* option : {"--check", "--config"}) {
      result = run({option, file});
      EXPECT_EQ(result.exit_code, 1) << result.out;
      EXPECT_NE(result.err.find(fault), std::string::npos) << result.err;
    }
  }
  EXPECT_EQ(run({"--config", "bad.json"}).exit_code, 1);
  EXPECT_EQ(run({"--config", "missing.json"}).exit_code, 1);
}

TEST_F(Incised, CheckWithoutAFileChecksThatOfConfig) {
  write("c.json", config());
  write("v.json", R"({"version": 6})");
  for (const std::vector<std::string>& one :
       {std::vector<std::string>{"--config", "c.json", "--check"}, {"--check", "--config", "c.json"}}) {
    EXPECT_EQ(run(one).out, "c.json: good\n") << run(one).err;
  }
  RunResult result = run({"--config", "nope.json", "--check", "v.json"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_EQ(result.err,
            "incised: --check v.json and --config nope.json: choose one; either checks a file, the second as "
            "--config FILE --check; see incised --help\n");
  result = run({"--check"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_EQ(result.err,
            "incised: --check needs a file: --check FILE, or --config FILE --check; see incised --help\n");
  write("r.json", R"({"relay": {"upstream": "a"}})");
  EXPECT_EQ(tests::run_program("incise-relay", {"--config", "r.json", "--check"}, dir_).out,
            "r.json: good\n");
  EXPECT_EQ(tests::run_program("incise-relay", {"--check"}, dir_).exit_code, 2);
}

TEST_F(Incised, APortInUseComesWithWhatToDo) {
  const stream::Listener taken;
  write("c.json", R"({"mesh": {"path": "cube.node"}, "loop": {"realtime_priority": 0, "lock_memory": false},
                      "listen": {"http_port": 0, "tcp_port": )" +
                      std::to_string(taken.port()) + "}}");
  const RunResult result = run({"--config", "c.json"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(
      result.err.find("Address already in use; end the program that listens there (ss -ltnp shows it), or "
                      "choose another listen.tcp_port (0: any free one)\n"),
      std::string::npos)
      << result.err;
}

TEST_F(Incised, TheTemplateSaysThatItNeedsABody) {
  write("c.json", run({"--print-config"}).out);
  const RunResult result = run({"--check", "c.json"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("what --print-config prints leaves the body to you"), std::string::npos)
      << result.err;
}

// --check finds the same faults as the start does, and the start finds them before it works on the mesh.
TEST_F(Incised, CheckLooksAtTheFilesThatAreNamed) {
  const auto fault = [&](const std::string& mesh, const std::string& rest) {
    write("c.json", "{\"mesh\": {" + mesh + "}" + rest + "}");
    const RunResult checked = run({"--check", "c.json"});
    EXPECT_EQ(checked.out.empty(), checked.exit_code != 0);
    EXPECT_EQ(checked.err.empty(), checked.exit_code == 0) << checked.err;
    return checked.err;
  };
  const std::string cube = R"("path": "cube.node")",
                    phantom = R"("phantom": "liver", "target_tets": 2000000)";
  EXPECT_EQ(fault(cube, ""), "");
  // The mesh.
  write("garbage.vtk", "nonsense");
  write("open.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n");
  for (const char* name : {"garbage.vtk", "open.off", "none.msh"}) {
    EXPECT_NE(fault("\"path\": \"" + std::string(name) + "\"", "").find(name), std::string::npos) << name;
  }
  fs::create_directories(dir_ / "folder.msh");
  EXPECT_NE(fault(R"("path": "folder.msh")", "").find("mesh.path"), std::string::npos);
  // The rest: the start is refused at once, although the body would take minutes to make.
  write("tokens.json", R"([{"token": "short", "roles": ["viewer"]}])");
  write("roles.json", R"([{"token": "sixteen letters or more", "roles": ["metric"]}])");
  write("rights.json", R"([{"token": "sixteen letters or more", "roles": []}])");
  write("server.pem", "no certificate");
  fs::create_directories(dir_ / "place");
  const std::vector<std::pair<std::string, std::string>> faults{
      {R"(, "listen": {"token_file": "tokens.json"})", "listen.token_file"},
      {R"(, "listen": {"token_file": "roles.json"})", "\"metrics\""},
      {R"(, "listen": {"token_file": "rights.json"})", "no roles"},
      {R"(, "listen": {"token_file": "place"})", "listen.token_file"},
      {R"(, "listen": {"certificate_file": "server.pem", "private_key_file": "server.pem"})",
       "listen.certificate_file"},
      {R"(, "listen": {"viewer_directory": "server.pem"})", "listen.viewer_directory"},
      {R"(, "listen": {"address": "localhost"})", "listen.address"},
      {R"(, "capture": {"path": "nowhere/a.capture"})", "capture.path"},
      {R"(, "capture": {"path": "place"})", "capture.path"},
      {R"(, "capture": {"path": "/proc/x.capture"})", "capture.path"},
      {R"(, "capture": {"library": "server.pem"})", "capture.library"},
      {R"(, "devices": {"profiles": "nowhere"})", "devices.profiles"}};
  for (const auto& [rest, named] : faults) {
    ASSERT_NE(fault(cube, rest).find(named), std::string::npos) << rest << " (a server would start and stay)";
    EXPECT_EQ(fault(phantom, rest), run({"--config", "c.json"}).err) << rest;
  }
}

// Clients refuse an expired certificate, so the operator is warned two weeks ahead.
TEST_F(Incised, ACertificateThatIsNotValidForLongIsWarnedOf) {
  const auto make = [&](const std::string& days) {
    const std::string command =
        "cd " + dir_.string() +
        " && openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj /CN=here "
        "-keyout server.key -out server.pem -days " +
        days + " >/dev/null 2>&1";
    return std::system(command.c_str()) == 0;
  };
  if (!make("30")) GTEST_SKIP() << "the openssl program is not there";
  const std::string tls = R"(, "listen": {"tcp_port": 0, "http_port": 0, "certificate_file": "server.pem",
                              "private_key_file": "server.key"})";
  write("c.json",
        R"({"mesh": {"path": "cube.node"}, "loop": {"realtime_priority": 0, "lock_memory": false})" + tls +
            "}");
  write("r.json", R"({"relay": {"upstream": "a"})" + tls + "}");
  EXPECT_EQ(run({"--check", "c.json"}).out, "c.json: good\n");
  const Config config = load_config(dir_ / "c.json");
  constexpr std::int64_t kDay_s = 86'400;
  const std::int64_t now_s = unix_ns() / 1'000'000'000;
  const auto said = [&](std::int64_t days) {
    const std::vector<std::string> warnings = certificate_warnings(config, now_s + days * kDay_s);
    return warnings.empty() ? std::string() : warnings.front();
  };
  EXPECT_EQ(said(15), "");
  EXPECT_NE(said(17).find("listen.certificate_file"), std::string::npos) << said(17);
  EXPECT_NE(said(17).find("it expires on 20"), std::string::npos) << said(17);
  EXPECT_NE(said(31).find("it expired on 20"), std::string::npos) << said(31);
  EXPECT_NE(said(-1).find("it is not valid before 20"), std::string::npos) << said(-1);

  ASSERT_TRUE(make("2"));
  const std::string warning = "server.pem: it expires on 20";
  EXPECT_NE(run({"--check", "c.json"}).out.find("c.json: warning: listen.certificate_file: " + warning),
            std::string::npos);
  EXPECT_NE(tests::run_program("incise", {"doctor", "--config", "c.json"}, dir_).out.find(warning),
            std::string::npos);
  EXPECT_NE(tests::run_program("incise-relay", {"--check", "r.json"}, dir_)
                .out.find("r.json: warning: listen.certificate_file: " + warning),
            std::string::npos);
  const pid_t pid = start({"--config", (dir_ / "c.json").string()});
  ASSERT_GT(pid, 0);
  EXPECT_EQ(stop(pid, SIGTERM), 0);
  EXPECT_NE(tests::read_file(dir_ / "log.txt").find(warning), std::string::npos);
}

TEST_F(Incised, WithTokensTheFiguresAreForTheirHolders) {
  write("tokens.json", R"([{"token": "a scraper's own token", "roles": ["metrics"]}])");
  write("c.json", R"({"mesh": {"path": "cube.node"}, "loop": {"realtime_priority": 0, "lock_memory": false},
                      "listen": {"tcp_port": 0, "http_port": 0, "token_file": "tokens.json"}})");
  const pid_t pid = start({"--config", (dir_ / "c.json").string()});
  ASSERT_GT(pid, 0);
  const std::string log = tests::read_file(dir_ / "log.txt");
  const auto port = static_cast<std::uint16_t>(std::stoi(log.substr(log.find("http=127.0.0.1:") + 15)));
  const auto get = [&](const std::string& target, const std::string& token) {
    return stream::http(port, target, "GET", token.empty() ? "" : "Authorization: Bearer " + token + "\r\n");
  };
  EXPECT_EQ(get("/healthz", "").substr(9, 3), "200");
  EXPECT_EQ(get("/stats", "").substr(9, 3), "401");
  EXPECT_EQ(get("/metrics", "some other token").substr(9, 3), "401");
  EXPECT_NE(get("/metrics", "a scraper's own token").find("\nincise_stream_refused_total 2\n"),
            std::string::npos);
  const std::string stats = get("/stats", "a scraper's own token");
  const json access = json::parse(stats.substr(stats.find("\r\n\r\n")))["access"];
  EXPECT_EQ(access["refused"], 2);
  EXPECT_EQ(access["wrong_tokens"], 1);
  // The doctor needs no token.
  write("same.json", R"({"mesh": {"path": "cube.node"}, "listen": {"tcp_port": 0, "http_port": )" +
                         std::to_string(port) + "}}");
  const RunResult doctor = tests::run_program("incise", {"doctor", "--config", "same.json"}, dir_);
  EXPECT_NE(doctor.out.find("an incised runs here"), std::string::npos) << doctor.out;
  EXPECT_EQ(stop(pid, SIGTERM), 0);
  const std::string told = tests::read_file(dir_ / "log.txt");
  EXPECT_NE(told.find("/metrics refused to 127.0.0.1:"), std::string::npos) << told;
  EXPECT_NE(told.find("a wrong token"), std::string::npos);
}

TEST_F(Incised, EndsCleanlyOnItsSignalsAndClosesItsCapture) {
  write("c.json", config());
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) {
    const pid_t pid = start({"--config", (dir_ / "c.json").string()});
    ASSERT_GT(pid, 0);
    EXPECT_EQ(stop(pid, signal), 0);
    const std::string log = tests::read_file(dir_ / "log.txt");
    EXPECT_NE(log.find("listening tcp=127.0.0.1:"), std::string::npos) << log;
    EXPECT_NE(log.find("ended at revision 0"), std::string::npos) << log;
    const RunResult info = tests::run_program("incise", {"info", "session.capture", "--json"}, dir_);
    ASSERT_EQ(info.exit_code, 0) << info.err;
    EXPECT_TRUE(json::parse(info.out)["closed"]);
    EXPECT_FALSE(fs::exists(dir_ / "session.capture.lock"));
  }
}

// A single thread that does not block them, such as the log's, gets one that comes while the main thread does not wait for
// signals, and the process is killed.
TEST_F(Incised, AllItsThreadsLeaveTheEndSignalsToTheMainThread) {
  write("c.json", config());
  const pid_t pid = start({"--config", (dir_ / "c.json").string()});
  ASSERT_GT(pid, 0);
  constexpr std::uint64_t kEnds = 1u << (SIGTERM - 1) | 1u << (SIGINT - 1) | 1u << (SIGHUP - 1);
  int threads = 0;
  for (const auto& task : fs::directory_iterator("/proc/" + std::to_string(pid) + "/task")) {
    const std::string status = tests::read_file(task.path() / "status");
    const std::size_t blocked = status.find("SigBlk:");
    if (blocked == std::string::npos || task.path().filename() == std::to_string(pid)) continue;
    EXPECT_EQ(std::stoull(status.substr(blocked + 7), nullptr, 16) & kEnds, kEnds) << status.substr(0, 40);
    ++threads;
  }
  EXPECT_GE(threads, 3);
  EXPECT_EQ(stop(pid, SIGTERM), 0);
}

TEST_F(Incised, UnderNohupAHangUpDoesNotEndIt) {
  write("c.json", config());
  const auto before = std::signal(SIGHUP, SIG_IGN);  // a child inherits it
  const pid_t pid = start({"--config", (dir_ / "c.json").string()});
  std::signal(SIGHUP, before);
  ASSERT_GT(pid, 0);
  kill(pid, SIGHUP);
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));  // it looks for signals once a second
  EXPECT_EQ(stop(pid, SIGTERM), 0);
  EXPECT_NE(tests::read_file(dir_ / "log.txt").find("SIGTERM: ending"), std::string::npos);
}

TEST_F(Incised, TheDoctorKnowsARunningServerByItsAnswer) {
  write("c.json", config());
  const pid_t pid = start({"--config", (dir_ / "c.json").string()});
  ASSERT_GT(pid, 0);
  const std::string log = tests::read_file(dir_ / "log.txt");
  const auto port = [&](const std::string& name) {
    return std::stoi(log.substr(log.find(name + "=127.0.0.1:") + name.size() + 11));
  };
  write("same.json", R"({"mesh": {"path": "cube.node"}, "listen": {"tcp_port": )" +
                         std::to_string(port("tcp")) + R"(, "http_port": )" + std::to_string(port("http")) +
                         "}}");
  const RunResult running = tests::run_program("incise", {"doctor", "--config", "same.json", "--json"}, dir_);
  EXPECT_EQ(running.exit_code, 0) << running.out << running.err;
  int ports = 0;
  const json report = json::parse(running.out);
  for (const json& finding : report["findings"]) {
    const std::string what = finding["what"], found = finding["found"];
    if (what != "listen.tcp_port" && what != "listen.http_port") continue;
    ++ports;
    EXPECT_EQ(finding["verdict"], "good") << finding;
    EXPECT_NE(found.find("an incised runs here"), std::string::npos) << finding;
  }
  EXPECT_EQ(ports, 2);
  EXPECT_EQ(stop(pid, SIGTERM), 0);
}

TEST_F(Incised, ResumesAfterKill) {
  write("c.json", config());
  const std::string file = (dir_ / "c.json").string();
  pid_t pid = start({"--config", file});
  ASSERT_GT(pid, 0);
  EXPECT_NE(stop(pid, SIGKILL), 0);
  pid = start({"--config", file, "--resume"});
  ASSERT_GT(pid, 0);
  EXPECT_NE(tests::read_file(dir_ / "log.txt").find("resumed"), std::string::npos);
  EXPECT_EQ(stop(pid, SIGTERM), 0);
  // Other values of cut are refused: the session could not go on as it began.
  write("c.json", config(R"(, "cut": {"batch_h": 0.5})"));
  const RunResult refused = run({"--config", "c.json", "--resume"});
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_NE(refused.err.find("other values of cut"), std::string::npos) << refused.err;
  // The command that it names shows what the session began with.
  ASSERT_NE(refused.err.find("incise info session.capture --json"), std::string::npos) << refused.err;
  const RunResult info = tests::run_program("incise", {"info", "session.capture", "--json"}, dir_);
  EXPECT_EQ(json::parse(info.out)["config"]["cut"]["batch_h"], 0.25) << info.out;
}

// A disk that is full at the start leaves that. Whatever reads it says the same, whether the file has no byte, half a word or half a header.
TEST_F(Incised, ACaptureThatEndsInItsHeaderIsOneThingForAllThatReadIt) {
  write("c.json", config());
  pid_t pid = start({"--config", (dir_ / "c.json").string()});
  ASSERT_GT(pid, 0);
  EXPECT_EQ(stop(pid, SIGTERM), 0);
  const fs::path capture = dir_ / "session.capture";
  const std::string whole = tests::read_file(capture);
  const std::string expected =
      "session.capture: is a capture that ends within its header, as a full disk leaves it: there is nothing "
      "in "
      "it to read, replay or resume\n";
  for (const std::size_t bytes : {300, 14, 8, 5, 0}) {
    ASSERT_LT(bytes, whole.size());
    fs::resize_file(capture, bytes);
    for (const std::vector<std::string>& command : {std::vector<std::string>{"info", "session.capture"},
                                                    {"replay", "session.capture"},
                                                    {"export", "session.capture", "--out", "o.vtu"},
                                                    {"convert", "session.capture", "--out", "o.capture"},
                                                    {"stream", "session.capture", "--to", "127.0.0.1:1"}}) {
      const RunResult result = tests::run_program("incise", command, dir_);
      EXPECT_EQ(result.exit_code, 1) << command[0];
      EXPECT_EQ(result.err, "incise: " + expected) << command[0] << " of " << bytes << " bytes";
    }
    const RunResult resumed = run({"--config", "c.json", "--resume"});
    EXPECT_EQ(resumed.exit_code, 1);
    EXPECT_NE(resumed.err.find(expected), std::string::npos) << resumed.err;
  }
}

// A start moves the file away and writes another in its place, and the next start replaces what was moved: two of them would
// destroy a file that was named by mistake.
TEST_F(Incised, AFileThatIsNoCaptureIsNotRecordedOver) {
  mesh_io::write_mesh(dir_ / "body.vtu", tests::cube(4));
  write("notes.txt", "my notes\n");
  fs::create_symlink("notes.txt", dir_ / "link");
  write("x.capture.old", "other notes\n");
  write("good.capture.old", "INCISCAP and more");
  write("empty.capture", "");
  write("torn.capture", "INCIS");
  const auto with = [](const std::string& mesh, const std::string& capture) {
    return R"({"mesh": {"path": ")" + mesh + R"("}, "listen": {"tcp_port": 0, "http_port": 0},
               "loop": {"realtime_priority": 0, "lock_memory": false}, "capture": {"path": ")" +
           capture + R"("}})";
  };
  const std::vector<std::array<std::string, 3>> refused{
      {"body.vtu", "notes.txt", "notes.txt is not a capture"},
      {"body.vtu", "link", "link is not a capture"},
      {"body.vtu", "body.vtu", "body.vtu is a file of mesh.path"},
      {"cube.node", "cube.ele", "cube.ele is a file of mesh.path"},
      {"cube", "cube.node", "cube.node is a file of mesh.path"},
      {"body.vtu", "c.json", "c.json is the configuration itself"},
      {"body.vtu", "x.capture", "x.capture.old is not a capture"}};
  for (const auto& [mesh, capture, why] : refused) {
    write("c.json", with(mesh, capture));
    const std::string before = capture == "x.capture" ? "" : tests::read_file(dir_ / capture);
    for (const std::vector<std::string>& arguments : {std::vector<std::string>{"--check", "c.json"},
                                                      {"--config", "c.json"},
                                                      {"--config", "c.json", "--resume"}}) {
      const RunResult result = run(arguments);
      EXPECT_EQ(result.exit_code, 1) << capture;
      EXPECT_EQ(result.err.rfind("incised: c.json: capture.path: ", 0), 0u) << result.err;
      EXPECT_NE(result.err.find(why), std::string::npos) << result.err;
      EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
      EXPECT_EQ(capture == "x.capture" ? "" : tests::read_file(dir_ / capture), before);
    }
  }
  EXPECT_EQ(tests::read_file(dir_ / "x.capture.old"), "other notes\n");
  EXPECT_FALSE(fs::exists(dir_ / "x.capture"));
  for (const char* capture : {"empty.capture", "torn.capture", "good.capture"}) {
    write("c.json", with("body.vtu", capture));
    EXPECT_EQ(run({"--check", "c.json"}).exit_code, 0) << capture;
    const pid_t pid = start({"--config", (dir_ / "c.json").string()});
    ASSERT_GT(pid, 0) << capture;
    EXPECT_EQ(stop(pid, SIGTERM), 0) << capture;
  }
}

// A second server would move the first one's capture away, or with --resume write into it.
TEST_F(Incised, ACaptureHasOneServer) {
  write("c.json", config());
  const std::string file = (dir_ / "c.json").string();
  pid_t pid = start({"--config", file});
  ASSERT_GT(pid, 0);
  const std::string refusal = "incised: capture.path: " + (dir_ / "session.capture").string() +
                              " is being written by another incised (process ";
  const auto expect_refused = [&] {
    const std::string before = tests::read_file(dir_ / "session.capture");
    for (const bool resume : {false, true}) {
      std::vector<std::string> arguments{"--config", file};
      if (resume) arguments.emplace_back("--resume");
      const RunResult refused = run(arguments);
      EXPECT_EQ(refused.exit_code, 1);
      EXPECT_NE(refused.err.find(refusal + std::to_string(pid) + "); give each its own\n"), std::string::npos)
          << refused.err;
      EXPECT_EQ(tests::read_file(dir_ / "session.capture"), before);
      EXPECT_FALSE(fs::exists(dir_ / "session.capture.old"));
    }
    EXPECT_EQ(run({"--check", file}).exit_code, 0) << "checking writes nothing";
  };
  expect_refused();
  stop(pid, SIGKILL);  // the kernel frees what it held
  EXPECT_TRUE(fs::exists(dir_ / "session.capture.lock"));
  pid = start({"--config", file, "--resume"});
  ASSERT_GT(pid, 0);
  expect_refused();
  EXPECT_EQ(stop(pid, SIGTERM), 0);
  EXPECT_FALSE(fs::exists(dir_ / "session.capture.lock"));
}

TEST_F(Incised, APortInUseIsAnErrorThatNamesIt) {
  write("c.json", config());
  const pid_t pid = start({"--config", (dir_ / "c.json").string()});
  ASSERT_GT(pid, 0);
  const std::string log = tests::read_file(dir_ / "log.txt");
  const auto at = log.find("listening tcp=127.0.0.1:") + 24;
  const std::string port = log.substr(at, log.find(' ', at) - at);
  write("d.json", R"({"mesh": {"path": "cube.node"}, "listen": {"http_port": 0, "tcp_port": )" + port + "}}");
  const RunResult result = run({"--config", "d.json"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find(port), std::string::npos) << result.err;
  EXPECT_EQ(stop(pid, SIGTERM), 0);
}

// A recording is somebody's work: what keeps a server from starting is found before that is moved away, or gone on with.
TEST_F(Incised, AStartThatFailsLeavesTheCaptureAsItIs) {
  std::string motion = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n";
  for (const core::Pose& pose : tests::sweep_through(50, 1000, 0.37)) {
    motion += std::to_string(static_cast<double>(pose.t_ns) * 1e-9) + ',' + std::to_string(pose.position.x) +
              ',' + std::to_string(pose.position.y) + ',' + std::to_string(pose.position.z) + ",1,0,0,0,1\n";
  }
  write("motion.csv", motion);
  write("c.json", config());
  const RunResult made = tests::run_program(
      "incise", {"convert", "motion.csv", "--mesh", "cube", "--config", "c.json", "--out", "session.capture"},
      dir_);
  ASSERT_EQ(made.exit_code, 0) << made.err;
  const std::string capture = tests::read_file(dir_ / "session.capture");
  write("session.capture.old", "the one before");
  write("no.pem", "no certificate");
  write("no.node", "no mesh");
  const stream::Listener taken;
  const std::string port = std::to_string(taken.port());
  const auto with = [&](const std::string& listen, const std::string& more = "",
                        const char* mesh = "cube.node") {
    return R"({"mesh": {"path": ")" + std::string(mesh) + R"("}, "listen": {)" + listen +
           R"(}, "capture": {"path": "session.capture"})" + more + "}";
  };
  const std::string free = R"("tcp_port": 0, "http_port": 0)";
  const std::string configs[] = {
      with(R"("http_port": 0, "tcp_port": )" + port),
      with(R"("tcp_port": 0, "http_port": )" + port),
      with(free + R"(, "token_file": "none.json")"),
      with(free + R"(, "certificate_file": "no.pem", "private_key_file": "no.pem")"),
      with(free, "", "no.node"),
#ifdef INCISE_OPENIGTLINK
      with(free, R"(, "openigtlink": {"port": )" + port + "}"),
#endif
  };
  for (const std::string& one : configs) {
    write("d.json", one);
    for (const bool resume : {false, true}) {
      std::vector<std::string> arguments{"--config", "d.json"};
      if (resume) arguments.emplace_back("--resume");
      const RunResult failed = run(arguments);
      EXPECT_EQ(failed.exit_code, 1) << one << failed.err;
      EXPECT_EQ(tests::read_file(dir_ / "session.capture"), capture) << one << failed.err;
      EXPECT_EQ(tests::read_file(dir_ / "session.capture.old"), "the one before") << one << failed.err;
    }
  }
}

}  // namespace
}  // namespace incise::app
