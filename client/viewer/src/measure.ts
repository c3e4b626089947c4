import { number } from "./dom";
import type { Marks } from "./marks";
import { notice } from "./notices";
import { follow, type Hit, type Place, placeOn } from "./pick";
import type { Stage } from "./stage";

const kClick_px = 4; // a hand that moves farther turns the body

export const inMm = (length_m: number) => `${number(length_m * 1000, length_m < 0.01 ? 2 : 1)} mm`;

/**
 * Lengths between places that are clicked on the surface, and areas of cuts. The places stay on their triangles and move
 * with them; lengths are those of the body, not of its opened picture.
 */
export class Measure {
  active = false; // clicks set places
  /** What the picture says, for tests and for screen readers. */
  labels: string[] = [];
  private readonly places: Place[] = [];
  private cut: { place: Place; area_m2: number } | null = null;
  private down: [number, number] | null = null;

  /** askArea: asks for the area of the cut that has this half-face. */
  constructor(
    private readonly canvas: HTMLElement,
    private readonly stage: Stage,
    private readonly askArea: (halfFace: number) => void,
  ) {
    canvas.addEventListener("pointerdown", (e) => {
      this.down = this.active && e.button === 0 && e.isPrimary ? [e.clientX, e.clientY] : null;
    });
    canvas.addEventListener("pointerup", (e) => {
      const { down } = this;
      this.down = null;
      if (!this.active || !down || Math.hypot(e.clientX - down[0], e.clientY - down[1]) > kClick_px) return;
      const box = this.canvas.getBoundingClientRect();
      const x = (2 * (e.clientX - box.left)) / box.width - 1;
      this.click(this.stage.pick(x, 1 - (2 * (e.clientY - box.top)) / box.height));
    });
  }

  get shown(): boolean {
    return this.places.length > 0;
  }

  /** Also of a click whose button is still held. */
  clear(): void {
    this.down = null;
    this.places.length = 0;
    this.cut = null;
    this.refresh();
  }

  /** The body has changed. */
  follow(): void {
    if (!this.shown) return;
    const { body } = this.stage;
    const before = this.places.length;
    const left = this.places.filter((place) => follow(body, place));
    this.places.splice(0, before, ...left);
    if (this.cut && !(follow(body, this.cut.place) && body.shown(0).isCut(this.cut.place.slot))) this.cut = null;
    if (this.cut) this.askArea(this.cut.place.halfFace);
    if (left.length < before) notice("A measured point is gone: its triangle was cut or removed.");
    this.refresh();
  }

  onArea(halfFace: number, area_m2: number): void {
    if (this.cut?.place.halfFace !== halfFace) return;
    this.cut.area_m2 = area_m2;
    this.refresh();
  }

  draw(marks: Marks): void {
    const { body, openNow } = this.stage;
    const at = this.places.map((place) => placeOn(body, place, openNow));
    for (let i = 1; i < at.length; ++i) marks.line(at[i - 1], at[i]);
    for (const place of at) marks.dot(place);
    const [length, area] = this.labels;
    if (at.length > 1) marks.label(at[at.length - 1], length);
    if (this.cut && this.cut.area_m2 > 0)
      marks.label(placeOn(body, this.cut.place, openNow), at.length > 1 ? area : length);
  }

  private click(hit: Hit | null): void {
    if (!hit) return;
    const { slot, halfFace, weights } = hit;
    this.places.push({ slot, halfFace, weights });
    this.cut = hit.isCut ? { place: this.places[this.places.length - 1], area_m2: 0 } : null;
    if (this.cut) this.askArea(halfFace);
    this.refresh();
  }

  private refresh(): void {
    const rest = this.places.map((place) => placeOn(this.stage.body, place, 0));
    let total = 0;
    for (let i = 1; i < rest.length; ++i) total += rest[i].distanceTo(rest[i - 1]);
    this.labels = rest.length > 1 ? [inMm(total)] : [];
    if (this.cut && this.cut.area_m2 > 0) this.labels.push(`${number(this.cut.area_m2 * 1e4, 2)} cm²`);
    this.stage.draw();
  }
}
