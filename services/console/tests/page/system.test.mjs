// The system's dialog, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument, within } from "./dom.mjs";

const dialog = makeDocument()("system");
const { System } = await import("../../page/js/system.js");

const shown = (name) => ({ cell: "cell", workers: [{ service: "simulator", name, load: undefined, silent_ms: 0 }], cameras: [] });

test("what is clicked and typed into outlives what is told of the system, and the rows do not", () => {
  const seeds = [], system = new System(dialog, { newScene: (seed) => seeds.push(seed), stop: () => {} });
  system.welcome({ version: "1", role: "operator" });
  system.show(shown("first"));
  system.open();
  const before = dialog.all.filter(({ tag }) => ["button", "input", "table"].includes(tag)), field = within(dialog, "scene-seed");
  field.value = "7";
  field.listeners.input({ target: field });
  system.show(shown("second"));
  assert.match(dialog.text, /second/);
  assert.doesNotMatch(dialog.text, /first/);
  assert.deepEqual(dialog.all.filter(({ tag }) => ["button", "input", "table"].includes(tag)), before);
  before.find(({ textContent }) => textContent === "Set up").click();
  assert.deepEqual([seeds, dialog.open], [[7], false]);
});

test("the robot can be stopped while the dialog keeps the page from being clicked", () => {
  let stops = 0;
  const system = new System(dialog, { stop: () => { stops++; } });
  system.open();
  within(dialog, "system-stop").click();
  assert.equal(stops, 1);
});
