import { element, input } from "./dom";
import { cssColour } from "./blade_colours";
import type { ReplayFacts, ToWorker } from "./messages";
import { type Bar, barsOf, type Revisions, revisionAt, seconds, strokeFrom, Timeline, timeOf } from "./timeline";

/** The header that a server with tokens requires outside the stream. */
export const bearer = (token: string): HeadersInit => (token ? { Authorization: `Bearer ${token}` } : {});

/** The list of recordings and the controls of the one that is played. */
export class Replay {
  facts: ReplayFacts | null = null;
  private scrubbing = false;
  private resume = false; // it played when the scrubbing began
  private asked: number | null = null; // a revision that was asked for, until the server has answered
  private wanted: number | null = null; // the next one to ask for
  private revisions: Revisions | null = null; // of the recording; without, the slider goes by revision
  private bars: Bar[] = [];
  private readonly timeline = new Timeline(
    element<HTMLCanvasElement>("strokes"),
    input("scrub"),
    (bar) => cssColour(bar.source, false),
    (bar) =>
      `Stroke ${bar.stroke} of blade ${bar.source + 1}: ${seconds(bar.from_ms)} to ${seconds(bar.to_ms)} s, revisions ${bar.first} to ${bar.last}`,
    "Go to a moment: drag, or arrow keys for single batches, PgUp and PgDn for strokes",
  );

  /** listUrl: where the names of the recordings are, as JSON. */
  constructor(
    private readonly send: (message: ToWorker) => void,
    private readonly listUrl = "captures",
  ) {
    const speed = () => Number(element<HTMLSelectElement>("speed").value);
    const scrub = input("scrub");
    element("play").onclick = () =>
      send({ kind: "replay", action: this.facts?.playing ? "pause" : "play", speed: speed() });
    element("step").onclick = () => send({ kind: "replay", action: "step" });
    element("replay-close").onclick = () => send({ kind: "replay", action: "close" });
    element("speed").onchange = () => {
      if (this.facts?.playing) send({ kind: "replay", action: "play", speed: speed() });
    };
    scrub.oninput = () => {
      if (!this.scrubbing) {
        this.scrubbing = true;
        this.resume = this.facts?.playing === true;
        if (this.resume) send({ kind: "replay", action: "pause" });
      }
      this.showPlace(this.revisionOf(scrub.valueAsNumber), scrub.valueAsNumber);
      this.go(this.revisionOf(scrub.valueAsNumber));
    };
    scrub.onchange = () => {
      this.scrubbing = false;
      this.go(this.revisionOf(scrub.valueAsNumber));
      if (this.resume) send({ kind: "replay", action: "play", speed: speed() });
      this.resume = false;
    };
    scrub.onkeydown = (e) => this.press(e);
  }

  /** Keys of the slider. */
  private press(e: KeyboardEvent): void {
    if (!this.facts) return;
    const at = this.wanted ?? this.asked ?? this.facts.revision;
    const { lastRevision } = this.facts;
    const to: Record<string, () => number> = {
      ArrowLeft: () => at - 1,
      ArrowDown: () => at - 1,
      ArrowRight: () => at + 1,
      ArrowUp: () => at + 1,
      PageUp: () => strokeFrom(this.bars, at, -1, lastRevision),
      PageDown: () => strokeFrom(this.bars, at, 1, lastRevision),
      Home: () => 0,
      End: () => lastRevision,
    };
    if (!to[e.key]) return;
    e.preventDefault();
    this.go(Math.min(lastRevision, Math.max(0, to[e.key]())));
  }

  /** Where the slider is at this revision. */
  placeOf(revision: number): number {
    return this.revisions ? timeOf(this.revisions, revision) : revision;
  }

  private revisionOf(place: number): number {
    return this.revisions ? revisionAt(this.revisions, place) : place;
  }

  draw(): void {
    this.timeline.draw();
  }

  /** Asks what recordings there are. */
  async list(token: string): Promise<void> {
    try {
      const answer = await fetch(this.listUrl, { cache: "no-store", headers: bearer(token) });
      if (!answer.ok) return;
      const names: string[] = await answer.json();
      element("recordings").hidden = names.length === 0;
      element("captures").replaceChildren(
        ...names.map((name) => {
          const item = document.createElement("li");
          const button = document.createElement("button");
          button.className = "text";
          button.textContent = name.replace(/\.capture$/, "");
          button.onclick = () => this.send({ kind: "replay", action: "open", capture: name });
          item.append(button);
          return item;
        }),
      );
    } catch {
      // The state of the connection is shown anyway.
    }
  }

  show(facts: ReplayFacts | null): void {
    this.facts = facts?.capture ? facts : null;
    element("player").hidden = this.facts === null;
    if (!this.facts || facts?.timeline) this.setTimeline(facts?.timeline ?? null);
    this.asked = null;
    if (!this.facts) {
      this.scrubbing = this.resume = false;
      this.wanted = null;
      return;
    }
    const { playing, revision, lastRevision } = this.facts;
    element("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    element("play-icon").setAttribute("d", playing ? "M7 5h4v14H7zM13 5h4v14h-4z" : "M8 5v14l11-7z");
    const scrub = input("scrub");
    scrub.max = String(this.placeOf(lastRevision));
    if (!this.scrubbing) {
      scrub.valueAsNumber = this.placeOf(revision);
      this.showPlace(revision, this.placeOf(revision));
    }
    if (this.wanted !== null) this.go(this.wanted);
  }

  private setTimeline(revisions: Revisions | null): void {
    this.revisions = revisions;
    this.bars = revisions ? barsOf(revisions) : [];
    element("player").dataset.timeline = revisions ? "on" : "off";
    if (revisions) this.timeline.show(this.bars, 0, timeOf(revisions, revisions.ms.length));
  }

  /** One request at a time: the server would go to every revision that the slider passes. */
  go(revision: number): void {
    this.wanted = null;
    if (revision === (this.asked ?? this.facts?.revision)) return;
    if (this.asked !== null) {
      this.wanted = revision;
      return;
    }
    this.asked = revision;
    this.send({ kind: "replay", action: "seek", revision });
  }

  private showPlace(revision: number, place: number): void {
    const last = this.facts?.lastRevision ?? 0;
    const when = this.revisions ? `${seconds(place)} / ${seconds(this.placeOf(last))} s · ` : "";
    element("scrub-text").textContent = `${when}${revision} / ${last}`;
  }
}
