using System;
using System.Collections.Generic;
using System.Threading;
using Incise;

/// <summary>Against the built incised on loopback.</summary>
public static class ServerTests
{
    /// <summary>The example of client/examples, as README.md shows it.</summary>
    public static void TheFirstClientCuts()
    {
        using (var server = new Server())
        {
            string program = System.IO.Path.Combine(AppDomain.CurrentDomain.BaseDirectory, "first_client.exe");
            using (System.Diagnostics.Process run = Server.Run("mono", program + " " + server.Port))
            {
                string printed = run.StandardOutput.ReadToEnd();
                run.WaitForExit();
                Check.Equal(run.ExitCode, 0, "exit status");
                Check.That(printed.Contains("revision 1: ") && printed.Contains(" tetrahedra, hash equal\n"), printed);
            }
        }
    }

    /// <summary>Both views follow a cut that parts the body; what they draw is the same, by range or from scratch.</summary>
    public static void BothViewsFollowACut()
    {
        using (var server = new Server())
        using (Client volume = Hands.Connect(server, View.Volume, Role.Operator))
        using (Client surface = Hands.Connect(server, View.Surface))
        {
            var meshes = new[] { new Follower(volume), new Follower(surface) };
            foreach (Follower mesh in meshes) mesh.FollowTo(Hands.Settled(server));
            foreach (PoseSample[] sweep in new[] { Hands.Sweep(-0.06, 200, false), Hands.Sweep(-0.04, 200, true) })
            {
                for (int at = 0; at < sweep.Length; at += 10)
                {
                    var part = new PoseSample[10];
                    Array.Copy(sweep, at, part, 0, part.Length);
                    Hands.Send(volume, part);
                    foreach (Follower mesh in meshes) mesh.Follow(volume.Welcome);
                }
            }
            Welcome now = Hands.Settled(server);
            Check.That(now.Revision > 20, "revisions: " + now.Revision);
            foreach (Follower mesh in meshes) mesh.FollowTo(now);
            Hands.CheckHolds(volume, now, "volume");
            Hands.CheckHolds(surface, now, "surface");
            Check.Equal(volume.Counters.Snapshots + surface.Counters.Snapshots, 2L, "snapshots");
            CheckSameBoundary((VolumeState)volume.State, (SurfaceState)surface.State);
            List<string> first = meshes[0].CheckDrawn();
            List<string> second = meshes[1].CheckDrawn();
            for (int i = 0; i < first.Count; ++i) Check.Equal(second[i], first[i], "drawn triangle " + i);
            foreach (Follower mesh in meshes)
            {
                Check.That(mesh.Mesh.InsideCount > 300, "triangles inside: " + mesh.Mesh.InsideCount / 3);
                Check.That(mesh.Patches > 5 && mesh.PatchedVertices < mesh.Patches * (long)mesh.Mesh.Vertices.Length / 4,
                    mesh.Patches + " patches with " + mesh.PatchedVertices + " vertices of " + mesh.Mesh.Vertices.Length);
            }
        }
    }

    /// <summary>A box whose sides are charts of their own: u says which side, v the height.</summary>
    private static string Box()
    {
        const int N = 5;
        var text = new System.Text.StringBuilder();
        int corner = 0;
        for (int side = 0; side < 6; ++side)
        {
            int axis = side / 2;
            for (int i = 0; i < N; ++i)
            {
                for (int j = 0; j < N; ++j)
                {
                    int[][] corners = { new[] { i, j }, new[] { i + 1, j }, new[] { i + 1, j + 1 }, new[] { i, j + 1 } };
                    if (side % 2 == 0) Array.Reverse(corners);
                    string face = "f";
                    foreach (int[] at in corners)
                    {
                        var p = new double[3];
                        p[axis] = side % 2;
                        p[(axis + 1) % 3] = (double)at[0] / N;
                        p[(axis + 2) % 3] = (double)at[1] / N;
                        text.AppendFormat(System.Globalization.CultureInfo.InvariantCulture, "v {0:r} {1:r} {2:r}\nvt {3:r} {4:r}\n", 0.1 * p[0] - 0.1,
                            0.1 * p[1] - 0.05, 0.1 * p[2] - 0.04, (side + 0.5) / 6, p[2]);
                        ++corner;
                        face += " " + corner + "/" + corner;
                    }
                    text.Append(face + "\n");
                }
            }
        }
        return text.ToString();
    }

