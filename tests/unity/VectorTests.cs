using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using Incise;

/// <summary>The golden vectors: every field read, every field written, states byte for byte, and damaged bytes.</summary>
public static class VectorTests
{
    private static readonly string[] Sent = { "Hello", "HelloResumeHash", "Resync", "Ping", "Pong", "Bye", "PoseBatch", "StrokeControl", "Reset", "Undo", "UndoOthers",
        "HelloLoadRate", "Positions", "BladeModel" };
    private static readonly string[] PassedOver = { "Hello", "HelloResumeHash", "Subscribe", "Resync", "PoseBatch", "StrokeControl", "Positions", "Reset",
        "ReplayControl", "ReplayState", "ReplayTimeline", "HelloLoadRate", "BladeModel", "Undo", "UndoOthers", "FieldValues", "FieldValuesWhole", "HelloFields", "SubscribeFields" };

    public static void EveryFieldIsRead()
    {
        int read = 0;
        foreach (string file in Directory.GetFiles(Vectors.PathOf("messages"), "*.bin"))
        {
            string name = Path.GetFileNameWithoutExtension(file);
            byte[] bytes = File.ReadAllBytes(file);
            Message message = MessageReader.Read(bytes, bytes.Length);
            Check.Equal(message.Body == null, Array.IndexOf(PassedOver, name) >= 0, name + " is passed over");
            var json = Vectors.Map(Json.Parse(File.ReadAllText(Path.ChangeExtension(file, ".json"))));
            Json.CheckEqual(message.Sequence, json["sequence"], name + ".sequence");
            if (message.Body == null) continue;
            Json.CheckEqual(message.Body, json["body"], name);
            ++read;
        }
        Check.That(read >= 15, "vectors were read");
    }

    /// <summary>Texture coordinates of faces, as every client finds them.</summary>
    public static void TexturesLieWhereTheyBelong()
    {
        byte[] bytes = File.ReadAllBytes(Vectors.PathOf("messages/SurfaceAsset.bin"));
        var lookup = new SurfaceLookup((SurfaceAsset)MessageReader.Read(bytes, bytes.Length).Body);
        int found = 0;
        foreach (object entry in (List<object>)Json.Parse(File.ReadAllText(Vectors.PathOf("surface_lookup.json"))))
        {
            var face = Vectors.Map(entry);
            var rest = new List<Vec3>();
            foreach (object corner in (List<object>)face["rest"])
            {
                var x = (List<object>)corner;
                rest.Add(new Vec3(NumberOf(x[0]), NumberOf(x[1]), NumberOf(x[2])));
            }
            var uvs = new float[6];
            bool has = lookup.CornerUvs((uint)NumberOf(face["origin"]), rest[0], rest[1], rest[2], uvs, 0);
            Check.Equal(has, face["uvs"] != null, (string)face["what"]);
            if (!has) continue;
            for (int i = 0; i < 6; ++i)
            {
                double expected = NumberOf(((List<object>)((List<object>)face["uvs"])[i / 2])[i % 2]);
                Check.That(Math.Abs(uvs[i] - expected) < 1e-6, (string)face["what"] + ": " + uvs[i] + " instead of " + expected);
            }
            ++found;
        }
        Check.That(found >= 5, "faces were found");
    }

    private static double NumberOf(object number)
    {
        return double.Parse(((Json.Number)number).Text, System.Globalization.CultureInfo.InvariantCulture);
    }

