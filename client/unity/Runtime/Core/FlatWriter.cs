using System;
using System.Collections.Generic;
using System.Text;

namespace Incise
{
    /// <summary>A table to be written: fields by their place in the schema's table. Zeros are left out, as FlatBuffers does.</summary>
    public sealed class FlatDraft
    {
        internal struct Field
        {
            public int Place;
            public byte[] Inline; // little-endian bytes within the table; null: an offset to what follows
            public int Alignment;
            public FlatDraft Table;
            public byte[] Elements; // of an array or a text
            public int Count;
            public bool IsText;
        }

        internal readonly List<Field> Fields = new List<Field>();

        public FlatDraft Byte(int place, int value)
        {
            return value == 0 ? this : Add(place, new[] { (byte)value }, 1);
        }

        public FlatDraft UInt(int place, uint value)
        {
            return value == 0 ? this : Add(place, BitConverter.GetBytes(value), 4);
        }

        public FlatDraft Float(int place, float value)
        {
            return value == 0 ? this : Add(place, BitConverter.GetBytes(value), 4);
        }

        public FlatDraft Double(int place, double value)
        {
            return Long(place, BitConverter.DoubleToInt64Bits(value));
        }

        public FlatDraft ULong(int place, ulong value)
        {
            return value == 0 ? this : Add(place, BitConverter.GetBytes(value), 8);
        }

        public FlatDraft Long(int place, long value)
        {
            return ULong(place, unchecked((ulong)value));
        }

        /// <summary>A struct of doubles.</summary>
        public FlatDraft Vector(int place, Vec3 v)
        {
            var bytes = new byte[24];
            Buffer.BlockCopy(new[] { v.X, v.Y, v.Z }, 0, bytes, 0, 24);
            return Add(place, bytes, 8);
        }

        public FlatDraft Table(int place, FlatDraft table)
        {
            if (table != null) Fields.Add(new Field { Place = place, Alignment = 4, Table = table });
            return this;
        }

        public FlatDraft Text(int place, string text)
        {
            if (string.IsNullOrEmpty(text)) return this;
            byte[] bytes = Encoding.UTF8.GetBytes(text);
            Fields.Add(new Field { Place = place, Alignment = 4, Elements = bytes, Count = bytes.Length, IsText = true });
            return this;
        }

        /// <summary>An array of structs whose members are 8 bytes long at most.</summary>
        public FlatDraft Array(int place, byte[] elements, int count)
        {
            Fields.Add(new Field { Place = place, Alignment = 4, Elements = elements, Count = count });
            return this;
        }

        /// <summary>An array of numbers of so many bytes each; an empty one is left out.</summary>
        public FlatDraft Numbers<T>(int place, T[] values, int bytesEach) where T : struct
        {
            if (values == null || values.Length == 0) return this;
            var bytes = new byte[bytesEach * values.Length];
            Buffer.BlockCopy(values, 0, bytes, 0, bytes.Length);
            return Array(place, bytes, values.Length);
        }

        private FlatDraft Add(int place, byte[] bytes, int alignment)
        {
            Fields.Add(new Field { Place = place, Inline = bytes, Alignment = alignment });
            return this;
        }
    }

    /// <summary>Writes drafts front to back: a table, then what it refers to.</summary>
    public sealed class FlatWriter
    {
        private byte[] data = new byte[256];
        private int length;

        /// <summary>A whole message.</summary>
        public static byte[] Write(FlatDraft root, string identifier)
        {
            var writer = new FlatWriter();
            writer.Reserve(8);
            Encoding.ASCII.GetBytes(identifier, 0, 4, writer.data, 4);
            writer.Put(0, writer.WriteTable(root));
            writer.Align(8);
            var bytes = new byte[writer.length];
            Buffer.BlockCopy(writer.data, 0, bytes, 0, bytes.Length);
            return bytes;
        }

        private int WriteTable(FlatDraft draft)
        {
            var fields = draft.Fields;
            fields.Sort((a, b) => a.Alignment != b.Alignment ? b.Alignment - a.Alignment : a.Place - b.Place);
            int places = 0;
            foreach (var field in fields) places = Math.Max(places, field.Place + 1);
            int vtableSize = 4 + 2 * places;
            // The table begins 4 bytes before a multiple of 8, so that its first field is aligned.
            while ((length + vtableSize) % 8 != 4) Reserve(1);
            int vtable = Reserve(vtableSize);
            int table = Reserve(4);
            PutInt(table, table - vtable);
            var at = new int[fields.Count];
            for (int i = 0; i < fields.Count; ++i)
            {
                Align(fields[i].Alignment);
                byte[] bytes = fields[i].Inline;
                at[i] = Reserve(bytes == null ? 4 : bytes.Length);
                if (bytes != null) Buffer.BlockCopy(bytes, 0, data, at[i], bytes.Length);
                PutShort(vtable + 4 + 2 * fields[i].Place, at[i] - table);
            }
            PutShort(vtable, vtableSize);
            PutShort(vtable + 2, length - table);
            for (int i = 0; i < fields.Count; ++i)
            {
                if (fields[i].Table != null) Put(at[i], WriteTable(fields[i].Table));
                if (fields[i].Elements != null) Put(at[i], WriteElements(fields[i]));
            }
            return table;
        }

        private int WriteElements(FlatDraft.Field field)
        {
            while ((length + 4) % 8 != 0) Reserve(1);
            int at = Reserve(4);
            PutInt(at, field.Count);
            int begin = Reserve(field.Elements.Length + (field.IsText ? 1 : 0));
            Buffer.BlockCopy(field.Elements, 0, data, begin, field.Elements.Length);
            return at;
        }

        /// <summary>Room for so many zero bytes; returns where it begins.</summary>
        private int Reserve(int bytes)
        {
            if (length + bytes > data.Length) System.Array.Resize(ref data, Math.Max(2 * data.Length, length + bytes));
            length += bytes;
            return length - bytes;
        }

        private void Align(int alignment)
        {
            while (length % alignment != 0) Reserve(1);
        }

        /// <summary>An offset from here to there.</summary>
        private void Put(int at, int target)
        {
            PutInt(at, target - at);
        }

        private void PutInt(int at, int value)
        {
            Buffer.BlockCopy(BitConverter.GetBytes(value), 0, data, at, 4);
        }

        private void PutShort(int at, int value)
        {
            Buffer.BlockCopy(BitConverter.GetBytes((ushort)value), 0, data, at, 2);
        }
    }
}
