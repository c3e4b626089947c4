#include "server/mesh_io/tet_collector.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_files.hpp"

namespace incise::mesh_io {

void TetCollector::add_node(std::int64_t number, const core::Vec3& position) {
  const std::size_t index = mesh_.positions.size();
  if (index == kMaxTets) in_.fail("more than " + std::to_string(kMaxTets) + " nodes");
  if (index == 0) first_ = number;
  // Unsigned, so that a hostile file cannot cause overflow.
  if (dense_ && static_cast<std::uint64_t>(number) - static_cast<std::uint64_t>(first_) != index) {
    dense_ = false;
    for (std::size_t i = 0; i < index; ++i) numbers_.push_back(first_ + static_cast<std::int64_t>(i));
  }
  if (!dense_) numbers_.push_back(number);
  mesh_.positions.push_back(position);
}

core::Vec3 TetCollector::read_position() {
  core::Vec3 p;
  p.x = in_.value<double>("the coordinate x");
  p.y = in_.value<double>("the coordinate y");
  p.z = in_.value<double>("the coordinate z");
  if (!core::is_finite(p)) in_.fail("a coordinate is not finite");
  return p;
}

void TetCollector::end_nodes() {
  if (dense_) return;
  sorted_.clear();
  sorted_.reserve(numbers_.size());
  for (std::size_t i = 0; i < numbers_.size(); ++i) {
    sorted_.emplace_back(numbers_[i], static_cast<core::VertexId>(i));
  }
  std::sort(sorted_.begin(), sorted_.end());
  for (std::size_t i = 1; i < sorted_.size(); ++i) {
    if (sorted_[i].first == sorted_[i - 1].first) {
      in_.fail("there are two nodes with the number " + std::to_string(sorted_[i].first));
    }
  }
}

core::VertexId TetCollector::vertex(std::int64_t number) const {
  if (dense_) {
    const auto index = static_cast<std::uint64_t>(number) - static_cast<std::uint64_t>(first_);
    if (index < mesh_.positions.size()) return static_cast<core::VertexId>(index);
  } else {
    const auto found = std::lower_bound(sorted_.begin(), sorted_.end(), std::pair{number, core::VertexId{0}});
    if (found != sorted_.end() && found->first == number) return found->second;
  }
  in_.fail("the node " + std::to_string(number) + " does not exist; there are " +
           std::to_string(mesh_.positions.size()) +
           (mesh_.positions.empty() ? "" : ", the first is " + std::to_string(first_)));
}

std::int32_t TetCollector::checked_region(std::int64_t region) const {
  if (region < std::numeric_limits<std::int32_t>::min() ||
      region > std::numeric_limits<std::int32_t>::max()) {
    in_.fail("the region " + std::to_string(region) +
             " is out of range; accepted are -2147483648 to 2147483647");
  }
  return static_cast<std::int32_t>(region);
}

void TetCollector::add_tet(const std::array<core::VertexId, 4>& corners, std::int64_t region) {
  if (mesh_.tets.size() == kMaxTets) in_.fail("more than " + std::to_string(kMaxTets) + " tetrahedra");
  mesh_.tets.push_back(corners);
  mesh_.regions.push_back(checked_region(region));
}

void TetCollector::note_cut_faces(double mask) {
  misread_cut_faces_ = misread_cut_faces_ || !(mask >= 0 && mask <= 15 && mask == std::floor(mask));
  mesh_.cut_masks.resize(mesh_.tets.size());
  if (!misread_cut_faces_) mesh_.cut_masks.back() = static_cast<std::uint8_t>(mask);
}

void TetCollector::note_cut_memory(std::span<const double> bytes) {
  mesh_.cut_memory.clear();
  for (const double byte : bytes) {
    mesh_.cut_memory.push_back(byte >= 0 && byte <= 255 ? static_cast<std::byte>(byte) : std::byte{});
  }
}

core::MeshData TetCollector::finish(std::vector<std::string>& warnings, std::string_view skipped) {
  if (mesh_.tets.empty()) {
    throw MeshError(in_.file_name() + ": there is no tetrahedron in it" + std::string(skipped) +
                    "; a closed surface is filled if it comes as .stl, .ply, .off, .obj or .glb");
  }
  if (higher_order_ > 0) {
    warnings.push_back(in_.file_name() + ": " + std::to_string(higher_order_) +
                       " tetrahedra of higher order: the corners are kept, the edges become straight");
  }
  if (misread_cut_faces_) {
    warnings.push_back(in_.file_name() + ": the array '" + std::string(kCutMask) +
                       "' has other numbers than 0 to 15: older cuts are taken for the body's boundary");
  }
  if (misread_cut_faces_ || std::ranges::all_of(mesh_.cut_masks, [](std::uint8_t mask) { return mask == 0; }))
    mesh_.cut_masks.clear();
  // The last piece of a file may have none.
  if (!mesh_.cut_masks.empty()) mesh_.cut_masks.resize(mesh_.tets.size());
  if (std::all_of(mesh_.regions.begin(), mesh_.regions.end(), [](std::int32_t r) { return r == 0; })) {
    mesh_.regions.clear();
  }
  return std::move(mesh_);
}

}  // namespace incise::mesh_io
