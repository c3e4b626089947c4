using System;
using System.Collections.Generic;

namespace Incise
{
    /// <summary>View Surface, or the part of it that touches a box: triangles and the vertices that they use, ids with gaps.</summary>
    public sealed class SurfaceState : BodyState
    {
        private readonly Dictionary<uint, int> vertexPlaces = new Dictionary<uint, int>();
        private readonly Stack<int> freeVertices = new Stack<int>();
        private float[] positions = { }; // three for each place
        private uint[] bits = { }; // of the same floats, for hashes
        private float[] rests = { }; // likewise: where the material is in the body at rest, where hasRest says so
        private bool[] hasRest = { };
        private int[] uses = { }; // corners of triangles at a vertex
        private readonly Dictionary<uint, int> trianglePlaces = new Dictionary<uint, int>();
        private readonly Stack<int> freeTriangles = new Stack<int>();
        private uint[] corners = { }; // ids of vertices, three for each place
        private byte[] flags = { };
        private uint[] pieces = { };
        private int[] regions = { };
        private uint[] origins = { };
        private ulong hash;

        public int VertexCount { get { return vertexPlaces.Count; } }
        public override int TriangleCount { get { return trianglePlaces.Count; } }
        public override ulong HeldHash { get { return hash; } }
        public override IEnumerable<uint> TriangleIds { get { return trianglePlaces.Keys; } }
        public IEnumerable<uint> VertexIds { get { return vertexPlaces.Keys; } }

        public override bool TryTriangle(uint id, out BoundaryTriangle triangle)
        {
            triangle = default(BoundaryTriangle);
            int at;
            if (!trianglePlaces.TryGetValue(id, out at)) return false;
            triangle.A = corners[3 * at];
            triangle.B = corners[3 * at + 1];
            triangle.C = corners[3 * at + 2];
            triangle.IsCut = (flags[at] & 1) != 0;
            triangle.Region = regions[at];
            return true;
        }

        /// <summary>The piece of a triangle that exists.</summary>
        public uint PieceOf(uint id)
        {
            return pieces[trianglePlaces[id]];
        }

        /// <summary>The triangle of the surface that the body was filled from, of a triangle that exists; SurfaceLookup.None: it has none.</summary>
        public uint OriginOf(uint id)
        {
            return origins[trianglePlaces[id]];
        }

        /// <summary>All bits of a triangle's flags, for comparing states.</summary>
        public byte FlagsOf(uint id)
        {
            return flags[trianglePlaces[id]];
        }

        public override bool TryVertex(uint id, out Vec3 position, out Vec3 rest)
        {
            position = rest = default(Vec3);
            int at;
            if (!vertexPlaces.TryGetValue(id, out at)) return false;
            position = rest = new Vec3(positions[3 * at], positions[3 * at + 1], positions[3 * at + 2]);
            if (hasRest[at]) rest = new Vec3(rests[3 * at], rests[3 * at + 1], rests[3 * at + 2]);
            return true;
        }

        public override ulong ComputeHash()
        {
            ulong value = 0;
            foreach (var v in vertexPlaces) value ^= Incise.StateHash.SurfaceVertex(v.Key, bits, 3 * v.Value);
            foreach (var t in trianglePlaces) value ^= HashOf(t.Key, t.Value);
            return value;
        }

        private ulong HashOf(uint id, int at)
        {
            return Incise.StateHash.Triangle(id, corners, 3 * at, flags[at]);
        }

        internal override void Add(SnapshotChunk chunk)
        {
            foreach (uint id in chunk.SurfaceVertices.Ids) Require(!vertexPlaces.ContainsKey(id), "a vertex that comes twice");
            foreach (uint id in chunk.Triangles.Ids) Require(!trianglePlaces.ContainsKey(id), "a triangle that comes twice");
            CheckLimits(chunk.SurfaceVertices.Ids.Length, chunk.Triangles.Ids.Length);
            PutVertices(chunk.SurfaceVertices, Bits(chunk.SurfaceVertices));
            foreach (uint v in chunk.SurfaceRest.Ids) Require(vertexPlaces.ContainsKey(v), "a rest position of a vertex that does not exist");
            PutRest(chunk.SurfaceRest);
            foreach (uint v in chunk.Triangles.Vertices) Require(vertexPlaces.ContainsKey(v), "a triangle of vertices that do not exist");
            PutTriangles(chunk.Triangles);
        }

