// The line over the page: what is wrong, or under way.

import { byId, el, fill } from "./element.js";

/** How long a passing notice stays. */
const PASSES_MS = 6000;
let over, isOfStop = false;

/** Shows `{message, field, read}`, or nothing; `read()` is told that somebody has put it away. What is wrong ("bad") stays until it is not, or somebody has read it; the rest passes. That a stop is not confirmed
 *  ("stop") stays whatever else there is to say, until there is nothing to say of it, or somebody has read it. */
export function notice(text, kind = "") {
  if (isOfStop && kind !== "stop") return;
  isOfStop = !!text && kind === "stop";
  show(text, kind);
}

function show(text, kind) {
  const box = byId("notice");
  clearTimeout(over);
  box.hidden = !text;
  if (!text) return;
  box.className = `notice ${kind && "bad"}`;
  if (!kind) over = setTimeout(() => { box.hidden = true; }, PASSES_MS);
  fill(box, el("span", { textContent: `${text.message}${text.field ? ` (${text.field})` : ""}` }),
    el("button", { type: "button", className: "quiet small", textContent: "✕", "aria-label": "Dismiss this notice", onclick: () => { notice(undefined, "stop"); text.read?.(); } }));
}
