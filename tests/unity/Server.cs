using System;
using System.Diagnostics;
using System.IO;
using System.Net;
using System.Net.Sockets;
using System.Threading;

/// <summary>An incised on a port of its own, with a capture to resume from.</summary>
public sealed class Server : IDisposable
{
    public static string Programs; // the folder that has incised

    private readonly string folder = Path.Combine(Path.GetTempPath(), "incise_unity_" + Guid.NewGuid().ToString("N"));
    private Process process;
    public readonly int Port;
    public int HttpPort;

    /// <summary>No motor is driven here, so a pause of a busy machine need not end a force. surface: the text of an .obj to fill; null: the phantom.</summary>
    public Server(bool capture = false, int tets = 4000, bool tls = false, string surface = null)
    {
        var probe = new TcpListener(IPAddress.Loopback, 0);
        probe.Start();
        Port = ((IPEndPoint)probe.LocalEndpoint).Port;
        probe.Stop();
        Directory.CreateDirectory(folder);
        string secret = tls ? MakeCertificate() : "";
        if (surface != null) File.WriteAllText(Path.Combine(folder, "body.obj"), surface);
        string body = surface != null ? @"""path"": ""body.obj""" : @"""phantom"": ""liver""";
        File.WriteAllText(Path.Combine(folder, "session.json"), @"{
  ""mesh"": {" + body + @", ""target_tets"": " + tets + @"},
  ""blade"": {""heel"": [0, 0, 0], ""tip"": [0, 0, -0.12]},
  ""haptics"": {""silence_s"": 0.25},
  ""capture"": {""path"": """ + (capture ? "session.capture" : "") + @"""},
  ""listen"": {""tcp_port"": " + Port + @", ""http_port"": 0" + secret + @"},
  ""loop"": {""realtime_priority"": 0, ""lock_memory"": false},
  ""log"": {""level"": ""error""}
}");
        Start(false);
    }

    /// <summary>A certificate that no authority has signed, for this server's configuration.</summary>
    private string MakeCertificate()
    {
        string key = Path.Combine(folder, "key.pem"), certificate = Path.Combine(folder, "certificate.pem");
        using (Process openssl = Process.Start(new ProcessStartInfo("openssl", "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=incise.test -keyout " +
            key + " -out " + certificate) { UseShellExecute = false, RedirectStandardError = true }))
        {
            openssl.StandardError.ReadToEnd();
            openssl.WaitForExit();
        }
        return @", ""certificate_file"": """ + certificate + @""", ""private_key_file"": """ + key + @"""";
    }

    public void Start(bool resume)
    {
        string config = Path.Combine(folder, "session.json");
        process = Run(Path.Combine(Programs, "incised"), "--config " + config + (resume ? " --resume" : ""));
        string line;
        while ((line = process.StandardOutput.ReadLine()) != null)
        {
            if (!line.StartsWith("listening ")) continue;
            foreach (string word in line.Split(' '))
                if (word.StartsWith("http=")) int.TryParse(word.Substring(word.LastIndexOf(':') + 1), out HttpPort);
            // What it prints later is read, so that it never waits for us.
            StreamReader output = process.StandardOutput;
            new Thread(() => Drain(output)) { IsBackground = true }.Start();
            return;
        }
        throw new Failure("incised opened no port");
    }

    private static void Drain(StreamReader output)
    {
        try
        {
            while (output.ReadLine() != null) { }
        }
        catch (Exception)
        {
            // Killed.
        }
    }

    /// <summary>Another program.</summary>
    public static Process Run(string program, string arguments)
    {
        return Process.Start(new ProcessStartInfo(program, arguments) { UseShellExecute = false, RedirectStandardOutput = true });
    }

    /// <summary>As a crash does.</summary>
    public void Kill()
    {
        process.Kill();
        process.WaitForExit();
        process.Dispose();
        process = null;
    }

    public void Dispose()
    {
        if (process != null) Kill();
        Directory.Delete(folder, true);
    }
}
