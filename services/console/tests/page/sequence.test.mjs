// Collected goals and the sequence that is carried out, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";

globalThis.document = { createElement: () => element(), activeElement: null };
const { Sequence } = await import("../../page/js/activity.js");

/** As much of an element as the page's parts are drawn with. */
function element() {
  return { append: () => {}, replaceChildren: () => {}, contains: () => false, setAttribute: () => {}, addEventListener: () => {}, dataset: {}, style: {}, textContent: "" };
}

const goal = (query, anchor) => ({ scene: { scene_id: "ab" }, query, goal: [{ relation: "left_of", anchor, holds: true }] });
const step = ({ query, goal }) => ({ query, goal, stage: "waiting", holds: [] });

test("goals that were collected go when they are carried out, and stay when somebody else begins a sequence", () => {
  const sequence = new Sequence(element(), {}), [own, others] = [[goal(1, 2), goal(3, 2)], [goal(4, 2)]];
  own.forEach((collected) => sequence.add(collected));
  sequence.running({ steps: others.map(step), ending: false, ended: false });
  assert.ok(!sequence.isEmpty, "another page's sequence");
  // The connection was lost and found again meanwhile.
  sequence.running(undefined);
  sequence.running({ steps: others.map(step), ending: false, ended: false });
  sequence.running({ steps: others.map(step), ending: false, ended: true });
  assert.ok(!sequence.isEmpty);
  sequence.running({ steps: own.map(step), ending: false, ended: false });
  assert.ok(sequence.isEmpty);
});
