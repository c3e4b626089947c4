using System;

namespace Incise
{
    /// <summary>Bytes that are no message of the protocol. The text names the field and what is wrong with it.</summary>
    public sealed class WireException : Exception
    {
        public WireException(string text) : base(text) { }
    }

    /// <summary>A message that does not fit the state, which is unchanged: the client asks for a snapshot.</summary>
    public sealed class ApplyException : Exception
    {
        public ApplyException(string text) : base(text) { }
    }

    /// <summary>A state larger than the options allow. Another snapshot would not help.</summary>
    public sealed class LimitException : Exception
    {
        public LimitException(string text) : base(text) { }
    }
}
