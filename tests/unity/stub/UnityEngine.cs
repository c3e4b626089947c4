// As much of Unity's API as the package uses, with Unity's names and types, so that it compiles and runs without Unity: values
// that behave, objects that hold components, a Mesh that keeps its buffers, and Player, which calls what Unity calls.

using System;
using System.Collections.Generic;
using System.Reflection;
using System.Runtime.InteropServices;
using UnityEngine.Rendering;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }

        public static Vector3 zero { get { return new Vector3(); } }
        public static Vector3 operator +(Vector3 a, Vector3 b) { return new Vector3(a.x + b.x, a.y + b.y, a.z + b.z); }
        public static Vector3 operator -(Vector3 a, Vector3 b) { return new Vector3(a.x - b.x, a.y - b.y, a.z - b.z); }
        public static Vector3 operator *(Vector3 a, float s) { return new Vector3(a.x * s, a.y * s, a.z * s); }
        public float magnitude { get { return (float)Math.Sqrt(x * x + y * y + z * z); } }
    }

    public struct Quaternion
    {
        public float x, y, z, w;

        public Quaternion(float x, float y, float z, float w)
        {
            this.x = x;
            this.y = y;
            this.z = z;
            this.w = w;
        }

        public static Quaternion identity { get { return new Quaternion(0, 0, 0, 1); } }
    }

    public struct Color
    {
        public float r, g, b;

        public Color(float r, float g, float b)
        {
            this.r = r;
            this.g = g;
            this.b = b;
        }
    }

    public struct Bounds
    {
        private Vector3 min, max;
        public void SetMinMax(Vector3 low, Vector3 high)
        {
            min = low;
            max = high;
        }
        public Vector3 center { get { return (min + max) * 0.5f; } }
        public Vector3 extents { get { return (max - min) * 0.5f; } }
    }

    public static class Mathf
    {
        public static float Max(float a, float b) { return Math.Max(a, b); }
        public static float Floor(float x) { return (float)Math.Floor(x); }
        public static float PingPong(float t, float length)
        {
            float r = t - Floor(t / (2 * length)) * 2 * length;
            return length - Math.Abs(r - length);
        }
    }

    public static class Time
    {
        public static float time;
    }

    public static class Debug
    {
        public static readonly List<string> Lines = new List<string>();
        public static void Log(object message, Object context) { Lines.Add("log: " + message); }
        public static void LogError(object message, Object context) { Lines.Add("error: " + message); }
        public static void LogWarning(object message, Object context) { Lines.Add("warning: " + message); }
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class AddComponentMenu : Attribute
    {
        public AddComponentMenu(string menuName) { }
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class DefaultExecutionOrder : Attribute
    {
        public readonly int order;
        public DefaultExecutionOrder(int order) { this.order = order; }
    }

    [AttributeUsage(AttributeTargets.Class, AllowMultiple = true)]
    public sealed class RequireComponent : Attribute
    {
        public RequireComponent(Type first, Type second) { }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class TooltipAttribute : Attribute
    {
        public TooltipAttribute(string tooltip) { }
    }

    public class Object
    {
        public string name { get; set; }
        public static void Destroy(Object obj)
        {
            if (obj is Component c) c.gameObject.Components.Remove(c);
        }
    }

    public class Component : Object
    {
        public GameObject gameObject { get; internal set; }
        public Transform transform { get { return gameObject.transform; } }
        public T GetComponent<T>() where T : Component { return gameObject.GetComponent<T>(); }
    }

    public class Behaviour : Component { }

    public class MonoBehaviour : Behaviour
    {
        internal bool Enabled, Started;
    }

    public sealed class Transform : Component
    {
        private Transform parent;
        public Vector3 position { get; set; } // world's: what the package uses has parents at the origin
        public Quaternion rotation = Quaternion.identity;
        public Vector3 localScale = new Vector3(1, 1, 1);
        public Vector3 lossyScale { get { return localScale; } }
        public void SetParent(Transform p) { parent = p; }
        public bool IsChildOf(Transform p) { return Under(p.gameObject); }
        internal bool Under(GameObject root) { return gameObject == root || parent != null && parent.Under(root); }

        public Vector3 TransformPoint(Vector3 p)
        {
            var q = new Incise.Quat(rotation.w, rotation.x, rotation.y, rotation.z);
            Incise.Vec3 turned = q.Rotate(new Incise.Vec3(p.x * localScale.x, p.y * localScale.y, p.z * localScale.z));
            return position + new Vector3((float)turned.X, (float)turned.Y, (float)turned.Z);
        }
    }

    public class Renderer : Component
    {
        public Material sharedMaterial { get; set; }
        public Material[] sharedMaterials { get; set; }
    }

    public sealed class MeshRenderer : Renderer { }

    public sealed class MeshFilter : Component
    {
        public Mesh sharedMesh { get; set; }
    }

    public sealed class Material : Object
    {
        public Material() { }
        public Material(Material source) { }
        public Color color { get; set; }
    }

    public enum PrimitiveType { Sphere, Capsule, Cylinder, Cube }

    public sealed class GameObject : Object
    {
        internal static readonly List<GameObject> All = new List<GameObject>();
        internal readonly List<Component> Components = new List<Component>();
        private bool active = true;
        public Transform transform { get; private set; }

        public GameObject(string name, params Type[] components)
        {
            this.name = name;
            All.Add(this);
            transform = AddComponent<Transform>();
            foreach (Type type in components) Add((Component)Activator.CreateInstance(type));
        }

        public static GameObject CreatePrimitive(PrimitiveType type)
        {
            var made = new GameObject(type.ToString(), typeof(MeshFilter), typeof(MeshRenderer));
            made.GetComponent<Renderer>().sharedMaterial = new Material();
            return made;
        }

        public T AddComponent<T>() where T : Component
        {
            return (T)Add((Component)Activator.CreateInstance(typeof(T)));
        }

        private Component Add(Component made)
        {
            made.gameObject = this;
            Components.Add(made);
            return made;
        }

        public T GetComponent<T>() where T : Component
        {
            foreach (Component c in Components)
                if (c is T found) return found;
            return null;
        }

        public void SetActive(bool value) { active = value; }

        internal bool IsActive
        {
            get
            {
                foreach (GameObject other in All)
                    if (!other.active && transform.Under(other)) return false;
                return true;
            }
        }
    }

    public enum MeshTopology { Triangles = 0 }

    /// <summary>Keeps the bytes that the graphics card would have.</summary>
    public sealed class Mesh : Object
    {
        public byte[] VertexBytes = { };
        public uint[] IndexBuffer = { };
        public SubMeshDescriptor[] SubMeshes = { };
        public int Stride;
        public long UploadedVertices, UploadedIndices; // elements, in all
        public int WholeUploads;

        public Bounds bounds { get; set; }
        public int subMeshCount { set { SubMeshes = new SubMeshDescriptor[value]; } }
        public void MarkDynamic() { }
        public void Clear() { SubMeshes = new SubMeshDescriptor[0]; }

        public void SetVertexBufferParams(int vertexCount, params VertexAttributeDescriptor[] attributes)
        {
            Stride = 0;
            foreach (VertexAttributeDescriptor a in attributes) Stride += 4 * a.dimension;
            VertexBytes = new byte[vertexCount * Stride];
            ++WholeUploads;
        }

        public void SetIndexBufferParams(int indexCount, IndexFormat format) { IndexBuffer = new uint[indexCount]; }

        public void SetVertexBufferData<T>(T[] data, int dataStart, int meshBufferStart, int count, int stream = 0,
            MeshUpdateFlags flags = MeshUpdateFlags.Default) where T : struct
        {
            int size = Marshal.SizeOf(typeof(T));
            if (size != Stride) throw new ArgumentException("elements of " + size + " bytes for a stride of " + Stride);
            GCHandle pinned = GCHandle.Alloc(data, GCHandleType.Pinned);
            Marshal.Copy(new IntPtr(pinned.AddrOfPinnedObject().ToInt64() + (long)dataStart * size), VertexBytes, meshBufferStart * size, count * size);
            pinned.Free();
            UploadedVertices += count;
        }

        public void SetIndexBufferData<T>(T[] data, int dataStart, int meshBufferStart, int count,
            MeshUpdateFlags flags = MeshUpdateFlags.Default) where T : struct
        {
            Array.Copy(data, dataStart, IndexBuffer, meshBufferStart, count);
            UploadedIndices += count;
        }

        public void SetSubMesh(int index, SubMeshDescriptor desc, MeshUpdateFlags flags = MeshUpdateFlags.Default)
        {
            if (desc.indexStart + desc.indexCount > IndexBuffer.Length) throw new ArgumentException("a submesh beyond the indices");
            SubMeshes[index] = desc;
        }
    }

    /// <summary>Calls Unity's messages on all components, in Unity's order.</summary>
    public static class Player
    {
        public static void Frame(float seconds)
        {
            Time.time += seconds;
            var all = new List<MonoBehaviour>();
            foreach (GameObject o in GameObject.All)
                foreach (Component c in o.Components)
                    if (c is MonoBehaviour b && o.IsActive) all.Add(b);
            all.Sort((a, b) => Order(a).CompareTo(Order(b)));
            foreach (MonoBehaviour b in all)
            {
                if (!b.Enabled) Call(b, "OnEnable");
                b.Enabled = true;
            }
            foreach (MonoBehaviour b in all)
            {
                if (!b.Started) Call(b, "Start");
                b.Started = true;
            }
            foreach (string message in new[] { "FixedUpdate", "Update", "LateUpdate" })
                foreach (MonoBehaviour b in all) Call(b, message);
        }

        public static T Find<T>() where T : Component
        {
            foreach (GameObject o in GameObject.All)
                if (o.GetComponent<T>() != null) return o.GetComponent<T>();
            return null;
        }

        public static void Quit()
        {
            foreach (GameObject o in GameObject.All)
                foreach (Component c in o.Components)
                    if (c is MonoBehaviour b && b.Enabled) Call(b, "OnDisable");
            GameObject.All.Clear();
        }

        private static int Order(MonoBehaviour b)
        {
            var found = (DefaultExecutionOrder[])b.GetType().GetCustomAttributes(typeof(DefaultExecutionOrder), true);
            return found.Length > 0 ? found[0].order : 0;
        }

        public static void Call(MonoBehaviour b, string message)
        {
            MethodInfo method = b.GetType().GetMethod(message, 
                BindingFlags.Instance | BindingFlags.NonPublic | BindingFlags.Public);
            if (method != null) method.Invoke(b, null);
        }
    }
}

namespace UnityEngine.Rendering
{
    public enum IndexFormat { UInt16 = 0, UInt32 = 1 }

    public enum VertexAttribute { Position = 0, Normal = 1, TexCoord0 = 4, TexCoord1 = 5 }

    public enum VertexAttributeFormat { Float32 = 0 }

    [Flags]
    public enum MeshUpdateFlags { Default = 0, DontValidateIndices = 1, DontResetBoneBounds = 2, DontNotifyMeshUsers = 4, DontRecalculateBounds = 8 }

    public struct VertexAttributeDescriptor
    {
        public int dimension { get; set; }
        public VertexAttributeDescriptor(VertexAttribute attribute = VertexAttribute.Position,
            VertexAttributeFormat format = VertexAttributeFormat.Float32, int dimension = 3, int stream = 0)
        {
            this.dimension = dimension;
        }
    }

    public struct SubMeshDescriptor
    {
        public Bounds bounds { get; set; }
        public int indexStart { get; set; }
        public int indexCount { get; set; }
        public int firstVertex { get; set; }
        public int vertexCount { get; set; }
        public SubMeshDescriptor(int indexStart, int indexCount, MeshTopology topology = MeshTopology.Triangles)
        {
            bounds = new Bounds();
            this.indexStart = indexStart;
            this.indexCount = indexCount;
            firstVertex = vertexCount = 0;
        }
    }
}
