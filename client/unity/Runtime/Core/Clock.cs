using System.Diagnostics;

namespace Incise
{
    /// <summary>This machine's monotonic clock: the source_ns of poses, and the time of forces.</summary>
    public static class Clock
    {
        public static long NowNs
        {
            get
            {
                long ticks = Stopwatch.GetTimestamp(), second = Stopwatch.Frequency;
                return ticks / second * 1000000000 + (long)(ticks % second * (1e9 / second));
            }
        }
    }
}
