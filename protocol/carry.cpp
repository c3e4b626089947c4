#include "protocol/carry.hpp"

namespace incise::protocol {

bool BlendRounds::next() {
  const std::size_t rounds = delta_.round_blends.empty() ? 1 : delta_.round_blends.size();
  if (round_ == rounds) return false;
  first_blend_ += blends_;
  first_added_ += added_;
  const bool one = delta_.round_blends.empty();
  blends_ = one ? delta_.blend_ids.size() : delta_.round_blends[round_];
  added_ = one ? delta_.provenance_t.size() : delta_.round_added[round_];
  ++round_;
  return true;
}

std::string elders_error(const Delta& d, std::size_t slots) {
  const std::size_t n = d.tet_elders.size();
  if (n > d.tets.ids.size()) return "more elders than tetrahedra";
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t id = d.tets.ids[d.tets.ids.size() - n + i];
    if (id < slots || (i > 0 && id <= d.tets.ids[d.tets.ids.size() - n + i - 1]) || d.tet_elders[i] >= slots)
      return "new tetrahedron " + std::to_string(id) + " in the place of " + std::to_string(d.tet_elders[i]) +
             ", ids run below " + std::to_string(slots);
  }
  return {};
}

std::string provenance_error(const Delta& d, std::size_t vertices) {
  const std::size_t added = d.provenance_t.size(), blends = d.blend_ids.size();
  if (d.provenance_a.size() != added || d.provenance_b.size() != added ||
      d.blend_vertices.size() != 4 * blends || d.blend_weights.size() != 4 * blends ||
      d.round_added.size() != d.round_blends.size()) {
    return "provenance or blends of different lengths";
  }
  if (!d.round_blends.empty()) {
    std::size_t listed_added = 0, listed_blends = 0;
    for (const std::uint32_t n : d.round_added) listed_added += n;
    for (const std::uint32_t n : d.round_blends) listed_blends += n;
    if (listed_added != added || listed_blends != blends) {
      return "rounds with " + std::to_string(listed_blends) + " blends and " + std::to_string(listed_added) +
             " added vertices, the delta has " + std::to_string(blends) + " and " + std::to_string(added);
    }
  }
  // Made from an older vertex, or from one added earlier in this delta.
  for (std::size_t i = 0; i < added; ++i) {
    if (d.provenance_a[i] < vertices + i && d.provenance_b[i] < vertices + i) continue;
    return "vertex " + std::to_string(vertices + i) + " made of " + std::to_string(d.provenance_a[i]) +
           " and " + std::to_string(d.provenance_b[i]);
  }
  for (BlendRounds round(d); round.next();) {
    const std::size_t before = vertices + round.first_added();
    for (std::size_t i = round.first_blend(); i < round.first_blend() + round.blends(); ++i) {
      const std::uint32_t v = d.blend_ids[i];
      if (v >= before + round.added() || (i > round.first_blend() && v <= d.blend_ids[i - 1]))
        return "blend of vertex " + std::to_string(v) + ", which does not exist or is not in order";
      for (const std::uint32_t from : d.blend_vertices.subspan(4 * i, 4)) {
        if (from >= before)
          return "vertex " + std::to_string(v) + " blended of " + std::to_string(from) +
                 ", which was not there before its round";
      }
    }
  }
  return {};
}

}  // namespace incise::protocol
