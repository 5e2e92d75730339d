// As much of a document as the page's parts are drawn with: elements with their children, properties and listeners.

class Element {
  children = []; dataset = {}; attributes = {}; listeners = {}; id = ""; className = ""; value = ""; textContent = ""; disabled = false; hidden = false; open = false;
  style = { setProperty: () => {} };
  classList = {
    remove: (name) => { this.className = this.#classes.filter((own) => own !== name).join(" "); },
    toggle: (name, is) => { this.className = [...this.#classes.filter((own) => own !== name), ...(is ? [name] : [])].join(" "); },
  };
  #parent;

  constructor(tag) { this.tag = tag; }
  get #classes() { return this.className.split(" "); }
  append(...parts) {
    this.children.push(...parts);
    for (const part of parts) if (part instanceof Element) part.#parent = this;
  }
  replaceChildren(...parts) { this.children = []; this.append(...parts); }
  remove() { this.#parent.children = this.#parent.children.filter((child) => child !== this); }
  setAttribute(name, value) { this.attributes[name] = value; }
  addEventListener(kind, listener) { this.listeners[kind] = listener; }
  contains() { return false; }
  scrollIntoView() {}
  get lastElementChild() { return this.children.at(-1); }
  /** Those of a select. */
  get options() { return this.children; }
  querySelector() { return null; }
  /** Those within that have a class, `.name`. */
  querySelectorAll(selector) { return this.all.filter((part) => part !== this && part.#classes.includes(selector.slice(1))); }
  showModal() { this.open = true; }
  close() { this.open = false; }
  /** What a click does, unless the element is off. */
  click() { return this.disabled ? undefined : this.listeners.click?.({ currentTarget: this }); }
  get all() { return [this, ...this.children.flatMap((child) => child.all ?? [])]; }
  /** All that is written in it. */
  get text() { return [this.textContent, ...this.children.map((child) => child.text ?? child)].join(" "); }
}

/** A document in which every id that is asked for is there. */
export function makeDocument() {
  const known = new Map();
  const byId = (id) => known.get(id) ?? known.set(id, new Element("div")).get(id);
  const [documentElement, body] = [new Element("html"), new Element("body")];
  globalThis.document = { createElement: (tag) => new Element(tag), getElementById: byId, activeElement: null, addEventListener: () => {}, documentElement, body };
  return byId;
}

/** The element with an id within another. */
export const within = (element, id) => element.all.find((part) => part.id === id);
