using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Globalization;
using System.Text;
using System.Threading.Tasks;
using Incise;

/// <summary>Frames of reference, and the contact renderer's arithmetic.</summary>
public static class FrameTests
{
    private const long Ms = 1000000;

    /// <summary>What is turned and then converted is what is converted and then turned; the handedness changes.</summary>
    public static void ConversionCommutesWithRotation()
    {
        var random = new Random(7);
        for (int i = 0; i < 200; ++i)
        {
            Quat q = RandomQuat(random);
            Vec3 v = RandomVec(random);
            CheckNear(UnityFrame.Convert(q.Rotate(v)), UnityFrame.Convert(q).Rotate(UnityFrame.Convert(v)), "rotation");
            CheckNear(UnityFrame.Convert(UnityFrame.Convert(v)), v, "there and back");
        }
        // Up stays up: Incise's phantoms have z up, Unity has y up.
        CheckNear(UnityFrame.Convert(new Vec3(0, 0, 1)), new Vec3(0, 1, 0), "up");
        Vec3 x = UnityFrame.Convert(new Vec3(1, 0, 0)), y = UnityFrame.Convert(new Vec3(0, 1, 0)), z = UnityFrame.Convert(new Vec3(0, 0, 1));
        Check.Near(Vec3.Dot(Vec3.Cross(x, y), z), -1, 1e-12, "the handedness");
    }

    /// <summary>Unity's own example: 90 degrees about y turn forward to the right; in Incise's frame that is about -z.</summary>
    public static void AQuarterTurnIsUnitys()
    {
        double half = Math.Sqrt(0.5);
        var unity = new Quat(half, 0, half, 0);
        CheckNear(unity.Rotate(new Vec3(0, 0, 1)), new Vec3(1, 0, 0), "Unity's forward");
        Quat incise = UnityFrame.Convert(unity);
        CheckNear(incise.Rotate(UnityFrame.Convert(new Vec3(0, 0, 1))), UnityFrame.Convert(new Vec3(1, 0, 0)), "the same in Incise's frame");
    }

    public static void PlacementGoesThereAndBack()
    {
        var random = new Random(8);
        for (int i = 0; i < 200; ++i)
        {
            var body = new Placement { Position = RandomVec(random), Rotation = RandomQuat(random), Scale = 0.1 + 10 * random.NextDouble() };
            Vec3 point = RandomVec(random);
            // Unity's Transform: scale, turn, move.
            Vec3 world = body.Position + body.Rotation.Rotate(body.Scale * UnityFrame.Convert(point));
            CheckNear(body.ToBody(world), point, "point");
            Quat tool = RandomQuat(random);
            Vec3 edge = RandomVec(random);
            Vec3 inWorld = body.ToWorld(tool.Rotate(edge)); // a direction on a tool that is turned by `tool` in the body
            Quat worldTool = body.Rotation * UnityFrame.Convert(tool);
            CheckNear(worldTool.Rotate(UnityFrame.Convert(edge)), inWorld, "direction");
            CheckNear(body.ToBody(worldTool).Rotate(edge), tool.Rotate(edge), "rotation");
        }
    }

    /// <summary>However body and hand are scaled, the force does no more work on the hand than on the blade, and is never magnified.</summary>
    public static void TheHandDoesTheBladesWork()
    {
        foreach (double scale in new[] { 0.1, 1, 10 })
        {
            foreach (double handScale in new[] { 0.5, 1, 10, 20 })
            {
                var body = new Placement { Rotation = Quat.Identity, Scale = scale };
                double share = body.ForceShare(handScale);
                Vec3 hand = new Vec3(0.001, 0.002, -0.003), force = new Vec3(1, 2, 3);
                Vec3 blade = body.ToBody(handScale * hand) - body.ToBody(new Vec3());
                double onHand = Math.Abs(Vec3.Dot(share * body.ToWorld(force), hand)), onBlade = Math.Abs(Vec3.Dot(force, blade));
                Check.That(onHand <= onBlade * (1 + 1e-12) && share <= 1, "scales " + scale + " and " + handScale + ": " + onHand + " J of " + onBlade);
                Check.That(share * body.Scale >= Math.Min(handScale, body.Scale) - 1e-12, "not smaller than need be");
            }
        }
    }

