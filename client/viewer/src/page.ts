import { Vector3 } from "three";
import { BladeName } from "./blade_name";
import { BladeNames } from "./blade_colours";
import { ask, element, input, save } from "./dom";
import { acceptDrops } from "./drop";
import { Figures } from "./figures";
import { ForceArrows } from "./force_arrows";
import { type Key, Keys } from "./keys";
import type { LinkState } from "./link";
import { LiveStrokes } from "./live_strokes";
import { Look } from "./look";
import type { BladeStep, Facts, FromWorker, Patch, Progress, ReplayFacts, ToWorker } from "./messages";
import { Measure } from "./measure";
import { More } from "./more";
import { notice } from "./notices";
import { Operator } from "./operator";
import { bearer, Replay } from "./replay";
import { Stage, type Tool } from "./stage";
import { fromFragment, toFragment } from "./view_link";

// The folder with a session's files, in a page without a server (static.cmake).
const kLocalSession = document.documentElement.dataset.session;
const kPosesStale_ms = 1500;
const kOwnReset_ms = 5000; // a reset within this time of asking is the user's own

const kWaitsText =
  kLocalSession === undefined ? "Waiting for the server to answer." : "Loading the session into this page.";
const kOpenText = kLocalSession === undefined ? "Live" : "In this page";

const now_ms = () => performance.timeOrigin + performance.now();

/** The page: passes the worker's messages to the parts that show them. */
export class Page {
  readonly worker = new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
  readonly stage = new Stage(element<HTMLCanvasElement>("picture"), element<HTMLCanvasElement>("marks"));
  readonly measure = new Measure(element("picture"), this.stage, (halfFace) =>
    this.send({ kind: "cut-area", halfFace }),
  );
  readonly forces = new ForceArrows(this.stage.marks, () => this.stage.bodySize_m);
  readonly operator = new Operator(this.stage, (message, transfer) => this.send(message, transfer));
  readonly replay = new Replay((message) => this.send(message), kLocalSession && `${kLocalSession}captures.json`);
  readonly figures = new Figures(kLocalSession !== undefined);
  readonly blades = new BladeNames();
  readonly bladeName = new BladeName((name) => this.send({ kind: "name-blade", name }));
  readonly live = new LiveStrokes(this.blades);
  readonly look = new Look(
    this.stage,
    (on) => this.send({ kind: "colour-by-quality", on }),
    () => {
      this.figures.draw();
      this.live.timeline.draw();
      this.replay.draw();
    },
  );
  readonly more = new More(this.stage, () => `${this.facts?.meshName || "body"}_r${this.progress?.revision ?? 0}`);
  facts: Facts | null = null;

  private token = sessionStorage.getItem("incise-token") ?? "";
  private viewState: LinkState = { stage: "connecting", text: "Connecting…" };
  private fitted = "";
  private patch: Patch | null = null;
  private readonly livePoses_ms = new Map<number, number>(); // when the last one came, by source
  private resetAsked_ms = -Infinity;
  private undoable = false; // as the server said last
  private recorded = false; // likewise; without a recording nothing can be undone

