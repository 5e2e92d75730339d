// The socket to the console, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";

const opened = [];
let look, retry;

/** A socket that is opened, and of which nothing is heard, as on a network that drops what is sent. */
class Socket {
  static OPEN = 1;
  readyState = 0;

  constructor() { opened.push(this); }
  send() {}
  close() { this.readyState = 2; }
}

Object.assign(globalThis, { WebSocket: Socket, location: { href: "http://console/" }, addEventListener: () => {}, document: { addEventListener: () => {} } });
const { Connection } = await import("../../page/js/connection.js");

/** A connection whose looks and retries come when the test says so, and the states that it tells. */
function connected() {
  const { setInterval, setTimeout } = globalThis, states = [];
  globalThis.setInterval = (looks) => { look = looks; };
  new Connection(() => {}, (state) => states.push(state));
  globalThis.setInterval = setInterval;
  const looked = () => {
    globalThis.setTimeout = (tries) => { retry = tries; };
    look();
    globalThis.setTimeout = setTimeout;
  };
  return { looked, states };
}

test("a connection that does not come about is given up and tried again, as one that has fallen silent is", () => {
  for (const readyState of [0, 1]) {
    opened.length = 0;
    retry = undefined;
    const { looked, states } = connected();
    opened[0].readyState = readyState;
    for (let looks = 0; looks < 5; looks++) looked();
    assert.deepEqual([states, retry], [[], undefined], "it may be slow");
    looked();
    assert.deepEqual(states, ["lost"]);
    retry();
    assert.equal(opened.length, 2);
  }
});
