using System;

namespace Incise
{
    /// <summary>What may be asked of the device at this end.</summary>
    public sealed class ContactLimits
    {
        /// <summary>Newtons, and newtons a second: above MostN / RampS, the part that the ramp takes.</summary>
        public double MostN = 3.3, SlewNS = 500;
        /// <summary>From nothing to full force at the first contact, after a contact that expired in use, and after a silence. 0: at once.</summary>
        public double RampS = 2;
        public double StiffestNM = 2000;
        /// <summary>Newton metres. The torque's change is limited in the same proportion to SlewNS.</summary>
        public double MostTorqueNM = 0.2;
    }

    /// <summary>What acts on the hand: N, and N m about the tool's origin.</summary>
    public struct Wrench
    {
        public Vec3 ForceN, TorqueNM;
    }

    /// <summary>
    /// Renders the tissue near the blade at the device's own rate from the planes that the server sends (Force.Contact,
    /// PROTOCOL.md, section 7), however old they are. The same arithmetic as client/contact_renderer.cpp: no force is NaN,
    /// exceeds the limits or starts without the ramp. In t seconds at most ReserveJ + LeakW t comes out beyond what went in,
    /// except for the work of one step and of the fade, whatever the delay. After SilenceNs without a call (a thread that was
    /// paused) the next call gives no force, and the ramp begins again: what the device did meanwhile is not known here.
    /// Incise's frame. Thread: Take() from one, Render() or RenderWrench() from one.
    /// </summary>
    public sealed class ContactRenderer
    {
        public const double ReserveJ = 5e-4, LeakW = 0.01;
        public const long SilenceNs = 50000000;
        private const double SmoothingS = 0.005; // of the velocity
        private const double LongestStepS = 0.005; // after a pause of the caller a force grows as in this time at most
        private const long LongestNs = 1000000000; // a plane is valid at most so long, whatever it says
        private const double FarthestM = 1e4;

        private sealed class Plane
        {
            public Vec3 Point, Normal, Arm;
            public double Stiffness, Damping, Resistance, Friction;
            public bool Penetrated;
            public long UntilNs;
            public bool Over = true; // the server said that there is no tissue; otherwise it has expired
        }

        private readonly double mostN, slewBesideRampNS, rampS, stiffestNM, mostTorqueNM, torqueSlewNMS;
        private volatile Plane newest = new Plane();
        // The device's thread's.
        private Plane taken;
        private Vec3 point; // the plane's, which gives way
        private bool called, begun, turned; // at all; with a place, with an orientation that can be used
        private long lastNs, toolNs; // of those calls
        private Vec3 lastTool, velocity, applied, slewed, torque;
        private Quat orientation;
        private double account = ReserveJ, ramp;

        /// <summary>Throws ArgumentException: a limit that is no finite number from 0, or a slew limit that the ramp uses up.</summary>
        public ContactRenderer(ContactLimits limits = null)
        {
            ContactLimits l = limits ?? new ContactLimits();
            mostN = Amount(l.MostN, "MostN");
            rampS = Amount(l.RampS, "RampS");
            stiffestNM = Amount(l.StiffestNM, "StiffestNM");
            mostTorqueNM = Amount(l.MostTorqueNM, "MostTorqueNM");
            slewBesideRampNS = l.SlewNS - (rampS > 0 ? mostN / rampS : 0);
            if (!(slewBesideRampNS > 0) || double.IsInfinity(l.SlewNS))
                throw new ArgumentException("ContactLimits: SlewNS is " + l.SlewNS + "; accepted are finite numbers above MostN / RampS");
            torqueSlewNMS = mostN > 0 ? l.SlewNS * mostTorqueNM / mostN : 0;
        }

        private static double Amount(double value, string name)
        {
            if (!(value >= 0) || double.IsInfinity(value))
                throw new ArgumentException("ContactLimits: " + name + " is " + value + "; accepted are finite numbers from 0");
            return value;
        }

