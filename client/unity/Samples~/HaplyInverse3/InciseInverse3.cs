// An Inverse3 and its VerseGrip, with Haply's Unity package (3.x), which calls on a thread of its own at the device's rate.
using Haply.Inverse.DeviceControllers;
using Haply.Inverse.DeviceData;
using InciseUnity;
using UnityEngine;

/// <summary>Put it where the device's origin shall be in the scene. The device's axes are then the scene's.</summary>
public sealed class InciseInverse3 : MonoBehaviour
{
    public InciseBlade blade;
    public Inverse3Controller inverse3;
    public VerseGripController grip;
    [Tooltip("Scene units for a metre of the hand.")]
    public float scale = 1;

    private readonly object gate = new object();
    private bool live; // guarded by gate
    private Vector3 origin; // a Transform belongs to the main thread
    private float units;

    private void OnEnable()
    {
        origin = transform.position;
        units = scale;
        blade.handScale = scale;
        blade.deviceDriven = true;
        live = true;
        inverse3.DeviceStateChanged += Feel;
    }

    private void OnDisable()
    {
        inverse3.DeviceStateChanged -= Feel;
        lock (gate) live = false; // a call that is under way has ended
        inverse3.SetCursorLocalForce(Vector3.zero);
        inverse3.Release();
    }

    private void Feel(object sender, Inverse3EventArgs args)
    {
        lock (gate)
        {
            if (!live) return;
            Vector3 force = Vector3.zero;
            try
            {
                force = blade.Step(origin + args.DeviceController.CursorLocalPosition * units, grip.Orientation, grip.GetButton());
            }
            finally
            {
                args.DeviceController.SetCursorLocalForce(force); // zero if something was thrown
            }
        }
    }
}
