#pragma once

// Reads the fields of a verified message. Part of decode.cpp: it includes the generated header, so nothing else does.

#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/framing.hpp"
#include "protocol/incise_generated.h"

namespace incise::protocol {

template <class T>
using Vec = flatbuffers::Vector<T>;

// Reads the fields of one message and keeps the first thing that is wrong with them.
class FieldReader {
 public:
  explicit FieldReader(const char* message) : message_(message) {}

  bool ok() const { return error_.empty(); }
  const std::string& error() const { return error_; }

  void fail(const char* field, const std::string& what) {
    if (ok()) error_ = std::string(message_) + '.' + field + ": " + what;
  }
  void require(bool condition, const char* field, const char* what) {
    if (!condition) fail(field, what);
  }

  std::string text(const char* field, const flatbuffers::String* value, std::size_t limit = kMaxNameBytes) {
    if (value == nullptr) return {};
    if (value->size() > limit) {
      fail(field, std::to_string(value->size()) + " bytes, accepted are at most " + std::to_string(limit));
      return {};
    }
    return value->str();
  }

  // On a little-endian machine the elements lie there as they are. The verifier has checked that they lie within the
  // message; that they are aligned for their type it leaves to us.
  template <class T, class Element = T>
  std::span<const T> array(const char* field, const Vec<Element>* value) {
    if (value == nullptr || value->size() == 0) return {};
    if (reinterpret_cast<std::uintptr_t>(value->Data()) % alignof(T) != 0) {
      fail(field, "not aligned to " + std::to_string(alignof(T)) + " bytes");
      return {};
    }
    return {reinterpret_cast<const T*>(value->Data()), value->size()};
  }

  // An array that goes with `count` elements, `each` numbers to one.
  template <class T>
  std::span<const T> array(const char* field, const Vec<T>* value, std::size_t count, std::size_t each) {
    const std::span<const T> values = array<T>(field, value);
    if (values.size() != count * each) {
      fail(field, std::to_string(values.size()) + " entries where " + std::to_string(count) +
                      " elements have " + std::to_string(each) + " each");
    }
    return values;
  }

  // The same, or nothing at all.
  template <class T>
  std::span<const T> by_element(const char* field, const Vec<T>* value, std::size_t count, std::size_t each) {
    return value == nullptr || value->size() == 0 ? std::span<const T>() : array(field, value, count, each);
  }

  // Ids, strictly ascending and below `limit`.
  std::span<const std::uint32_t> ids(const char* field, const Vec<std::uint32_t>* value,
                                     std::uint32_t limit) {
    const std::span<const std::uint32_t> values = array<std::uint32_t>(field, value);
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (values[i] >= limit) {
        fail(field,
             "id " + std::to_string(values[i]) + ", accepted are those below " + std::to_string(limit));
        break;
      }
      if (i > 0 && values[i] <= values[i - 1]) {
        fail(field, "id " + std::to_string(values[i]) + " after " + std::to_string(values[i - 1]) +
                        ", accepted are ascending ids");
        break;
      }
    }
    return values;
  }

  template <class T>
  void coordinates(const char* field, std::span<const T> values) {
    for (const T x : values) {
      if (!(std::abs(static_cast<double>(x)) <= kMaxCoordinate)) {
        fail(field, std::to_string(x) + ", accepted are coordinates within +-1e6 m");
        return;
      }
    }
  }
  template <class T>
  std::span<const T> positions(const char* field, const Vec<T>* value, std::size_t vertices) {
    const auto values = array(field, value, vertices, 3);
    coordinates(field, values);
    return values;
  }

  double finite(const char* field, double value) {
    if (!std::isfinite(value)) fail(field, std::to_string(value) + ", accepted are finite numbers");
    return value;
  }
  float finite(const char* field, float value) {
    finite(field, static_cast<double>(value));
    return value;
  }

  Vec3 vector(const char* field, const wire::Vec3* value) {
    if (value == nullptr) return {};
    const Vec3 v{value->x(), value->y(), value->z()};
    const double numbers[] = {v.x, v.y, v.z};
    coordinates(field, std::span<const double>(numbers));
    return v;
  }

  template <class To, class From>
  To enumeration(const char* field, From value) {
    if (value > From::MAX) {
      fail(field, std::to_string(static_cast<unsigned>(value)) + ", accepted are 0 to " +
                      std::to_string(static_cast<unsigned>(From::MAX)));
    }
    return static_cast<To>(value);
  }

  std::optional<Box> box(const char* field, const wire::Box* value) {
    if (value == nullptr) return std::nullopt;
    const Box b{vector(field, value->min()), vector(field, value->max())};
    require(b.min.x <= b.max.x && b.min.y <= b.max.y && b.min.z <= b.max.z, field, "min above max");
    return b;
  }

  std::optional<BladeEdge> edge(const char* field, const wire::BladeEdge* value) {
    if (value == nullptr) return std::nullopt;
    const BladeEdge e{vector(field, value->heel()), vector(field, value->tip())};
    for (const Vec3& p : {e.heel, e.tip}) {
      require(std::abs(p.x) <= kMaxBladeCoordinate && std::abs(p.y) <= kMaxBladeCoordinate &&
                  std::abs(p.z) <= kMaxBladeCoordinate,
              field, "more than 10 km from the tool's origin");
    }
    require(e.heel != e.tip, field, "of no length");
    return e;
  }

