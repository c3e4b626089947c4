using System;
using System.Threading;
using Incise;
using UnityEngine;

namespace InciseUnity
{
    /// <summary>
    /// A haptic device that drives a blade from a thread of its own: derive from it, and read and drive your device's plugin in
    /// Read() and Apply(). This Transform is the device's origin in the scene.
    /// </summary>
    public abstract class InciseDevice : MonoBehaviour
    {
        public InciseBlade blade;
        [Tooltip("Scene units for a metre of the device.")]
        public float scale = 1;
        [Tooltip("Steps a second, where Read() does not wait for the device itself.")]
        public int rateHz = 1000;

        private readonly object gate = new object();
        private Vector3 origin; // guarded by gate: a Transform belongs to the main thread
        private Quat turn = Quat.Identity;
        private Thread thread;
        private volatile bool runs;
        private volatile Exception fault;

        /// <summary>The device's thread: where it is, in its own frame with Unity's axes, metres; whether it cuts. May wait for it.</summary>
        protected abstract void Read(out Vector3 position, out Quaternion rotation, out bool cuts);

        /// <summary>Whether the device makes the torques that Apply() gets; otherwise they are zero. The same throughout.</summary>
        protected virtual bool MakesTorque { get { return false; } }

        /// <summary>
        /// The device's thread: the force on the hand, N, and the torque about the place that Read() gave, N m, in the same frame.
        /// Both are zero once before the thread ends.
        /// </summary>
        protected abstract void Apply(Vector3 force, Vector3 torque);

        protected virtual void OnEnable()
        {
            if (blade == null) throw new InvalidOperationException("Incise: the device has no blade");
            if (transform.IsChildOf(blade.transform))
                throw new InvalidOperationException("Incise: the blade follows the device, so the device must not be on or below the blade");
            Follow();
            blade.deviceDriven = true;
            runs = true;
            thread = new Thread(Run) { IsBackground = true, Name = "incise device", Priority = System.Threading.ThreadPriority.Highest };
            thread.Start();
        }

        protected virtual void OnDisable()
        {
            runs = false;
            if (thread != null) thread.Join(1000);
            thread = null;
        }

        protected virtual void Update()
        {
            if (thread == null) return;
            Follow();
            Exception error = fault;
            if (error == null) return;
            fault = null;
            Debug.LogError("Incise: the device's thread has ended: " + error.Message, this);
        }

        private void Follow()
        {
            lock (gate)
            {
                origin = transform.position;
                turn = transform.rotation.ToIncise().Normalized;
            }
            blade.handScale = scale;
        }

        private void Run()
        {
            try
            {
                try
                {
                    while (runs) Step();
                }
                finally
                {
                    Apply(Vector3.zero, Vector3.zero);
                }
            }
            catch (Exception error)
            {
                fault = error; // the main thread says so
            }
        }

        private void Step()
        {
            long begun = Clock.NowNs;
            Read(out Vector3 position, out Quaternion rotation, out bool cuts);
            Vec3 from;
            Quat turned;
            lock (gate)
            {
                from = origin.ToIncise();
                turned = turn;
            }
            Vector3 world = (from + turned.Rotate(scale * position.ToIncise())).ToUnity();
            Quaternion heading = (turned * rotation.ToIncise()).ToUnity();
            Vector3 force, torque = Vector3.zero;
            if (MakesTorque) blade.Step(world, heading, cuts, out force, out torque);
            else force = blade.Step(world, heading, cuts);
            Quat back = turned.Inverse;
            Apply(back.Rotate(force.ToIncise()).ToUnity(), back.Rotate(torque.ToIncise()).ToUnity());
            long left = 1000000000 / Math.Max(1, rateHz) - (Clock.NowNs - begun);
            if (left > 0) Thread.Sleep(TimeSpan.FromTicks(left / 100));
        }
    }
}
