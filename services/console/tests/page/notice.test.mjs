// The notice over the page, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument } from "./dom.mjs";

const box = makeDocument()("notice");
const { notice } = await import("../../page/js/notice.js");

test("that a stop is not confirmed stays whatever becomes of the connection, until it is or somebody has read it", () => {
  const lost = { message: "The connection is lost." }, unconfirmed = { message: "Stop: nobody has confirmed it." };
  notice(lost, "bad");
  assert.match(box.text, /lost/);
  notice(unconfirmed, "stop");
  // Lost, and found again.
  notice(lost, "bad");
  notice();
  assert.deepEqual([box.hidden, /nobody has confirmed/.test(box.text), box.className], [false, true, "notice bad"]);
  notice(undefined, "stop");
  assert.ok(box.hidden);
  let reads = 0;
  notice({ ...unconfirmed, read: () => { reads++; } }, "stop");
  box.all.find(({ tag }) => tag === "button").click();
  assert.deepEqual([box.hidden, reads], [true, 1], "read");
  notice(lost, "bad");
  assert.match(box.text, /lost/);
});
