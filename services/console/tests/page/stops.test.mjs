// Stops that nobody has confirmed, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { STALE_MS } from "../../page/js/age.js";
import { Stops } from "../../page/js/stops.js";

/** Stops, and what the notice says of them: nothing before, or once all are confirmed. */
function told() {
  const notices = [];
  return { stops: new Stops((text) => notices.push(text)), now: () => notices.at(-1)?.message ?? "", put: () => notices.at(-1).read(), notices };
}

const fails = (message, field) => Promise.reject(Object.assign(new Error(message), { field }));

test("another robot's stop confirms nothing of one that may go on", async () => {
  const { stops, now } = told();
  await stops.follow("hall", "left", fails("the console does not answer."));
  assert.match(now(), /^Stop of left in cell hall: nobody has confirmed it: the console does not answer\. If/);
  await stops.follow("hall", "right", Promise.resolve({}));
  assert.match(now(), /left/);
  // The robots' states come all the time.
  stops.confirmed("hall", "right");
  assert.match(now(), /left/);
  stops.confirmed("hall", "left");
  assert.equal(now(), "");
});

test("a robot of the same name in another cell confirms nothing either", async () => {
  const { stops, now } = told();
  await stops.follow("a", "panda", fails("robot panda has not shown the stop in 5000 ms"));
  stops.confirmed("b", "panda");
  await stops.follow("b", "panda", Promise.resolve({}));
  assert.match(now(), /panda in cell a: nobody has confirmed it/);
  await stops.follow("a", "panda", Promise.resolve({}));
  assert.equal(now(), "");
});

test("all that are not confirmed are named, and each goes by itself", async () => {
  const { stops, now } = told();
  await stops.follow("hall", "left", fails("late"));
  await stops.follow("hall", "right", fails("no such cell", "cell"));
  assert.match(now(), /left in cell hall.*right in cell hall: nobody has confirmed it: no such cell \(cell\)\. If/);
  stops.confirmed("hall", "left");
  assert.ok(/right/.test(now()) && !/left/.test(now()), now());
});

test("a stop that named no robot is confirmed by its own answer only", async () => {
  const { stops, now } = told();
  await stops.follow(undefined, undefined, fails("no robot of cell cell tells its state"));
  assert.match(now(), /^Stop of every robot: nobody/);
  stops.confirmed(undefined, "left");
  assert.match(now(), /every robot/);
  await stops.follow(undefined, undefined, Promise.resolve({}));
  assert.equal(now(), "");
});

test("a stop without an answer is said not to be confirmed yet, and one with an answer takes no notice away", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const { stops, now, notices } = told();
  let answer;
  const followed = stops.follow("hall", "left", new Promise((resolve) => { answer = resolve; }));
  context.mock.timers.tick(STALE_MS - 1);
  assert.deepEqual(notices, []);
  context.mock.timers.tick(1);
  assert.match(now(), /left in cell hall: nobody has confirmed it yet\. If/);
  answer({});
  await followed;
  assert.deepEqual([now(), notices.length], ["", 2]);
  // The line may say by now that the connection is lost.
  await stops.follow("hall", "left", Promise.resolve({}));
  assert.equal(notices.length, 2);
});

test("what was read and put away is not said again with the next one", async () => {
  const { stops, now, put } = told();
  await stops.follow("hall", "left", fails("late"));
  put();
  await stops.follow("hall", "right", fails("late"));
  assert.ok(/right/.test(now()) && !/left/.test(now()), now());
});
