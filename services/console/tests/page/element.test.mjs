// Elements that are drawn again and again, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeDocument } from "./dom.mjs";

const box = makeDocument()("objects");
const { el, keep } = await import("../../page/js/element.js");

test("a button is the same while its key is there, whatever else is said of it", () => {
  const draw = (keys, title) => keep(box, keys, (key) => el("button", { textContent: key }), (button) => { button.title = title; });
  draw(["object-1", "object-2"], "4 cm");
  const first = [...box.children];
  draw(["object-1", "object-2"], "5 cm");
  assert.deepEqual([box.children[0] === first[0], box.children[1] === first[1], box.children[0].title], [true, true, "5 cm"]);
  draw(["object-2"], "5 cm");
  assert.deepEqual(box.children.map(({ textContent }) => textContent), ["object-2"]);
  draw([], "");
  assert.deepEqual(box.children, []);
});
