using System;

namespace Incise
{
    /// <summary>The bytes of the messages that a client sends, without the length that precedes them on TCP.</summary>
    public static class MessageWriter
    {
        public const int MaxPoses = 8192; // in a batch
        private const int PoseBytes = 72;

        public static byte[] Write(object body, ulong sequence, long sentNs)
        {
            int kind;
            FlatDraft draft = Draft(body, out kind);
            var root = new FlatDraft().ULong(0, sequence).Long(1, sentNs).Byte(2, kind).Table(3, draft);
            return FlatWriter.Write(root, MessageReader.Identifier);
        }

        private static FlatDraft Draft(object body, out int kind)
        {
            var draft = new FlatDraft();
            kind = 1;
            if (body is Hello hello) return Draft(hello);
            kind = 4;
            if (body is Resync resync) return draft.ULong(0, resync.Revision).ULong(1, resync.Hash).Text(2, resync.Reason);
            kind = 5;
            if (body is Ping ping) return draft.ULong(0, ping.Nonce).Long(1, ping.SentNs);
            kind = 6;
            if (body is Pong pong) return draft.ULong(0, pong.Nonce).Long(1, pong.PingSentNs).Long(2, pong.ReceivedNs);
            kind = 8;
            if (body is Bye bye) return draft.Byte(0, (int)bye.Reason).Text(1, bye.Text);
            kind = 9;
            if (body is PoseBatch batch) return draft.Array(0, Bytes(batch.Poses), batch.Poses.Length);
            kind = 11;
            if (body is StrokeControl stroke) return draft.Byte(0, (int)stroke.Action).Long(1, stroke.SourceNs);
            kind = 18;
            if (body is Positions positions) return Draft(positions);
            kind = 28;
            if (body is BladeModel model) return Draft(model);
            kind = 20;
            if (body is Reset) return draft;
            kind = 26;
            if (body is Undo undo) return draft.Byte(0, undo.Others ? 1 : 0);
            throw new ArgumentException("a client does not send " + body.GetType().Name);
        }

        private static FlatDraft Draft(Hello m)
        {
            FlatDraft box = m.Box == null ? null : new FlatDraft().Vector(0, m.Box.Min).Vector(1, m.Box.Max);
            FlatDraft blade = m.Blade == null ? null : new FlatDraft().Vector(0, m.Blade.Heel).Vector(1, m.Blade.Tip);
            return new FlatDraft().UInt(0, m.ProtocolVersion).Byte(1, (int)m.Role).Byte(2, (int)m.View).Text(3, m.ClientName)
                .Text(4, m.ClientVersion).Text(5, m.Token).ULong(6, m.ResumeSession).ULong(7, m.ResumeRevision).Float(8, m.MaxRateHz)
                .Table(9, box).Text(10, m.SourceName).Byte(11, m.TakeOver ? 1 : 0).Float(12, m.BladeRateHz).Table(13, blade)
                .ULong(14, m.ResumeHash).Float(15, m.LoadRateHz);
        }

        private static FlatDraft Draft(Positions m)
        {
            return new FlatDraft().ULong(0, m.Frame).ULong(1, m.Revision).Long(2, m.SourceNs).Numbers(3, m.Ids, 4).UInt(4, m.First)
                .Numbers(5, m.F32, 4).Numbers(6, m.F64, 8);
        }

        private static FlatDraft Draft(BladeModel m)
        {
            return new FlatDraft().UInt(0, m.Source).Long(1, m.ServerNs).Vector(2, m.Point).Vector(3, m.Normal).Numbers(4, m.Stiffness, 8)
                .Double(5, m.DampingNSPerM).Double(6, m.ResistanceN).Long(7, m.ValidForNs);
        }

        private static byte[] Bytes(PoseSample[] poses)
        {
            var bytes = new byte[PoseBytes * poses.Length];
            for (int i = 0; i < poses.Length; ++i) Put(bytes, PoseBytes * i, poses[i]);
            return bytes;
        }

        private static void Put(byte[] bytes, int at, PoseSample p)
        {
            Put(bytes, at, p.SourceNs);
            Put(bytes, at + 8, p.Position.X);
            Put(bytes, at + 16, p.Position.Y);
            Put(bytes, at + 24, p.Position.Z);
            Put(bytes, at + 32, p.Orientation.W);
            Put(bytes, at + 40, p.Orientation.X);
            Put(bytes, at + 48, p.Orientation.Y);
            Put(bytes, at + 56, p.Orientation.Z);
            Put(bytes, at + 64, (long)p.Buttons); // and the reserved zero
        }

        private static void Put(byte[] bytes, int at, double value)
        {
            Put(bytes, at, BitConverter.DoubleToInt64Bits(value));
        }

        private static void Put(byte[] bytes, int at, long value)
        {
            for (int i = 0; i < 8; ++i) bytes[at + i] = unchecked((byte)(value >> 8 * i));
        }

        // ---- A single pose, a thousand times a second: nothing is allocated but the message ----

        private const long Mark = 0x0123456789abcdef;
        private static readonly byte[] single = Write(new PoseBatch { Poses = new[] { new PoseSample { SourceNs = Mark + 2 } } }, Mark, Mark + 1);
        private static readonly int sequenceAt = Find(Mark), sentAt = Find(Mark + 1), poseAt = Find(Mark + 2);

        private static int Find(long value)
        {
            int at = 0;
            while (BitConverter.ToInt64(single, at) != value) ++at;
            return at;
        }

        public static byte[] Write(PoseSample pose, ulong sequence, long sentNs)
        {
            var bytes = (byte[])single.Clone();
            Put(bytes, sequenceAt, unchecked((long)sequence));
            Put(bytes, sentAt, sentNs);
            Put(bytes, poseAt, pose);
            return bytes;
        }
    }
}
