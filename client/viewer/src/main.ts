import { Chart } from "./chart";
import type { BladeStep, Facts, FromWorker, Progress, ReplayFacts, ToWorker } from "./messages";
import type { Colouring } from "./body_mesh";
import { MouseBlade } from "./mouse_blade";
import { bearer, Replay } from "./replay";
import { Stage, type Tool } from "./stage";

const kFiguresEvery_ms = 500;
const kOpenAfterStroke_ms = 300;
const kPosesStale_ms = 1500;
const kNoticeTime_ms = 8000;
const kLongestBlade = 1.5; // times the body's size: from wherever one looks it reaches through
const kNarrow_px = 760; // as in style.css
const kNewBladeAfter_ms = 250; // of a length that stays

const element = <T extends HTMLElement = HTMLElement>(id: string): T => document.getElementById(id) as T;
const input = (id: string) => element<HTMLInputElement>(id);
const number = (x: number, digits = 0) => x.toLocaleString("en", { maximumFractionDigits: digits, minimumFractionDigits: digits });
const touch = matchMedia("(pointer: coarse)");

class Page {
  readonly worker = new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
  readonly stage = new Stage(element<HTMLCanvasElement>("picture"));
  readonly mouse = new MouseBlade(element("picture"), this.stage, {
    poses: (poses) => this.send({ kind: "poses", poses }, [poses.buffer]),
    moved: (heel, tip, cuts) => {
      this.stage.blade(0, true).move(heel, tip, cuts);
      this.stage.draw();
    },
    strokeBegan: () => {
      clearTimeout(this.openTimer);
      this.stage.setOpen(0, true);
      document.body.dataset.stroke = "on";
    },
    strokeEnded: () => {
      delete document.body.dataset.stroke;
      this.stage.blade(0, true).endStroke();
      this.stage.blade(0, true).hide();
      this.openTimer = setTimeout(() => this.stage.setOpen(input("open").valueAsNumber), kOpenAfterStroke_ms);
      this.nextHint();
    },
  });
  readonly replay = new Replay((message) => this.send(message));
  facts: Facts | null = null;
  progress: Progress | null = null;
  token = sessionStorage.getItem("incise-token") ?? "";
  tool: Tool = "cut";

  private openIsChosen = false;
  private openTimer: ReturnType<typeof setTimeout> | undefined;
  private viewState = { stage: "connecting", text: "Connecting…" };
  private fitted = "";
  private hints = 0;
  private livePoses_ms = new Map<number, number>(); // when the last one came, by source
  shownAfter_ms = 0; // from the page's start to its first state
  private posed_ms = 0; // of the state in the picture that is on its way to the screen
  private latencies: number[] = [];
  private lastFigures = { deltas: 0, bytes: 0, work_us: 0, frames: 0 };
  private readonly charts = {
    latency: new Chart(element<HTMLCanvasElement>("latency-chart"), 20),
    budget: new Chart(element<HTMLCanvasElement>("budget-chart"), 100, 1),
    backlog: new Chart(element<HTMLCanvasElement>("backlog-chart"), 10, 1),
    deltas: new Chart(element<HTMLCanvasElement>("deltas-chart"), 5),
  };

