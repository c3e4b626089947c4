import { element } from "./dom";

export interface Key {
  keys: string[]; // as in KeyboardEvent.key, letters in lower case; arrows and page keys with Shift as "Shift ArrowLeft"
  shown: string; // in the help
  does: string;
  act: (key: string) => void;
  needs?: () => boolean; // else the key does nothing
}

/** The key for the page, or null if the focused control uses it. */
function wantedKey(e: KeyboardEvent): string | null {
  const target = e.target as HTMLElement;
  if ((e.ctrlKey || e.metaKey) && !e.altKey && !e.shiftKey && e.key.toLowerCase() === "z") return "z";
  if (
    e.ctrlKey ||
    e.metaKey ||
    e.altKey ||
    target.closest("dialog") ||
    target.matches("select, input[type=password], input[type=text]")
  )
    return null;
  const moves = e.key.startsWith("Arrow") || e.key.startsWith("Page");
  if (target.matches("input[type=range], input[type=radio]") && moves) return null;
  if (e.shiftKey && moves) return `Shift ${e.key}`;
  return e.key.length === 1 ? e.key.toLowerCase() : e.key; // also with Shift or Caps Lock
}

/** The keyboard, and the dialog that lists its keys. */
export class Keys {
  private readonly byKey = new Map<string, Key>();

  constructor(keys: Key[]) {
    for (const key of [...keys, { keys: ["?"], shown: "?", does: "This help", act: () => this.help() }]) {
      for (const name of key.keys) this.byKey.set(name, key);
    }
    element("help").onclick = () => this.help();
    const rows = [...new Set(this.byKey.values())].map(({ shown, does }) => {
      const row = document.createElement("div");
      const term = document.createElement("dt");
      const what = document.createElement("dd");
      term.append(...shown.split(" ").map((key) => Object.assign(document.createElement("kbd"), { textContent: key })));
      what.textContent = does;
      row.append(term, what);
      return row;
    });
    element("keys").replaceChildren(...rows);
    addEventListener("keydown", (e) => this.press(e));
  }

  private press(e: KeyboardEvent): void {
    const name = wantedKey(e);
    const key = name === null ? undefined : this.byKey.get(name);
    if (!key || key.needs?.() === false) return;
    key.act(name!);
    e.preventDefault();
  }

  private help(): void {
    const dialog = element<HTMLDialogElement>("help-dialog");
    dialog.showModal();
    element("keys").scrollTop = 0;
  }
}
