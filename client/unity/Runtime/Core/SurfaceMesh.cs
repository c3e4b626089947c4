using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;

namespace Incise
{
    /// <summary>A vertex as the graphics card gets it, in Unity's frame.</summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct MeshVertex
    {
        public float X, Y, Z;
        public float NormalX, NormalY, NormalZ;
        /// <summary>Where its material is in the body at rest: textures that are placed by it stay on the tissue.</summary>
        public float U, V, W;
        /// <summary>Texture coordinates of the surface that the body was filled from; 0 without one, and inside.</summary>
        public float S, T;
    }

    /// <summary>Entries Start, Start + 1, ... of a buffer.</summary>
    public struct BufferRange
    {
        public int Start, Count;
    }

    /// <summary>
    /// The boundary of a state as the buffers of a Unity Mesh: triangles of the skin (submesh 0) and of the inside that cuts
    /// have opened (submesh 1), with vertices and smooth normals of their own. Update() costs what has changed, and says
    /// which ranges to upload. Thread: one, within the client's Lock. One SurfaceMesh a state.
    /// </summary>
    public sealed class SurfaceMesh
    {
        private const int MaxRanges = 24; // uploads a buffer; larger gaps are uploaded, too
        private const int None = -1;

        // A corner is 3 * triangle + k. The corners at a vertex are a list: first[vertex], next[corner].
        // At a seam of the texture a vertex of the state has several here: the first, twins[first], ...
        private readonly Dictionary<ulong, int> vertexOf = new Dictionary<ulong, int>(); // by 2 * id + submesh
        private int[] twins = { };
        private readonly Stack<int> freeVertices = new Stack<int>();
        private ulong[] keys = { };
        private int[] first = { };
        private int usedVertices;
        private readonly Dictionary<uint, int> triangleOf = new Dictionary<uint, int>();
        private readonly Stack<int> freeTriangles = new Stack<int>();
        private int[] corners = { };
        private int[] next = { };
        private int[] places = { }; // of a triangle in its submesh
        private bool[] inside = { };
        private uint[] ids = { };
        private int usedTriangles;
        private SurfaceLookup texture;
        private readonly float[] uvs = new float[6];
        private readonly HashSet<uint> laidAnew = new HashSet<uint>();
        private readonly List<int>[] order = { new List<int>(), new List<int>() }; // triangles by place
        private readonly HashSet<int> dirtyVertices = new HashSet<int>();
        private readonly HashSet<int>[] dirtyPlaces = { new HashSet<int>(), new HashSet<int>() };
        private BodyState shown;

        /// <summary>All vertices, free ones among them; upload those of VertexRanges.</summary>
        public MeshVertex[] Vertices { get; private set; }
        /// <summary>Those of the skin begin at 0, those of the inside at InsideStart.</summary>
        public uint[] Indices { get; private set; }
        public int InsideStart { get; private set; }
        public int SkinCount { get { return 3 * order[0].Count; } }
        public int InsideCount { get { return 3 * order[1].Count; } }
        /// <summary>The buffers have been replaced: allocate them again and upload everything.</summary>
        public bool Replaced { get; private set; }
        public List<BufferRange> VertexRanges { get; private set; }
        public List<BufferRange> IndexRanges { get; private set; }
        /// <summary>Holds all vertices. It only grows between two snapshots.</summary>
        public Vec3 Min { get; private set; }
        public Vec3 Max { get; private set; }

        public SurfaceMesh()
        {
            Vertices = new MeshVertex[0];
            Indices = new uint[0];
            VertexRanges = new List<BufferRange>();
            IndexRanges = new List<BufferRange>();
        }

        /// <summary>Where the skin's texture coordinates come from, in view Surface. Null: they are 0.</summary>
        public SurfaceLookup Texture
        {
            get { return texture; }
            set
            {
                texture = value;
                Forget();
            }
        }

        /// <summary>Brings the buffers to the state's revision. Returns whether anything has changed.</summary>
        public bool Update(BodyState state)
        {
            Replaced = false;
            VertexRanges.Clear();
            IndexRanges.Clear();
            if (state != shown) Restart(state);
            else if (state.ChangedTriangles.Count + state.MovedVertices.Count == 0) return false;
            foreach (uint id in state.ChangedTriangles)
            {
                Remove(id);
                Add(id);
            }
            laidAnew.Clear();
            foreach (uint id in state.MovedVertices) Move(id);
            foreach (uint id in laidAnew)
            {
                Remove(id);
                Add(id);
            }
            state.ChangedTriangles.Clear();
            state.MovedVertices.Clear();
            foreach (int vertex in dirtyVertices) SetNormal(vertex);
            WriteIndices();
            if (!Replaced) FindRanges(dirtyVertices, 1, 0, VertexRanges);
            dirtyVertices.Clear();
            return true;
        }

        /// <summary>Nothing more is noted for it; the next Update() replaces everything.</summary>
        public void Forget()
        {
            if (shown != null) shown.NotesChanges = false;
            shown = null;
        }