  TetArrays tets(const wire::Tets* t) {
    if (t == nullptr) return {};
    TetArrays out;
    out.ids = ids("tets.ids", t->ids(), kMaxTets);
    const std::size_t n = out.ids.size();
    out.vertices = array("tets.vertices", t->vertices(), n, 4);
    out.regions = array("tets.regions", t->regions(), n, 1);
    out.cut_masks = array("tets.cut_masks", t->cut_masks(), n, 1);
    out.boundary_masks = array("tets.boundary_masks", t->boundary_masks(), n, 1);
    std::uint8_t bits = 0;
    for (const std::uint8_t m : out.cut_masks) bits |= m;
    for (const std::uint8_t m : out.boundary_masks) bits |= m;
    require(bits <= 15, "tets.*_masks", "a bit above 3 is set: there are four faces");
    return out;
  }

  TriangleArrays triangles(const wire::Triangles* t) {
    if (t == nullptr) return {};
    TriangleArrays out;
    out.ids = ids("triangles.ids", t->ids(), 4 * kMaxTets);
    const std::size_t n = out.ids.size();
    out.vertices = array("triangles.vertices", t->vertices(), n, 3);
    out.flags = array("triangles.flags", t->flags(), n, 1);
    out.pieces = array("triangles.pieces", t->pieces(), n, 1);
    out.regions = array("triangles.regions", t->regions(), n, 1);
    out.origins = by_element("triangles.origins", t->origins(), n, 1);
    return out;
  }

  SurfaceVertexArrays surface_vertices(const char* ids_field, const char* positions_field,
                                       const wire::SurfaceVertices* v) {
    if (v == nullptr) return {};
    SurfaceVertexArrays out;
    out.ids = ids(ids_field, v->ids(), kMaxVertices);
    out.positions = positions(positions_field, v->positions(), out.ids.size());
    return out;
  }

  std::vector<Step> steps(const flatbuffers::Vector<flatbuffers::Offset<wire::Step>>* values,
                          std::uint64_t base, std::uint64_t revision) {
    std::vector<Step> out;
    if (revision <= base) fail("revision", std::to_string(revision) + " from " + std::to_string(base));
    if (values == nullptr) return out;
    if (values->size() > kMaxStepsPerDelta) {
      fail("steps",
           std::to_string(values->size()) + ", accepted are at most " + std::to_string(kMaxStepsPerDelta));
      return out;
    }
    out.reserve(values->size());
    std::uint64_t last = base;
    for (const wire::Step* s : *values) {
      require(s->revision() > last && s->revision() <= revision, "steps.revision",
              "not rising, or outside of the delta's revisions");
      last = s->revision();
      Step step;
      step.revision = s->revision();
      step.source = s->source();
      step.stroke = s->stroke();
      step.batch = s->batch();
      step.stroke_ended = s->stroke_ended();
      step.from_heel = vector("steps.from_heel", s->from_heel());
      step.from_tip = vector("steps.from_tip", s->from_tip());
      step.to_heel = vector("steps.to_heel", s->to_heel());
      step.to_tip = vector("steps.to_tip", s->to_tip());
      step.from_source_ns = s->from_source_ns();
      step.to_source_ns = s->to_source_ns();
      step.arrival_ns = s->arrival_ns();
      step.drain_ns = s->drain_ns();
      step.cut_ns = s->cut_ns();
      step.cut_faces = s->cut_faces();
      step.cut_area_m2 = finite("steps.cut_area_m2", s->cut_area_m2());
      step.snaps = s->snaps();
      step.splits = s->splits();
      step.min_dihedral_deg = finite("steps.min_dihedral_deg", s->min_dihedral_deg());
      step.max_deviation_h = finite("steps.max_deviation_h", s->max_deviation_h());
      step.state_hash = s->state_hash();
      out.push_back(step);
    }
    return out;
  }

  std::vector<std::string> texts(const char* field,
                                 const Vec<flatbuffers::Offset<flatbuffers::String>>* values) {
    std::vector<std::string> out;
    if (values == nullptr) return out;
    require(values->size() <= kMaxFields, field, "above the limit of 256");
    if (!ok()) return out;
    for (const flatbuffers::String* value : *values) out.push_back(text(field, value));
    return out;
  }

  std::vector<FieldFacts> field_facts(const Vec<flatbuffers::Offset<wire::FieldFacts>>* values) {
    std::vector<FieldFacts> out;
    if (values == nullptr) return out;
    require(values->size() <= kMaxFields, "fields", "above the limit of 256");
    if (!ok()) return out;
    for (const wire::FieldFacts* f : *values) {
      out.push_back({text("fields.name", f->name()), enumeration<FieldOn>("fields.on", f->on()),
                     f->components(), f->whole()});
      require(f->components() >= 1 && f->components() <= kMaxFieldComponents, "fields.components",
              "accepted are 1 to 9");
    }
    return out;
  }

  std::optional<Restart> restart(const wire::Restart* value) {
    if (value == nullptr) return std::nullopt;
    const bool known = value->kind() <= wire::RestartKind::MAX;
    return Restart{known ? static_cast<RestartKind>(value->kind()) : RestartKind::None,
                   enumeration<Role>("restart.role", value->role()),
                   text("restart.by", value->by()),
                   value->source(),
                   text("restart.blade", value->blade()),
                   texts("restart.others", value->others())};
  }

  std::vector<BladeStats> blade_stats(const Vec<flatbuffers::Offset<wire::BladeStats>>* values) {
    std::vector<BladeStats> out;
    if (values == nullptr) return out;
    require(values->size() <= kMaxStatsBlades, "blades", "above the limit of 64");
    if (!ok()) return out;
    for (const wire::BladeStats* b : *values) {
      out.push_back({b->source(), text("blades.name", b->name()), b->poses(), b->rejected(), b->strokes(),
                     b->cut_faces(), b->in_stroke()});
    }
    return out;
  }

  float rate(const char* field, float hz) {
    finite(field, hz);
    require(hz >= 0, field, "accepted are numbers from 0");
    return hz;
  }

 private:
  const char* message_;
  std::string error_;
};

}  // namespace incise::protocol