    /// <summary>A mesh has its surface's texture coordinates, split at the seams, before and after a cut, by range or from scratch.</summary>
    public static void ATextureStaysWithItsSeams()
    {
        using (var server = new Server(false, 3000, false, Box()))
        using (Client hand = Hands.Connect(server, View.None, Role.Operator))
        using (Client client = Hands.Connect(server, View.Surface))
        {
            var mesh = new Follower(client);
            mesh.FollowTo(Hands.Settled(server));
            Check.That(Array.TrueForAll(mesh.Mesh.Vertices, v => v.S == 0 && v.T == 0), "no texture yet");
            byte[] bytes;
            using (var web = new System.Net.WebClient())
                bytes = web.DownloadData("http://127.0.0.1:" + server.HttpPort + client.Welcome.Surface.Path);
            var asset = (SurfaceAsset)MessageReader.Read(bytes, bytes.Length).Body;
            Check.Equal((uint)asset.Triangles.Length / 3, client.Welcome.Surface.Triangles, "triangles of the surface");
            mesh.Mesh.Texture = new SurfaceLookup(asset);
            mesh.FollowTo(Hands.Settled(server));
            CheckTexture(mesh.Mesh);
            PoseSample[] sweep = Hands.Sweep(-0.06, 200, false);
            for (int at = 0; at < sweep.Length; at += 10)
            {
                var part = new PoseSample[10];
                Array.Copy(sweep, at, part, 0, part.Length);
                Hands.Send(hand, part);
                mesh.Follow(hand.Welcome);
            }
            mesh.FollowTo(Hands.Settled(server));
            Check.That(mesh.Patches > 3 && mesh.Mesh.InsideCount > 100, mesh.Patches + " patches, " + mesh.Mesh.InsideCount / 3 + " triangles inside");
            CheckTexture(mesh.Mesh);
            mesh.CheckDrawn();
        }
    }

    private static void CheckTexture(SurfaceMesh mesh)
    {
        var sides = new Dictionary<string, HashSet<int>>(); // at each place
        for (int at = 0; at < mesh.SkinCount; at += 3)
        {
            var found = new HashSet<int>();
            for (int k = 0; k < 3; ++k)
            {
                MeshVertex v = mesh.Vertices[mesh.Indices[at + k]];
                Check.That(Math.Abs(v.T - (v.Y + 0.04) / 0.1) < 1e-3, "height " + v.Y + " has v " + v.T);
                int side = (int)Math.Round(6 * v.S - 0.5);
                Check.That(Math.Abs(6 * v.S - 0.5 - side) < 1e-3, "u " + v.S + " is of no side");
                found.Add(side);
                string place = v.X + " " + v.Y + " " + v.Z;
                if (!sides.ContainsKey(place)) sides.Add(place, new HashSet<int>());
                sides[place].Add(side);
            }
            Check.Equal(found.Count, 1, "a triangle reaches over a seam");
        }
        int seams = 0;
        foreach (HashSet<int> there in sides.Values) seams += there.Count > 1 ? 1 : 0;
        Check.That(seams >= 12 * 4, "vertices at seams: " + seams);
        for (int at = mesh.InsideStart; at < mesh.InsideStart + mesh.InsideCount; ++at)
            Check.That(mesh.Vertices[mesh.Indices[at]].S == 0, "the inside has no texture");
    }

