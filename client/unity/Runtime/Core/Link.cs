using System;
using System.IO;
using System.Net;
using System.Net.Security;
using System.Net.Sockets;
using System.Security.Authentication;

namespace Incise
{
    /// <summary>One TCP connection, with TLS or without. Read() from one thread, Write() from one, Close() from any.</summary>
    internal sealed class Link
    {
        private readonly Socket socket;
        private readonly Stream stream;
        private byte[] message = new byte[1 << 16]; // read
        private byte[] frame = new byte[1 << 10]; // written, with its length

        /// <summary>Throws IOException or SocketException: no such host, nobody there, no answer in time.</summary>
        public Link(string host, int port, ClientOptions options)
        {
            TimeSpan timeout = TimeSpan.FromSeconds(options.ConnectTimeoutS);
            socket = Connect(host, port, timeout);
            try
            {
                socket.NoDelay = true;
                socket.ReceiveTimeout = (int)timeout.TotalMilliseconds; // until Welcome
                socket.SendTimeout = 10000;
                stream = new NetworkStream(socket, false);
                if (!options.Tls) return;
                stream = Secure(stream, host, options.CertificateCheck);
            }
            catch
            {
                socket.Close();
                throw;
            }
        }

        private static Stream Secure(Stream plain, string host, RemoteCertificateValidationCallback check)
        {
            string refused = null;
            var secure = new SslStream(plain, false, (sender, certificate, chain, errors) =>
            {
                if (check != null ? check(sender, certificate, chain, errors) : errors == SslPolicyErrors.None) return true;
                refused = check != null ? "the certificate was refused" : "the certificate is not trusted (" + errors + ")";
                return false;
            });
            try
            {
                secure.AuthenticateAsClient(host);
            }
            catch (Exception error) when (refused != null && !(error is AuthenticationException))
            {
                // Mono may end its own read first, and say only that.
                throw new AuthenticationException(refused, error);
            }
            return secure;
        }

        private static Socket Connect(string host, int port, TimeSpan timeout)
        {
            Exception failure = null;
            foreach (IPAddress address in Dns.GetHostAddresses(host))
            {
                var socket = new Socket(address.AddressFamily, SocketType.Stream, ProtocolType.Tcp);
                try
                {
                    IAsyncResult begun = socket.BeginConnect(address, port, null, null);
                    if (!begun.AsyncWaitHandle.WaitOne(timeout)) throw new IOException("no answer in time");
                    socket.EndConnect(begun);
                    return socket;
                }
                catch (Exception error) when (error is SocketException || error is IOException)
                {
                    failure = error;
                    socket.Close();
                }
            }
            throw failure ?? new IOException("no such host");
        }

        /// <summary>From here on a read waits as long as it takes.</summary>
        public void WaitLonger()
        {
            socket.ReceiveTimeout = 0;
        }

        /// <summary>The next message is in the first bytes of the array, until the next call. Throws IOException at the end.</summary>
        public byte[] Read(out int length)
        {
            Fill(0, 4);
            uint announced = BitConverter.ToUInt32(message, 0);
            if (announced < MessageReader.MinBytes || announced > MessageReader.MaxBytes)
                throw new WireException("a message of " + announced + " bytes");
            length = (int)announced;
            // Memory is taken as the bytes come, not as they are announced.
            for (int have = 0; have < length;)
            {
                if (have == message.Length) Array.Resize(ref message, Math.Min(2 * have, MessageReader.MaxBytes));
                int part = Math.Min(length, message.Length);
                Fill(have, part);
                have = part;
            }
            return message;
        }

        private void Fill(int from, int to)
        {
            while (from < to)
            {
                int read = ReadSome(from, to - from);
                if (read <= 0) throw new EndOfStreamException("the connection was closed");
                from += read;
            }
        }

        private int ReadSome(int from, int count)
        {
            try
            {
                return stream.Read(message, from, count);
            }
            catch (AggregateException error)
            {
                // Mono's TLS wraps the loss of a connection in one.
                throw new IOException(error.GetBaseException().Message, error);
            }
        }

        public void Write(byte[] body)
        {
            if (frame.Length < 4 + body.Length) frame = new byte[4 + body.Length];
            for (int i = 0; i < 4; ++i) frame[i] = (byte)(body.Length >> 8 * i);
            Buffer.BlockCopy(body, 0, frame, 4, body.Length);
            stream.Write(frame, 0, 4 + body.Length);
        }

        public void Close()
        {
            try
            {
                socket.Shutdown(SocketShutdown.Both); // wakes a read under way
            }
            catch (Exception error) when (error is SocketException || error is ObjectDisposedException)
            {
                // It is gone already.
            }
            socket.Close();
        }
    }
}
