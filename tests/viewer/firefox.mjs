// Firefox on a display of its own, driven by WebDriver BiDi (https://w3c.github.io/webdriver-bidi): Playwright drives only its own build of it.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { wait_ms } from "./server.mjs";

const require = createRequire(new URL("../../client/viewer/package.json", import.meta.url));
const WebSocket = require("ws");

/** The first line of a stream that matches. */
async function lineOf(stream, pattern, what) {
  for await (const line of createInterface({ input: stream })) {
    const found = pattern.exec(line);
    if (found) return found[1];
  }
  throw new Error(`${what} ended before it was ready; ./dev test installs it (section test of config/packages.txt)`);
}

async function end(process) {
  if (!process || process.exitCode !== null || process.signalCode !== null) return;
  const ended = once(process, "exit");
  process.kill();
  await ended;
}

export class Firefox {
  faults = []; // errors and warnings of the page
  #answers = new Map();
  #last = 0;

  /** A window of this size; end it with close(). */
  static async launch(width, height) {
    const firefox = new Firefox();
    try {
      await firefox.#begin(width, height);
    } catch (error) {
      await firefox.close();
      throw error;
    }
    return firefox;
  }

  async #begin(width, height) {
    this.profile = mkdtempSync(join(tmpdir(), "incise_firefox_"));
    const prefs = {
      "datareporting.policy.dataSubmissionEnabled": false,
      "app.update.auto": false,
      "ui.prefersReducedMotion": 1,
    };
    const lines = Object.entries(prefs).map(([name, value]) => `user_pref(${JSON.stringify(name)}, ${value});`);
    writeFileSync(join(this.profile, "user.js"), lines.join("\n"));
    const screen = ["-screen", "0", `${width}x${height + 200}x24`, "-nolisten", "tcp"];
    this.display = spawn("Xvfb", ["-displayfd", "1", ...screen], { stdio: ["ignore", "pipe", "ignore"] });
    this.display.on("error", () => {}); // lineOf() says so
    const display = await lineOf(this.display.stdout, /^(\d+)$/, "Xvfb");
    // Mesa draws on the processor, wherever the tests run.
    const env = { ...process.env, DISPLAY: `:${display}`, LIBGL_ALWAYS_SOFTWARE: "1", MOZ_ENABLE_WAYLAND: "0" };
    this.process = spawn("firefox-esr", ["--profile", this.profile, "--no-remote", "--remote-debugging-port", "0"], {
      env,
      stdio: ["ignore", "ignore", "pipe"],
    });
    this.process.on("error", () => {});
    const url = await lineOf(this.process.stderr, /WebDriver BiDi listening on (ws:\S+)/, "firefox-esr");
    this.process.stderr.resume();
    this.socket = new WebSocket(`${url}/session`, { maxPayload: 1 << 28 });
    this.socket.on("message", (data) => this.#take(JSON.parse(data)));
    await once(this.socket, "open");
    await this.#ask("session.new", { capabilities: {} });
    await this.#ask("session.subscribe", { events: ["log.entryAdded"] });
    this.context = (await this.#ask("browsingContext.getTree", {})).contexts[0].context;
    await this.#ask("browsingContext.setViewport", { context: this.context, viewport: { width, height } });
  }

  async close() {
    this.socket?.terminate();
    await end(this.process);
    await end(this.display);
    if (this.profile) rmSync(this.profile, { recursive: true, force: true, maxRetries: 5 });
  }

  goto(url) {
    return this.#ask("browsingContext.navigate", { context: this.context, url, wait: "complete" });
  }

  /** What this function, which stands alone, returns in the page; JSON. */
  async evaluate(what, argument) {
    const expression = `(async () => JSON.stringify((await (${what})(${JSON.stringify(argument ?? null)})) ?? null))()`;
    const target = { context: this.context };
    const { result, exceptionDetails } = await this.#ask("script.evaluate", { expression, target, awaitPromise: true });
    if (exceptionDetails) throw new Error(exceptionDetails.text);
    return JSON.parse(result.value);
  }

  async until(condition, argument) {
    for (const begin = Date.now(); !(await this.evaluate(condition, argument)); ) {
      if (Date.now() - begin > wait_ms) throw new Error(`in vain: ${condition}`);
      await new Promise((done) => setTimeout(done, 50));
    }
  }

  /** Drags the mouse, in pixels of the page. */
  async drag(from, to, steps = 30) {
    const at = (share) => [0, 1].map((k) => Math.round(from[k] + share * (to[k] - from[k])));
    const move = (share) => ({ type: "pointerMove", x: at(share)[0], y: at(share)[1], duration: 16 });
    const moves = Array.from({ length: steps }, (_, i) => move((i + 1) / steps));
    const actions = [move(0), { type: "pointerDown", button: 0 }, ...moves, { type: "pointerUp", button: 0 }];
    const mouse = { type: "pointer", id: "mouse", parameters: { pointerType: "mouse" }, actions };
    await this.#ask("input.performActions", { context: this.context, actions: [mouse] });
  }

  async press(key) {
    const actions = ["keyDown", "keyUp"].map((type) => ({ type, value: key }));
    await this.#ask("input.performActions", { context: this.context, actions: [{ type: "key", id: "keys", actions }] });
  }

  async screenshot(path) {
    const { data } = await this.#ask("browsingContext.captureScreenshot", { context: this.context });
    writeFileSync(path, Buffer.from(data, "base64"));
  }

  #ask(method, params) {
    const id = ++this.#last;
    return new Promise((resolve, reject) => {
      this.#answers.set(id, { resolve, reject });
      this.socket.send(JSON.stringify({ id, method, params }));
    });
  }

  #take(message) {
    if (message.method === "log.entryAdded") {
      const { level, text } = message.params;
      // What it says of every page that draws in software, and of screenshots.
      if (["error", "warn"].includes(level) && !/^WebGL warning|GPU stall|willReadFrequently/.test(text ?? ""))
        this.faults.push(text);
    }
    const answer = this.#answers.get(message.id);
    this.#answers.delete(message.id);
    if (message.type === "error") answer?.reject(new Error(`${message.error}: ${message.message}`));
    else answer?.resolve(message.result);
  }
}
