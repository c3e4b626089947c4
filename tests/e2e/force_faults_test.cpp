// A device's reports to the force that it is sent, through all that lies between, with a clock of the test's own: decoder,
// queue, loop with forces and cutting, slot, report. So limits in newtons a second and times in milliseconds are checked
// to the digit, on any machine; incise-hid-faults does the same with threads and a separate process, in real
// time.

#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <optional>

#include "server/input/hid/hid_device.hpp"
#include "server/input/positions_slot.hpp"
#include "server/loop/frame_loop.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"
#include "tests/support/float_stylus.hpp"

namespace {
std::int64_t virtual_ns = 0;  // 0: the system's clock
}

extern "C" int clock_gettime(clockid_t clock, timespec* time) noexcept {
  if (clock != CLOCK_MONOTONIC || virtual_ns == 0)
    return static_cast<int>(::syscall(SYS_clock_gettime, clock, time));
  *time = {virtual_ns / 1'000'000'000, virtual_ns % 1'000'000'000};
  return 0;
}

namespace incise::e2e {
namespace {

using core::Vec3;
using tests::Random;

constexpr std::int64_t kMs = 1'000'000;
constexpr double kMost_n = 3.3, kSlew_n_s = 500, kRamp_s = 2, kQuantum_n = 2e-6;
constexpr std::int64_t kDecay_ns = 10 * kMs, kFrameSlack_ns = 2 * kMs;

using Report = std::array<std::uint8_t, 16>;

// A host simulation, as the stream's thread would join it to the loop: it takes the blade's loads, moves the body by them and by
// itself, 60 times a second, and may send models of its own. It fails in all ways that a program behind a network can.
class Simulation {
 public:
  enum Fault : std::uint32_t { kNone, kStalls, kDies, kNotANumber, kLate, kFloods, kReconnects, kFaults };
  static constexpr std::int64_t kModelLife_ns = 50 * kMs;

  explicit Simulation(core::CutSession& session) : session_(session) {}

  void step(std::int64_t now_ns) {
    link.wanted_until_ns = now_ns + 1000 * kMs;
    if (fault == kStalls || fault == kDies)
      return;  // the connection is there, or it is not: the loop gets nothing
    link.loads[0].read(load_);
    for (int i = 0; i < (fault == kFloods ? 30 : now_ns / kMs % 16 == 0); ++i) send(now_ns, i);
  }
  // After kDies: another process, which knows nothing.
  void start_again() {
    shift_.clear();
    fault = kNone;
  }

  haptics::SimulationLink link;
  input::PositionsSlot positions;
  Fault fault = kNone;
  bool models = false;
  int used = 0, refused = 0;  // models

