// As much of a browser's page as the page's modules use.

export class FakeElement {
  dataset = {};
  hidden = false;
  textContent = "";
  className = "";
  children = [];
  attributes = {};
  style = { setProperty: () => {} };
  classList = { toggle: () => {} };
  clientWidth = 0;
  clientHeight = 0;
  returnValue = "";
  open = false;
  kind = "";
  listeners = {};
  get firstChild() {
    return this.children[0] ?? null;
  }
  addEventListener(name, listener) {
    (this.listeners[name] ??= []).push(listener);
  }
  dispatchEvent(event) {
    const given = { target: this, preventDefault: () => {}, ...event, type: event.type };
    this[`on${event.type}`]?.(given);
    for (const listener of this.listeners[event.type] ?? []) listener(given);
  }
  click() {
    this.clicks = (this.clicks ?? 0) + 1;
    this.dispatchEvent({ type: "click" });
  }
  append(...children) {
    this.children.push(...children);
    for (const child of children) if (child instanceof FakeElement) child.parent = this;
  }
  replaceChildren(...children) {
    this.children = [];
    this.append(...children);
  }
  remove() {
    this.parent?.children.splice(this.parent.children.indexOf(this), 1);
  }
  setAttribute(name, value) {
    this.attributes[name] = value;
  }
  querySelectorAll() {
    return [];
  }
  setPointerCapture() {}
  closest(selector) {
    return selector === this.kind ? this : null;
  }
  matches(selectors) {
    return selectors.split(", ").includes(this.kind);
  }
  showModal() {
    this.open = true;
  }
  get text() {
    return this.textContent || this.children.map((child) => child.text ?? child).join("");
  }
}

const elements = new Map();
export function byId(id) {
  if (!elements.has(id)) elements.set(id, new FakeElement());
  return elements.get(id);
}
export const noticeTexts = () => byId("notices").children.map((box) => box.children[0].textContent);

export const body = new FakeElement();
const page = new FakeElement();
globalThis.document = {
  body,
  getElementById: byId,
  createElement: () => new FakeElement(),
  visibilityState: "visible",
  addEventListener: (name, listener) => page.addEventListener(`document ${name}`, listener),
};
globalThis.addEventListener = (name, listener) => page.addEventListener(name, listener);
globalThis.matchMedia = () => ({ matches: false, addEventListener: () => {} });
globalThis.HTMLElement = FakeElement;
globalThis.ResizeObserver = class {
  observe() {}
};

/** A key is pressed while `target` has the focus. True: the page took it. */
export function press(key, { target = new FakeElement(), ...more } = {}) {
  let taken = false;
  page.dispatchEvent({ type: "keydown", key, target, preventDefault: () => (taken = true), ...more });
  return taken;
}

export function focusOn(kind) {
  const target = new FakeElement();
  target.kind = kind;
  return target;
}
