using System;

namespace Incise
{
    /// <summary>From bytes to checked messages. PROTOCOL.md, section 10, has the limits.</summary>
    public static class MessageReader
    {
        public const int MinBytes = 16, MaxBytes = 64 << 20;
        internal const string Identifier = "INC1";
        internal const uint NoId = 0xffffffff;
        private const uint IdLimit = 0x3fffffff;
        private const double MaxCoordinate = 1e6;
        private const int NameBytes = 256, TextBytes = 4096, JsonBytes = 1 << 20, MaxSteps = 4096, MaxChunks = 65536, MaxMaterials = 4096, MaxFields = 256, MaxBlades = 64;

        /// <summary>The message in the first bytes of an array. Throws WireException.</summary>
        public static Message Read(byte[] data, int length)
        {
            if (length < MinBytes || length > MaxBytes) throw new WireException("a message of " + length + " bytes");
            FlatTable root = FlatTable.Root(data, length, Identifier);
            FlatTable body;
            if (!root.Table(3, out body)) throw new WireException("a message without a body");
            return new Message { Sequence = root.ULong(0), SentNs = root.Long(1), Body = ReadBody(root.Byte(2), body) };
        }

        private static object ReadBody(byte kind, FlatTable t)
        {
            switch (kind)
            {
                case 2: return ReadWelcome(t);
                case 5: return new Ping { Nonce = t.ULong(0), SentNs = t.Long(1) };
                case 6: return new Pong { Nonce = t.ULong(0), PingSentNs = t.Long(1), ReceivedNs = t.Long(2) };
                case 7: return ReadError(t);
                case 8: return ReadBye(t);
                case 10: return ReadReport(t);
                case 12: return ReadForce(t);
                case 13: return ReadDelta(t);
                case 14: return ReadSurfaceDelta(t);
                case 15: return ReadBegin(t);
                case 16: return ReadChunk(t);
                case 17:
                    return new SnapshotEnd { Revision = t.ULong(0), StateHash = t.ULong(1), SurfaceHash = t.ULong(2), PartHash = t.ULong(3) };
                case 19: return ReadStats(t);
                case 23:
                    return new BladePose { Source = t.UInt(0), Cutting = t.Bool(1), Heel = Needed(t, 2), Tip = Needed(t, 3), ArrivalNs = t.Long(4), ForceN = Vector(t, 5) };
                case 24: return ReadPositionsReport(t);
                case 25: return ReadSurfaceAsset(t);
                case 27: return ReadLoad(t);
                default: return null;
            }
        }

        private static Welcome ReadWelcome(FlatTable t)
        {
            var m = new Welcome
            {
                ProtocolVersion = t.UInt(0), Session = t.ULong(1), Role = (Role)Enumeration(t, 2, 3), View = (View)Enumeration(t, 3, 2),
                Resumed = t.Bool(4), Revision = t.ULong(5), StateHash = t.ULong(6), BladeHeel = Vector(t, 8), BladeTip = Vector(t, 9),
                Source = t.UInt(10), EngageButton = t.Int(11, -1), MaxSpeedMS = Finite(t.Double(12)), FrameRateHz = Finite(t.Double(13)),
                MaxMessageBytes = t.UInt(14), ServerName = t.Text(15, NameBytes), ServerVersion = t.Text(16, NameBytes),
                ServerMonotonicNs = t.Long(17), ServerUnixNs = t.Long(18), Policy = t.Text(19, NameBytes),
                Recording = (Recording)Enumeration(t, 20, 2)
            };
            FlatTable surface;
            if (t.Table(21, out surface))
                m.Surface = new SurfaceFacts { Triangles = surface.UInt(0), Path = surface.Text(1, NameBytes), ContentHash = surface.Text(2, NameBytes) };
            FlatTable[] fields = t.Tables(22, MaxFields);
            m.Fields = new FieldFacts[fields.Length];
            for (int i = 0; i < fields.Length; ++i)
            {
                uint components = fields[i].Has(2) ? fields[i].UInt(2) : 1;
                Require(components >= 1 && components <= 9, "fields.components: accepted are 1 to 9");
                m.Fields[i] = new FieldFacts
                {
                    Name = fields[i].Text(0, NameBytes), On = (FieldOn)Enumeration(fields[i], 1, 1), Components = components, Whole = fields[i].Bool(3)
                };
            }
            FlatTable restart;
            if (t.Table(23, out restart))
            {
                byte kind = restart.Byte(0);
                m.Restart = new Restart
                {
                    Kind = kind > (byte)RestartKind.Undo ? RestartKind.None : (RestartKind)kind, Role = (Role)Enumeration(restart, 1, 3),
                    By = restart.Text(2, NameBytes), Source = restart.UInt(3), Blade = restart.Text(4, NameBytes),
                    Others = restart.Texts(5, MaxFields, NameBytes)
                };
            }
            Require(m.EngageButton >= -1 && m.EngageButton < 32, "engage_button: accepted are -1 to 31");
            FlatTable facts;
            if (!t.Table(7, out facts)) return m;
            m.Mesh = new MeshFacts
            {
                Name = facts.Text(0, NameBytes), ContentHash = facts.Text(1, NameBytes), Vertices = facts.UInt(2), Tets = facts.UInt(3),
                BoundaryFaces = facts.UInt(4), MeanEdgeLengthM = Finite(facts.Double(5)), Box = ReadBox(facts, 6)
            };
            return m;
        }

