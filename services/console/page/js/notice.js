// The line over the page: what is wrong, or under way.

import { byId, el, fill } from "./element.js";

/** How long a passing notice stays. */
const PASSES_MS = 6000;
let over;

/** Shows `{message, field}`, or nothing. What is wrong ("bad") stays until it is not, or somebody has read it; the rest passes. */
export function notice(text, kind = "") {
  const box = byId("notice");
  clearTimeout(over);
  box.hidden = !text;
  if (!text) return;
  box.className = `notice ${kind}`;
  if (!kind) over = setTimeout(() => { box.hidden = true; }, PASSES_MS);
  fill(box, el("span", { textContent: `${text.message}${text.field ? ` (${text.field})` : ""}` }),
    el("button", { type: "button", className: "quiet small", textContent: "✕", "aria-label": "Dismiss this notice", onclick: () => notice() }));
}