  constructor() {
    this.worker.onerror = (event) => notice(`The page failed (${event.message}). Reload it.`);
    this.worker.onmessage = ({ data }: MessageEvent<FromWorker>) => this.onMessage(data);
    this.operator.askToken = (why) => this.askToken(why);
    this.stage.beforeDraw = () => {
      this.mouse.tick();
      return this.applyPatch() || this.mouse.cutting;
    };
    this.stage.afterDraw = () => {
      const shown = this.figures.latency.drawn();
      if (shown) requestAnimationFrame(() => shown(now_ms())); // it is on the screen when the next frame begins
    };
    this.stage.marks.covered = () => ["title", "corner"].map((id) => element(id).getBoundingClientRect());
    this.stage.marks.layers.push((marks) => this.measure.draw(marks));
    this.stage.marks.layers.push((marks) => this.stage.labelBlades(marks, (source) => this.nameOf(source)));
    this.operator.onTool = (tool) => {
      this.measure.active = tool === "measure";
      element("measure").setAttribute("aria-pressed", String(this.measure.active));
    };
    new Keys(this.keys());
    this.bindButtons();
    this.stage.onRest = () => this.keepView();
    addEventListener("hashchange", () => this.showLink());
    addEventListener("online", () => this.send({ kind: "wake" }));
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState !== "visible") return;
      this.figures.latency.seen(now_ms());
      this.send({ kind: "wake" });
    });
    this.operator.waitsFor = kWaitsText;
    this.showLink();
    this.connect();
  }

  get mouse() {
    return this.operator.mouse;
  }
  get tool(): Tool {
    return this.operator.tool;
  }
  get progress(): Progress | null {
    return this.figures.progress;
  }

  send(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  private connect(): void {
    const url = new URL(kLocalSession ?? "ws", document.baseURI);
    if (kLocalSession === undefined) url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.send({ kind: "connect", url: url.href, token: this.token, local: kLocalSession !== undefined });
    this.operator.setTool("cut");
    void this.replay.list(this.token);
  }

  // ---- From the worker ----

  private onMessage(message: FromWorker): void {
    switch (message.kind) {
      case "facts":
        return this.onFacts(message.facts);
      case "texture":
        return this.stage.body.setTexture(message.size, message.layers, message.pixels);
      case "look":
        this.stage.body.setLook(message.look);
        this.look.offerImage(message.look.image !== null);
        return this.stage.draw();
      case "geometry":
        return this.onGeometry(message);
      case "patch":
        this.patch = message;
        return this.stage.draw();
      case "opening":
        this.stage.body.setOpening(message.lips, message.pieces);
        this.figures.showCutArea(message.cutArea_m2);
        return this.stage.draw();
      case "cut-area":
        return this.measure.onArea(message.halfFace, message.area_m2);
      case "link":
        return this.onLink(message.which, message.state);
      case "blade":
        this.blades.set(message.facts.source, message.facts.name);
        return this.operator.onBlade(message.facts);
      case "blade-pose":
        this.livePoses_ms.set(message.source, performance.now());
        this.stage.blade(message.source, false).move(message.heel, message.tip, message.cutting);
        return this.stage.draw();
      case "force":
        this.forces.take(message.force);
        return this.stage.draw();
      case "stats":
        this.figures.showStats(message.json);
        this.blades.read(message.json);
        this.live.showBlades();
        this.recorded = message.recorded;
        this.undoable = message.undoable > 0;
        this.enableUndo();
        element("connection").title = `Round trip ${message.roundTrip_ms.toFixed(1)} ms`;
        return;
      case "replay":
        return this.onReplay(message.facts);
      case "deforms":
        return this.operator.onDeforms();
      case "differs":
        return this.figures.showTrust(false);
      case "was-reset":
        return this.onReset(message.undone, message.by, message.others);
      case "notice":
        notice(message.text);
        return;
      case "recording":
        if (message.after === "asked") return save(message.bytes, "incise.capture");
        notice("What was cut until then was recorded.", "Save it", () => save(message.bytes, "incise_failed.capture"));
        return;
      case "dump":
        return this.onDump?.(message.triangles);
    }
  }

  private onFacts(facts: Facts): void {
    const another = facts.session !== this.facts?.session;
    this.facts = facts;
    element("body-name").textContent = `${facts.meshName}, ${facts.tets.toLocaleString("en")} tetrahedra`;
    element("server").textContent = facts.server;
    document.title = `${facts.meshName} · Incise`;
    const place = [facts.min, facts.max].join();
    if (place !== this.fitted) {
      this.fitted = place;
      this.stage.setBody(facts.min, facts.max);
      this.stage.fit(true);
      this.showLinkedCamera();
      this.operator.showOpen();
    }
    if (another && facts.live) this.live.restart(facts.revision);
    if (another) {
      this.operator.abandonStroke();
      this.measure.clear();
    }
    this.operator.meet(facts.meshName);
    if (!this.stage.body.mesh.visible)
      this.operator.waitsFor = `Loading the body of ${facts.tets.toLocaleString("en")} tetrahedra.`;
  }

  /** The address keeps the view; no entry in the history. */
  private keepView(): void {
    if (!this.facts) return;
    const camera = { body: this.facts.meshName, ...this.stage.cameraPlace };
    const fragment = `#${toFragment({ camera, ...this.look.state, name: this.bladeName.inLink })}`;
    if (fragment !== location.hash) history.replaceState(history.state, "", fragment);
  }

  private showLink(): void {
    const state = fromFragment(location.hash);
    this.look.showState(state);
    this.bladeName.follow(state.name);
    this.showLinkedCamera();
  }

  /** Puts the camera where the address says, if it is about this body. */
  private showLinkedCamera(): void {
    const { camera } = fromFragment(location.hash);
    if (!camera || !this.facts) return;
    if (camera.body && camera.body !== this.facts.meshName) {
      notice(`The link shows another body, ${camera.body}. Its place of view is left out.`);
      return;
    }
    this.stage.placeCamera(new Vector3(...camera.position), new Vector3(...camera.target));
  }

  private onGeometry(message: FromWorker & { kind: "geometry" }): void {
    this.stage.body.replace(message.slots, message.capacity, message.corners);
    this.patch = null;
    this.operator.waitsFor = "";
    this.measure.follow();
    this.show(message.progress);
    this.figures.showTrust(message.progress.hashAgrees);
    if (message.progress.revision === 0) this.stage.body.setOpening(new Float32Array(0), new Float32Array(0));
    this.send({ kind: "applied" });
    this.stage.draw();
  }

  /** At most once a frame; the worker sends the next patch after this one is applied. */
  private applyPatch(): boolean {
    const patch = this.patch;
    if (!patch) return false;
    this.patch = null;
    this.stage.body.patch(patch.slots, patch.highest, patch.corners);
    this.measure.follow();
    for (const step of patch.steps) this.follow(step);
    this.show(patch.progress);
    this.figures.latency.expect(patch.posed_ms);
    this.send({ kind: "applied" });
    return true;
  }

  /** A blade without live poses, as in a replay, is shown where its batches end. */
  private follow(step: BladeStep): void {
    if (this.replay.facts === null) this.live.add(step);
    if (step.cutArea_m2 > 0 && this.recorded && !this.undoable) {
      this.undoable = true; // the server says so only once a second
      this.enableUndo();
    }
    if (step.own) return this.operator.onOwnStep(step);
    if (performance.now() - (this.livePoses_ms.get(step.source) ?? -Infinity) < kPosesStale_ms) return;
    const blade = this.stage.blade(step.source, false);
    blade.move(step.heel, step.tip, true);
    if (step.ended) blade.endStroke();
  }

  private nameOf(source: number): string {
    return this.replay.facts === null ? this.blades.of(source) : `blade ${source + 1}`; // a recording has its own
  }

  private onLink(which: "view" | "blade" | "admin", state: LinkState): void {
    switch (which) {
      case "view":
        this.viewState = state;
        this.showConnection();
        this.operator.onViewLink(state);
        if (state.reason === "token") this.askTokenToSee();
        return;
      case "blade":
        return this.operator.onBladeLink(state);
      case "admin":
        if (state.reason === "token") {
          notice("Reset needs an administrator's token.", "Enter a token", () =>
            this.askToken("Reset needs one with the role admin."),
          );
        } else if (state.stage === "waiting") {
          notice("The server does not answer; nothing was reset.");
        }
    }
  }

  private onReset(undone: boolean, by: string, others: string[]): void {
    if (performance.now() - this.resetAsked_ms < kOwnReset_ms) return;
    if (undone) {
      const also = others.length > 0 ? `, and with it what ${others.join(", ")} had cut since` : "";
      notice(`The last stroke was undone, by ${by || "its operator or an administrator"}${also}.`);
      return;
    }
    notice(
      `The body was reset for everybody, by ${by || "an administrator"}; the demo begins each pass with an ` +
        "uncut body. All cuts are gone.",
    );
  }

  private enableUndo(): void {
    const button = element<HTMLButtonElement>("undo");
    button.disabled = !this.undoable || this.replay.facts !== null;
    button.title = this.undoable
      ? "Back to before the last stroke, for everybody (Z)"
      : this.recorded
        ? "There is no stroke to undo (Z says why)"
        : "Nothing can be undone: this server keeps no recording";
  }

  /** Where that cannot be, the server says why. `others`: also what other blades have cut since. */
  private undo(others = false): void {
    if (this.replay.facts !== null) return;
    this.resetAsked_ms = performance.now();
    if (this.mouse.cutting)
      notice("The undo waits until this stroke ends, and takes it back where it has cut something.");
    this.send({ kind: "undo", others });
  }

  private onReplay(facts: ReplayFacts | null): void {
    const was = this.replay.facts !== null;
    this.replay.show(facts);
    const is = this.replay.facts !== null;
    document.body.dataset.replay = is ? "on" : "off";
    element<HTMLButtonElement>("reset").disabled = is;
    this.enableUndo();
    element("quality-of").textContent = is ? "of the triangles" : "of the tetrahedra";
    if (is !== was) {
      this.look.measureCover();
      this.measure.clear(); // it is of the other body
    }
    if (is && !was && this.look.narrow) this.look.togglePanel(false); // it would cover the player
    this.operator.onReplay(is);
    if (facts?.text) notice(facts.text);
    this.showConnection();
  }

  private show(progress: Progress): void {
    this.figures.show(progress);
    this.showConnection();
  }

  private showConnection(): void {
    const { stage, text } = this.viewState;
    this.figures.showLive(stage === "open");
    const replaying = this.replay.facts !== null && stage === "open";
    element("connection").dataset.stage = replaying ? "replay" : stage;
    element("connection-text").textContent = replaying ? "Replay (a copy)" : stage === "open" ? kOpenText : text;
  }

  // ---- From the user ----

  private bindButtons(): void {
    element("fit").onclick = () => this.stage.fit();
    this.more.bind("measure", () => this.toggleMeasure());
    element("undo").onclick = (e) => this.undo(e.shiftKey);
    element("reset").onclick = () =>
      ask("reset-dialog", (confirmed) => {
        if (!confirmed) return;
        this.resetAsked_ms = performance.now();
        this.send({ kind: "reset" });
      });
    element("picture").addEventListener("contextmenu", (e) => e.preventDefault());
    element("save-recording").onclick = () => this.send({ kind: "save-recording" });
    input("open-recording").onchange = () => {
      const file = input("open-recording").files?.[0];
      if (file) void this.openRecording(file).finally(() => (input("open-recording").value = "")); // it may be chosen again
    };
    acceptDrops(kLocalSession !== undefined, (file) => void this.openRecording(file));
    element("token-cancel").onclick = () => element<HTMLDialogElement>("token-dialog").close();
    for (const link of document.querySelectorAll<HTMLAnchorElement>(".links a"))
      link.onclick = (event) => void this.openWithToken(event, link.href);
  }

  private async openRecording(file: File): Promise<void> {
    const bytes = new Uint8Array(await file.arrayBuffer());
    this.send({ kind: "open-recording", name: file.name, bytes }, [bytes.buffer]);
  }

  /** A link cannot carry the token: its page is fetched with the token and shown in a tab of its own. */
  private async openWithToken(event: MouseEvent, url: string): Promise<void> {
    if (this.token === "") return;
    event.preventDefault();
    const answer = await fetch(url, { cache: "no-store", headers: bearer(this.token) });
    open(URL.createObjectURL(await answer.blob()));
  }

  private keys(): Key[] {
    const { operator, stage, look, more } = this;
    const press = (id: string) => () => element(id).click();
    const nudge = (id: string, less: string, by: number) => (key: string) =>
      operator.nudge(id, key === less ? -by : by);
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, 1],
      ArrowDown: [0, -1],
    };
    return [
      { keys: ["c"], shown: "C", does: "Cut", act: () => operator.setTool("cut") },
      { keys: ["t"], shown: "T", does: "Turn", act: () => operator.setTool("turn") },
      { keys: Object.keys(turns), shown: "← → ↑ ↓", does: "Turn the body", act: (key) => stage.turn(...turns[key]) },
      {
        keys: ["+", "=", "-"],
        shown: "+ -",
        does: "Nearer, farther",
        act: (key) => stage.zoom(key === "-" ? 1.14 : 0.88),
      },
      { keys: ["f"], shown: "F", does: "Whole body in view", act: () => stage.fit() },
      ...more.keys(),
      { keys: ["[", "]"], shown: "[ ]", does: "Depth of the blade", act: nudge("depth", "[", 0.05) },
      { keys: ["{", "}"], shown: "{ }", does: "Length of the blade", act: nudge("length", "{", 0.05) },
      { keys: [",", "."], shown: ", .", does: "Angle of the blade", act: nudge("tilt", ",", 5) },
      { keys: ["o"], shown: "O", does: "Open or close the cuts", act: () => operator.toggleOpen() },
      { keys: ["w"], shown: "W", does: "Wireframe", act: press("wire") },
      { keys: ["s"], shown: "S", does: "Section", act: press("section") },
      {
        keys: ["v"],
        shown: "V",
        does: "Inside: tissue or image",
        act: () => look.toggleImage(),
        needs: () => this.stage.body.look.hasImage,
      },
      {
        keys: Object.keys(turns).map((key) => `Shift ${key}`),
        shown: "Shift+arrows",
        does: "Turn the section",
        act: (key) => look.turnSection(...turns[key.slice("Shift ".length)]),
        needs: () => look.state.section !== undefined,
      },
      {
        keys: ["PageUp", "PageDown"],
        shown: "PgUp PgDn",
        does: "Move the section",
        act: (key) => look.moveSection(key === "PageUp" ? 1 : -1),
        needs: () => look.state.section !== undefined,
      },
      {
        keys: ["n"],
        shown: "N",
        does: "In a replay: next batch",
        act: press("step"),
        needs: () => this.replay.facts !== null,
      },
      { keys: ["z"], shown: "Z", does: "Undo the last stroke", act: () => this.undo() },
      { keys: ["r"], shown: "R", does: "Reset", act: press("reset") },
      { keys: ["l"], shown: "L", does: "Light or dark theme", act: press("theme") },
      { keys: ["p"], shown: "P", does: "Figures and settings", act: () => look.togglePanel() },
      { keys: ["m"], shown: "M", does: "Measure", act: press("measure") },
      { keys: ["Escape"], shown: "Esc", does: "End the stroke, or measuring", act: () => this.escape() },
    ];
  }

  private escape(): void {
    if (this.more.close() || this.look.handle.cancel()) return;
    if (!this.mouse.cutting && (this.measure.active || this.measure.shown)) return this.endMeasuring();
    this.operator.abandonStroke();
  }

  private endMeasuring(): void {
    this.measure.clear();
    this.operator.endMeasuring();
  }

  private toggleMeasure(): void {
    if (this.measure.active) this.endMeasuring();
    else this.operator.setTool("measure");
  }

  private askTokenToSee(): void {
    const why = this.token
      ? "The server did not accept that token."
      : "This server shows its body only to those who have a token.";
    const again = () => notice("Without a token there is nothing to see.", "Enter a token", () => this.askTokenToSee());
    this.askToken(why, again);
  }

  private askToken(why: string, refused = () => {}): void {
    element("token-why").textContent =
      `${why} Ask the person who runs the server for one. It is kept only in this window.`;
    ask("token-dialog", (confirmed) => {
      const token = input("token").value;
      input("token").value = "";
      if (!confirmed || token === "") return refused();
      this.token = token;
      sessionStorage.setItem("incise-token", token);
      this.connect();
    });
  }

  // For tests, and for the browser's console.
  private onDump: ((triangles: Float32Array) => void) | null = null;
  dump(): Promise<Float32Array> {
    return new Promise((resolve) => {
      this.onDump = resolve;
      this.send({ kind: "dump" });
    });
  }
}