        private void Restart(BodyState state)
        {
            Forget();
            shown = state;
            vertexOf.Clear();
            triangleOf.Clear();
            freeVertices.Clear();
            freeTriangles.Clear();
            foreach (var list in order) list.Clear();
            usedVertices = usedTriangles = 0;
            Replaced = true;
            double far = double.MaxValue;
            Min = new Vec3(far, far, far);
            Max = new Vec3(-far, -far, -far);
            state.NotesChanges = true;
            state.ChangedTriangles.Clear();
            state.MovedVertices.Clear();
            foreach (uint id in state.TriangleIds) Add(id);
        }

        // ---- Triangles ----

        private void Add(uint id)
        {
            BoundaryTriangle t;
            if (!shown.TryTriangle(id, out t)) return;
            int triangle = freeTriangles.Count > 0 ? freeTriangles.Pop() : usedTriangles++;
            if (triangle >= places.Length)
            {
                int room = Math.Max(64, 2 * places.Length);
                Array.Resize(ref corners, 3 * room);
                Array.Resize(ref next, 3 * room);
                Array.Resize(ref places, room);
                Array.Resize(ref inside, room);
                Array.Resize(ref ids, room);
            }
            triangleOf.Add(id, triangle);
            ids[triangle] = id;
            inside[triangle] = t.IsCut;
            int submesh = t.IsCut ? 1 : 0;
            var surface = shown as SurfaceState;
            if (texture == null || surface == null || !texture.CornerUvs(surface, id, uvs, 0)) Array.Clear(uvs, 0, 6);
            // Clockwise, as Unity wants it.
            Attach(3 * triangle, VertexFor(t.A, submesh, uvs[0], uvs[1]));
            Attach(3 * triangle + 1, VertexFor(t.C, submesh, uvs[4], uvs[5]));
            Attach(3 * triangle + 2, VertexFor(t.B, submesh, uvs[2], uvs[3]));
            places[triangle] = order[submesh].Count;
            dirtyPlaces[submesh].Add(places[triangle]);
            order[submesh].Add(triangle);
        }

        private void Attach(int corner, int vertex)
        {
            corners[corner] = vertex;
            next[corner] = first[vertex];
            first[vertex] = corner;
            Touch(vertex);
        }

        /// <summary>The normal of a vertex and its twins has changed.</summary>
        private void Touch(int vertex)
        {
            for (int twin = vertexOf[keys[vertex]]; twin != None; twin = twins[twin]) dirtyVertices.Add(twin);
        }

        private void Remove(uint id)
        {
            int triangle;
            if (!triangleOf.TryGetValue(id, out triangle)) return;
            triangleOf.Remove(id);
            freeTriangles.Push(triangle);
            for (int k = 0; k < 3; ++k) Detach(3 * triangle + k);
            // The last one takes its place.
            int submesh = inside[triangle] ? 1 : 0;
            List<int> list = order[submesh];
            int place = places[triangle], last = list[list.Count - 1];
            list[place] = last;
            places[last] = place;
            list.RemoveAt(list.Count - 1);
            dirtyPlaces[submesh].Add(place);
        }

        private void Detach(int corner)
        {
            int vertex = corners[corner];
            if (first[vertex] == corner)
            {
                first[vertex] = next[corner];
            }
            else
            {
                int before = first[vertex];
                while (next[before] != corner) before = next[before];
                next[before] = next[corner];
            }
            Touch(vertex);
            if (first[vertex] != None) return;
            int head = vertexOf[keys[vertex]];
            if (head != vertex)
            {
                while (twins[head] != vertex) head = twins[head];
                twins[head] = twins[vertex];
            }
            else if (twins[vertex] != None)
            {
                vertexOf[keys[vertex]] = twins[vertex];
            }
            else
            {
                vertexOf.Remove(keys[vertex]);
            }
            freeVertices.Push(vertex);
        }

        // ---- Vertices ----

        private int VertexFor(uint id, int submesh, float s, float t)
        {
            const float Same = 1e-4f; // of the texture: rounding is less, and a seam much more
            ulong key = 2UL * id + (uint)submesh;
            int head, vertex;
            if (!vertexOf.TryGetValue(key, out head)) head = None;
            for (int twin = head; twin != None; twin = twins[twin])
                if (Math.Abs(Vertices[twin].S - s) <= Same && Math.Abs(Vertices[twin].T - t) <= Same) return twin;
            vertex = freeVertices.Count > 0 ? freeVertices.Pop() : usedVertices++;
            if (vertex >= keys.Length)
            {
                int room = Math.Max(64, keys.Length + keys.Length / 2);
                MeshVertex[] vertices = Vertices;
                Array.Resize(ref vertices, room);
                Vertices = vertices;
                Array.Resize(ref keys, room);
                Array.Resize(ref first, room);
                Array.Resize(ref twins, room);
                Replaced = true;
            }
            vertexOf[key] = vertex;
            twins[vertex] = head;
            keys[vertex] = key;
            first[vertex] = None;
            Place(vertex, id, s, t);
            return vertex;
        }

