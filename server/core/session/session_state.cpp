#include "server/core/session/session_state.hpp"

#include <array>
#include <cmath>
#include <cstring>
#include <type_traits>

#include "server/base/check.hpp"
#include "server/core/cut/conforming/conforming_cutter.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

// The same fields() writes and reads: a Writer takes each field's value, a Reader sets it.

class Writer {
 public:
  static constexpr bool kReads = false;

  template <class T>
  requires(std::is_arithmetic_v<T> || std::is_enum_v<T>) void operator()(const T& value) {
    const auto* bytes = reinterpret_cast<const std::byte*>(&value);
    bytes_.insert(bytes_.end(), bytes, bytes + sizeof value);
  }
  // The count, then each element by `field`.
  template <class T, class Field>
  void list(const std::vector<T>& values, std::size_t /*least_bytes*/, Field field) {
    (*this)(static_cast<std::uint64_t>(values.size()));
    for (const T& value : values) field(value);
  }
  void demand(bool, const char*) {}

  std::vector<std::byte> take() { return std::move(bytes_); }

 private:
  std::vector<std::byte> bytes_;
};

class Reader {
 public:
  static constexpr bool kReads = true;

  explicit Reader(std::span<const std::byte> bytes) : bytes_(bytes) {}

  template <class T>
  requires(std::is_arithmetic_v<T> || std::is_enum_v<T>) void operator()(T& value) {
    if (bytes_.size() < sizeof value) {
      demand(false, "it ends too early");
      value = {};
      return;
    }
    std::memcpy(&value, bytes_.data(), sizeof value);
    bytes_ = bytes_.subspan(sizeof value);
  }
  void operator()(bool& value) {
    std::uint8_t byte = 0;
    (*this)(byte);
    demand(byte <= 1, "a flag is neither 0 nor 1");
    value = byte == 1;
  }
  template <class T, class Field>
  void list(std::vector<T>& values, std::size_t least_bytes, Field field) {
    std::uint64_t count = 0;
    (*this)(count);
    demand(count <= bytes_.size() / least_bytes, "a list is longer than what is left");
    if (failed()) return;
    values.clear();
    values.reserve(count + count / 4 + 64);
    values.resize(count);
    for (T& value : values) field(value);
  }
  // The first demand that is not met is the error.
  void demand(bool met, const char* otherwise) {
    if (!met && error_.empty()) error_ = otherwise;
  }
  bool failed() const { return !error_.empty(); }
  const std::string& error() const { return error_; }
  bool at_end() const { return bytes_.empty(); }

 private:
  std::span<const std::byte> bytes_;
  std::string error_;
};

template <class Io, class V>
requires std::is_same_v<std::remove_const_t<V>, Vec3>
void fields(Io& io, V& v) {
  io(v.x);
  io(v.y);
  io(v.z);
  io.demand(is_finite(v), "a coordinate is not finite");
}

template <class Io, class L>
requires std::is_same_v<std::remove_const_t<L>, BladeLine> || std::is_same_v<std::remove_const_t<L>, Blade>
void fields(Io& io, L& line) {
  fields(io, line.heel);
  fields(io, line.tip);
}

// Room to grow, as a fresh session has it.
template <class T>
void grow_to(std::vector<T>& values, std::size_t count) {
  values.reserve(room_for(count));
  values.resize(count, T{});
}

}  // namespace

// The members of each class that later revisions depend on. What is absent is scratch, a stamp that is only compared
// with serial numbers still to come, or follows from the rest.
struct SessionFields {
  template <class Io, class Mesh>
  static void mesh(Io& io, Mesh& m) {
    io(m.mean_edge_length_);
    io(m.initial_vertex_copies_);
    io(m.has_regions_);
    io(m.cut_sides_);
    io(m.hash_);
    // Which tetrahedron a vertex names is part of the state: stars are walked from there, and ids follow from the walk.
    io.list(m.vertices_, 32, [&](auto& v) {
      fields(io, v.position);
      io(v.tet);
      io(v.h);
    });
    io.list(m.rest_, 24, [&](auto& rest) { fields(io, rest); });
    io.list(m.tets_, 32, [&](auto& t) {
      for (auto& v : t.vertices) io(v);
      for (auto& o : t.opposite) io(o);
    });
    io.list(m.attributes_, 9, [&](auto& a) {
      io(a.region);
      io(a.piece);
      io(a.cut_mask);
    });
    if constexpr (Io::kReads) restore(io, m);
  }

