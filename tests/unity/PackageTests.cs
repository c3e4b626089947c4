using System.Collections.Generic;
using System.IO;
using System.Text.RegularExpressions;

/// <summary>The package's files. Unity passes over a file without a .meta in a package that it may not change.</summary>
public static class PackageTests
{
    public static void EveryFileHasItsMeta()
    {
        string root = Path.Combine(Vectors.Source, "client", "unity");
        var guids = new HashSet<string>();
        int files = 0;
        foreach (string path in Directory.GetFileSystemEntries(root, "*", SearchOption.AllDirectories))
        {
            string name = path.Substring(root.Length + 1);
            if (name.EndsWith(".meta"))
            {
                string target = path.Substring(0, path.Length - 5);
                Check.That(File.Exists(target) || Directory.Exists(target), name + " belongs to nothing");
                Match guid = Regex.Match(File.ReadAllText(path), "^fileFormatVersion: 2\nguid: ([0-9a-f]{32})\n");
                Check.That(guid.Success && guids.Add(guid.Groups[1].Value), name + " has no guid of its own");
            }
            else if (name != "Samples~")
            {
                Check.That(File.Exists(path + ".meta"), name + " has no .meta; tests/unity/make_meta.py makes it");
                ++files;
            }
        }
        Check.That(files > 30, "files: " + files);
    }

    public static void ThePackageIsOfThisVersion()
    {
        string cmake = File.ReadAllText(Path.Combine(Vectors.Source, "CMakeLists.txt"));
        string version = Regex.Match(cmake, @"project\(incise VERSION ([\d.]+)").Groups[1].Value;
        var package = Vectors.Map(Json.Parse(File.ReadAllText(Path.Combine(Vectors.Source, "client", "unity", "package.json"))));
        Check.Equal((string)package["version"], version, "version");
        foreach (object sample in (List<object>)package["samples"])
            Check.That(Directory.Exists(Path.Combine(Vectors.Source, "client", "unity", (string)Vectors.Map(sample)["path"])), "a sample");
    }
}
