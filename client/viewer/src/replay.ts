import type { ReplayFacts, ToWorker } from "./messages";

const element = <T extends HTMLElement = HTMLElement>(id: string): T => document.getElementById(id) as T;

/** What a server with tokens asks for beside the stream. */
export const bearer = (token: string): HeadersInit => (token ? { Authorization: `Bearer ${token}` } : {});

/** The list of recordings and the controls of the one that is played. */
export class Replay {
  facts: ReplayFacts | null = null;
  private scrubbing = false;

  constructor(private readonly send: (message: ToWorker) => void) {
    const speed = () => Number(element<HTMLSelectElement>("speed").value);
    const scrub = element<HTMLInputElement>("scrub");
    element("play").onclick = () => send({ kind: "replay", action: this.facts?.playing ? "pause" : "play", speed: speed() });
    element("step").onclick = () => send({ kind: "replay", action: "step" });
    element("replay-close").onclick = () => send({ kind: "replay", action: "close" });
    element("speed").onchange = () => {
      if (this.facts?.playing) send({ kind: "replay", action: "play", speed: speed() });
    };
    scrub.oninput = () => {
      this.scrubbing = true;
      this.showPlace(scrub.valueAsNumber);
    };
    scrub.onchange = () => {
      this.scrubbing = false;
      send({ kind: "replay", action: "seek", revision: scrub.valueAsNumber });
    };
  }

  /** Asks the server what recordings it offers. */
  async list(token: string): Promise<void> {
    try {
      const answer = await fetch("captures", { cache: "no-store", headers: bearer(token) });
      if (!answer.ok) return;
      const names: string[] = await answer.json();
      element("recordings").hidden = names.length === 0;
      element("captures").replaceChildren(...names.map((name) => {
        const item = document.createElement("li");
        const button = document.createElement("button");
        button.className = "text";
        button.textContent = name.replace(/\.capture$/, "");
        button.onclick = () => this.send({ kind: "replay", action: "open", capture: name });
        item.append(button);
        return item;
      }));
    } catch {
      // The state of the connection says it already.
    }
  }

  show(facts: ReplayFacts | null): void {
    this.facts = facts?.capture ? facts : null;
    element("player").hidden = this.facts === null;
    if (!this.facts) return;
    const { playing, revision, lastRevision } = this.facts;
    element("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    element("play-icon").setAttribute("d", playing ? "M7 5h4v14H7zM13 5h4v14h-4z" : "M8 5v14l11-7z");
    const scrub = element<HTMLInputElement>("scrub");
    scrub.max = String(lastRevision);
    if (!this.scrubbing) {
      scrub.valueAsNumber = revision;
      this.showPlace(revision);
    }
  }

  private showPlace(revision: number): void {
    element("scrub-text").textContent = `${revision} / ${this.facts?.lastRevision ?? 0}`;
  }
}
