// What the console costs, on a system that runs for nothing else: `node measure.mjs` with REPOSE and REPOSE_BROWSER_MODULES set, as in
// scripts/browser-tests. Prints one JSON document. Viewers are sockets that read everything and say so; one page is a real browser.

import { connect } from "node:net";
import { setTimeout as pause } from "node:timers/promises";

import { clickObject, objects, open } from "./page.mjs";
import { cpuMs, residentMb, startBrowser, startSystem } from "./system.mjs";

const VIEWERS = 8, SECONDS = Number(process.env.SECONDS ?? 20);

/** A viewer that takes and acknowledges pictures and scenes; `bytes` and `pictures` count what came. */
function viewer(url) {
  const { hostname, port } = new URL(url), socket = connect(Number(port), hostname);
  const counted = { bytes: 0, pictures: 0, close: () => socket.destroy() };
  const send = (message) => {
    const text = Buffer.from(JSON.stringify(message));
    socket.write(Buffer.concat([Buffer.from([0x81, 0x80 | text.length, 0, 0, 0, 0]), text]));
  };
  let buffered = Buffer.alloc(0), isOpen = false;
  socket.write(`GET /socket HTTP/1.1\r\nHost: ${hostname}:${port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n`);
  socket.on("error", () => {});
  socket.on("data", (data) => {
    counted.bytes += data.length;
    buffered = Buffer.concat([buffered, data]);
    if (!isOpen) {
      const end = buffered.indexOf("\r\n\r\n");
      if (end < 0) return;
      [isOpen, buffered] = [true, buffered.subarray(end + 4)];
      send({ id: 1, ask: "watch", cell: "cell", camera: "front" });
    }
    for (;;) {
      if (buffered.length < 10) return;
      const short = buffered[1] & 0x7f;
      const [head, length] = short < 126 ? [2, short] : short === 126 ? [4, buffered.readUInt16BE(2)] : [10, Number(buffered.readBigUInt64BE(2))];
      if (buffered.length < head + length) return;
      if ((buffered[0] & 15) === 2) {
        const what = buffered.subarray(head, head + 600).includes('"kind":"picture"') ? "picture" : "scene";
        if (what === "picture") counted.pictures += 1;
        send({ id: 0, ask: "seen", what });
      }
      buffered = buffered.subarray(head + length);
    }
  });
  return counted;
}

async function cost(pid) {
  const before = cpuMs(pid), started = performance.now();
  await pause(SECONDS * 1000);
  return 100 * (cpuMs(pid) - before) / (performance.now() - started);
}

// What users get: not the thin cloud of the tests.
const system = await startSystem({ environment: { REPOSE_CONSOLE__CLOUD_POINTS: "60000", REPOSE_CONSOLE__SCENE_PERIOD_MS: "500" } });
const browser = await startBrowser();
const figures = {};
try {
  const pid = system.consoleProcess();
  figures.idle_percent_of_core = await cost(pid);
  const viewers = Array.from({ length: VIEWERS }, () => viewer(system.url));
  await pause(2000);
  const before = viewers.map(({ pictures }) => pictures);
  figures.viewers = VIEWERS;
  figures.percent_of_core = await cost(pid);
  figures.pictures_per_s = viewers.map(({ pictures }, k) => (pictures - before[k]) / SECONDS);
  figures.resident_mb = residentMb(pid);
  viewers.forEach(({ close }) => close());
  const opened = [];
  for (let k = 0; k < 5; k++) {
    const page = await open(browser, system.url);
    opened.push(page.openedMs);
    await page.context().close();
  }
  figures.opened_ms = opened;
  const page = await open(browser, system.url);
  const [query, anchor] = await objects(page);
  await clickObject(page, query);
  await clickObject(page, anchor);
  const beyond = [];
  for (let k = 0; k < 5; k++) {
    await page.evaluate(() => {
      document.querySelector("#answers").replaceChildren();
      window.answered = new Promise((resolve) => {
        const watch = new MutationObserver(() => {
          if (!document.querySelector("#answers .placement, #answers .tally")) return;
          watch.disconnect();
          // Drawn: the frame after the one in which it was put on the page.
          requestAnimationFrame(() => requestAnimationFrame(() => resolve(performance.now())));
        });
        watch.observe(document.querySelector("#answers"), { childList: true, subtree: true });
      });
    });
    const clicked = await page.evaluate(() => { const t = performance.now(); document.querySelector("#ask").click(); return t; });
    const drawn = await page.evaluate(() => window.answered);
    const own = await page.locator("#answers .title .numbers").textContent();
    const took = own.endsWith("ms") ? parseFloat(own) : 1000 * parseFloat(own);
    beyond.push(drawn - clicked - took);
  }
  figures.click_to_drawn_beyond_placement_ms = beyond;
} finally {
  await browser.close();
  await system.stop();
}
console.log(JSON.stringify(figures, null, 2));
