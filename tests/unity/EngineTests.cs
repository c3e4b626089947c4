using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;
using System.Threading;
using Incise;
using InciseUnity;
using UnityEngine;

/// <summary>The MonoBehaviours in tests/unity/stub, which stands for Unity: the sample, against the built incised.</summary>
public static class EngineTests
{
    /// <summary>The sample's blade cuts the body, and the mesh's buffers hold what the client holds.</summary>
    public static void TheSampleCutsABody()
    {
        using (var server = new Server())
        {
            UnityEngine.Debug.Lines.Clear();
            var sample = new GameObject("Sample").AddComponent<FirstCut>();
            sample.port = server.Port;
            sample.secondsPerSweep = 2;
            InciseBody body = null;
            DateTime end = DateTime.UtcNow.AddSeconds(120);
            for (int frames = 0; body == null || frames < 300 || body.GetComponent<MeshFilter>().sharedMesh.SubMeshes[1].indexCount < 300; ++frames)
            {
                Check.That(DateTime.UtcNow < end, "nothing is cut");
                Player.Frame(0.02f);
                Thread.Sleep(5);
                if (body == null || !body.HasBody) frames = 0;
                body = Find<InciseBody>();
            }
            UnityEngine.Mesh mesh = body.GetComponent<MeshFilter>().sharedMesh;
            Client client = Find<InciseConnection>().Client;
            Check.That(UnityEngine.Debug.Lines.Contains("log: Incise: connected to 127.0.0.1:" + server.Port), string.Join(", ", UnityEngine.Debug.Lines));
            Find<InciseBlade>().connection = null; // from here on nothing is sent
            CheckHolds(mesh, client, Hands.Settled(server));
            Check.That(mesh.UploadedVertices < 50L * mesh.VertexBytes.Length / mesh.Stride, "uploaded vertices: " + mesh.UploadedVertices);
            server.Kill();
            for (int i = 0; i < 400 && UnityEngine.Debug.Lines.Count < 2; ++i)
            {
                Player.Frame(0.02f);
                Thread.Sleep(5);
            }
            Check.That(UnityEngine.Debug.Lines[1].StartsWith("warning: Incise: ") && UnityEngine.Debug.Lines[1].EndsWith("; connecting again"), UnityEngine.Debug.Lines[1]);
            Player.Quit();
            Check.Equal(client.Status, ClientStatus.Closed, "after the end");
        }
    }

    private static T Find<T>() where T : MonoBehaviour
    {
        return Player.Find<T>();
    }

    private static void CheckHolds(UnityEngine.Mesh mesh, Client client, Welcome server)
    {
        Check.That(client.WaitForRevision(server.Revision, 60), client.LastError);
        for (int i = 0; i < 20; ++i) Player.Frame(0.02f);
        var fresh = new SurfaceMesh();
        List<string> expected;
        lock (client.Lock)
        {
            Check.Equal(client.State.StateHash, server.StateHash, "state hash");
            fresh.Update(client.State);
            expected = Hands.Drawn(fresh.Vertices, fresh.Indices, fresh.SkinCount, fresh.InsideStart, fresh.InsideCount);
        }
        var vertices = new MeshVertex[mesh.VertexBytes.Length / mesh.Stride];
        GCHandle pinned = GCHandle.Alloc(vertices, GCHandleType.Pinned);
        Marshal.Copy(mesh.VertexBytes, 0, pinned.AddrOfPinnedObject(), mesh.VertexBytes.Length);
        pinned.Free();
        List<string> drawn = Hands.Drawn(vertices, mesh.IndexBuffer, mesh.SubMeshes[0].indexCount, mesh.SubMeshes[1].indexStart, mesh.SubMeshes[1].indexCount);
        Check.Equal(drawn.Count, expected.Count, "triangles drawn");
        for (int i = 0; i < drawn.Count; ++i) Check.Equal(drawn[i], expected[i], "drawn triangle");
    }

