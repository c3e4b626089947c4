// Peers built on the OpenIGTLink library, and some that keep to nothing, with PoseSources behind the server.

#include "server/input/openigtlink/openigtlink_input.hpp"

#include <gtest/gtest.h>
#include <igtlServerSocket.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <thread>

#include "server/input/openigtlink/message.hpp"
#include "tests/input/openigtlink/library_peer.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::input {
namespace {

using namespace std::chrono_literals;
using tests::LibraryPeer;
using tests::Packed;
using Kind = InputEvent::Kind;

constexpr std::int64_t kStart_ns = 1'700'000'000'000'000'000, kStep_ns = 10'000'000;
constexpr double kLibrary_ns = 20;  // how well the library turns nanoseconds into its fractions

class OpenIgtLink : public ::testing::Test {
 protected:
  void SetUp() override { spdlog::set_level(spdlog::level::off); }
  void start(OpenIgtLinkOptions options = {}) {
    if (options.connect.empty()) options.port = 0;
    if (options.silence_s == 0.5) options.silence_s = 3600;  // only those who ask for it are timed
    input = std::make_unique<OpenIgtLinkInput>(pose_sources, options,
                                               SurfaceFeed{[this] { return state.load(); },
                                                           [this](auto ready) {
                                                             ++requests;
                                                             test.server.request_surface(std::move(ready));
                                                           }});
    input->start();
  }
  std::uint64_t count(const std::string& what) const {
    for (const auto& [name, value] : input->status().counts) {
      if (name == what) return value;
    }
    return ~std::uint64_t{0};
  }
  // Events of all sources so far; drains them.
  const std::vector<InputEvent>& drain() {
    pose_sources.drain([&](std::uint32_t source, const InputEvent& event) {
      events.push_back(event);
      sources.push_back(source);
      return true;
    });
    return events;
  }
  bool came(std::size_t count) {
    return stream::eventually([&] { return drain().size() >= count; });
  }

  PoseSources pose_sources{core::Blade{}};
  stream::TestServer test{2};
  std::atomic<std::uint64_t> state{1};
  std::atomic<int> requests{0};
  std::unique_ptr<OpenIgtLinkInput> input;
  std::vector<InputEvent> events;
  std::vector<std::uint32_t> sources;
};

TEST_F(OpenIgtLink, PosesComeInMetresWithThePeersTimeAndEngaged) {
  OpenIgtLinkOptions options;
  options.world = {{0, 0, 1}, {0, 0, 0, 1}, 0.001};
  options.engage_buttons = 4;
  start(options);
  LibraryPeer peer(input->port());
  ASSERT_TRUE(peer.connected());
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(peer.send(
        tests::transform({"Scalpel", 10, 20, 30 + static_cast<float>(i)}, kStart_ns + i * kStep_ns)));
  }
  ASSERT_TRUE(came(4));
  EXPECT_EQ(events[0].kind, Kind::kOpened);
  EXPECT_EQ(pose_sources.name_of(sources[0]), "Scalpel");
  for (std::size_t i = 0; i < 3; ++i) {
    const core::Pose& pose = events[i + 1].pose.pose;
    EXPECT_NEAR(core::length(pose.position - core::Vec3{-0.01, -0.02, 1.03 + 0.001 * static_cast<double>(i)}),
                0, 1e-9);
    EXPECT_NEAR(static_cast<double>(pose.t_ns - kStart_ns), static_cast<double>(i) * kStep_ns, kLibrary_ns);
    EXPECT_NEAR(pose.orientation.z, 1, 1e-9);
    EXPECT_EQ(pose.buttons, 4u);
  }
  const NetworkStatus status = input->status();
  ASSERT_TRUE(stream::eventually([&] { return input->status().peers.size() == 1 && count("poses") == 3; }));
  EXPECT_EQ(input->status().peers[0].sources, std::vector<std::string>{"Scalpel"});
  peer.close();
  ASSERT_TRUE(stream::eventually([&] { return drain().back().kind == Kind::kEndStroke; }));
  EXPECT_TRUE(stream::eventually([&] { return input->status().peers.empty(); }));
}

