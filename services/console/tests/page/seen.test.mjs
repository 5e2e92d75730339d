// How old what is shown of the camera is, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { instantOf } from "../../page/js/age.js";
import { Seen } from "../../page/js/seen.js";

/** The cameras of a system message. */
const cameras = (age_ms) => [{ name: "wrist", scenes_per_s: 5, age_ms: 0 }, { name: "front", scenes_per_s: 0, age_ms }];

/** What is said beside a fresh picture. */
function beside(age_ms, isHeld = false) {
  const seen = new Seen();
  seen.pictureAt = instantOf({});
  seen.cameras(cameras(age_ms), "front");
  return { ...seen.words(isHeld), areObjectsOld: seen.areObjectsOld };
}

test("beside fresh pictures it is said how old the objects are that perception says nothing new of", () => {
  assert.deepEqual(beside(60000), { kind: "bad", text: "live, objects 60 s old", areObjectsOld: true });
  assert.deepEqual(beside(60000, true), { kind: "bad", text: "held for the goal, objects 60 s old", areObjectsOld: true });
  // Of a camera that nobody has asked about yet there is a scene every ten seconds.
  assert.deepEqual(beside(10000), { kind: "live", text: "live", areObjectsOld: false });
  assert.deepEqual(beside(10000, true), { kind: "held", text: "held for the goal", areObjectsOld: false });
});

test("objects go on growing old when their camera is known no longer, and another camera's are not these", () => {
  const seen = new Seen();
  assert.deepEqual(seen.words(false), { kind: "", text: "" });
  seen.cameras(cameras(60000), "front");
  seen.cameras([], "front");
  assert.deepEqual(seen.words(false), { kind: "bad", text: "objects 60 s old" });
  seen.forget();
  seen.cameras(cameras(60000), undefined);
  seen.cameras(cameras(60000), "wrist");
  assert.ok(!seen.areObjectsOld);
  seen.pictureAt = instantOf({ age_ms: 7000 });
  assert.deepEqual(seen.words(false), { kind: "bad", text: "7 s old" });
});
