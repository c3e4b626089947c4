import { input } from "./dom";

const kKey = "incise-name";
const kDefault = "mouse";

/** Without what a server would not take, or nobody could read; empty: the usual one. */
export function cleaned(name: string | null | undefined): string {
  return [...(name ?? "").replace(/[\p{C}\s]+/gu, " ").trim()].slice(0, 40).join("") || kDefault;
}

/** The name under which this page's blade cuts: that of the link, or what the user has typed. */
export class BladeName {
  private linked: string | undefined;

  constructor(private readonly changed: (name: string) => void) {
    const field = input("blade-name");
    field.value = this.stored;
    field.addEventListener("change", () => {
      if (cleaned(field.value) === this.name) return this.tell(); // as it was, also where it is a link's
      localStorage.setItem(kKey, cleaned(field.value));
      this.linked = undefined;
      this.tell();
    });
    // Esc leaves the field, and the name as it was.
    field.addEventListener("keydown", (e) => {
      if (e.key !== "Escape") return;
      field.value = this.name;
      field.blur();
    });
    this.tell();
  }

  /** What the address keeps; a typed name is not in it. */
  get inLink(): string | undefined {
    return this.linked;
  }

  /** name: of a link; undefined: it has none. */
  follow(name: string | undefined): void {
    this.linked = name && cleaned(name);
    this.tell();
  }

  private get stored(): string {
    return cleaned(localStorage.getItem(kKey));
  }

  private get name(): string {
    return this.linked ?? this.stored;
  }

  private tell(): void {
    input("blade-name").value = this.name;
    this.changed(this.name);
  }
}
