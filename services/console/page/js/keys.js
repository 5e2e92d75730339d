// The keys of the page. Letters and digits belong to the field that is being filled, where one is.

import { byId } from "./element.js";

/** Calls `stop()`, `pick(digit, {shift})` or what `keys` has for a key. */
export function followKeys({ stop, pick, keys }) {
  addEventListener("keydown", (event) => {
    // A key that is kept down is pressed once.
    if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || byId("sign-in").open) return;
    // With capitals locked, too; and with Shift a digit is a sign, by its place on the keyboard still a digit.
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const digit = Number(/^[1-9]$/.test(key) ? key : /^Digit([1-9])$/.exec(event.code)?.[1]);
    if (isStop(key, event)) {
      // It is no choice in a list, and nothing to be written into a field.
      event.preventDefault();
      return stop();
    }
    // Giving a goal up works everywhere; other letters belong to the field that is being filled.
    if (byId("system").open || event.key !== "Escape" && event.target.matches("input, select, textarea")) return;
    // Enter does what the focused button says.
    if (key === "Enter" && event.target.matches("button, summary, .placement")) return;
    if (digit) pick(digit, { shift: event.shiftKey });
    else keys[key]?.();
  });
}

/** Fields that letters can be written into: sliders and fields for numbers take none, and whoever has just used one stops as ever. */
const TAKES_LETTERS = "textarea, input:not([type=range], [type=number])";

/** Whether the stop is meant: S, or the key in its place where what a keyboard writes is not Latin. */
function isStop(key, { code, target }) {
  const isS = key === "s" || code === "KeyS" && /^\P{ASCII}$/u.test(key);
  return isS && !target.matches(TAKES_LETTERS);
}
