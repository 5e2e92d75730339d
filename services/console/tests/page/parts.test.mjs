// Messages that come in parts over the socket to the console, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { test } from "node:test";

const said = [];
let socket;

/** A socket that is open, and keeps what is said over it. */
class Socket {
  static OPEN = 1;
  readyState = 1;

  constructor(address) { [socket, this.address] = [this, address]; }
  send(text) { said.push(JSON.parse(text)); }
  close() {}
}

Object.assign(globalThis, {
  WebSocket: Socket, location: { href: "https://console/" }, addEventListener: () => {}, document: { addEventListener: () => {} }, setInterval: () => {} });
const { Connection } = await import("../../page/js/connection.js");

/** The bulk form: metadata and one tensor of bytes. */
function bulk(metadata, name, bytes) {
  const header = new TextEncoder().encode(JSON.stringify({ __metadata__: metadata, [name]: { dtype: "U8", shape: [bytes.length], data_offsets: [0, bytes.length] } }));
  const whole = new Uint8Array(8 + header.length + bytes.length);
  new DataView(whole.buffer).setBigUint64(0, BigInt(header.length), true);
  whole.set(header, 8);
  whole.set(bytes, 8 + header.length);
  return whole;
}

function partsOf(of, form, whole, most, ageMs = 0) {
  const parts = [];
  for (let offset = 0; offset < whole.length; offset += most) {
    const metadata = { kind: "part", of, form, offset: String(offset), total_bytes: String(whole.length), age_ms: String(ageMs) };
    parts.push(bulk(metadata, "bytes", whole.slice(offset, offset + most)).buffer);
  }
  return parts;
}

/** A connection, and what it has heard. */
function connected() {
  const heard = [];
  said.length = 0;
  new Connection((kind, message) => { heard.push([kind, message]); }, () => {});
  return heard;
}

const jpeg = Uint8Array.from({ length: 1000 }, (_, k) => k % 251), scene = bulk({ kind: "scene", scene_id: "a" }, "jpeg", jpeg);

test("a scene that comes in parts is heard once it is whole, and others between its parts at once", async () => {
  const heard = connected(), [first, ...others] = partsOf("scene", "bulk", scene, 400, 2500);
  assert.equal(String(socket.address), "wss://console/socket?paced");
  socket.onmessage({ data: first });
  socket.onmessage({ data: '{"kind":"robot","robot":"panda"}' });
  assert.deepEqual(heard.map(([kind]) => kind), ["robot"]);
  for (const part of others) await socket.onmessage({ data: part });
  const [kind, { metadata, tensors }] = heard[1];
  assert.deepEqual([kind, metadata.scene_id, metadata.age_ms, [...tensors.jpeg]], ["scene", "a", 2500, [...jpeg]]);
  assert.deepEqual(said, [...Array(2 + others.length).fill({ id: 0, ask: "received" }), { id: 0, ask: "seen", what: "scene" }]);
});

test("an answer that comes in parts is the request's", async () => {
  const asked = new Connection(() => {}, () => {}).ask("plan"), plan = "é".repeat(500);
  const text = new TextEncoder().encode(JSON.stringify({ kind: "answer", id: asked.id, result: { plan } }));
  for (const part of partsOf("answer 1", "text", text, 333)) socket.onmessage({ data: part });
  assert.deepEqual(await asked, { plan });
});

test("a scene that was given up for another cell's leaves nothing behind in that one", async () => {
  const heard = connected(), other = bulk({ kind: "scene", scene_id: "b" }, "jpeg", jpeg.slice(0, 700));
  const [first, second] = partsOf("scene", "bulk", scene, 400);
  socket.onmessage({ data: first });
  for (const part of partsOf("scene", "bulk", other, 300)) await socket.onmessage({ data: part });
  socket.onmessage({ data: second });
  assert.deepEqual(heard.map(([, { metadata, tensors }]) => [metadata.scene_id, tensors.jpeg.length]), [["b", 700]]);
});