    /// <summary>What we write, as flatc reads it, is what the vector has.</summary>
    public static void EveryFieldIsWritten()
    {
        string folder = Path.Combine(Path.GetTempPath(), "incise_unity_" + Guid.NewGuid().ToString("N"));
        Directory.CreateDirectory(folder);
        foreach (string name in Sent)
        {
            var golden = Vectors.Map(Json.Parse(File.ReadAllText(Vectors.PathOf("messages/" + name + ".json"))));
            Type type = typeof(Message).Assembly.GetType("Incise." + golden["body_type"]);
            byte[] bytes = MessageWriter.Write(Json.Make(type, golden["body"]), ulong.Parse(((Json.Number)golden["sequence"]).Text), 123);
            string file = Path.Combine(folder, name + ".bin");
            File.WriteAllBytes(file, bytes);
            string schema = Path.Combine(Vectors.Source, "protocol", "incise.fbs");
            Process flatc = Process.Start(new ProcessStartInfo("flatc", "--json --strict-json --raw-binary -o " + folder + " " + schema + " -- " + file)
            {
                UseShellExecute = false
            });
            flatc.WaitForExit();
            Check.Equal(flatc.ExitCode, 0, "flatc reads " + name);
            var written = Vectors.Map(Json.Parse(File.ReadAllText(Path.ChangeExtension(file, ".json"))));
            Check.Equal((string)written["body_type"], (string)golden["body_type"], name);
            if (name == "Hello") Check.Equal(((Hello)Json.Make(type, golden["body"])).ProtocolVersion, Hello.Version, "protocol version");
            object again = Json.Make(type, written["body"]);
            Json.CheckEqual(again, golden["body"], name);
            Json.CheckEqual(Json.Make(type, golden["body"]), written["body"], name + " as written");
        }
        Directory.Delete(folder, true);
    }

    /// <summary>A single pose is written by a path of its own: the same bytes.</summary>
    public static void ASinglePoseIsABatchOfOne()
    {
        var golden = Vectors.Map(Json.Parse(File.ReadAllText(Vectors.PathOf("messages/PoseBatch.json"))));
        foreach (PoseSample pose in ((PoseBatch)Json.Make(typeof(PoseBatch), golden["body"])).Poses)
        {
            byte[] batch = MessageWriter.Write(new PoseBatch { Poses = new[] { pose } }, 70, 80);
            Check.Equal(BitConverter.ToString(MessageWriter.Write(pose, 70, 80)), BitConverter.ToString(batch), "pose at " + pose.SourceNs);
        }
    }

    /// <summary>Fields over a delta of two rounds: blends from the values before, then added vertices in order.</summary>
    public static void FieldsFollowTheMaterial()
    {
        var delta = new Delta
        {
            VertexCount = 7, ProvenanceA = new uint[] { 0, 4, 1 }, ProvenanceB = new uint[] { 1, 2, 5 }, ProvenanceT = new[] { 0.5, 0.25, 0.5 },
            BlendIds = new uint[] { 0, 5, 4 }, BlendVertices = new uint[] { 0, 1, 2, 3, 3, 2, 1, 0, 4, 5, 0, 1 },
            BlendWeights = new[] { 0.5, 0.5, 0.25, -0.25, 1.0, 0, 0, 0, 0.5, 0.25, 0.25, 0 },
            RoundAdded = new uint[] { 2, 1 }, RoundBlends = new uint[] { 2, 1 }
        };
        double[] field = { 8, 16, 32, 64, -8, -16, -32, -64 };
        var pairs = new double[8];
        for (int v = 0; v < 4; ++v)
        {
            pairs[2 * v] = field[v];
            pairs[2 * v + 1] = -field[v];
        }
        delta.Carry(ref pairs, 2);
        // Vertex 0: 4 + 8 + 8 - 16; 4: between that and 1; 5: that of 3. Then 4: half of itself, a quarter of 5 and of 0; 6: between 1 and 5.
        double[] expected = { 4, 16, 32, 64, 22, 64, 40 };
        Check.Equal(pairs.Length, 14, "values");
        for (int v = 0; v < 7; ++v)
        {
            Check.Near(pairs[2 * v], expected[v], 1e-12, "vertex " + v);
            Check.Near(pairs[2 * v + 1], -expected[v], 1e-12, "vertex " + v);
        }
        double[] few = { 1, 2, 3 };
        Check.Throws<ArgumentException>(() => delta.Carry(ref few, 1), "values of three vertices");
        delta.BlendVertices[11] = 6;
        double[] four = { 1, 2, 3, 4 };
        Check.Throws<ArgumentException>(() => delta.Carry(ref four, 1), "a blend of a vertex that was not there");
        Check.Equal(four.Length, 4, "unchanged");
    }