TEST_F(OpenIgtLink, EachToolOfAMessageIsABladeAndTwoPeersShareThem) {
  start();
  LibraryPeer one(input->port()), other(input->port());
  ASSERT_TRUE(one.send(tests::tdata({{"Left"}, {"Right"}}, kStart_ns)));
  ASSERT_TRUE(came(4));
  ASSERT_TRUE(other.send(tests::qtdata({{"Right"}, {"Third"}}, kStart_ns)));  // the first holds "Right"
  ASSERT_TRUE(came(6));
  EXPECT_EQ(pose_sources.open_count(), 3u);
  EXPECT_TRUE(pose_sources.is_open("Third"));
  EXPECT_TRUE(stream::eventually([&] { return count("no_blade") == 1; }));
}

TEST_F(OpenIgtLink, SilenceABadStatusAndTheNextPose) {
  OpenIgtLinkOptions options;
  options.silence_s = 0.3;
  start(options);
  LibraryPeer peer(input->port());
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns)));
  ASSERT_TRUE(came(3));  // opened, a pose, and the end, with nothing more being said
  EXPECT_EQ(events[2].kind, Kind::kEndStroke);
  EXPECT_FALSE(pose_sources.is_open("Scalpel"));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns + kStep_ns)));
  ASSERT_TRUE(peer.send(tests::status("Scalpel", 16)));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns + 2 * kStep_ns)));
  ASSERT_TRUE(came(8));
  const std::vector<Kind> kinds{events[3].kind, events[4].kind, events[5].kind, events[6].kind,
                                events[7].kind};
  EXPECT_EQ(kinds,
            (std::vector<Kind>{Kind::kOpened, Kind::kPose, Kind::kEndStroke, Kind::kOpened, Kind::kPose}));
}

TEST_F(OpenIgtLink, AStringEngages) {
  OpenIgtLinkOptions options;
  options.engage = "string";
  start(options);
  LibraryPeer peer(input->port());
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns)));
  ASSERT_TRUE(peer.send(tests::string_message("Scalpel_engage", "1")));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns + kStep_ns)));
  ASSERT_TRUE(peer.send(tests::string_message("Scalpel", "off", 2)));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns + 2 * kStep_ns)));
  ASSERT_TRUE(came(5));
  EXPECT_EQ(events[1].pose.pose.buttons, 0u);
  EXPECT_EQ(events[2].pose.pose.buttons, 1u);
  EXPECT_EQ(events[3].kind, Kind::kEndStroke);
  EXPECT_EQ(events[4].pose.pose.buttons, 0u);
}

TEST_F(OpenIgtLink, AClockThatIsSetBackAndOneThatIsNotThere) {
  start();
  LibraryPeer peer(input->port());
  const std::int64_t times[] = {kStart_ns, kStart_ns + kStep_ns, kStart_ns - 3600'000'000'000,
                                kStart_ns - 3600'000'000'000 + kStep_ns};
  for (const std::int64_t t : times) ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, t)));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, 0)));
  ASSERT_TRUE(came(6));
  for (std::size_t i = 2; i < 6; ++i) EXPECT_GT(events[i].pose.pose.t_ns, events[i - 1].pose.pose.t_ns) << i;
  EXPECT_NEAR(static_cast<double>(events[4].pose.pose.t_ns - events[3].pose.pose.t_ns), kStep_ns,
              kLibrary_ns);
  EXPECT_TRUE(stream::eventually([&] { return count("clock_restarts") == 1; }));
}

