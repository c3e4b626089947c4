using System;

namespace Incise
{
    // The messages of protocol/incise.fbs that a client of this package sends or receives, field by field as there. An
    // absent array or text is empty, an absent number 0. PROTOCOL.md says what they mean.

    public enum Role : byte { Viewer, Operator, Simulator, Admin }

    public enum View : byte { None, Surface, Volume }

    public enum Recording : byte { Off, On, Stopped }

    public enum FieldOn : byte { Vertices, Tets }

    public enum SnapshotCause : byte { Join, ResumeGone, Resync, TooSlow, Reset, Subscribe }

    public enum RestartKind : byte { None, Reset, Undo }

    public enum ByeReason : byte { Unknown, Done, ServerStops, TooSlow, Idle, HandshakeTimeout, HandedOver, Refused }

    public enum ErrorCode : ushort
    {
        Unknown, BadFrame, TooLong, BadVersion, BadState, Unauthorized, Forbidden, BladeTaken, UnknownSource,
        TooManySessions, RateExceeded, NotAvailable, BadRequest, Internal, NotRecorded
    }

    public enum StrokeAction : byte { Engage, End, HandOver }

    /// <summary>None: the blade is in air. Presses: on the surface, which holds.</summary>
    public enum BladeContact : byte { None, Presses, Inside }

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
        public float MaxRateHz, BladeRateHz, LoadRateHz;
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
        /// <summary>Null: the body was not filled from a surface.</summary>
        public SurfaceFacts Surface;
        /// <summary>Fields of the body. This client does not ask for their values; Delta.Carry carries your own.</summary>
        public FieldFacts[] Fields = { };
        /// <summary>Who asked for the reset or the undo that the present ids began with; null: nobody, or the server is older.</summary>
        public Restart Restart;
    }

    public sealed class Restart
    {
        public RestartKind Kind;
        public Role Role;
        /// <summary>An operator's blade, else the name of the client.</summary>
        public string By = "";
        /// <summary>Undo: the blade whose stroke was undone, and its name.</summary>
        public uint Source;
        public string Blade = "";
        /// <summary>Undo: the names of the other blades of which something was undone as well.</summary>
        public string[] Others = { };
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
        public uint[] Origins = { };
    }

    /// <summary>Values on the vertices or tetrahedra, Components for each: int where they are Whole, else float.</summary>
    public sealed class FieldFacts
    {
        public string Name;
        public FieldOn On;
        public uint Components = 1;
        public bool Whole;
    }

    /// <summary>The surface that the body was filled from.</summary>
    public sealed class SurfaceFacts
    {
        public uint Triangles;
        public string Path, ContentHash;
    }

    public sealed class SurfaceMaterial
    {
        public string Name;
        public float[] Diffuse = { };
        public string Texture;
    }

    /// <summary>That surface, as the server's HTTP port answers it: see SurfaceLookup.</summary>
    public sealed class SurfaceAsset
    {
        public double[] Positions = { };
        public uint[] Triangles = { };
        public float[] Uvs = { }, Normals = { };
        public byte[] Colours = { };
        public uint[] MaterialIndices = { };
        public SurfaceMaterial[] Materials = { };
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
        public uint[] BlendIds = { }, BlendVertices = { }, RoundAdded = { }, RoundBlends = { }, TetElders = { };
        public double[] BlendWeights = { };

        /// <summary>
        /// Carries a field on the vertices, so many numbers for each, from the state before this delta to that after it: the values with which
        /// each vertex has what its material has. For fields of your own, in Client.DeltaApplied; not for a delta of a box. Throws
        /// ArgumentException, and changes nothing, where values or lists do not fit.
        /// </summary>
        public void Carry(ref double[] values, int components)
        {
            int added = ProvenanceT.Length, before = (int)VertexCount - added;
            if (components < 1 || before < 0 || values.Length != components * before)
                throw new ArgumentException("a field with " + values.Length + " values for " + before + " vertices of " + components + " each");
            string error = ProvenanceError(before);
            if (error != null) throw new ArgumentException(error);
            var next = new double[components * (before + added)];
            Array.Copy(values, next, values.Length);
            int rounds = RoundAdded.Length == 0 ? 1 : RoundAdded.Length, firstAdded = 0, blend = 0;
            for (int round = 0; round < rounds; ++round)
            {
                int endAdded = firstAdded + (RoundAdded.Length == 0 ? added : (int)RoundAdded[round]);
                int endBlend = blend + (RoundBlends.Length == 0 ? BlendIds.Length : (int)RoundBlends[round]);
                // All blends of a round read the values before it.
                var blended = new double[components * (endBlend - blend)];
                for (int i = 0; i < blended.Length; ++i)
                    for (int k = 4 * (blend + i / components), end = k + 4; k < end; ++k)
                        blended[i] += BlendWeights[k] * next[components * BlendVertices[k] + i % components];
                for (int i = 0; i < blended.Length; ++i) next[components * BlendIds[blend + i / components] + i % components] = blended[i];
                for (; firstAdded < endAdded; ++firstAdded)
                {
                    if (Array.BinarySearch(BlendIds, blend, endBlend - blend, (uint)(before + firstAdded)) >= 0) continue;
                    double t = ProvenanceT[firstAdded];
                    for (int c = 0; c < components; ++c)
                        next[components * (before + firstAdded) + c] = (1 - t) * next[components * ProvenanceA[firstAdded] + c]
                            + t * next[components * ProvenanceB[firstAdded] + c];
                }
                blend = endBlend;
            }
            values = next;
        }

        /// <summary>What is wrong with provenance or blends for a state of so many vertices; null: nothing.</summary>
        internal string ProvenanceError(int vertices)
        {
            for (int i = 0; i < ProvenanceT.Length; ++i)
                if (ProvenanceA[i] >= vertices + i || ProvenanceB[i] >= vertices + i) return "a vertex made of later ones";
            long added = 0, blends = 0;
            for (int round = 0; round < Math.Max(1, RoundAdded.Length); ++round)
            {
                long before = vertices + added, first = blends;
                added += RoundAdded.Length == 0 ? ProvenanceT.Length : (long)RoundAdded[round];
                blends += RoundBlends.Length == 0 ? BlendIds.Length : (long)RoundBlends[round];
                if (added > ProvenanceT.Length || blends > BlendIds.Length) break;
                for (long i = first; i < blends; ++i)
                {
                    bool fits = BlendIds[i] < vertices + added && (i == first || BlendIds[i] > BlendIds[i - 1]);
                    for (long k = 4 * i; k < 4 * i + 4; ++k) fits &= BlendVertices[k] < before;
                    if (!fits) return "blends of vertices that do not exist, or out of order";
                }
            }
            bool whole = added == ProvenanceT.Length && blends == BlendIds.Length;
            return whole ? null : "rounds that do not add up to the added vertices and blends";
        }
    }

    public sealed class SurfaceDelta
    {
        public ulong BaseRevision, Revision, SurfaceHash, StateHash;
        public Step[] Steps = { };
        public SurfaceVertices Vertices = new SurfaceVertices();
        public Triangles Triangles = new Triangles();
        public uint[] RemovedVertices = { }, RemovedTriangles = { };
        public SurfaceVertices Rest = new SurfaceVertices();
        public uint LiveTets;
    }

    public sealed class SnapshotBegin
    {
        public View View;
        public ulong Revision;
        public SnapshotCause Cause;
        public uint Chunks, VertexCount, TetCount, TriangleCount;
        public Box Box;
        public uint[] PieceIds = { }, PieceNames = { }, Fields = { };
    }

    public sealed class SnapshotChunk
    {
        public uint Index, FirstVertex;
        public double[] Positions = { }, RestPositions = { };
        public Tets Tets = new Tets();
        public uint[] TetPieces = { }, VertexIds = { };
        public SurfaceVertices SurfaceVertices = new SurfaceVertices();
        public SurfaceVertices SurfaceRest = new SurfaceVertices();
        public Triangles Triangles = new Triangles();
    }

    public sealed class SnapshotEnd
    {
        public ulong Revision, StateHash, SurfaceHash, PartHash;
    }

    /// <summary>Simulator: where vertices are now, metres. They are Ids, ascending, or without ids First, First + 1, ...</summary>
    public sealed class Positions
    {
        /// <summary>The simulator's own number for the message, which the report has.</summary>
        public ulong Frame;
        /// <summary>The state that they were computed with, one that the client holds.</summary>
        public ulong Revision;
        public long SourceNs;
        public uint[] Ids = { };
        public uint First;
        /// <summary>x y z of each vertex, in one of the two.</summary>
        public float[] F32 = { };
        public double[] F64 = { };
    }

    /// <summary>What became of a message of positions.</summary>
    public sealed class PositionsReport
    {
        public ulong Frame, Revision;
        public uint Moved, PassedOver;
        /// <summary>Vertices that stayed, or went half the way: at a blade that cuts, or a tetrahedron would have inverted.</summary>
        public uint[] Held = { };
        public ulong Taken, Skipped;
    }

    /// <summary>To a simulator: what a blade does to the body. Incise's frame.</summary>
    public sealed class BladeLoad
    {
        public uint Source;
        public ulong Revision;
        public long SourceNs, ServerNs;
        public BladeContact Contact;
        public bool Engaged;
        /// <summary>The edge and the tool's origin.</summary>
        public Vec3 Heel, Tip, Tool;
        /// <summary>On the hand: N, and N m about the tool's origin. Center is where the force acts.</summary>
        public Vec3 ForceN, TorqueNM, Center;
        public double EngagedLengthM;
        /// <summary>Vertices of Revision, ascending, and the force on each, x y z, N: they sum to the opposite of ForceN.</summary>
        public uint[] Ids = { };
        public double[] Forces = { };
        public ulong Number, Skipped;
    }

    /// <summary>
    /// A simulator's own model of the tissue at a blade, in answer to a BladeLoad: inwards from Point, a place of the tool's origin, the
    /// force is Stiffness (Point - tool), until ValidForNs after ServerNs.
    /// </summary>
    public sealed class BladeModel
    {
        /// <summary>Those of the BladeLoad.</summary>
        public uint Source;
        public long ServerNs;
        /// <summary>Normal: unit, out of the tissue.</summary>
        public Vec3 Point, Normal;
        /// <summary>Nine numbers, row by row, N/m: symmetric, positive semidefinite.</summary>
        public double[] Stiffness = { };
        /// <summary>Along the normal; and where the tissue gives way, N: 0, it holds.</summary>
        public double DampingNSPerM, ResistanceN;
        public long ValidForNs;
    }

    public sealed class Stats
    {
        public string Json = "";
        public ulong Revision, Frames, LateFrames, PosesAccepted, PosesRejected;
        public uint LiveTets, Pieces, Sessions, BacklogSegments;
        public float FrameWorkP99Us, PoseToDeltaP99Us;
        public Recording Recording;
        public uint Undoable;
        /// <summary>Those that somebody holds.</summary>
        public BladeStats[] Blades = { };
    }

    /// <summary>Since the blade was taken.</summary>
    public sealed class BladeStats
    {
        public uint Source, Strokes;
        public string Name = "";
        public ulong Poses, Rejected, CutFaces;
        public bool InStroke;
    }

    public sealed class Reset { }

    /// <summary>Operators and admins: back to the state before the last stroke that cut something.</summary>
    public sealed class Undo
    {
        /// <summary>An operator's: also where other blades have cut since that stroke began.</summary>
        public bool Others;
    }

    /// <summary>Where a blade's edge is between the deltas, Incise's frame.</summary>
    public sealed class BladePose
    {
        public uint Source;
        public bool Cutting;
        public Vec3 Heel, Tip;
        public long ArrivalNs;
        /// <summary>On the hand, newtons.</summary>
        public Vec3 ForceN;
    }
}
