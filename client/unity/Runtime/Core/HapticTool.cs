using System;

namespace Incise
{
    /// <summary>Where a body stands in Unity's world: its Transform.</summary>
    public struct Placement
    {
        public Vec3 Position;
        public Quat Rotation;
        /// <summary>The same along all axes.</summary>
        public double Scale;

        public static Placement Origin
        {
            get { return new Placement { Rotation = Quat.Identity, Scale = 1 }; }
        }

        /// <summary>From a point of Unity's world to the body's frame, Incise's.</summary>
        public Vec3 ToBody(Vec3 world)
        {
            return UnityFrame.Convert(1 / Scale * Rotation.Inverse.Rotate(world - Position));
        }

        public Quat ToBody(Quat world)
        {
            return UnityFrame.Convert(Rotation.Inverse * world).Normalized;
        }

        /// <summary>
        /// The share of the tissue's force that a hand gets whose metre moves the tool by so many units. Where the hand moves by more
        /// than the blade does in the body, it is the ratio: the hand then does the blade's work, and ContactRenderer's bound on what
        /// comes out holds for it.
        /// </summary>
        public double ForceShare(double handScale)
        {
            return Math.Min(1, handScale / Scale);
        }

        /// <summary>The same for the torque: turning is not magnified, but the arm of the force at the hand is.</summary>
        public double TorqueShare(double handScale)
        {
            return Math.Min(1, Scale / handScale);
        }

        /// <summary>A force in the body's frame as a direction of Unity's world.</summary>
        public Vec3 ToWorld(Vec3 direction)
        {
            return Rotation.Rotate(UnityFrame.Convert(direction));
        }

        /// <summary>A torque in the body's frame in Unity's world, where a rotation about an axis runs the other way.</summary>
        public Vec3 TorqueToWorld(Vec3 torque)
        {
            return -1 * Rotation.Rotate(UnityFrame.Convert(torque));
        }
    }

    /// <summary>
    /// A tool in Unity's world: its poses go out, the force on the hand comes back. Step() or StepWrench() is called by what moves
    /// the tool, a device's own thread at its own rate (1 kHz) or FixedUpdate; neither waits for the network.
    /// Thread: those from one, the rest from any. Give each client one tool.
    /// </summary>
    public sealed class HapticTool : IDisposable
    {
        private readonly Client client;
        private readonly ContactRenderer renderer;
        private readonly object gate = new object();
        private Placement body = Placement.Origin;
        private double handScale = 1;
        private Force lastForce;
        private int engageButton = -1;
        private long lastNs;

        public HapticTool(Client client, ContactLimits limits = null)
        {
            this.client = client;
            renderer = new ContactRenderer(limits);
            client.ForceReceived += Take;
            client.Welcomed += Welcomed;
            Welcome known = client.Welcome;
            if (known != null) Welcomed(known);
        }

        public void Dispose()
        {
            client.ForceReceived -= Take;
            client.Welcomed -= Welcomed;
        }

        /// <summary>Where the body stands now. A scale that is not above 0 is passed over.</summary>
        public void Place(Placement placement)
        {
            if (!(placement.Scale > 0) || double.IsInfinity(placement.Scale) || !placement.Position.IsFinite) return;
            placement.Rotation = placement.Rotation.Normalized;
            lock (gate) body = placement;
        }

        /// <summary>Units of Unity's world that the tool moves by for a metre of the hand. Above 0.</summary>
        public double HandScale
        {
            get { lock (gate) return handScale; }
            set
            {
                if (!(value > 0) || double.IsInfinity(value)) throw new ArgumentOutOfRangeException("value", "HandScale: accepted are numbers above 0");
                lock (gate) handScale = value;
            }
        }

        /// <summary>The server's last word: its own force, the length of the edge in tissue, its safety stages. Null: none yet.</summary>
        public Force LastForce { get { lock (gate) return lastForce; } }

        private void Take(Force force)
        {
            lock (gate) lastForce = force;
            renderer.Take(force, Clock.NowNs);
        }

        private void Welcomed(Welcome welcome)
        {
            lock (gate) engageButton = welcome.EngageButton;
        }

        /// <summary>
        /// The tool is here now, in Unity's world; `cut` holds the engage button (a server without one always cuts). Returns the
        /// force on the hand, N, in Unity's world: apply it until the next call.
        /// </summary>
        public Vec3 Step(Vec3 position, Quat rotation, bool cut)
        {
            PoseSample pose;
            Placement placement;
            double hand;
            Send(position, rotation, cut, out pose, out placement, out hand);
            return placement.ToWorld(placement.ForceShare(hand) * renderer.Render(pose.Position, pose.SourceNs));
        }

        /// <summary>
        /// The same for a device that makes torques: force and torque about `position`, N m, in Unity's world and with Unity's sense
        /// of rotation. Use one of the two throughout.
        /// </summary>
        public Wrench StepWrench(Vec3 position, Quat rotation, bool cut)
        {
            PoseSample pose;
            Placement placement;
            double hand;
            Send(position, rotation, cut, out pose, out placement, out hand);
            Wrench felt = renderer.RenderWrench(pose.Position, pose.Orientation, pose.SourceNs);
            return new Wrench
            {
                ForceN = placement.ToWorld(placement.ForceShare(hand) * felt.ForceN),
                TorqueNM = placement.TorqueToWorld(placement.TorqueShare(hand) * felt.TorqueNM)
            };
        }

        private void Send(Vec3 position, Quat rotation, bool cut, out PoseSample pose, out Placement placement, out double hand)
        {
            int button;
            lock (gate)
            {
                hand = handScale;
                placement = body;
                button = engageButton;
            }
            lastNs = Math.Max(Clock.NowNs, lastNs + 1);
            pose = new PoseSample
            {
                SourceNs = lastNs, Position = placement.ToBody(position), Orientation = placement.ToBody(rotation),
                Buttons = cut && button >= 0 ? 1u << button : 0
            };
            client.SendPose(pose);
        }
    }
}
