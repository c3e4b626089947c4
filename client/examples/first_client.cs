// A first client in C#: cuts, follows, and checks what it holds.
using System;
using Incise;

public static class FirstClient
{
    public static int Main(string[] arguments)
    {
        int port = arguments.Length > 0 ? int.Parse(arguments[0]) : 7450;
        var poses = new PoseSample[200];
        for (int i = 0; i < poses.Length; ++i)
        {
            poses[i].SourceNs = 5000000L * i + 1;
            poses[i].Position = new Vec3(-0.06, -0.1 + 0.001 * i, 0.07);
            poses[i].Orientation = Quat.Identity;
            poses[i].Buttons = 1;
        }
        using (var client = new Client("127.0.0.1", port, new ClientOptions { Role = Role.Operator, View = View.Volume }))
        {
            client.DeltaApplied += delta => Console.WriteLine("revision " + delta.Revision + ": " + delta.ProvenanceT.Length + " new vertices");
            client.Start(); // connects, and comes back when the connection is lost
            if (!client.WaitForRevision(0, 10)) return Fail(client);
            ulong sequence = client.SendPoses(poses);
            if (!client.WaitForReport(sequence, 30)) return Fail(client); // the loop has taken all of them
            if (!client.WaitForRevision(1, 5)) return Fail(client);
            lock (client.Lock)
            {
                var mesh = (VolumeState)client.State;
                Console.WriteLine(mesh.LiveTets + " tetrahedra, hash " + (mesh.ComputeHash() == mesh.StateHash ? "equal" : "differs"));
            }
            return 0;
        }
    }

    private static int Fail(Client client)
    {
        Console.Error.WriteLine("first_client: " + client.LastError);
        return 1;
    }
}