    public static void HashesOfElements()
    {
        var hashes = Vectors.Map(Json.Parse(File.ReadAllText(Vectors.PathOf("hashes.json"))));
        foreach (object item in (List<object>)hashes["vertex"])
        {
            var v = Vectors.Map(item);
            CheckHash(StateHash.Vertex(Id(v), (double[])Json.Make(typeof(double[]), v["position"]), 0), v);
        }
        foreach (object item in (List<object>)hashes["tetrahedron"])
        {
            var t = Vectors.Map(item);
            CheckHash(StateHash.Tet(Id(t), Ids(t), 0, (int)Json.Make(typeof(int), t["region"]), (byte)Json.Make(typeof(byte), t["cut_mask"])), t);
        }
        foreach (object item in (List<object>)hashes["triangle"])
        {
            var t = Vectors.Map(item);
            CheckHash(StateHash.Triangle(Id(t), Ids(t), 0, (byte)Json.Make(typeof(byte), t["flags"])), t);
        }
        foreach (object item in (List<object>)hashes["surface_vertex"])
        {
            var v = Vectors.Map(item);
            var bits = new uint[3];
            Buffer.BlockCopy((float[])Json.Make(typeof(float[]), v["position"]), 0, bits, 0, 12);
            CheckHash(StateHash.SurfaceVertex(Id(v), bits, 0), v);
        }
    }

    private static uint Id(Dictionary<string, object> element)
    {
        return (uint)Json.Make(typeof(uint), element["id"]);
    }

    private static uint[] Ids(Dictionary<string, object> element)
    {
        return (uint[])Json.Make(typeof(uint[]), element["vertices"]);
    }

    private static void CheckHash(ulong found, Dictionary<string, object> element)
    {
        Check.Equal(found.ToString("x16"), (string)element["hash"], "hash of element " + Id(element));
    }

    /// <summary>The client, served from a stream, holds the vector's state after the snapshot and after each delta.</summary>
    public static void StreamsGiveTheirStates()
    {
        foreach (string name in new[] { "volume", "surface" })
        {
            var states = (List<object>)Json.Parse(File.ReadAllText(Vectors.PathOf("streams/" + name + ".json")));
            var found = new List<string>();
            using (var server = new PlayedServer(Vectors.Stream(name), 1))
            using (var client = new Client("127.0.0.1", server.Port, Options(name)))
            {
                client.SnapshotHeld += state => found.Add(Vectors.Canonical(state));
                client.DeltaApplied += delta => found.Add(Vectors.Canonical(client.State));
                client.SurfaceDeltaApplied += delta => found.Add(Vectors.Canonical(client.State));
                client.Start();
                client.WaitForRevision(1000, 20); // it never comes: Bye ends the wait
                Check.Equal(client.Status, ClientStatus.Closed, name + ": " + client.LastError);
                Check.Equal(client.State.ComputeHash(), client.State.HeldHash, name + ": hash from scratch");
            }
            Check.Equal(found.Count, states.Count, name + ": states");
            for (int i = 0; i < states.Count; ++i) Check.Equal(found[i], (string)Vectors.Map(states[i])["canonical_bytes"], name + " " + i);
        }
    }

    private static ClientOptions Options(string stream)
    {
        return new ClientOptions { View = stream == "volume" ? View.Volume : View.Surface, Reconnect = false, FullCheckInterval = 1 };
    }

    /// <summary>Damaged messages are refused with a WireException or read as another message: nothing else happens.</summary>
    public static void DamagedMessagesAreRefused()
    {
        var random = new Random(4711);
        var all = new List<byte[]>();
        foreach (string file in Directory.GetFiles(Vectors.PathOf("messages"), "*.bin")) all.Add(File.ReadAllBytes(file));
        foreach (string name in new[] { "volume", "surface", "volume_part" }) all.AddRange(Vectors.Stream(name));
        int refused = 0, read = 0;
        foreach (byte[] good in all)
        {
            for (int round = 0; round < 400; ++round)
            {
                byte[] bad = Damage(good, random);
                try
                {
                    MessageReader.Read(bad, bad.Length);
                    ++read;
                }
                catch (WireException)
                {
                    ++refused;
                }
            }
        }
        Check.That(refused > 1000 && read > 1000, refused + " were refused, " + read + " read");
    }

