// incise-relay as a program: its command line, several sessions, TLS on both sides, another body at the origin.

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>

#include "server/app/config.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/write_vtk.hpp"
#include "tests/e2e/recovery.hpp"
#include "tests/e2e/served_session.hpp"
#include "tests/relay/relay_process.hpp"
#include "tests/support/run_program.hpp"

namespace incise::relay {
namespace {

namespace fs = std::filesystem;
using e2e::ServedSession;
using e2e::wait_for;

class RelayProgram : public ::testing::Test {
 protected:
  RelayProgram() { fs::create_directories(directory_); }
  ~RelayProgram() override { fs::remove_all(directory_); }
  tests::RunResult run(const std::vector<std::string>& arguments) const {
    return tests::run_program("incise-relay", arguments, directory_);
  }
  std::string file(const std::string& name) const { return (directory_ / name).string(); }
  // What --check says of a configuration.
  std::string fault(const std::string& config) const {
    std::ofstream(file("relay.json")) << config;
    const tests::RunResult result = run({"--check", file("relay.json")});
    EXPECT_EQ(result.err.empty(), result.exit_code == 0);
    const auto name = result.err.find("relay.json: ");
    return name == std::string::npos ? result.err : result.err.substr(name + 12);
  }
  fs::path directory_ = fs::temp_directory_path() / ("incise_relay_program_" + std::to_string(::getpid()));
};

TEST_F(RelayProgram, SaysWhatItTakes) {
  const tests::RunResult help = run({});
  EXPECT_EQ(help.exit_code, 0);
  for (const char* option : {"--config", "--to", "--port", "--http-port", "--token-file", "--ca"})
    EXPECT_NE(help.out.find(option), std::string::npos) << option;
  EXPECT_EQ(run({"--frob"}).exit_code, 2);
  EXPECT_EQ(run({"--to", "here:and:there"}).exit_code, 2);
  EXPECT_EQ(
      tests::end_of(tests::start_program("incise-relay", {"--help"}, directory_, "/dev/full")).exit_code, 1);
  const tests::RunResult printed = run({"--print-config"});
  ASSERT_EQ(printed.exit_code, 0);
  EXPECT_NE(printed.out.find("\"upstream\": \"\""), std::string::npos);
  EXPECT_EQ(printed.out.find("\"mesh\""), std::string::npos) << "it has no body of its own";
  const app::Config config = app::parse_config(printed.out, "printed", app::Program::kRelay);
  EXPECT_EQ(app::commented(config, app::Program::kRelay), printed.out) << "it reads what it prints";
}

TEST_F(RelayProgram, RefusesAConfigurationThatCannotServe) {
  EXPECT_EQ(fault(R"({"relay": {"upstream": "host"}})"), "");
  EXPECT_EQ(fault(R"({"relay": {"sessions": [{"name": "a", "upstream": "tls://host:1"}]}})"), "");
  EXPECT_EQ(fault("{}"),
            "relay.upstream: found \"\"; accepted is the server to follow, HOST:PORT, or relay.sessions\n");
  EXPECT_EQ(fault(R"({"relay": {"upstream": "a", "sessions": [{"name": "a", "upstream": "b"}]}})"),
            "relay.upstream: found \"a\"; accepted is \"\" if relay.sessions is given\n");
  EXPECT_TRUE(fault(R"({"mesh": {"phantom": "liver"}, "relay": {"upstream": "a"}})")
                  .starts_with("unknown key \"mesh\"; accepted are"));
  for (const char* sessions :
       {R"([{"upstream": "b"}])", R"([{"name": "a"}])", R"([{"name": "a b", "upstream": "c"}])",
        R"([{"name": "a", "upstream": "b"}, {"name": "a", "upstream": "c"}])",
        R"({"name": "a", "upstream": "b"})", R"([{"name": "a", "upstream": "b", "tcp_port": 70000}])",
        R"([{"name": "a", "upstream": "b", "port": 1}])"}) {
    EXPECT_TRUE(fault(R"({"relay": {"sessions": )" + std::string(sessions) + "}}")
                    .starts_with("relay.sessions: found"))
        << sessions;
  }
  EXPECT_TRUE(fault(R"({"relay": {"sessions": [{"name": "a", "upstream": "b", "tcp_port": 7},
                                               {"name": "b", "upstream": "b", "tcp_port": 7}]}})")
                  .starts_with("relay.sessions: found port 7 twice"));
  EXPECT_TRUE(
      fault(R"({"relay": {"upstream": "a", "token_file": "none"}})").starts_with("relay.token_file: found"));
  EXPECT_TRUE(fault(R"({"relay": {"upstream": "a"}, "listen": {"address": "0.0.0.0"}})")
                  .starts_with("listen.address: found \"0.0.0.0\""));
}

// What a session's line on stdout says.
struct Place {
  std::uint16_t tcp = 0, http = 0;
};

TEST_F(RelayProgram, ServesSeveralSessionsAndWaitsForThoseThatAreNotThere) {
  ServedSession first("relay_first", 3000, ""), second("relay_second", 4000, "");
  ASSERT_TRUE(first.start(false) && second.start(false));
  second.kill();
  const auto session = [](const char* name, const ServedSession& served) {
    return R"({"name": ")" + std::string(name) + R"(", "upstream": "127.0.0.1:)" +
           std::to_string(served.tcp_port()) + R"("})";
  };
  std::ofstream(file("relay.json")) << R"({"relay": {"sessions": [)" << session("one", first) << ", "
                                    << session("two", second) << R"(]}, "log": {"level": "off"}})";
  e2e::Process relay({"incise-relay", "--config", file("relay.json")});
  const auto next = [&](const std::string& name) {
    const std::string line = relay.line("listening ");
    EXPECT_TRUE(line.ends_with(" session=" + name)) << line;
    return Place{e2e::port_after(line, "tcp="), e2e::port_after(line, "http=")};
  };
  const Place one = next("one");
  {
    Witness viewer(one.tcp);
    EXPECT_TRUE(viewer.client().wait_for_revision(0, 20));
  }
  ASSERT_TRUE(second.start(true));
  const Place two = next("two");
  Witness a(one.tcp), b(two.tcp);
  e2e::PoseDriver cutting(first, 1000, 0.4, "blade", one.tcp), also(second, 1000, 0.4, "blade", two.tcp);
  EXPECT_TRUE(wait_for([&] { return a.client().revision() > 20 && b.client().revision() > 20; }));
  ASSERT_TRUE(cutting.settle() && also.settle());
  EXPECT_TRUE(wait_for([&] { return e2e::held(a.client()) == e2e::what_the_server_has(first); }));
  EXPECT_TRUE(wait_for([&] { return e2e::held(b.client()) == e2e::what_the_server_has(second); }));
  EXPECT_NE(a.client().welcome().session, b.client().welcome().session);
  // One of them goes, and the other does not notice.
  first.kill();
  EXPECT_TRUE(wait_for([&] { return e2e::stat(one.http, "/relay/connected") == 0.0; }));
  EXPECT_EQ(e2e::stat(two.http, "/relay/connected"), 1.0);
  relay.signal(SIGHUP);
  EXPECT_EQ(relay.wait(), 0) << "it ends cleanly";
}

