// Figures of the page, in a headless Chromium without a graphics card, on the demo's mesh:
//
//   node tests/viewer/bench.mjs turn            pictures a second and processor time of each, while the body turns
//   node tests/viewer/bench.mjs first           from the address to the first picture with the body in it, new browsers
//   node tests/viewer/bench.mjs long [MINUTES]  MINUTES (10) of streamed cutting: memory, then page against .vtu export
//
// Programs and page are those of build/release, or of INCISE_BIN_DIR. The last ends with 1 where triangles differ.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { readdirSync, readFileSync } from "node:fs";
import { loadavg } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { bin, launch, openPage, Server, until } from "./server.mjs";
import { boundaryOfVtu, canonical } from "./triangles.mjs";

const root = fileURLToPath(new URL("../../", import.meta.url));
const kPassesOnOneBody = 20;
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const MB = (bytes) => (bytes / 1e6).toFixed(1);

/** Processor time and resident memory of the browser's processes that run now, by what they are. */
function processes() {
  const children = new Map();
  for (const pid of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      const stat = readFileSync(`/proc/${pid}/stat`, "utf8");
      const fields = stat.slice(stat.lastIndexOf(")") + 2).split(" ");
      const kind = /--type=([\w-]+)/.exec(readFileSync(`/proc/${pid}/cmdline`, "utf8"))?.[1] ?? "browser";
      children.set(fields[1], [
        ...(children.get(fields[1]) ?? []),
        { pid, kind, cpu_ms: 10 * (Number(fields[11]) + Number(fields[12])), rss: 4096 * Number(fields[21]) },
      ]);
    } catch {
      // It has ended.
    }
  }
  const sums = {};
  const walk = (pid) => {
    for (const child of children.get(String(pid)) ?? []) {
      const sum = (sums[child.kind] ??= { cpu_ms: 0, rss: 0 });
      sum.cpu_ms += child.cpu_ms;
      sum.rss += child.rss;
      walk(child.pid);
    }
  };
  walk(process.pid);
  return sums;
}