    private static Quat RandomQuat(Random random)
    {
        return new Quat(random.NextDouble() - 0.5, random.NextDouble() - 0.5, random.NextDouble() - 0.5, random.NextDouble() - 0.5).Normalized;
    }

    private static Vec3 RandomVec(Random random)
    {
        return new Vec3(random.NextDouble() - 0.5, random.NextDouble() - 0.5, random.NextDouble() - 0.5);
    }

    private static void CheckNear(Vec3 found, Vec3 expected, string what)
    {
        Check.That((found - expected).Length < 1e-9, what + ": found " + found + ", expected " + expected);
    }

    // ---- Contact ----

    private static Force Golden()
    {
        byte[] bytes = System.IO.File.ReadAllBytes(Vectors.PathOf("messages/Force.bin"));
        return (Force)MessageReader.Read(bytes, bytes.Length).Body;
    }

    /// <summary>The golden plane, at z = 0.03, of 800 N/m, that gives way at 0.75 N: pressed for long enough, it gives that.</summary>
    public static void APlaneHoldsWhatItResists()
    {
        Force force = Golden();
        force.Contact.FrictionNSPerM = 0;
        force.Contact.Penetrated = false;
        var renderer = new ContactRenderer();
        Vec3 felt = new Vec3();
        double last = 0;
        for (int ms = 0; ms < 4000; ++ms)
        {
            if (ms % 10 == 0) renderer.Take(force, ms * Ms);
            felt = renderer.Render(new Vec3(0, 0, 0.03 - Math.Min(ms * 1e-6, 0.0009)), ms * Ms);
            Check.That(felt.Length <= last + 0.5 + 1e-9, "slew at " + ms + " ms");
            last = felt.Length;
        }
        CheckClose(felt.Z, 800 * 0.0009, "0.9 mm deep");
        renderer.Take(new Force(), 4000 * Ms);
        for (int ms = 4000; ms < 4100; ++ms) felt = renderer.Render(new Vec3(0, 0, 0.0291), ms * Ms);
        Check.Equal(felt.Length, 0.0, "without a contact");
    }

    private static void CheckClose(double found, double expected, string what)
    {
        Check.Near(found, expected, 0.01 * Math.Abs(expected), what);
    }

    public static void AForceFadesWhenItsPlaneExpires()
    {
        Force force = Golden();
        var renderer = new ContactRenderer();
        double most = 0, after = 0;
        for (int ms = 0; ms < 2100; ++ms)
        {
            if (ms < 2000 && ms % 10 == 0) renderer.Take(force, ms * Ms);
            double felt = renderer.Render(new Vec3(0, 0, 0.0295), ms * Ms).Length;
            if (ms < 2000) most = Math.Max(most, felt);
            else after = felt;
        }
        Check.That(most > 0.3 && most <= 3.3, "force " + most);
        Check.Equal(after, 0.0, "force after it expired");
        Check.That(!(renderer.Render(new Vec3(double.NaN, 0, 0), 2200 * Ms).Length > 0), "a place that is no number");
    }