    private static void CheckSameBoundary(VolumeState volume, SurfaceState surface)
    {
        Check.Equal(volume.TriangleCount, surface.TriangleCount, "triangles");
        uint[] pieces = volume.Pieces();
        var found = new HashSet<uint>();
        foreach (uint id in surface.TriangleIds)
        {
            Check.That(volume.TryTriangle(id, out BoundaryTriangle a) && surface.TryTriangle(id, out BoundaryTriangle b) && a.A == b.A &&
                       a.B == b.B && a.C == b.C && a.IsCut == b.IsCut && a.Region == b.Region, "triangle " + id + " differs");
            Check.Equal(pieces[id / 4], surface.PieceOf(id), "piece of triangle " + id);
            found.Add(pieces[id / 4]);
        }
        Check.That(found.Count >= 2, "the body was cut apart: " + found.Count + " pieces");
    }

    /// <summary>A connection that is cut comes back and goes on where it was: no second snapshot.</summary>
    public static void ALostConnectionResumes()
    {
        using (var server = new Server())
        using (Client hand = Hands.Connect(server, View.None, Role.Operator))
        {
            foreach (View view in new[] { View.Surface, View.Volume })
            {
                using (Client client = Hands.Connect(server, view))
                {
                    Check.That(client.WaitForRevision(0, 60), "no snapshot");
                    client.DropConnection();
                    Hands.Send(hand, Hands.Sweep(view == View.Surface ? -0.05 : -0.03, 100, false));
                    Hands.CheckHolds(client, Hands.Settled(server), view.ToString());
                    Check.Equal(client.Counters.Reconnects, 1L, view + ": reconnects");
                    Check.Equal(client.Counters.Resumed, 1L, view + ": resumed");
                    Check.Equal(client.Counters.Snapshots, 1L, view + ": snapshots");
                    Check.That(client.Counters.Deltas > 0, view + ": deltas");
                }
            }
        }
    }

    /// <summary>Connections that break, a server that is killed and resumes, resets, again and again while strokes go on.</summary>
    public static void ChaosEndsWithEqualHashes()
    {
        using (var server = new Server(true))
        using (Client hand = Hands.Connect(server, View.None, Role.Operator))
        using (Client admin = Hands.Connect(server, View.None, Role.Admin))
        using (Client volume = Hands.Connect(server, View.Volume))
        using (Client surface = Hands.Connect(server, View.Surface, Role.Viewer, null, true, 30))
        {
            var followers = new[] { new Follower(volume), new Follower(surface) };
            var blows = new Blows(server, admin, new[] { hand, volume, surface });
            for (int round = 0; round < Program.Rounds; ++round)
            {
                string where = "round " + round;
                double x = -0.08 + 0.16 * ((round * 37 % 64 + 0.1 * (round / 64 % 10)) / 64.0);
                hand.SendPoses(Hands.Sweep(x, 60, round % 2 == 1)); // not all of it may be taken
                blows.Fall();
                Check.That(hand.WaitForWelcome(60), where + ": " + hand.LastError);
                Welcome now = Hands.Settled(server);
                foreach (Follower follower in followers) follower.FollowTo(now);
                Hands.CheckHolds(volume, now, where + ", volume");
                Hands.CheckHolds(surface, now, where + ", surface");
                if (round % 10 == 9)
                    foreach (Follower follower in followers) follower.CheckDrawn();
            }
            Console.WriteLine(Program.Rounds + " rounds of chaos: " + blows + "; surface: " + Said(surface) + "; volume: " + Said(volume));
            Check.That(surface.Counters.Resumed > 0 && volume.Counters.Resumed > 0 && volume.Counters.Snapshots > 1, "what happened");
        }
    }

    /// <summary>What goes wrong in a round of chaos.</summary>
    private sealed class Blows
    {
        private readonly Random random = new Random(90210);
        private readonly Server server;
        private readonly Client admin;
        private readonly Client[] clients;
        private int kills, drops, resets, joiners;

