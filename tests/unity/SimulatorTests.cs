using System;
using System.Collections.Generic;
using System.Threading;
using Incise;

/// <summary>The role Simulator, against the built incised on loopback.</summary>
public static class SimulatorTests
{
    private static Client Simulator(Server server, float loadRateHz)
    {
        var options = new ClientOptions { Role = Role.Simulator, View = View.Volume, LoadRateHz = loadRateHz, FullCheckInterval = 1, ConnectTimeoutS = 60 };
        return new Client("127.0.0.1", server.Port, options);
    }

    private static double[] Copy(double[] all, int vertices)
    {
        var some = new double[3 * vertices];
        Array.Copy(all, some, some.Length);
        return some;
    }

    /// <summary>Bent sideways with the height, from rest.</summary>
    private static double[] Swayed(double[] rest, double by)
    {
        var swayed = (double[])rest.Clone();
        for (int i = 0; i < rest.Length; i += 3) swayed[i] += by * rest[i + 2] * rest[i + 2];
        return swayed;
    }

    /// <summary>Sends as often as it takes, and waits for the report and the revision that it names.</summary>
    private static PositionsReport Send(Client simulator, Positions positions)
    {
        DateTime end = DateTime.UtcNow.AddSeconds(60);
        while (simulator.SendPositions(positions) == 0)
        {
            Check.That(DateTime.UtcNow < end, "positions are not sent: " + simulator.LastError);
            Thread.Sleep(1);
        }
        Check.That(simulator.WaitForPositions(positions.Frame, 60), "no report: " + simulator.LastError);
        Check.That(simulator.WaitForRevision(simulator.PositionsReport.Revision, 60), "no delta");
        return simulator.PositionsReport;
    }

    /// <summary>It moves all vertices, some, and all again after a cut; a client that comes late has the same.</summary>
    public static void ABodyGoesWhereItIsSent()
    {
        using (var server = new Server(false, 2000))
        using (Client simulator = Simulator(server, 0))
        using (Client hand = Hands.Connect(server, View.None, Role.Operator))
        {
            simulator.Start();
            Check.That(simulator.WaitForRevision(0, 60), simulator.LastError);
            var body = (VolumeState)simulator.State;
            double[] start = Copy(body.Positions, body.VertexCount);
            float[] wanted = Array.ConvertAll(Swayed(start, 1.5), x => (float)x);
            PositionsReport report = Send(simulator, new Positions { Frame = 1, F32 = wanted });
            Check.That(report.Frame == 1 && report.Taken == 1 && report.Skipped == 0 && report.Moved > 300, "moved " + report.Moved);
            Check.Equal(report.Held.Length, 0, "held");
            for (int i = 0; i < start.Length; ++i)
                Check.That(body.Positions[i] == wanted[i] && body.RestPositions[i] == start[i], "coordinate " + i);

            uint[] some = { 0, 2, 5 };
            var near = new double[9];
            for (int i = 0; i < 9; ++i) near[i] = body.Positions[3 * some[i / 3] + i % 3] + 1e-5;
            report = Send(simulator, new Positions { Frame = 2, Revision = body.Revision, Ids = some, F64 = near });
            Check.Equal(report.Moved, 3u, "moved");
            for (int i = 0; i < 9; ++i) Check.Equal(body.Positions[3 * some[i / 3] + i % 3], near[i], "coordinate " + i);

            Hands.Send(hand, Hands.Sweep(-0.04, 100, false));
            Hands.CheckHolds(simulator, Hands.Settled(server), "after the cut");
            Check.That(3 * body.VertexCount > start.Length, "the cut made vertices");
            // The rest positions are those of the material: swayed again, they are where the vertices are.
            double[] again = Swayed(Copy(body.RestPositions, body.VertexCount), 1);
            report = Send(simulator, new Positions { Frame = 3, Revision = body.Revision, F64 = again });
            var held = new HashSet<uint>(report.Held);
            int free = 0;
            for (uint t = 0; t < body.TetSlots; ++t)
            {
                for (int k = 0; k < 4 && body.IsAlive(t); ++k)
                {
                    uint v = body.Tets[4 * t + k];
                    if (held.Contains(v)) continue;
                    ++free;
                    for (int c = 0; c < 3; ++c) Check.Equal(body.Positions[3 * v + c], again[3 * v + c], "vertex " + v);
                }
            }
            Check.That(free > 1000 && held.Count < body.VertexCount / 20, free + " corners are free, " + held.Count + " vertices held");
            Welcome now = Hands.Settled(server);
            Hands.CheckHolds(simulator, now, "simulator");
            using (Client late = Hands.Connect(server, View.Volume)) Hands.CheckHolds(late, now, "late");
            Check.Equal(simulator.Counters.Snapshots + simulator.Counters.Resyncs, 1L, "snapshots");
        }
    }

