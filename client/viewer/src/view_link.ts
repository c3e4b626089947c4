import type { Colouring } from "./body_mesh";
import type { Vec3 } from "./messages";
import type { Section } from "./section";

/** What the address keeps of a view, after its "#". Parts that are missing or make no sense are left out. */
export interface ViewState {
  camera?: { body: string; position: Vec3; target: Vec3 }; // metres; of the body with this name, or of any if it is empty
  section?: Section;
  colours?: Colouring;
  theme?: "light" | "dark";
  inside?: "tissue" | "image"; // on cut faces and in the section
  name?: string; // of the page's blade
}

const kColours: readonly string[] = ["tissue", "pieces", "quality"] satisfies Colouring[];
const kLongest = 1000; // characters

const written = (place: Vec3) => place.map((x) => Number(x.toPrecision(6))).join();

export function toFragment({ camera, section, colours, theme, inside, name }: ViewState): string {
  const parts: string[] = [];
  if (camera) {
    parts.push(`body=${encodeURIComponent(camera.body)}`);
    parts.push(`from=${written(camera.position)}`, `to=${written(camera.target)}`);
  }
  if (section) parts.push(`section=${[...section.normal, section.share].map((x) => Number(x.toFixed(4))).join()}`);
  if (colours) parts.push(`colours=${colours}`);
  if (theme) parts.push(`theme=${theme}`);
  if (inside === "image") parts.push("inside=image");
  if (name) parts.push(`name=${encodeURIComponent(name)}`);
  return parts.join("&");
}

export function fromFragment(fragment: string): ViewState {
  const state: ViewState = {};
  if (fragment.length > kLongest) return state;
  const fields = new URLSearchParams(fragment.replace(/^#/, ""));
  const position = place(fields.get("from")),
    target = place(fields.get("to"));
  if (position && target && position.some((x, i) => x !== target[i]))
    state.camera = { body: fields.get("body") ?? "", position, target };
  const section = sectionOf(fields.get("section"));
  if (section) state.section = section;
  const colours = fields.get("colours") ?? "";
  if (kColours.includes(colours)) state.colours = colours as Colouring;
  const theme = fields.get("theme");
  if (theme === "light" || theme === "dark") state.theme = theme;
  if (fields.get("inside") === "image") state.inside = "image";
  const name = fields.get("name");
  if (name) state.name = name;
  return state;
}

/** The numbers of a list with commas; null: not all are finite numbers. */
function numbers(text: string): number[] | null {
  const parts = text.split(",");
  const values = parts.map(Number);
  return parts.every((part, i) => part.trim() !== "" && Number.isFinite(values[i])) ? values : null;
}

function place(text: string | null): Vec3 | null {
  const values = numbers(text ?? "");
  return values?.length === 3 && values.every((x) => Math.abs(x) < 1e6) ? [values[0], values[1], values[2]] : null;
}

function sectionOf(text: string | null): Section | null {
  const values = numbers(text ?? "");
  if (values?.length !== 4) return null;
  const [x, y, z, share] = values;
  const length = Math.hypot(x, y, z);
  if (Math.abs(length - 1) > 0.01 || share < 0 || share > 1) return null;
  return { normal: [x / length, y / length, z / length], share };
}