TEST_F(OpenIgtLink, WhatIsWrongIsCountedAndLosesNothingElse) {
  OpenIgtLinkOptions options;
  options.devices = {"Scalpel"};
  start(options);
  LibraryPeer peer(input->port());
  Packed torn = tests::transform({"Scalpel"}, kStart_ns);
  torn.back() ^= 1;
  ASSERT_TRUE(peer.send(torn));
  ASSERT_TRUE(peer.send(openigtlink::encode("TDATA", "Scalpel", 0, Packed(69))));
  ASSERT_TRUE(peer.send(openigtlink::encode("TRANSFORM", "Scalpel", 0, Packed(48))));
  ASSERT_TRUE(peer.send(openigtlink::encode("IMAGE", "Camera", 0, Packed(300'000, 7))));
  ASSERT_TRUE(peer.send(tests::transform({"Foreign"}, kStart_ns)));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns)));
  ASSERT_TRUE(came(2));
  EXPECT_TRUE(stream::eventually([&] { return count("poses") == 1; }));
  for (const char* what : {"bad_crc", "bad_shape", "bad_values", "skipped", "refused"})
    EXPECT_EQ(count(what), 1u) << what;
  EXPECT_EQ(count("messages"), 6u);
}

TEST_F(OpenIgtLink, EveryStatusButOkReleasesTheBlade) {
  start();
  LibraryPeer peer(input->port());
  std::size_t events_so_far = 0;
  std::int64_t t_ns = kStart_ns;
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, t_ns)));
  for (const int code : {0, 2, 3}) {
    ASSERT_TRUE(peer.send(tests::status("Scalpel", code)));
    ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, t_ns += kStep_ns)));
    ASSERT_TRUE(came(events_so_far + 5)) << code;  // opened, a pose, the end, opened, a pose
    EXPECT_EQ(events[events_so_far + 2].kind, Kind::kEndStroke) << code;
    events_so_far += 3;
  }
  ASSERT_TRUE(peer.send(tests::status("Scalpel", 1)));
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, t_ns + kStep_ns)));
  ASSERT_TRUE(came(events_so_far + 3));
  EXPECT_EQ(events.back().kind, Kind::kPose);
  EXPECT_EQ(events.size(), events_so_far + 3);
}

// A clock that goes back by less than a second was not set: those poses are late.
TEST_F(OpenIgtLink, PosesOutOfOrderAreNoRestartOfTheClock) {
  start();
  LibraryPeer peer(input->port());
  for (const std::int64_t t : {kStart_ns, kStart_ns - 500'000'000, kStart_ns + kStep_ns})
    ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, t)));
  ASSERT_TRUE(came(4));
  EXPECT_LT(events[2].pose.pose.t_ns, events[1].pose.pose.t_ns);
  EXPECT_GT(events[3].pose.pose.t_ns, events[1].pose.pose.t_ns);
  EXPECT_EQ(count("clock_restarts"), 0u);
}

TEST_F(OpenIgtLink, AConnectionHasThirtyTwoToolsAtMost) {
  start();
  LibraryPeer peer(input->port());
  std::vector<tests::PlacedTool> tools;
  for (int i = 0; i < 35; ++i) tools.push_back({"Tool" + std::to_string(i)});
  ASSERT_TRUE(peer.send(tests::tdata(tools, kStart_ns)));
  EXPECT_TRUE(stream::eventually([&] { return count("refused") == 3; }));
  EXPECT_EQ(count("poses"), std::uint64_t{core::kMaxSources});
}

TEST_F(OpenIgtLink, AMessageOfMoreThanAGigabyteEndsItsConnection) {
  start();
  stream::RawPeer peer(input->port());
  Packed header = openigtlink::encode("IMAGE", "Camera", 0, {});
  const std::uint64_t bytes = (std::uint64_t{1} << 30) + 1;
  for (std::size_t i = 0; i < 8; ++i) header[42 + i] = static_cast<std::uint8_t>(bytes >> (56 - 8 * i));
  ASSERT_TRUE(peer.send(std::as_bytes(std::span(header))));
  EXPECT_TRUE(peer.closes());
  EXPECT_TRUE(stream::eventually([&] { return input->status().peers.empty(); }));
  EXPECT_EQ(count("unfinished"), 0u) << "at once, not after the time that a message may take";
}

