// Goals that shall hold together, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument } from "./dom.mjs";

const element = makeDocument();
const { Arrangement, together } = await import("../../page/js/arrangement.js");
const { Goal } = await import("../../page/js/goal.js");

/** An arrangement's card, and what it asks. */
function card(id) {
  const box = element(id), asked = [];
  const arrangement = new Arrangement(box, { ask: (request) => { asked.push(request); return new Promise(() => {}); }, cancel: () => {} });
  arrangement.may(true, true);
  return { arrangement, box, asked };
}

/** What is collected of a goal with these options. */
function collected(query, anchor, options = {}) {
  const goal = new Goal(element("goal"), { changed: () => {} });
  Object.assign(goal.options, options);
  goal.pick(query);
  goal.pick(anchor);
  return goal.request("ab", 0.5);
}

test("a clearance that was chosen for a goal is not dropped without a word", () => {
  const { arrangement, box, asked } = card("clearance");
  arrangement.find([collected(1, 2), collected(3, 2, { clearance: 20 })]);
  assert.deepEqual(asked, []);
  assert.ok(!box.hidden);
  assert.match(box.text, /Goals together keep no clearance: clear that option, or carry them out one after another/);
  // None is what an arrangement keeps.
  arrangement.find([collected(1, 2), collected(3, 2, { clearance: 0 })]);
  assert.deepEqual([asked.length, /clearance/.test(box.text)], [1, false]);
});

test("whatever can be chosen for a goal is asked for together, or said not to be", () => {
  const everything = collected(1, 2, { count: 5, rotation: "yaw", variant: "geometric", view: "scene", clearance: 20, seed: 7 });
  // What is to hold is asked for as each object's goal, and of the places of each there is one.
  const kept = [...Object.keys(together([everything])), "query", "goal", "count"];
  const dropped = Object.keys(everything).filter((option) => !kept.includes(option));
  assert.deepEqual(dropped, ["min_clearance_m"]);
});