        /// <summary>Takes over a message that arrived at nowNs, by a clock of this machine. For Client.ForceReceived.</summary>
        public void Take(Force force, long nowNs)
        {
            var plane = new Plane { UntilNs = nowNs, Arm = newest.Arm }; // a force that fades acts where it did
            LocalContact c = force.Contact;
            if (c != null && IsSound(c))
            {
                plane.Point = c.Point;
                plane.Normal = (1 / c.Normal.Length) * c.Normal;
                plane.Stiffness = Math.Min(c.StiffnessNPerM, stiffestNM);
                plane.Damping = c.DampingNSPerM;
                plane.Resistance = c.CuttingResistanceN;
                plane.Friction = c.FrictionNSPerM;
                plane.Penetrated = c.Penetrated;
                plane.Arm = c.Arm;
                plane.Over = false;
                plane.UntilNs = nowNs + Math.Min(c.ValidForNs, LongestNs);
            }
            newest = plane;
        }

        private static bool IsSound(LocalContact c)
        {
            return c.Point.IsFinite && c.Arm.IsFinite && c.Normal.IsFinite && c.Normal.Length > 0.5 && c.Normal.Length < 2 &&
                   IsAmount(c.StiffnessNPerM) && IsAmount(c.DampingNSPerM) && IsAmount(c.CuttingResistanceN) && IsAmount(c.FrictionNSPerM) &&
                   c.ValidForNs > 0;
        }

        private static bool IsAmount(double value)
        {
            return value >= 0 && !double.IsInfinity(value);
        }

        /// <summary>
        /// The force on the hand, N, for the tool's origin at toolM now. Apply it until the next call. With a tool that is not
        /// finite, or more than 10 km away, it fades. The clock is that of Take() and must rise.
        /// </summary>
        public Vec3 Render(Vec3 toolM, long nowNs)
        {
            Plane plane = newest;
            if (plane != taken) point = plane.Point; // the same plane keeps the place to which it has given way
            taken = plane;
            bool usable = toolM.IsFinite && toolM.Length <= FarthestM;
            double dt = begun ? Math.Max(0, (nowNs - toolNs) * 1e-9) : 0;
            if (dt > 0 && usable)
            {
                Vec3 step = toolM - lastTool;
                account += LeakW * dt - Vec3.Dot(applied, step);
                velocity += dt / (SmoothingS + dt) * ((1 / dt) * step - velocity);
            }
            double growing = GrowingS(nowNs);
            if (called && nowNs - lastNs > SilenceNs)
            {
                applied = slewed = torque = velocity = new Vec3();
                ramp = 0;
            }
            lastNs = nowNs;
            called = true;
            if (usable)
            {
                lastTool = toolM;
                toolNs = nowNs;
                begun = true;
            }
            bool valid = usable && nowNs < plane.UntilNs;
            Vec3 elastic = new Vec3(), viscous = new Vec3();
            double energy = valid ? Press(plane, toolM, ref elastic, ref viscous) : 0;
            account = Math.Min(account, energy + ReserveJ);
            double held = Math.Max(account, 0);
            Vec3 wanted = (energy > held ? held / energy : 1) * elastic + Math.Min(1, held / ReserveJ) * viscous;
            return Limit(wanted, growing, valid, energy > 0 || plane.Penetrated);
        }

