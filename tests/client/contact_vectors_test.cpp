// protocol/vectors/contact.json: what the contact renderer gives, call by call, for renderers in other languages to compare
// with. INCISE_WRITE_VECTORS=1 client_test --gtest_filter='ContactVectors.*' writes it again, and the difference is for review.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "client/contact_renderer.hpp"
#include "tests/haptics/random.hpp"

namespace incise::client {
namespace {

using protocol::LocalContact;
using protocol::Vec3;
using tests::Random;
constexpr std::int64_t kMs = 1'000'000;

double size(const Vec3& v) {
  return std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
}

using nlohmann::json;

// Six digits, so that the file holds exactly what is rendered here.
double rounded(double x, double to = 1e6) {
  return std::round(x * to) / to;
}

json numbers(const Vec3& v) {
  return {rounded(v.x, 1e12), rounded(v.y, 1e12), rounded(v.z, 1e12)};
}

Vec3 vector(const json& j) {
  return {j[0], j[1], j[2]};
}

Vec3 anywhere(Random& random, double size) {
  const auto one = [&] { return rounded(random.uniform(-size, size)); };
  const double x = one(), y = one();
  return {x, y, one()};
}

// A plane near the tool; now and then none, or one that must not be rendered.
json golden_plane(Random& random, const Vec3& tool) {
  if (random.below(25) == 0) return nullptr;
  Vec3 near = anywhere(random, 0.0005), normal = anywhere(random, 0.2);
  near = {rounded(near.x + tool.x), rounded(near.y + tool.y), rounded(near.z + tool.z + 0.0008)};
  normal.z = random.below(30) == 0 ? 0.1 : 1.1;
  json plane{{"point", numbers(near)},
             {"normal", numbers(normal)},
             {"stiffness_n_per_m", rounded(random.uniform(200, 2500))},
             {"damping_n_s_per_m", rounded(random.uniform(0, 5))},
             {"cutting_resistance_n", random.below(2) * rounded(random.uniform(0.2, 2))},
             {"friction_n_s_per_m", rounded(random.uniform(0, 3))},
             {"valid_for_ns", static_cast<std::int64_t>(10 + random.below(50)) * kMs},
             {"penetrated", random.below(3) == 0}};
  if (random.below(10) != 0)
    plane["arm"] = numbers(random.below(50) ? anywhere(random, 0.08) : Vec3{1e9, 0, 0});
  return plane;
}

// A hand that presses and turns, with pauses and now and then a reading that cannot be used (null).
json golden_calls(std::uint64_t seed) {
  Random random(seed);
  json calls = json::array();
  Vec3 tool;
  double angle = 0;
  std::int64_t now = kMs;
  for (int i = 0; i < 400; ++i) {
    const std::uint64_t pause = random.below(150);
    now += pause == 0   ? ContactRenderer::kSilence_ns + 1
           : pause == 1 ? ContactRenderer::kSilence_ns
           : pause == 2 ? 0
                        : static_cast<std::int64_t>(random.below(3'000'000));
    if (random.below(6) == 0) calls.push_back({{"take", now}, {"contact", golden_plane(random, tool)}});
    const Vec3 step = anywhere(random, 0.0002);
    tool = {rounded(tool.x + step.x), rounded(tool.y + step.y), rounded(0.98 * tool.z + step.z)};
    angle += random.uniform(-0.02, 0.03);
    json turned{rounded(std::cos(angle)), rounded(std::sin(angle) * 0.6), 0, rounded(std::sin(angle) * 0.8)};
    if (random.below(60) == 0) turned = random.below(2) ? json() : json{0.1, 0, 0, 0};
    calls.push_back({{"call", now}, {"tool", random.below(80) ? numbers(tool) : json()}, {"turned", turned}});
  }
  return calls;
}

json golden_inputs() {
  json runs = json::array();
  for (const bool torque : {true, false})
    runs.push_back({{"torque", torque},
                    {"limits",
                     {{"most_n", torque ? 3.3 : 1},
                      {"slew_n_s", torque ? 500 : 200},
                      {"ramp_s", torque ? 0.1 : 0.02},
                      {"stiffest_n_m", 1800},
                      {"most_torque_n_m", 0.04}}},
                    {"calls", golden_calls(torque ? 5 : 6)}});
  return runs;
}

ContactLimits limits_of(const json& l) {
  return {l["most_n"], l["slew_n_s"], l["ramp_s"], l["stiffest_n_m"], l["most_torque_n_m"]};
}

protocol::Force message_of(const json& c) {
  protocol::Force force;
  if (c.is_null()) return force;
  force.contact = LocalContact{vector(c["point"]),     vector(c["normal"]),       c["stiffness_n_per_m"],
                               c["damping_n_s_per_m"], c["cutting_resistance_n"], c["friction_n_s_per_m"],
                               c["valid_for_ns"],      c["penetrated"],           {}};
  if (c.contains("arm")) force.contact->arm = vector(c["arm"]);
  return force;
}

// What each call of a run gives, in order.
std::vector<Wrench> rendered(const json& run) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  ContactRenderer renderer(limits_of(run["limits"]));
  std::vector<Wrench> felt;
  for (const json& call : run["calls"]) {
    if (call.contains("take")) {
      renderer.take(message_of(call["contact"]), call["take"]);
      continue;
    }
    const Vec3 tool = call["tool"].is_null() ? Vec3{nan, 0, 0} : vector(call["tool"]);
    const json& t = call["turned"];
    const protocol::Quat turned =
        t.is_null() ? protocol::Quat{nan, 0, 0, 0} : protocol::Quat{t[0], t[1], t[2], t[3]};
    felt.push_back(run["torque"] ? renderer.wrench(tool, turned, call["call"])
                                 : Wrench{renderer.force(tool, call["call"]), {}});
  }
  return felt;
}

// One line a call: differences can be read.
void write_golden(const std::string& path, json runs) {
  std::ofstream out(path);
  out << "[";
  for (std::size_t r = 0; r < runs.size(); ++r) {
    json& run = runs[r];
    out << (r ? ",\n" : "") << "{\"torque\":" << run["torque"] << ",\"limits\":" << run["limits"]
        << ",\"calls\":[\n";
    const std::vector<Wrench> felt = rendered(run);
    std::size_t next = 0;
    for (std::size_t i = 0; i < run["calls"].size(); ++i) {
      json& call = run["calls"][i];
      if (call.contains("call")) {
        call["force"] = numbers(felt[next].force_n);
        if (run["torque"]) call["torque"] = numbers(felt[next].torque_n_m);
        ++next;
      }
      out << (i ? ",\n" : "") << call;
    }
    out << "]}";
  }
  out << "]\n";
}

TEST(ContactVectors, AreWhatIsRendered) {
  const std::string path = std::string(INCISE_SOURCE_DIR) + "/protocol/vectors/contact.json";
  if (std::getenv("INCISE_WRITE_VECTORS")) write_golden(path, golden_inputs());
  std::ifstream in(path);
  ASSERT_TRUE(in.good()) << path << " cannot be read";
  const json runs = json::parse(in);
  double force = 0, torque = 0;
  for (const json& run : runs) {
    const std::vector<Wrench> felt = rendered(run);
    std::size_t next = 0;
    for (const json& call : run["calls"]) {
      if (!call.contains("call")) continue;
      const Wrench& found = felt[next++];
      const Vec3 f = vector(call["force"]), t = run["torque"] ? vector(call["torque"]) : Vec3{};
      const Vec3 &g = found.force_n, &u = found.torque_n_m;
      ASSERT_LT(size({g.x - f.x, g.y - f.y, g.z - f.z}), 1e-9) << call;
      ASSERT_LT(size({u.x - t.x, u.y - t.y, u.z - t.z}), 1e-9) << call;
      force = std::max(force, size(g));
      torque = std::max(torque, size(u));
    }
    EXPECT_EQ(next, felt.size());
  }
  EXPECT_GT(force, 1) << "something is felt";
  EXPECT_GT(torque, 0.03);
}

}  // namespace
}  // namespace incise::client
