using System;
using System.Collections.Generic;
using System.IO;
using System.Net;
using System.Net.Sockets;
using System.Threading;

/// <summary>Sends the same messages to each who connects, and reads what comes.</summary>
public sealed class PlayedServer : IDisposable
{
    private readonly TcpListener listener = new TcpListener(IPAddress.Loopback, 0);
    private readonly List<byte[]> messages;

    public int Port { get { return ((IPEndPoint)listener.LocalEndpoint).Port; } }

    public PlayedServer(List<byte[]> messages, int visits)
    {
        this.messages = messages;
        listener.Start();
        new Thread(() => Serve(visits)) { IsBackground = true }.Start();
    }

    private void Serve(int visits)
    {
        try
        {
            for (; visits > 0; --visits)
            {
                using (TcpClient peer = listener.AcceptTcpClient()) Play(peer);
            }
        }
        catch (Exception error) when (error is SocketException || error is ObjectDisposedException || error is InvalidOperationException)
        {
            // Disposed: while it waits, or just before.
        }
    }

    private void Play(TcpClient peer)
    {
        try
        {
            NetworkStream stream = peer.GetStream();
            foreach (byte[] message in messages)
            {
                stream.Write(BitConverter.GetBytes(message.Length), 0, 4);
                stream.Write(message, 0, message.Length);
            }
            peer.Client.Shutdown(SocketShutdown.Send);
            var ignored = new byte[4096];
            while (stream.Read(ignored, 0, ignored.Length) > 0) { }
        }
        catch (IOException)
        {
            // The client has left.
        }
    }

    public void Dispose()
    {
        listener.Stop();
    }
}