    /// <summary>The Python client's renderer, which the project's other tests know, computes the same.</summary>
    public static void ItRendersAsPythonDoes()
    {
        var random = new Random(31);
        var renderer = new ContactRenderer();
        var lines = new StringBuilder();
        var found = new List<Vec3>();
        var tool = new Vec3(0, 0, 0.03);
        long ns = 0;
        for (int step = 0; step < 8000; ++step)
        {
            ns += random.Next(1, 3000000);
            if (random.Next(8) == 0)
            {
                Force force = RandomForce(random, tool);
                LocalContact c = force.Contact;
                renderer.Take(force, ns);
                lines.Append("take " + ns);
                if (c != null)
                    foreach (double x in new[] { c.Point.X, c.Point.Y, c.Point.Z, c.Normal.X, c.Normal.Y, c.Normal.Z, c.StiffnessNPerM, c.DampingNSPerM,
                        c.CuttingResistanceN, c.FrictionNSPerM, c.ValidForNs, c.Penetrated ? 1 : 0 }) lines.Append(" " + Text(x));
                lines.Append("\n");
            }
            tool += 0.0002 * RandomVec(random);
            lines.Append("render " + ns + " " + Text(tool.X) + " " + Text(tool.Y) + " " + Text(tool.Z) + "\n");
            found.Add(renderer.Render(tool, ns));
        }
        string[] expected = Python(lines.ToString()).Split(new[] { '\n' }, StringSplitOptions.RemoveEmptyEntries);
        Check.Equal(expected.Length, found.Count, "forces");
        double largest = 0;
        for (int i = 0; i < expected.Length; ++i)
        {
            double[] f = Array.ConvertAll(expected[i].Split(' '), word => double.Parse(word, CultureInfo.InvariantCulture));
            Check.That((found[i] - new Vec3(f[0], f[1], f[2])).Length < 1e-9, "step " + i + ": found " + found[i] + ", Python has " + expected[i]);
            largest = Math.Max(largest, found[i].Length);
        }
        Check.That(largest > 0.02, "largest force " + largest);
    }

    private static Force RandomForce(Random random, Vec3 tool)
    {
        if (random.Next(20) == 0) return new Force();
        Force force = Golden();
        force.Contact.Point = tool + 0.001 * RandomVec(random);
        force.Contact.Normal = RandomQuat(random).Rotate(new Vec3(0, 0, random.Next(30) == 0 ? 3 : 1.1)); // now and then unsound
        force.Contact.CuttingResistanceN = random.Next(2) * random.NextDouble();
        force.Contact.Penetrated = random.Next(2) == 0;
        force.Contact.ValidForNs = random.Next(20, 60) * Ms;
        return force;
    }

    private static string Text(double x)
    {
        return x.ToString("r", CultureInfo.InvariantCulture);
    }

    private static string Python(string input)
    {
        string script = System.IO.Path.Combine(Vectors.Source, "tests", "unity", "contact_reference.py");
        using (Process run = Process.Start(new ProcessStartInfo("/usr/bin/python3", "-B " + script)
        {
            UseShellExecute = false, RedirectStandardInput = true, RedirectStandardOutput = true
        }))
        {
            Task<string> output = run.StandardOutput.ReadToEndAsync();
            run.StandardInput.Write(input);
            run.StandardInput.Close();
            run.WaitForExit();
            return output.Result;
        }
    }

    /// <summary>Planes that come late, jump and lie do not make it an engine: what comes out stays within the account.</summary>
    public static void WhatComesOutIsBounded()
    {
        var random = new Random(99);
        for (int round = 0; round < 8; ++round)
        {
            var renderer = new ContactRenderer();
            var tool = new Vec3(0, 0, 0.03);
            var velocity = new Vec3();
            Vec3 felt = new Vec3();
            double given = 0; // work done by the force on the tool
            double steps = 0; // of one step each: force that changes within it
            for (int ms = 0; ms < 5000; ++ms)
            {
                if (ms % 7 == 0)
                {
                    Force force = Golden();
                    force.Contact.Point = tool + 0.004 * (random.NextDouble() - 0.3) * force.Contact.Normal;
                    force.Contact.CuttingResistanceN = random.Next(2) * 2.0;
                    renderer.Take(force, ms * Ms);
                }
                Vec3 step = 0.001 * velocity;
                given += Vec3.Dot(felt, step);
                tool += step;
                Vec3 next = renderer.Render(tool, ms * Ms);
                steps = Math.Max(steps, Vec3.Dot(felt, step));
                felt = next;
                velocity += 0.001 / 0.05 * felt; // 50 g in nobody's hand
                Check.That(felt.IsFinite && felt.Length <= 3.3 + 1e-9, "force " + felt);
                double bound = ContactRenderer.ReserveJ + ContactRenderer.LeakW * ms * 1e-3 + steps + 0.002;
                Check.That(given <= bound, "round " + round + ", " + ms + " ms: " + given + " J of " + bound);
            }
            Check.That(given > 1e-5, "the planes pushed: " + given);
        }
    }
}
