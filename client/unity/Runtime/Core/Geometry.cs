using System;

namespace Incise
{
    /// <summary>A point, direction or force. Metres, newtons.</summary>
    public struct Vec3
    {
        public double X, Y, Z;

        public Vec3(double x, double y, double z)
        {
            X = x;
            Y = y;
            Z = z;
        }

        public static Vec3 operator +(Vec3 a, Vec3 b)
        {
            return new Vec3(a.X + b.X, a.Y + b.Y, a.Z + b.Z);
        }

        public static Vec3 operator -(Vec3 a, Vec3 b)
        {
            return new Vec3(a.X - b.X, a.Y - b.Y, a.Z - b.Z);
        }

        public static Vec3 operator *(double s, Vec3 a)
        {
            return new Vec3(s * a.X, s * a.Y, s * a.Z);
        }

        public static double Dot(Vec3 a, Vec3 b)
        {
            return a.X * b.X + a.Y * b.Y + a.Z * b.Z;
        }

        public static Vec3 Cross(Vec3 a, Vec3 b)
        {
            return new Vec3(a.Y * b.Z - a.Z * b.Y, a.Z * b.X - a.X * b.Z, a.X * b.Y - a.Y * b.X);
        }

        public double Length
        {
            get { return Math.Sqrt(Dot(this, this)); }
        }

        public bool IsFinite
        {
            get
            {
                double sum = X + Y + Z; // NaN or infinite if one of them is
                return !double.IsNaN(sum) && !double.IsInfinity(sum);
            }
        }

        public override string ToString()
        {
            return X + " " + Y + " " + Z;
        }
    }

    /// <summary>A rotation, Hamilton convention, of unit length.</summary>
    public struct Quat
    {
        public double W, X, Y, Z;

        public Quat(double w, double x, double y, double z)
        {
            W = w;
            X = x;
            Y = y;
            Z = z;
        }

        public static Quat Identity
        {
            get { return new Quat(1, 0, 0, 0); }
        }

        public Quat Inverse
        {
            get { return new Quat(W, -X, -Y, -Z); }
        }

        public static Quat operator *(Quat a, Quat b)
        {
            return new Quat(a.W * b.W - a.X * b.X - a.Y * b.Y - a.Z * b.Z, a.W * b.X + a.X * b.W + a.Y * b.Z - a.Z * b.Y,
                a.W * b.Y - a.X * b.Z + a.Y * b.W + a.Z * b.X, a.W * b.Z + a.X * b.Y - a.Y * b.X + a.Z * b.W);
        }

        public Vec3 Rotate(Vec3 v)
        {
            var axis = new Vec3(X, Y, Z);
            Vec3 t = 2 * Vec3.Cross(axis, v);
            return v + W * t + Vec3.Cross(axis, t);
        }

        /// <summary>Of unit length; the identity if it has no usable length.</summary>
        public Quat Normalized
        {
            get
            {
                double size = Math.Sqrt(W * W + X * X + Y * Y + Z * Z);
                return size > 1e-9 && !double.IsInfinity(size) ? new Quat(W / size, X / size, Y / size, Z / size) : Identity;
            }
        }
    }

    /// <summary>A box in the mesh's frame, metres.</summary>
    public sealed class Box
    {
        public Vec3 Min, Max;

        public Box(Vec3 min, Vec3 max)
        {
            Min = min;
            Max = max;
        }
    }

    /// <summary>The blade's edge in the tool's frame, metres.</summary>
    public sealed class BladeEdge
    {
        public Vec3 Heel, Tip;

        public BladeEdge(Vec3 heel, Vec3 tip)
        {
            Heel = heel;
            Tip = tip;
        }
    }

    /// <summary>
    /// The one place where frames are converted. Incise's frame is right-handed, that of the mesh as loaded; Unity's is
    /// left-handed with y up. Swapping y and z turns the one into the other, and a mesh whose z points up stands upright.
    /// Seen from outside, a triangle that is counter-clockwise here still is so there, and Unity draws clockwise ones:
    /// its last two corners are swapped, too.
    /// </summary>
    public static class UnityFrame
    {
        /// <summary>A point, direction or force, either way.</summary>
        public static Vec3 Convert(Vec3 v)
        {
            return new Vec3(v.X, v.Z, v.Y);
        }

        /// <summary>A rotation, either way. A reflection turns an axis round: the rotation about it runs the other way.</summary>
        public static Quat Convert(Quat q)
        {
            return new Quat(q.W, -q.X, -q.Z, -q.Y);
        }
    }
}