        public Blows(Server server, Client admin, Client[] clients)
        {
            this.server = server;
            this.admin = admin;
            this.clients = clients;
        }

        public void Fall()
        {
            for (int blow = random.Next(1, 4); blow > 0; --blow)
            {
                Thread.Sleep(random.Next(30));
                switch (random.Next(9))
                {
                    case 0:
                        server.Kill();
                        server.Start(true);
                        ++kills;
                        break;
                    case 1:
                        if (admin.Reset()) ++resets;
                        break;
                    case 2: // comes, and leaves within its snapshot
                        using (Client joiner = Hands.Connect(server, View.Volume))
                        {
                            Thread.Sleep(random.Next(4));
                            joiner.DropConnection();
                        }
                        ++joiners;
                        break;
                    default:
                        clients[random.Next(clients.Length)].DropConnection();
                        ++drops;
                        break;
                }
            }
        }

        public override string ToString()
        {
            return kills + " kills, " + resets + " resets, " + drops + " drops, " + joiners + " joiners";
        }
    }

    private static string Said(Client client)
    {
        ClientCounters c = client.Counters;
        return "revision " + client.State.Revision + ", " + c.Reconnects + " reconnects, " + c.Resumed + " resumed, " + c.Snapshots + " snapshots, " + c.Resyncs + " resyncs";
    }

    /// <summary>In a body that a simulator deforms while it is cut, each vertex keeps its place at rest, as the server has it.</summary>
    public static void RestPositionsAreCarried()
    {
        using (var server = new Server(false, 2000))
        using (Client follower = Hands.Connect(server, View.Volume))
        using (Client hand = Hands.Connect(server, View.None, Role.Operator))
        {
            Check.That(follower.WaitForRevision(0, 60), "no snapshot");
            System.Diagnostics.Process simulator = Server.Run(System.IO.Path.Combine(Server.Programs, "incise-xpbd"), "127.0.0.1:" + server.Port);
            try
            {
                Hands.Send(hand, Hands.Sweep(-0.04, 100, false));
                for (DateTime end = DateTime.UtcNow.AddSeconds(60); FromRest(follower) <= 1000; System.Threading.Thread.Sleep(10))
                    Check.That(DateTime.UtcNow < end, "the cut does not open");
            }
            finally
            {
                simulator.Kill();
                simulator.WaitForExit();
                simulator.Dispose();
            }
            Welcome now = Hands.Settled(server);
            Hands.CheckHolds(follower, now, "follower");
            using (Client late = Hands.Connect(server, View.Volume))
            {
                Hands.CheckHolds(late, now, "late");
                Check.Equal(follower.Counters.Snapshots, 1L, "snapshots");
                VolumeState a = (VolumeState)follower.State, b = (VolumeState)late.State;
                for (int i = 0; i < 3 * a.VertexCount; ++i) Check.Equal(a.RestPositions[i], b.RestPositions[i], "rest coordinate " + i);
                Check.That(FromRest(follower) > 1000 && a.VertexCount > now.Mesh.Vertices, FromRest(follower) + " coordinates, " + a.VertexCount + " vertices");
            }
        }
    }

    /// <summary>How many coordinates are not those at rest.</summary>
    private static int FromRest(Client follower)
    {
        lock (follower.Lock)
        {
            var state = (VolumeState)follower.State;
            int apart = 0;
            for (int i = 0; i < 3 * state.VertexCount; ++i)
                if (state.RestPositions[i] != state.Positions[i]) ++apart;
            return apart;
        }
    }