    /// <summary>What cannot be is refused, here or by the server, and the connection goes on.</summary>
    public static void WhatDoesNotFitIsRefused()
    {
        Check.Throws<ArgumentException>(() => new Client("h", 1, new ClientOptions { Role = Role.Simulator, View = View.Surface }), "view Surface");
        using (var server = new Server(false, 2000))
        using (Client simulator = Simulator(server, 0))
        using (Client second = Simulator(server, 0))
        {
            simulator.Start();
            Check.That(simulator.WaitForRevision(0, 60), simulator.LastError);
            Check.Throws<ArgumentException>(() => simulator.SendPositions(new Positions { F32 = new float[4] }), "four numbers");
            Check.Throws<ArgumentException>(() => simulator.SendPositions(new Positions { F32 = new float[3], F64 = new double[3] }), "both kinds");
            Check.Throws<ArgumentException>(() => simulator.SendPositions(new Positions { Ids = new uint[] { 1 }, F64 = new double[6] }), "ids");
            Check.Throws<ArgumentException>(() => simulator.SendModel(new BladeModel { Stiffness = new double[3] }), "three numbers");
            var errors = new List<ErrorCode>();
            simulator.ErrorReceived += error => { lock (errors) errors.Add(error.Code); };
            var body = (VolumeState)simulator.State;
            Expect(simulator, errors, new Positions { Frame = 1, Ids = new[] { (uint)body.VertexCount }, F64 = new double[3] }, ErrorCode.BadRequest);
            Expect(simulator, errors, new Positions { Frame = 2, Revision = 1000, F64 = new double[3] }, ErrorCode.BadRequest);
            PositionsReport report = Send(simulator, new Positions { Frame = 3, F64 = new double[] { 1000, 1000, 1000 } });
            Check.That(report.Held.Length > 0, "a vertex that would invert its tetrahedra is held");
            second.Start();
            Check.That(second.WaitForRevision(0, 60), second.LastError);
            var answers = new List<ErrorCode>();
            second.ErrorReceived += error => { lock (answers) answers.Add(error.Code); };
            Expect(second, answers, new Positions { Frame = 1, F64 = Copy(body.Positions, 1) }, ErrorCode.NotAvailable);
            Check.Equal(simulator.Status, ClientStatus.Connected, "the first one's status");
        }
        using (var server = new Server(false, 2000))
        using (Client wrong = new Client("127.0.0.1", server.Port, new ClientOptions { View = View.None, LoadRateHz = 100, Reconnect = false }))
        {
            wrong.Start();
            Check.That(!wrong.WaitForWelcome(60) && wrong.LastError.StartsWith("BadRequest: "), "loads for a viewer: " + wrong.LastError);
        }
    }

    private static void Expect(Client client, List<ErrorCode> errors, Positions positions, ErrorCode code)
    {
        DateTime end = DateTime.UtcNow.AddSeconds(60);
        while (client.SendPositions(positions) == 0) Thread.Sleep(1);
        for (;;)
        {
            lock (errors)
            {
                if (errors.Count > 0)
                {
                    Check.Equal(errors[0], code, "answer to frame " + positions.Frame);
                    errors.Clear();
                    return;
                }
            }
            Check.That(DateTime.UtcNow < end, "no answer to frame " + positions.Frame);
            Thread.Sleep(1);
        }
    }

