using Incise;
using UnityEngine;

namespace InciseUnity
{
    /// <summary>Unity's types as Incise's and back. The axes stay: UnityFrame converts those.</summary>
    public static class Conversions
    {
        public static Vec3 ToIncise(this Vector3 v)
        {
            return new Vec3(v.x, v.y, v.z);
        }

        public static Quat ToIncise(this Quaternion q)
        {
            return new Quat(q.w, q.x, q.y, q.z);
        }

        public static Vector3 ToUnity(this Vec3 v)
        {
            return new Vector3((float)v.X, (float)v.Y, (float)v.Z);
        }

        public static Quaternion ToUnity(this Quat q)
        {
            return new Quaternion((float)q.X, (float)q.Y, (float)q.Z, (float)q.W);
        }

        /// <summary>Scale is that along x: a body must not be stretched.</summary>
        public static Placement ToPlacement(this Transform transform)
        {
            return new Placement
            {
                Position = transform.position.ToIncise(), Rotation = transform.rotation.ToIncise(), Scale = transform.lossyScale.x
            };
        }
    }
}
