using System;
using System.Collections.Generic;

/// <summary>What a test says when it fails.</summary>
public sealed class Failure : Exception
{
    public Failure(string text) : base(text) { }
}

public static class Check
{
    public static void That(bool condition, string what)
    {
        if (!condition) throw new Failure(what);
    }

    public static void Equal<T>(T found, T expected, string what)
    {
        if (!EqualityComparer<T>.Default.Equals(found, expected)) throw new Failure(what + ": found " + found + ", expected " + expected);
    }

    public static void Near(double found, double expected, double tolerance, string what)
    {
        if (!(Math.Abs(found - expected) <= tolerance)) throw new Failure(what + ": found " + found + ", expected " + expected);
    }

    public static void Throws<T>(Action action, string what) where T : Exception
    {
        try
        {
            action();
        }
        catch (T)
        {
            return;
        }
        throw new Failure(what + ": nothing was thrown");
    }
}