        internal override void Finish(SnapshotBegin begin, SnapshotEnd end)
        {
            Require(VertexCount == begin.VertexCount && TriangleCount == begin.TriangleCount, "a snapshot whose counts differ from its contents");
            hash = ComputeHash();
            CheckHash(end.Revision, hash, end.SurfaceHash);
            Revision = end.Revision;
            StateHash = end.StateHash;
        }

        /// <summary>Takes the state to the delta's revision. Throws ApplyException or LimitException and changes nothing.</summary>
        public void Apply(SurfaceDelta d)
        {
            CheckBase(d.BaseRevision, d.Revision);
            Require(!Overlap(d.Triangles.Ids, d.RemovedTriangles), "triangles both set and removed");
            Require(!Overlap(d.Vertices.Ids, d.RemovedVertices), "vertices both set and removed");
            CheckLimits(d.Vertices.Ids.Length, d.Triangles.Ids.Length);
            uint[] newBits = Bits(d.Vertices);
            ulong after = HashAfter(d, newBits);
            CheckHash(d.Revision, after, d.SurfaceHash);
            CheckUses(d);
            PutVertices(d.Vertices, newBits);
            PutRest(d.Rest);
            foreach (uint id in d.RemovedTriangles) RemoveTriangle(id);
            PutTriangles(d.Triangles);
            foreach (uint id in d.RemovedVertices) RemoveVertex(id);
            Note(d);
            hash = after;
            StateHash = d.StateHash;
            Revision = d.Revision;
        }

        private void CheckLimits(int moreVertices, int moreTriangles)
        {
            if (vertexPlaces.Count + moreVertices > MaxVertices) throw new LimitException("more vertices than MaxVertices, " + MaxVertices);
            if (trianglePlaces.Count + moreTriangles > MaxElements) throw new LimitException("more triangles than MaxElements, " + MaxElements);
        }

        private static uint[] Bits(SurfaceVertices vertices)
        {
            var bits = new uint[vertices.Positions.Length];
            Buffer.BlockCopy(vertices.Positions, 0, bits, 0, 4 * bits.Length);
            return bits;
        }

        private ulong HashAfter(SurfaceDelta d, uint[] newBits)
        {
            ulong value = hash;
            int at;
            for (int i = 0; i < d.Vertices.Ids.Length; ++i)
            {
                uint id = d.Vertices.Ids[i];
                if (vertexPlaces.TryGetValue(id, out at)) value ^= Incise.StateHash.SurfaceVertex(id, bits, 3 * at);
                value ^= Incise.StateHash.SurfaceVertex(id, newBits, 3 * i);
            }
            foreach (uint id in d.RemovedVertices)
                if (vertexPlaces.TryGetValue(id, out at)) value ^= Incise.StateHash.SurfaceVertex(id, bits, 3 * at);
            for (int i = 0; i < d.Triangles.Ids.Length; ++i)
            {
                uint id = d.Triangles.Ids[i];
                if (trianglePlaces.TryGetValue(id, out at)) value ^= HashOf(id, at);
                value ^= Incise.StateHash.Triangle(id, d.Triangles.Vertices, 3 * i, d.Triangles.Flags[i]);
            }
            foreach (uint id in d.RemovedTriangles)
                if (trianglePlaces.TryGetValue(id, out at)) value ^= HashOf(id, at);
            return value;
        }