        /// <summary>
        /// The same for a device that makes torques: force, and torque about the tool's origin. The force acts where the tissue
        /// presses on the blade, and turning the tool is work that is booked, too. toolTurned is the unit quaternion
        /// world_from_tool; one that is not finite or far from unit is passed over. Use one of the two throughout.
        /// </summary>
        public Wrench RenderWrench(Vec3 toolM, Quat toolTurned, long nowNs)
        {
            Quat q = toolTurned;
            double squared = q.W * q.W + q.X * q.X + q.Y * q.Y + q.Z * q.Z;
            if (squared > 0.25 && squared < 4)
            {
                if (turned) account -= Vec3.Dot(torque, Turn(orientation, q));
                orientation = q;
                turned = true;
            }
            double growing = GrowingS(nowNs); // before Render() takes the time
            Vec3 force = Render(toolM, nowNs);
            Vec3 wanted = Vec3.Cross(taken.Arm, force);
            if (!wanted.IsFinite) wanted = new Vec3();
            if (wanted.Length > mostTorqueNM) wanted = mostTorqueNM / wanted.Length * wanted;
            // The force is ramped, so its moment is; an arm that jumps is not.
            torque = Toward(torque, wanted, torqueSlewNMS * growing);
            return new Wrench { ForceN = force, TorqueNM = torque };
        }

        /// <summary>What a force may grow by at this call, as time. 0 at the first one, and at the first after a silence.</summary>
        private double GrowingS(long nowNs)
        {
            long passed = called ? Math.Max(0, nowNs - lastNs) : 0;
            return passed > SilenceNs ? 0 : Math.Min(passed * 1e-9, LongestStepS);
        }

        /// <summary>From a to b, by so much at most.</summary>
        private static Vec3 Toward(Vec3 a, Vec3 b, double most)
        {
            Vec3 change = b - a;
            return change.Length > most ? a + most / change.Length * change : b;
        }

        /// <summary>The rotation from a to b as its axis times its angle, by the shorter way.</summary>
        private static Vec3 Turn(Quat a, Quat b)
        {
            double w = a.W * b.W + a.X * b.X + a.Y * b.Y + a.Z * b.Z;
            Vec3 va = new Vec3(a.X, a.Y, a.Z), vb = new Vec3(b.X, b.Y, b.Z);
            Vec3 v = a.W * vb - b.W * va - Vec3.Cross(vb, va);
            double sine = v.Length;
            return sine > 0 ? (w < 0 ? -2 : 2) * Math.Atan2(sine, Math.Abs(w)) / sine * v : new Vec3();
        }

        /// <summary>A spring that gives way at its resistance, a damper that does not pull, friction. Returns the spring's energy, J.</summary>
        private double Press(Plane plane, Vec3 tool, ref Vec3 elastic, ref Vec3 viscous)
        {
            double depth = Vec3.Dot(plane.Normal, point - tool);
            if (plane.Resistance > 0 && plane.Stiffness * depth > plane.Resistance)
            {
                double holds = plane.Resistance / plane.Stiffness;
                point += (holds - depth) * plane.Normal;
                depth = holds;
            }
            double away = Vec3.Dot(plane.Normal, velocity);
            double spring = plane.Stiffness * Math.Max(depth, 0);
            if (depth > 0) viscous = Math.Max(-plane.Damping * away, -spring) * plane.Normal;
            elastic = spring * plane.Normal;
            if (plane.Penetrated) viscous -= plane.Friction * velocity;
            else if (depth > 0) viscous -= plane.Friction * (velocity - away * plane.Normal);
            return 0.5 * spring * Math.Max(depth, 0);
        }

        /// <summary>The limits in the server's order: finite, clamp, slew, ramp.</summary>
        private Vec3 Limit(Vec3 wanted, double growingS, bool valid, bool touching)
        {
            if (!wanted.IsFinite) wanted = new Vec3();
            if (wanted.Length > mostN) wanted = mostN / wanted.Length * wanted;
            slewed = Toward(slewed, wanted, slewBesideRampNS * growingS);
            if (valid && (ramp > 0 || touching)) ramp = rampS > 0 ? Math.Min(1, ramp + growingS / rampS) : 1;
            applied = ramp * slewed;
            // A plane expired while it acted: once the force has faded, the next one starts from nothing.
            if (!valid && !taken.Over && slewed.Length <= 0) ramp = 0;
            return applied;
        }
    }
}