    /// <summary>View Surface with a box holds the triangles that touch it, and no others.</summary>
    public static void ABoxHoldsItsPart()
    {
        var box = new Box(new Vec3(-1, -1, -1), new Vec3(-0.02, 0.01, 1));
        using (var server = new Server())
        using (Client hand = Hands.Connect(server, View.Surface, Role.Operator))
        using (Client part = Hands.Connect(server, View.Surface, Role.Viewer, box))
        {
            Check.That(part.WaitForRevision(0, 60) && hand.WaitForRevision(0, 60), "no snapshots");
            Hands.Send(hand, Hands.Sweep(-0.05, 100, false));
            Welcome now = Hands.Settled(server);
            Hands.CheckHolds(hand, now, "whole");
            Hands.CheckHolds(part, now, "part");
            int touching = 0;
            foreach (uint id in hand.State.TriangleIds)
            {
                if (!Touches(hand.State, id, box)) continue;
                ++touching;
                Check.That(part.State.TryTriangle(id, out BoundaryTriangle t), "triangle " + id + " is not in the part");
            }
            Check.Equal(part.State.TriangleCount, touching, "triangles in the part");
            Check.That(touching > 0 && touching < hand.State.TriangleCount, "triangles that touch: " + touching);
        }
        Check.Throws<ArgumentException>(() => new Client("h", 1, new ClientOptions { View = View.Volume, Box = box }), "a box of the volume");
    }

    private static bool Touches(BodyState state, uint id, Box box)
    {
        state.TryTriangle(id, out BoundaryTriangle t);
        var low = new Vec3(9, 9, 9);
        var high = new Vec3(-9, -9, -9);
        foreach (uint v in new[] { t.A, t.B, t.C })
        {
            state.TryVertex(v, out Vec3 p, out Vec3 rest);
            low = new Vec3(Math.Min(low.X, p.X), Math.Min(low.Y, p.Y), Math.Min(low.Z, p.Z));
            high = new Vec3(Math.Max(high.X, p.X), Math.Max(high.Y, p.Y), Math.Max(high.Z, p.Z));
        }
        return low.X <= box.Max.X && high.X >= box.Min.X && low.Y <= box.Max.Y && high.Y >= box.Min.Y && low.Z <= box.Max.Z && high.Z >= box.Min.Z;
    }

    /// <summary>A tool that is pressed into the body at 1 kHz gets a force against it, within the limit.</summary>
    public static void AToolFeelsTheBody()
    {
        using (var server = new Server())
        {
            var options = new ClientOptions { Role = Role.Operator, View = View.None, Blade = new BladeEdge(new Vec3(), new Vec3(0, 0, -0.05)) };
            using (var client = new Client("127.0.0.1", server.Port, options))
            using (var tool = new HapticTool(client))
            {
                client.Start();
                Check.That(client.WaitForWelcome(60), client.LastError);
                // A body that stands elsewhere in Unity's world, turned by a quarter about the vertical.
                var body = new Placement { Position = new Vec3(3, 1, -2), Rotation = new Quat(Math.Sqrt(0.5), 0, Math.Sqrt(0.5), 0), Scale = 1 };
                tool.Place(body);
                var force = new Vec3();
                int steps = 0;
                // Down at 0.02 m/s to where the edge is well inside, up and down again, until the force has grown: it ramps up.
                for (long begun = Clock.NowNs, now = begun; force.Y < 0.002 && now < begun + 60000000000; now = Clock.NowNs, ++steps)
                {
                    double way = 0.02 * (now - begun) * 1e-9 % 0.08;
                    var tissue = new Vec3(0.02, 0, 0.1 - (way < 0.04 ? way : 0.08 - way));
                    Vec3 world = body.Position + body.Rotation.Rotate(UnityFrame.Convert(tissue));
                    force = tool.Step(world, body.Rotation, false);
                    Check.That(force.Length <= 3.3 + 1e-9, "force " + force);
                    Thread.Sleep(1);
                }
                Check.That(force.Y > 0.002 && force.Y > 0.5 * force.Length, "the force points up: " + force + " after " + steps + " steps");
                // The thread is paused: planes come meanwhile, and the force begins from nothing.
                Thread.Sleep(70);
                Vec3 at = body.Position + body.Rotation.Rotate(UnityFrame.Convert(new Vec3(0.02, 0, 0.07)));
                Check.Equal(tool.Step(at, body.Rotation, false).Length, 0.0, "the force after a pause");
                Check.That(tool.LastForce != null && client.Report.Accepted > 100, "the server answers");
                Check.Equal(client.Report.TimeNotRising + client.Report.NotUnit + client.Report.NotFinite, 0UL, "poses that are refused");
            }
        }
    }

