import { bold, notice, showHint } from "./notices";
import { choose, element, input, number, onChoice } from "./dom";
import type { LinkState } from "./link";
import type { BladeFacts, BladeStep, ToWorker } from "./messages";
import type { Marks } from "./marks";
import { MouseBlade } from "./mouse_blade";
import type { Stage, Tool } from "./stage";

const kOpenAfterStroke_ms = 300;
const kOpenInStroke = 0.3; // at most: the farther apart, the more a piece is bent towards the blade, where nothing is opened
const kLongestBlade = 1.5; // times the body's size: it reaches through from any side
const kNewBladeAfter_ms = 250; // after the last change of its length
const kReachesThrough = 0.75; // times the body's size
const kPreviewOutside = 0.1; // of the blade outside the body, times the body's size: a long one would cross the page

type Send = (message: ToWorker, transfer?: Transferable[]) => void;

/** The user as an operator: tool, the mouse's blade, its settings, and the messages about it. */
export class Operator {
  tool: Tool = "cut";
  private toolBefore: Tool = "cut"; // measuring
  readonly mouse: MouseBlade;
  bodyName = ""; // empty until the server has described the body
  askToken: (why: string) => void = () => {};
  onTool: (tool: Tool) => void = () => {};
  private viewStage: LinkState["stage"] = "connecting";
  private replaying = false;
  private openTimer: ReturnType<typeof setTimeout> | undefined;
  private openIsChosen = false;
  private newBladeTimer: ReturnType<typeof setTimeout> | undefined;
  private liveOpen = 0; // while a recording is shown: where the live body's Open was
  private removeReplayNotice = () => {};
  private removeStalledNotice = () => {};
  private held = false; // we have the blade: after a break it is taken back
  private strokesTried = 0; // for the hints
  private strokeArea_m2 = 0; // cut by the current or last stroke
  private readonly touch = matchMedia("(pointer: coarse)");