    /// <summary>A blade's forces on the vertices come, and sum to minus that on the hand; a model is taken, a bad one answered.</summary>
    public static void ABladesLoadsCome()
    {
        using (var server = new Server(false, 3000))
        using (Client simulator = Simulator(server, 500))
        {
            BladeLoad last = null;
            int pressing = 0;
            double largestError = 0, largestMoment = 0;
            string error = "";
            var gate = new object();
            simulator.BladeLoaded += load =>
            {
                lock (gate)
                {
                    last = load;
                    if (load.Ids.Length == 0) return;
                    ++pressing;
                    Vec3 sum = load.ForceN, moment = new Vec3();
                    lock (simulator.Lock)
                    {
                        var body = (VolumeState)simulator.State;
                        for (int i = 0; i < load.Ids.Length; ++i)
                        {
                            var force = new Vec3(load.Forces[3 * i], load.Forces[3 * i + 1], load.Forces[3 * i + 2]);
                            body.TryVertex(load.Ids[i], out Vec3 at, out Vec3 rest);
                            sum += force;
                            moment += Vec3.Cross(at - load.Center, force);
                        }
                    }
                    largestError = Math.Max(largestError, sum.Length);
                    largestMoment = Math.Max(largestMoment, moment.Length);
                }
            };
            simulator.ErrorReceived += message => { lock (gate) error = message.Text; };
            simulator.Start();
            Check.That(simulator.WaitForRevision(0, 60), simulator.LastError);
            var edge = new BladeEdge(new Vec3(), new Vec3(0, 0, -0.05));
            using (var hand = new Client("127.0.0.1", server.Port, new ClientOptions { Role = Role.Operator, View = View.None, Blade = edge }))
            {
                hand.Start();
                Check.That(hand.WaitForWelcome(60), hand.LastError);
                Box box = simulator.Welcome.Mesh.Box;
                double down = 0;
                Func<double, int> step = by =>
                {
                    down += by;
                    hand.SendPose(new PoseSample
                    {
                        SourceNs = Clock.NowNs, Orientation = Quat.Identity,
                        Position = new Vec3(0.5 * (box.Min.X + box.Max.X), 0.5 * (box.Min.Y + box.Max.Y), box.Max.Z + 0.055 - down)
                    });
                    Thread.Sleep(1);
                    lock (gate) return pressing;
                };
                // Down until it presses, then to and fro, until enough has come however slow the machine is.
                for (int i = 0; i < 20000 && step(2e-5) == 0; ++i) { }
                for (int i = 0; i < 20000 && step(i / 50 % 2 == 0 ? 1e-5 : -1e-5) < 20; ++i) { }
                Check.That(pressing >= 20, "loads: " + pressing);
                Check.That(largestError < 1e-6 && largestMoment < 1e-6, "they sum to " + largestError + " N and " + largestMoment + " N m");
                Func<double, uint, string> answer = (stiffness, source) =>
                {
                    lock (gate)
                    {
                        error = "";
                        simulator.SendModel(new BladeModel
                        {
                            Source = source, ServerNs = last.ServerNs, Point = last.Tool, Normal = new Vec3(0, 0, 1),
                            Stiffness = new[] { 0, 0, 0, 0, 0, 0, 0, 0, stiffness }, ValidForNs = 900000000
                        });
                    }
                    for (int i = 0; i < 300; ++i) step(0);
                    lock (gate) return error;
                };
                Check.Equal(answer(100, last.Source), "", "a model");
                Check.That(answer(-100, last.Source).Contains("semidefinite"), "a stiffness below 0: " + error);
                Check.That(answer(100, last.Source + 7).Contains("no BladeLoad"), "another blade: " + error);
                // Up again: the last word is that nothing acts.
                for (int i = 0; i < 20000 && down > -0.005; ++i) step(-1e-4);
                for (int i = 0; i < 20000 && last.Contact != BladeContact.None; ++i) Thread.Sleep(1);
                Check.That(last.Contact == BladeContact.None && last.ForceN.Length <= 0, "the last load: " + last.Contact);
                Check.Equal(simulator.Status, ClientStatus.Connected, "status");
                Check.Equal(simulator.Counters.HandlerFaults, 0L, "handler: " + simulator.LastHandlerFault);
            }
        }
    }
}
