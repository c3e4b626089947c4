using System;
using System.Collections.Generic;
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
                // One ratio for both, or energy could go in through the one and come out through the other.
                Check.Near(body.TorqueShare(handScale), onHand / onBlade, 1e-12, "the share of the torque");
            }
        }
    }

    /// <summary>A torque in Unity's frame is that of the converted force at the converted arm, and does the same work as the body turns.</summary>
    public static void TorquesConvertAsCrossProductsDo()
    {
        var random = new Random(9);
        for (int i = 0; i < 200; ++i)
        {
            var body = new Placement { Position = RandomVec(random), Rotation = RandomQuat(random), Scale = 1 };
            Vec3 arm = RandomVec(random), force = RandomVec(random);
            CheckNear(body.TorqueToWorld(Vec3.Cross(arm, force)), Vec3.Cross(body.ToWorld(arm), body.ToWorld(force)), "torque");
            Quat turn = new Quat(1, 1e-4 * random.NextDouble(), 1e-4 * random.NextDouble(), 1e-4 * random.NextDouble()).Normalized;
            Quat world = body.Rotation * UnityFrame.Convert(turn) * body.Rotation.Inverse;
            double work = Vec3.Dot(Vec3.Cross(arm, force), new Vec3(turn.X, turn.Y, turn.Z));
            Check.Near(Vec3.Dot(body.TorqueToWorld(Vec3.Cross(arm, force)), new Vec3(world.X, world.Y, world.Z)), work, 1e-12, "work");
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

    /// <summary>A thread that was paused for longer than a plane is valid begins again from nothing, however fresh the next plane is.</summary>
    public static void AfterASilenceTheRampBeginsAgain()
    {
        Force force = Golden();
        force.Contact.FrictionNSPerM = 0;
        force.Contact.Penetrated = false;
        force.Contact.Arm = new Vec3(0.05, 0, 0);
        foreach (bool torque in new[] { false, true })
        {
            var renderer = new ContactRenderer();
            long now = Ms;
            Func<long, Wrench> after = ns =>
            {
                now += ns;
                renderer.Take(force, now);
                var tool = new Vec3(0, 0, 0.03 - Math.Min((now - Ms) / Ms * 1e-6, 0.0009));
                return torque ? renderer.RenderWrench(tool, Quat.Identity, now) : new Wrench { ForceN = renderer.Render(tool, now) };
            };
            for (int ms = 0; ms < 4000; ++ms) after(Ms);
            CheckClose(after(ContactRenderer.SilenceNs).ForceN.Z, 0.72, "after a short pause");
            foreach (long pause in new[] { ContactRenderer.SilenceNs + 1, 5000 * Ms })
            {
                Wrench felt = after(pause);
                Check.Equal(felt.ForceN.Length + felt.TorqueNM.Length, 0.0, "after a silence of " + pause);
                for (int ms = 0; ms < 200; ++ms) felt = after(Ms);
                CheckClose(felt.ForceN.Z, 0.1 * 0.72, "0.2 s later");
                if (torque) CheckClose(felt.TorqueNM.Y, -0.05 * 0.1 * 0.72, "its torque");
                for (int ms = 0; ms < 2000; ++ms) felt = after(Ms);
                CheckClose(felt.ForceN.Z, 0.72, "after the ramp");
            }
        }
    }

    public static void ImpossibleLimitsAreRefused()
    {
        foreach (double bad in new[] { double.NaN, double.PositiveInfinity, -1 })
        {
            foreach (ContactLimits limits in new[] { new ContactLimits { MostN = bad }, new ContactLimits { SlewNS = bad },
                new ContactLimits { RampS = bad }, new ContactLimits { StiffestNM = bad }, new ContactLimits { MostTorqueNM = bad } })
                Check.Throws<ArgumentException>(() => new ContactRenderer(limits), "a limit of " + bad);
        }
        Check.Throws<ArgumentException>(() => new ContactRenderer(new ContactLimits { SlewNS = 1 }), "a slew limit that the ramp uses up");
    }

    /// <summary>protocol/vectors/contact.json: the renderers of the other languages compute the same.</summary>
    public static void TheGoldenFiguresAreRendered()
    {
        double largest = 0, turning = 0;
        foreach (object item in (List<object>)Json.Parse(System.IO.File.ReadAllText(Vectors.PathOf("contact.json"))))
        {
            var run = Vectors.Map(item);
            var limits = Vectors.Map(run["limits"]);
            var renderer = new ContactRenderer(new ContactLimits
            {
                MostN = Number(limits["most_n"]), SlewNS = Number(limits["slew_n_s"]), RampS = Number(limits["ramp_s"]),
                StiffestNM = Number(limits["stiffest_n_m"]), MostTorqueNM = Number(limits["most_torque_n_m"])
            });
            foreach (object line in (List<object>)run["calls"])
            {
                var call = Vectors.Map(line);
                if (call.ContainsKey("take"))
                {
                    renderer.Take(new Force { Contact = PlaneOf(call["contact"]) }, (long)Json.Make(typeof(long), call["take"]));
                    continue;
                }
                var tool = call["tool"] == null ? new Vec3(double.NaN, 0, 0) : VecOf(call["tool"]);
                var turned = new Quat(double.NaN, 0, 0, 0);
                if (call["turned"] is List<object> q) turned = new Quat(Number(q[0]), Number(q[1]), Number(q[2]), Number(q[3]));
                var now = (long)Json.Make(typeof(long), call["call"]);
                bool torque = (bool)run["torque"];
                Wrench felt = torque ? renderer.RenderWrench(tool, turned, now) : new Wrench { ForceN = renderer.Render(tool, now) };
                CheckNear(felt.ForceN, VecOf(call["force"]), "force at " + now);
                if (torque) CheckNear(felt.TorqueNM, VecOf(call["torque"]), "torque at " + now);
                largest = Math.Max(largest, felt.ForceN.Length);
                turning = Math.Max(turning, felt.TorqueNM.Length);
            }
        }
        Check.That(largest > 1 && turning > 0.03, "largest force " + largest + ", torque " + turning);
    }

    private static LocalContact PlaneOf(object json)
    {
        if (json == null) return null;
        var c = Vectors.Map(json);
        return new LocalContact
        {
            Point = VecOf(c["point"]), Normal = VecOf(c["normal"]), Arm = c.ContainsKey("arm") ? VecOf(c["arm"]) : new Vec3(),
            StiffnessNPerM = Number(c["stiffness_n_per_m"]), DampingNSPerM = Number(c["damping_n_s_per_m"]),
            CuttingResistanceN = Number(c["cutting_resistance_n"]), FrictionNSPerM = Number(c["friction_n_s_per_m"]),
            ValidForNs = (long)Json.Make(typeof(long), c["valid_for_ns"]), Penetrated = (bool)c["penetrated"]
        };
    }

    private static double Number(object number)
    {
        return (double)Json.Make(typeof(double), number);
    }

    private static Vec3 VecOf(object numbers)
    {
        var list = (List<object>)numbers;
        return new Vec3(Number(list[0]), Number(list[1]), Number(list[2]));
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
