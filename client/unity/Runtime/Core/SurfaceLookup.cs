using System;
using System.Collections.Generic;

namespace Incise
{
    /// <summary>
    /// Texture coordinates on the cut body, from the surface that it was filled from (PROTOCOL.md, section 5). Read the asset with
    /// MessageReader from the bytes that the server's HTTP port answers at Welcome.Surface.Path.
    /// </summary>
    public sealed class SurfaceLookup
    {
        /// <summary>The origin of a face that has none.</summary>
        public const uint None = 0xffffffff;
        private const int MaxSteps = 16; // a face spans few triangles

        private readonly SurfaceAsset asset;
        private readonly uint[] beside; // by corner: the triangle across the edge opposite to it; None: a seam

        public SurfaceLookup(SurfaceAsset asset)
        {
            this.asset = asset;
            beside = new uint[asset.Triangles.Length];
            var waiting = new Dictionary<string, int>();
            for (int c = 0; c < beside.Length; ++c)
            {
                beside[c] = None;
                string a = EndOf(c - c % 3 + (c + 1) % 3), b = EndOf(c - c % 3 + (c + 2) % 3);
                string key = string.CompareOrdinal(a, b) < 0 ? a + ";" + b : b + ";" + a;
                if (asset.MaterialIndices.Length > 0) key += ";" + asset.MaterialIndices[c / 3];
                int other;
                if (!waiting.TryGetValue(key, out other))
                {
                    waiting.Add(key, c);
                    continue;
                }
                waiting.Remove(key);
                beside[c] = (uint)(other / 3);
                beside[other] = (uint)(c / 3);
            }
        }

        private string EndOf(int corner)
        {
            string end = asset.Triangles[corner].ToString();
            if (asset.Uvs.Length == 0) return end;
            return end + "," + BitConverter.ToInt32(BitConverter.GetBytes(asset.Uvs[2 * corner] + 0f), 0) + "," +
                   BitConverter.ToInt32(BitConverter.GetBytes(asset.Uvs[2 * corner + 1] + 0f), 0);
        }

        /// <summary>
        /// Writes u and v of a face's corners, which rest at these places, to six entries of `uvs` from `at` on. Returns false where the
        /// face has no origin, or the surface no texture coordinates.
        /// </summary>
        public bool CornerUvs(uint origin, Vec3 restA, Vec3 restB, Vec3 restC, float[] uvs, int at)
        {
            if (asset.Uvs.Length == 0 || origin >= beside.Length / 3) return false;
            Write(origin, restA, uvs, at);
            Write(origin, restB, uvs, at + 2);
            Write(origin, restC, uvs, at + 4);
            return true;
        }

        /// <summary>Of a triangle of view Surface.</summary>
        public bool CornerUvs(SurfaceState state, uint triangle, float[] uvs, int at)
        {
            BoundaryTriangle t;
            Vec3 position, a, b, c;
            return state.TryTriangle(triangle, out t) && state.TryVertex(t.A, out position, out a) && state.TryVertex(t.B, out position, out b) &&
                   state.TryVertex(t.C, out position, out c) && CornerUvs(state.OriginOf(triangle), a, b, c, uvs, at);
        }

        private void Write(uint origin, Vec3 rest, float[] uvs, int to)
        {
            double[] weights;
            int corner = 3 * (int)Find(origin, rest, out weights);
            for (int i = 0; i < 2; ++i)
            {
                double sum = 0;
                for (int k = 0; k < 3; ++k) sum += weights[k] * asset.Uvs[2 * (corner + k) + i];
                uvs[to + i] = (float)sum;
            }
        }

        /// <summary>Goes on from the origin across the edge that the point is farthest beyond, but across no seam.</summary>
        private uint Find(uint origin, Vec3 rest, out double[] weights)
        {
            uint at = origin, before = None;
            weights = Barycentric(at, rest);
            for (int step = 0; step < MaxSteps; ++step)
            {
                int least = weights[0] <= weights[1] && weights[0] <= weights[2] ? 0 : weights[1] <= weights[2] ? 1 : 2;
                uint next = beside[3 * at + least];
                if (weights[least] >= 0 || next == None || next == before) break;
                before = at;
                at = next;
                weights = Barycentric(at, rest);
            }
            return at;
        }

        private Vec3 Corner(uint triangle, int k)
        {
            uint v = asset.Triangles[3 * triangle + k];
            return new Vec3(asset.Positions[3 * v], asset.Positions[3 * v + 1], asset.Positions[3 * v + 2]);
        }

        private double[] Barycentric(uint triangle, Vec3 p)
        {
            Vec3 a = Corner(triangle, 0), ab = Corner(triangle, 1) - a, ac = Corner(triangle, 2) - a, ap = p - a;
            Vec3 normal = Vec3.Cross(ab, ac);
            double area = Vec3.Dot(normal, normal);
            double b = Vec3.Dot(Vec3.Cross(ap, ac), normal) / area, c = Vec3.Dot(Vec3.Cross(ab, ap), normal) / area;
            return new[] { 1 - b - c, b, c };
        }
    }
}