  static void restore(Reader& io, TetMesh& m) {
    io.demand(m.tets_.size() < kNone / 16 && m.vertices_.size() < kNone / 2, "the mesh is too large");
    io.demand(m.attributes_.size() == m.tets_.size(), "attributes and tetrahedra differ in number");
    io.demand(m.rest_.empty() || m.rest_.size() == m.vertices_.size(),
              "rest positions and vertices differ in number");
    io.demand(m.mean_edge_length_ > 0 && std::isfinite(m.mean_edge_length_), "h is not positive");
    if (io.failed()) return;
    m.live_tets_ = 0;
    for (const TetMesh::Tet& t : m.tets_) {
      if (t.vertices[0] == kNone) continue;
      ++m.live_tets_;
      for (VertexId v : t.vertices) io.demand(v < m.vertex_slots(), "a tetrahedron names no vertex");
      for (HalfFace o : t.opposite) {
        io.demand(o == kNone || (tet_of(o) < m.tet_slots() && m.alive(tet_of(o))), "a neighbour is none");
      }
    }
    if (io.failed()) return;
    for (VertexId v = 0; v < m.vertex_slots(); ++v) {
      const TetId t = m.vertex_tet(v);
      io.demand(t == kNone || (t < m.tet_slots() && m.alive(t) && m.local_index(t, v) >= 0),
                "a vertex names a tetrahedron that has it not");
      io.demand(m.vertices_[v].h >= 0 && std::isfinite(m.vertices_[v].h), "a local width is no length");
    }
    grow_to(m.vertices_, m.vertices_.size());
    if (m.deformed()) grow_to(m.rest_, m.rest_.size());
    grow_to(m.tets_, m.tets_.size());
    grow_to(m.attributes_, m.tets_.size());
    grow_to(m.vertex_mark_, m.vertices_.size());
    grow_to(m.record_, m.tets_.size());
    grow_to(m.tet_mark_, m.tets_.size());
    m.begin_step();
    if (io.failed()) return;
    const std::string problem = validate(m, false);
    io.demand(problem.empty(), problem.c_str());
  }

  template <class Io, class Pieces>
  static void pieces(Io& io, Pieces& p, const TetMesh& m) {
    io(p.next_piece_);
    std::vector<std::uint32_t> clusters;
    if constexpr (!Io::kReads) clusters = p.list_clusters();
    io.list(clusters, 4, [&](auto& entry) { io(entry); });
    if constexpr (Io::kReads) {
      io.demand(p.next_piece_ >= 1 && p.next_piece_ <= m.tet_slots() + 1, "more pieces than tetrahedra");
      for (TetId t = 0; t < m.tet_slots() && !io.failed(); ++t) {
        io.demand(m.piece(t) < p.next_piece_, "a tetrahedron is in a piece that never was");
      }
      if (io.failed()) return;
      p.piece_tets_.assign(p.next_piece_, 0);
      for (TetId t = 0; t < m.tet_slots(); ++t) {
        if (m.alive(t)) ++p.piece_tets_[m.piece(t)];
      }
      io.demand(p.restore_clusters(clusters), "clusters that are not the tetrahedra, each once");
      grow_to(p.cluster_of_, m.tet_slots());
      grow_to(p.next_member_, m.tet_slots());
    }
  }

