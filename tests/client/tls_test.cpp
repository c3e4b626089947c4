#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>

#include "client/client.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::client {
namespace {

namespace fs = std::filesystem;
using stream::TestServer;

// Certificates of our own, made by the openssl program.
class TlsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(directory);
    for (const char* name : {"server", "other"}) {
      const std::string base = (directory / name).string();
      const std::string command =
          "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=" +
          std::string(name) + " -addext subjectAltName=IP:127.0.0.1 -keyout " + base + ".key -out " + base +
          ".pem >/dev/null 2>&1";
      if (std::system(command.c_str()) != 0) GTEST_SKIP() << "the openssl program is not there";
    }
  }
  ~TlsTest() override { fs::remove_all(directory); }
  std::string file(const std::string& name) const { return (directory / name).string(); }
  Options options(TransportKind kind, const std::string& ca = "server.pem") const {
    Options o;
    o.tls = true;
    o.transport = kind;
    o.ca_file = file(ca);
    o.connect_timeout_s = 5;
    return o;
  }

  fs::path directory = fs::temp_directory_path() / ("incise_tls_" + std::to_string(::getpid()));
};

TEST_F(TlsTest, BothTransportsHoldTheMesh) {
  stream::StreamConfig config = stream::test_config();
  config.certificate_file = file("server.pem");
  config.private_key_file = file("server.key");
  config.tokens = {{"secret", {protocol::Role::Viewer}}};
  TestServer test(4, config);
  Options tcp_options = options(TransportKind::kTcp), web_options = options(TransportKind::kWebSocket);
  tcp_options.token = web_options.token = "secret";
  const auto tcp = Client::connect("127.0.0.1", test.server.tcp_port(), tcp_options);
  const auto web = Client::connect("127.0.0.1", test.server.http_port(), web_options);
  test.cut(2);
  for (Client* client : {tcp.get(), web.get()}) {
    ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), 20)) << client->last_error();
    EXPECT_EQ(client->read([](const protocol::Replica& m) { return m.compute_state_hash(); }),
              test.loop.state_hash());
  }
}

TEST_F(TlsTest, NobodyTalksToAStranger) {
  stream::StreamConfig config = stream::test_config();
  config.certificate_file = file("server.pem");
  config.private_key_file = file("server.key");
  TestServer test(2, config);
  EXPECT_THROW(
      Client::connect("127.0.0.1", test.server.tcp_port(), options(TransportKind::kTcp, "other.pem")),
      ConnectError);
  EXPECT_THROW(
      Client::connect("127.0.0.1", test.server.http_port(), options(TransportKind::kWebSocket, "other.pem")),
      ConnectError);
  Options plain;
  plain.connect_timeout_s = 2;
  EXPECT_THROW(Client::connect("127.0.0.1", test.server.tcp_port(), plain), ConnectError);
  const auto good = Client::connect("127.0.0.1", test.server.tcp_port(), options(TransportKind::kTcp));
  EXPECT_TRUE(good->wait_for_revision(0, 20));
}

TEST_F(TlsTest, ACertificateForOtherNamesSaysForWhich) {
  stream::StreamConfig config = stream::test_config();
  config.certificate_file = file("server.pem");
  config.private_key_file = file("server.key");
  TestServer test(2, config);
  for (const TransportKind kind : {TransportKind::kTcp, TransportKind::kWebSocket}) {
    std::string problem;
    try {
      Client::connect("localhost",
                      kind == TransportKind::kTcp ? test.server.tcp_port() : test.server.http_port(),
                      options(kind));
    } catch (const ConnectError& error) {
      problem = error.what();
    }
    EXPECT_NE(problem.find("the server's certificate is not for localhost; it is for 127.0.0.1"),
              std::string::npos)
        << problem;
    EXPECT_EQ(problem.find("--ca"), std::string::npos) << problem;
  }
}

TEST_F(TlsTest, FilesThatAreNoneAreNamed) {
  stream::MiniLoop loop(stream::box_mesh(2));
  stream::StreamConfig config = stream::test_config();
  const auto problem = [&] {
    try {
      stream::Server server(config, loop.facts(), loop.initial(), loop);
      return std::string();
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
  };
  config.certificate_file = file("none.pem");
  config.private_key_file = file("server.key");
  EXPECT_NE(problem().find("none.pem"), std::string::npos);
  config.certificate_file = file("server.pem");
  config.private_key_file = "";
  EXPECT_NE(problem().find("private"), std::string::npos) << problem();
}

}  // namespace
}  // namespace incise::client