    /// <summary>TLS: a certificate that the caller knows is accepted, and one that nobody knows is not.</summary>
    public static void TlsAsksForACertificate()
    {
        using (var server = new Server(false, 2000, true))
        {
            var known = new ClientOptions { Tls = true, CertificateCheck = (sender, certificate, chain, errors) => certificate.Subject == "CN=incise.test" };
            using (var client = new Client("127.0.0.1", server.Port, known))
            {
                client.Start();
                Check.That(client.WaitForRevision(0, 60), client.LastError);
                for (int lost = 1; lost <= 10; ++lost)
                {
                    client.DropConnection();
                    for (int i = 0; i < 600 && client.Counters.Reconnects < lost && client.Status != ClientStatus.Closed; ++i) Thread.Sleep(100);
                    Check.That(client.WaitForWelcome(60), "lost " + lost + " times: " + client.LastError);
                }
                Hands.CheckHolds(client, client.Welcome, "over TLS");
            }
            foreach (bool tls in new[] { true, false })
            {
                using (var client = new Client("127.0.0.1", server.Port, new ClientOptions { Tls = tls, Reconnect = false }))
                {
                    client.Start();
                    Check.That(!client.WaitForWelcome(60) && client.Status == ClientStatus.Closed, "it connects");
                    string why = tls ? ": AuthenticationException: " : ": the connection was closed; a server with a certificate needs Tls";
                    Check.That(client.LastError.StartsWith("127.0.0.1:" + server.Port + why) && !client.LastError.Contains("\n"), client.LastError);
                }
            }
        }
    }

    /// <summary>Nobody there, a blade that another has, a server that goes: one clear line, and the client goes on as it should.</summary>
    public static void RefusalsSayWhy()
    {
        using (var server = new Server())
        {
            using (Client first = Hands.Connect(server, View.None, Role.Operator))
            using (var second = new Client("127.0.0.1", server.Port, new ClientOptions { Role = Role.Operator, View = View.None }))
            {
                second.Start();
                Check.That(!second.WaitForWelcome(60), "the blade is taken");
                Check.Equal(second.Status, ClientStatus.Closed, "a refused client does not come back");
                Check.That(second.LastError.StartsWith("BladeTaken: "), second.LastError);
            }
            using (Client viewer = Hands.Connect(server, View.Surface))
            {
                Check.That(viewer.WaitForRevision(0, 60), "no snapshot");
                server.Kill();
                for (int i = 0; i < 600 && !viewer.LastError.Contains("refused"); ++i) Thread.Sleep(100);
                Check.Equal(viewer.Status, ClientStatus.Connecting, "it tries again");
                Check.That(viewer.LastError.StartsWith("127.0.0.1:" + server.Port + ": "), viewer.LastError);
                Check.That(viewer.State != null, "the state is still there to be drawn");
                server.Start(false);
                // Another session: it gets a snapshot.
                Check.That(viewer.WaitForWelcome(60), viewer.LastError);
                Hands.CheckHolds(viewer, Hands.Settled(server), "after a new session");
                Check.Equal(viewer.Counters.Snapshots, 2L, "snapshots");
            }
        }
    }
}