TEST_F(RelayProgram, SpeaksTlsOnBothSides) {
  for (const char* name : {"server", "other"}) {
    const std::string base = file(name);
    const std::string command =
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=" +
        std::string(name) + " -addext subjectAltName=IP:127.0.0.1 -keyout " + base + ".key -out " + base +
        ".pem >/dev/null 2>&1";
    if (std::system(command.c_str()) != 0) GTEST_SKIP() << "the openssl program is not there";
  }
  ServedSession session("relay_tls", 3000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  const std::string secured = R"(, "certificate_file": ")" + file("server.pem") +
                              R"(", "private_key_file": ")" + file("server.key") + '"';
  RelayProcess near("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port(), secured);
  ASSERT_TRUE(near.start()) << near.log();
  for (const bool web : {false, true}) {
    const std::string place =
        web ? "wss://127.0.0.1:" + std::to_string(near.http_port()) : "tls://" + near.place();
    RelayProcess far(place, near.http_port(), "", R"(, "ca_file": ")" + file("server.pem") + '"');
    ASSERT_TRUE(far.start()) << far.log();
    Witness viewer(far.tcp_port());
    e2e::PoseDriver driver(session, 1000, 0.4, "blade", far.tcp_port());
    const std::uint64_t before = viewer.client().revision();
    EXPECT_TRUE(wait_for([&] { return viewer.client().revision() > before + 20; }));
    ASSERT_TRUE(driver.settle());
    EXPECT_EQ(driver.accepted(), driver.sent());
    EXPECT_TRUE(wait_for([&] { return e2e::held(viewer.client()) == e2e::what_the_server_has(session); }));
  }
  // A server that another authority vouches for is none to follow.
  std::ofstream(file("relay.json")) << R"({"relay": {"upstream": "tls://)" << near.place()
                                    << R"(", "ca_file": ")" << file("other.pem")
                                    << R"("}, "listen": {"tcp_port": 0, "http_port": 0}})";
  const std::string log = file("log.txt");
  e2e::Process wrong(
      {"/bin/sh", "-c",
       "exec " + std::string(INCISE_BIN_DIR) + "/incise-relay --config " + file("relay.json") + " 2>" + log});
  EXPECT_TRUE(wait_for([&] { return tests::read_file(log).find("is not trusted") != std::string::npos; }));
  EXPECT_TRUE(wrong.running()) << "it goes on trying";
  wrong.signal(SIGTERM);
  EXPECT_EQ(wrong.wait(), 0);
}

TEST_F(RelayProgram, AnotherBodyAtTheOriginIsAnotherBodyHere) {
  ServedSession session("relay_body", 3000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess relay("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  Witness viewer(relay.tcp_port());
  ASSERT_TRUE(viewer.client().wait_for_revision(0, 20));
  const std::string before = viewer.client().welcome().mesh.content_hash;
  for (int i = 0; i < 2; ++i) {
    const app::Config config = app::parse_config(
        R"({"mesh": {"phantom": "slab", "target_tets": )" + std::to_string(2000 + 1500 * i) + "}}", "body");
    mesh_io::write_mesh(session.file("body" + std::to_string(i) + ".vtu"), app::load_body(config).loaded.mesh,
                        std::vector<core::Field>{});
    session.use_body("body" + std::to_string(i) + ".vtu");
    session.kill();
    ASSERT_TRUE(session.start(false)) << session.log();
    EXPECT_TRUE(wait_for([&] {
      return viewer.client().status() == client::Status::kConnected &&
             viewer.client().welcome().mesh.name == "body" + std::to_string(i) + ".vtu";
    })) << relay.log();
    EXPECT_TRUE(wait_for([&] { return e2e::held(viewer.client()) == e2e::what_the_server_has(session); }));
    EXPECT_EQ(viewer.client().welcome().fields.size(), 2u) << "what the configuration declares";
  }
  EXPECT_NE(viewer.client().welcome().mesh.content_hash, before);
  EXPECT_EQ(viewer.went_back() + viewer.resyncs(), 0);
  EXPECT_EQ(relay.health(), 200);
}

}  // namespace
}  // namespace incise::relay
