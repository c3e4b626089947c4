using System;
using System.Threading;

namespace Incise
{
    /// <summary>
    /// Follows an incised and moves a blade. Two threads of its own do the work: nothing here waits for the network but the
    /// Wait functions. Events are raised on the reading thread, after the state has changed. Everything else: any thread.
    /// </summary>
    public sealed partial class Client : IDisposable
    {
        private readonly string host;
        private readonly int port;
        private readonly ClientOptions options;
        private readonly object gate = new object(); // of everything that follows but the state
        private ClientStatus status = ClientStatus.Connecting;
        private string lastError = "";
        private Welcome welcome;
        private PoseReport report;
        private PositionsReport positionsReport;
        private ulong? heldRevision; // the state's; null: none
        private ClientCounters counters;
        private Link link;
        private Outbox outbox;
        private ulong sequence;
        private bool disposed;
        private Thread thread;

        /// <summary>Held while the state changes. Take it to read the state.</summary>
        public readonly object Lock = new object();
        private BodyState state; // guarded by Lock; null before the first snapshot

        public event Action<Welcome> Welcomed; // also after a reset and a reconnection
        public event Action<BodyState> SnapshotHeld;
        public event Action<Delta> DeltaApplied; // view Volume
        public event Action<SurfaceDelta> SurfaceDeltaApplied;
        public event Action<Force> ForceReceived;
        public event Action<PoseReport> Reported;
        public event Action<PositionsReport> PositionsReported; // role Simulator
        public event Action<BladeLoad> BladeLoaded; // role Simulator, with ClientOptions.LoadRateHz: what a blade does to the body
        public event Action<BladePose> BladeMoved;
        public event Action<Stats> StatsReceived;
        public event Action<Error> ErrorReceived;
        public event Action<string> Resynced; // why a snapshot was asked for
        public event Action<string> Disconnected; // why

        public Client(string host, int port, ClientOptions options = null)
        {
            if (!BitConverter.IsLittleEndian) throw new PlatformNotSupportedException("Incise needs a little-endian machine");
            this.host = host;
            this.port = port;
            this.options = options ?? new ClientOptions();
            if (this.options.Box != null && this.options.View != View.Surface)
                throw new ArgumentException("Box: accepted with view Surface only");
            if (this.options.Role == Role.Simulator && this.options.View != View.Volume)
                throw new ArgumentException("View: a simulator needs Volume, whose vertices it moves");
        }

        /// <summary>Begins to connect and returns at once. Status and LastError say how it goes.</summary>
        public void Start()
        {
            lock (gate)
            {
                if (thread != null) throw new InvalidOperationException("Start() comes once");
                thread = new Thread(Live) { IsBackground = true, Name = "incise reader" };
                thread.Start();
            }
        }

        public ClientStatus Status { get { lock (gate) return status; } }
        /// <summary>Why it is not connected; empty while it is.</summary>
        public string LastError { get { lock (gate) return lastError; } }
        /// <summary>The last one; null before.</summary>
        public Welcome Welcome { get { lock (gate) return welcome; } }
        public PoseReport Report { get { lock (gate) return report; } }
        public PositionsReport PositionsReport { get { lock (gate) return positionsReport; } }
        public ClientCounters Counters { get { lock (gate) return counters; } }

        /// <summary>A VolumeState or SurfaceState; null without one. Read it within Lock.</summary>
        public BodyState State { get { lock (Lock) return state; } }

        // ---- Sending ----

        /// <summary>
        /// Sends poses in time order. Returns the sequence that PoseReport.ThroughSequence will reach. 0 without a connection or
        /// room for them: try again.
        /// </summary>
        public ulong SendPoses(params PoseSample[] poses)
        {
            ulong last = 0;
            for (int from = 0; from < poses.Length; from += MessageWriter.MaxPoses)
            {
                var part = new PoseSample[Math.Min(MessageWriter.MaxPoses, poses.Length - from)];
                Array.Copy(poses, from, part, 0, part.Length);
                last = Send(new PoseBatch { Poses = part });
                if (last == 0) return 0;
            }
            return last;
        }

        /// <summary>The same for one pose, with next to no garbage: for a device's loop.</summary>
        public ulong SendPose(PoseSample pose)
        {
            lock (gate)
            {
                if (outbox == null || status != ClientStatus.Connected) return 0;
                return outbox.Add(MessageWriter.Write(pose, sequence + 1, Clock.NowNs)) ? ++sequence : 0;
            }
        }

        /// <summary>For a tool without a button: engages the blade for all poses sent from here on, until EndStroke().</summary>
        public bool Engage()
        {
            return Send(new StrokeControl { Action = StrokeAction.Engage, SourceNs = Clock.NowNs }) > 0;
        }

