using System;
using System.Collections.Generic;

namespace Incise
{
    /// <summary>
    /// View Volume: arrays by id. A vertex v is at Positions[3 v], ...; a tetrahedron t has Tets[4 t] to Tets[4 t + 3], the first
    /// of them NoId where there is none. The arrays are longer than what is used, and replaced when they grow.
    /// </summary>
    public sealed class VolumeState : BodyState
    {
        public const uint NoId = MessageReader.NoId;
        // The corners of face f, counter-clockwise from outside.
        private static readonly int[] Faces = { 1, 2, 3, 0, 3, 2, 0, 1, 3, 0, 2, 1 };

        private double[] positions = { };
        private double[] rest; // null before the first deformation
        private uint[] tets = { };
        private int[] regions = { };
        private byte[] cutMasks = { }, boundaryMasks = { };
        private readonly SortedDictionary<uint, uint> names = new SortedDictionary<uint, uint>(); // a tetrahedron by piece
        private uint[] pieces;
        private ulong hash;
        private int boundaryFaces;

        public int VertexCount { get; private set; }
        /// <summary>Ids of tetrahedra run below it.</summary>
        public int TetSlots { get; private set; }
        public int LiveTets { get; private set; }
        public double[] Positions { get { return positions; } }
        /// <summary>Where each vertex's material is at rest; equal to Positions until a simulator deforms the body.</summary>
        public double[] RestPositions { get { return rest ?? positions; } }
        public uint[] Tets { get { return tets; } }
        public int[] Regions { get { return regions; } }
        /// <summary>Bit f: face f, opposite to vertex f, was opened by a cut; is on the boundary.</summary>
        public byte[] CutMasks { get { return cutMasks; } }
        public byte[] BoundaryMasks { get { return boundaryMasks; } }

        public override int TriangleCount { get { return boundaryFaces; } }
        public override ulong HeldHash { get { return StateHash; } }

        public bool IsAlive(uint tet)
        {
            return tet < TetSlots && tets[4 * tet] != NoId;
        }

        public override IEnumerable<uint> TriangleIds
        {
            get
            {
                for (uint t = 0; t < TetSlots; ++t)
                {
                    for (uint f = 0; f < 4; ++f)
                        if (IsAlive(t) && (boundaryMasks[t] >> (int)f & 1) != 0)
                            yield return 4 * t + f;
                }
            }
        }

        public override bool TryTriangle(uint id, out BoundaryTriangle triangle)
        {
            triangle = default(BoundaryTriangle);
            uint t = id / 4;
            int f = (int)(id % 4);
            if (!IsAlive(t) || (boundaryMasks[t] >> f & 1) == 0) return false;
            triangle.A = tets[4 * t + Faces[3 * f]];
            triangle.B = tets[4 * t + Faces[3 * f + 1]];
            triangle.C = tets[4 * t + Faces[3 * f + 2]];
            triangle.IsCut = (cutMasks[t] >> f & 1) != 0;
            triangle.Region = regions[t];
            return true;
        }

        public override bool TryVertex(uint id, out Vec3 position, out Vec3 material)
        {
            position = material = default(Vec3);
            if (id >= VertexCount) return false;
            position = At(positions, id);
            material = rest == null ? position : At(rest, id);
            return true;
        }

        private static Vec3 At(double[] array, uint id)
        {
            return new Vec3(array[3 * id], array[3 * id + 1], array[3 * id + 2]);
        }

        public override ulong ComputeHash()
        {
            ulong value = 0;
            for (uint v = 0; v < VertexCount; ++v) value ^= Incise.StateHash.Vertex(v, positions, (int)(3 * v));
            for (uint t = 0; t < TetSlots; ++t)
                if (IsAlive(t)) value ^= HashOf(t);
            return value;
        }

        private ulong HashOf(uint t)
        {
            return Incise.StateHash.Tet(t, tets, (int)(4 * t), regions[t], cutMasks[t]);
        }

