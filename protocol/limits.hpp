#pragma once

// How long anything in the protocol, the capture and a motion file may be. A reader checks these before it
// allocates. PROTOCOL.md, "Limits", repeats those that a peer must keep.

#include <cstddef>
#include <cstdint>

namespace incise::protocol {

// The largest message in either direction: a snapshot chunk or the delta of a very large batch. A browser allocates
// room for a whole message at once, so the limit is low.
inline constexpr std::size_t kMaxMessageBytes = 64u << 20;
// What a peer may send before Welcome: many times a Hello with a token and a name, but not a
// flood.
inline constexpr std::size_t kMaxHandshakeBytes = 16u << 10;
// What a viewer, operator or admin may send: the largest pose batch, rounded up.
inline constexpr std::size_t kMaxClientBytes = 1u << 20;
// What a simulator may send: positions of kMaxPositionsVertices as doubles with ids, rounded up.
inline constexpr std::size_t kMaxSimulatorBytes = 64u << 20;
// No message is shorter: root offset, identifier, and a table with a body.
inline constexpr std::size_t kMinMessageBytes = 16;

// Poses in one batch: over a second of an 8 kHz device; at 72 bytes each well under kMaxClientBytes.
inline constexpr std::size_t kMaxPosesPerBatch = 8192;
// Names, versions, hashes and cause texts.
inline constexpr std::size_t kMaxNameBytes = 256;
inline constexpr std::size_t kMaxTokenBytes = 1024;
inline constexpr std::size_t kMaxTextBytes = 4096;
// Statistics as JSON: histograms of every stage and session.
inline constexpr std::size_t kMaxStatsJsonBytes = 1u << 20;

// Blades in statistics: far more than one server has.
inline constexpr std::size_t kMaxStatsBlades = 64;

// Steps in one coalesced delta; beyond that a snapshot is the shorter way to say it.
inline constexpr std::size_t kMaxStepsPerDelta = 4096;
// Vertices and tetrahedra of one mesh: half-faces are 4 * tetrahedron + face in 32 bits, kNone excluded.
inline constexpr std::uint32_t kMaxTets = 0x3fffffffu;
inline constexpr std::uint32_t kMaxVertices = 0x3fffffffu;
// Entries of any one array in one message: what kMaxMessageBytes could hold of the smallest element, so this
// bounds a product before it is computed.
inline constexpr std::size_t kMaxArrayEntries = kMaxMessageBytes;
// Chunks in one snapshot. 65,536 of the default size are far beyond kMaxTets.
inline constexpr std::uint32_t kMaxSnapshotChunks = 65536;
// Elements (vertices, tetrahedra or triangles) that the encoder puts into one chunk: about 1 MB, so that a
// slow line shows progress and a delta waits behind one chunk at most a short while.
inline constexpr std::size_t kChunkElements = 32768;
// 2 million vertices x (24 + 4) bytes stay under kMaxSimulatorBytes.
inline constexpr std::size_t kMaxPositionsVertices = 2u << 20;

// What a replica allocates by default. Ids may have gaps (tetrahedra that came and went between two messages), so one
// small message could ask for any amount. 32 million slots of 26 bytes are a 5M mesh with every tetrahedron replaced six
// times.
inline constexpr std::uint32_t kDefaultReplicaTets = 32u << 20;
inline constexpr std::uint32_t kDefaultReplicaVertices = 16u << 20;

// Fields of a body, and numbers of each for a vertex or tetrahedron.
inline constexpr std::uint32_t kMaxFields = 256;
inline constexpr std::uint32_t kMaxFieldComponents = 9;

// Materials of a surface asset.
inline constexpr std::size_t kMaxMaterials = 4096;

// Nesting: Message -> Delta -> Step or Tets. FlatBuffers' verifier counts tables and vectors as levels.
inline constexpr unsigned kMaxDepth = 8;
inline constexpr unsigned kMaxTables = kMaxStepsPerDelta + 64;

// Of a blade's heel and tip in the tool's frame, metres (meshes in other units are cut, too).
inline constexpr double kMaxBladeCoordinate = 1e4;
// A coordinate beyond this (metres) is an error of units or of memory, not a place.
inline constexpr double kMaxCoordinate = 1e6;
// How far a quaternion's length may be from 1 where a peer sends it: files round to 4 digits.
inline constexpr double kQuaternionTolerance = 1e-2;

// Capture: the header holds two configurations and versions; a record holds a pose, a mark, or a note.
inline constexpr std::size_t kMaxCaptureHeaderBytes = 4u << 20;
inline constexpr std::size_t kMaxCaptureRecordBytes = 64u << 20;

// Motion files: a line of text, and poses in memory (72 bytes each: 1.2 GB at most; 46 hours at 100 Hz).
inline constexpr std::size_t kMaxMotionLineBytes = 4096;
inline constexpr std::size_t kMaxMotionSamples = 1u << 24;

}  // namespace incise::protocol