    /// <summary>A device's thread drives the blade in a magnified body: its Transform follows, and the force is the tissue's.</summary>
    public static void ADeviceDrivesTheBlade()
    {
        using (var server = new Server())
        {
            UnityEngine.Debug.Lines.Clear();
            var root = new GameObject("Incise", typeof(MeshFilter), typeof(MeshRenderer));
            root.SetActive(false);
            var connection = root.AddComponent<InciseConnection>();
            connection.port = server.Port;
            connection.bringsBlade = true;
            // Beside the hand, so that pushing turns it.
            connection.heel = new Vector3(0.03f, 0, 0);
            connection.tip = new Vector3(0.03f, -0.05f, 0);
            var body = new GameObject("Body", typeof(MeshFilter), typeof(MeshRenderer));
            body.transform.SetParent(root.transform);
            body.transform.localScale = new Vector3(10, 10, 10);
            body.transform.position = new Vector3(0, 3, 0);
            body.AddComponent<InciseBody>().connection = connection;
            var blade = new GameObject("Blade").AddComponent<InciseBlade>();
            blade.transform.SetParent(root.transform);
            blade.connection = connection;
            blade.body = body.GetComponent<InciseBody>();
            var device = new GameObject("Device").AddComponent<BreakableDevice>();
            device.transform.SetParent(root.transform);
            device.transform.position = body.transform.position;
            // A half turn about the vertical: the device looks the other way.
            device.transform.rotation = new Quaternion(0, 1, 0, 0);
            // The edge's tip is 2 cm above the body, then as deep in it.
            device.top = new Vector3(-0.05f, 0.1f, 0);
            device.scale = 10;
            device.blade = blade;
            root.SetActive(true);
            DateTime end = DateTime.UtcNow.AddSeconds(60);
            // The spring alone would give newtons. Where the machine pauses the device's thread for 50 ms the ramp begins again: then
            // only some hundredths are reached, and outward they are all the same. On the way up friction holds the blade back.
            while (device.Strongest.Force.y < 0.005f)
            {
                Check.That(DateTime.UtcNow < end, "no force outward: " + device.Strongest.Force.y);
                Player.Frame(0.02f);
                Thread.Sleep(5);
            }
            // Read once: the device's thread goes on.
            Load strongest = device.Strongest;
            Vector3 force = strongest.Force, turning = strongest.Torque;
            Check.That(force.y > 0.8f * force.magnitude, "the tissue pushes outward: " + force.y + " of " + force.magnitude);
            // That of the force somewhere between heel and tip.
            double low = 0.03 * force.y, high = low + 0.05 * force.x;
            Check.That(turning.z > 0.9 * Math.Min(low, high) && turning.z < 1.1 * Math.Max(low, high), "torque " + turning.z + " of " + low + " to " + high);
            double work = Vec3.Dot(turning.ToIncise(), force.ToIncise());
            Check.Near(work / (turning.magnitude * force.magnitude), 0, 0.05, "it is at right angles to the force");
            Vector3 at = blade.transform.position;
            Check.That(Math.Abs(at.x - 0.5f) < 1e-5 && at.y < 4 && at.y > 3.6f, "the Transform follows: " + at.x + " " + at.y);
            Check.That(blade.LastReport != null && blade.LastReport.SourceNs > 0, "the server's report");
            // A plugin that fails: no force stays on the hand, and the console says why.
            device.Breaks = true;
            while (UnityEngine.Debug.Lines.Count < 2)
            {
                Check.That(DateTime.UtcNow < end, "nothing is said");
                Player.Frame(0.02f);
                Thread.Sleep(5);
            }
            Check.Equal(UnityEngine.Debug.Lines[1], "error: Incise: the device's thread has ended: unplugged", "what is said");
            Check.Equal(device.Last.magnitude, 0f, "the last force");
            Player.Quit();
        }
    }

    private sealed class Load
    {
        public readonly Vector3 Force, Torque;

        public Load(Vector3 force, Vector3 torque)
        {
            Force = force;
            Torque = torque;
        }
    }

    private sealed class BreakableDevice : InciseDevice
    {
        public Vector3 top, Last;
        /// <summary>The most that pushed outward. Replaced as a whole, so that a reader has one force and its torque.</summary>
        public volatile Load Strongest = new Load(Vector3.zero, Vector3.zero);
        public volatile bool Breaks;
        private long begun;

        protected override bool MakesTorque { get { return true; } }

        protected override void Read(out Vector3 position, out Quaternion rotation, out bool cuts)
        {
            if (Breaks) throw new InvalidOperationException("unplugged");
            if (begun == 0) begun = Clock.NowNs;
            // In two seconds into the body, then four of pressing a little deeper, in which the ramp ends, and out.
            double time = (Clock.NowNs - begun) * 1e-9 % 8;
            double way = time < 2 ? 0.0175 * time : time < 6 ? 0.035 + 0.001 * (time - 2) : 0.039 * (8 - time) / 2;
            position = top + new Vector3(0, (float)-way, 0);
            rotation = Quaternion.identity;
            // Three pauses of a quarter of a second turn the force off; the button, pressed above the body, asks for it again.
            cuts = time < 0.2;
        }

