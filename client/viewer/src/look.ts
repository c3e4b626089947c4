import type { Colouring } from "./body_mesh";
import { choose, element, input, onChoice } from "./dom";
import { axisFacing, mirrored, sideFacing } from "./section";
import type { Stage } from "./stage";

const kNarrow_px = 760; // as in style.css
const kPanelOpen_px = 1000; // a window at least this wide starts with the panel open

/** How the picture and the page look: colours, wireframe, section, theme, panel. */
export class Look {
  private axis = 0;
  private side = 1;

  /** redraw: called when the charts' size or colours have changed. */
  constructor(
    private readonly stage: Stage,
    colourByQuality: (on: boolean) => void,
    private readonly redraw: () => void,
  ) {
    onChoice("colouring", (value) => {
      stage.body.setColouring(value as Colouring);
      element("quality-scale").hidden = value !== "quality";
      colourByQuality(value === "quality");
      stage.draw();
    });
    input("wire").addEventListener("change", () => {
      stage.body.setWire(input("wire").checked);
      stage.draw();
    });
    this.bindSection();
    element("panel-toggle").onclick = () => this.togglePanel();
    element("theme").onclick = () =>
      this.setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => this.setTheme(this.storedTheme));
    addEventListener("resize", () => this.measureCover());
    this.setTheme(this.storedTheme);
    this.togglePanel(innerWidth > kPanelOpen_px);
  }

  get narrow(): boolean {
    return innerWidth <= kNarrow_px;
  }

  togglePanel(open = document.body.dataset.panel === "closed"): void {
    document.body.dataset.panel = open ? "open" : "closed";
    element("panel-toggle").setAttribute("aria-expanded", String(open));
    this.measureCover();
    this.redraw();
  }

  private bindSection(): void {
    const show = () => {
      const on = input("section").checked;
      element("section-rows").hidden = !on;
      this.stage.setSection(on ? { axis: this.axis, side: this.side, share: input("section-at").valueAsNumber } : null);
    };
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

  private setTheme(theme: string): void {
    if (theme !== "auto") localStorage.setItem("incise-theme", theme);
    const light = theme === "light" || (theme === "auto" && matchMedia("(prefers-color-scheme: light)").matches);
    document.documentElement.dataset.theme = light ? "light" : "dark";
    const colour = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    this.stage.setInk(light ? 0x7c8b9a : 0xb8c6d4, light ? 0.26 : 0.55, light ? 1.25 : 1, [
      colour("--back-a"),
      colour("--back-b"),
    ]);
    this.redraw();
  }
}
