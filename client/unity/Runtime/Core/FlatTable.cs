using System;
using System.Text;

namespace Incise
{
    /// <summary>
    /// Reads a table of a FlatBuffer. Every offset is checked before it is followed, so bytes from a stranger give a
    /// WireException, never a read outside the message. Fields are named by their place in the schema's table, from 0; a
    /// union takes two places. Format: FlatBuffers, "Internals".
    /// </summary>
    public struct FlatTable
    {
        private readonly byte[] data;
        private readonly int end; // of the message within data
        private readonly int position;
        private readonly int size; // of the table's inline part
        private readonly int vtable;
        private readonly int vtableSize;

        private FlatTable(byte[] data, int end, int position)
        {
            this.data = data;
            this.end = end;
            this.position = position;
            if (position < 4 || position > end - 4 || position % 4 != 0) throw new WireException("a table outside the message");
            long at = (long)position - BitConverter.ToInt32(data, position);
            if (at < 0 || at > end - 4 || at % 2 != 0) throw new WireException("a vtable outside the message");
            vtable = (int)at;
            vtableSize = BitConverter.ToUInt16(data, vtable);
            size = BitConverter.ToUInt16(data, vtable + 2);
            if (vtableSize < 4 || vtableSize % 2 != 0 || vtableSize > end - vtable || size < 4 || size > end - position)
                throw new WireException("a table that reaches outside the message");
        }

        /// <summary>The root of a message in the first bytes of an array.</summary>
        public static FlatTable Root(byte[] data, int length, string identifier)
        {
            if (length < 8 || length > data.Length) throw new WireException("a message of " + length + " bytes");
            for (int i = 0; i < 4; ++i)
            {
                if (data[4 + i] != identifier[i]) throw new WireException("bytes without the identifier " + identifier);
            }
            uint offset = BitConverter.ToUInt32(data, 0);
            if (offset > (uint)length) throw new WireException("a root outside the message");
            return new FlatTable(data, length, (int)offset);
        }

        /// <summary>Where the field's inline bytes are, or 0 if it is absent.</summary>
        private int Find(int field, int bytes, int alignment)
        {
            int entry = 4 + 2 * field;
            if (entry + 2 > vtableSize) return 0;
            int offset = BitConverter.ToUInt16(data, vtable + entry);
            if (offset == 0) return 0;
            if (offset < 4 || offset + bytes > size) throw new WireException("field " + field + " outside its table");
            if ((position + offset) % alignment != 0) throw new WireException("field " + field + " is not aligned");
            return position + offset;
        }

        /// <summary>Where the offset in a field leads, or 0 if the field is absent.</summary>
        private int Follow(int field)
        {
            int at = Find(field, 4, 4);
            if (at == 0) return 0;
            uint offset = BitConverter.ToUInt32(data, at);
            if (offset == 0 || offset > (uint)(end - at - 4) || (at + offset) % 4 != 0)
                throw new WireException("field " + field + " leads outside the message");
            return at + (int)offset;
        }

        public bool Has(int field)
        {
            return Find(field, 1, 1) != 0;
        }

        public byte Byte(int field)
        {
            int at = Find(field, 1, 1);
            return at == 0 ? (byte)0 : data[at];
        }

        public bool Bool(int field)
        {
            return Byte(field) != 0;
        }

        public ushort UShort(int field)
        {
            int at = Find(field, 2, 2);
            return at == 0 ? (ushort)0 : BitConverter.ToUInt16(data, at);
        }

        public uint UInt(int field)
        {
            int at = Find(field, 4, 4);
            return at == 0 ? 0 : BitConverter.ToUInt32(data, at);
        }

        public int Int(int field, int absent)
        {
            int at = Find(field, 4, 4);
            return at == 0 ? absent : BitConverter.ToInt32(data, at);
        }

        public float Float(int field)
        {
            int at = Find(field, 4, 4);
            return at == 0 ? 0 : BitConverter.ToSingle(data, at);
        }

        public ulong ULong(int field)
        {
            int at = Find(field, 8, 8);
            return at == 0 ? 0 : BitConverter.ToUInt64(data, at);
        }

        public long Long(int field)
        {
            return unchecked((long)ULong(field));
        }

        public double Double(int field)
        {
            return BitConverter.Int64BitsToDouble(Long(field));
        }

        /// <summary>The doubles of an inline struct; false if it is absent.</summary>
        public bool Doubles(int field, double[] values)
        {
            int at = Find(field, 8 * values.Length, 8);
            if (at == 0) return false;
            Buffer.BlockCopy(data, at, values, 0, 8 * values.Length);
            return true;
        }

        public bool Table(int field, out FlatTable table)
        {
            int at = Follow(field);
            table = at == 0 ? default(FlatTable) : new FlatTable(data, end, at);
            return at != 0;
        }

        /// <summary>A copy of an array of scalars, each of so many bytes; empty if it is absent.</summary>
        public T[] Array<T>(int field, int bytesEach) where T : struct
        {
            int count, at = Elements(field, bytesEach, out count);
            var values = new T[count];
            if (count > 0) Buffer.BlockCopy(data, at, values, 0, count * bytesEach);
            return values;
        }

        /// <summary>The tables of an array.</summary>
        public FlatTable[] Tables(int field, int limit)
        {
            int count, at = Elements(field, 4, out count);
            if (count > limit) throw new WireException(count + " tables in field " + field + ", accepted are at most " + limit);
            var tables = new FlatTable[count];
            for (int i = 0; i < count; ++i, at += 4)
            {
                uint offset = BitConverter.ToUInt32(data, at);
                if (offset > (uint)(end - at)) throw new WireException("a table outside the message");
                tables[i] = new FlatTable(data, end, at + (int)offset);
            }
            return tables;
        }

        public string Text(int field, int limit)
        {
            return TextAt(Follow(field), limit);
        }

        /// <summary>The texts of an array.</summary>
        public string[] Texts(int field, int limit, int bytes)
        {
            int count, at = Elements(field, 4, out count);
            if (count > limit) throw new WireException(count + " texts in field " + field + ", accepted are at most " + limit);
            var texts = new string[count];
            for (int i = 0; i < count; ++i, at += 4)
            {
                uint offset = BitConverter.ToUInt32(data, at);
                if (offset > (uint)(end - at - 4)) throw new WireException("a text outside the message");
                texts[i] = TextAt(at + (int)offset, bytes);
            }
            return texts;
        }

        private string TextAt(int start, int limit)
        {
            int count, at = ElementsAt(start, 1, out count);
            if (count > limit) throw new WireException("a text of " + count + " bytes, accepted are at most " + limit);
            return Encoding.UTF8.GetString(data, at, count);
        }

        /// <summary>Where an array's elements begin. With none of them 0 elements at 0.</summary>
        private int Elements(int field, int bytesEach, out int count)
        {
            return ElementsAt(Follow(field), bytesEach, out count);
        }

        private int ElementsAt(int at, int bytesEach, out int count)
        {
            count = 0;
            if (at == 0) return 0;
            uint n = BitConverter.ToUInt32(data, at);
            at += 4;
            if (n > (uint)((end - at) / bytesEach)) throw new WireException("an array that reaches outside the message");
            if (n > 0 && at % bytesEach != 0) throw new WireException("an array that is not aligned to " + bytesEach + " bytes");
            count = (int)n;
            return n > 0 ? at : 0;
        }
    }
}
