#!/usr/bin/env python3
"""Makes the .meta files that are missing in client/unity: Unity imports nothing without one from a package it may not change."""

import hashlib
import pathlib

ROOT = pathlib.Path(__file__).resolve().parents[2] / "client/unity"

for path in sorted(ROOT.rglob("*")):
    meta = path.with_name(path.name + ".meta")
    if path.suffix == ".meta" or path.name == "Samples~" or meta.exists():
        continue
    guid = hashlib.md5(f"com.incise.client/{path.relative_to(ROOT)}".encode()).hexdigest()
    meta.write_text(f"fileFormatVersion: 2\nguid: {guid}\n" + ("folderAsset: yes\n" if path.is_dir() else ""))
    print(meta.relative_to(ROOT))
