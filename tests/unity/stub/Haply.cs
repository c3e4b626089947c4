// As much of the API of Haply's Unity package as the sample uses, with the names and types of Haply's documentation
// (docs.haply.co/inverseSDK, Unity, 3.x) and tutorials. Nobody has compared it with the package itself.

using System;
using Haply.Inverse.DeviceData;
using UnityEngine;

namespace Haply.Inverse.DeviceControllers
{
    public sealed class Inverse3Controller : MonoBehaviour
    {
        public event EventHandler<Inverse3EventArgs> DeviceStateChanged;
        public Vector3 CursorLocalPosition { get; private set; }
        public Vector3 LastForce { get; private set; }
        public bool Released { get; private set; }

        public void SetCursorLocalForce(Vector3 force)
        {
            LastForce = force;
        }

        public void Release()
        {
            Released = true;
        }

        /// <summary>A frame of the device, on its thread.</summary>
        public void Tick(Vector3 position)
        {
            CursorLocalPosition = position;
            if (DeviceStateChanged != null) DeviceStateChanged(this, new Inverse3EventArgs { DeviceController = this });
        }
    }

    public sealed class VerseGripController : MonoBehaviour
    {
        public Quaternion Orientation { get { return Quaternion.identity; } }

        public bool GetButton()
        {
            return false;
        }
    }
}

namespace Haply.Inverse.DeviceData
{
    public sealed class Inverse3EventArgs : EventArgs
    {
        public DeviceControllers.Inverse3Controller DeviceController { get; set; }
    }
}
