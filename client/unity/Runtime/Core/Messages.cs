namespace Incise
{
    // The messages of protocol/incise.fbs that a client of this package sends or receives, field by field as there. An
    // absent array or text is empty, an absent number 0. PROTOCOL.md says what they mean.

    public enum Role : byte { Viewer, Operator, Simulator, Admin }

    public enum View : byte { None, Surface, Volume }

    public enum Recording : byte { Off, On, Stopped }

    public enum SnapshotCause : byte { Join, ResumeGone, Resync, TooSlow, Reset, Subscribe }

    public enum ByeReason : byte { Unknown, Done, ServerStops, TooSlow, Idle, HandshakeTimeout, HandedOver, Refused }

    public enum ErrorCode : ushort
    {
        Unknown, BadFrame, TooLong, BadVersion, BadState, Unauthorized, Forbidden, BladeTaken, UnknownSource,
        TooManySessions, RateExceeded, NotAvailable, BadRequest, Internal, NotRecorded
    }

    public enum StrokeAction : byte { Engage, End, HandOver }

    public sealed class Message
    {
        public ulong Sequence;
        public long SentNs;
        /// <summary>One of the classes below; null for a kind that this client does not read.</summary>
        public object Body;
    }

    public sealed class Hello
    {
        public const uint Version = 2;
        public uint ProtocolVersion = Version;
        public Role Role;
        public View View;
        public string ClientName, ClientVersion, Token, SourceName;
        public ulong ResumeSession, ResumeRevision, ResumeHash;
        public float MaxRateHz, BladeRateHz;
        public Box Box;
        public bool TakeOver;
        public BladeEdge Blade;
    }

    public sealed class MeshFacts
    {
        public string Name = "", ContentHash = "";
        public uint Vertices, Tets, BoundaryFaces;
        public double MeanEdgeLengthM;
        public Box Box;
    }

    public sealed class Welcome
    {
        public uint ProtocolVersion, Source, MaxMessageBytes;
        public ulong Session, Revision, StateHash;
        public Role Role;
        public View View;
        public bool Resumed;
        public MeshFacts Mesh = new MeshFacts();
        public Vec3 BladeHeel, BladeTip;
        public int EngageButton = -1;
        public double MaxSpeedMS, FrameRateHz;
        public string ServerName = "", ServerVersion = "", Policy = "";
        public long ServerMonotonicNs, ServerUnixNs;
        public Recording Recording;
    }

    public sealed class Resync
    {
        public ulong Revision, Hash;
        public string Reason;
    }

    public sealed class Ping
    {
        public ulong Nonce;
        public long SentNs;
    }

    public sealed class Pong
    {
        public ulong Nonce;
        public long PingSentNs, ReceivedNs;
    }

    public sealed class Error
    {
        public ErrorCode Code;
        public string Text = "";
        public bool Fatal;
        public ulong InReplyTo;
    }

    public sealed class Bye
    {
        public ByeReason Reason;
        public string Text = "";
    }

    /// <summary>world_from_tool at one moment of the sender's own clock, in Incise's frame.</summary>
    public struct PoseSample
    {
        public long SourceNs;
        public Vec3 Position;
        public Quat Orientation;
        /// <summary>Bit i: button i is held.</summary>
        public uint Buttons;
    }

    public sealed class PoseBatch
    {
        public PoseSample[] Poses;
    }

    public sealed class PoseReport
    {
        public ulong ThroughSequence, Accepted, NotFinite, NotUnit, TimeNotRising, QueueFull, TooFast, Recorded;
        public long LastSourceNs, RecordedSourceNs;
        public uint BacklogSegments;
        public Recording Recording;
    }

    public sealed class StrokeControl
    {
        public StrokeAction Action;
        public long SourceNs;
    }

    public sealed class LocalContact
    {
        public Vec3 Point, Normal;
        public double StiffnessNPerM, DampingNSPerM, CuttingResistanceN, FrictionNSPerM;
        public long ValidForNs;
        public bool Penetrated;
        /// <summary>From the tool's origin to where the tissue presses on the blade: torque = arm x force. Zero: an older server.</summary>
        public Vec3 Arm;
    }

    public sealed class Force
    {
        public uint Source;
        public long SourceNs;
        public Vec3 ForceN;
        public double EngagedLengthM;
        /// <summary>Null: no tissue at the blade.</summary>
        public LocalContact Contact;
        public bool Saturated, Ramping, LatchedOff;
        /// <summary>On the hand, about the tool's origin.</summary>
        public Vec3 TorqueNM;
    }

    public sealed class Tets
    {
        public uint[] Ids = { }, Vertices = { };
        public int[] Regions = { };
        public byte[] CutMasks = { }, BoundaryMasks = { };
    }

    public sealed class Triangles
    {
        public uint[] Ids = { }, Vertices = { }, Pieces = { };
        public byte[] Flags = { };
        public int[] Regions = { };
    }

    public sealed class SurfaceVertices
    {
        public uint[] Ids = { };
        public float[] Positions = { };
    }

    public sealed class Step
    {
        public ulong Revision, StateHash;
        public uint Source, Stroke, Batch, CutFaces, Snaps, Splits;
        public bool StrokeEnded;
        public Vec3 FromHeel, FromTip, ToHeel, ToTip;
        public long FromSourceNs, ToSourceNs, ArrivalNs, DrainNs, CutNs;
        public double CutAreaM2, MinDihedralDeg, MaxDeviationH;
    }

    public sealed class Delta
    {
        public ulong BaseRevision, Revision, StateHash, PartHash;
        public Step[] Steps = { };
        public uint[] MovedIds = { };
        public double[] MovedPositions = { };
        public uint FirstAdded, VertexCount, LiveTets, FirstNewTet;
        public double[] AddedPositions = { };
        public uint[] ProvenanceA = { }, ProvenanceB = { };
        public double[] ProvenanceT = { };
        public Tets Tets = new Tets();
        public uint[] RemovedTets = { }, BoundaryUpserted = { }, BoundaryRemoved = { };
        public uint[] PieceIds = { }, PieceSizes = { }, PieceTets = { }, PieceNames = { };
        public uint[] AddedIds = { }, RemovedVertices = { }, RestIds = { };
        public double[] RestPositions = { };
    }

    public sealed class SurfaceDelta
    {
        public ulong BaseRevision, Revision, SurfaceHash, StateHash;
        public Step[] Steps = { };
        public SurfaceVertices Vertices = new SurfaceVertices();
        public Triangles Triangles = new Triangles();
        public uint[] RemovedVertices = { }, RemovedTriangles = { };
        public uint LiveTets;
    }

    public sealed class SnapshotBegin
    {
        public View View;
        public ulong Revision;
        public SnapshotCause Cause;
        public uint Chunks, VertexCount, TetCount, TriangleCount;
        public Box Box;
        public uint[] PieceIds = { }, PieceNames = { };
    }

    public sealed class SnapshotChunk
    {
        public uint Index, FirstVertex;
        public double[] Positions = { }, RestPositions = { };
        public Tets Tets = new Tets();
        public uint[] TetPieces = { }, VertexIds = { };
        public SurfaceVertices SurfaceVertices = new SurfaceVertices();
        public Triangles Triangles = new Triangles();
    }

    public sealed class SnapshotEnd
    {
        public ulong Revision, StateHash, SurfaceHash, PartHash;
    }

    public sealed class Stats
    {
        public string Json = "";
        public ulong Revision, Frames, LateFrames, PosesAccepted, PosesRejected;
        public uint LiveTets, Pieces, Sessions, BacklogSegments;
        public float FrameWorkP99Us, PoseToDeltaP99Us;
        public Recording Recording;
    }

    public sealed class Reset { }

    /// <summary>Where a blade's edge is between the deltas, Incise's frame.</summary>
    public sealed class BladePose
    {
        public uint Source;
        public bool Cutting;
        public Vec3 Heel, Tip;
        public long ArrivalNs;
    }
}