  // Lists in the grid keep their order: the search meets tetrahedra in it, and ids follow.
  template <class Io, class Grid>
  static void grid(Io& io, Grid& g, const TetMesh& m) {
    fields(io, g.origin_);
    fields(io, g.low_);
    fields(io, g.high_);
    io(g.cell_);
    io(g.inverse_);
    io(g.slack_);
    for (auto& n : g.count_) io(n);
    io.list(g.head_, 4, [&](auto& head) { io(head); });
    io.list(g.nodes_, 8, [&](auto& node) {
      io(node.tet);
      io(node.next);
    });
    auto when_built = static_cast<std::uint64_t>(g.nodes_when_built_);
    io(when_built);
    io.list(g.anchors_, 24, [&](auto& anchor) { fields(io, anchor); });
    if constexpr (Io::kReads) {
      g.nodes_when_built_ = when_built;
      io.demand(when_built <= g.nodes_.size(), "a grid that has shrunk");
      io.demand(g.slack_ >= 0.25 && g.slack_ <= 1, "a grid with another slack");
      io.demand(g.anchors_.size() <= m.vertex_slots(), "more anchors than vertices");
      std::uint64_t cells = 1;
      for (const std::int64_t n : g.count_) {
        io.demand(n > 0 && n <= (1 << 25), "a grid without cells");
        if (!io.failed()) cells *= static_cast<std::uint64_t>(n);
        io.demand(cells <= g.head_.size(), "a grid of other cells");
        if (io.failed()) return;
      }
      io.demand(cells == g.head_.size(), "a grid of other cells");
      io.demand(g.cell_ > 0 && std::isfinite(g.cell_) && g.inverse_ == 1 / g.cell_,
                "grid cells without a size");
      for (const std::uint32_t head : g.head_)
        io.demand(head == kNone || head < g.nodes_.size(), "a grid cell lists nothing");
      // A list leads to ever older nodes: none goes in a circle.
      for (std::size_t i = 0; i < g.nodes_.size(); ++i) {
        io.demand(g.nodes_[i].tet < m.tet_slots(), "the grid names no tetrahedron");
        io.demand(g.nodes_[i].next == kNone || g.nodes_[i].next < i, "a grid list goes in a circle");
      }
      g.nodes_.reserve(room_for(g.nodes_.size()));
      g.taken_.assign(g.head_.size(), 0);
    }
  }

  template <class Io, class Workspace>
  static void workspace(Io& io, Workspace& w, const TetMesh& m) {
    grid(io, w.grid, m);
    io.list(w.vertices, 16, [&](auto& marks) {
      io(marks.surface);
      io(marks.batch);
      io(marks.failed);
      io(marks.rim);
    });
    io.list(w.tets, 4, [&](auto& marks) { io(marks.active); });
    if constexpr (Io::kReads) {
      io.demand(w.vertices.size() == m.vertex_slots() && w.tets.size() == m.tet_slots(),
                "stamps and mesh differ in size");
      if (io.failed()) return;
      grow_to(w.vertices, m.vertex_slots());
      grow_to(w.tets, m.tet_slots());
    }
  }

  template <class Io, class Mover>
  static void mover(Io& io, Mover& mover, const TetMesh& m) {
    io.list(mover.known_since_, 8, [&](auto& revision) { io(revision); });
    if constexpr (Io::kReads) {
      io.demand(mover.known_since_.size() == m.vertex_slots(), "revisions and vertices differ in number");
      if (!io.failed()) grow_to(mover.known_since_, m.vertex_slots());
    }
  }

  template <class Io, class Builder>
  static void builder(Io& io, Builder& b) {
    io(b.has_pose_);
    io(b.in_stroke_);
    io(b.stroke_);
    io(b.batch_);
    io(b.last_pose_.t_ns);
    fields(io, b.last_pose_.position);
    for (auto* q : {&b.last_pose_.orientation.w, &b.last_pose_.orientation.x, &b.last_pose_.orientation.y,
                    &b.last_pose_.orientation.z}) {
      io(*q);
      io.demand(std::isfinite(*q), "a quaternion is not finite");
    }
    io(b.last_pose_.buttons);
    io.list(b.buffer_, 56, [&](auto& line) {
      fields(io, line.line);
      io(line.t_ns);
    });
    io.demand(!b.in_stroke_ || !b.buffer_.empty(), "a stroke without a line");
    io.demand(b.buffer_.size() <= (1u << 20), "more lines than a stroke keeps");
    if constexpr (Io::kReads) b.buffer_.reserve(1024);
  }