 private:
  void send(std::int64_t now_ns, int i) {
    const core::TetMesh& mesh = session_.mesh();
    shift_.resize(mesh.vertex_slots());
    for (Vec3& shift : shift_) shift = 0.5 * shift;
    for (std::size_t k = 0; k < load_.loads.count; ++k) {
      if (load_.loads.ids[k] < shift_.size())
        shift_[load_.loads.ids[k]] += (0.5 / 2000) * load_.loads.forces[k];
    }
    const double sway = 5e-4 * std::sin(1e-9 * static_cast<double>(now_ns) * 7 + 0.1 * i);
    if (const auto made = positions.buffer()) {
      made->revision = fault == kLate ? 0 : session_.revision();
      made->ids.clear();
      made->positions.clear();
      for (core::VertexId v = 0; v < shift_.size(); ++v) {
        const Vec3 rest = mesh.rest_position(v);
        made->positions.push_back(fault == kReconnects ? rest
                                                       : rest + shift_[v] + Vec3{0, 0, 10 * sway * rest.z});
      }
      positions.offer(made);
    }
    if (!models) return;
    // To the side, as no contact with the cube's top is, so that whose force acts can be seen.
    haptics::LocalModel model;
    model.number = ++models_;
    model.point = load_.tool + Vec3{0.002, 0, 0};
    model.normal = {1, 0, 0};
    model.stiffness = {{400, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    model.from_ns = fault == kLate ? now_ns - 2 * kModelLife_ns : now_ns;
    model.expires_ns = model.from_ns + kModelLife_ns;
    if (fault == kNotANumber) (i % 2 ? model.stiffness.x.x : model.point.x) = NAN;
    if (haptics::trouble_of(model, now_ns).empty()) {
      link.models[0].write(model);
      ++used;
    } else {
      ++refused;
    }
  }

  core::CutSession& session_;
  haptics::BladeLoad load_;
  std::vector<Vec3> shift_;
  std::uint64_t models_ = 0;
};

class Rig {
 public:
  explicit Rig(bool simulated = false) {
    virtual_ns = kBegun;
    // So stiff that four millimetres are more than the limit: every stage has something to hold back.
    haptics::ForceConfig config;
    config.materials.tissue.stiffness_n_m = 2000;
    if (simulated) loop_.offer_deformation(simulation.emplace(session_).positions);
    loop_.offer_forces(config, std::make_unique<haptics::Tissue>(tests::cube(6)), nullptr, &slots_,
                       simulated ? &simulation->link : nullptr);
    plug();
  }
  ~Rig() { virtual_ns = 0; }

  void plug() {
    decoder_.emplace(profile_, input::Placement{});
    source_ = sources_.open("stylus");
    ASSERT_TRUE(source_);
    slots_[0].device_came(profile_.force->max_newtons);
    maker_.emplace(*profile_.force, *decoder_);
    felt = {};
  }
  // As HidDevice does when its node is gone.
  void unplug() {
    slots_[0].device_lost();
    source_->end_stroke(virtual_ns);
    source_.reset();
    maker_.reset();
    felt = {};
  }
  bool plugged() const { return maker_.has_value(); }

  // A report from the device.
  void report(const Report& bytes) { report(std::span<const std::uint8_t>(bytes)); }
  void report(std::span<const std::uint8_t> bytes) {
    for (const auto& sample : decoder_->decode(bytes, virtual_ns)) {
      const input::TimedPose pose{sample.pose, virtual_ns};
      if (!sample.valid) {
        source_->end_stroke(virtual_ns);
      } else {
        ASSERT_EQ(source_->enqueue(std::span(&pose, 1)), 1u);
      }
    }
  }
  // What it says of itself, moved on towards where it is wanted by at most 1 mm.
  Report pose() {
    const double t = 1e-9 * static_cast<double>(virtual_ns - kBegun);
    at_ += std::clamp(height - at_, -1e-3, 1e-3);
    Report bytes{};
    bytes[0] = 1;
    ++counter_;
    std::memcpy(&bytes[1], &counter_, 2);
    bytes[3] = static_cast<std::uint8_t>(2 + engaged);
    const float p[3] = {static_cast<float>(0.05 + 0.01 * std::sin(t)), 0.05f, static_cast<float>(at_)};
    std::memcpy(&bytes[4], p, sizeof p);
    return last_pose = bytes;
  }
  // The same place, reported again.
  Report frozen() {
    ++counter_;
    std::memcpy(&last_pose[1], &counter_, 2);
    return last_pose;
  }

  // A millisecond goes by; the loop has a frame, or hangs; the writer writes. Checks what must always hold.
  void tick(bool frame = true) {
    virtual_ns += kMs;
    if (simulation) simulation->step(virtual_ns);
    if (frame) loop_.frame(virtual_ns);
    if (!maker_) return;
    const bool fresh = slots_[0].read(command_);
    const auto bytes = maker_->make(command_, virtual_ns);
    std::int32_t raw[3];
    std::memcpy(raw, &bytes[1], sizeof raw);
    const Vec3 now{1e-6 * raw[0], 1e-6 * raw[1], 1e-6 * raw[2]};
    if (refuses) {  // the device does not get it; it holds what it has, and must not be trusted with it
      maker_->failed();
      slots_[0].write_failed();
    }
    ASSERT_LE(length(now), kMost_n + kQuantum_n);
    // Between two commands; a command that has become too old is no force at once.
    if (fresh && !stale_) {
      ASSERT_LE(distance(now, felt),
                kSlew_n_s * 1e-9 * static_cast<double>(virtual_ns - command_ns_) + kQuantum_n);
    }
    if (fresh) command_ns_ = virtual_ns;
    stale_ = virtual_ns - command_.time_ns > input::kForceLife_ns || refuses;
    felt = now;
    if (length(felt) == 0) {
      zero_ns = virtual_ns;
      if (first_zero_ns == 0) first_zero_ns = virtual_ns;
    }
  }
  void run(int ms) {
    for (int i = 0; i < ms && !::testing::Test::HasFatalFailure(); ++i) {
      report(pose());
      tick();
    }
  }
  // Pulled out of the tissue and in again, the button pressed in the air.
  void press_again() {
    height = 0.16;
    engaged = false;
    run(30);
    engaged = true;
    run(5);
    engaged = false;
    run(5);
  }

  std::uint64_t revision() const { return session_.revision(); }
  bool in_stroke() const { return session_.in_stroke(0); }
  const loop::LoopStats& stats() const { return loop_.stats(); }
  bool latched() const { return (command_.flags & haptics::kForceLatchedOff) != 0; }

  std::optional<Simulation> simulation;
  double height = 0.146;  // of the tip over the cube's bottom: wanted; the top is at 0.1, the blade 0.05 long
  bool engaged = false, refuses = false;
  Report last_pose{};
  Vec3 felt;
  std::int64_t zero_ns = kBegun,
               first_zero_ns = 0;  // the last time that there was none; the first one since this was 0

 private:
  static core::CutConfig cut_config() {
    core::CutConfig config;
    config.blade = {{0, 0, 0}, {0, 0, -0.05}};
    return config;
  }
  struct Discard : loop::DeltaSink {
    void publish(std::shared_ptr<const loop::PublishedDelta>) noexcept override {}
  };
  static constexpr std::int64_t kBegun = 1'000'000 * kMs;
  const input::DeviceProfile profile_ = input::parse_profile(
      tests::float_stylus_profile(R"("usage_page": "ff1c", "usage": "0001")"), "float.json");
  core::CutSession session_{tests::cube(6), cut_config()};
  input::PoseSources sources_{cut_config().blade};
  Discard sink_;
  haptics::ForceSlots slots_;
  loop::FrameLoop loop_{session_, sources_, sink_, nullptr, {}};
  std::optional<input::PoseDecoder> decoder_;
  std::optional<input::PoseSource> source_;
  std::optional<input::ForceReport> maker_;
  haptics::ForceCommand command_;
  std::int64_t command_ns_ = kBegun;
  bool stale_ = true;
  std::uint16_t counter_ = 0;
  double at_ = 0.16;
};

enum Fault : std::uint32_t {
  kUnplug,
  kGarbage,
  kSilent,
  kRepeats,
  kFrozen,
  kNotANumber,
  kOutOfSight,
  kLateLoop,
  kRefuses,
  kFaults
};

// The fault begins and lasts; returns in what time it must have ended the force, ns.
std::int64_t inflict(Rig& rig, Fault fault, Random& random) {
  const auto last = [&](std::int64_t ms, const std::function<void()>& report) {
    for (std::int64_t i = 0; i < ms && !::testing::Test::HasFatalFailure(); ++i) {
      report();
      rig.tick();
    }
  };
  switch (fault) {
    case kUnplug:
      rig.unplug();
      last(5, [] {});
      return 0;
    case kGarbage:
      last(60, [&] {
        std::array<std::uint8_t, 40> bytes;
        for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random.below(256));
        // Too short, or of another number, or with a position that is light years off.
        const std::uint32_t kind = random.below(3);
        bytes[0] = kind == 1 ? 9 : 1;
        if (kind == 2) bytes[7] = bytes[11] = bytes[15] = 0x7e;
        rig.report(std::span<const std::uint8_t>(bytes).first(kind == 0 ? 1 + random.below(15) : 40));
      });
      return 20 * kMs + kDecay_ns;
    case kSilent:
      last(60, [] {});
      return 20 * kMs + kDecay_ns;
    case kRepeats:
      last(60, [&] { rig.report(rig.last_pose); });
      return 20 * kMs + kDecay_ns;
    case kFrozen:
      last(290, [&] { rig.report(rig.frozen()); });
      return 250 * kMs + kDecay_ns;
    case kNotANumber:
      last(60, [&] {
        Report bytes = rig.frozen();
        const float none = random.below(2) ? NAN : -INFINITY;
        std::memcpy(&bytes[4 + 4 * random.below(3)], &none, 4);
        rig.report(bytes);
      });
      return 20 * kMs + kDecay_ns;
    case kOutOfSight:
      last(60, [&] {
        Report bytes = rig.frozen();
        bytes[3] = 0;
        rig.report(bytes);
      });
      return 20 * kMs + kDecay_ns;
    case kLateLoop:
      for (std::uint32_t i = 0, n = 6 + random.below(45); i < n; ++i) {
        rig.report(rig.pose());
        rig.tick(false);
      }
      last(12, [&] { rig.report(rig.pose()); });
      return 20 * kMs + kDecay_ns;  // older commands are not sent to the device
    case kRefuses:
      rig.refuses = true;
      last(5 + random.below(20), [&] { rig.report(rig.pose()); });
      rig.refuses = false;
      last(12, [&] { rig.report(rig.pose()); });
      return 0;
    case kFaults:
      break;
  }
  return 0;
}

TEST(ForceFaults, FiveHundredInContactEndTheForceInTimeAndNoneBreaksALimit) {
  int acted = 0, latches = 0, strokes = 0, counts[kFaults] = {};
  for (std::uint64_t seed = 1; seed <= 25; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    Rig rig;
    for (int episode = 0; episode < 20; ++episode) {
      SCOPED_TRACE("episode " + std::to_string(episode));
      // Down to the surface and into a contact, one in three with a stroke under way.
      rig.height = 0.146;
      rig.engaged = random.below(3) == 0;
      rig.run(60 + static_cast<int>(random.below(random.below(5) == 0 ? 2500 : 500)));
      if (HasFatalFailure()) return;
      acted += length(rig.felt) > 0;
      strokes += rig.in_stroke();
      const auto fault = static_cast<Fault>(random.below(kFaults));
      ++counts[fault];
      SCOPED_TRACE("fault " + std::to_string(fault));
      const std::int64_t from = virtual_ns;
      rig.first_zero_ns = 0;
      const bool acting = length(rig.felt) > 0;
      const std::int64_t allowed = inflict(rig, fault, random);
      if (HasFatalFailure()) return;
      if (fault == kUnplug) {
        ASSERT_FALSE(rig.in_stroke()) << "a stroke ends with its device";
        rig.plug();
      } else if (acting) {
        ASSERT_GT(rig.first_zero_ns, 0) << "the force has not come to 0";
        ASSERT_LE(rig.first_zero_ns - from, allowed + kFrameSlack_ns);
        if (fault != kLateLoop) {
          ASSERT_EQ(length(rig.felt), 0) << "and is 0 as long as the fault lasts";
        }
      }
      if (fault == kOutOfSight) {
        ASSERT_FALSE(rig.in_stroke());
      }
      // What comes back comes with the ramp.
      const std::int64_t zero = rig.zero_ns;
      const bool latched = rig.latched() && fault != kUnplug;
      latches += latched;
      for (int i = 0; i < 120; ++i) {
        rig.run(1);
        if (HasFatalFailure()) return;
        const double ramp = kMost_n / kRamp_s * 1e-9 * static_cast<double>(virtual_ns - zero);
        ASSERT_LE(length(rig.felt), latched ? 0 : ramp + kQuantum_n) << i << " ms after";
      }
      if (fault == kRefuses) {  // forces begin again only when the source is opened again
        ASSERT_TRUE(latched);
        rig.press_again();
        ASSERT_TRUE(rig.latched());
        rig.unplug();
        rig.tick();
        rig.plug();
      }
      rig.press_again();
      if (HasFatalFailure()) return;
      ASSERT_FALSE(rig.latched());
    }
    ASSERT_GT(rig.stats().pose_to_force.count(), 1000u);
  }
  EXPECT_GE(acted, 450);
  EXPECT_GE(strokes, 50);
  EXPECT_GE(latches, 50);
  for (const int count : counts) EXPECT_GE(count, 20);
}

// The same with a simulation that moves the body, in every other fault the one that fails: whatever it does, forces keep to
// their limits (Rig::tick), a device's fault ends them in time, and a model of its own is rendered no longer than it is valid.
TEST(ForceFaults, FiveHundredWithASimulationAmongWhatFails) {
  int device = 0, counts[Simulation::kFaults] = {}, rendered = 0, used = 0, refused = 0;
  std::uint64_t revisions = 0;
  for (std::uint64_t seed = 101; seed <= 125; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    Rig rig(true);
    Simulation& simulation = *rig.simulation;
    for (int episode = 0; episode < 20; ++episode) {
      SCOPED_TRACE("episode " + std::to_string(episode));
      rig.height = 0.146;
      rig.engaged = random.below(3) == 0;
      simulation.models = random.below(2) == 0;
      rig.run(60 + static_cast<int>(random.below(500)));
      if (HasFatalFailure()) return;
      const bool acting = length(rig.felt) > 0;
      if (random.below(2) == 0) {
        ++device;
        auto fault = kLateLoop;
        while (fault == kLateLoop || fault == kRefuses) fault = static_cast<Fault>(random.below(kFaults));
        SCOPED_TRACE("of the device: " + std::to_string(fault));
        const std::int64_t from = virtual_ns;
        rig.first_zero_ns = 0;
        const std::int64_t allowed = inflict(rig, fault, random);
        if (HasFatalFailure()) return;
        if (fault == kUnplug) {
          rig.plug();
        } else if (acting) {
          ASSERT_GT(rig.first_zero_ns, 0) << "the force has not come to 0";
          ASSERT_LE(rig.first_zero_ns - from, allowed + kFrameSlack_ns);
          ASSERT_EQ(length(rig.felt), 0);
        }
      } else {
        const auto fault = static_cast<Simulation::Fault>(1 + random.below(Simulation::kFaults - 1));
        ++counts[fault];
        SCOPED_TRACE("of the simulation: " + std::to_string(fault));
        rendered += simulation.models && rig.felt.x > 0.05;
        simulation.fault = fault;
        rig.run(60);
        if (HasFatalFailure()) return;
        // What it said last has expired, and the force has had 10 ms to follow. (A blade that cuts is held to the side, too.)
        if (!rig.engaged && fault != Simulation::kFloods && fault != Simulation::kReconnects) {
          ASSERT_LT(rig.felt.x, 0.05 + std::abs(rig.felt.z)) << "a model is rendered that nobody stands by";
        }
        rig.run(static_cast<int>(random.below(300)));
        if (HasFatalFailure()) return;
        simulation.start_again();
        rig.run(100);
      }
      simulation.models = false;
      rig.run(60);
      rig.press_again();
      if (HasFatalFailure()) return;
      ASSERT_FALSE(rig.latched());
    }
    used += simulation.used;
    refused += simulation.refused;
    revisions += rig.revision();
  }
  EXPECT_GE(device, 200);
  for (int fault = 1; fault < static_cast<int>(Simulation::kFaults); ++fault)
    EXPECT_GE(counts[fault], 25) << fault;
  EXPECT_GE(rendered, 30);
  EXPECT_GT(used, 1000);
  EXPECT_GT(refused, 200);
  EXPECT_GT(revisions, 10'000u) << "the body did not move";
}

}  // namespace
}  // namespace incise::e2e
