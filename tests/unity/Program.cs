using System;
using System.Diagnostics;
using System.Reflection;

/// <summary>The package's tests: SOURCE PROGRAMS [--rounds N] [--only TEXT].</summary>
public static class Program
{
    private static readonly Type[] Suites = { typeof(PackageTests), typeof(VectorTests), typeof(FrameTests), typeof(ServerTests), typeof(SimulatorTests),
        typeof(EngineTests) };

    public static int Rounds = 30; // of chaos

    public static int Main(string[] arguments)
    {
        if (arguments.Length < 2)
        {
            Console.Error.WriteLine("usage: tests SOURCE PROGRAMS [--rounds N] [--only TEXT]");
            return 2;
        }
        Vectors.Source = arguments[0];
        Server.Programs = arguments[1];
        string only = "";
        for (int i = 2; i + 1 < arguments.Length; i += 2)
        {
            if (arguments[i] == "--rounds") Rounds = int.Parse(arguments[i + 1]);
            if (arguments[i] == "--only") only = arguments[i + 1];
        }
        int failed = 0, run = 0;
        foreach (Type suite in Suites)
        {
            foreach (MethodInfo test in suite.GetMethods(BindingFlags.Static | BindingFlags.Public | BindingFlags.DeclaredOnly))
            {
                if (!(suite.Name + "." + test.Name).Contains(only)) continue;
                ++run;
                if (!Run(suite.Name + "." + test.Name, test)) ++failed;
            }
        }
        Console.WriteLine(run + " tests, " + failed + " failed");
        return failed == 0 && run > 0 ? 0 : 1;
    }

    private static bool Run(string name, MethodInfo test)
    {
        Stopwatch clock = Stopwatch.StartNew();
        try
        {
            test.Invoke(null, null);
            Console.WriteLine("passed " + name + " (" + clock.ElapsedMilliseconds + " ms)");
            return true;
        }
        catch (TargetInvocationException error)
        {
            Console.WriteLine("FAILED " + name + ": " + (error.InnerException is Failure ? error.InnerException.Message : error.InnerException.ToString()));
            return false;
        }
    }
}