async function turn(browser, server) {
  const { page } = await openPage(browser, server.url, { width: 1280, height: 720 });
  await until(page, () => window.incise.stage.atRest);
  await page.evaluate(() => {
    window.gaps = [];
    let last = performance.now();
    const step = (now) => {
      window.gaps.push(now - last);
      last = now;
      window.incise.stage.turn(0.3, 0);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  });
  const read = () => page.evaluate(() => ({ now: performance.now(), drawn: window.incise.stage.framesDrawn }));
  await pause(2500); // until it has found its scale
  await page.evaluate(() => (window.gaps = []));
  const before = processes(),
    from = await read();
  await pause(8000);
  const after = processes(),
    to = await read();
  const drawn = to.drawn - from.drawn;
  const { p50, p95, pixels } = await page.evaluate(() => {
    const gaps = window.gaps.sort((a, b) => a - b);
    const gl = window.incise.stage.renderer.getContext();
    return {
      p50: gaps[gaps.length >> 1],
      p95: gaps[Math.floor(0.95 * gaps.length)],
      pixels: `${gl.drawingBufferWidth} x ${gl.drawingBufferHeight}`,
    };
  });
  const cpu = Object.keys(after)
    .filter((kind) => /gpu|renderer/.test(kind))
    .map((kind) => `${kind} ${((after[kind].cpu_ms - before[kind].cpu_ms) / drawn).toFixed(1)} ms`)
    .join(", ");
  console.log(
    `turning, 1280 x 720: ${((1000 * drawn) / (to.now - from.now)).toFixed(1)} pictures/s at ${pixels}, frame p50 ${p50.toFixed(1)} p95 ${p95.toFixed(1)} ms; a picture: ${cpu}; load ${loadavg()[0].toFixed(1)}`,
  );
}

/** A new browser each time: in a used one the first page's drawing keeps the GPU process busy, which the next would pay for. */
async function first(_, server) {
  const times = [];
  for (let n = 0; n < 7; ++n) {
    const browser = await launch();
    const page = await (await browser.newContext({ viewport: { width: 1280, height: 720 } })).newPage();
    await page.addInitScript(() => {
      const look = () => {
        const stage = window.incise?.stage;
        // What was drawn before this frame is on the screen now.
        if (window.drawnAt === undefined && stage?.body.mesh.visible && stage.framesDrawn > window.framesBefore)
          window.drawnAt = performance.now();
        window.framesBefore = stage?.body.mesh.visible
          ? Math.min(window.framesBefore ?? Infinity, stage.framesDrawn)
          : Infinity;
        requestAnimationFrame(look);
      };
      requestAnimationFrame(look);
    });
    await page.goto(server.url);
    await until(page, () => window.drawnAt !== undefined);
    times.push(await page.evaluate(() => window.drawnAt));
    await browser.close();
  }
  times.sort((a, b) => a - b);
  console.log(
    `first picture after ${times.map((ms) => (ms / 1000).toFixed(2)).join(" ")} s; load ${loadavg()[0].toFixed(1)}`,
  );
}

/** One pass of the demo's motion at four times its speed, and the time that its work takes. */
async function pass(server) {
  const stream = spawn(
    join(bin, "incise"),
    ["stream", join(root, "config/demo_motion.csv"), "--to", `127.0.0.1:${server.ports.tcp_port}`, "--speed", "4"],
    { stdio: ["ignore", "ignore", "inherit"] },
  );
  await once(stream, "exit");
  while ((await server.stats()).backlog.segments > 0) await pause(100);
}

async function long(browser, server, minutes) {
  const { page, faults } = await openPage(browser, server.url);
  const cdp = await page.context().newCDPSession(page);
  await until(page, () => window.incise.stage.atRest);
  const began = Date.now();
  const report = async () => {
    await cdp.send("HeapProfiler.collectGarbage");
    const heap = (await cdp.send("Runtime.getHeapUsage")).usedSize;
    const { renderer, "gpu-process": gpu } = processes();
    const state = await page.evaluate(() => ({
      ...window.incise.progress,
      pictures: window.incise.stage.framesDrawn,
      memory: performance.memory.usedJSHeapSize,
    }));
    console.log(
      `${((Date.now() - began) / 1000).toFixed(0)} s: ${state.deltas} deltas, revision ${state.revision}, ${state.triangles} triangles, ${state.pieces} pieces, ` +
        `${state.pictures} pictures; page's heap ${MB(heap)} MB (performance.memory ${MB(state.memory)}), renderer ${MB(renderer.rss)} MB, GPU process ${MB(gpu.rss)} MB, ` +
        `hash ${state.hashAgrees ? "agrees" : "DIFFERS"}, ${faults.length} faults`,
    );
  };
  // A fresh body now and then: what is cut again and again in the same places is soon minced.
  for (let passes = 0, told = 0; Date.now() - began < minutes * 60_000; ++passes) {
    if (passes > 0 && passes % kPassesOnOneBody === 0) {
      await page.evaluate(() => window.incise.send({ kind: "reset" }));
      await until(page, () => window.incise.progress.revision === 0);
    }
    await pass(server);
    if (Date.now() - told < 30_000) continue;
    told = Date.now();
    await report();
  }
  const { revision } = await server.stats();
  await until(page, (r) => window.incise.progress.revision === r, revision);
  await report();
  const shown = await page.evaluate(async () => Array.from(await window.incise.dump()));
  await server.stop();
  server.incise("export", server.file("session.capture"), "--out", server.file("end.vtu"));
  const there = canonical(boundaryOfVtu(server.file("end.vtu"))),
    here = canonical(Float32Array.from(shown));
  const differ = here.length !== there.length || here.some((triangle, i) => triangle !== there[i]);
  console.log(
    `page ${here.length} triangles, .vtu ${there.length}: ${differ ? "THEY DIFFER" : "the same, triangle for triangle"}`,
  );
  if (differ || faults.length > 0) process.exitCode = 1;
}

const [command, minutes = "10"] = process.argv.slice(2);
if (!["turn", "first", "long"].includes(command) || !(Number(minutes) > 0)) {
  console.error("usage: node tests/viewer/bench.mjs turn | first | long [MINUTES]");
  process.exit(2);
}
const server = new Server({
  mesh: { phantom: "liver", target_tets: 60000 },
  loop: { rate_hz: 1000, realtime_priority: 0, lock_memory: false },
});
await server.start();
const browser = await launch();
try {
  await { turn, first, long }[command](browser, server, Number(minutes));
} finally {
  await browser.close();
  await server.end();
}