        protected override void Apply(Vector3 force, Vector3 torque)
        {
            Last = force + torque;
            if (force.y > Strongest.Force.y) Strongest = new Load(force, torque);
        }
    }

    /// <summary>What the server says beside the state, a full disk for one, is said in Unity's console.</summary>
    public static void TheConsoleHasTheServersWarnings()
    {
        List<byte[]> messages = Vectors.Stream("surface");
        messages.Insert(1, System.IO.File.ReadAllBytes(Vectors.PathOf("messages/ErrorNotRecorded.bin")));
        using (var server = new PlayedServer(messages, 1))
        {
            UnityEngine.Debug.Lines.Clear();
            var connection = new GameObject("Incise").AddComponent<InciseConnection>();
            connection.port = server.Port;
            DateTime end = DateTime.UtcNow.AddSeconds(60);
            while (!UnityEngine.Debug.Lines.Exists(line => line.StartsWith("warning: Incise: NotRecorded: ")))
            {
                Check.That(DateTime.UtcNow < end, "nothing is said: " + string.Join(", ", UnityEngine.Debug.Lines));
                Player.Frame(0.02f);
                Thread.Sleep(5);
            }
            Player.Quit();
        }
    }

    /// <summary>The sample's device feels the body, too.</summary>
    public static void TheSampleDeviceFeelsTheBody()
    {
        using (var server = new Server())
        {
            var root = new GameObject("Incise");
            root.SetActive(false);
            var connection = root.AddComponent<InciseConnection>();
            connection.port = server.Port;
            connection.view = View.None;
            connection.bringsBlade = true;
            var blade = root.AddComponent<InciseBlade>();
            blade.connection = connection;
            var wrong = root.AddComponent<SimulatedDevice>();
            wrong.blade = blade;
            Check.Throws<System.Reflection.TargetInvocationException>(() => Player.Call(wrong, "OnEnable"), "a device on its blade");
            UnityEngine.Object.Destroy(wrong);
            var device = new GameObject("Device").AddComponent<SimulatedDevice>();
            device.blade = blade;
            root.SetActive(true);
            DateTime end = DateTime.UtcNow.AddSeconds(60);
            while (device.LargestForce < 0.005f)
            {
                Check.That(DateTime.UtcNow < end, "no force: " + device.LargestForce);
                Player.Frame(0.02f);
                Thread.Sleep(5);
            }
            Player.Quit();
        }
    }

    /// <summary>The sample for Haply's package, called by a thread as that does, and let go of in the midst of it.</summary>
    public static void TheInverse3SampleFeelsTheBody()
    {
        using (var server = new Server())
        {
            var root = new GameObject("Incise");
            root.SetActive(false);
            var connection = root.AddComponent<InciseConnection>();
            connection.port = server.Port;
            connection.view = View.None;
            connection.bringsBlade = true;
            var blade = root.AddComponent<InciseBlade>();
            blade.connection = connection;
            var haptic = new GameObject("Haptic Origin");
            haptic.transform.position = new Vector3(0.02f, 0.1f, 0);
            var inverse3 = haptic.AddComponent<Haply.Inverse.DeviceControllers.Inverse3Controller>();
            var sample = haptic.AddComponent<InciseInverse3>();
            sample.blade = blade;
            sample.inverse3 = inverse3;
            sample.grip = haptic.AddComponent<Haply.Inverse.DeviceControllers.VerseGripController>();
            root.SetActive(true);
            Player.Frame(0.02f);
            bool ends = false;
            float largest = 0;
            long begun = Clock.NowNs;
            var thread = new Thread(() =>
            {
                while (!Volatile.Read(ref ends))
                {
                    float way = (float)(0.02 * (Clock.NowNs - begun) * 1e-9 % 0.08);
                    inverse3.Tick(new Vector3(0, way < 0.04f ? -way : way - 0.08f, 0));
                    if (inverse3.LastForce.y > largest) largest = inverse3.LastForce.y;
                    Thread.Sleep(1);
                }
            });
            thread.Start();
            DateTime end = DateTime.UtcNow.AddSeconds(60);
            while (largest < 0.005f && DateTime.UtcNow < end)
            {
                Player.Frame(0.02f);
                Thread.Sleep(5);
            }
            Player.Quit();
            Check.That(inverse3.Released, "it is let go of");
            Thread.Sleep(20);
            Check.Equal(inverse3.LastForce.magnitude, 0f, "the last force");
            Volatile.Write(ref ends, true);
            thread.Join();
            Check.That(largest >= 0.005f, "no force: " + largest);
        }
    }
}
