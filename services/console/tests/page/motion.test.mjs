// The robot and what it carries out, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument, within } from "./dom.mjs";

const byId = makeDocument();
const { Motion } = await import("../../page/js/activity.js");

const state = (more) => ({ mode: "idle", stop: null, owner: null, gripper_width_m: 0.04, gripper_holding: false, held: null, ...more });
const shown = (robot, more) => ({ robot, state: state(more), links: [], heardAt: performance.now() });
const plan = { plan: "p", robot: "left", query: 3, duration_ms: 1000, phases: [{ name: "approach", start_ms: 0 }], poses: [] };
const moving = (robot, ended) => ({ robot, query: 3, phases: ["approach", "grasp"], phase: 0, ended });

test("what another robot of the cell carries out is said of that one, and keeps this one from nothing", () => {
  const box = byId("motion"), motion = new Motion(box, { preview: () => {} });
  motion.may(true);
  motion.robot(shown("left"));
  motion.plan(plan);
  motion.mine(true);
  motion.execution(moving("right"));
  assert.match(box.text, /Robot right: Moving object 3/);
  assert.ok(within(box, "execute") && within(box, "recovery"), "the left one may move");
  motion.execution(moving("left"));
  assert.doesNotMatch(box.text, /Robot/);
  assert.ok(!within(box, "execute") && !within(box, "recovery"), "it moves already");
  assert.ok(motion.isMoving);
});

test("a robot that is stopped and does not say why can be let go on", () => {
  const resets = [], box = byId("stopped"), motion = new Motion(box, { reset: (...of) => resets.push(of) });
  motion.may(true);
  motion.robot(shown("left", { mode: "stopped" }));
  assert.match(box.text, /does not say why/);
  within(box, "reset").click();
  const stop = { kind: "estop", reason: "a person is in the way", estop_id: "1" };
  motion.robot(shown("left", { mode: "stopped", stop }));
  within(box, "reset").click();
  assert.deepEqual(resets, [["left", undefined], ["left", stop]]);
});
