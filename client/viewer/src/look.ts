import type { Colouring } from "./body_mesh";
import { choose, element, input, onChoice } from "./dom";
import { axisFacing, mirrored, sideFacing } from "./section";
import type { Stage } from "./stage";
import type { ViewState } from "./view_link";

const kNarrow_px = 760; // as in style.css
const kPanelOpen_px = 1000; // a window at least this wide starts with the panel open

/** How the picture and the page look: colours, wireframe, section, theme, panel. */
export class Look {
  private axis = 0;
  private side = 1;
  private colouring: Colouring = "tissue";

  /** redraw: called when the charts' size or colours have changed. */
  constructor(
    private readonly stage: Stage,
    private readonly colourByQuality: (on: boolean) => void,
    private readonly redraw: () => void,
  ) {
    onChoice("colouring", (value) => this.setColouring(value as Colouring));
    input("wire").addEventListener("change", () => {
      stage.body.setWire(input("wire").checked);
      stage.draw();
    });
    this.bindSection();
    element("panel-toggle").onclick = () => this.togglePanel();
    element("theme").onclick = () => this.setTheme(this.theme === "light" ? "dark" : "light");
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => this.setTheme(this.storedTheme));
    addEventListener("resize", () => this.measureCover());
    this.setTheme(this.storedTheme);
    this.togglePanel(innerWidth > kPanelOpen_px);
  }

  get narrow(): boolean {
    return innerWidth <= kNarrow_px;
  }

  /** What a link keeps of it. */
  get state(): ViewState {
    const section = input("section").checked
      ? { axis: this.axis, side: this.side, share: input("section-at").valueAsNumber }
      : undefined;
    return { section, colours: this.colouring, theme: this.theme };
  }

  /** Shows what a link has kept; a theme that comes so is not the user's choice and is not stored. */
  showState({ section, colours, theme }: ViewState): void {
    if (theme) this.showTheme(theme === "light");
    if (colours) {
      choose("colouring", colours);
      this.setColouring(colours);
    }
    input("section").checked = section !== undefined;
    if (section) {
      this.axis = section.axis;
      this.side = section.side;
      choose("section-axis", "xyz"[section.axis]);
      input("section-at").valueAsNumber = section.share;
    }
    this.showSection();
  }

  togglePanel(open = document.body.dataset.panel === "closed"): void {
    document.body.dataset.panel = open ? "open" : "closed";
    element("panel-toggle").setAttribute("aria-expanded", String(open));
    this.measureCover();
    this.redraw();
  }

  private setColouring(colouring: Colouring): void {
    this.colouring = colouring;
    this.stage.body.setColouring(colouring);
    element("quality-scale").hidden = colouring !== "quality";
    this.colourByQuality(colouring === "quality");
    this.stage.draw();
  }

  private showSection(): void {
    const { section } = this.state;
    element("section-rows").hidden = !section;
    this.stage.setSection(section ?? null);
  }

  private bindSection(): void {
    const show = () => this.showSection();
    const face = (axis: number) => {
      this.axis = axis;
      this.side = sideFacing(this.stage.toEye, axis);
      choose("section-axis", "xyz"[axis]);
      show();
    };
    input("section").addEventListener("change", () =>
      input("section").checked ? face(axisFacing(this.stage.toEye)) : show(),
    );
    onChoice("section-axis", (value) => face("xyz".indexOf(value)));
    input("section-at").addEventListener("input", show);
    // The other half is looked at from the other side, or its skin would hide the section.
    element("section-flip").onclick = () => {
      this.stage.lookFrom(mirrored(this.stage.toEye, this.axis));
      this.side = -this.side;
      show();
    };
  }

  /** The body is shown in the part of the picture that no panel covers. */
  private measureCover(): void {
    const panel = document.body.dataset.panel !== "closed" && !this.narrow;
    this.stage.setCover({
      left: 0,
      right: panel ? innerWidth - element("panel").offsetLeft : 0,
      top: 0.6 * element("title").offsetHeight,
      bottom: innerHeight - element("tools").offsetTop,
    });
    document.body.style.setProperty("--tools-top", `${innerHeight - element("tools").offsetTop}px`);
    document.body.style.setProperty("--free-middle", `${(panel ? element("panel").offsetLeft : innerWidth) / 2}px`);
  }

  private get storedTheme(): string {
    return localStorage.getItem("incise-theme") ?? "auto";
  }

  private get theme(): "light" | "dark" {
    return document.documentElement.dataset.theme === "light" ? "light" : "dark";
  }

  private setTheme(theme: string): void {
    if (theme !== "auto") localStorage.setItem("incise-theme", theme);
    this.showTheme(theme === "light" || (theme === "auto" && matchMedia("(prefers-color-scheme: light)").matches));
  }

  private showTheme(light: boolean): void {
    document.documentElement.dataset.theme = light ? "light" : "dark";
    const colour = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    this.stage.setInk(light ? 0x7c8b9a : 0xb8c6d4, light ? 0.26 : 0.55, light ? 1.25 : 1, [
      colour("--back-a"),
      colour("--back-b"),
    ]);
    this.redraw();
  }
}