        // Codes and reasons of a later version are still errors: what is unknown reads as Unknown.
        private static Error ReadError(FlatTable t)
        {
            ushort code = t.UShort(0);
            return new Error
            {
                Code = code > (ushort)ErrorCode.NotRecorded ? ErrorCode.Unknown : (ErrorCode)code, Text = t.Text(1, TextBytes),
                Fatal = t.Bool(2), InReplyTo = t.ULong(3)
            };
        }

        private static Bye ReadBye(FlatTable t)
        {
            byte reason = t.Byte(0);
            return new Bye
            {
                Reason = reason > (byte)ByeReason.Refused ? ByeReason.Unknown : (ByeReason)reason, Text = t.Text(1, TextBytes)
            };
        }

        private static PoseReport ReadReport(FlatTable t)
        {
            return new PoseReport
            {
                ThroughSequence = t.ULong(0), Accepted = t.ULong(1), NotFinite = t.ULong(2), NotUnit = t.ULong(3),
                TimeNotRising = t.ULong(4), QueueFull = t.ULong(5), TooFast = t.ULong(6), LastSourceNs = t.Long(7),
                BacklogSegments = t.UInt(8), Recorded = t.ULong(9), RecordedSourceNs = t.Long(10),
                Recording = (Recording)Enumeration(t, 11, 2)
            };
        }

        private static Force ReadForce(FlatTable t)
        {
            var m = new Force
            {
                Source = t.UInt(0), SourceNs = t.Long(1), ForceN = Needed(t, 2), EngagedLengthM = Finite(t.Double(3)),
                Saturated = t.Bool(5), Ramping = t.Bool(6), LatchedOff = t.Bool(7), TorqueNM = Vector(t, 8)
            };
            FlatTable c;
            if (!t.Table(4, out c)) return m;
            m.Contact = new LocalContact
            {
                Point = Needed(c, 0), Normal = Needed(c, 1), StiffnessNPerM = Finite(c.Double(2)), DampingNSPerM = Finite(c.Double(3)),
                CuttingResistanceN = Finite(c.Double(4)), FrictionNSPerM = Finite(c.Double(5)), ValidForNs = c.Long(6),
                Penetrated = c.Bool(7), Arm = Vector(c, 8)
            };
            return m;
        }

        private static PositionsReport ReadPositionsReport(FlatTable t)
        {
            return new PositionsReport
            {
                Frame = t.ULong(0), Revision = t.ULong(1), Moved = t.UInt(2), PassedOver = t.UInt(3), Held = Ids(t, 4, IdLimit), Taken = t.ULong(5),
                Skipped = t.ULong(6)
            };
        }

        private static BladeLoad ReadLoad(FlatTable t)
        {
            var m = new BladeLoad
            {
                Source = t.UInt(0), Revision = t.ULong(1), SourceNs = t.Long(2), ServerNs = t.Long(3), Contact = (BladeContact)Enumeration(t, 4, 2),
                Engaged = t.Bool(5), Heel = Needed(t, 6), Tip = Needed(t, 7), Tool = Needed(t, 8), ForceN = Needed(t, 9),
                TorqueNM = Needed(t, 10), Center = Needed(t, 11), EngagedLengthM = Finite(t.Double(12)), Ids = Ids(t, 13, IdLimit),
                Number = t.ULong(15), Skipped = t.ULong(16)
            };
            m.Forces = Positions(t, 14, m.Ids.Length, "forces");
            return m;
        }

