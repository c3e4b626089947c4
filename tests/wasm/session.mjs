// A session in Node, as the tests of the module and its measurement use it.

import { execFileSync } from "node:child_process";
import { webcrypto } from "node:crypto";
import { mkdirSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { load } from "../viewer/unit/modules.mjs";

// A global of pages; Node.js has it since 19, and Debian 12 has 18.
globalThis.crypto ??= webcrypto;

const build = new URL("../../build/release/", import.meta.url).pathname;
export const bin = process.env.INCISE_BIN_DIR ?? join(build, "bin");
export const wasmDirectory = process.env.INCISE_WASM_DIR ?? join(build, "wasm");
export const root = new URL("../../", import.meta.url).pathname;

const { WasmSession } = await load("wasm_session");
const module = new WebAssembly.Module(readFileSync(join(wasmDirectory, "incise.wasm")));

export function incise(...args) {
  return execFileSync(join(bin, "incise"), args.map(String), { encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });
}

/** A folder that ends with the process. */
export const directory = mkdtempSync(join(tmpdir(), "incise_wasm_"));
process.on("exit", () => rmSync(directory, { recursive: true, force: true }));

let folders = 0;
/** The files of a page's session with the body and the configuration of a capture. */
export function sessionFiles(capture) {
  const folder = join(directory, `session${++folders}`);
  mkdirSync(folder);
  execFileSync(join(bin, "incise-static-body"), [capture, folder]);
  return { header: readFileSync(join(folder, "header.capture")), body: readFileSync(join(folder, "body.bin")) };
}

/** A session with the body and the configuration of a capture. */
export function sessionOf(capture, events = {}) {
  const session = new WasmSession(module, { send() {}, close() {}, fetchCapture() {}, ...events });
  const { header, body } = sessionFiles(capture);
  session.begin(header, body);
  return session;
}
export const emptySession = () => new WasmSession(module, { send() {}, close() {}, fetchCapture() {} });
