using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using System.Reflection;
using System.Text;
using Incise;

/// <summary>Reads JSON into dictionaries, lists, texts, bools and Numbers, and compares it with our messages.</summary>
public sealed class Json
{
    /// <summary>A number as it was written: 64 bits do not fit a double.</summary>
    public struct Number
    {
        public string Text;
    }

    private readonly string text;
    private int at;

    private Json(string text)
    {
        this.text = text;
    }

    public static object Parse(string text)
    {
        return new Json(text).Value();
    }

    private object Value()
    {
        switch (Next())
        {
            case '{': return Object();
            case '[': return List();
            case '"': return Text();
            case 't':
                at += 4;
                return true;
            case 'f':
                at += 5;
                return false;
            case 'n':
                at += 4;
                return null;
            default:
                int from = at;
                while (at < text.Length && "+-.eE0123456789".IndexOf(text[at]) >= 0) ++at;
                if (at == from) throw new FormatException("JSON at " + at);
                return new Number { Text = text.Substring(from, at - from) };
        }
    }

    private char Next()
    {
        while (char.IsWhiteSpace(text[at])) ++at;
        return text[at];
    }

    private Dictionary<string, object> Object()
    {
        var found = new Dictionary<string, object>();
        for (++at; Next() != '}';)
        {
            string key = Text();
            Next();
            ++at; // the colon
            found[key] = Value();
            if (Next() == ',') ++at;
        }
        ++at;
        return found;
    }

    private List<object> List()
    {
        var found = new List<object>();
        for (++at; Next() != ']';)
        {
            found.Add(Value());
            if (Next() == ',') ++at;
        }
        ++at;
        return found;
    }

    private string Text()
    {
        Next();
        var found = new StringBuilder();
        for (++at; text[at] != '"'; ++at)
        {
            if (text[at] == '\\') ++at;
            found.Append(text[at]);
        }
        ++at;
        return found.ToString();
    }

    // ---- Messages ----

    /// <summary>The field of our class that has the schema's name: engaged_length_m is EngagedLengthM.</summary>
    private static FieldInfo Field(Type type, string name)
    {
        var pascal = new StringBuilder();
        foreach (string word in name.Split('_')) pascal.Append(char.ToUpperInvariant(word[0])).Append(word.Substring(1));
        FieldInfo field = type.GetField(pascal.ToString());
        if (field == null) throw new Failure(type.Name + " has no " + pascal);
        return field;
    }

    /// <summary>Everything that the JSON has is in the value, to the JSON's digits.</summary>
    public static void CheckEqual(object value, object json, string where)
    {
        if (json is Dictionary<string, object> fields)
        {
            Check.That(value != null, where + " is absent");
            foreach (var pair in fields)
                if (pair.Key != "reserved") CheckEqual(Field(value.GetType(), pair.Key).GetValue(value), pair.Value, where + "." + pair.Key);
        }
        else if (json is List<object> list)
        {
            var array = (IList)value;
            Check.Equal(array.Count, list.Count, where + ": entries");
            for (int i = 0; i < list.Count; ++i) CheckEqual(array[i], list[i], where + "[" + i + "]");
        }
        else if (json is Number number)
        {
            if (value is double || value is float)
            {
                double expected = double.Parse(number.Text, CultureInfo.InvariantCulture);
                Check.Near(Convert.ToDouble(value), expected, (value is float ? 1e-6 : 1e-11) * (1 + Math.Abs(expected)), where);
            }
            else
            {
                Check.Equal(Convert.ToString(value, CultureInfo.InvariantCulture), number.Text, where);
            }
        }
        else
        {
            Check.Equal(value is bool ? value : value.ToString(), json, where);
        }
    }

    /// <summary>An object of the type with the fields that the JSON has.</summary>
    public static object Make(Type type, object json)
    {
        if (json is Dictionary<string, object> fields)
        {
            object made = type == typeof(Box) ? new Box(new Vec3(), new Vec3())
                : type == typeof(BladeEdge) ? new BladeEdge(new Vec3(), new Vec3()) : Activator.CreateInstance(type);
            foreach (var pair in fields)
            {
                if (pair.Key == "reserved") continue;
                FieldInfo field = Field(type, pair.Key);
                field.SetValue(made, Make(field.FieldType, pair.Value));
            }
            return made;
        }
        if (json is List<object> list)
        {
            Array array = Array.CreateInstance(type.GetElementType(), list.Count);
            for (int i = 0; i < list.Count; ++i) array.SetValue(Make(type.GetElementType(), list[i]), i);
            return array;
        }
        if (type.IsEnum) return Enum.Parse(type, (string)json);
        if (type == typeof(double) && ((Number)json).Text == "-0.0") return BitConverter.Int64BitsToDouble(long.MinValue); // Mono reads 0
        return json is Number number ? Convert.ChangeType(number.Text, type, CultureInfo.InvariantCulture) : json;
    }
}
