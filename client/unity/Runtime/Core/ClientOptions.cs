using System.Net.Security;

namespace Incise
{
    public sealed class ClientOptions
    {
        public Role Role = Role.Viewer;
        public View View = View.Surface;
        public string Token = "";
        public string ClientName = "com.incise.client";
        /// <summary>Operator: which blade, whether to take it from the operator who has it, and another edge than the server's.</summary>
        public string SourceName = "blade";
        public bool TakeOver;
        public BladeEdge Blade;
        /// <summary>View Surface: only what touches it. Null: everything.</summary>
        public Box Box;
        /// <summary>Deltas a second at most, put together; 0: one for each revision.</summary>
        public float MaxRateHz;
        /// <summary>BladeMoved at most so often for each blade; 0: never.</summary>
        public float BladeRateHz;
        /// <summary>Simulator: BladeLoaded at most so often for each blade, 60 to 1,000; 0: never.</summary>
        public float LoadRateHz;
        /// <summary>Connects again when the connection is lost, or the server is not there yet, and resumes the state it holds.</summary>
        public bool Reconnect = true;
        public double ConnectTimeoutS = 5;
        /// <summary>TLS. The system's authorities decide, or this, where a server has a certificate of its own.</summary>
        public bool Tls;
        public RemoteCertificateValidationCallback CertificateCheck;
        /// <summary>The hash of each delta is checked; every so many changes the whole state is hashed as well. 0: never.</summary>
        public int FullCheckInterval;
        /// <summary>Poses that wait for the network.</summary>
        public int MaxOutboxBytes = 8 << 20;
        public int MaxVertices = 16 << 20, MaxElements = 32 << 20;
    }

    public enum ClientStatus { Connecting, Connected, Closed }

    public struct ClientCounters
    {
        public long Deltas, Steps, Snapshots, Resyncs, Reconnects, Resumed, HandlerFaults;
    }
}
