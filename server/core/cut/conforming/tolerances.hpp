#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "server/core/geometry/quality.hpp"

// The constants of the policy `conforming`; those of rooms below stand beside their code: noise of the hand (stroke_builder.cpp), how far a move
// may take the boundary (vertex_star.cpp). `_h`: in mean edge lengths of the mesh as loaded; `_local`: in mean edge lengths at
// the vertex in question (TetMesh::local_h); `_edge`: a part of the edge's length; `kCos...`: the cosine of an angle. The rest
// are counts or ratios. A change of any of them changes what cuts do, so all hashes in tests/replay.
namespace incise::core::tolerance {

// ---- Quality: measures of dihedral angles (quality.hpp), smaller is better.

// A star without a worse angle is good: a snap that leaves it so is taken at once, and repairs stop there.
inline constexpr double kGood = dihedral_measure(0.9876883406);  // 9 degrees
// Repairs take on tetrahedra that are worse than this.
inline constexpr double kPoor = dihedral_measure(0.9914448614);  // 7.5 degrees
// A snap is preferred to a split down to this.
inline constexpr double kSnapFloor = dihedral_measure(0.9986295348);  // 3 degrees
// Neither snap nor split makes anything worse than this: the crossing fails instead.
inline constexpr double kFloor = dihedral_measure(0.9999904807);  // 0.25 degrees
// The same where exactness is preferred.
inline constexpr double kExactFloor = dihedral_measure(0.99999998477);  // 0.01 degrees

// ---- Arithmetic.

// Nearer to a plane than this, only exact predicates decide on which side a point lies.
inline constexpr double kClear_h = 1e-6;
// A direction that meets the surface at a slope below this is parallel to it.
inline constexpr double kParallelSlope = 1e-3;
// How far off the surface a point that is computed to lie on it may be.
inline constexpr double kOnSurface_h = 1e-3;

// ---- The swept surface (stroke_path.cpp).

// Side of its cells: somewhat larger than tetrahedra.
inline constexpr double kCell_h = 4;
inline constexpr double kMaxColumns = 256,
                        kMaxRows = 1024;  // cells along the blade, and along the motion of one segment
// The part of a twist by which the diagonal of a cell leaves the ruled surface.
inline constexpr double kTwistSag = 0.25;
// A motion that the surface covers to within this sweeps nothing new. Sampled this finely along the motion, and by h along the
// blade.
inline constexpr double kRetrace_h = 0.05;
inline constexpr double kMaxRetraceRows = 16, kMaxRetraceColumns = 1024;
// Lines of a motion that sweeps nothing new; after so many it is swept after all.
inline constexpr std::size_t kMaxRetraced = 256;
// The blade's way bends where it is farther than this from the chord since its last bend. Chords are no longer than kWay_h; of the lines on the
// way, only those at least kWayStep_h apart are looked at, and no more than kMaxWayLines.
inline constexpr double kBend_h = 0.1, kWay_h = 3, kWayStep_h = 0.05;
inline constexpr std::size_t kMaxWayLines = 64;
// A line at which it bends by more than this is met as exactly as a rim.
inline constexpr double kCosSharpTurn = 0.9;  // 26 degrees
// The surface is kept this far behind the oldest active tetrahedron, in the largest local mesh widths of the stroke: a split or a
// flip may reach some edge lengths farther back.
inline constexpr double kKeptBehind_local = 8;

// ---- What is nearer than a quarter of an element is one (joining_stage.cpp, search_stage.cpp, closing_stage.cpp).

// What is nearer than this to an older cut is one with it. kLiesAtCut_h, kLies_h: a vertex this near to the sweep lies in it, at an
// older cut and elsewhere.
inline constexpr double kOne_h = 0.25, kLiesAtCut_h = 0.02, kLies_h = 0.001;
// A sweep that begins or ends this near before an older cut or the boundary goes on until it is kJoinBeyond_h beyond; less, but kLeastBeyond_h, where it would
// go farther than kOne_h in all: what opens there lies as far off what was swept. The reach is somewhat more than kOne_h: an older cut may end somewhat before
// its own rim.
inline constexpr double kJoinReach_h = 0.35, kJoinBeyond_h = 0.15, kLeastBeyond_h = 0.05;
// What would be closed or parted beyond the sweep itself is left to another blade that is about to part what is nearer than this.
inline constexpr double kLeftToOthers_h = 1;
// The parts of a line that are looked at one by one: how long each is, and how many there are at most.
inline constexpr double kJoinPart_h = 0.25, kMaxJoinParts = 4096;
// A sweep's end goes on to the walls ahead of it unless more of its parts in the tissue have none: so many for each that has one.
inline constexpr double kMostFree = 0.3;
// So many parts that follow each other, at least, are closed against the boundary beside them.
inline constexpr std::size_t kLeastBeside = 3;
// So many parts that follow each other are looked at with the walls near all of them.
inline constexpr std::size_t kJoinBlock = 8;
// A sweep begins and ends, too, where the blade moves along itself, but for this part of its way.
inline constexpr double kLeastAcross = 0.05;
// A boundary faces a blade whose motion is off its normal by no more than this.
inline constexpr double kCosFacing = 0.5;  // 60 degrees
// A blade whose motion is off the plane of an older cut's face by less than this runs along it, and meets it only where it is ahead
// by more than this.
inline constexpr double kSinAlong = 0.17, kLeastAhead_h = 0.02;  // 10 degrees
// The way of a heel or a tip goes on to the boundary ahead of it where the way to there changes by no more than this part of it along it.
inline constexpr double kRimSlope = 0.3;
// Straight ahead is a slanted wall's face where the blade meets its plane no farther beside the face than this.
inline constexpr double kAimOff_h = 0.1;
// What is kept of a sweep where it begins or ends: so wide a strip, of lines that are so far apart. Where no face of a cut is this near to it,
// the tissue hangs together across it.
inline constexpr double kStrip_h = 3, kStripStep_h = 0.2, kOpen_h = 0.1;
// A sweep that goes back the way it came, so far, ends there as well: the cosine between the two ways.
inline constexpr double kTurnsBack = -0.8, kTurnsBackAfter_h = 1;
// Strips narrower than this part of kJoinBeyond_h are not added.
inline constexpr double kLeastJoin = 0.1;
// A sweep goes on beyond the way of a heel or a tip where it covers, to within kCovered_h, what is kBeyondRow_h beyond that, and not what is kRow_h before
// it. So wide a strip before that way is part of it then: somewhat more than a vertex may be moved.
inline constexpr double kBeyondRow_h = 0.3, kRow_h = 1, kCovered_h = 0.1;
// Of the stroke's own ways so many parts are looked at in a batch: a hand that is at it in place leaves thousands.
inline constexpr std::size_t kMostOwnRims = 128;
// A face that closes a gap between the end of a sweep and a wall ahead of it is no farther than this from what the blade has swept: as far as
// that wall may be ahead, and kOne_h beside it.
inline constexpr double kFarGap_h = kJoinReach_h + kOne_h;
// How far a face that closes a gap may be off the surface where it lies at no older cut and neither of the parts that it holds together
// is known to be apart from the other.
inline constexpr double kAtSkin_h = 0.1;
// A face at the skin, with no vertex farther than this from what is swept now, may hold together two parts that a surface passes by: Neck decides. Where
// elements are large it may be this part of their edges, up to kNeckFar_h.
inline constexpr double kNeckOff_h = 0.5, kNeckOff_local = 0.42, kNeckFar_h = 0.75;
// Of a part that is known to its end it looks at all, and so far around it, at points that are so far apart: farther where what is beside the part has less
// than kNeckPart_h3 there, and where that is less than kPartBeside_h3 it says nothing. Parts hang together that share kPartShared of their points, and are apart
// if they share less than kPartApart. No part has more tetrahedra than kMaxPart, and no box more points than kMaxPartPoints.
inline constexpr std::array<double, 2> kPartAround_h{0.75, 2};
inline constexpr double kPartStep_h = 0.125, kPartShared = 0.5, kPartApart = 0.02, kPartBeside_h3 = 0.2,
                        kMaxPartPoints = 6e5;
inline constexpr std::size_t kMaxPart = 8000;
// A part is the same as before if it has no more than so many times as many tetrahedra, or as few.
inline constexpr std::size_t kSamePart = 2;
// Otherwise it looks in a box that reaches so far, with so many points along each axis. Parts hang together that share kNeckShared of their points. It looks
// farther where they share less than kNeckDoubtful, and from the first box, where one of them has less than kNeckPart_h3 in it, unless they share kNeckSure.
inline constexpr std::array<double, 3> kNeckReach_h{1.5, 2.5, 4};
inline constexpr int kNeckPoints = 25;
inline constexpr double kNeckShared = 0.1, kNeckDoubtful = 0.5, kNeckSure = 0.95, kNeckPart_h3 = 0.75;
// The parts of a rim that are looked at one by one.
inline constexpr double kNeckRim_h = 0.125;
// So many quads' rims that follow each other are looked at with the walls near all of them.
inline constexpr std::size_t kRimBlock = 8;
// So many faces are asked about in a batch.
inline constexpr std::size_t kMaxNecks = 16;
// What holds two parts together by several faces (BridgeFinder). It is looked for around a face with an edge of kBridgeEdge_h whose middle is within kBridgeBeside_h of what was swept, if within
// kBridgeClear_h of the points kBridgeDepth_h to either side nothing was, and if the sweep goes on kBridgeRound_h from there, within kBridgeRoundOff_h of its plane, or all ends before.
// First within kBridgeReach_h[0], and farther while two parts that have kLeastPartNear_h3 there, clear of what was swept, stay apart; at points kBridgeStep_h apart. No vertex of a
// face that opens is farther off what was swept than kBridgeFar_h. Places are kBridgesApart_h apart, by how far was looked around the one before. So many faces are kept of a stroke, and so many
// places looked at when it ends; so often may what flows from part to part take another way.
inline constexpr std::array<double, 3> kBridgeReach_h{1, 1.75, 3}, kBridgesApart_h{0.75, 1.25, 1.5};
inline constexpr double kLeastPartNear_h3 = 0.015, kBridgeStep_h = 1.0 / 6, kBridgeBeside_h = 0.3,
                        kBridgeFar_h = 1.25, kBridgeDepth_h = 0.5, kBridgeClear_h = 0.25, kBridgeEdge_h = 1,
                        kBridgeRound_h = 0.75, kBridgeRoundOff_h = 0.4;
inline constexpr int kBridgeRounds = 8;           // so many ways
inline constexpr std::uint32_t kMostWalked = 64;  // tetrahedra on one of them
inline constexpr std::size_t kMostBridges = 4096, kMaxBridges = 16, kMostFlows = 64;
// Chords that stand for what was swept are no shorter than this.
inline constexpr double kRemembered_h = 0.2;
// How thick a rib between a sweep and the boundary may be, where it is parted far from the ends of a sweep.
inline constexpr double kRib_h = 0.21;
// So far off a sweep that has come upon nothing a rib or a neck may be.
inline constexpr double kOffAlone_h = 0.15;
// The least volume of a part.
inline constexpr double kLeastPart_h3 = 0.25;
// A tetrahedron this near to the surface may be on either side of it.
inline constexpr double kBeside_h = 0.1;
// A face nearer to the blade than this waits: what the blade is about to part hangs together before it.
inline constexpr double kFar_h = 4;
// The largest part that counts as small, and the farthest that a search looks for a way from one side of a face to the other, in
// tetrahedra.
inline constexpr std::size_t kMaxWay = 400;
// So far it looks first.
inline constexpr std::size_t kNearWay = 32;
// When a stroke ends, so many are looked at besides, both sides together; so many of one side before the other's turn; and so many for
// all faces, after which no more are begun.
inline constexpr std::size_t kMaxFarWay = 100000, kFarChunk = 32, kMaxFarWays = 200000;
// ---- Waiting for the blade.

// A vertex nearer than this to the blade's present line waits: what is swept next may concern it too.
inline constexpr double kHot_local = 1.5;

// ---- The rim (rim_stage.cpp).

// A rim vertex this near to where the rim pierces a face stands for that place.
inline constexpr double kRim_local = 0.5;
// A vertex goes no farther than this to the rim.
inline constexpr double kRimReach_local = 0.75;
// Places that are tried besides the one that is pierced, along the rim.
inline constexpr double kRimShift_local = 0.15;
// A new rim vertex splits an edge of the face no nearer to its ends than this.
inline constexpr double kRimSplit_edge = 0.2;
// A face that is pierced is found from both sides. It is listed once, if so many others have not come between.
inline constexpr std::size_t kMaxLately = 64;

// ---- Crossings (crossing_stage.cpp, placement.cpp).

// A crossing this near to an end that is on the surface is that vertex.
inline constexpr double kAtVertex_edge = 0.25;
// Where exactness is preferred, an edge crossed farther than this from its ends is split.
inline constexpr double kExactNear_edge = 0.05;
// A vertex is snapped no farther than this, of the crossed edge.
inline constexpr double kSnapReach_edge = 0.75;
// A tetrahedron with all vertices on the surface and at most this thick is flat, and is removed.
inline constexpr double kFlat_local = 0.03;
// Its barycentre has to be this near to the surface: it may lie across a bend.
inline constexpr double kFlatOff_h = 0.1;
// A boundary vertex this near to the surface may stand for it where it is, if its boundary runs along the surface. The smaller of
// h and the local width counts.
inline constexpr double kStay_h = 0.08;
inline constexpr double kCosAlong = 0.94;  // 20 degrees
// Where snaps and splits would leave angles below kSnapFloor, a crossing this near to an end on the surface is dealt with; and
// a vertex this near to the surface stands for it, at an older cut and at the skin.
inline constexpr double kMetForNeedle_h = 0.35, kCutForNeedle_h = 0.2, kSkinForNeedle_h = 0.1;

// Which way a vertex is free to go: boundary faces within this angle of a first one make a smooth patch, which fixes one
// direction; more than one patch make a crease or a corner.
inline constexpr double kCosPatch = 0.94;  // 20 degrees
// A patch fixes another direction if this much of its unit normal is off those that are fixed: the first patch (against the swept
// surface), and each one after it (20 degrees).
inline constexpr double kFirstPatchOff = 0.05, kNextPatchOff = 0.34;

// The pattern search for a better place: its first step, how often it halves, moves at each step, and how far off the surface a
// trial point may be to be put back on it.
inline constexpr double kSearchStep_local = 0.25;
inline constexpr int kSearchLevels = 3, kSearchTurns = 2;
// Where the sweep has come upon a cut there is little room. What a repair leaves worse than kSnapFloor there is looked for once more, so
// finely: otherwise hands leave 1.6 times as many needles.
inline constexpr int kNeedleLevels = 8, kNeedleTurns = 8;
inline constexpr double kSearchReach_local = 0.2;

// ---- Repairs (repair_stage.cpp, flips.cpp).

// A vertex that is moved within the surface has to be this near to it.
inline constexpr double kMoveOff_h = 0.01;
// A tetrahedron with all vertices on the surface, this thin (local) and this near to it (h), is a film. It is removed if it is
// worse than kFilmKept, or than kSnapFloor where the sweep has come upon a cut: films are many there, and the body would lose their volume.
inline constexpr double kFilmKept = dihedral_measure(0.9961946981);  // 5 degrees
inline constexpr double kFilm_local = 0.06, kFilmOff_h = 0.06;
// An edge between vertices on the surface, or a face, whose middle is farther off it is no part of it.
inline constexpr double kFlipOff_h = 0.1;
// A vertex whose star stays poor is repaired this often again, after all others.
inline constexpr int kMaxRepeats = 2;
// Poor tetrahedra that the repair of one vertex takes on.
inline constexpr std::size_t kMaxPoor = 32;
// A new vertex is merged with one of its nearest neighbours, if that is nearer than this.
inline constexpr double kMerge_local = 0.8;
inline constexpr int kMaxMergeCandidates = 4;
// Edges with more tetrahedra around them are not removed.
inline constexpr std::size_t kMaxEdgeRing = 7;

// ---- Verification.

// How often crossings that snaps and repairs have made are dealt with; those after the last time fail.
inline constexpr int kMaxRounds = 5;

// ---- Opening (opening_stage.cpp, islands.cpp).

// Where the line between two tetrahedra passes their face: this part of the way from its middle to their reference points.
inline constexpr double kPass = 0.25;
// A vertex that an older sweep has put in place is still there where chords of what was swept pass it by this.
inline constexpr double kLiesInSwept_h = 0.05;
// A face on the surface whose middle is farther off it is a chord of a bend, and is split, where one of its edges is farther off than kChordEdge_h; so
// often in a batch at most. kChord_h: where the sweep is alone, since nothing else was swept within kAlone_h: by no other stroke, nor by this one more
// than kOwnSweep_h before or after. Where it is not, hands would add 0.15 more new tetrahedra a cut face, and kChordBeside_h holds.
inline constexpr double kChord_h = 0.1, kChordEdge_h = 0.05, kChordBeside_h = 0.2;
inline constexpr double kAlone_h = 1, kOwnSweep_h = 4;
inline constexpr int kMaxRefinements = 5;
// What reaches no farther than this from the surface is no part of the tissue.
inline constexpr double kThin_local = 0.1;
// Nor is a film between cuts, or between a cut and the boundary, that is no thicker than this in the mean; kOne_h where this part of its
// surface is cut.
inline constexpr double kFilm_h = 0.15, kBetweenCuts = 0.75;
// Where this part of its surface is cut, it may be kOne_h thick, and kUneven_h between cuts, whose faces may lie off what was swept, if it holds
// less than kLeastDeep_h3 farther from the cut than kDeep_h. And where the sweep is alone if none
// of it reaches farther than kFilmReach_h. kSlab_h: how thick it may be where it hangs by a face that had to stay closed.
inline constexpr double kUneven_h = 0.27, kAlongCut = 0.4, kDeep_h = 0.3, kLeastDeep_h3 = 0.09,
                        kFilmReach_h = 0.42, kSlab_h = 0.4;
// One in so many of a film's tetrahedra may have a vertex inside it, and so many besides in a film larger than kMaxRaggedIsland.
inline constexpr std::size_t kFilmToInner = 8, kFilmInner = 16;
// What hung by a flat tetrahedron that was removed goes with it where the middles of its tetrahedra are nearer to a cut than this, and it has
// no more than so many.
inline constexpr double kShallow_h = 0.125;
inline constexpr std::size_t kMaxCrumb = 64;
// Tetrahedra that stay with a neighbour although the sweep cuts them off on all sides: with a ragged face or in a tip, and in a sheet or a film.
inline constexpr std::size_t kMaxRaggedIsland = 16, kMaxSheetIsland = 2000;
// How many tetrahedra around one of these neighbours are looked at for the others.
inline constexpr std::size_t kMaxAround = 12;
// How far from an opened face the surface is looked for: for its side, and for the deviation that is reported. First nearer, where it is
// as a rule.
inline constexpr double kSurfaceReach_h = 4, kSurfaceNear_h = 0.125;
// Faces opened between two looks at the budget.
inline constexpr std::size_t kOpenChunk = 16;

// ---- Parting edges (pinched_edges.cpp).

// An edge around which the tissue hangs together in several fans is parted once the blade has gone on for so long. Parted four h behind the
// blade, hands added 1.19 new tetrahedra a cut face instead of 1.17.
inline constexpr double kPinchedWait_h = 100;

// ---- Prefetching.

// Tetrahedra: what is active as a rule, and some layers around it. 30 us.
inline constexpr std::size_t kMaxPrefetched = 1024;

}  // namespace incise::core::tolerance