    private static byte[] Damage(byte[] good, Random random)
    {
        var bad = (byte[])good.Clone();
        switch (random.Next(4))
        {
            case 0: // another byte, or some
                for (int n = random.Next(1, 4); n > 0; --n) bad[random.Next(bad.Length)] = (byte)random.Next(256);
                break;
            case 1: // one bit
                bad[random.Next(bad.Length)] ^= (byte)(1 << random.Next(8));
                break;
            case 2: // an offset or a length that is far off
                Buffer.BlockCopy(BitConverter.GetBytes(random.Next() << random.Next(2)), 0, bad, random.Next(bad.Length / 4) * 4, 4);
                break;
            default: // the end is missing
                Array.Resize(ref bad, random.Next(bad.Length));
                break;
        }
        return bad;
    }

    /// <summary>A server whose snapshots never fit: the client asks five times for another, then ends for good, and says why.</summary>
    public static void SnapshotsThatNeverFitEndIt()
    {
        List<byte[]> good = Vectors.Stream("surface");
        var stream = new List<byte[]> { good[0] };
        byte[] end = File.ReadAllBytes(Vectors.PathOf("messages/SnapshotEnd.bin")); // of another revision
        for (int i = 0; i < 8; ++i) stream.AddRange(new[] { good[1], good[2], end });
        using (var server = new PlayedServer(stream, 5))
        using (var client = new Client("127.0.0.1", server.Port))
        {
            client.Start();
            Check.That(!client.WaitForRevision(0, 60), "a state");
            Check.Equal(client.Status, ClientStatus.Closed, "status");
            Check.Equal(client.LastError, "cannot hold the server's state: a snapshot that is not complete", "why");
            Check.Equal(client.Counters.Resyncs, 6L, "resyncs");
        }
    }

    private static List<string> HashesOf(string stream)
    {
        var hashes = new List<string>();
        foreach (object state in (List<object>)Json.Parse(File.ReadAllText(Vectors.PathOf("streams/" + stream + ".json"))))
            hashes.Add((string)Vectors.Map(state)["hash"]);
        return hashes;
    }

    /// <summary>Damaged streams: the client refuses, asks again or ends the connection; no thread dies, no state has a wrong hash.</summary>
    public static void DamagedStreamsDoNoHarm()
    {
        var random = new Random(815);
        long resyncs = 0, ended = 0;
        for (int round = 0; round < 120; ++round)
        {
            string name = round % 2 == 0 ? "volume" : "surface";
            List<byte[]> stream = Vectors.Stream(name);
            int which = random.Next(1, stream.Count - 1);
            stream[which] = Damage(stream[which], random);
            using (var server = new PlayedServer(stream, 1))
            using (var client = new Client("127.0.0.1", server.Port, Options(name)))
            {
                client.Start();
                client.WaitForRevision(1000, 20);
                string where = "round " + round + ", message " + which + ": " + client.LastError;
                Check.Equal(client.Status, ClientStatus.Closed, where);
                Check.That(!client.LastError.Contains("Exception"), where);
                Check.Equal(client.Counters.HandlerFaults, 0L, where);
                resyncs += client.Counters.Resyncs;
                ended += client.LastError.Contains("not a message") ? 1 : 0;
                BodyState state = client.State;
                if (state == null) continue;
                Check.Equal(state.ComputeHash(), state.HeldHash, where);
                Check.That(HashesOf(name).Contains(state.HeldHash.ToString("x16")), where + ": a state that the stream does not have");
            }
        }
        Check.That(resyncs > 5 && ended > 5, resyncs + " resyncs, " + ended + " refused");
    }
}