        private static Delta ReadDelta(FlatTable t)
        {
            var m = new Delta
            {
                BaseRevision = t.ULong(0), Revision = t.ULong(1), Steps = ReadSteps(t, 2), MovedIds = Ids(t, 3, IdLimit), FirstAdded = t.UInt(5),
                ProvenanceT = t.Array<double>(9, 8), Tets = ReadTets(t, 10), RemovedTets = Ids(t, 11, IdLimit),
                BoundaryUpserted = Ids(t, 12, 4 * IdLimit), BoundaryRemoved = Ids(t, 13, 4 * IdLimit), PieceIds = t.Array<uint>(14, 4),
                PieceTets = t.Array<uint>(16, 4), VertexCount = t.UInt(17), LiveTets = t.UInt(18), StateHash = t.ULong(19),
                FirstNewTet = t.UInt(20), AddedIds = Ids(t, 21, IdLimit), RemovedVertices = Ids(t, 22, IdLimit), PartHash = t.ULong(23),
                RestIds = Ids(t, 24, IdLimit), PieceNames = t.Array<uint>(26, 4), BlendIds = t.Array<uint>(27, 4),
                RoundAdded = t.Array<uint>(30, 4), TetElders = t.Array<uint>(32, 4)
            };
            int added = m.ProvenanceT.Length;
            m.MovedPositions = Positions(t, 4, m.MovedIds.Length, "moved_positions");
            m.AddedPositions = Positions(t, 6, added, "added_positions");
            m.ProvenanceA = Matching<uint>(t, 7, 4, added, "provenance_a");
            m.ProvenanceB = Matching<uint>(t, 8, 4, added, "provenance_b");
            m.PieceSizes = Matching<uint>(t, 15, 4, m.PieceIds.Length, "piece_sizes");
            m.RestPositions = Positions(t, 25, m.RestIds.Length, "rest_positions");
            m.BlendVertices = Matching<uint>(t, 28, 4, 4 * m.BlendIds.Length, "blend_vertices");
            m.BlendWeights = Matching<double>(t, 29, 8, 4 * m.BlendIds.Length, "blend_weights");
            m.RoundBlends = Matching<uint>(t, 31, 4, m.RoundAdded.Length, "round_blends");
            foreach (double weight in m.BlendWeights) Finite(weight);
            foreach (double share in m.ProvenanceT) Require(share >= 0 && share <= 1, "provenance_t: accepted are 0 to 1");
            Require(m.PieceNames.Length == 0 || m.PieceNames.Length == m.PieceIds.Length, "piece_names: as many as piece_ids, or none");
            Require(m.AddedIds.Length == 0 || m.AddedIds.Length == added, "added_ids: as many as provenance_t, or none");
            return m;
        }

        private static SurfaceDelta ReadSurfaceDelta(FlatTable t)
        {
            return new SurfaceDelta
            {
                BaseRevision = t.ULong(0), Revision = t.ULong(1), Steps = ReadSteps(t, 2), Vertices = ReadSurfaceVertices(t, 3),
                RemovedVertices = Ids(t, 4, IdLimit), Triangles = ReadTriangles(t, 5), RemovedTriangles = Ids(t, 6, 4 * IdLimit),
                SurfaceHash = t.ULong(7), StateHash = t.ULong(8), LiveTets = t.UInt(9), Rest = ReadSurfaceVertices(t, 10)
            };
        }

        private static SurfaceAsset ReadSurfaceAsset(FlatTable t)
        {
            var m = new SurfaceAsset { Positions = t.Array<double>(0, 8), Triangles = t.Array<uint>(1, 4) };
            Check(m.Positions);
            Require(m.Positions.Length % 3 == 0 && m.Triangles.Length % 3 == 0, "positions, triangles: three for each");
            foreach (uint v in m.Triangles) Require(v < m.Positions.Length / 3, "triangles: a vertex that does not exist");
            int corners = m.Triangles.Length;
            m.Uvs = ByElement<float>(t, 2, 4, 2 * corners, "uvs");
            m.Normals = ByElement<float>(t, 3, 4, 3 * corners, "normals");
            m.Colours = ByElement<byte>(t, 4, 1, 4 * corners, "colours");
            m.MaterialIndices = ByElement<uint>(t, 5, 4, corners / 3, "material_indices");
            foreach (float x in m.Uvs) Finite(x);
            foreach (float x in m.Normals) Finite(x);
            FlatTable[] materials = t.Tables(6, MaxMaterials);
            m.Materials = new SurfaceMaterial[materials.Length];
            for (int i = 0; i < materials.Length; ++i)
            {
                m.Materials[i] = new SurfaceMaterial
                {
                    Name = materials[i].Text(0, NameBytes), Diffuse = Matching<float>(materials[i], 1, 4, 3, "materials.diffuse"),
                    Texture = materials[i].Text(2, NameBytes)
                };
            }
            foreach (uint i in m.MaterialIndices) Require(i < materials.Length, "material_indices: a material that does not exist");
            return m;
        }

