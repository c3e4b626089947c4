// Host simulations: what they send is cut, seen by everybody, recorded, and never trusted.

#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <limits>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "client/client.hpp"
#include "tests/e2e/served_session.hpp"
#include "tests/support/run_program.hpp"

namespace incise::e2e {
namespace {

using std::chrono::milliseconds;

bool wait_for(const std::function<bool()>& condition) {
  for (int i = 0; i < 6000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(milliseconds(10));
  }
  return false;
}

// A simulator's connection, and what the server has told it.
class Simulator {
 public:
  explicit Simulator(std::uint16_t port, protocol::Role role = protocol::Role::Simulator) {
    client::Callbacks callbacks;
    callbacks.on_positions_report = [this](const protocol::PositionsReport& report) {
      const std::scoped_lock lock(mutex_);
      report_ = report;
      report_.held = {};
      held_ += report.held.size();
      passed_over_ += report.passed_over;
    };
    callbacks.on_error = [this](const protocol::Error& error) {
      const std::scoped_lock lock(mutex_);
      errors_.push_back(error.code);
    };
    client::Options options;
    options.role = role;
    client_ = client::Client::connect("127.0.0.1", port, options, callbacks);
    EXPECT_TRUE(client_->wait_for_revision(0, 60));
  }

  // All vertices, each where `where` puts it given its rest position: as a solver would that knows the state it holds.
  bool send(const std::function<protocol::Vec3(const protocol::Vec3&)>& where, bool single) {
    protocol::Positions message;
    std::vector<double> twice;
    client_->read([&](const protocol::Replica& mesh) {
      message.revision = mesh.revision();
      const auto rest = mesh.rest_positions();
      for (std::size_t i = 0; i < rest.size(); i += 3) {
        const protocol::Vec3 p = where({rest[i], rest[i + 1], rest[i + 2]});
        twice.insert(twice.end(), {p.x, p.y, p.z});
      }
    });
    const std::vector<float> once(twice.begin(), twice.end());
    if (single) {
      message.f32 = once;
    } else {
      message.f64 = twice;
    }
    return send(message);
  }
  bool send(protocol::Positions message) {
    message.frame = ++frame_;
    return client_->send_positions(message) != 0;
  }
  bool send(std::uint64_t revision, std::vector<std::uint32_t> ids, std::vector<double> positions) {
    protocol::Positions message;
    message.revision = revision;
    message.ids = ids;
    message.f64 = positions;
    while (client_->status() == client::Status::kConnected) {
      if (send(message)) return true;
      std::this_thread::sleep_for(milliseconds(1));
    }
    return false;
  }

  client::Client& client() { return *client_; }
  protocol::PositionsReport report() const {
    const std::scoped_lock lock(mutex_);
    return report_;
  }
  std::uint64_t held() const {
    const std::scoped_lock lock(mutex_);
    return held_;
  }
  std::vector<protocol::ErrorCode> errors() const {
    const std::scoped_lock lock(mutex_);
    return errors_;
  }