        /// <summary>Afterwards each triangle has its vertices: none of them is absent or removed.</summary>
        private void CheckUses(SurfaceDelta d)
        {
            foreach (uint v in d.Triangles.Vertices)
            {
                bool there = vertexPlaces.ContainsKey(v) || Array.BinarySearch(d.Vertices.Ids, v) >= 0;
                Require(there && Array.BinarySearch(d.RemovedVertices, v) < 0, "a triangle of vertices that do not exist");
            }
            foreach (uint v in d.Rest.Ids)
            {
                bool there = vertexPlaces.ContainsKey(v) || Array.BinarySearch(d.Vertices.Ids, v) >= 0;
                Require(there && Array.BinarySearch(d.RemovedVertices, v) < 0, "a rest position of a vertex that does not exist");
            }
            var fewer = new Dictionary<uint, int>(); // uses that go
            foreach (uint id in d.RemovedTriangles) CountCorners(id, fewer);
            foreach (uint id in d.Triangles.Ids) CountCorners(id, fewer);
            foreach (uint v in d.RemovedVertices)
            {
                int at, gone;
                if (!vertexPlaces.TryGetValue(v, out at)) continue;
                fewer.TryGetValue(v, out gone);
                Require(uses[at] == gone, "a removed vertex that a triangle uses");
            }
        }

        private void CountCorners(uint id, Dictionary<uint, int> count)
        {
            int at;
            if (!trianglePlaces.TryGetValue(id, out at)) return;
            for (int k = 0; k < 3; ++k)
            {
                int n;
                count.TryGetValue(corners[3 * at + k], out n);
                count[corners[3 * at + k]] = n + 1;
            }
        }

        private void PutVertices(SurfaceVertices from, uint[] newBits)
        {
            for (int i = 0; i < from.Ids.Length; ++i)
            {
                int at;
                if (!vertexPlaces.TryGetValue(from.Ids[i], out at))
                {
                    at = freeVertices.Count > 0 ? freeVertices.Pop() : vertexPlaces.Count;
                    Grow(ref positions, 3 * (at + 1));
                    Grow(ref bits, 3 * (at + 1));
                    Grow(ref rests, 3 * (at + 1));
                    Grow(ref hasRest, at + 1);
                    Grow(ref uses, at + 1);
                    vertexPlaces.Add(from.Ids[i], at);
                    uses[at] = 0;
                    hasRest[at] = false;
                }
                Array.Copy(from.Positions, 3 * i, positions, 3 * at, 3);
                Array.Copy(newBits, 3 * i, bits, 3 * at, 3);
            }
        }

        private void PutRest(SurfaceVertices from)
        {
            for (int i = 0; i < from.Ids.Length; ++i)
            {
                int at = vertexPlaces[from.Ids[i]];
                hasRest[at] = true;
                Array.Copy(from.Positions, 3 * i, rests, 3 * at, 3);
            }
        }

        private void PutTriangles(Triangles from)
        {
            for (int i = 0; i < from.Ids.Length; ++i)
            {
                RemoveTriangle(from.Ids[i]);
                int at = freeTriangles.Count > 0 ? freeTriangles.Pop() : trianglePlaces.Count;
                Grow(ref corners, 3 * (at + 1));
                Grow(ref flags, at + 1);
                Grow(ref pieces, at + 1);
                Grow(ref regions, at + 1);
                Grow(ref origins, at + 1);
                origins[at] = from.Origins.Length > 0 ? from.Origins[i] : SurfaceLookup.None;
                Array.Copy(from.Vertices, 3 * i, corners, 3 * at, 3);
                flags[at] = from.Flags[i];
                pieces[at] = from.Pieces[i];
                regions[at] = from.Regions[i];
                for (int k = 0; k < 3; ++k) ++uses[vertexPlaces[corners[3 * at + k]]];
                trianglePlaces.Add(from.Ids[i], at);
            }
        }

        private void RemoveTriangle(uint id)
        {
            int at;
            if (!trianglePlaces.TryGetValue(id, out at)) return;
            for (int k = 0; k < 3; ++k) --uses[vertexPlaces[corners[3 * at + k]]];
            trianglePlaces.Remove(id);
            freeTriangles.Push(at);
        }

        private void RemoveVertex(uint id)
        {
            int at;
            if (!vertexPlaces.TryGetValue(id, out at)) return;
            vertexPlaces.Remove(id);
            freeVertices.Push(at);
        }

        private void Note(SurfaceDelta d)
        {
            if (!NotesChanges) return;
            ChangedTriangles.UnionWith(d.Triangles.Ids);
            ChangedTriangles.UnionWith(d.RemovedTriangles);
            MovedVertices.UnionWith(d.Vertices.Ids);
            MovedVertices.UnionWith(d.Rest.Ids);
        }
    }
}
