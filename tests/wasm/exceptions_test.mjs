// The runtime for C++ exceptions (server/wasm/exceptions.cpp).

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { WASI } from "node:wasi";
import { wasmDirectory } from "./session.mjs";

const module = new WebAssembly.Module(readFileSync(join(wasmDirectory, "throwing.wasm")));
const wasi = new WASI({ version: "preview1" });
const instance = new WebAssembly.Instance(module, { wasi_snapshot_preview1: wasi.wasiImport });
wasi.initialize(instance);
const { memory, text_of, live_objects, throw_out } = instance.exports;

function text(kind) {
  const bytes = new Uint8Array(memory.buffer);
  const at = text_of(kind);
  return Buffer.from(bytes.subarray(at, bytes.indexOf(0, at))).toString();
}

test("each exception reaches the handler for its type, by its base classes too", () => {
  const expected = [
    "nothing",
    "logic_error an argument",
    "int 7",
    "meanwhile an argument, exception with an object",
    "something",
    "other 42",
    "meanwhile an argument, exception a file: No such file or directory",
    "pointer",
  ];
  expected.forEach((what, kind) => {
    assert.equal(text(kind), what);
    assert.equal(live_objects(), 0, `${what}: all is destroyed`);
  });
});

test("what is thrown and caught is freed", () => {
  const round = () => {
    for (let kind = 1; kind < 8; ++kind) text_of(kind);
  };
  for (let i = 0; i < 100; ++i) round();
  const before = memory.buffer.byteLength;
  for (let i = 0; i < 20_000; ++i) round();
  assert.equal(memory.buffer.byteLength, before);
});

test("what nobody catches reaches the caller", () => {
  assert.throws(throw_out, WebAssembly.Exception);
});