TEST_F(OpenIgtLink, APeerOutOfStepIsLetGoAndOthersGoOn) {
  start();
  LibraryPeer good(input->port());
  ASSERT_TRUE(good.send(tests::transform({"Scalpel"}, kStart_ns)));
  ASSERT_TRUE(came(2));
  stream::RawPeer browser(input->port());
  browser.send("GET / HTTP/1.1\r\nHost: somewhere\r\nUser-Agent: a browser, with some more\r\n\r\n");
  EXPECT_TRUE(browser.closes());
  stream::RawPeer liar(input->port());
  Packed huge = openigtlink::encode("TDATA", "Scalpel", 0, {});
  huge[42] = 0x7f;  // a body of 2^62 bytes
  liar.send(std::string_view(reinterpret_cast<const char*>(huge.data()), huge.size()));
  EXPECT_TRUE(liar.closes());
  stream::RawPeer babbler(input->port());
  for (int i = 0; i < 40; ++i) {
    Packed bad = openigtlink::encode("TRANSFORM", "Scalpel", 0, Packed(48));
    babbler.send(std::string_view(reinterpret_cast<const char*>(bad.data()), bad.size()));
  }
  EXPECT_TRUE(babbler.closes());
  EXPECT_TRUE(stream::eventually([&] { return count("bad_headers") == 1; }));
  ASSERT_TRUE(good.send(tests::transform({"Scalpel"}, kStart_ns + kStep_ns)));
  EXPECT_TRUE(came(3));
}

TEST_F(OpenIgtLink, ManyPeersFindAClosedDoor) {
  start();
  std::vector<std::unique_ptr<stream::RawPeer>> crowd;
  for (int i = 0; i < 16; ++i) crowd.push_back(std::make_unique<stream::RawPeer>(input->port()));
  ASSERT_TRUE(stream::eventually([&] { return count("connections") == 16; }));
  stream::RawPeer late(input->port());
  EXPECT_TRUE(late.closes());
  crowd.pop_back();
  ASSERT_TRUE(stream::eventually([&] { return input->status().peers.size() == 15; }));
  LibraryPeer next(input->port());
  ASSERT_TRUE(next.send(tests::transform({"Scalpel"}, kStart_ns)));
  EXPECT_TRUE(came(2));
}

// Who begins a message and does not send the rest keeps no place; who says nothing at all may stay.
TEST_F(OpenIgtLink, AMessageThatIsNotFinishedEndsItsConnection) {
  OpenIgtLinkOptions options;
  options.message_time_s = 0.2;
  start(options);
  stream::RawPeer silent(input->port());
  const Packed whole = tests::transform({"Scalpel"}, kStart_ns);
  const auto begun = [&](std::size_t bytes) {
    auto peer = std::make_unique<stream::RawPeer>(input->port());
    peer->send(std::as_bytes(std::span(whole)).first(bytes));
    return peer;
  };
  const auto half_header = begun(29), half_body = begun(whole.size() - 1);
  stream::RawPeer half_image(input->port());  // of those that are passed over
  const Packed image = openigtlink::encode("IMAGE", "Camera", 0, Packed(1000));
  half_image.send(std::as_bytes(std::span(image)).first(500));
  EXPECT_TRUE(half_header->closes());
  EXPECT_TRUE(half_body->closes());
  EXPECT_TRUE(half_image.closes());
  EXPECT_TRUE(stream::eventually([&] { return count("unfinished") == 3; }));
  EXPECT_TRUE(stream::eventually([&] { return input->status().peers.size() == 1; }));
  silent.send(std::as_bytes(std::span(whole)));
  EXPECT_TRUE(came(2));
}

TEST_F(OpenIgtLink, AFullQueueHoldsThePeerBackAndLosesNothing) {
  start();
  LibraryPeer peer(input->port());
  constexpr int kPoses = 12'000;  // the queue holds 8192
  std::thread sender([&] {
    for (int i = 0; i < kPoses; ++i) peer.send(tests::transform({"Scalpel"}, kStart_ns + i * kStep_ns));
  });
  ASSERT_TRUE(stream::eventually([&] { return pose_sources.waiting() >= 8192; }));
  EXPECT_TRUE(came(1 + kPoses));
  sender.join();
  for (std::size_t i = 2; i < events.size(); ++i)
    ASSERT_GT(events[i].pose.pose.t_ns, events[i - 1].pose.pose.t_ns) << i;
}

