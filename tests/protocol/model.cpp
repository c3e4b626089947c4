#include "tests/protocol/model.hpp"

#include <algorithm>
#include <set>

#include "protocol/state_hash.hpp"

namespace incise::protocol {

std::uint64_t Model::hash() const {
  std::uint64_t hash = 0;
  for (std::uint32_t v = 0; v < positions.size(); ++v) {
    hash ^= vertex_hash(v, positions[v][0], positions[v][1], positions[v][2]);
  }
  for (const auto& [id, tet] : tets) hash ^= tet_hash(id, tet.vertices.data(), tet.region, tet.cut_mask);
  return hash;
}

void Model::find_pieces() {
  std::vector<std::uint32_t> part(positions.size());
  for (std::uint32_t v = 0; v < part.size(); ++v) part[v] = v;
  for (bool changed = true; changed;) {
    changed = false;
    for (const auto& [id, tet] : tets) {
      std::uint32_t least = kNoId;
      for (const std::uint32_t v : tet.vertices) least = std::min(least, part[v]);
      for (const std::uint32_t v : tet.vertices) {
        changed = changed || part[v] != least;
        part[v] = least;
      }
    }
  }
  std::map<std::uint32_t, std::uint32_t> piece_of;
  std::erase_if(names, [&](const auto& name) { return !tets.contains(name.second); });
  for (const auto& [piece, id] : names) piece_of[part[tets.at(id).vertices[0]]] = piece;
  for (auto& [id, tet] : tets) {
    const auto [entry, is_new] = piece_of.try_emplace(part[tet.vertices[0]], tet.piece);
    if (is_new) {
      if (names.contains(tet.piece)) entry->second = next_piece++;
      names[entry->second] = id;
    }
    tet.piece = entry->second;
  }
}

namespace {

void put_tet(OwnedDelta& d, std::uint32_t id, const Model::Tet& tet) {
  d.tet_ids.push_back(id);
  d.tet_vertices.insert(d.tet_vertices.end(), tet.vertices.begin(), tet.vertices.end());
  d.tet_regions.push_back(tet.region);
  d.tet_cut_masks.push_back(tet.cut_mask);
  d.tet_boundary_masks.push_back(tet.boundary_mask);
}

bool same_but_piece(Model::Tet a, const Model::Tet& b) {
  a.piece = b.piece;
  return a == b;
}

std::uint32_t pick(std::mt19937_64& random, std::size_t count) {
  return static_cast<std::uint32_t>(random() % count);
}

double coordinate(std::mt19937_64& random) {
  return static_cast<double>(random() % 2000001) / 1e6 - 1.0;
}

}  // namespace

OwnedDelta difference(const Model& a, const Model& b) {
  OwnedDelta d;
  d.base_revision = a.revision;
  d.revision = b.revision;
  for (std::uint64_t r = a.revision + 1; r <= b.revision; ++r) {
    Step step;
    step.revision = r;
    step.batch = static_cast<std::uint32_t>(r);
    d.steps.push_back(step);
  }
  for (std::uint32_t v = 0; v < a.positions.size(); ++v) {
    if (a.positions[v] == b.positions[v]) continue;
    d.moved_ids.push_back(v);
    d.moved_positions.insert(d.moved_positions.end(), b.positions[v].begin(), b.positions[v].end());
  }
  d.first_added = static_cast<std::uint32_t>(a.positions.size());
  for (std::uint32_t v = d.first_added; v < b.positions.size(); ++v) {
    d.added_positions.insert(d.added_positions.end(), b.positions[v].begin(), b.positions[v].end());
    const Model::Origin& origin = b.origins.at(v);
    d.provenance_a.push_back(origin.a);
    d.provenance_b.push_back(origin.b);
    d.provenance_t.push_back(origin.t);
  }
  d.first_new_tet = a.next_tet;
  std::set<std::uint32_t> ids;
  for (const auto& [id, tet] : a.tets) ids.insert(id);
  for (const auto& [id, tet] : b.tets) ids.insert(id);
  for (const std::uint32_t id : ids) {
    const auto before = a.tets.find(id), after = b.tets.find(id);
    const bool was = before != a.tets.end(), is = after != b.tets.end();
    if (is && (!was || !same_but_piece(before->second, after->second))) put_tet(d, id, after->second);
    if (was && !is) d.removed_tets.push_back(id);
    for (std::uint32_t f = 0; f < 4; ++f) {
      const bool face_was = was && (before->second.boundary_mask >> f & 1);
      const bool face_is = is && (after->second.boundary_mask >> f & 1);
      if (face_is && (!face_was || !same_but_piece(before->second, after->second))) {
        d.boundary_upserted.push_back(4 * id + f);
      }
      if (face_was && !face_is) d.boundary_removed.push_back(4 * id + f);
    }
  }
  for (const auto& [piece, name] : b.names) {
    const auto before = a.names.find(piece);
    if (piece == 0 || (before != a.names.end() && before->second == name)) continue;
    d.piece_ids.push_back(piece);
    d.piece_names.push_back(name);
    d.piece_sizes.push_back(static_cast<std::uint32_t>(std::count_if(
        b.tets.begin(), b.tets.end(), [id = piece](const auto& entry) { return entry.second.piece == id; })));
  }
  d.vertex_count = static_cast<std::uint32_t>(b.positions.size());
  d.live_tets = static_cast<std::uint32_t>(b.tets.size());
  d.state_hash = b.hash();
  return d;
}

Replica Model::replica() const {
  Model none;
  none.next_tet = 0;
  Model all = *this;
  all.revision = 1;
  for (std::uint32_t v = 0; v < positions.size(); ++v) all.origins[v] = {};
  const OwnedDelta d = difference(none, all);
  SnapshotBegin begin;
  begin.view = View::Volume;
  begin.revision = revision;
  begin.chunks = 1;
  begin.vertex_count = d.vertex_count;
  begin.tet_count = d.live_tets;
  begin.piece_ids = d.piece_ids;
  begin.piece_names = d.piece_names;
  SnapshotChunk chunk;
  chunk.positions = d.added_positions;
  chunk.tets = d.view().tets;
  Replica replica;
  EXPECT_TRUE(replica.begin(begin));
  EXPECT_TRUE(replica.chunk(chunk));
  const ApplyResult done = replica.end({revision, d.state_hash, 0});
  EXPECT_TRUE(done) << done.text;
  return replica;
}

Model box_model(std::uint32_t nx, std::uint32_t ny, std::uint32_t nz) {
  Model model;
  const auto vertex = [&](std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    return (z * (ny + 1) + y) * (nx + 1) + x;
  };
  for (std::uint32_t z = 0; z <= nz; ++z) {
    for (std::uint32_t y = 0; y <= ny; ++y) {
      for (std::uint32_t x = 0; x <= nx; ++x) model.positions.push_back({0.01 * x, 0.01 * y, 0.01 * z});
    }
  }
  // Six tetrahedra around the diagonal of each cube (Kuhn): one for each order of the three axes.
  constexpr int kOrders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  for (std::uint32_t z = 0; z < nz; ++z) {
    for (std::uint32_t y = 0; y < ny; ++y) {
      for (std::uint32_t x = 0; x < nx; ++x) {
        for (int o = 0; o < 6; ++o) {
          std::array<std::uint32_t, 3> at{x, y, z};
          Model::Tet tet;
          tet.vertices[0] = vertex(x, y, z);
          for (std::size_t k = 0; k < 3; ++k) {
            ++at[static_cast<std::size_t>(kOrders[o][k])];
            tet.vertices[k + 1] = vertex(at[0], at[1], at[2]);
          }
          if (o >= 3) std::swap(tet.vertices[2], tet.vertices[3]);
          tet.region = static_cast<std::int32_t>(z);
          model.tets[model.next_tet++] = tet;
        }
      }
    }
  }
  std::map<std::array<std::uint32_t, 3>, int> uses;
  const auto key = [](const Model::Tet& t, std::size_t f) {
    std::array<std::uint32_t, 3> k{t.vertices[kFaceVertices[f][0]], t.vertices[kFaceVertices[f][1]],
                                   t.vertices[kFaceVertices[f][2]]};
    std::sort(k.begin(), k.end());
    return k;
  };
  for (const auto& [id, tet] : model.tets) {
    for (std::size_t f = 0; f < 4; ++f) ++uses[key(tet, f)];
  }
  for (auto& [id, tet] : model.tets) {
    for (std::size_t f = 0; f < 4; ++f) {
      if (uses[key(tet, f)] == 1) tet.boundary_mask = static_cast<std::uint8_t>(tet.boundary_mask | 1u << f);
    }
  }
  return model;
}

void mutate(Model& model, std::mt19937_64& random) {
  ++model.revision;
  for (std::uint32_t n = pick(random, 4); n > 0; --n) {
    model.positions[pick(random, model.positions.size())] = {coordinate(random), coordinate(random),
                                                             coordinate(random)};
  }
  for (std::uint32_t n = pick(random, 4); n > 0; --n) {
    const auto count = model.positions.size();
    model.origins[static_cast<std::uint32_t>(count)] = {pick(random, count), pick(random, count),
                                                        static_cast<double>(pick(random, 1025)) / 1024};
    model.positions.push_back({coordinate(random), coordinate(random), coordinate(random)});
  }
  const auto some_tet = [&] { return std::next(model.tets.begin(), pick(random, model.tets.size())); };
  // Pieces never grow together, so a tetrahedron takes vertices of its own piece, or such as none has.
  std::vector<std::uint32_t> piece_at(model.positions.size(), kNoId);
  for (const auto& [id, tet] : model.tets) {
    for (const std::uint32_t v : tet.vertices) piece_at[v] = tet.piece;
  }
  const auto randomise = [&](Model::Tet& tet) {
    std::set<std::uint32_t> vertices;
    while (vertices.size() < 4) {
      const std::uint32_t v = pick(random, model.positions.size());
      if (piece_at[v] == kNoId || piece_at[v] == tet.piece) vertices.insert(v);
    }
    for (const std::uint32_t v : vertices) piece_at[v] = tet.piece;
    std::copy(vertices.begin(), vertices.end(), tet.vertices.begin());
    std::shuffle(tet.vertices.begin(), tet.vertices.end(), random);
    tet.boundary_mask = static_cast<std::uint8_t>(random() & 15);
    tet.cut_mask = static_cast<std::uint8_t>(tet.boundary_mask & random() & 15);
  };
  for (std::uint32_t n = pick(random, 5); n > 0 && !model.tets.empty(); --n) randomise(some_tet()->second);
  for (std::uint32_t n = pick(random, 4); n > 0; --n) {
    Model::Tet tet;
    tet.piece = some_tet()->second.piece;
    randomise(tet);
    tet.region = static_cast<std::int32_t>(pick(random, 7)) - 3;
    model.next_tet += pick(random, 3);  // ids of tetrahedra that came and went within the step
    model.tets[model.next_tet++] = tet;
  }
  for (std::uint32_t n = pick(random, 3); n > 0 && model.tets.size() > 4; --n) model.tets.erase(some_tet());
  if (pick(random, 4) == 0) {
    // One comes off, alone.
    for (std::uint32_t& v : some_tet()->second.vertices) {
      const auto copy = static_cast<std::uint32_t>(model.positions.size());
      model.origins[copy] = {v, v, 0};
      model.positions.push_back(model.positions[v]);
      v = copy;
    }
  }
  model.find_pieces();
}

::testing::AssertionResult holds(const Replica& replica, const Model& model) {
  const auto fail = [](const auto&... parts) {
    auto result = ::testing::AssertionFailure();
    ((result << parts << ' '), ...);
    return result;
  };
  if (replica.revision() != model.revision) return fail("revision", replica.revision(), model.revision);
  if (replica.vertex_count() != model.positions.size()) return fail("vertices", replica.vertex_count());
  if (replica.live_tets() != model.tets.size())
    return fail("tetrahedra", replica.live_tets(), model.tets.size());
  for (std::uint32_t v = 0; v < model.positions.size(); ++v) {
    const Vec3 p = replica.position(v);
    if (std::array{p.x, p.y, p.z} != model.positions[v]) return fail("vertex", v);
  }
  std::uint32_t faces = 0;
  for (const auto& [id, tet] : model.tets) {
    if (!replica.alive(id)) return fail("tetrahedron", id, "is missing");
    const Model::Tet held{replica.vertices(id), replica.region(id), replica.cut_mask(id),
                          replica.boundary_mask(id), replica.piece(id)};
    if (held != tet) return fail("tetrahedron", id, "differs");
    faces += static_cast<std::uint32_t>(std::popcount(tet.boundary_mask));
  }
  if (replica.boundary_faces() != faces) return fail("boundary faces", replica.boundary_faces(), faces);
  if (replica.state_hash() != model.hash()) return fail("state hash");
  return ::testing::AssertionSuccess();
}

}  // namespace incise::protocol
