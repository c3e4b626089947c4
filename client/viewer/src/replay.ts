import { element, input } from "./dom";
import type { ReplayFacts, ToWorker } from "./messages";

/** The header that a server with tokens requires outside the stream. */
export const bearer = (token: string): HeadersInit => (token ? { Authorization: `Bearer ${token}` } : {});

/** The list of recordings and the controls of the one that is played. */
export class Replay {
  facts: ReplayFacts | null = null;
  private scrubbing = false;
  private resume = false; // it played when the scrubbing began
  private asked: number | null = null; // a revision that was asked for, until the server has answered
  private wanted: number | null = null; // the next one to ask for

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
      this.showPlace(scrub.valueAsNumber);
      this.seek(scrub.valueAsNumber);
    };
    scrub.onchange = () => {
      this.scrubbing = false;
      this.seek(scrub.valueAsNumber);
      if (this.resume) send({ kind: "replay", action: "play", speed: speed() });
      this.resume = false;
    };
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
    scrub.max = String(lastRevision);
    if (!this.scrubbing) {
      scrub.valueAsNumber = revision;
      this.showPlace(revision);
    }
    if (this.wanted !== null) this.seek(this.wanted);
  }

  /** One request at a time: the server would go to every revision that the slider passes. */
  private seek(revision: number): void {
    this.wanted = null;
    if (revision === (this.asked ?? this.facts?.revision)) return;
    if (this.asked !== null) {
      this.wanted = revision;
      return;
    }
    this.asked = revision;
    this.send({ kind: "replay", action: "seek", revision });
  }

  private showPlace(revision: number): void {
    element("scrub-text").textContent = `${revision} / ${this.facts?.lastRevision ?? 0}`;
  }
}