        private static SnapshotBegin ReadBegin(FlatTable t)
        {
            byte cause = t.Byte(2);
            var m = new SnapshotBegin
            {
                View = (View)Enumeration(t, 0, 2), Revision = t.ULong(1),
                Cause = cause > (byte)SnapshotCause.Subscribe ? SnapshotCause.Join : (SnapshotCause)cause, Chunks = t.UInt(3),
                VertexCount = t.UInt(4), TetCount = t.UInt(5), TriangleCount = t.UInt(6), Box = ReadBox(t, 7),
                PieceIds = Ids(t, 8, NoId)
            };
            m.PieceNames = Matching<uint>(t, 9, 4, m.PieceIds.Length, "piece_names");
            m.Fields = Ids(t, 10, MaxFields);
            Require(m.View != View.None, "view: None has no snapshot");
            Require(m.Chunks <= MaxChunks, "chunks: above the limit");
            return m;
        }

        private static SnapshotChunk ReadChunk(FlatTable t)
        {
            var m = new SnapshotChunk
            {
                Index = t.UInt(0), FirstVertex = t.UInt(1), Positions = t.Array<double>(2, 8), Tets = ReadTets(t, 3),
                TetPieces = t.Array<uint>(4, 4), SurfaceVertices = ReadSurfaceVertices(t, 5), Triangles = ReadTriangles(t, 6),
                VertexIds = Ids(t, 7, IdLimit), RestPositions = t.Array<double>(8, 8), SurfaceRest = ReadSurfaceVertices(t, 9)
            };
            Require(m.Positions.Length % 3 == 0, "positions: three for each vertex");
            Require(m.RestPositions.Length == 0 || m.RestPositions.Length == m.Positions.Length, "rest_positions: as many as positions, or none");
            Require(m.TetPieces.Length == 0 || m.TetPieces.Length == m.Tets.Ids.Length, "tet_pieces: one for each of tets, or none");
            Check(m.Positions);
            Check(m.RestPositions);
            return m;
        }

        private static Stats ReadStats(FlatTable t)
        {
            var m = new Stats
            {
                Json = t.Text(0, JsonBytes), Revision = t.ULong(1), LiveTets = t.UInt(2), Pieces = t.UInt(3), Sessions = t.UInt(4),
                BacklogSegments = t.UInt(5), Frames = t.ULong(6), LateFrames = t.ULong(7), PosesAccepted = t.ULong(8),
                PosesRejected = t.ULong(9), FrameWorkP99Us = t.Float(10), PoseToDeltaP99Us = t.Float(11),
                Recording = (Recording)Enumeration(t, 12, 2), Undoable = t.UInt(13)
            };
            FlatTable[] blades = t.Tables(14, MaxBlades);
            m.Blades = new BladeStats[blades.Length];
            for (int i = 0; i < blades.Length; ++i)
            {
                m.Blades[i] = new BladeStats
                {
                    Source = blades[i].UInt(0), Name = blades[i].Text(1, NameBytes), Poses = blades[i].ULong(2), Rejected = blades[i].ULong(3),
                    Strokes = blades[i].UInt(4), CutFaces = blades[i].ULong(5), InStroke = blades[i].Bool(6)
                };
            }
            return m;
        }

        private static Step[] ReadSteps(FlatTable t, int field)
        {
            FlatTable[] tables = t.Tables(field, MaxSteps);
            var steps = new Step[tables.Length];
            for (int i = 0; i < steps.Length; ++i)
            {
                FlatTable s = tables[i];
                steps[i] = new Step
                {
                    Revision = s.ULong(0), Source = s.UInt(1), Stroke = s.UInt(2), Batch = s.UInt(3), StrokeEnded = s.Bool(4),
                    FromHeel = Vector(s, 5), FromTip = Vector(s, 6), ToHeel = Vector(s, 7), ToTip = Vector(s, 8), FromSourceNs = s.Long(9),
                    ToSourceNs = s.Long(10), ArrivalNs = s.Long(11), DrainNs = s.Long(12), CutNs = s.Long(13), CutFaces = s.UInt(14),
                    CutAreaM2 = Finite(s.Double(15)), Snaps = s.UInt(16), Splits = s.UInt(17), MinDihedralDeg = Finite(s.Double(18)),
                    MaxDeviationH = Finite(s.Double(19)), StateHash = s.ULong(20)
                };
            }
            return steps;
        }