TEST_F(OpenIgtLink, TheSurfaceIsSentToWhoAsks) {
  OpenIgtLinkOptions options;
  options.surface_hz = 50;
  start(options);
  LibraryPeer peer(input->port());
  const auto surface = igtl::PolyDataMessage::New();
  ASSERT_TRUE(peer.send(tests::get_polydata()));
  ASSERT_EQ(peer.receive_header(), "POLYDATA");
  EXPECT_EQ(peer.device(), "Incise");
  ASSERT_TRUE(peer.receive_body(*surface));
  EXPECT_TRUE(tests::seen(*surface).good);
  // Again: nothing has changed, and nothing is made a second time.
  ASSERT_TRUE(peer.send(tests::get_polydata()));
  ASSERT_EQ(peer.receive_header(), "POLYDATA");
  peer.skip_body();
  EXPECT_EQ(requests, 1);
  // Streamed: one now, one for each change.
  ASSERT_TRUE(peer.send(openigtlink::encode("STT_POLYDATA", "Viewer", 0, Packed(4))));
  ASSERT_EQ(peer.receive_header(), "RTS_POLYDATA");
  peer.skip_body();
  ASSERT_EQ(peer.receive_header(), "POLYDATA");
  peer.skip_body();
  state = 2;
  ASSERT_EQ(peer.receive_header(), "POLYDATA");
  peer.skip_body();
  EXPECT_EQ(requests, 2);
  ASSERT_TRUE(peer.send(openigtlink::encode("STP_POLYDATA", "Viewer", 0, {})));
  ASSERT_EQ(peer.receive_header(), "RTS_POLYDATA");
  peer.skip_body();
  state = 3;
  std::this_thread::sleep_for(200ms);
  EXPECT_EQ(requests, 2);
  EXPECT_EQ(count("surfaces"), 4u);
}

TEST_F(OpenIgtLink, AStreamedSurfaceComesNoOftenerThanThePeerAskedFor) {
  OpenIgtLinkOptions options;
  options.surface_hz = 50;
  start(options);
  LibraryPeer seldom(input->port()), often(input->port());
  const auto follow = [](LibraryPeer& peer, std::uint32_t interval_ms) {
    Packed body;
    for (int shift = 24; shift >= 0; shift -= 8)
      body.push_back(static_cast<std::uint8_t>(interval_ms >> shift));
    ASSERT_TRUE(peer.send(openigtlink::encode("STT_POLYDATA", "Viewer", 0, body)));
    for (const char* type : {"RTS_POLYDATA", "POLYDATA"}) {
      ASSERT_EQ(peer.receive_header(), type);
      peer.skip_body();
    }
  };
  follow(seldom, 60'000);
  follow(often, 0);
  for (int i = 0; i < 8; ++i) {
    ++state;
    ASSERT_EQ(often.receive_header(), "POLYDATA");
    often.skip_body();
  }
  EXPECT_TRUE(stream::eventually([&] { return count("surfaces") >= 1 + 9; }));
  EXPECT_EQ(count("surfaces"), 1u + 9u);
}

TEST_F(OpenIgtLink, NobodyGetsASurfaceThatIsNotOffered) {
  OpenIgtLinkOptions options;
  options.surface = "never";
  options.surface_hz = 50;
  start(options);
  LibraryPeer peer(input->port());
  ASSERT_TRUE(peer.send(tests::get_polydata()));
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(peer.send(openigtlink::encode("STT_POLYDATA", "Viewer", 0, Packed(4))));
    ASSERT_EQ(peer.receive_header(), "RTS_POLYDATA");
    peer.skip_body();
    std::this_thread::sleep_for(50ms);
  }
  EXPECT_EQ(requests, 0);
}

TEST_F(OpenIgtLink, TheSurfaceGoesToAllWhereThatIsConfiguredAndNotTooOften) {
  OpenIgtLinkOptions options;
  options.surface = "always";
  options.surface_hz = 2;
  start(options);
  const auto begin = std::chrono::steady_clock::now();
  LibraryPeer peer(input->port());
  std::jthread changes([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      ++state;
      std::this_thread::sleep_for(1ms);
    }
  });
  for (int i = 0; i < 4; ++i) {
    ASSERT_EQ(peer.receive_header(), "POLYDATA");
    peer.skip_body();
  }
  // The first at once, three more half a second apart at least.
  EXPECT_GE(std::chrono::steady_clock::now() - begin, 1400ms);
}

