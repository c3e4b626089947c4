// What the tests of the page share: a browser, servers and pages that end with their test, and hands.

import { join } from "node:path";
import { after, before } from "node:test";
import { launch, openPage, screenshots, Server, until } from "./server.mjs";

let browser;
before(async () => (browser = await launch()));
after(async () => browser?.close());

export const theBrowser = () => browser;

export async function serve(t, config, ...args) {
  const server = new Server(config);
  t.after(() => server.end());
  await server.start(...args);
  return server;
}

export async function look(t, url, options) {
  const opened = await openPage(browser, url, options);
  t.after(() => opened.close());
  return opened;
}

export const shot = (page, name) => page.screenshot({ path: join(screenshots, `${name}.png`) });

/** Drags across the picture, in shares of its free part. */
export async function drag(page, from, to, steps = 30) {
  const free = await page.evaluate(() => {
    const { left, right, top, bottom } = window.incise.stage.cover;
    return { x: left, y: top, width: innerWidth - left - right, height: innerHeight - top - bottom };
  });
  const at = (p) => [free.x + p[0] * free.width, free.y + p[1] * free.height];
  await page.mouse.move(...at(from));
  await page.mouse.down();
  for (let i = 1; i <= steps; ++i) {
    await page.mouse.move(...at([0, 1].map((k) => from[k] + ((to[k] - from[k]) * i) / steps)));
    await page.waitForTimeout(8);
  }
  await page.mouse.up();
}

export const bladeIsReady = (page) => until(page, () => document.body.dataset.blade === "open");
export const atRevision = (page, revision) => until(page, (r) => window.incise.progress.revision === r, revision);
export const strokeIsOver = (page) =>
  until(page, () => window.incise.progress.revision > 0 && !document.body.dataset.stroke);
/** Everything that the page says at the top right now. */
export const notices = (page) =>
  page.evaluate(() => [...document.querySelectorAll(".notice p")].map((p) => p.textContent));
