// What counts as live, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { STALE_MS, instantOf, isStale } from "../../page/js/age.js";

test("what lay at the console before the page came is as old as the console says, and what comes now is live", () => {
  assert.ok(!isStale(instantOf({})) && !isStale(undefined));
  // A robot's state has it as a number, a picture as text.
  assert.ok(isStale(instantOf({ age_ms: 2 * STALE_MS })) && isStale(instantOf({ age_ms: String(2 * STALE_MS) })));
  assert.ok(!isStale(instantOf({ age_ms: STALE_MS / 3 })));
});