        private static Tets ReadTets(FlatTable parent, int field)
        {
            FlatTable t;
            if (!parent.Table(field, out t)) return new Tets();
            uint[] ids = Ids(t, 0, IdLimit);
            return new Tets
            {
                Ids = ids, Vertices = Matching<uint>(t, 1, 4, 4 * ids.Length, "tets.vertices"),
                Regions = Matching<int>(t, 2, 4, ids.Length, "tets.regions"), CutMasks = Matching<byte>(t, 3, 1, ids.Length, "tets.cut_masks"),
                BoundaryMasks = Matching<byte>(t, 4, 1, ids.Length, "tets.boundary_masks")
            };
        }

        private static Triangles ReadTriangles(FlatTable parent, int field)
        {
            FlatTable t;
            if (!parent.Table(field, out t)) return new Triangles();
            uint[] ids = Ids(t, 0, 4 * IdLimit);
            return new Triangles
            {
                Ids = ids, Vertices = Matching<uint>(t, 1, 4, 3 * ids.Length, "triangles.vertices"),
                Flags = Matching<byte>(t, 2, 1, ids.Length, "triangles.flags"), Pieces = Matching<uint>(t, 3, 4, ids.Length, "triangles.pieces"),
                Regions = Matching<int>(t, 4, 4, ids.Length, "triangles.regions"), Origins = ByElement<uint>(t, 5, 4, ids.Length, "triangles.origins")
            };
        }

        private static SurfaceVertices ReadSurfaceVertices(FlatTable parent, int field)
        {
            FlatTable t;
            if (!parent.Table(field, out t)) return new SurfaceVertices();
            uint[] ids = Ids(t, 0, IdLimit);
            float[] positions = Matching<float>(t, 1, 4, 3 * ids.Length, "vertices.positions");
            foreach (float x in positions) Require(Math.Abs(x) <= MaxCoordinate, "vertices.positions: beyond 1e6 m");
            return new SurfaceVertices { Ids = ids, Positions = positions };
        }

        /// <summary>As many, or none.</summary>
        private static T[] ByElement<T>(FlatTable t, int field, int bytesEach, int count, string name) where T : struct
        {
            T[] values = t.Array<T>(field, bytesEach);
            Require(values.Length == 0 || values.Length == count, name + ": " + values.Length + " entries instead of " + count + ", or none");
            return values;
        }

        private static T[] Matching<T>(FlatTable t, int field, int bytesEach, int count, string name) where T : struct
        {
            T[] values = t.Array<T>(field, bytesEach);
            Require(values.Length == count, name + ": " + values.Length + " entries, expected are " + count);
            return values;
        }

        private static double[] Positions(FlatTable t, int field, int vertices, string name)
        {
            double[] values = Matching<double>(t, field, 8, 3 * vertices, name);
            Check(values);
            return values;
        }

        private static void Check(double[] coordinates)
        {
            foreach (double x in coordinates) Require(Math.Abs(x) <= MaxCoordinate, "a coordinate beyond 1e6 m");
        }

        private static uint[] Ids(FlatTable t, int field, uint limit)
        {
            uint[] ids = t.Array<uint>(field, 4);
            for (int i = 0; i < ids.Length; ++i)
            {
                Require(ids[i] < limit, "an id above the limit");
                Require(i == 0 || ids[i] > ids[i - 1], "ids that do not ascend");
            }
            return ids;
        }

        private static Vec3 Vector(FlatTable t, int field)
        {
            var v = new double[3];
            t.Doubles(field, v);
            Check(v);
            return new Vec3(v[0], v[1], v[2]);
        }

        private static Vec3 Needed(FlatTable t, int field)
        {
            Require(t.Has(field), "a required field is absent");
            return Vector(t, field);
        }

        private static Box ReadBox(FlatTable parent, int field)
        {
            FlatTable t;
            if (!parent.Table(field, out t)) return null;
            var box = new Box(Needed(t, 0), Needed(t, 1));
            Require(box.Min.X <= box.Max.X && box.Min.Y <= box.Max.Y && box.Min.Z <= box.Max.Z, "box: min above max");
            return box;
        }

        private static byte Enumeration(FlatTable t, int field, byte last)
        {
            byte value = t.Byte(field);
            Require(value <= last, "an enumeration of value " + value + ", accepted are 0 to " + last);
            return value;
        }

        private static double Finite(double value)
        {
            Require(!double.IsNaN(value) && !double.IsInfinity(value), "a number that is not finite");
            return value;
        }

        private static void Require(bool condition, string text)
        {
            if (!condition) throw new WireException(text);
        }
    }
}
