// The keys, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";

let press;
globalThis.addEventListener = (_, listener) => { press = listener; };
globalThis.document = { getElementById: () => ({ open: false }) };
const { followKeys } = await import("../../page/js/keys.js");

/** An element, as far as the keys look at one: what it is, by simple selectors and `input:not([type=…], …)`. */
function element(tag, type) {
  const isOne = (selector) => selector === tag || selector.startsWith("input:not(") && tag === "input" && !selector.includes(`[type=${type}]`);
  return { matches: (selectors) => selectors.split(/, (?![^(]*\))/).some(isOne) };
}

/** What a key does: how often it stops, and whether the browser is kept from writing it. */
function pressed(key, code, target) {
  let stops = 0, isKept = false;
  followKeys({ stop: () => { stops++; }, pick: () => {}, keys: {} });
  press({ key, code, target, preventDefault: () => { isKept = true; } });
  return [stops, isKept];
}

test("the stop's key stops wherever no letters are written", () => {
  for (const target of [element("body"), element("button"), element("select"), element("input", "range"), element("input", "number")]) {
    assert.deepEqual(pressed("s", "KeyS", target), [1, true]);
    assert.deepEqual(pressed("S", "KeyS", target), [1, true]);
  }
  for (const target of [element("textarea"), element("input", "text"), element("input", "password")]) assert.deepEqual(pressed("s", "KeyS", target), [0, false]);
});

test("the key in the place of S stops where a keyboard writes no Latin, and no other letter does", () => {
  assert.deepEqual(pressed("ы", "KeyS", element("body")), [1, true]);
  // Dvorak has an O in that place, and its S elsewhere.
  assert.deepEqual(pressed("o", "KeyS", element("body")), [0, false]);
  assert.deepEqual(pressed("s", "Semicolon", element("body")), [1, true]);
  assert.deepEqual(pressed("Shift", "ShiftLeft", element("body")), [0, false]);
});
