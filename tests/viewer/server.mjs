// incised and a browser, run by a test.

import { spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { existsSync, mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";

const require = createRequire(new URL("../../client/viewer/package.json", import.meta.url));
const { chromium } = require("playwright-core");

export const bin = process.env.INCISE_BIN_DIR ?? new URL("../../build/release/bin", import.meta.url).pathname;
export const screenshots = process.env.INCISE_SCREENSHOT_DIR ?? join(tmpdir(), "incise_screenshots");
mkdirSync(screenshots, { recursive: true });

export const wait_ms = 90_000; // generous: the machine may be busy with other things

export class Server {
  /** `config`: what differs from the tests' usual configuration. */
  constructor(config = {}) {
    this.directory = mkdtempSync(join(tmpdir(), "incise_viewer_"));
    this.config = {
      mesh: { phantom: "liver", target_tets: 8000 },
      blade: { heel: [0, 0, 0], tip: [0, 0, -0.12] },
      capture: { path: "session.capture" },
      loop: { rate_hz: 250, realtime_priority: 0, lock_memory: false },
      log: { level: "warning" },
      ...config,
    };
    this.ports = { tcp_port: 0, http_port: 0 };
  }

  async start(...more) {
    this.file("server.json", JSON.stringify({ ...this.config, listen: { ...this.config.listen, ...this.ports } }));
    this.process = spawn(join(bin, "incised"), ["--config", join(this.directory, "server.json"), ...more], {
      stdio: ["ignore", "pipe", "inherit"],
    });
    for await (const line of createInterface({ input: this.process.stdout })) {
      const ports = /^listening tcp=[^:]*:(\d+) http=[^:]*:(\d+)/.exec(line);
      if (!ports) continue;
      this.ports = { tcp_port: Number(ports[1]), http_port: Number(ports[2]) }; // the same after a restart
      this.url = `http://127.0.0.1:${ports[2]}/`;
      return this;
    }
    throw new Error("incised ended before it listened");
  }

  async stop(signal = "SIGTERM") {
    if (!this.process || this.process.exitCode !== null || this.process.signalCode !== null) return;
    const ended = once(this.process, "exit");
    this.process.kill(signal);
    this.process.kill("SIGCONT"); // a test may have frozen it
    await ended;
  }

  async end() {
    await this.stop();
    rmSync(this.directory, { recursive: true, force: true });
  }

  file(name, content) {
    const path = join(this.directory, name);
    if (content !== undefined) writeFileSync(path, content);
    return path;
  }

  incise(...args) {
    const done = spawnSync(join(bin, "incise"), args.map(String), { encoding: "utf8" });
    if (done.status !== 0) throw new Error(`incise ${args.join(" ")}: ${done.stderr || done.error}`);
    return done.stdout;
  }

  /** Streams straight passes of the blade through the body at these places along x, at `speed` times one second each. */
  stream(places, { depth_m = 0.07, speed = 4, lines = 60 } = {}) {
    const passes = places.map((x) => [
      [x, -0.12, depth_m],
      [x, 0.12, depth_m],
    ]);
    return this.streamPasses(passes, { speed, lines });
  }

  /** Streams the blade, which points down, along straight lines: [from, to] each. `more`: further options of incise stream. */
  streamPasses(passes, { speed = 4, lines = 60, more = [] } = {}) {
    const rows = ["t_s,x_m,y_m,z_m,qw,qx,qy,qz,button"];
    passes.forEach(([from, to], pass) => {
      for (let i = 0; i <= lines; ++i) {
        const at = from.map((a, k) => a + ((to[k] - a) * i) / lines);
        rows.push([pass * 2 + i / lines, ...at, 1, 0, 0, 0, i < lines ? 1 : 0].join());
      }
    });
    const motion = this.file("motion.csv", `${rows.join("\n")}\n`);
    for (let tries = 10; ; --tries) {
      try {
        return this.incise("stream", motion, "--to", `127.0.0.1:${this.ports.tcp_port}`, "--speed", speed, ...more);
      } catch (error) {
        // It waits for a few seconds only, which a busy machine may take to answer.
        if (tries === 0 || !String(error).includes("no answer in time")) throw error;
      }
    }
  }

  async stats() {
    return (await fetch(`${this.url}stats`)).json();
  }
}

/** flags: further ones of Chromium's. */
export async function launch(...flags) {
  const executablePath = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(existsSync);
  if (!executablePath) throw new Error("no Chromium; ./dev test installs it (section test of config/packages.txt)");
  return chromium.launch({
    executablePath,
    // Software GL, wherever the tests run; Chromium's own sandbox refuses to run as root.
    args: [
      "--use-gl=angle",
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
      ...(process.getuid() === 0 ? ["--no-sandbox"] : []),
      ...flags,
    ],
  });
}

/** A page that shows a state. `faults` collects the errors and warnings of its console; end it with close(). */
export async function openPage(
  browser,
  url,
  { width = 800, height = 560, colorScheme = "dark", hasTouch = false, ...more } = {},
) {
  const context = await browser.newContext({
    viewport: { width, height },
    colorScheme,
    hasTouch,
    reducedMotion: "reduce",
    ...more,
  });
  const page = await context.newPage();
  page.setDefaultTimeout(wait_ms);
  const faults = [];
  page.on("console", (message) => {
    if (message.type() !== "error" && message.type() !== "warning") return;
    // The browser reports a server that is away, and the driver what costs it time, such as screenshots.
    if (/WebSocket connection|ERR_CONNECTION_REFUSED|GL Driver Message \(OpenGL, Performance/.test(message.text()))
      return;
    faults.push(message.text());
  });
  page.on("pageerror", (error) => faults.push(String(error)));
  await page.goto(url);
  await page.waitForFunction(() => window.incise?.progress);
  return { page, faults, close: () => context.close() };
}

export const progress = (page) => page.evaluate(() => window.incise.progress);

export async function until(page, condition, argument) {
  await page.waitForFunction(condition, argument, { polling: 50 });
}
