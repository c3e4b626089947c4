using System;
using System.IO;
using System.Net.Sockets;
using System.Threading;

namespace Incise
{
    // The reading thread: connects, reads, makes changes, connects again.
    public sealed partial class Client
    {
        private const int FirstPauseMs = 100, LongestPauseMs = 2000;
        private const long SilenceNs = 15000000000; // with a ping a second unanswered, the server is gone
        private const int MaxResyncs = 5; // in a row; after that another snapshot would not help

        private long lastReceivedNs; // by Interlocked
        private bool givesUp, reconnecting, awaitingSnapshot;
        private ulong session, pingNonce;
        private int resyncsInARow, changesSinceCheck;
        private SnapshotBegin begin; // of a snapshot under way
        private BodyState staged;
        private uint chunks;

        private void Live()
        {
            int pauseMs = FirstPauseMs;
            for (;;)
            {
                string why;
                bool served = false;
                try
                {
                    Link opened = Open();
                    served = true;
                    for (;;) ReadOne(opened);
                }
                catch (Exception error) when (error is IOException || error is SocketException || error is ObjectDisposedException)
                {
                    why = (served ? "connection lost: " : host + ":" + port + ": ") + error.Message;
                    if (!served && !options.Tls && error is EndOfStreamException) why += "; a server with a certificate needs Tls";
                }
                catch (WireException error)
                {
                    why = "the server sent something that is not a message: " + error.Message;
                }
                catch (EndException error)
                {
                    why = error.Message;
                }
                catch (Exception error)
                {
                    // Certificates, memory: connecting again would not help.
                    why = host + ":" + port + ": " + error.GetType().Name + ": " + error.GetBaseException().Message.Replace('\n', ' ');
                    givesUp = true;
                }
                if (!Closed(why)) return;
                pauseMs = served ? FirstPauseMs : pauseMs;
                lock (gate)
                {
                    if (!disposed) Monitor.Wait(gate, pauseMs);
                    if (disposed) status = ClientStatus.Closed;
                    if (disposed) return;
                }
                pauseMs = Math.Min(2 * pauseMs, LongestPauseMs);
            }
        }

        /// <summary>The server said goodbye, or what it sends cannot be held.</summary>
        private sealed class EndException : Exception
        {
            public EndException(string text) : base(text) { }
        }

        /// <summary>Connects and waits for Welcome.</summary>
        private Link Open()
        {
            var opened = new Link(host, port, options);
            lock (gate)
            {
                link = opened;
                sequence = 1;
                if (disposed) opened.Close();
            }
            begin = null;
            staged = null;
            opened.Write(MessageWriter.Write(Greeting(), 1, Clock.NowNs));
            int length;
            byte[] bytes = opened.Read(out length);
            object first = MessageReader.Read(bytes, length).Body;
            if (first is Error error) throw new EndException(Refusal(error));
            if (first is Bye bye) On(bye);
            if (!(first is Welcome)) throw new WireException("no Welcome");
            opened.WaitLonger();
            Interlocked.Exchange(ref lastReceivedNs, Clock.NowNs);
            lock (gate)
            {
                outbox = new Outbox(opened, options.MaxOutboxBytes, LookAfter);
                if (reconnecting) ++counters.Reconnects;
            }
            On((Welcome)first);
            return opened;
        }

        private string Refusal(Error error)
        {
            // Bye with the reason Refused would follow.
            givesUp = error.Fatal;
            return error.Code + ": " + error.Text;
        }

        private Hello Greeting()
        {
            var hello = new Hello
            {
                Role = options.Role, View = options.View, ClientName = options.ClientName, Token = options.Token, MaxRateHz = options.MaxRateHz,
                BladeRateHz = options.BladeRateHz, LoadRateHz = options.LoadRateHz, Box = options.Box, SourceName = options.SourceName, Blade = options.Blade,
                // After a lost connection the server may still count the blade as held by it.
                TakeOver = options.TakeOver || reconnecting
            };
            BodyState held = State;
            if (!reconnecting || held == null || awaitingSnapshot) return hello;
            hello.ResumeSession = session;
            hello.ResumeRevision = held.Revision;
            hello.ResumeHash = held.StateHash;
            return hello;
        }

