// Elements of the page, made and filled.

/** An element with properties, `on…` listeners, `data`, `style` variables, attributes (`aria-…`, `role`, …) and children. */
export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null) continue;
    if (name === "data") Object.assign(element.dataset, value);
    else if (name === "own") element.style.setProperty("--own", value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && !name.includes("-")) element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** The element with an id. */
export const byId = (id) => document.getElementById(id);

/** Puts new children in the place of an element's old ones; the focus stays on whatever has the same `data-key`, or id. */
export function fill(element, ...children) {
  const { id, dataset: { key } } = element.contains(document.activeElement) ? document.activeElement : { dataset: {} };
  const focused = key ? `[data-key="${CSS.escape(key)}"]` : id && `#${CSS.escape(id)}`;
  element.replaceChildren(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  if (focused) element.querySelector(focused)?.focus();
}

/** Has one child for each key, in order, which `make(key)` makes and `update(child, key)` changes from then on. While the keys are the same the children are:
 *  a button that is drawn anew between press and release is not clicked. */
export function keep(element, keys, make, update) {
  const same = keys.length === element.children.length && keys.every((key, k) => element.children[k].dataset.key === key);
  if (!same) fill(element, keys.map((key) => { const child = make(key); child.dataset.key = key; return child; }));
  keys.forEach((key, k) => update(element.children[k], key));
}

/** Fills a select with names, and keeps or sets what is chosen. */
export function choices(select, names, chosen) {
  const same = names.length === select.options.length && names.every((name, i) => select.options[i].value === name);
  if (!same) select.replaceChildren(...names.map((name) => el("option", { value: name, textContent: name })));
  if (chosen !== undefined && select.value !== chosen) select.value = chosen;
  select.disabled = names.length < 1;
}

/** What can be folded out, as `owner.isOpen` says; it is kept there when the summary is clicked: "toggle" comes later, by when the element may have been
 *  drawn anew as it was before. */
export function foldOut(owner, properties, summary, ...children) {
  const details = el("details", { className: "more", open: owner.isOpen, ...properties },
    el("summary", { ...summary, onclick: () => { owner.isOpen = !details.open; } }), ...children);
  return details;
}