 private:
  mutable std::mutex mutex_;
  protocol::PositionsReport report_;
  std::uint64_t held_ = 0, passed_over_ = 0, frame_ = 0;
  std::vector<protocol::ErrorCode> errors_;
  std::unique_ptr<client::Client> client_;
};

struct Held {
  std::uint64_t revision = 0, hash = 0;
  friend bool operator==(const Held&, const Held&) = default;
};

Held held(const client::Client& viewer) {
  return viewer.read([](const protocol::Replica& m) { return Held{m.revision(), m.compute_state_hash()}; });
}

// A simulator gets what a blade does to the body, may answer with a model of its own, and is told why a bad one is not used.
TEST(SimulatorTest, GetsTheBladesLoadsAndMayAnswerWithAModel) {
  ServedSession session("loads", 3000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  std::mutex mutex;
  protocol::BladeLoad last;
  std::uint64_t pressing = 0;
  double largest_error = 0;
  std::vector<std::string> errors;
  client::Callbacks callbacks;
  callbacks.on_blade_load = [&](const protocol::BladeLoad& load) {
    const std::scoped_lock lock(mutex);
    protocol::Vec3 sum = load.force_n;
    for (std::size_t i = 0; i < load.ids.size(); ++i) {
      sum.x += load.forces[3 * i];
      sum.y += load.forces[3 * i + 1];
      sum.z += load.forces[3 * i + 2];
    }
    if (!load.ids.empty()) {
      ++pressing;
      largest_error = std::max({largest_error, std::abs(sum.x), std::abs(sum.y), std::abs(sum.z)});
    }
    last = load;
    last.ids = {};
    last.forces = {};
  };
  callbacks.on_error = [&](const protocol::Error& error) {
    const std::scoped_lock lock(mutex);
    errors.push_back(error.text);
  };
  client::Options options;
  options.role = protocol::Role::Simulator;
  options.load_rate_hz = 500;
  const auto simulator = client::Client::connect("127.0.0.1", session.tcp_port(), options, callbacks);
  options = {};
  options.role = protocol::Role::Operator;
  options.view = protocol::View::None;
  options.blade = protocol::BladeEdge{{0, 0, 0}, {0, 0, -0.05}};
  const auto hand = client::Client::connect("127.0.0.1", session.tcp_port(), options);
  const protocol::Box box = simulator->welcome().mesh.box;
  const auto begun = std::chrono::steady_clock::now();
  double down = 0;
  const auto step = [&](double by) {
    down += by;
    const auto now = std::chrono::steady_clock::now() - begun;
    const protocol::PoseSample pose{
        1 + std::chrono::duration_cast<std::chrono::nanoseconds>(now).count(),
        {0.5 * (box.min.x + box.max.x), 0.5 * (box.min.y + box.max.y), box.max.z + 0.055 - down},
        {},
        0,
        0};
    hand->send_poses({&pose, 1});
    std::this_thread::sleep_for(milliseconds(1));
    const std::scoped_lock lock(mutex);
    return pressing;
  };
  // Down until it presses, then to and fro, until enough has come however slow the machine is.
  for (int i = 0; i < 20'000 && step(2e-5) == 0; ++i) {
  }
  for (int i = 0; i < 20'000 && step(i / 50 % 2 == 0 ? 1e-5 : -1e-5) < 20; ++i) {
  }
  {
    const std::scoped_lock lock(mutex);
    ASSERT_GE(pressing, 20u);
    EXPECT_LT(largest_error, 1e-6);
  }
  const auto answer = [&](std::vector<double> stiffness, std::uint32_t source) {
    protocol::BladeModel model;
    {
      const std::scoped_lock lock(mutex);
      model.server_ns = last.server_ns;
      model.point = last.tool;
    }
    model.source = source;
    model.stiffness = stiffness;
    model.valid_for_ns = 900'000'000;
    simulator->send_model(model);
    for (int i = 0; i < 300; ++i) step(0);
    const std::scoped_lock lock(mutex);
    return errors.empty() ? std::string() : std::exchange(errors, {})[0];
  };
  EXPECT_EQ(answer({0, 0, 0, 0, 0, 0, 0, 0, 100}, last.source), "");
  EXPECT_NE(answer({0, 0, 0, 0, 0, 0, 0, 0, -100}, last.source).find("semidefinite"), std::string::npos);
  EXPECT_NE(answer({1, 2, 3}, last.source).find("accepted are 9"), std::string::npos);
  EXPECT_NE(answer({0, 0, 0, 0, 0, 0, 0, 0, 100}, 7).find("no BladeLoad"), std::string::npos);
  EXPECT_EQ(simulator->status(), client::Status::kConnected);
  // Up again: the last word is that nothing acts.
  for (int i = 0; i < 20'000 && down > -0.005; ++i) step(-1e-4);
  EXPECT_TRUE(wait_for([&] {
    const std::scoped_lock lock(mutex);
    return last.contact == protocol::BladeContact::None && last.force_n == protocol::Vec3{};
  }));
}

// A body that sways while a blade goes to and fro in it: a viewer, a second computation of the capture, checkpoints and a
// server that was killed and started again all have the same.
TEST(SimulatorTest, CutsInADeformedBodyAreTheSameForEverybody) {
  ServedSession session("simulator", 3000, R"(, "checkpoint_replay_s": 0.01)");
  ASSERT_TRUE(session.start(false)) << session.log();
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  Held last;
  {
    Simulator simulator(session.tcp_port());
    const protocol::Box box = simulator.client().welcome().mesh.box;
    const double size = box.max.x - box.min.x;
    PoseDriver driver(session, 500, 0.5 * size);
    int sent = 0;
    // Until enough has been cut and moved, however slow the machine is.
    const auto enough = [&] {
      return simulator.report().taken >= 60 && session.stat("/cut_faces").value_or(0) > 300;
    };
    for (int i = 0; i < 20'000 && !enough(); ++i) {
      const double t = 0.05 * i;
      sent += simulator.send(
          [&](const protocol::Vec3& p) {
            return protocol::Vec3{p.x + 0.02 * size * std::sin(t), p.y + 0.05 * std::sin(0.7 * t) * p.x,
                                  p.z + 0.1 * std::cos(t) * p.x * p.x / size};
          },
          i % 2 == 0);
      std::this_thread::sleep_for(milliseconds(20));
    }
    EXPECT_TRUE(enough()) << sent << " sent, " << simulator.report().taken << " taken";
    EXPECT_TRUE(driver.settle());
    EXPECT_TRUE(simulator.errors().empty());
    EXPECT_GT(simulator.held(), 0u) << "no tissue has clung to the blade";
    // All that was sent is either a step or was skipped.
    EXPECT_TRUE(wait_for([&] {
      const protocol::PositionsReport report = simulator.report();
      return report.taken + report.skipped >= static_cast<std::uint64_t>(sent) ||
             report.frame == static_cast<std::uint64_t>(sent);
    }));
    EXPECT_TRUE(wait_for([&] { return session.stat("/backlog/batches").value_or(1) == 0; }));
    // A step that was taken may not be among the figures yet: nothing may come for a while.
    EXPECT_TRUE(wait_for([&] {
      last = held(*viewer);
      std::this_thread::sleep_for(milliseconds(500));
      return static_cast<double>(last.revision) >= session.stat("/revision").value_or(1e18) &&
             simulator.client().revision() == last.revision && viewer->revision() == last.revision;
    }));
    EXPECT_EQ(held(simulator.client()), last);
    // A late one gets rest positions with the snapshot.
    Simulator late(session.tcp_port(), protocol::Role::Viewer);
    EXPECT_EQ(held(late.client()), last);
    simulator.client().read([&](const protocol::Replica& a) {
      late.client().read([&](const protocol::Replica& b) {
        EXPECT_TRUE(a.deformed() && b.deformed());
        EXPECT_TRUE(std::equal(a.rest_positions().begin(), a.rest_positions().end(),
                               b.rest_positions().begin(), b.rest_positions().end()));
      });
    });
  }
  CaptureFollower follower(session);
  EXPECT_TRUE(wait_for([&] {
    EXPECT_EQ(follower.follow(), "");
    return follower.marks() >= last.revision;
  }));
  EXPECT_EQ((Held{follower.revision(), follower.state_hash()}), last);
  EXPECT_GE(follower.deformations(), 60u);
  EXPECT_TRUE(wait_for([&] { return session.stat("/checkpoints/written").value_or(0) > 0; }));
  EXPECT_EQ(session.stat("/checkpoints/following"), 1.0) << session.log();
  EXPECT_EQ(session.stat("/journal/lost"), 0.0);

  session.kill();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_NE(session.log().find("from the checkpoint at"), std::string::npos) << session.log();
  const auto again = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(again->wait_for_revision(0, 60));
  EXPECT_EQ(held(*again), last);
  EXPECT_TRUE(again->read([](const protocol::Replica& m) { return m.deformed(); }));
  Process verify({"incise", "replay", session.capture(), "--verify"});
  EXPECT_EQ(verify.wait(), 0);
  session.kill();

  // A file has the deformed shape, and says where that was at rest.
  const std::string mesh = session.file("deformed.vtu");
  Process exporting({"incise", "export", session.capture(), "--out", mesh});
  EXPECT_EQ(exporting.wait(), 0);
  Process info({"incise", "info", mesh});
  EXPECT_NE(info.rest().find("rest_position, on vertices, 3 float32"), std::string::npos);
  const auto pair = tests::run_program(
      "incise", {"export", session.capture(), "--out", session.file("deformed.node")}, session.file(""));
  EXPECT_EQ(pair.exit_code, 0) << pair.err;
  EXPECT_NE(pair.err.find("deformed.node: has the body as a simulation has deformed it"), std::string::npos)
      << pair.err;
}

TEST(SimulatorTest, BadPositionsAreRefusedAndTheBodyStays) {
  using protocol::ErrorCode;
  ServedSession session("bad_positions", 2000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  ASSERT_TRUE(viewer->wait_for_revision(0, 60));
  const Held before = held(*viewer);
  const std::uint32_t vertices = viewer->read([](const protocol::Replica& m) { return m.vertex_count(); });

  Simulator simulator(session.tcp_port());
  const auto refused = [&](ErrorCode code, std::uint64_t revision, std::vector<std::uint32_t> ids,
                           std::vector<double> positions) {
    const std::size_t errors = simulator.errors().size();
    EXPECT_TRUE(simulator.send(revision, std::move(ids), std::move(positions)));
    EXPECT_TRUE(wait_for([&] { return simulator.errors().size() > errors; }));
    EXPECT_EQ(simulator.errors().back(), code);
  };
  refused(ErrorCode::BadRequest, 0, {vertices}, {0, 0, 0});  // no such vertex
  refused(ErrorCode::BadRequest, 1, {0}, {0, 0, 0});         // a revision to come
  refused(ErrorCode::BadRequest, 0, {}, {});                 // nothing
  Simulator stranger(session.tcp_port(), protocol::Role::Viewer);
  EXPECT_TRUE(stranger.send(0, {0}, {0, 0, 0}));
  EXPECT_TRUE(wait_for([&] { return !stranger.errors().empty(); }));
  EXPECT_EQ(stranger.errors().front(), ErrorCode::Forbidden);
  EXPECT_EQ(held(*viewer), before);

  // Far away: the vertex is held, the step is told, the mesh is as it was.
  EXPECT_TRUE(simulator.send(0, {0}, {1000, 1000, 1000}));
  EXPECT_TRUE(wait_for([&] { return simulator.report().taken == 1; }));
  EXPECT_GE(simulator.held(), 1u);
  EXPECT_TRUE(viewer->wait_for_revision(1, 60));
  EXPECT_EQ(held(*viewer), (Held{1, before.hash}));

  // A second one may not, while the first is there; then it may.
  Simulator second(session.tcp_port());
  EXPECT_TRUE(second.send(0, {0}, {0, 0, 0}));
  EXPECT_TRUE(wait_for([&] { return !second.errors().empty(); }));
  EXPECT_EQ(second.errors().front(), ErrorCode::NotAvailable);

  // More than the loop takes: some are skipped, the last one perhaps as well; but a simulation sends on.
  constexpr int kMany = 300;
  const protocol::Vec3 corner = viewer->read([](const protocol::Replica& m) { return m.position(0); });
  for (int i = 1; i <= kMany; ++i) {
    const double d = 1e-6 * i;
    ASSERT_TRUE(simulator.send(1, {0}, {corner.x + d, corner.y, corner.z}));
    if (i % 100 == 0) std::this_thread::sleep_for(milliseconds(1100));  // 500 messages a second are accepted
  }
  EXPECT_TRUE(wait_for([&] {
    const auto report = simulator.report();
    return report.taken + report.skipped >= kMany + 1;
  }));
  EXPECT_TRUE(wait_for([&] {
    const double last = corner.x + 1e-6 * kMany;
    if (viewer->read([](const protocol::Replica& m) { return m.position(0).x; }) == last) return true;
    std::this_thread::sleep_for(milliseconds(20));
    simulator.send(1, {0}, {last, corner.y, corner.z});
    return false;
  }));

  // What is no number ends the session, and nothing else.
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::size_t errors = simulator.errors().size();
  EXPECT_TRUE(simulator.send(1, {0}, {nan, 0, 0}));
  EXPECT_TRUE(wait_for([&] { return simulator.errors().size() > errors; }));
  EXPECT_EQ(simulator.errors().back(), ErrorCode::BadFrame);
  EXPECT_TRUE(wait_for([&] { return simulator.client().status() == client::Status::kClosed; }));
  EXPECT_TRUE(wait_for([&] {
    second.send(1, {0}, {corner.x, corner.y, corner.z});
    return second.report().taken > 0;
  }));
  const std::uint64_t now = viewer->revision();
  EXPECT_TRUE(viewer->wait_for_revision(now, 60));
  EXPECT_TRUE(session.server().running());
}

// The example, and a hand that holds a blade over it.
class SoftSlab {
 public:
  SoftSlab(const std::string& name, const std::string& capture) : session(name, 3000, capture) {
    session.set_keys(R"(, "haptics": {"silence_s": 1})");  // no motor: a busy machine's pauses are no fault
    EXPECT_TRUE(session.start(false)) << session.log();
    simulation.emplace(
        std::vector<std::string>{"incise-xpbd", "127.0.0.1:" + std::to_string(session.tcp_port())});
    EXPECT_TRUE(rests()) << "it does not come to rest";
    connect();
  }
  void connect() {
    client::Options options;
    viewer = client::Client::connect("127.0.0.1", session.tcp_port(), options);
    options.role = protocol::Role::Operator;
    options.view = protocol::View::None;
    options.blade = protocol::BladeEdge{{0, 0, 0}, {0, 0, -0.05}};
    hand = client::Client::connect("127.0.0.1", session.tcp_port(), options);
    box = hand->welcome().mesh.box;
  }
  // The simulation says so when it has come to rest.
  bool rests() {
    for (int i = 0; i < 120; ++i) {
      if (const std::string line = simulation->line(""); line.find("at rest") != std::string::npos)
        return true;
    }
    return false;
  }
  // The tip goes there in a millisecond; x and y from 0 to 1 across the body, z from its top.
  void move(double x, double y, double z, bool engaged) {
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    const protocol::PoseSample pose{std::chrono::duration_cast<std::chrono::nanoseconds>(now).count(),
                                    {box.min.x + x * (box.max.x - box.min.x),
                                     box.min.y + y * (box.max.y - box.min.y), box.max.z + z + 0.05},
                                    {1, 0, 0, 0},
                                    engaged ? 1u : 0u,
                                    0};
    hand->send_poses({&pose, 1});
    std::this_thread::sleep_for(milliseconds(1));
  }
  // Across the middle, half-way down.
  void cut(double x) {
    const double down = 0.5 * (box.max.z - box.min.z);
    for (int i = 0; i <= 600; ++i) move(x, -0.1 + 1.2 * i / 600, -down, i < 600);
    for (int i = 0; i < 50; ++i) move(x, 1.2, -down + 1e-6 * i, false);
  }
  // The farthest that a vertex is from its place at rest, m.
  double bent() const {
    return viewer->read([](const protocol::Replica& m) {
      double most = 0;
      for (std::size_t i = 0; i < m.positions().size(); ++i)
        most = std::max(most, std::abs(m.positions()[i] - m.rest_positions()[i]));
      return most;
    });
  }
  // The widest gap between the two copies of a vertex that a cut has parted, by the body's length.
  double gap() const {
    return viewer->read([&](const protocol::Replica& m) {
      std::map<std::array<double, 3>, std::uint32_t> first;
      double widest = 0;
      for (std::uint32_t v = 0; v < m.vertex_count(); ++v) {
        const auto rest = m.rest_positions().subspan(3 * std::size_t{v}, 3);
        const auto [twin, is_new] = first.try_emplace({rest[0], rest[1], rest[2]}, v);
        const protocol::Vec3 a = m.position(v), b = m.position(twin->second);
        if (!is_new) widest = std::max(widest, std::hypot(a.x - b.x, a.y - b.y, a.z - b.z));
      }
      return widest / (box.max.x - box.min.x);
    });
  }
  double deformations() const { return session.stat("/deformations/count").value_or(-1); }

  ServedSession session;
  std::optional<Process> simulation;
  std::unique_ptr<client::Client> viewer, hand;
  protocol::Box box;
};

// Nothing sags, and what rests sends nothing; a blade dents the body, and without it the body is as it was.
TEST(SoftBodyTest, RestsAsItWasServedDentsUnderABladeAndRestsAgain) {
  SoftSlab slab("xpbd_dent", "");
  EXPECT_EQ(slab.deformations(), 0);
  double z = 0.005, deepest = 0;
  for (int i = 0; i < 20'000 && deepest < 1e-3; ++i) {
    if (z > -0.004) z -= 2e-6;
    slab.move(0.5, 0.5, z + 1e-7 * (i % 2), false);  // a hand is never quite still
    if (i % 50 == 0) deepest = slab.bent();
  }
  EXPECT_GT(deepest, 1e-3);
  for (int i = 0; i < 2'000; ++i) slab.move(0.5, 0.5, z += 5e-6, false);
  ASSERT_TRUE(slab.rests());
  // Nothing is on its way any more.
  EXPECT_TRUE(wait_for([&] {
    return static_cast<double>(slab.viewer->revision()) == slab.session.stat("/revision").value_or(-1);
  }));
  EXPECT_LT(slab.bent(), 1e-4);
  const std::uint64_t revision = slab.viewer->revision();
  EXPECT_GT(revision, 0u);
  for (int i = 0; i < 300; ++i) slab.move(0.5, 0.5, 0.02 + 1e-6 * i, true);  // in the air, and engaged
  EXPECT_EQ(slab.deformations(), static_cast<double>(revision));
}

// A cut opens and stays open; undone, it was never there, and the next one opens as well; so after a reset and with a server that
// was killed and started again.
TEST(SoftBodyTest, ACutOpensAlsoAfterUndoResetAndRestart) {
  SoftSlab slab("xpbd_cut", "");
  const auto opens = [&](const char* when) {
    slab.cut(0.5);
    EXPECT_TRUE(wait_for([&] { return slab.gap() > 0.02; })) << when << ": " << slab.gap();
    EXPECT_TRUE(slab.rests()) << when;
    EXPECT_GT(slab.gap(), 0.02) << when;
  };
  opens("first");
  slab.hand->undo();
  EXPECT_TRUE(wait_for([&] { return slab.session.stat("/cut_faces").value_or(1) == 0; }));
  EXPECT_TRUE(wait_for([&] { return slab.viewer->revision() == 0; }));
  EXPECT_TRUE(slab.rests());
  EXPECT_EQ(slab.bent(), 0);
  opens("undone");

  client::Options options;
  options.role = protocol::Role::Admin;
  options.view = protocol::View::None;
  const auto admin = client::Client::connect("127.0.0.1", slab.session.tcp_port(), options);
  admin->reset();
  EXPECT_TRUE(wait_for([&] { return slab.session.stat("/cut_faces").value_or(1) == 0; }));
  EXPECT_TRUE(slab.rests());
  EXPECT_TRUE(wait_for([&] { return slab.viewer->revision() == 0; }));
  opens("reset");

  // Steps that were still on their way to the capture would be gone.
  Held before = held(*slab.viewer);
  EXPECT_TRUE(wait_for([&] {
    const Held last = before;
    std::this_thread::sleep_for(milliseconds(500));
    before = held(*slab.viewer);
    return before == last;
  }));
  slab.session.kill();
  ASSERT_TRUE(slab.session.start(true)) << slab.session.log();
  slab.connect();
  ASSERT_TRUE(slab.viewer->wait_for_revision(0, 60));
  EXPECT_EQ(held(*slab.viewer), before);
  EXPECT_GT(slab.gap(), 0.02);
  slab.cut(0.3);
  EXPECT_TRUE(wait_for([&] { return slab.deformations() > 10; })) << slab.deformations();
  EXPECT_TRUE(slab.rests());
  slab.simulation->signal(SIGTERM);
  EXPECT_EQ(slab.simulation->wait(), 0);
}

}  // namespace
}  // namespace incise::e2e