        /// <summary>Every second, on the writing thread.</summary>
        private void LookAfter()
        {
            if (Clock.NowNs - Interlocked.Read(ref lastReceivedNs) > SilenceNs) throw new IOException("the server is silent");
            Send(new Ping { Nonce = ++pingNonce, SentNs = Clock.NowNs });
        }

        /// <summary>Whether to connect again.</summary>
        private bool Closed(string why)
        {
            bool again, was;
            lock (gate)
            {
                was = status == ClientStatus.Connected && !disposed;
                again = options.Reconnect && !disposed && !givesUp;
                status = again ? ClientStatus.Connecting : ClientStatus.Closed;
                lastError = why;
                if (link != null) link.Close();
                if (outbox != null) outbox.Close();
                link = null;
                outbox = null;
                Monitor.PulseAll(gate);
            }
            if (was) Raise(Disconnected, why);
            return again;
        }

        private void ReadOne(Link from)
        {
            int length;
            byte[] bytes = from.Read(out length);
            Interlocked.Exchange(ref lastReceivedNs, Clock.NowNs);
            Dispatch(MessageReader.Read(bytes, length).Body);
        }

        private void Dispatch(object body)
        {
            if (body is Delta delta) Change(() => On(delta));
            else if (body is SurfaceDelta surface) Change(() => On(surface));
            else if (body is SnapshotBegin started) Change(() => Begin(started));
            else if (body is SnapshotChunk chunk) Change(() => Take(chunk));
            else if (body is SnapshotEnd end) Change(() => End(end));
            else if (body is Force force) Raise(ForceReceived, force);
            else if (body is BladeLoad load) Raise(BladeLoaded, load);
            else if (body is PositionsReport moved) On(moved);
            else if (body is BladePose pose) Raise(BladeMoved, pose);
            else if (body is Ping ping) Send(new Pong { Nonce = ping.Nonce, PingSentNs = ping.SentNs, ReceivedNs = Clock.NowNs });
            else if (body is PoseReport reported) On(reported);
            else if (body is Stats stats) Raise(StatsReceived, stats);
            else if (body is Error error) On(error);
            else if (body is Bye bye) On(bye);
            else if (body is Welcome again) On(again);
        }

        // ---- State ----

        private void On(Welcome message)
        {
            session = message.Session;
            begin = null;
            staged = null;
            if (!message.Resumed)
            {
                lock (Lock) state = null;
                awaitingSnapshot = true;
            }
            lock (gate)
            {
                if (!message.Resumed) heldRevision = null;
                welcome = message;
                report = null;
                positionsReport = null;
                status = ClientStatus.Connected;
                lastError = "";
                if (message.Resumed) ++counters.Resumed;
                Monitor.PulseAll(gate);
            }
            reconnecting = true; // so is any connection after this one
            Raise(Welcomed, message);
        }

        private void On(Delta delta)
        {
            if (awaitingSnapshot) return; // sent before the server knew
            lock (Lock)
            {
                Held<VolumeState>().Apply(delta);
                CheckNowAndThen();
            }
            Moved(delta.Revision, delta.Steps.Length, false);
            Raise(DeltaApplied, delta);
        }

        private void On(SurfaceDelta delta)
        {
            if (awaitingSnapshot) return;
            lock (Lock)
            {
                Held<SurfaceState>().Apply(delta);
                CheckNowAndThen();
            }
            Moved(delta.Revision, delta.Steps.Length, false);
            Raise(SurfaceDeltaApplied, delta);
        }

        private T Held<T>() where T : BodyState
        {
            if (!(state is T held)) throw new ApplyException("a delta of another view");
            return held;
        }