        /// <summary>Ends the running stroke after the poses sent so far.</summary>
        public bool EndStroke()
        {
            return Send(new StrokeControl { Action = StrokeAction.End, SourceNs = Clock.NowNs }) > 0;
        }

        /// <summary>Role Admin: back to the mesh as loaded, for everybody.</summary>
        public bool Reset()
        {
            return Send(new Reset()) > 0;
        }

        /// <summary>An operator who holds a blade, or role Admin: back to the state before the last stroke that cut something, an operator's own, for everybody. An operator's is
        /// refused where other blades have cut since that stroke began, unless `others`: then that is undone as well.</summary>
        public bool Undo(bool others = false)
        {
            return Send(new Undo { Others = others }) > 0;
        }

        /// <summary>
        /// Role Simulator: where vertices are now. Returns the message's sequence; 0 without a connection, or while something still
        /// waits for the network: send the next ones, later. Throws ArgumentException where numbers and ids do not fit. What the
        /// server made of them comes as PositionsReported and as a delta; vertices that are not there as ErrorReceived.
        /// </summary>
        public ulong SendPositions(Positions positions)
        {
            int numbers = positions.F32.Length + positions.F64.Length;
            if (numbers % 3 != 0 || (positions.F32.Length > 0 && positions.F64.Length > 0) ||
                (positions.Ids.Length > 0 && numbers != 3 * positions.Ids.Length))
                throw new ArgumentException("positions: " + positions.F32.Length + " floats and " + positions.F64.Length + " doubles for " +
                    positions.Ids.Length + " ids; accepted are three for each vertex, in one of the two");
            return Send(positions, true);
        }

        /// <summary>
        /// Role Simulator: its own model of the tissue at a blade, in answer to a BladeLoad. Returns the message's sequence; 0 without a
        /// connection. One that cannot be rendered comes back as ErrorReceived, not fatal.
        /// </summary>
        public ulong SendModel(BladeModel model)
        {
            if (model.Stiffness.Length != 9) throw new ArgumentException("Stiffness: " + model.Stiffness.Length + " numbers; accepted are 9");
            return Send(model);
        }

        private ulong Send(object body, bool alone = false)
        {
            lock (gate)
            {
                if (outbox == null || status != ClientStatus.Connected) return 0;
                byte[] message = MessageWriter.Write(body, sequence + 1, Clock.NowNs);
                return (alone ? outbox.AddAlone(message) : outbox.Add(message)) ? ++sequence : 0;
            }
        }

        // ---- Waiting: for programs, not for a frame ----

        /// <summary>Until the state is at this revision or beyond.</summary>
        public bool WaitForRevision(ulong revision, double timeoutS)
        {
            return Wait(timeoutS, () => heldRevision >= revision);
        }

        /// <summary>Until the server has dealt with all poses up to the message of that number.</summary>
        public bool WaitForReport(ulong through, double timeoutS)
        {
            return Wait(timeoutS, () => report != null && report.ThroughSequence >= through);
        }

        /// <summary>Until the server has dealt with the positions of that frame, or of a later one.</summary>
        public bool WaitForPositions(ulong frame, double timeoutS)
        {
            return Wait(timeoutS, () => positionsReport != null && positionsReport.Frame >= frame);
        }

        public bool WaitForWelcome(double timeoutS)
        {
            return Wait(timeoutS, () => status == ClientStatus.Connected);
        }

        private bool Wait(double timeoutS, Func<bool> done)
        {
            DateTime end = DateTime.UtcNow + TimeSpan.FromSeconds(timeoutS);
            lock (gate)
            {
                while (!done())
                {
                    TimeSpan left = end - DateTime.UtcNow;
                    if (left <= TimeSpan.Zero || status == ClientStatus.Closed) return false;
                    Monitor.Wait(gate, left);
                }
                return true;
            }
        }

        // ---- The end ----

        /// <summary>Drops the connection without a goodbye, as a lost network does. With Reconnect it comes back.</summary>
        public void DropConnection()
        {
            Link dropped;
            lock (gate) dropped = link;
            if (dropped != null) dropped.Close();
        }

        /// <summary>Says goodbye, waits half a second at most until everything is sent, closes.</summary>
        public void Dispose()
        {
            Outbox last;
            lock (gate)
            {
                if (disposed) return;
                disposed = true;
                last = outbox;
                Monitor.PulseAll(gate);
            }
            Send(new Bye { Reason = ByeReason.Done });
            if (last != null) last.Flush(TimeSpan.FromSeconds(0.5));
            DropConnection();
            if (thread != null && thread != Thread.CurrentThread) thread.Join(2000);
        }
    }
}
