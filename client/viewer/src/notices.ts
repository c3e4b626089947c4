import { element } from "./dom";

const kShown_ms = 8000;

/** Shows a text at the top of the page for a while, with a button if there is an action. Returns a function to take it away. */
export function notice(text: string, action?: string, act?: () => void): () => void {
  const box = document.createElement("div");
  box.className = "notice glass";
  const words = document.createElement("p");
  words.textContent = text;
  box.append(words);
  if (action && act) {
    const button = document.createElement("button");
    button.className = "primary";
    button.textContent = action;
    button.onclick = () => {
      box.remove();
      act();
    };
    box.append(button);
  }
  const list = element("notices");
  for (const old of [...list.children]) if (old.firstChild?.textContent === text) old.remove();
  list.append(box);
  const remove = () => box.remove();
  setTimeout(remove, action ? 3 * kShown_ms : kShown_ms);
  return remove;
}

/** Shows what to do next; empty: hides the hint. */
export function showHint(parts: (string | HTMLElement)[]): void {
  element("hint").hidden = parts.length === 0;
  element("hint-text").replaceChildren(...parts);
}

export function bold(text: string): HTMLElement {
  const b = document.createElement("b");
  b.textContent = text;
  return b;
}