  constructor(
    private readonly stage: Stage,
    private readonly send: Send,
  ) {
    this.mouse = new MouseBlade(element("picture"), stage, {
      poses: (poses) => send({ kind: "poses", poses }, [poses.buffer]),
      moved: (heel, tip, cuts) => {
        stage.blade(0, true).move(stage.beforeBody(heel, tip), tip, cuts);
        stage.draw();
      },
      refused: () => this.sayWhyNot(),
      strokeBegan: () => this.beginStroke(),
      aimed: (ray) => stage.hold(ray),
      hovered: () => stage.marks.draw(),
      strokeEnded: (sent) => this.endStroke(sent),
    });
    stage.marks.tools.push((marks) => this.drawPreview(marks));
    onChoice("tool", (tool) => this.setTool(tool as Tool));
    this.bindSliders();
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState !== "visible") this.mouse.cancel();
    });
  }

  setTool(tool: Tool): void {
    if (tool === "cut" && this.replaying) {
      const close = () => this.send({ kind: "replay", action: "close" });
      this.removeReplayNotice = notice("A recording cannot be cut.", "Back to live", close);
      tool = "turn";
    }
    this.show(tool);
    if (tool === "cut" && this.bladeStage !== "open" && this.bladeStage !== "stalled") this.takeBlade(false);
  }

  /** What the page waits for before there is a body; empty: nothing. */
  set waitsFor(what: string) {
    if (what === this.waiting) return;
    this.waiting = what;
    this.hint();
  }
  private waiting = "";

  /** Measuring is over: back to the tool that was in hand before. */
  endMeasuring(): void {
    if (this.tool === "measure") this.setTool(this.toolBefore);
  }

  /** The server has described the body. */
  meet(bodyName: string): void {
    this.bodyName = bodyName === "" || bodyName.includes(".") ? "body" : bodyName; // not a file's name
    this.showDepth();
    if (this.tool === "cut" && this.bladeStage !== "open") this.takeBlade(this.held); // its length depends on the body
    this.hint();
  }

  /** Ends the stroke, since its body has been replaced or the user wants it. */
  abandonStroke(): void {
    this.mouse.cancel();
  }

  onViewLink(state: LinkState): void {
    this.viewStage = state.stage;
    this.enableMouse();
  }

  onBlade(facts: BladeFacts): void {
    this.mouse.facts = facts;
    this.showDepth();
  }

  onBladeLink(state: LinkState): void {
    document.body.dataset.blade = state.stage;
    this.enableMouse();
    this.hint();
    if (state.stage === "open") this.held = true;
    if (state.stage !== "ended") return;
    this.held = false;
    this.setTool("turn");
    const takeIt = () => this.takeBlade(true);
    if (state.reason === "taken") {
      notice("Another window holds the mouse's blade. You can watch here.", "Take it over", takeIt);
    } else if (state.reason === "handed-over") {
      notice("Another window has taken the blade. You can watch here.", "Take it back", takeIt);
    } else if (state.reason === "token") {
      notice("To cut here you need an operator's token. You can watch.", "Enter a token", () =>
        this.askToken("Cutting needs one with the role operator."),
      );
    } else {
      notice(state.text);
    }
  }

  /** A batch that the server has cut for the mouse. */
  onOwnStep(step: BladeStep): void {
    this.strokeArea_m2 += step.cutArea_m2;
    if (step.ended && !this.mouse.cutting && this.strokeArea_m2 === 0) this.sayMissed();
  }

  onReplay(on: boolean): void {
    if (on === this.replaying) return;
    this.replaying = on;
    if (!on) {
      this.removeReplayNotice();
      if (!this.openIsChosen) {
        input("open").valueAsNumber = this.liveOpen;
        this.showOpen();
      }
      return this.setTool("cut");
    }
    this.liveOpen = input("open").valueAsNumber;
    this.setTool("turn");
    this.send({ kind: "release-blade" });
    document.body.dataset.blade = "ended";
  }

  /** A simulation opens cuts by itself: Open goes to 0, unless the user has set it. */
  onDeforms(): void {
    if (this.openIsChosen) return;
    input("open").valueAsNumber = 0;
    this.showOpen();
  }

  showOpen(): void {
    this.stage.setOpen(input("open").valueAsNumber, true);
    element("open-text").textContent = `${Math.round(100 * input("open").valueAsNumber)}%`;
  }

  /** Moves a slider as the user would. */
  nudge(id: string, by: number): void {
    this.slide(id, input(id).valueAsNumber + by);
  }

  toggleOpen(): void {
    this.slide("open", input("open").valueAsNumber > 0.01 ? 0 : 0.3);
  }

  private slide(id: string, value: number): void {
    input(id).valueAsNumber = value;
    input(id).dispatchEvent(new Event("input"));
  }

  private get bladeStage(): string {
    return document.body.dataset.blade ?? "";
  }

  private show(tool: Tool): void {
    if (tool === "measure" && this.tool !== "measure") this.toolBefore = this.tool;
    this.tool = tool;
    this.mouse.cancel();
    document.body.dataset.tool = tool;
    choose("tool", tool);
    this.stage.setTool(tool);
    this.onTool(tool);
    this.enableMouse();
    this.hint();
  }

  private takeBlade(takeOver: boolean): void {
    if (this.bodyName === "") return;
    this.send({ kind: "take-blade", takeOver, length_m: this.bladeLength_m });
    if (takeOver) this.show("cut");
  }

  /** Cutting needs both connections: without the viewer's, the user would not see the cut. */
  private enableMouse(): void {
    const before = this.mouse.cutting;
    this.mouse.enabled = this.tool === "cut" && this.bladeStage === "open" && this.viewStage === "open";
    this.stage.marks.draw(); // the preview
    if (this.mouse.enabled) return this.removeStalledNotice();
    this.mouse.cancel();
    if (before && this.tool === "cut" && !this.replaying) {
      notice("The server does not answer. Your stroke ends here; the last second of it may still be cut.");
    }
  }

  private sayWhyNot(): void {
    if (this.tool !== "cut") return;
    const stages = [this.viewStage, this.bladeStage];
    if (!stages.includes("stalled") && !stages.includes("waiting")) return;
    this.removeStalledNotice = notice("The server does not answer. Nothing is cut until it does.");
  }

  private beginStroke(): void {
    clearTimeout(this.openTimer);
    this.strokeArea_m2 = 0;
    this.stage.setOpen(Math.min(input("open").valueAsNumber, kOpenInStroke));
    document.body.dataset.stroke = "on";
  }

  /** sent: the server was sent poses of it. */
  private endStroke(sent: boolean): void {
    delete document.body.dataset.stroke;
    this.stage.blade(0, true).endStroke();
    this.stage.blade(0, true).hide();
    this.openTimer = setTimeout(() => {
      this.stage.release();
      this.stage.setOpen(input("open").valueAsNumber);
    }, kOpenAfterStroke_ms);
    if (this.tool === "cut") ++this.strokesTried;
    this.hint();
    if (!sent && this.mouse.enabled) this.sayMissed();
  }

  /** How the blade would enter under the pointer, before the button is pressed. */
  private drawPreview(marks: Marks): void {
    const preview = this.mouse.preview();
    if (!preview || document.body.dataset.handle) return;
    const { heel, entry, tip } = preview;
    const outside = heel.clone().sub(entry);
    marks.line(entry.clone().add(outside.clampLength(0, kPreviewOutside * this.stage.bodySize_m)), entry, 1);
    marks.line(entry, tip, 3);
    marks.dot(entry, 7, false);
    marks.dot(tip, 3);
    marks.label(entry, element("depth-text").textContent ?? "");
  }

  private sayMissed(): void {
    notice(`That stroke cut nothing. Draw across the ${this.bodyName}.`);
    this.strokesTried = 0;
    this.hint();
  }

  /** Says what to do next, until the user has done it once. */
  private hint(): void {
    if (this.waiting) return showHint([this.waiting]);
    if (this.tool === "measure") {
      return showHint([bold("Click on the surface"), ": two points give a length, a cut gives its area. Esc ends."]);
    }
    const hand = this.touch.matches ? "Two fingers turn and zoom." : "Right-drag turns, the wheel zooms.";
    if (this.tool !== "cut" || this.bladeStage !== "open" || this.strokesTried > 1) showHint([]);
    else if (this.strokesTried === 0)
      showHint([bold(`Drag across the ${this.bodyName}`), `, from one side to the other, to cut it in two. ${hand}`]);
    else showHint([bold("Open"), " moves the cut apart; ", bold("Depth"), ` makes it stop inside. ${hand}`]);
  }

  // ---- The blade's settings ----

  private get bladeLength_m(): number {
    return input("length").valueAsNumber * kLongestBlade * this.stage.bodySize_m;
  }

  private showDepth(): void {
    const share = input("depth").valueAsNumber;
    const length = this.bladeLength_m;
    element("length-text").textContent = `${number(length * 1000)} mm`;
    // A blade that is too short to reach through goes in up to its heel.
    const reaches = length >= kReachesThrough * this.stage.bodySize_m;
    const most = Math.min(0.97 * length, 0.6 * this.stage.bodySize_m);
    const through = share >= 1 && reaches;
    this.mouse.depth_m = through ? null : share * most;
    element("depth-text").textContent = through ? "through" : `${number(share * most * 1000)} mm`;
    this.stage.marks.draw(); // the preview
  }

  private bindSliders(): void {
    const on = (id: string, what: () => void) => input(id).addEventListener("input", what);
    on("depth", () => this.showDepth());
    on("length", () => {
      this.showDepth();
      clearTimeout(this.newBladeTimer);
      this.newBladeTimer = setTimeout(() => {
        if (this.bladeStage === "open") this.takeBlade(true);
      }, kNewBladeAfter_ms);
    });
    on("tilt", () => {
      this.mouse.tilt_rad = (input("tilt").valueAsNumber * Math.PI) / 180;
      element("tilt-text").textContent = `${input("tilt").value}°`;
      this.stage.marks.draw();
    });
    on("open", () => {
      this.openIsChosen = true;
      this.showOpen();
    });
  }
}
