using System;
using System.Collections.Generic;
using System.IO;
using System.Text;
using Incise;

/// <summary>protocol/vectors, and states as canonical bytes (PROTOCOL.md, section 13).</summary>
public static class Vectors
{
    public static string Source; // of the project

    public static string PathOf(string name)
    {
        return Path.Combine(Source, "protocol", "vectors", name);
    }

    public static Dictionary<string, object> Map(object json)
    {
        return (Dictionary<string, object>)json;
    }

    /// <summary>The messages of a TCP stream.</summary>
    public static List<byte[]> Stream(string name)
    {
        byte[] bytes = File.ReadAllBytes(PathOf("streams/" + name + ".bin"));
        var found = new List<byte[]>();
        for (int at = 0; at < bytes.Length;)
        {
            var message = new byte[BitConverter.ToInt32(bytes, at)];
            Buffer.BlockCopy(bytes, at + 4, message, 0, message.Length);
            found.Add(message);
            at += 4 + message.Length;
        }
        return found;
    }

    public static string Canonical(BodyState state)
    {
        var bytes = new MemoryStream();
        var writer = new BinaryWriter(bytes);
        if (state is VolumeState volume) Write(writer, volume);
        else Write(writer, (SurfaceState)state);
        var text = new StringBuilder();
        foreach (byte b in bytes.ToArray()) text.Append(b.ToString("x2"));
        return text.ToString();
    }

    private static void Write(BinaryWriter writer, VolumeState s)
    {
        writer.Write(s.Revision);
        writer.Write(s.HeldHash);
        writer.Write(s.VertexCount);
        writer.Write(s.LiveTets);
        for (int i = 0; i < 3 * s.VertexCount; ++i) writer.Write(s.Positions[i]);
        uint[] pieces = s.Pieces();
        for (uint t = 0; t < s.TetSlots; ++t)
        {
            if (!s.IsAlive(t)) continue;
            writer.Write(t);
            for (int k = 0; k < 4; ++k) writer.Write(s.Tets[4 * t + k]);
            writer.Write(s.Regions[t]);
            writer.Write(pieces[t]);
            writer.Write(s.CutMasks[t] + 256u * s.BoundaryMasks[t]);
        }
    }

    private static void Write(BinaryWriter writer, SurfaceState s)
    {
        writer.Write(s.Revision);
        writer.Write(s.HeldHash);
        writer.Write(s.VertexCount);
        writer.Write(s.TriangleCount);
        var vertices = new List<uint>(s.VertexIds);
        vertices.Sort();
        foreach (uint v in vertices)
        {
            s.TryVertex(v, out Vec3 p, out Vec3 rest);
            writer.Write(v);
            foreach (double x in new[] { p.X, p.Y, p.Z }) writer.Write((float)x);
        }
        var triangles = new List<uint>(s.TriangleIds);
        triangles.Sort();
        foreach (uint id in triangles)
        {
            s.TryTriangle(id, out BoundaryTriangle t);
            writer.Write(id);
            writer.Write(t.A);
            writer.Write(t.B);
            writer.Write(t.C);
            writer.Write(t.Region);
            writer.Write(s.PieceOf(id));
            writer.Write((uint)s.FlagsOf(id));
        }
    }
}