  // Between two batches; after the last one of a stroke all of it is left over and means nothing.
  template <class Io, class ConformingCutter>
  static void cutter(Io& io, ConformingCutter& c, const TetMesh& m) {
    io(c.stroke_);
    io(c.batch_);
    fields(io, c.heading_);
    io.list(c.surface_.triangles_, 253, [&](auto& t) {
      for (auto& corner : t.corners) fields(io, corner);
      fields(io, t.normal);
      io(t.offset);
      fields(io, t.low);
      fields(io, t.high);
      for (auto& inward : t.inward) fields(io, inward);
      for (auto& offset : t.inward_offset) io(offset);
      io(t.batch);
      io(t.rim);
    });
    io.list(c.active_, 20, [&](auto& a) {
      io(a.tet);
      io(a.since);
      io(a.ripe_at);
      io.demand(a.since >= 0, "active since before its stroke");
      io.demand(a.tet < m.tet_slots(), "an active tetrahedron never was");
    });
    io(c.travel_);
    io(c.widest_);
    io.demand(c.travel_ >= 0 && c.widest_ >= 0, "a way or a width below 0");
    io.list(c.swept_, 12, [&](auto& s) {
      io(s.batch);
      io(s.travel);
    });
    io.list(c.retraced_, 48, [&](auto& line) { fields(io, line); });
    io.demand(c.retraced_.size() <= ConformingCutter::kMostRetraced, "more lines than a blade retraces");
    io.list(c.events_, 36, [&](auto& e) {
      io(e.nearness);
      io(e.at);
      io(e.a);
      io(e.b);
      io(e.tet);
      io(e.triangle);
      io(e.batch);
      io.demand(e.a < m.vertex_slots() && e.b < m.vertex_slots() && e.tet < m.tet_slots(),
                "a crossing of no edge");
      // A crossing of an earlier batch is looked for anew; one that says it is of the next would not be.
      io.demand(e.batch <= c.batch_, "a crossing of a batch to come");
      io.demand(e.nearness == e.nearness && e.at >= 0 && e.at <= 1, "a crossing beyond its edge");
    });
    io.list(c.rim_events_, 89, [&](auto& e) {
      io(e.tet);
      for (auto& v : e.face) io(v);
      fields(io, e.point);
      fields(io, e.from);
      fields(io, e.to);
      io(e.again);
      io.demand(e.tet < m.tet_slots(), "a rim through no tetrahedron");
      for (auto& v : e.face) io.demand(v < m.vertex_slots(), "a rim through no face");
    });
    if constexpr (Io::kReads) {
      for (auto& e : c.events_) e.done = false;
      for (auto& e : c.rim_events_) e.done = false;
      if (!io.failed()) c.surface_.build();
    }
  }

  // What of a source there is before it is used.
  template <class Io>
  static bool source_exists(Io& io, bool exists) {
    io(exists);
    return exists;
  }

  template <class Io, class Session>
  static void session(Io& io, Session& s) {
    std::uint32_t version = kSessionStateVersion;
    io(version);
    io.demand(version == kSessionStateVersion, "it is of another version");
    auto policy = static_cast<std::uint8_t>(s.config_.policy);
    io(policy);
    io.demand(policy == static_cast<std::uint8_t>(s.config_.policy), "it is of another policy");
    if constexpr (Io::kReads) {
      if (io.failed()) return;
    }
    io(s.revision_);
    io(s.stroke_counter_);
    mesh(io, s.mesh_);
    if constexpr (Io::kReads) {
      if (io.failed()) return;
    }
    pieces(io, s.pieces_, s.mesh_);
    workspace(io, s.workspace_, s.mesh_);
    mover(io, s.mover_, s.mesh_);
    for (std::uint32_t number = 0; number < kMaxSources; ++number) {
      if (!source_exists(io, s.sources_[number] != nullptr)) continue;
      Blade blade;
      if constexpr (!Io::kReads) blade = s.sources_[number]->builder.config_.blade;
      fields(io, blade);
      if constexpr (Io::kReads) {
        if (io.failed()) return;
        s.set_blade(number, blade);
      }
      auto& source = *s.sources_[number];
      builder(io, source.builder);
      io.demand(source.builder.stroke_ <= s.stroke_counter_, "a stroke that is not counted");
      if (s.config_.policy != Policy::kConforming) continue;
      using Conforming =
          std::conditional_t<std::is_const_v<Session>, const ConformingCutter, ConformingCutter>;
      auto& conforming = static_cast<Conforming&>(*source.cutter);
      cutter(io, conforming, s.mesh_);
      io.demand(conforming.stroke_ <= s.stroke_counter_, "a stroke that is not counted");
      io.demand(conforming.stroke_ != source.builder.stroke_ || conforming.batch_ == source.builder.batch_,
                "batches that were not cut");
    }
  }
};

std::vector<std::byte> save_session(const CutSession& session) {
  INCISE_CHECK(session.backlog_batches() == 0, session.backlog_batches());
  Writer out;
  SessionFields::session(out, session);
  return out.take();
}

std::unique_ptr<CutSession> restore_session(std::span<const std::byte> bytes, const CutConfig& config,
                                            std::string& error) {
  auto session = std::make_unique<CutSession>(MeshData{}, config);
  Reader in(bytes);
  SessionFields::session(in, *session);
  in.demand(in.at_end(), "something follows its end");
  error = in.error();
  return in.failed() ? nullptr : std::move(session);
}

}  // namespace incise::core
