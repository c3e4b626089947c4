using System;

namespace Incise
{
    /// <summary>What may be asked of the device at this end.</summary>
    public sealed class ContactLimits
    {
        /// <summary>Newtons, and newtons a second.</summary>
        public double MostN = 3.3, SlewNS = 500;
        /// <summary>From nothing to full force at the first contact, and after a contact that expired in use.</summary>
        public double RampS = 2;
        public double StiffestNM = 2000;
    }

    /// <summary>
    /// Renders the tissue near the blade at the device's own rate from the planes that the server sends (Force.Contact,
    /// PROTOCOL.md, section 7), however old they are. The same arithmetic as client/contact_renderer.cpp: no force is NaN,
    /// exceeds the limits or starts without the ramp. In t seconds at most ReserveJ + LeakW t comes out beyond what went in,
    /// except for the work of one step and of the fade, whatever the delay. Incise's frame. Thread: Take() from one, Render() from one.
    /// </summary>
    public sealed class ContactRenderer
    {
        public const double ReserveJ = 5e-4, LeakW = 0.01;
        private const double SmoothingS = 0.005; // of the velocity
        private const double LongestStepS = 0.005; // after a pause of the caller a force grows as in this time at most
        private const long LongestNs = 1000000000; // a plane is valid at most so long, whatever it says

        private sealed class Plane
        {
            public Vec3 Point, Normal;
            public double Stiffness, Damping, Resistance, Friction;
            public bool Penetrated;
            public long UntilNs;
            public bool Over = true; // the server said that there is no tissue; otherwise it has expired
        }

        private readonly ContactLimits limits;
        private volatile Plane newest = new Plane();
        // The device's thread's.
        private Plane taken;
        private Vec3 point; // the plane's, which gives way
        private bool begun;
        private long lastNs;
        private Vec3 lastTool, velocity, applied, slewed;
        private double account = ReserveJ, ramp;

        public ContactRenderer(ContactLimits limits = null)
        {
            this.limits = limits ?? new ContactLimits();
        }

        /// <summary>Takes over a message that arrived at nowNs, by a clock of this machine. For Client.ForceReceived.</summary>
        public void Take(Force force, long nowNs)
        {
            var plane = new Plane { UntilNs = nowNs };
            LocalContact c = force.Contact;
            if (c != null && IsSound(c))
            {
                plane.Point = c.Point;
                plane.Normal = (1 / c.Normal.Length) * c.Normal;
                plane.Stiffness = Math.Min(c.StiffnessNPerM, limits.StiffestNM);
                plane.Damping = c.DampingNSPerM;
                plane.Resistance = c.CuttingResistanceN;
                plane.Friction = c.FrictionNSPerM;
                plane.Penetrated = c.Penetrated;
                plane.Over = false;
                plane.UntilNs = nowNs + Math.Min(c.ValidForNs, LongestNs);
            }
            newest = plane;
        }

        private static bool IsSound(LocalContact c)
        {
            return c.Point.IsFinite && c.Normal.IsFinite && c.Normal.Length > 0.5 && c.Normal.Length < 2 && c.StiffnessNPerM >= 0 &&
                   c.DampingNSPerM >= 0 && c.CuttingResistanceN >= 0 && c.FrictionNSPerM >= 0 && c.ValidForNs > 0;
        }

        /// <summary>
        /// The force on the hand, N, for the tool's origin at toolM now. Apply it until the next call. The clock is that of
        /// Take() and must rise.
        /// </summary>
        public Vec3 Render(Vec3 toolM, long nowNs)
        {
            Plane plane = newest;
            if (plane != taken) point = plane.Point; // the same plane keeps the place to which it has given way
            taken = plane;
            bool usable = toolM.IsFinite;
            double dt = begun ? Math.Max(0, (nowNs - lastNs) * 1e-9) : 0;
            if (dt > 0 && usable)
            {
                Vec3 step = toolM - lastTool;
                account += LeakW * dt - Vec3.Dot(applied, step);
                velocity += dt / (SmoothingS + dt) * ((1 / dt) * step - velocity);
            }
            lastNs = nowNs;
            if (usable)
            {
                lastTool = toolM;
                begun = true;
            }
            bool valid = usable && nowNs < plane.UntilNs;
            Vec3 elastic = new Vec3(), viscous = new Vec3();
            double energy = valid ? Press(plane, toolM, ref elastic, ref viscous) : 0;
            account = Math.Min(account, energy + ReserveJ);
            double held = Math.Max(account, 0);
            Vec3 wanted = (energy > held ? held / energy : 1) * elastic + Math.Min(1, held / ReserveJ) * viscous;
            return Limit(wanted, Math.Min(dt, LongestStepS), valid, energy > 0 || plane.Penetrated);
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
            if (wanted.Length > limits.MostN) wanted = limits.MostN / wanted.Length * wanted;
            double most = Math.Max(0, limits.SlewNS - limits.MostN / limits.RampS) * growingS;
            Vec3 change = wanted - slewed;
            slewed = change.Length > most ? slewed + most / change.Length * change : wanted;
            if (valid && (ramp > 0 || touching)) ramp = Math.Min(1, ramp + growingS / limits.RampS);
            applied = ramp * slewed;
            // A plane expired while it acted: once the force has faded, the next one starts from nothing.
            if (!valid && !taken.Over && slewed.Length <= 0) ramp = 0;
            return applied;
        }
    }
}