        private void Place(int vertex, uint id, float s, float t)
        {
            Vec3 position, rest;
            shown.TryVertex(id, out position, out rest);
            position = UnityFrame.Convert(position);
            rest = UnityFrame.Convert(rest);
            Vertices[vertex] = new MeshVertex
            {
                X = (float)position.X, Y = (float)position.Y, Z = (float)position.Z, U = (float)rest.X, V = (float)rest.Y, W = (float)rest.Z, S = s, T = t
            };
            Min = new Vec3(Math.Min(Min.X, position.X), Math.Min(Min.Y, position.Y), Math.Min(Min.Z, position.Z));
            Max = new Vec3(Math.Max(Max.X, position.X), Math.Max(Max.Y, position.Y), Math.Max(Max.Z, position.Z));
        }

        /// <summary>A vertex that has moved changes the normals around it; one that rests elsewhere, the texture there, too.</summary>
        private void Move(uint id)
        {
            for (uint submesh = 0; submesh < 2; ++submesh)
            {
                int vertex;
                if (!vertexOf.TryGetValue(2UL * id + submesh, out vertex)) continue;
                for (; vertex != None; vertex = twins[vertex])
                {
                    MeshVertex before = Vertices[vertex];
                    Place(vertex, id, before.S, before.T);
                    bool rests = before.U == Vertices[vertex].U && before.V == Vertices[vertex].V && before.W == Vertices[vertex].W;
                    for (int c = first[vertex]; c != None; c = next[c])
                    {
                        for (int k = 0; k < 3; ++k) Touch(corners[c / 3 * 3 + k]);
                        if (texture != null && submesh == 0 && !rests) laidAnew.Add(ids[c / 3]);
                    }
                }
            }
        }

        /// <summary>The mean of the triangles' normals at it and its twins, weighted by area.</summary>
        private void SetNormal(int vertex)
        {
            var sum = new Vec3();
            if (vertexOf.Count == 0 || first[vertex] == None) return;
            for (int twin = vertexOf[keys[vertex]]; twin != None; twin = twins[twin])
            {
                for (int c = first[twin]; c != None; c = next[c])
                {
                    int at = c / 3 * 3;
                    Vec3 a = PositionOf(corners[at]);
                    sum += Vec3.Cross(PositionOf(corners[at + 1]) - a, PositionOf(corners[at + 2]) - a);
                }
            }
            double size = sum.Length;
            if (size > 0) sum = (1 / size) * sum;
            Vertices[vertex].NormalX = (float)sum.X;
            Vertices[vertex].NormalY = (float)sum.Y;
            Vertices[vertex].NormalZ = (float)sum.Z;
        }

        private Vec3 PositionOf(int vertex)
        {
            return new Vec3(Vertices[vertex].X, Vertices[vertex].Y, Vertices[vertex].Z);
        }

        // ---- Buffers ----

        private void WriteIndices()
        {
            if (Replaced || SkinCount > InsideStart || InsideStart + InsideCount > Indices.Length)
            {
                int skin = order[0].Count + order[0].Count / 2 + 64, rest = order[1].Count + order[1].Count / 2 + 64;
                Replaced = true;
                InsideStart = 3 * skin;
                Indices = new uint[3 * (skin + rest)];
            }
            for (int submesh = 0; submesh < 2; ++submesh)
            {
                int start = submesh * InsideStart;
                HashSet<int> dirty = dirtyPlaces[submesh];
                if (Replaced)
                {
                    for (int place = 0; place < order[submesh].Count; ++place) WriteTriangle(order[submesh][place], start + 3 * place);
                }
                else
                {
                    dirty.RemoveWhere(place => place >= order[submesh].Count);
                    foreach (int place in dirty) WriteTriangle(order[submesh][place], start + 3 * place);
                    FindRanges(dirty, 3, start, IndexRanges);
                }
                dirty.Clear();
            }
        }

        private void WriteTriangle(int triangle, int at)
        {
            for (int k = 0; k < 3; ++k) Indices[at + k] = (uint)corners[3 * triangle + k];
        }

        /// <summary>Ranges that cover these entries, each of so many elements. Gaps are filled until there are few enough.</summary>
        private static void FindRanges(HashSet<int> entries, int elements, int start, List<BufferRange> ranges)
        {
            var sorted = new int[entries.Count];
            entries.CopyTo(sorted);
            Array.Sort(sorted);
            int before = ranges.Count;
            for (long gap = 8; ; gap *= 4)
            {
                ranges.RemoveRange(before, ranges.Count - before);
                for (int i = 0; i < sorted.Length;)
                {
                    int from = sorted[i], to = from + 1;
                    for (++i; i < sorted.Length && sorted[i] - to <= gap; ++i) to = sorted[i] + 1;
                    ranges.Add(new BufferRange { Start = start + elements * from, Count = elements * (to - from) });
                }
                if (ranges.Count - before <= MaxRanges) return;
            }
        }
    }
}
