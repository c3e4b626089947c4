using System;
using System.Collections.Generic;

namespace Incise
{
    /// <summary>A triangle of the body's boundary, counter-clockwise seen from outside.</summary>
    public struct BoundaryTriangle
    {
        public uint A, B, C; // vertices
        public bool IsCut; // a cut opened it
        public int Region;
    }

    /// <summary>
    /// The state that a stream describes, at one revision, in Incise's frame. A change is made completely or not at all. A
    /// triangle's id is its half-face: 4 * tetrahedron + face. Thread: the client changes it within Client.Lock.
    /// </summary>
    public abstract class BodyState
    {
        public ulong Revision { get; protected set; }
        /// <summary>Of the whole mesh at this revision, as the server announced it.</summary>
        public ulong StateHash { get; protected set; }

        /// <summary>The largest number of vertices, and of triangles or tetrahedra.</summary>
        public int MaxVertices = 16 << 20, MaxElements = 32 << 20;

        /// <summary>Whether changes are noted in the two sets below, for a SurfaceMesh.</summary>
        internal bool NotesChanges;
        internal readonly HashSet<uint> ChangedTriangles = new HashSet<uint>();
        internal readonly HashSet<uint> MovedVertices = new HashSet<uint>();

        public abstract int TriangleCount { get; }
        public abstract IEnumerable<uint> TriangleIds { get; }
        public abstract bool TryTriangle(uint id, out BoundaryTriangle triangle);

        /// <summary>Where a vertex is, and where its material is in the body at rest (view Volume; else the same).</summary>
        public abstract bool TryVertex(uint id, out Vec3 position, out Vec3 rest);

        /// <summary>The hash of what is held, from scratch: it must equal HeldHash. O(all).</summary>
        public abstract ulong ComputeHash();

        /// <summary>The announced hash of what is held: of the whole mesh, or of the surface.</summary>
        public abstract ulong HeldHash { get; }

        internal abstract void Add(SnapshotChunk chunk);
        internal abstract void Finish(SnapshotBegin begin, SnapshotEnd end);

        protected void CheckBase(ulong baseRevision, ulong revision)
        {
            if (baseRevision != Revision || revision <= Revision)
                throw new ApplyException("delta from " + baseRevision + " to " + revision + ", this state is at " + Revision);
        }

        protected static void Require(bool condition, string text)
        {
            if (!condition) throw new ApplyException(text);
        }

        protected static void CheckHash(ulong revision, ulong found, ulong announced)
        {
            Require(found == announced, "revision " + revision + " has hash " + found.ToString("x16") + ", announced was " + announced.ToString("x16"));
        }

        /// <summary>Whether one of two ascending arrays has an id of the other.</summary>
        protected static bool Overlap(uint[] a, uint[] b)
        {
            for (int i = 0, j = 0; i < a.Length && j < b.Length;)
            {
                if (a[i] == b[j]) return true;
                if (a[i] < b[j]) ++i;
                else ++j;
            }
            return false;
        }

        /// <summary>Makes room for so many entries, at least doubling.</summary>
        protected static void Grow<T>(ref T[] array, int count)
        {
            if (count > array.Length) Array.Resize(ref array, Math.Max(count, (int)Math.Min(2L * array.Length, int.MaxValue / 2)));
        }
    }
}
