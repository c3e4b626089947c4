#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/mesh/mesh_data.hpp"

namespace incise::core {

// What blades have left in a body beside its cuts (MeshData::cut_memory): where they have swept it, where these sweeps end, and which faces they had to
// hold. Cuts in a body that is saved with it and loaded again come out as in one session, but for what differs by the numbers of tetrahedra.

// `mesh` has been exported as `exported`; `strokes`: how many there were. Empty where no blade has left anything. O(mesh) otherwise.
std::vector<std::byte> save_cut_memory(const CutWorkspace& workspace, const TetMesh& mesh,
                                       std::uint32_t strokes, const MeshData& exported);

// Whether a mesh has memory, and its points and tetrahedra are those that this was saved with: in a body that was moved since, blades have swept
// elsewhere. O(mesh).
bool has_its_cut_memory(const MeshData& mesh);

// Into a workspace in which nothing was cut, of a mesh that has its memory; sets `strokes`. False, and nothing is changed, where the bytes are
// damaged.
bool restore_cut_memory(std::span<const std::byte> memory, const TetMesh& mesh, CutWorkspace& workspace,
                        std::uint32_t& strokes);

}  // namespace incise::core
