#!/usr/bin/env python3
"""Renders what standard input says with the Python client's ContactRenderer, for comparison.

Lines: "take NS" followed by nothing (no tissue) or by POINT NORMAL STIFFNESS DAMPING RESISTANCE FRICTION VALID_NS PENETRATED;
"render NS X Y Z". For each of the latter prints the force."""

import importlib.util
import pathlib
import sys
from types import SimpleNamespace

PATH = pathlib.Path(__file__).resolve().parents[2] / "client/python/incise_client/contact.py"
spec = importlib.util.spec_from_file_location("contact", PATH)
contact = importlib.util.module_from_spec(spec)
spec.loader.exec_module(contact)


def vector(numbers):
    x, y, z = numbers
    return SimpleNamespace(X=lambda: x, Y=lambda: y, Z=lambda: z)


def force(numbers):
    if not numbers:
        return SimpleNamespace(Contact=lambda: None)
    names = ("StiffnessNPerM", "DampingNSPerM", "CuttingResistanceN", "FrictionNSPerM", "ValidForNs", "Penetrated")
    plane = SimpleNamespace(Point=lambda: vector(numbers[:3]), Normal=lambda: vector(numbers[3:6]),
                            **{name: lambda value=value: value for name, value in zip(names, numbers[6:])})
    return SimpleNamespace(Contact=lambda: plane)


renderer = contact.ContactRenderer()
for line in sys.stdin:
    verb, ns, *rest = line.split()
    values = [float(word) for word in rest]
    if verb == "take":
        renderer.take(force(values), int(ns))
    else:
        print(*(repr(float(x)) for x in renderer.force(values, int(ns))))
