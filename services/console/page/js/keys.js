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
    if (key === "s" && !event.target.matches("input")) return stop();
    // Giving a goal up works everywhere; other letters belong to the field that is being filled.
    if (byId("system").open || event.key !== "Escape" && event.target.matches("input, select, textarea")) return;
    // Enter does what the focused button says.
    if (key === "Enter" && event.target.matches("button, summary, .placement")) return;
    if (digit) pick(digit, { shift: event.shiftKey });
    else keys[key]?.();
  });
}
