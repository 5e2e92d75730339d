// As much of a document as the page's parts are drawn with: elements with their children, properties and listeners.

class Element {
  children = []; dataset = {}; attributes = {}; listeners = {}; id = ""; className = ""; value = ""; textContent = ""; disabled = false; hidden = false; open = false;
  style = { setProperty: () => {} };

  constructor(tag) { this.tag = tag; }
  append(...parts) { this.children.push(...parts); }
  replaceChildren(...parts) { this.children = parts; }
  setAttribute(name, value) { this.attributes[name] = value; }
  addEventListener(kind, listener) { this.listeners[kind] = listener; }
  contains() { return false; }
  querySelector() { return null; }
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
  globalThis.document = { createElement: (tag) => new Element(tag), getElementById: byId, activeElement: null };
  return byId;
}

/** The element with an id within another. */
export const within = (element, id) => element.all.find((part) => part.id === id);
