using System;
using System.Collections.Generic;
using System.Threading;

namespace Incise
{
    /// <summary>Messages that wait for the network, written by a thread of its own, so that a sender never waits. Thread: any.</summary>
    internal sealed class Outbox
    {
        private static readonly TimeSpan PingEvery = TimeSpan.FromSeconds(1);
        private readonly Link link;
        private readonly int maxBytes;
        private readonly Action everySecond;
        private readonly Queue<byte[]> queue = new Queue<byte[]>();
        private int bytes;
        private bool closed;

        /// <summary>everySecond is called on the writing thread.</summary>
        public Outbox(Link link, int maxBytes, Action everySecond)
        {
            this.link = link;
            this.maxBytes = maxBytes;
            this.everySecond = everySecond;
            new Thread(Run) { IsBackground = true, Name = "incise writer" }.Start();
        }

        /// <summary>False if it is closed or full: nothing is queued.</summary>
        public bool Add(byte[] message)
        {
            lock (queue)
            {
                if (closed || bytes + message.Length > maxBytes) return false;
                bytes += message.Length;
                queue.Enqueue(message);
                Monitor.PulseAll(queue);
                return true;
            }
        }

        /// <summary>The same, but only where nothing waits: for what is replaced by the next one. Of any size.</summary>
        public bool AddAlone(byte[] message)
        {
            lock (queue)
            {
                if (closed || bytes > 0) return false;
                bytes = message.Length;
                queue.Enqueue(message);
                Monitor.PulseAll(queue);
                return true;
            }
        }

        /// <summary>Waits until everything has been written, or the time is over.</summary>
        public void Flush(TimeSpan timeout)
        {
            DateTime end = DateTime.UtcNow + timeout;
            lock (queue)
            {
                while (bytes > 0 && !closed && DateTime.UtcNow < end) Monitor.Wait(queue, 10);
            }
        }

        public void Close()
        {
            lock (queue)
            {
                closed = true;
                Monitor.PulseAll(queue);
            }
        }

        private void Run()
        {
            DateTime next = DateTime.UtcNow;
            try
            {
                for (;;)
                {
                    if (DateTime.UtcNow >= next)
                    {
                        everySecond();
                        next = DateTime.UtcNow + PingEvery;
                    }
                    byte[] message = Next(next);
                    if (message == null) continue;
                    link.Write(message);
                    lock (queue)
                    {
                        bytes -= message.Length;
                        Monitor.PulseAll(queue);
                    }
                }
            }
            catch (Exception)
            {
                // The reading thread finds the end of the connection, too, and says why.
                Close();
                link.Close();
            }
        }

        /// <summary>Null when it is time for a ping. Throws when it is closed.</summary>
        private byte[] Next(DateTime until)
        {
            lock (queue)
            {
                while (queue.Count == 0)
                {
                    if (closed) throw new OperationCanceledException();
                    TimeSpan left = until - DateTime.UtcNow;
                    if (left <= TimeSpan.Zero) return null;
                    Monitor.Wait(queue, left);
                }
                if (closed) throw new OperationCanceledException();
                return queue.Dequeue();
            }
        }
    }
}
