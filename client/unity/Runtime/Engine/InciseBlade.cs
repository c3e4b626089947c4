using Incise;
using UnityEngine;

namespace InciseUnity
{
    /// <summary>
    /// Sends this Transform's pose at each FixedUpdate; the edge runs from heel to tip in its frame. With deviceDriven, a
    /// device's thread calls Step() instead, at its own rate, and the Transform follows it.
    /// </summary>
    [AddComponentMenu("Incise/Blade")]
    public sealed class InciseBlade : MonoBehaviour
    {
        public InciseConnection connection;
        [Tooltip("The body to cut. Poses are relative to it.")]
        public InciseBody body;
        [Tooltip("Holds the engage button: the blade cuts.")]
        public bool cut;
        [Tooltip("A device's thread calls Step(); this Transform follows.")]
        public bool deviceDriven;
        [Tooltip("Scene units that the blade moves by for a metre of the hand.")]
        public float handScale = 1;
        [Tooltip("Largest force, N.")]
        public float mostForce = 3.3f;
        [Tooltip("Largest torque, N m, of a device that makes one.")]
        public float mostTorque = 0.2f;

        private readonly object gate = new object();
        private HapticTool tool; // guarded by gate; of toolClient
        private Client toolClient;
        private Vector3 position, force, torque; // guarded by gate
        private Quaternion rotation;
        private bool stepped;

        /// <summary>On the hand, N, world axes.</summary>
        public Vector3 Force { get { lock (gate) return force; } }

        /// <summary>On the hand, about this Transform's position, N m, world axes and Unity's sense of rotation. Zero without a device that makes one.</summary>
        public Vector3 Torque { get { lock (gate) return torque; } }

        /// <summary>What the server says of the force: engaged length, saturation, latches. Null: nothing yet.</summary>
        public Incise.Force LastReport
        {
            get
            {
                lock (gate) return tool != null ? tool.LastForce : null;
            }
        }

        /// <summary>Any thread, but one at a time: the tool is here now, in world space. Returns the force on the hand, N, world axes.</summary>
        public Vector3 Step(Vector3 worldPosition, Quaternion worldRotation, bool cuts)
        {
            HapticTool current = Move(worldPosition, worldRotation);
            if (current == null) return Vector3.zero;
            Vector3 now = current.Step(worldPosition.ToIncise(), worldRotation.ToIncise(), cuts).ToUnity();
            lock (gate) force = now;
            return now;
        }

        /// <summary>The same for a device that makes torques: force and torque about worldPosition. Use one of the two throughout.</summary>
        public void Step(Vector3 worldPosition, Quaternion worldRotation, bool cuts, out Vector3 newtons, out Vector3 newtonMetres)
        {
            newtons = newtonMetres = Vector3.zero;
            HapticTool current = Move(worldPosition, worldRotation);
            if (current == null) return;
            Wrench now = current.StepWrench(worldPosition.ToIncise(), worldRotation.ToIncise(), cuts);
            newtons = now.ForceN.ToUnity();
            newtonMetres = now.TorqueNM.ToUnity();
            lock (gate)
            {
                force = newtons;
                torque = newtonMetres;
            }
        }

        private HapticTool Move(Vector3 worldPosition, Quaternion worldRotation)
        {
            lock (gate)
            {
                position = worldPosition;
                rotation = worldRotation;
                stepped = true;
                return tool;
            }
        }

        private void FixedUpdate()
        {
            Client client = connection != null ? connection.Client : null;
            if (client != toolClient) Take(client);
            if (tool == null) return;
            tool.HandScale = handScale;
            tool.Place(body != null ? body.transform.ToPlacement() : Placement.Origin);
            if (!deviceDriven) Step(transform.position, transform.rotation, cut);
        }

        private void Update()
        {
            if (!deviceDriven) return;
            lock (gate)
            {
                if (!stepped) return;
                transform.position = position;
                transform.rotation = rotation;
            }
        }

        private void OnDisable()
        {
            Take(null);
        }

        private void Take(Client client)
        {
            lock (gate)
            {
                if (tool != null) tool.Dispose();
                toolClient = client;
                tool = null;
                force = torque = Vector3.zero;
                if (client != null) tool = new HapticTool(client, new ContactLimits { MostN = mostForce, MostTorqueNM = mostTorque });
            }
        }
    }
}
