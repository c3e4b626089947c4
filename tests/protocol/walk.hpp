#pragma once

// What the tests of replicas share: a random walk of a model, snapshots sent through bytes, and many boxes of interest
// that follow such a walk.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "protocol/box_follow.hpp"
#include "protocol/coalesce.hpp"
#include "protocol/framing.hpp"
#include "tests/protocol/model.hpp"

namespace incise::protocol {

// A model that changes at random. A failure tells the seed.
struct Walk {
  Walk(std::uint32_t nx, std::uint32_t ny, std::uint32_t nz) : model(box_model(nx, ny, nz)) {}
  // The next change.
  OwnedDelta step() {
    const Model before = model;
    mutate(model, random);
    return difference(before, model);
  }
  // A cut: what it moves goes anywhere.
  OwnedDelta cut() {
    OwnedDelta delta = step();
    delta.steps.back().stroke = 1;
    return delta;
  }
  // A deformation that moves all vertices a little.
  OwnedDelta sway(double by_m) {
    const Model before = model;
    ++model.revision;
    std::uniform_real_distribution<double> some(-by_m, by_m);
    for (auto& position : model.positions)
      for (double& x : position) x += some(random);
    return difference(before, model);
  }

  const std::uint64_t seed = std::random_device{}();
  std::mt19937_64 random{seed};
  Model model;
  const ::testing::ScopedTrace trace{__FILE__, __LINE__, "seed " + std::to_string(seed)};
};

// What a server's mirror does with a delta. Returns the tetrahedra that are in another piece than before.
inline std::vector<std::uint32_t> apply_at_server(Replica& mesh, TetIndex& index, const Delta& delta) {
  static_cast<void>(mesh.pieces());
  index.follow(mesh, delta);
  EXPECT_TRUE(mesh.apply(delta));
  std::vector<std::uint32_t> in_other_pieces;
  mesh.follow_pieces(index, delta, in_other_pieces);
  return in_other_pieces;
}

// The message as a receiver gets it. Its arrays live as long as `kept`.
template <class T>
const T& through_bytes(const T& body, Message& kept) {
  const Frame frame = encode(body);
  DecodeResult decoded = decode(frame.body());  // which is not 8-aligned: the message gets a copy
  EXPECT_TRUE(decoded) << decoded.error;
  kept = decoded ? std::move(*decoded.message) : Message{{}, T{}, nullptr};
  return std::get<T>(kept.body);
}

// Sends a snapshot to `to`, through bytes. `hash`: what the writer wants for the end.
template <class Writer, class To, class... Hash>
ApplyResult send_snapshot(Writer writer, To& to, Hash... hash) {
  Message kept;
  ApplyResult result = to.begin(through_bytes(writer.begin(), kept));
  while (result && writer.next()) result = to.chunk(through_bytes(writer.chunk(), kept));
  return result ? to.end(through_bytes(writer.end(hash...), kept)) : result;
}

// Boxes of any size and place in a mesh; the first one is a corner of it, where only the bounds touch.
inline std::vector<Box> random_boxes(const Replica& mesh, std::size_t count, std::mt19937_64& random) {
  Vec3 low{1e9, 1e9, 1e9}, high{-1e9, -1e9, -1e9};
  for (std::uint32_t v = 0; v < mesh.vertex_count(); ++v) {
    const Vec3 p = mesh.position(v);
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  std::vector<Box> boxes{{low, low}};
  while (boxes.size() < count) {
    const auto between = [&](double a, double b) {
      std::uniform_real_distribution<double> any(a, b);
      return std::minmax({any(random), any(random)});
    };
    const auto [x0, x1] = between(low.x, high.x);
    const auto [y0, y1] = between(low.y, high.y);
    const auto [z0, z1] = between(low.z, high.z);
    boxes.push_back({{x0, y0, z0}, {x1, y1, z1}});
  }
  return boxes;
}

// Follows a walk in many boxes at once, each of which gets a delta over a number of steps of its own, and has the view say
// whether what a client holds is what the box holds of the whole. A view has the type Part and
//   mesh, load(mesh), step(delta) -> change: the whole; step() applies the delta to the mesh
//   load_part(part, box), writer(part, box), follow_part(part, change of the whole, box) -> owned
//   expect_part(part, box), tets_set(owned): the tetrahedra of the elements that it sets
template <class View>
void follow_boxes(View view) {
  Walk walk(3, 2, 2);
  view.load(walk.model.replica());
  struct Follower {
    Box box;
    std::size_t every;
    typename View::Part server, client;
    std::optional<MeshChange> since;
  };
  std::vector<Follower> followers;
  for (const Box& box : random_boxes(view.mesh, 12, walk.random)) {
    Follower f{box, 1 + followers.size() % 5, {}, {}, {}};
    view.load_part(f.server, box);
    const ApplyResult result = send_snapshot(view.writer(f.server, box), f.client, std::uint64_t{0});
    ASSERT_TRUE(result) << result.text;
    view.expect_part(f.client, box);
    followers.push_back(std::move(f));
  }
  int moved_in = 0;
  for (std::size_t i = 0; i < 400; ++i) {
    // Deformations that a box's shell covers and such as it does not, with cuts between.
    const OwnedDelta delta = i % 37 == 36 ? walk.step() : i % 4 == 3 ? walk.cut() : walk.sway(1e-3);
    const MeshChange change = view.step(delta.view());
    for (Follower& f : followers) {
      if (f.since) {
        f.since->append(change);
      } else {
        f.since = change;
      }
      if ((i + 1) % f.every != 0) continue;
      const auto sent = view.follow_part(f.server, *f.since, f.box);
      const std::vector<std::uint32_t>& named = f.since->tets;
      for (const std::uint32_t tet : view.tets_set(sent))
        moved_in += std::find(named.begin(), named.end(), tet) == named.end();
      f.since.reset();
      Message kept;
      const ApplyResult result = f.client.apply(through_bytes(sent.view(), kept));
      ASSERT_TRUE(result) << result.text << " at step " << i;
      view.expect_part(f.client, f.box);
      ASSERT_EQ(f.client.canonical_bytes(), f.server.canonical_bytes());
      if (::testing::Test::HasFailure()) return;
    }
  }
  // Some that did not change came in because a vertex of theirs moved.
  EXPECT_GT(moved_in, 0);
}

}  // namespace incise::protocol