        /// <summary>
        /// The piece of each tetrahedron: what hangs together over shared vertices with the tetrahedron that names a piece is in
        /// it, the rest in piece 0. Found when asked for, once a change. O(mesh).
        /// </summary>
        public uint[] Pieces()
        {
            if (pieces != null) return pieces;
            var parent = new int[VertexCount];
            for (int v = 0; v < parent.Length; ++v) parent[v] = v;
            for (uint t = 0; t < TetSlots; ++t)
            {
                if (!IsAlive(t)) continue;
                int root = Root(parent, tets[4 * t]);
                for (int k = 1; k < 4; ++k) parent[Root(parent, tets[4 * t + k])] = root;
            }
            var pieceOf = new uint[VertexCount];
            foreach (var name in names)
                if (IsAlive(name.Value)) pieceOf[Root(parent, tets[4 * name.Value])] = name.Key;
            var found = new uint[TetSlots];
            for (uint t = 0; t < TetSlots; ++t)
                if (IsAlive(t)) found[t] = pieceOf[Root(parent, tets[4 * t])];
            pieces = found;
            return found;
        }

        private static int Root(int[] parent, uint vertex)
        {
            int v = (int)vertex;
            while (parent[v] != v) v = parent[v] = parent[parent[v]];
            return v;
        }

        // ---- A snapshot ----

        internal override void Add(SnapshotChunk chunk)
        {
            int more = chunk.Positions.Length / 3;
            Require(chunk.VertexIds.Length == 0, "a part of the volume, which this client does not hold");
            Require(more == 0 || chunk.FirstVertex == VertexCount, "vertices that do not follow the last one");
            Require(more == 0 || VertexCount == 0 || (rest != null) == (chunk.RestPositions.Length > 0), "rest positions of some vertices");
            if (VertexCount + more > MaxVertices) throw new LimitException("more vertices than MaxVertices, " + MaxVertices);
            Grow(ref positions, 3 * (VertexCount + more));
            Array.Copy(chunk.Positions, 0, positions, 3 * VertexCount, 3 * more);
            if (chunk.RestPositions.Length > 0)
            {
                rest = rest ?? new double[0];
                Grow(ref rest, positions.Length);
                Array.Copy(chunk.RestPositions, 0, rest, 3 * VertexCount, 3 * more);
            }
            VertexCount += more;
            Tets added = chunk.Tets;
            if (added.Ids.Length == 0) return;
            Require(added.Ids[0] >= TetSlots, "tetrahedra: ids that do not ascend");
            SetSlots(added.Ids[added.Ids.Length - 1] + 1);
            for (int i = 0; i < added.Ids.Length; ++i) Put(added, i);
            LiveTets += added.Ids.Length;
        }

        internal override void Finish(SnapshotBegin begin, SnapshotEnd end)
        {
            Require(VertexCount == begin.VertexCount && LiveTets == begin.TetCount, "a snapshot whose counts differ from its contents");
            for (uint t = 0; t < TetSlots; ++t)
            {
                for (int k = 0; k < 4 && IsAlive(t); ++k) Require(tets[4 * t + k] < VertexCount, "a tetrahedron of vertices that do not exist");
            }
            for (int i = 0; i < begin.PieceIds.Length; ++i)
            {
                Require(IsAlive(begin.PieceNames[i]), "a piece with a tetrahedron that does not exist");
                names[begin.PieceIds[i]] = begin.PieceNames[i];
            }
            hash = ComputeHash();
            CheckHash(end.Revision, hash, end.StateHash);
            Revision = end.Revision;
            StateHash = end.StateHash;
        }

        private void SetSlots(uint slots)
        {
            if (slots > MaxElements) throw new LimitException("more tetrahedra than MaxElements, " + MaxElements);
            int count = (int)slots;
            if (count <= TetSlots) return;
            Grow(ref tets, 4 * count);
            Grow(ref regions, count);
            Grow(ref cutMasks, count);
            Grow(ref boundaryMasks, count);
            for (int i = 4 * TetSlots; i < 4 * count; i += 4) tets[i] = NoId;
            TetSlots = count;
        }