TEST_F(OpenIgtLink, WhoAsksAndDoesNotReadIsLetGo) {
  start();
  stream::RawPeer peer(input->port(), 4096);
  const Packed ask = openigtlink::encode("STP_POLYDATA", "Viewer", 0, {});
  const std::string_view bytes(reinterpret_cast<const char*>(ask.data()), ask.size());
  // Until the answers fill the kernel's buffers and ours.
  bool going = true;
  for (int i = 0; i < 2'000'000 && going; ++i) going = peer.send(bytes);
  EXPECT_FALSE(going);
  EXPECT_TRUE(stream::eventually([&] { return input->status().peers.empty(); }));
}

TEST_F(OpenIgtLink, ConnectsToServersAndAsksThemForPoses) {
  const auto listener = igtl::ServerSocket::New();
  int port = 0;
  for (port = 28'944; port < 29'044 && listener->CreateServer(port) != 0; ++port) {
  }
  OpenIgtLinkOptions options;
  options.connect = {"127.0.0.1:" + std::to_string(port)};
  options.ask_for = "TDATA";
  start(options);
  const auto serve = [&](std::int64_t t_ns) {
    const igtl::ClientSocket::Pointer socket = listener->WaitForConnection(20'000);
    ASSERT_TRUE(socket.IsNotNull());
    const auto header = igtl::MessageHeader::New();
    header->InitPack();
    socket->SetReceiveTimeout(20'000);
    socket->Receive(header->GetPackPointer(), header->GetPackSize());
    header->Unpack();
    EXPECT_STREQ(header->GetDeviceType(), "STT_TDATA");
    const auto ask = igtl::StartTrackingDataMessage::New();
    ask->SetMessageHeader(header);
    ask->AllocatePack();
    socket->Receive(ask->GetPackBodyPointer(), ask->GetPackBodySize());
    EXPECT_TRUE(ask->Unpack(1) & igtl::MessageHeader::UNPACK_BODY);
    EXPECT_EQ(ask->GetResolution(), 1);  // ms
    const Packed bytes = tests::tdata({{"Channel 0"}}, t_ns);
    socket->Send(bytes.data(), static_cast<int>(bytes.size()));
    ASSERT_TRUE(stream::eventually([&] { return count("poses") > 0; }));
    socket->CloseSocket();
  };
  serve(kStart_ns);
  ASSERT_TRUE(came(3));  // opened, a pose, and the end, since the server has gone
  EXPECT_EQ(pose_sources.name_of(sources[0]), "Channel 0");
  // It comes back.
  serve(kStart_ns);
  EXPECT_TRUE(came(6));
  EXPECT_TRUE(stream::eventually([&] { return count("connections") == 2; }));
}

TEST_F(OpenIgtLink, APortInUseComesWithWhatToDo) {
  const SurfaceFeed none{[] { return std::uint64_t{0}; }, [](auto) {}};
  OpenIgtLinkOptions options;
  options.port = 0;
  OpenIgtLinkInput first(pose_sources, options, none);
  options.port = first.port();
  const std::string expected =
      "openigtlink.port: cannot listen on 127.0.0.1:" + std::to_string(first.port()) +
      ": Address already in use; end the program that listens there (ss -ltnp "
      "shows it), or choose another openigtlink.port (0: any free one)";
  const auto expect_refused = [&](const auto& listen) {
    try {
      listen();
      FAIL() << "two listeners at one port";
    } catch (const std::runtime_error& error) {
      EXPECT_EQ(error.what(), expected);
    }
  };
  // As long as neither listens, both have the port.
  OpenIgtLinkInput second(pose_sources, options, none);
  first.start();
  expect_refused([&] { second.start(); });
  expect_refused([&] { OpenIgtLinkInput(pose_sources, options, none); });
}

TEST_F(OpenIgtLink, StoppedInTheMiddleOfEverything) {
  OpenIgtLinkOptions options;
  options.surface = "always";
  start(options);
  LibraryPeer peer(input->port());
  ASSERT_TRUE(peer.send(tests::transform({"Scalpel"}, kStart_ns)));
  ASSERT_TRUE(came(2));
  stream::RawPeer half(input->port());
  half.send(std::string_view("\0\1", 2));
  input->stop();
  ASSERT_TRUE(came(3));
  EXPECT_EQ(events[2].kind, Kind::kEndStroke);
  EXPECT_EQ(pose_sources.open_count(), 0u);
  input.reset();
}

}  // namespace
}  // namespace incise::input
