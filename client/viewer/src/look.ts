import { Vector3 } from "three";
import type { Colouring } from "./body_mesh";
import { choose, element, input, onChoice } from "./dom";
import { across, axisFacing, axisOf, mirrored, otherHalf, type Section } from "./section";
import { SectionHandle } from "./section_handle";
import type { Stage } from "./stage";
import type { ViewState } from "./view_link";

const kNarrow_px = 760; // as in style.css
const kPanelOpen_px = 1000; // a window at least this wide starts with the panel open

/** How the picture and the page look: colours, wireframe, section, theme, panel. */
export class Look {
  private section: Section = { normal: [1, 0, 0], share: 0.5 }; // also while it is off
  readonly handle: SectionHandle;
  private colouring: Colouring = "tissue";
  private image = false; // wanted
  private roomy = innerWidth > kPanelOpen_px;
  private makesRoom = false; // the panel was open before the window became narrower

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
    onChoice("inside", (value) => this.showImage(value === "image"));
    this.handle = new SectionHandle(element("picture"), stage, (section) => this.setSection(section));
    this.bindSection();
    element("panel-toggle").onclick = () => this.togglePanel();
    element("theme").onclick = () => this.setTheme(this.theme === "light" ? "dark" : "light");
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => this.setTheme(this.storedTheme));
    addEventListener("resize", () => this.resized());
    this.setTheme(this.storedTheme);
    this.togglePanel(this.roomy);
  }

  get narrow(): boolean {
    return innerWidth <= kNarrow_px;
  }

  /** The panel closes where the window would start without it, and comes back with the room; the body stays in view. */
  private resized(): void {
    this.followWidth();
    this.measureCover();
    this.stage.refit();
  }

  private followWidth(): void {
    const roomy = innerWidth > kPanelOpen_px;
    if (roomy === this.roomy) return;
    this.roomy = roomy;
    const comesBack = this.makesRoom;
    this.makesRoom = !roomy && document.body.dataset.panel === "open";
    if (!roomy || comesBack) this.togglePanel(roomy);
  }

  /** What a link keeps of it. */
  get state(): ViewState {
    const section = input("section").checked ? this.section : undefined;
    return { section, colours: this.colouring, theme: this.theme, inside: this.image ? "image" : "tissue" };
  }

  /** Shows what a link has kept; a theme that comes so is not the user's choice and is not stored. */
  showState({ section, colours, theme, inside }: ViewState): void {
    this.showImage(inside === "image");
    if (theme) this.showTheme(theme === "light");
    if (colours) {
      choose("colouring", colours);
      this.setColouring(colours);
    }
    input("section").checked = section !== undefined;
    if (section) this.section = section;
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

  /** Whether the server has a volume image. */
  offerImage(has: boolean): void {
    element("inside-row").hidden = !has;
  }

  toggleImage(): void {
    this.showImage(!this.image);
  }

  private showImage(on: boolean): void {
    this.image = on;
    choose("inside", on ? "image" : "tissue");
    this.stage.body.showImage(on);
    this.stage.draw();
  }

  /** A key's step: 5 degrees to the right or upwards in the picture. */
  turnSection(right: number, up: number): void {
    this.handle.turn((right * Math.PI) / 36, (-up * Math.PI) / 36);
  }

  /** A key's step along the plane's normal. */
  moveSection(by: number): void {
    this.handle.move(0.02 * by);
  }

  private setSection(section: Section): void {
    this.section = section;
    this.showSection();
  }

  private showSection(): void {
    const { section } = this.state;
    element("section-rows").hidden = !section;
    choose("section-axis", "xyz"[axisOf(this.section.normal)] ?? "");
    input("section-at").valueAsNumber = this.section.share;
    if (!section) this.handle.drop();
    this.stage.setSection(section ?? null);
  }

  private bindSection(): void {
    const { stage } = this;
    const face = (axis: number) => this.setSection({ ...this.section, normal: across(axis, stage.toEye) });
    input("section").addEventListener("change", () =>
      input("section").checked ? face(axisFacing(stage.toEye)) : this.showSection(),
    );
    onChoice("section-axis", (value) => face("xyz".indexOf(value)));
    input("section-at").addEventListener("input", () =>
      this.setSection({ ...this.section, share: input("section-at").valueAsNumber }),
    );
    element("section-view").onclick = () => {
      const normal = new Vector3(...stage.toEye).normalize().toArray();
      this.setSection({ ...this.section, normal });
    };
    // The other half is looked at from the other side, or its skin would hide the section.
    element("section-flip").onclick = () => {
      stage.lookFrom(mirrored(stage.toEye, this.section.normal));
      this.setSection(otherHalf(this.section));
    };
  }

  /** The body is shown in the part of the picture that no panel covers. */
  measureCover(): void {
    const player = element("player").hidden ? null : element("player");
    const panel = document.body.dataset.panel !== "closed" && !this.narrow;
    // First, since it gives the tools their width, and so their lines.
    document.body.style.setProperty("--free-middle", `${(panel ? element("panel").offsetLeft : innerWidth) / 2}px`);
    document.body.style.setProperty("--tools-top", `${innerHeight - element("tools").offsetTop}px`);
    this.stage.setCover({
      left: 0,
      right: panel ? innerWidth - element("panel").offsetLeft : 0,
      top: 0.6 * element("title").offsetHeight,
      bottom: innerHeight - (player ?? element("tools")).offsetTop,
    });
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