        private void Put(Tets from, int i)
        {
            uint t = from.Ids[i];
            boundaryFaces += Bits(from.BoundaryMasks[i]) - Bits(boundaryMasks[t]);
            Array.Copy(from.Vertices, 4 * i, tets, 4 * t, 4);
            regions[t] = from.Regions[i];
            cutMasks[t] = from.CutMasks[i];
            boundaryMasks[t] = from.BoundaryMasks[i];
        }

        private static int Bits(byte mask)
        {
            return (mask & 1) + (mask >> 1 & 1) + (mask >> 2 & 1) + (mask >> 3 & 1);
        }

        // ---- A delta ----

        /// <summary>Takes the state to the delta's revision. Throws ApplyException or LimitException and changes nothing.</summary>
        public void Apply(Delta d)
        {
            CheckBase(d.BaseRevision, d.Revision);
            CheckVertices(d);
            int live = CheckTets(d);
            ulong after = HashAfter(d);
            CheckHash(d.Revision, after, d.StateHash);
            ApplyRest(d);
            ApplyVertices(d);
            ApplyTets(d);
            LiveTets = live;
            hash = StateHash = after;
            Revision = d.Revision;
        }

        private void CheckVertices(Delta d)
        {
            long vertices = (long)VertexCount + d.ProvenanceT.Length;
            Require(d.AddedIds.Length == 0 && d.RemovedVertices.Length == 0, "a delta of a part of the volume");
            Require(d.ProvenanceT.Length == 0 || d.FirstAdded == VertexCount, "added vertices that do not follow the last one");
            Require(d.VertexCount == vertices, "a delta whose counts differ from its contents");
            if (vertices > MaxVertices) throw new LimitException("more vertices than MaxVertices, " + MaxVertices);
            Require(Below(d.MovedIds, VertexCount), "moved vertices that do not exist");
            Require(Below(d.RestIds, vertices), "rest positions of vertices that do not exist");
            string error = d.ProvenanceError(VertexCount);
            Require(error == null, error);
            foreach (uint v in d.Tets.Vertices) Require(v < vertices, "a tetrahedron of vertices that do not exist");
        }

        private static bool Below(uint[] ascending, long limit)
        {
            return ascending.Length == 0 || ascending[ascending.Length - 1] < limit;
        }

        /// <summary>How many tetrahedra there will be.</summary>
        private int CheckTets(Delta d)
        {
            int changed = 0;
            uint[] ids = d.Tets.Ids;
            for (; changed < ids.Length && ids[changed] < d.FirstNewTet; ++changed)
                Require(IsAlive(ids[changed]), "changed tetrahedra that do not exist");
            Require(d.FirstNewTet >= TetSlots || changed == ids.Length, "new tetrahedra with old ids");
            foreach (uint t in d.RemovedTets) Require(IsAlive(t), "removed tetrahedra that do not exist");
            Require(!Overlap(d.RemovedTets, ids), "tetrahedra both changed and removed");
            int live = LiveTets + ids.Length - changed - d.RemovedTets.Length;
            Require(live == d.LiveTets, "a delta whose counts differ from its contents");
            Require(d.TetElders.Length == 0 || d.TetElders.Length == ids.Length - changed, "elders of some new tetrahedra only");
            foreach (uint t in d.TetElders) Require(IsAlive(t), "an elder that does not exist");
            Require(d.PieceNames.Length == d.PieceIds.Length, "pieces without their tetrahedra");
            foreach (uint t in d.PieceNames)
            {
                bool stays = IsAlive(t) && Array.BinarySearch(d.RemovedTets, t) < 0;
                Require(stays || Array.BinarySearch(ids, t) >= 0, "a piece with a tetrahedron that does not exist");
            }
            if (ids.Length > 0 && ids[ids.Length - 1] >= MaxElements) throw new LimitException("more tetrahedra than MaxElements, " + MaxElements);
            return live;
        }