  constructor() {
    this.worker.onerror = (event) => this.notice(`The page failed (${event.message}). Reload it.`);
    this.worker.onmessage = ({ data }: MessageEvent<FromWorker>) => this.onMessage(data);
    this.stage.beforeDraw = () => {
      this.mouse.tick();
      return this.applyPatch() || this.mouse.cutting;
    };
    this.stage.afterDraw = () => this.measureLatency();
    this.bindTools();
    this.bindLook();
    this.bindKeys();
    this.setTheme(localStorage.getItem("incise-theme") ?? "auto");
    this.togglePanel(innerWidth > 1000);
    setInterval(() => this.showRates(), kFiguresEvery_ms);
    for (const link of document.querySelectorAll<HTMLAnchorElement>(".links a")) link.onclick = (event) => void this.openWithToken(event, link.href);
    addEventListener("resize", () => this.measureCover());
    addEventListener("online", () => this.send({ kind: "wake" }));
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState === "visible") this.send({ kind: "wake" });
      else this.mouse.cancel();
    });
    this.connect();
  }

  send(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  private connect(): void {
    const url = new URL("ws", document.baseURI);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.send({ kind: "connect", url: url.href, token: this.token });
    this.setTool(this.tool);
    void this.replay.list(this.token);
  }

  // ---- From the worker ----

  private patch: (FromWorker & { kind: "patch" }) | null = null;

  private onMessage(message: FromWorker): void {
    switch (message.kind) {
      case "facts":
        this.onFacts(message.facts);
        break;
      case "geometry":
        this.stage.body.replace(message.slots, message.capacity, message.corners);
        this.patch = null;
        this.shownAfter_ms ||= performance.now();
        this.show(message.progress);
        if (message.progress.revision === 0) this.stage.body.setOpening(new Float32Array(0), new Float32Array(0));
        this.send({ kind: "applied" });
        this.stage.draw();
        break;
      case "patch":
        this.patch = message;
        this.stage.draw();
        break;
      case "opening":
        this.stage.body.setOpening(message.lips, message.pieces);
        element("cut-area").textContent = number(message.cutArea_m2 * 1e4, 1);
        this.stage.draw();
        break;
      case "link":
        this.onLink(message.which, message.state);
        break;
      case "blade":
        this.mouse.facts = message.facts;
        this.showDepth();
        break;
      case "blade-pose":
        this.livePoses_ms.set(message.source, performance.now());
        this.stage.blade(message.source, false).move(message.heel, message.tip, message.cutting);
        this.stage.draw();
        break;
      case "stats":
        this.onStats(message.json, message.roundTrip_ms);
        this.showTets(message.tets); // a page that comes late has it from here
        break;
      case "replay":
        this.onReplay(message.facts);
        break;
      case "deforms":
        if (this.openIsChosen) break;
        input("open").valueAsNumber = 0;
        this.showOpen();
        break;
      case "notice":
        this.notice(message.text);
        break;
      case "dump":
        this.onDump?.(message.triangles);
        break;
    }
  }

  private showOpen(): void {
    this.stage.setOpen(input("open").valueAsNumber, true);
    element("open-text").textContent = `${Math.round(100 * input("open").valueAsNumber)}%`;
  }

  private onFacts(facts: Facts): void {
    this.facts = facts;
    element("body-name").textContent = `${facts.meshName}, ${number(facts.tets)} tetrahedra`;
    element("server").textContent = facts.server;
    document.title = `${facts.meshName} · Incise`;
    const place = [facts.min, facts.max].join();
    if (place !== this.fitted) {
      this.fitted = place;
      this.stage.setBody(facts.min, facts.max, facts.meanEdge_m);
      this.stage.fit(true);
      this.stage.setOpen(input("open").valueAsNumber, true);
    }
    this.showDepth();
    if (this.tool === "cut" && document.body.dataset.blade !== "open") this.takeBlade(false); // its length depends on the body
    this.nextHint(true);
  }

  /** Once a picture at most; the worker sends the next when this one is in. */
  private applyPatch(): boolean {
    const patch = this.patch;
    if (!patch) return false;
    this.patch = null;
    this.stage.body.patch(patch.slots, patch.highest, patch.corners);
    this.follow(patch.steps);
    this.show(patch.progress);
    this.posed_ms = patch.progress.posed_ms;
    this.send({ kind: "applied" });
    return true;
  }

  /** Blades of whom no poses come, as in a replay, are seen where their batches end. */
  private follow(steps: BladeStep[]): void {
    for (const step of steps) {
      if (step.own || performance.now() - (this.livePoses_ms.get(step.source) ?? -1e6) < kPosesStale_ms) continue;
      const blade = this.stage.blade(step.source, false);
      blade.move(step.heel, step.tip, true);
      if (step.ended) blade.endStroke();
    }
  }

  private measureLatency(): void {
    if (this.posed_ms === 0) return;
    const posed = this.posed_ms;
    this.posed_ms = 0;
    // The picture is on the screen when the next one may be drawn.
    requestAnimationFrame(() => {
      const latency = performance.timeOrigin + performance.now() - posed;
      if (latency >= 0 && latency < 60_000) this.latencies.push(latency);
    });
  }

  private onLink(which: "view" | "blade" | "admin", state: { stage: string; text: string; reason?: string }): void {
    if (which === "view") {
      this.viewState = state;
      this.showConnection();
      if (state.reason === "token") this.askToken("This server shows its body to holders of a token only.");
      return;
    }
    if (which === "admin") {
      if (state.reason === "token") this.notice("Reset needs an administrator's token.", "Enter a token", () => this.askToken("One that opens the role admin."));
      else if (state.stage === "waiting") this.notice("The server does not answer; nothing was reset.");
      return;
    }
    document.body.dataset.blade = state.stage;
    if (state.stage === "open") {
      this.mouse.enabled = this.tool === "cut";
      this.nextHint(true);
      return;
    }
    this.mouse.enabled = false;
    this.mouse.cancel();
    this.nextHint(true);
    if (state.stage !== "ended") return;
    this.setTool("turn");
    if (state.reason === "taken") {
      this.notice("The mouse's blade is in another window's hand. You can watch here.", "Take it over", () => this.takeBlade(true));
    } else if (state.reason === "handed-over") {
      this.notice("Another window has taken the blade. You can watch here.", "Take it back", () => this.takeBlade(true));
    } else if (state.reason === "token") {
      this.notice("To cut here you need an operator's token. You can watch.", "Enter a token", () => this.askToken("One that opens the role operator."));
    } else {
      this.notice(state.text);
    }
  }

  private onStats(json: string, roundTrip_ms: number): void {
    let stats;
    try {
      stats = JSON.parse(json);
    } catch {
      return;
    }
    const work = stats.stages_us?.frame_work;
    const rate = stats.frames?.rate_hz ?? 1000;
    if (work?.sum !== undefined) {
      const frames = work.count - this.lastFigures.frames;
      const share = frames > 0 ? ((work.sum - this.lastFigures.work_us) / frames / (1e6 / rate)) * 100 : 0;
      if (this.lastFigures.frames > 0 && frames >= 0) {
        this.charts.budget.push(share);
        element("budget").textContent = `${number(share, share < 10 ? 1 : 0)}%`;
      }
      this.lastFigures.work_us = work.sum;
      this.lastFigures.frames = work.count;
    }
    const segments = stats.backlog?.segments ?? 0;
    this.charts.backlog.push(segments);
    element("backlog").textContent = segments > 0 ? `${number(segments)} segments, ${number(stats.backlog.work_ms)} ms` : "none";
    element("connection").title = `Round trip ${roundTrip_ms.toFixed(1)} ms`;
  }

  // ---- Figures ----

  private show(progress: Progress): void {
    this.progress = progress;
    element("revision").textContent = number(progress.revision);
    element("pieces").textContent = number(progress.pieces);
    this.showTets(progress.tets);
    element("hash-row").dataset.agrees = String(progress.hashAgrees);
    element("hash-text").textContent = progress.hashAgrees ? "State checked: hash agrees" : "Hash differs; asking for the state anew";
    element("hash").textContent = progress.hash;
    this.showConnection();
  }

  private showTets(tets: number): void {
    if (tets > 0) element("tets").textContent = number(tets);
  }

  private showRates(): void {
    const p = this.progress;
    if (!p) return;
    const seconds = kFiguresEvery_ms / 1000;
    const deltas = (p.deltas - this.lastFigures.deltas) / seconds;
    const bytes = (p.bytes - this.lastFigures.bytes) / seconds;
    this.lastFigures.deltas = p.deltas;
    this.lastFigures.bytes = p.bytes;
    this.charts.deltas.push(deltas);
    element("deltas").textContent = deltas > 0 ? `${number(deltas)}/s, ${number(bytes / 1024)} KiB/s` : "none";
    const sorted = this.latencies.splice(0).sort((a, b) => a - b);
    const median = sorted[sorted.length >> 1];
    if (median !== undefined) element("latency").textContent = `${number(median)} ms`;
    this.charts.latency.push(median ?? 0);
  }

  private showConnection(): void {
    const replaying = this.replay.facts !== null && this.viewState.stage === "open";
    element("connection").dataset.stage = replaying ? "replay" : this.viewState.stage;
    element("connection-text").textContent = replaying ? "Replay: a scratch copy" : this.viewState.stage === "open" ? "Live" : this.viewState.text;
  }

  notice(text: string, action?: string, act?: () => void): void {
    const box = document.createElement("div");
    box.className = "notice glass";
    const words = document.createElement("p");
    words.textContent = text;
    box.append(words);
    if (action && act) {
      const button = document.createElement("button");
      button.className = "primary";
      button.textContent = action;
      button.onclick = () => {
        box.remove();
        act();
      };
      box.append(button);
    }
    const list = element("notices");
    for (const old of [...list.children]) if (old.firstChild?.textContent === text) old.remove();
    list.append(box);
    setTimeout(() => box.remove(), action ? 3 * kNoticeTime_ms : kNoticeTime_ms);
  }

  /** What to do next, until it has been done once. */
  private nextHint(stay = false): void {
    if (!stay && this.tool === "cut") ++this.hints;
    const name = this.facts?.meshName || "body";
    const hand = touch.matches ? "Two fingers turn and zoom." : "Right-drag turns, the wheel zooms.";
    const text = this.tool !== "cut" || document.body.dataset.blade !== "open" ? "" :
      this.hints === 0 ? `<b>Drag across the ${name.replace(/[<&]/g, "")}</b>, from one side to the other, to cut it in two. ${hand}` :
      this.hints === 1 ? `<b>Open</b> moves the cut apart; <b>Depth</b> makes it stop inside. ${hand}` : "";
    element("hint").hidden = text === "";
    element("hint-text").innerHTML = text;
  }

  // ---- Tools ----

  private takeBlade(takeOver: boolean): void {
    if (!this.facts) return;
    this.send({ kind: "take-blade", takeOver, length_m: this.bladeLength_m });
    if (takeOver) this.setTool("cut", false);
  }

  setTool(tool: Tool, connect = true): void {
    if (tool === "cut" && this.replay.facts) {
      this.notice("A recording cannot be cut.", "Back to live", () => this.send({ kind: "replay", action: "close" }));
      tool = "turn";
    }
    this.tool = tool;
    this.mouse.cancel();
    document.body.dataset.tool = tool;
    input("tool").querySelectorAll<HTMLInputElement>("input").forEach((radio) => (radio.checked = radio.value === tool));
    this.stage.setTool(tool);
    this.mouse.enabled = tool === "cut" && document.body.dataset.blade === "open";
    if (tool === "cut" && connect && document.body.dataset.blade !== "open") this.takeBlade(false);
    this.nextHint(true);
  }

  private get bladeLength_m(): number {
    return input("length").valueAsNumber * kLongestBlade * this.stage.bodySize_m;
  }
  private newBlade: ReturnType<typeof setTimeout> | undefined;

  private showDepth(): void {
    const share = input("depth").valueAsNumber;
    const length = this.bladeLength_m;
    element("length-text").textContent = `${number(length * 1000)} mm`;
    // A blade that is too short to reach through goes in up to its heel.
    const reaches = length >= 0.75 * this.stage.bodySize_m;
    const most = Math.min(0.97 * length, 0.6 * this.stage.bodySize_m);
    const through = share >= 1 && reaches;
    this.mouse.depth_m = through ? null : share * most;
    element("depth-text").textContent = through ? "through" : `${number(share * most * 1000)} mm`;
  }

  private bindTools(): void {
    element("tool").addEventListener("change", (e) => this.setTool((e.target as HTMLInputElement).value as Tool));
    const on = (id: string, what: () => void) => input(id).addEventListener("input", what);
    on("depth", () => this.showDepth());
    on("length", () => {
      this.showDepth();
      clearTimeout(this.newBlade);
      this.newBlade = setTimeout(() => {
        if (document.body.dataset.blade === "open") this.takeBlade(true);
      }, kNewBladeAfter_ms);
    });
    on("tilt", () => {
      this.mouse.tilt_rad = (input("tilt").valueAsNumber * Math.PI) / 180;
      element("tilt-text").textContent = `${input("tilt").value}°`;
    });
    on("open", () => {
      this.openIsChosen = true;
      this.showOpen();
    });
    element("fit").onclick = () => this.stage.fit();
    element("reset").onclick = () => element<HTMLDialogElement>("reset-dialog").showModal();
    element<HTMLDialogElement>("reset-dialog").onclose = () => {
      if (element<HTMLDialogElement>("reset-dialog").returnValue === "ok") this.send({ kind: "reset" });
      element<HTMLDialogElement>("reset-dialog").returnValue = "";
    };
    element("picture").addEventListener("contextmenu", (e) => e.preventDefault());
  }

  private bindLook(): void {
    element("colouring").addEventListener("change", (e) => {
      const colouring = (e.target as HTMLInputElement).value as Colouring;
      this.stage.body.setColouring(colouring);
      element("quality-scale").hidden = colouring !== "quality";
      this.send({ kind: "colour-by-quality", on: colouring === "quality" });
      this.stage.draw();
    });
    input("wire").addEventListener("change", () => {
      this.stage.body.setWire(input("wire").checked);
      this.stage.draw();
    });
    const section = () => {
      element("section-at-row").hidden = !input("section").checked;
      this.stage.setSection(input("section").checked ? input("section-at").valueAsNumber : -1);
    };
    input("section").addEventListener("change", section);
    input("section-at").addEventListener("input", section);
    element("panel-toggle").onclick = () => this.togglePanel();
    element("theme").onclick = () => this.setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => this.setTheme(localStorage.getItem("incise-theme") ?? "auto"));
  }

  private bindKeys(): void {
    const nudge = (id: string, by: number) => {
      input(id).valueAsNumber += by;
      input(id).dispatchEvent(new Event("input"));
    };
    const press = (id: string) => input(id).click();
    const keys: Record<string, () => void> = {
      c: () => this.setTool("cut"), t: () => this.setTool("turn"), f: () => this.stage.fit(),
      r: () => element("reset").click(), l: () => element("theme").click(), p: () => this.togglePanel(),
      w: () => press("wire"), s: () => press("section"),
      "[": () => nudge("depth", -0.05), "]": () => nudge("depth", 0.05), "{": () => nudge("length", -0.05), "}": () => nudge("length", 0.05),
      ",": () => nudge("tilt", -5), ".": () => nudge("tilt", 5),
      o: () => {
        input("open").valueAsNumber = input("open").valueAsNumber > 0.01 ? 0 : 0.3;
        input("open").dispatchEvent(new Event("input"));
      },
      Escape: () => this.mouse.cancel(),
    };
    addEventListener("keydown", (e) => {
      const target = e.target as HTMLElement;
      if (e.ctrlKey || e.metaKey || e.altKey || target.closest("dialog") || target.matches("input[type=password], select")) return;
      if (target.matches("input[type=range], input[type=radio]") && e.key.startsWith("Arrow")) return;
      const turn: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (turn[e.key] && target.id === "picture") {
        this.stage.turn(...turn[e.key]);
        e.preventDefault();
      } else if ((e.key === "+" || e.key === "-") && target.id === "picture") {
        this.stage.zoom(e.key === "+" ? 0.88 : 1.14);
      } else if (keys[e.key]) {
        keys[e.key]();
        e.preventDefault();
      }
    });
  }

  private togglePanel(open = document.body.dataset.panel === "closed"): void {
    document.body.dataset.panel = open ? "open" : "closed";
    element("panel-toggle").setAttribute("aria-expanded", String(open));
    this.measureCover();
    for (const chart of Object.values(this.charts)) chart.draw();
  }

  /** What the panels leave free of the picture is where the body is shown. */
  private measureCover(): void {
    const panel = document.body.dataset.panel !== "closed" && innerWidth > kNarrow_px;
    this.stage.setCover({
      left: 0,
      right: panel ? innerWidth - element("panel").offsetLeft : 0,
      top: 0.6 * element("title").offsetHeight,
      bottom: innerHeight - element("tools").offsetTop,
    });
    document.body.style.setProperty("--tools-top", `${innerHeight - element("tools").offsetTop}px`);
    document.body.style.setProperty("--free-middle", `${(panel ? element("panel").offsetLeft : innerWidth) / 2}px`);
  }

  private setTheme(theme: string): void {
    if (theme !== "auto") localStorage.setItem("incise-theme", theme);
    const light = theme === "light" || (theme === "auto" && matchMedia("(prefers-color-scheme: light)").matches);
    document.documentElement.dataset.theme = light ? "light" : "dark";
    const colour = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    this.stage.setInk(light ? 0x7c8b9a : 0xb8c6d4, light ? 0.26 : 0.55, light ? 1.25 : 1, [colour("--back-a"), colour("--back-b")]);
    for (const chart of Object.values(this.charts)) chart.draw();
  }

  /** A link cannot carry the token: what it leads to is fetched, and shown in a tab of its own. */
  private async openWithToken(event: MouseEvent, url: string): Promise<void> {
    if (this.token === "") return;
    event.preventDefault();
    const answer = await fetch(url, { cache: "no-store", headers: bearer(this.token) });
    open(URL.createObjectURL(await answer.blob()));
  }

  private askToken(why: string): void {
    const dialog = element<HTMLDialogElement>("token-dialog");
    if (dialog.open) return;
    element("token-why").textContent = `${why} Whoever runs it can give you one; it stays in this window.`;
    dialog.onclose = () => {
      const token = input("token").value;
      input("token").value = "";
      if (dialog.returnValue !== "ok" || token === "") return;
      this.token = token;
      sessionStorage.setItem("incise-token", token);
      this.tool = "cut";
      this.connect();
    };
    dialog.returnValue = "";
    dialog.showModal();
  }

  private onReplay(facts: ReplayFacts | null): void {
    const was = this.replay.facts !== null;
    this.replay.show(facts);
    const is = this.replay.facts !== null;
    document.body.dataset.replay = is ? "on" : "off";
    element<HTMLButtonElement>("reset").disabled = is;
    element("quality-of").textContent = is ? "of the triangles" : "of the tetrahedra";
    if (is && !was) {
      if (innerWidth <= kNarrow_px) this.togglePanel(false); // it lies over the player
      this.setTool("turn");
      this.send({ kind: "release-blade" });
      document.body.dataset.blade = "ended";
    } else if (was && !is) {
      this.setTool("cut");
    }
    if (facts?.text) this.notice(facts.text);
    this.showConnection();
  }

  // For tests, and for the curious at the console.
  private onDump: ((triangles: Float32Array) => void) | null = null;
  dump(): Promise<Float32Array> {
    return new Promise((resolve) => {
      this.onDump = resolve;
      this.send({ kind: "dump" });
    });
  }
}

declare global {
  interface Window {
    incise: Page;
  }
}
window.incise = new Page();
