using System;
using System.Collections.Generic;
using Incise;

/// <summary>Strokes, and states to compare.</summary>
public static class Hands
{
    private static long nextNs = 1;

    /// <summary>A sweep along y through the liver, the blade held upright at x; forth or back.</summary>
    public static PoseSample[] Sweep(double x, int poses, bool back)
    {
        var sweep = new PoseSample[poses];
        for (int i = 0; i < poses; ++i)
        {
            double share = (back ? poses - 1 - i : i) / (poses - 1.0);
            nextNs += 5000000;
            sweep[i] = new PoseSample
            {
                SourceNs = nextNs, Position = new Vec3(x, -0.12 + 0.24 * share, 0.07), Orientation = Quat.Identity, Buttons = 1
            };
        }
        nextNs += 1000000000; // a gap: the next one is another stroke
        return sweep;
    }

    public static Client Connect(Server server, View view, Role role = Role.Viewer, Box box = null, bool reconnect = true, float rate = 0)
    {
        var options = new ClientOptions { View = view, Role = role, Box = box, FullCheckInterval = 20, Reconnect = reconnect, MaxRateHz = rate, ConnectTimeoutS = 60 };
        var client = new Client("127.0.0.1", server.Port, options);
        client.Start();
        Check.That(client.WaitForWelcome(60), "no Welcome: " + client.LastError);
        return client;
    }

    /// <summary>Sends poses, as often as it takes, until the server reports that it has taken all of them.</summary>
    public static void Send(Client hand, PoseSample[] poses)
    {
        ulong sequence = hand.SendPoses(poses);
        Check.That(sequence > 0 && hand.WaitForReport(sequence, 60), "poses are not taken: " + hand.LastError);
    }

    /// <summary>What the server has, from a client that holds nothing, when nothing is being cut any longer.</summary>
    public static Welcome Settled(Server server)
    {
        Welcome before = null;
        for (int round = 0; round < 600; ++round)
        {
            using (Client probe = Connect(server, View.None))
            {
                Welcome now = probe.Welcome;
                if (before != null && before.Revision == now.Revision && before.Session == now.Session) return now;
                before = now;
            }
            System.Threading.Thread.Sleep(100);
        }
        throw new Failure("the server does not come to rest");
    }

    /// <summary>The client comes to what the server has, and its hashes from scratch are right.</summary>
    public static void CheckHolds(Client client, Welcome server, string where)
    {
        Check.That(client.WaitForRevision(server.Revision, 60), where + ": revision " + server.Revision + " does not come: " + client.LastError +
            " (" + client.Status + ", resyncs " + client.Counters.Resyncs + ")");
        lock (client.Lock)
        {
            Check.Equal(client.State.Revision, server.Revision, where + ": revision");
            Check.Equal(client.State.StateHash, server.StateHash, where + ": state hash");
            Check.Equal(client.State.ComputeHash(), client.State.HeldHash, where + ": hash from scratch");
        }
        Check.Equal(client.Counters.HandlerFaults, 0L, where + ": " + client.LastHandlerFault);
    }

    /// <summary>What a mesh draws, in an order of its own: corners with positions, normals and rest, skin before inside.</summary>
    public static List<string> Drawn(MeshVertex[] vertices, uint[] indices, int skinCount, int insideStart, int insideCount)
    {
        var drawn = new List<string>();
        for (int at = 0; at < skinCount; at += 3) drawn.Add("skin " + Triangle(vertices, indices, at));
        for (int at = insideStart; at < insideStart + insideCount; at += 3) drawn.Add("inside " + Triangle(vertices, indices, at));
        drawn.Sort(string.CompareOrdinal);
        return drawn;
    }

    private static string Triangle(MeshVertex[] vertices, uint[] indices, int at)
    {
        var corners = new string[3];
        for (int k = 0; k < 3; ++k)
        {
            MeshVertex v = vertices[indices[at + k]];
            // Sums of normals come in another order, so their last digits differ.
            corners[k] = v.X.ToString("r") + " " + v.Y.ToString("r") + " " + v.Z.ToString("r") + " n " + Rounded(v.NormalX) + " " +
                         Rounded(v.NormalY) + " " + Rounded(v.NormalZ) + " r " + v.U.ToString("r") + " " + v.V.ToString("r") + " " + v.W.ToString("r");
        }
        // Begin at the least corner; the sense of rotation stays.
        int first = 0;
        for (int k = 1; k < 3; ++k)
            if (string.CompareOrdinal(corners[k], corners[first]) < 0) first = k;
        return corners[first] + " | " + corners[(first + 1) % 3] + " | " + corners[(first + 2) % 3];
    }

    private static string Rounded(float x)
    {
        return (Math.Round(x * 50.0) / 50 + 0.0).ToString("0.00");
    }
}
