// Collected goals and the sequence that is carried out, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument, within } from "./dom.mjs";

const element = makeDocument();
const { Sequence } = await import("../../page/js/activity.js");

const goal = (query, anchor) => ({ scene: { scene_id: "ab" }, query, goal: [{ relation: "left_of", anchor, holds: true }] });
const step = ({ query, goal }) => ({ query, goal, stage: "waiting", holds: [] });

test("goals that were collected go when they are carried out, and stay when somebody else begins a sequence", () => {
  const sequence = new Sequence(element("theirs"), {}), [own, others] = [[goal(1, 2), goal(3, 2)], [goal(4, 2)]];
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

test("goals that are clicked twice are carried out once", async () => {
  let began;
  const asked = [], box = element("own");
  const sequence = new Sequence(box, { run: (goals) => { asked.push(goals.length); return new Promise((resolve) => { began = resolve; }); } });
  sequence.may(true);
  sequence.add(goal(1, 2));
  const button = within(box, "run");
  button.click();
  // The same, as long as it is under the pointer, and the one that is drawn in its place.
  button.click();
  within(box, "run").click();
  assert.deepEqual(asked, [1]);
  began();
  await new Promise(setImmediate);
  within(box, "run").click();
  assert.deepEqual(asked, [1, 1], "again, after that");
});
