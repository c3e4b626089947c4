// A device to begin with: replace what Read and Apply do by calls of your device's plugin.
using InciseUnity;
using UnityEngine;

/// <summary>A hand that goes down by 4 cm and up again, for ever.</summary>
public sealed class SimulatedDevice : InciseDevice
{
    public Vector3 top = new Vector3(0.02f, 0.1f, 0);
    private long steps;
    private float largest; // N; a float is read whole by any thread

    public float LargestForce { get { return largest; } }

    protected override void Read(out Vector3 position, out Quaternion rotation, out bool cuts)
    {
        float way = steps++ * 0.00002f % 0.08f; // at 1 kHz 2 cm a second
        position = top + new Vector3(0, way < 0.04f ? -way : way - 0.08f, 0);
        rotation = Quaternion.identity;
        cuts = false;
    }

    protected override void Apply(Vector3 force, Vector3 torque)
    {
        largest = Mathf.Max(largest, force.y);
    }
}
