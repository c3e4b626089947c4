using System.Threading;
using Incise;
using UnityEngine;
using UnityEngine.Rendering;

namespace InciseUnity
{
    /// <summary>
    /// Draws the body that a connection follows: the renderer's first material is its skin, the second its inside. Each frame
    /// uploads only what has changed. One body a connection. The Transform may move, turn and scale (evenly) the body.
    /// </summary>
    [AddComponentMenu("Incise/Body")]
    [RequireComponent(typeof(MeshFilter), typeof(MeshRenderer))]
    public sealed class InciseBody : MonoBehaviour
    {
        private const MeshUpdateFlags Unchecked =
            MeshUpdateFlags.DontValidateIndices | MeshUpdateFlags.DontRecalculateBounds | MeshUpdateFlags.DontNotifyMeshUsers;

        public InciseConnection connection;

        private readonly SurfaceMesh surface = new SurfaceMesh();
        private Mesh mesh;

        /// <summary>The surface that the body was filled from: its texture coordinates go to TEXCOORD1, in view Surface.</summary>
        public SurfaceLookup Texture
        {
            get { return surface.Texture; }
            set { surface.Texture = value; }
        }

        /// <summary>The revision that is drawn, and whether there is one.</summary>
        public ulong Revision { get; private set; }
        public bool HasBody { get; private set; }

        private void OnEnable()
        {
            mesh = new Mesh { name = "Incise body" };
            mesh.MarkDynamic();
            GetComponent<MeshFilter>().sharedMesh = mesh;
            HasBody = false;
        }

        private void OnDisable()
        {
            surface.Forget();
            Destroy(mesh);
            mesh = null;
        }

        private void LateUpdate()
        {
            Client client = connection != null ? connection.Client : null;
            if (client == null) return;
            // While a large change is being made, the next frame shows it: this one does not wait.
            if (!Monitor.TryEnter(client.Lock)) return;
            try
            {
                BodyState state = client.State;
                if (state == null || !surface.Update(state)) return;
                Revision = state.Revision;
            }
            finally
            {
                Monitor.Exit(client.Lock);
            }
            HasBody = true;
            Upload();
        }

        private void Upload()
        {
            if (surface.Replaced)
            {
                mesh.Clear();
                mesh.SetVertexBufferParams(surface.Vertices.Length, new VertexAttributeDescriptor(VertexAttribute.Position),
                    new VertexAttributeDescriptor(VertexAttribute.Normal), new VertexAttributeDescriptor(VertexAttribute.TexCoord0),
                    new VertexAttributeDescriptor(VertexAttribute.TexCoord1, VertexAttributeFormat.Float32, 2));
                mesh.SetIndexBufferParams(surface.Indices.Length, IndexFormat.UInt32);
                mesh.SetVertexBufferData(surface.Vertices, 0, 0, surface.Vertices.Length, 0, Unchecked);
                mesh.SetIndexBufferData(surface.Indices, 0, 0, surface.Indices.Length, Unchecked);
                mesh.subMeshCount = 2;
            }
            foreach (BufferRange range in surface.VertexRanges)
                mesh.SetVertexBufferData(surface.Vertices, range.Start, range.Start, range.Count, 0, Unchecked);
            foreach (BufferRange range in surface.IndexRanges)
                mesh.SetIndexBufferData(surface.Indices, range.Start, range.Start, range.Count, Unchecked);
            var bounds = new Bounds();
            if (surface.SkinCount + surface.InsideCount > 0) bounds.SetMinMax(surface.Min.ToUnity(), surface.Max.ToUnity());
            SetSubMesh(0, 0, surface.SkinCount, bounds);
            SetSubMesh(1, surface.InsideStart, surface.InsideCount, bounds);
            mesh.bounds = bounds;
        }

        private void SetSubMesh(int submesh, int start, int count, Bounds bounds)
        {
            var part = new SubMeshDescriptor(start, count) { bounds = bounds, firstVertex = 0, vertexCount = surface.Vertices.Length };
            mesh.SetSubMesh(submesh, part, Unchecked);
        }
    }
}