// What operations cost, in units of WorkBudget (some 50 ns each). Counted, not timed, so that no clock decides anything.
namespace incise::core::cost {

inline constexpr std::int64_t kLook = 1;  // at the next entry of a list, or at one number

// A batch begins: by triangles, crossings and active tetrahedra, which are this many times as cheap.
inline constexpr std::size_t kTrianglesAUnit = 4, kCrossingsAUnit = 8, kActiveAUnit = 16;
inline constexpr std::int64_t kRetraceSample = 1;
inline constexpr std::size_t kWallsAUnit = 8;  // looked at for one place

// Search.
inline constexpr std::int64_t kProbe = 3;
inline constexpr std::int64_t kGridCells = 10;  // of one triangle
inline constexpr std::size_t kGridEntriesAUnit = 8;
inline constexpr std::int64_t kLocate = 50;

// Stars and crossings.
inline constexpr std::int64_t kGather = 2;
inline constexpr std::size_t kGatherCornersAUnit = 2;
inline constexpr std::size_t kStarCornersAUnit = 6;  // only walked
inline constexpr std::int64_t kWorstAt = 1;
inline constexpr std::size_t kWorstAtCornersAUnit = 8;
inline constexpr std::int64_t kSurfaceQuery = 1;
inline constexpr std::int64_t kNearby = 2;  // a query that has to look around
inline constexpr std::int64_t kFindCrossing = 2;
inline constexpr std::int64_t kFindEdge = 10;
inline constexpr std::int64_t kPlace = 4;

// A neck: a box of points, and what was swept by all strokes.
inline constexpr std::size_t kNeckPointsAUnit = 4, kBridgePointsAUnit = 10, kQuadsAUnit = 8, kRowsAUnit = 2;
inline constexpr std::int64_t kFillTet = 12;

// A part of a batch that is worth a delta of its own, some 5 ms, and what it is estimated to have cost: by the events, the faces that have opened,
// the points that films are told by, those of necks, and the quads that were swept where a bridge is looked for.
inline constexpr std::size_t kPart = 60'000, kPartEvent = 1'000, kPartFace = 250, kPartFilmPoint = 16,
                             kPartNeckPoint = 1, kPartBridgeQuad = 40;

// Operations on the mesh.
inline constexpr std::int64_t kTrySplit = 2;  // each tetrahedron around the edge
inline constexpr std::int64_t kSplit = 8;     // each tetrahedron around the edge
inline constexpr std::int64_t kRemoveFlat = 60;
inline constexpr std::int64_t kReplace = 20;
inline constexpr std::int64_t kTryCollapse = 40;
inline constexpr std::int64_t kTryFlip = 12;
inline constexpr std::int64_t kOpenFace = 40;

// Verification and opening.
inline constexpr std::int64_t kVerify = 1, kVerifyEdge = 2;
inline constexpr std::int64_t kIslandMember = 2;
inline constexpr std::int64_t kThin = 6;
inline constexpr std::int64_t kDeviation = 4;

}  // namespace incise::core::cost
