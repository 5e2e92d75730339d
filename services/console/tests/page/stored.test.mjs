// What a browser keeps for the page, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Stored } from "../../page/js/stored.js";

test("a browser that keeps nothing keeps nobody from the page", () => {
  const stored = new Stored(() => { throw new DOMException("the operation is insecure", "SecurityError"); });
  assert.equal(stored.get("cell"), undefined);
  stored.set("cell", "lab");
  assert.equal(stored.get("cell"), "lab");
});

test("what was stored before is there, and what is stored is the browser's", () => {
  const kept = new Map([["repose.cell", "lab"]]);
  const stored = new Stored(() => ({ getItem: (key) => kept.get(key) ?? null, setItem: (key, text) => kept.set(key, text) }));
  assert.deepEqual([stored.get("cell"), stored.get("camera")], ["lab", undefined]);
  stored.set("camera", "");
  assert.deepEqual([stored.get("camera"), kept.get("repose.camera")], ["", ""]);
});
