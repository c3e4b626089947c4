using System;

namespace Incise
{
    /// <summary>The hash of one element; a state's hash is the XOR over its elements. PROTOCOL.md, section 6.</summary>
    public struct StateHash
    {
        private uint a, b;

        private StateHash(uint kind)
        {
            unchecked
            {
                a = kind * 0x9e3779b1u;
                b = ~kind * 0x85ebca77u;
            }
        }

        private void Add(uint word)
        {
            unchecked
            {
                a = Rotate(a ^ (word * 0xcc9e2d51u), 13) * 5 + 0xe6546b64u;
                b = Rotate(b ^ (word * 0x1b873593u), 17) * 9 + 0x38495ab5u;
            }
        }

        private void Add(double number)
        {
            ulong bits = unchecked((ulong)BitConverter.DoubleToInt64Bits(number));
            Add((uint)(bits & 0xffffffffu));
            Add((uint)(bits >> 32));
        }

        private ulong Value
        {
            get
            {
                uint low = Mix(a ^ Rotate(b, 7));
                uint high = Mix(unchecked(b + low));
                return (ulong)high << 32 | low;
            }
        }

        private static uint Rotate(uint x, int n)
        {
            return x << n | x >> (32 - n);
        }

        private static uint Mix(uint h)
        {
            unchecked
            {
                h ^= h >> 16;
                h *= 0x85ebca6bu;
                h ^= h >> 13;
                h *= 0xc2b2ae35u;
                return h ^ (h >> 16);
            }
        }

        /// <summary>A vertex of the volume at positions[at], positions[at + 1], positions[at + 2].</summary>
        public static ulong Vertex(uint id, double[] positions, int at)
        {
            var hash = new StateHash(1);
            hash.Add(id);
            for (int k = 0; k < 3; ++k) hash.Add(positions[at + k]);
            return hash.Value;
        }

        /// <summary>A tetrahedron with vertices[at] to vertices[at + 3].</summary>
        public static ulong Tet(uint id, uint[] vertices, int at, int region, byte cutMask)
        {
            var hash = new StateHash(2);
            hash.Add(id);
            for (int k = 0; k < 4; ++k) hash.Add(vertices[at + k]);
            hash.Add(unchecked((uint)region));
            hash.Add((uint)cutMask);
            return hash.Value;
        }

        /// <summary>A boundary triangle with vertices[at] to vertices[at + 2].</summary>
        public static ulong Triangle(uint id, uint[] vertices, int at, byte flags)
        {
            var hash = new StateHash(3);
            hash.Add(id);
            for (int k = 0; k < 3; ++k) hash.Add(vertices[at + k]);
            hash.Add((uint)flags);
            return hash.Value;
        }

        /// <summary>A vertex of the surface; the bits of its floats are bits[at] to bits[at + 2].</summary>
        public static ulong SurfaceVertex(uint id, uint[] bits, int at)
        {
            var hash = new StateHash(4);
            hash.Add(id);
            for (int k = 0; k < 3; ++k) hash.Add(bits[at + k]);
            return hash.Value;
        }
    }
}
