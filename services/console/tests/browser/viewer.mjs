// A viewer without a browser: a WebSocket that takes and acknowledges pictures and scenes, and counts them.

import { connect } from "node:net";

const UPGRADE = ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="].join("\r\n");

/** How long until a viewer that was let go looks again, as a page does. */
const AGAIN_MS = 1000;

/** Looks at the camera `front` of the cell `cell`, until it is closed. */
export function viewer(url) {
  const counted = { bytes: 0, pictures: 0, pause: () => look.socket.pause(), close: () => { look.isOver = true; look.socket.destroy(); } };
  const look = { isOver: false, again: () => look.isOver || begin(url, counted, look) };
  begin(url, counted, look);
  return counted;
}

function begin(url, counted, look) {
  const { hostname, port } = new URL(url), socket = connect(Number(port), hostname);
  look.socket = socket;
  let buffered = Buffer.alloc(0), isOpen = false;
  const send = (message) => socket.write(frame(JSON.stringify(message)));
  socket.write(`GET /socket HTTP/1.1\r\nHost: ${hostname}:${port}\r\n${UPGRADE}\r\n\r\n`);
  socket.on("error", () => {});
  socket.on("close", () => setTimeout(look.again, AGAIN_MS));
  socket.on("data", (data) => {
    counted.bytes += data.length;
    buffered = Buffer.concat([buffered, data]);
    if (!isOpen) {
      const end = buffered.indexOf("\r\n\r\n");
      if (end < 0) return;
      [isOpen, buffered] = [true, buffered.subarray(end + 4)];
      send({ id: 1, ask: "watch", cell: "cell", camera: "front" });
    }
    for (let size; (size = sizeOf(buffered)) && size.all <= buffered.length; buffered = buffered.subarray(size.all)) {
      if ((buffered[0] & 15) !== 2) continue;
      const what = buffered.subarray(size.head, size.head + 600).includes('"kind":"picture"') ? "picture" : "scene";
      if (what === "picture") counted.pictures += 1;
      send({ id: 0, ask: "seen", what });
    }
  });
}

/** A text of at most 125 bytes as a frame; its mask is zero. */
function frame(text) {
  const bytes = Buffer.from(text);
  return Buffer.concat([Buffer.from([0x81, 0x80 | bytes.length, 0, 0, 0, 0]), bytes]);
}

/** How long a server's frame is, and its head; nothing where not even that is known. */
function sizeOf(buffered) {
  if (buffered.length < 10) return undefined;
  const short = buffered[1] & 0x7f;
  const [head, length] = short < 126 ? [2, short] : short === 126 ? [4, buffered.readUInt16BE(2)] : [10, Number(buffered.readBigUInt64BE(2))];
  return { head, all: head + length };
}