        private ulong HashAfter(Delta d)
        {
            ulong value = hash;
            for (int i = 0; i < d.MovedIds.Length; ++i)
            {
                value ^= Incise.StateHash.Vertex(d.MovedIds[i], positions, (int)(3 * d.MovedIds[i]));
                value ^= Incise.StateHash.Vertex(d.MovedIds[i], d.MovedPositions, 3 * i);
            }
            for (int i = 0; i < d.ProvenanceT.Length; ++i)
                value ^= Incise.StateHash.Vertex((uint)(VertexCount + i), d.AddedPositions, 3 * i);
            foreach (uint t in d.RemovedTets) value ^= HashOf(t);
            for (int i = 0; i < d.Tets.Ids.Length; ++i)
            {
                uint t = d.Tets.Ids[i];
                if (IsAlive(t)) value ^= HashOf(t);
                value ^= Incise.StateHash.Tet(t, d.Tets.Vertices, 4 * i, d.Tets.Regions[i], d.Tets.CutMasks[i]);
            }
            return value;
        }

        // Rest positions begin at the first deformation: until then they are the positions.
        private void ApplyRest(Delta d)
        {
            bool deforms = rest != null || d.RestIds.Length > 0;
            foreach (Step step in d.Steps) deforms |= step.Stroke == 0;
            if (!deforms) return;
            if (rest == null) rest = (double[])positions.Clone();
            int added = d.ProvenanceT.Length;
            Grow(ref rest, 3 * (VertexCount + added));
            for (int i = 0; i < added; ++i)
            {
                long to = 3L * (VertexCount + i), a = 3L * d.ProvenanceA[i], b = 3L * d.ProvenanceB[i];
                for (int k = 0; k < 3; ++k) rest[to + k] = rest[a + k] + d.ProvenanceT[i] * (rest[b + k] - rest[a + k]);
            }
            for (int i = 0; i < d.RestIds.Length; ++i) Array.Copy(d.RestPositions, 3 * i, rest, 3L * d.RestIds[i], 3);
        }

        private void ApplyVertices(Delta d)
        {
            for (int i = 0; i < d.MovedIds.Length; ++i) Array.Copy(d.MovedPositions, 3 * i, positions, 3L * d.MovedIds[i], 3);
            int added = d.ProvenanceT.Length;
            Grow(ref positions, 3 * (VertexCount + added));
            Array.Copy(d.AddedPositions, 0, positions, 3 * VertexCount, 3 * added);
            VertexCount += added;
            if (!NotesChanges) return;
            MovedVertices.UnionWith(d.MovedIds);
            MovedVertices.UnionWith(d.RestIds);
        }

        private void ApplyTets(Delta d)
        {
            foreach (uint t in d.RemovedTets)
            {
                boundaryFaces -= Bits(boundaryMasks[t]);
                tets[4 * t] = NoId;
                regions[t] = 0;
                cutMasks[t] = boundaryMasks[t] = 0;
            }
            uint[] ids = d.Tets.Ids;
            if (ids.Length > 0) SetSlots(ids[ids.Length - 1] + 1);
            for (int i = 0; i < ids.Length; ++i) Put(d.Tets, i);
            for (int i = 0; i < d.PieceIds.Length; ++i) names[d.PieceIds[i]] = d.PieceNames[i];
            if (ids.Length + d.RemovedTets.Length + d.PieceIds.Length > 0) pieces = null;
            if (!NotesChanges) return;
            for (uint f = 0; f < 4; ++f)
            {
                foreach (uint t in ids) ChangedTriangles.Add(4 * t + f);
                foreach (uint t in d.RemovedTets) ChangedTriangles.Add(4 * t + f);
            }
        }
    }
}
