// The goal's card, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument, within } from "./dom.mjs";

const box = makeDocument()("goal");
const { Goal } = await import("../../page/js/goal.js");

/** Types into a field, and leaves it. */
function type(id, text) {
  const field = within(box, id);
  field.value = text;
  field.listeners.change({ target: field });
}

test("what a field is left for by a click is still there when the click ends", () => {
  let changes = 0, asks = 0;
  const goal = new Goal(box, { changed: () => { changes++; }, ask: () => { asks++; } });
  goal.pick(1);
  goal.pick(2);
  goal.fault({ code: "invalid_argument", message: "expected 1 to 64, got 1000", field: "count" });
  const wrong = () => [box.querySelectorAll(".fault").length, within(box, "option-count").className];
  assert.deepEqual(wrong(), [1, "wrong"]);
  const [ask, collect] = [within(box, "ask"), within(box, "collect")];
  changes = 0;
  type("option-count", "5");
  assert.deepEqual([goal.request("ab", 0).count, changes], [5, 1]);
  assert.deepEqual([within(box, "ask") === ask, within(box, "collect") === collect], [true, true]);
  assert.deepEqual(wrong(), [0, ""], "the fault was about what was typed before");
  ask.click();
  assert.equal(asks, 1);
});

test("a field that is left empty shows what is asked for then", () => {
  const goal = new Goal(box, { changed: () => {} });
  type("option-seed", "");
  type("option-clearance", "20");
  assert.deepEqual([goal.request("ab", 0).seed, within(box, "option-seed").value, goal.request("ab", 0).min_clearance_m], [0, 0, 0.02]);
  type("option-clearance", "");
  assert.deepEqual([goal.request("ab", 0).min_clearance_m, within(box, "option-clearance").value], [undefined, ""]);
});
