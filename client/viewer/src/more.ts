import { element, save } from "./dom";
import type { Key } from "./keys";
import { notice } from "./notices";
import type { Stage } from "./stage";
import { kViews } from "./views";

/** The menu More: standard views, and files of what is seen. */
export class More {
  private readonly menu = element<HTMLDetailsElement>("more");

  /** fileName: without its ending. */
  constructor(
    private readonly stage: Stage,
    private readonly fileName: () => string,
  ) {
    for (const button of element("views").querySelectorAll("button"))
      button.onclick = () => stage.lookFrom(kViews[button.dataset.view!]);
    this.bind("save-picture", () => void this.save("png", () => stage.picture()));
    this.bind(
      "save-glb",
      () => void this.save("glb", async () => (await import("./glb")).toGlb(stage.body, fileName())),
    );
    addEventListener("pointerdown", (e) => {
      if (!this.menu.contains(e.target as Node)) this.menu.open = false;
    });
  }

  keys(): Key[] {
    const views = Object.values(kViews);
    const digits = views.map((_, i) => String(i + 1));
    return [
      {
        keys: digits,
        shown: digits.join(" "),
        does: `View: ${Object.keys(kViews).join(", ")}`,
        act: (key) => this.stage.lookFrom(views[Number(key) - 1]),
      },
      { keys: ["i"], shown: "I", does: "Save a picture", act: () => element("save-picture").click() },
      { keys: ["g"], shown: "G", does: "Save as GLB", act: () => element("save-glb").click() },
    ];
  }

  /** Escape closes the menu; false: it was not open. */
  close(): boolean {
    const { open } = this.menu;
    this.menu.open = false;
    return open;
  }

  /** An entry of the menu that closes it. */
  bind(id: string, act: () => void): void {
    element(id).onclick = () => {
      this.menu.open = false;
      act();
    };
  }

  private async save(ending: string, content: () => Promise<BlobPart>): Promise<void> {
    const name = `${this.fileName().replace(/[^\w.-]+/g, "_")}.${ending}`;
    try {
      save(await content(), name);
    } catch (error) {
      notice(`${name} could not be saved: ${error instanceof Error ? error.message : error}.`);
    }
  }
}