        private void CheckNowAndThen()
        {
            if (options.FullCheckInterval <= 0 || ++changesSinceCheck < options.FullCheckInterval) return;
            changesSinceCheck = 0;
            if (state.ComputeHash() != state.HeldHash) throw new ApplyException("the state does not have the hash that its changes add up to");
        }

        private void Begin(SnapshotBegin message)
        {
            if (message.View == View.Volume && message.Box != null) throw new LimitException("a part of the volume, which this client does not hold");
            begin = message;
            chunks = 0;
            staged = message.View == View.Surface ? (BodyState)new SurfaceState() : new VolumeState();
            staged.MaxVertices = options.MaxVertices;
            staged.MaxElements = options.MaxElements;
        }

        private void Take(SnapshotChunk chunk)
        {
            if (begin == null) return;
            if (chunk.Index != chunks++) throw new ApplyException("a snapshot whose chunks are not in order");
            staged.Add(chunk);
        }

        private void End(SnapshotEnd message)
        {
            if (begin == null) return;
            if (chunks != begin.Chunks || message.Revision != begin.Revision) throw new ApplyException("a snapshot that is not complete");
            staged.Finish(begin, message);
            BodyState whole = staged;
            begin = null;
            staged = null;
            awaitingSnapshot = false;
            lock (Lock) state = whole;
            Moved(whole.Revision, 0, true);
            Raise(SnapshotHeld, whole);
        }

        private void Moved(ulong revision, int steps, bool snapshot)
        {
            resyncsInARow = 0;
            lock (gate)
            {
                heldRevision = revision;
                counters.Steps += steps;
                if (snapshot) ++counters.Snapshots;
                else ++counters.Deltas;
                Monitor.PulseAll(gate);
            }
        }

        /// <summary>Makes a change; where the state refuses it, asks for a snapshot.</summary>
        private void Change(Action change)
        {
            string why;
            try
            {
                change();
                return;
            }
            catch (ApplyException error)
            {
                why = error.Message;
            }
            catch (LimitException error)
            {
                givesUp = true;
                throw new EndException("cannot hold the server's state: " + error.Message);
            }
            begin = null;
            staged = null;
            awaitingSnapshot = true;
            lock (gate) ++counters.Resyncs;
            Raise(Resynced, why);
            if (++resyncsInARow > MaxResyncs)
            {
                givesUp = true;
                throw new EndException("cannot hold the server's state: " + why);
            }
            BodyState held = State;
            Send(new Resync { Revision = held == null ? 0 : held.Revision, Reason = why.Length > 200 ? why.Substring(0, 200) : why });
        }

        // ---- The rest ----

        private void On(PoseReport message)
        {
            lock (gate)
            {
                report = message;
                Monitor.PulseAll(gate);
            }
            Raise(Reported, message);
        }

        private void On(PositionsReport message)
        {
            lock (gate)
            {
                positionsReport = message;
                Monitor.PulseAll(gate);
            }
            Raise(PositionsReported, message);
        }

        private void On(Error message)
        {
            Raise(ErrorReceived, message);
            if (message.Fatal) throw new EndException(Refusal(message));
        }

        private void On(Bye message)
        {
            // Coming back would fight the operator who took the blade, or the server that refused us.
            givesUp = message.Reason == ByeReason.HandedOver || message.Reason == ByeReason.Refused;
            throw new EndException(message.Text.Length > 0 ? message.Text : "the server said goodbye: " + message.Reason);
        }

        /// <summary>A handler's fault is counted and does not end the connection.</summary>
        private void Raise<T>(Action<T> handlers, T message)
        {
            if (handlers == null) return;
            try
            {
                handlers(message);
            }
            catch (Exception error)
            {
                lock (gate)
                {
                    ++counters.HandlerFaults;
                    lastHandlerFault = error;
                }
            }
        }

        private Exception lastHandlerFault;
        /// <summary>What a handler of an event threw last; null: nothing.</summary>
        public Exception LastHandlerFault { get { lock (gate) return lastHandlerFault; } }
    }
}
