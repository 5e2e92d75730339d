// The few words beside the pointer.

import { byId, fill } from "./element.js";

/** Shows content beside the pointer of an event; none hides it. */
export function showTip({ clientX, clientY }, ...content) {
  const tip = byId("tip");
  tip.hidden = !content.length || !content[0];
  if (tip.hidden) return;
  fill(tip, ...content);
  const { width, height } = tip.getBoundingClientRect();
  tip.style.left = `${Math.min(clientX + 14, innerWidth - width - 8)}px`;
  tip.style.top = `${Math.min(clientY + 14, innerHeight - height - 8)}px`;
}