/// <summary>A SurfaceMesh, and what a graphics card has of it that only gets the ranges.</summary>
public sealed class Follower
{
    private readonly Client client;
    public readonly SurfaceMesh Mesh = new SurfaceMesh();
    public long Patches, PatchedVertices;
    private MeshVertex[] cardVertices = { };
    private uint[] cardIndices = { };

    public Follower(Client client)
    {
        this.client = client;
    }

    /// <summary>Updates the mesh until it is at the server's state, after a reset perhaps at a lower revision.</summary>
    public void FollowTo(Welcome server)
    {
        for (DateTime end = DateTime.UtcNow.AddSeconds(60); !Follow(server);)
        {
            Check.That(DateTime.UtcNow < end, "revision " + server.Revision + " does not come: " + client.LastError);
            Thread.Sleep(1);
        }
    }

    public bool Follow(Welcome server)
    {
        lock (client.Lock)
        {
            BodyState state = client.State;
            if (state == null) return false;
            if (Mesh.Update(state)) Upload();
            return state.Revision == server.Revision && state.StateHash == server.StateHash;
        }
    }

    private void Upload()
    {
        if (Mesh.Replaced)
        {
            cardVertices = (MeshVertex[])Mesh.Vertices.Clone();
            cardIndices = (uint[])Mesh.Indices.Clone();
            return;
        }
        ++Patches;
        foreach (BufferRange range in Mesh.VertexRanges)
        {
            Array.Copy(Mesh.Vertices, range.Start, cardVertices, range.Start, range.Count);
            PatchedVertices += range.Count;
        }
        foreach (BufferRange range in Mesh.IndexRanges) Array.Copy(Mesh.Indices, range.Start, cardIndices, range.Start, range.Count);
    }

    /// <summary>What the card draws is what a mesh from scratch draws, and its faces point outwards.</summary>
    public List<string> CheckDrawn()
    {
        var fresh = new SurfaceMesh();
        List<string> drawn, expected;
        lock (client.Lock)
        {
            Mesh.Update(client.State);
            Upload();
            drawn = Hands.Drawn(cardVertices, cardIndices, Mesh.SkinCount, Mesh.InsideStart, Mesh.InsideCount);
            fresh.Update(client.State);
            expected = Hands.Drawn(fresh.Vertices, fresh.Indices, fresh.SkinCount, fresh.InsideStart, fresh.InsideCount);
            Mesh.Forget();
        }
        Check.Equal(drawn.Count, expected.Count, "triangles drawn");
        for (int i = 0; i < drawn.Count; ++i) Check.Equal(drawn[i], expected[i], "drawn triangle");
        CheckOutwards(fresh);
        return drawn;
    }

    /// <summary>The volume that Unity's clockwise triangles enclose, and normals that agree with them.</summary>
    private static void CheckOutwards(SurfaceMesh mesh)
    {
        double volume = 0;
        int agree = 0, count = 0;
        for (int at = 0; at < mesh.Indices.Length; at += 3)
        {
            if (at >= mesh.SkinCount && at < mesh.InsideStart || at >= mesh.InsideStart + mesh.InsideCount) continue;
            MeshVertex v = mesh.Vertices[mesh.Indices[at]];
            Vec3 a = At(v), b = At(mesh.Vertices[mesh.Indices[at + 1]]), c = At(mesh.Vertices[mesh.Indices[at + 2]]);
            // In a left-handed frame, clockwise from outside: (b - a) x (c - a) points outwards.
            Vec3 normal = Vec3.Cross(b - a, c - a);
            volume += Vec3.Dot(a, normal) / 6;
            ++count;
            if (Vec3.Dot(normal, new Vec3(v.NormalX, v.NormalY, v.NormalZ)) >= 0) ++agree;
        }
        Check.That(volume > 1e-5, "volume " + volume);
        Check.That(agree > 0.9 * count, agree + " of " + count + " normals agree with their triangles");
    }

    private static Vec3 At(MeshVertex v)
    {
        return new Vec3(v.X, v.Y, v.Z);
    }
}
