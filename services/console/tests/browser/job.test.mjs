// The whole job at the screen: see, click, ask, plan, execute, stop, reset; with other viewers, a slow one, and a console that is started again.

import assert from "node:assert/strict";
import { request } from "node:http";
import { connect } from "node:net";
import { after, before, test as plainTest } from "node:test";
import { setTimeout as pause } from "node:timers/promises";

import { PATIENCE_MS, assertDrawn, clickObject, count, difference, objects, open, pixels, screenshot, textOf } from "./page.mjs";
import { startBrowser, startSystem } from "./system.mjs";

const isGreen = (r, g, b) => g > 110 && g > 1.6 * r && g > 1.25 * b;
const isBlue = (r, g, b) => b > 150 && b > 1.5 * r && b > 1.15 * g;

let system, browser, page;

before(async () => {
  // A console that is to end waits for a motion to its end, however slow the machine is.
  system = await startSystem({ environment: { REPOSE_WORKER__DRAIN_MS: String(PATIENCE_MS) } });
  browser = await startBrowser();
  page = await open(browser, system.url);
});

/** The figures of this run, printed at the end. */
const figures = [];

after(async () => {
  for (const figure of figures) console.log(`figure: ${figure}`);
  await browser?.close();
  await system?.stop();
});

/** Asks for pairs of objects in turn until one has a place; clicks as a person would. */
async function askUntilFound(page, relation = "left_of") {
  const ids = await objects(page);
  for (const query of ids) {
    for (const anchor of ids.filter((id) => id !== query)) {
      await page.keyboard.press("Escape");
      await clickObject(page, query);
      await clickObject(page, anchor);
      await page.selectOption("#goal select", relation);
      await page.click("#ask");
      await page.waitForSelector("#answers .placement, #answers .tally, #goal .fault", { timeout: PATIENCE_MS });
      if (await page.locator("#answers .placement").count()) return { query, anchor };
    }
  }
  assert.fail("no pair of objects has a place");
}

async function plan(page) {
  await page.click("#plan");
  await page.waitForSelector("#execute, #answers .fault", { timeout: PATIENCE_MS });
  return (await page.locator("#execute").count()) > 0;
}

/** A pair of objects with a place that the arm can serve. */
async function planUntilFound(page) {
  for (const relation of ["left_of", "right_of", "in_front_of", "behind", "near"]) {
    const found = await askUntilFound(page, relation);
    if (await plan(page)) return found;
  }
  assert.fail("the arm can serve no placement");
}

/** A test whose page is kept as a picture when it fails. */
const test = (name, body) => plainTest(name, async (context) => {
  try {
    await body(context);
  } catch (error) {
    await screenshot(page, `failed-${name.replaceAll(/[^a-z]+/g, "-").slice(0, 40)}`).catch(() => {});
    throw error;
  }
});

test("the page shows the picture and the scene", async () => {
  assertDrawn(await pixels(page, "#picture canvas.over"));
  assertDrawn(await pixels(page, "#world canvas"));
  assert.ok((await objects(page)).length >= 2);
  figures.push(`the page is usable ${page.openedMs.toFixed(0)} ms after it was opened`);
  await screenshot(page, "1-open");
  assert.deepEqual(page.faults, []);
});

test("a blank canvas is noticed", () => {
  assert.throws(() => assertDrawn({ width: 64, height: 64, data: new Array(64 * 64 * 4).fill(200) }), /blank/);
});

test("two clicks and a question give ranked places, drawn as ghosts with their evidence", async () => {
  const before = count(await pixels(page, "#world canvas"), isGreen);
  await askUntilFound(page);
  const withGhosts = count(await pixels(page, "#world canvas"), isGreen);
  assert.ok(withGhosts > before + 200, `green pixels: ${before} before, ${withGhosts} with ghosts`);
  const first = await page.locator("#answers .placement").first().textContent();
  for (const fact of ["likely to stay", "Support margin", "Clearance", "Cost", "by rule"]) assert.ok(first.includes(fact), `${fact} in ${first}`);
  await page.locator("#answers .placement").first().hover();
  await screenshot(page, "2-places");
});

test("places are gone through by keys, and rounds are told as they pass", async () => {
  const rows = page.getByRole("listbox", { name: /best first/ }).getByRole("option"), last = (await rows.count()) - 1;
  assert.ok(last >= 0);
  await rows.first().focus();
  await page.keyboard.press("End");
  assert.equal(await page.evaluate(() => document.activeElement.dataset.key), `placement-${last}`);
  assert.deepEqual([await rows.nth(last).getAttribute("aria-selected"), await rows.nth(last).getAttribute("tabindex")], ["true", "0"]);
  await page.keyboard.press("Home");
  assert.equal(await page.evaluate(() => document.activeElement.dataset.key), "placement-0");
  assert.equal(await page.locator("#progress").getAttribute("role"), "status");
});

test("an answer goes with the options that it was asked for with", async () => {
  await page.click("#goal summary");
  await page.selectOption("#option-rotation", "yaw");
  assert.equal(await page.locator("#answers .placement").count(), 0);
  assert.ok(await page.locator("#ask").isEnabled(), "the goal stays");
  await page.selectOption("#option-rotation", "fixed");
  await page.click("#goal summary");
});

test("a goal that cannot be met is explained", async () => {
  const [query, anchor] = await objects(page);
  await page.keyboard.press("Escape");
  await clickObject(page, query);
  await clickObject(page, anchor);
  await page.selectOption("#goal select", "left_of");
  await page.keyboard.press("a");
  await clickObject(page, anchor);
  await page.locator("#goal select").nth(1).selectOption("right_of");
  const before = await pixels(page, "#world canvas");
  await page.click("#ask");
  await page.waitForSelector("#answers .tally", { timeout: PATIENCE_MS });
  assert.match(await page.locator("#answers").textContent(), /None of \d+ candidates passed/);
  // Each rejected candidate is a dot in its reason's color; pointing at a reason leaves its own.
  await page.locator("#answers .tally li").first().hover();
  assert.ok(difference(before, await pixels(page, "#world canvas")) > 100, "no rejected candidate is drawn");
  await screenshot(page, "3-none");
});

test("an error is shown as the contract's message with its field", async () => {
  const [query, anchor] = await objects(page);
  await page.keyboard.press("Escape");
  await clickObject(page, query);
  await clickObject(page, anchor);
  await page.click("#goal summary");
  await page.fill("#option-count", "1000");
  // The click leaves the field, and is one on the button all the same.
  await page.click("#ask");
  const fault = await textOf(page, "#goal .fault", /count/);
  assert.match(fault, /invalid argument: .*64.*1000.*\(count\)/);
  await screenshot(page, "4-error");
  await page.fill("#option-count", "3");
  await page.click("#goal summary");
});

test("the keyboard is enough", async () => {
  await page.keyboard.press("Escape");
  const [query, anchor] = await objects(page);
  await page.locator("#world canvas").focus();
  await page.keyboard.press(String(query));
  await page.keyboard.press(String(anchor));
  await page.keyboard.press("n");
  // With capitals locked the keys are the same.
  await page.keyboard.press("N");
  assert.equal(await page.locator("#goal .toggle").first().getAttribute("aria-pressed"), "false");
  await page.keyboard.press("Enter");
  await page.waitForSelector("#answers .placement, #answers .tally, #goal .fault", { timeout: PATIENCE_MS });
  assert.equal(await page.locator("#goal .fault").count(), 0, await page.locator("#goal").textContent());
});

test("a planned motion's slider outlives a gripper whose width flickers", async () => {
  const seen = await page.evaluate(async () => {
    const { Motion } = await import("/js/activity.js");
    const box = document.createElement("section"), motion = new Motion(box, { preview: () => {} });
    const told = (width) => motion.robot({ robot: "panda", heardAt: performance.now(), state: { mode: "idle", gripper_width_m: width } });
    told(0.0404);
    motion.plan({ duration_ms: 2000, phases: [{ name: "standoff", start_ms: 0 }] });
    const slider = box.querySelector("input[type=range]");
    told(0.0406);
    return [box.querySelector("input[type=range]") === slider, box.querySelector("#gripper").textContent];
  });
  assert.deepEqual(seen, [true, "gripper 41 mm"]);
});

test("the planned way is drawn before anything moves, to other viewers too", async () => {
  const other = await open(browser, system.url, { colorScheme: "dark", viewport: { width: 1180, height: 820 } });
  await planUntilFound(page);
  assert.ok(count(await pixels(page, "#world canvas"), isBlue) > 300, "no way is drawn");
  await other.waitForSelector("#motion .scrub");
  assert.equal(await other.locator("#execute").count(), 0, "a plan is its maker's to execute");
  await page.locator("#motion input[type=range]").fill("6000");
  await screenshot(page, "5-plan");
  await screenshot(other, "5-plan-other-viewer");
  await other.context().close();
});

test("stop stops, says why to everybody, and reset lets the robot go on", async () => {
  const other = await open(browser, system.url, { colorScheme: "dark" });
  await page.keyboard.press("Escape");
  await planUntilFound(page);
  const before = await pixels(page, "#world canvas");
  await page.click("#execute");
  await textOf(page, "#mode", /moving/);
  // On its way, and before it has anything in its hand. No picture is taken before the stop: a machine that is busy with other things may take
  // longer over one than the motion lasts.
  const { x, y, width, height } = await page.locator("#stop").boundingBox();
  await textOf(page, "#phase", /Moving object/);
  await pause(1000);
  const started = performance.now();
  await page.mouse.click(x + width / 2, y + height / 2);
  await textOf(page, "#mode", /stopped/);
  const took = performance.now() - started;
  // The pointer is still over the button, and what it says can be read.
  await page.waitForFunction(() => {
    const button = document.querySelector("#stop.latched:hover");
    return button && getComputedStyle(button).backgroundColor === "rgba(0, 0, 0, 0)";
  });
  await textOf(page, ".stopped", /Stopped from the console/i);
  await textOf(other, ".stopped", /Stopped from the console/i);
  await textOf(page, "#phase", /Stopped|Ended/i);
  assert.ok(difference(before, await pixels(page, "#world canvas")) > 300, "the arm has not moved on the screen");
  await screenshot(page, "6-stopped");
  await screenshot(other, "6-stopped-other-viewer");
  figures.push(`a stop is shown ${took.toFixed(0)} ms after its click`);
  await other.context().close();
  await page.click("#reset");
  await textOf(page, "#mode", /idle/);
  await page.click("#recovery summary");
  // The arm does not go home with something in its hand.
  if (/holding/.test(await page.locator("#gripper").textContent())) {
    await page.click("#recovery button >> text=Open the hand");
    await textOf(page, "#gripper", /mm$/);
  }
  await page.click("#recovery button:enabled >> text=Home");
  await textOf(page, "#mode", /moving/);
  await textOf(page, "#mode", /idle/);
  await page.waitForSelector("#recovery button:enabled >> text=Home");
  assert.equal(await page.locator("#motion .fault").count(), 0, await page.locator("#motion").textContent());
  assert.match(await page.locator("#recovered").textContent(), /checked against the scene of camera/);
});

test("the motion is carried out to its end", async () => {
  const other = await open(browser, system.url), goalOf = (viewer) => viewer.locator("#goal .chip.query, #goal .chip.anchor").count();
  const [query, anchor] = await objects(other);
  await clickObject(other, query);
  await clickObject(other, anchor);
  await page.keyboard.press("Escape");
  await planUntilFound(page);
  await page.click("#execute");
  // The picture is live again, in which ids may mean other objects; the places stay to compare with.
  assert.equal(await goalOf(page), 0);
  await textOf(page, "#phase", /Moving object/);
  assert.ok(await page.locator("#answers .placement").count());
  await page.waitForFunction(() => /lift|transfer|lower/.test(document.querySelector("#phase")?.textContent ?? ""), undefined, { timeout: PATIENCE_MS });
  await screenshot(page, "7-moving");
  await textOf(page, "#phase", /^Done|lost|Ended|Stopped/);
  assert.match(await page.locator("#phase").textContent(), /^Done/);
  await page.waitForFunction(() => !document.querySelector("#answers .placement"));
  await textOf(other, "#phase", /^Done/);
  assert.equal(await goalOf(other), 2, "another's motion leaves a viewer its goal");
  await other.context().close();
  // A look at the cell says what has become of everything.
  await page.waitForSelector("#execution .said", { timeout: PATIENCE_MS });
  assert.match(await page.locator("#execution .said").last().textContent(), /moved|fell|mm from|gone|not seen/);
  await screenshot(page, "8-done");
});

test("a console that is asked to end brings the motion under way to its end, and its page says how it ended", async () => {
  await planUntilFound(page);
  await page.click("#execute");
  await textOf(page, "#mode", /moving/);
  process.kill(system.consoleProcess(), "SIGTERM");
  await textOf(page, "#notice", /lost: the console is ending/);
  await textOf(page, "#link", /Live/);
  assert.match(await page.locator("#phase").textContent(), /^Done|The grasp was lost/);
  assert.equal(await page.locator("#motion .fault").count(), 0, await page.locator("#motion").textContent());
});

test("goals that were collected are carried out one after another, with what held", async () => {
  await planUntilFound(page);
  await page.click("#collect");
  await textOf(page, "#collected", /\d/);
  await page.click("#run");
  await textOf(page, "#steps", /looking|placing|planning|moving/);
  await page.waitForFunction(() => /holds|failed/.test(document.querySelector("#steps .badge")?.textContent ?? ""), undefined, { timeout: PATIENCE_MS });
  await screenshot(page, "9-sequence");
  assert.match(await page.locator("#steps .badge").first().textContent(), /holds/, await page.locator("#steps").textContent());
  assert.match(await page.locator("#steps").textContent(), /executed/i);
});

test("goals that were collected are brought about together, and what cannot hold together is said", async () => {
  await page.keyboard.press("Escape");
  const collect = async (query, anchor, relation) => {
    await clickObject(page, query);
    await clickObject(page, anchor);
    await page.selectOption("#goal select", relation);
    await page.click("#collect");
    await page.click("#goal >> text=Clear");
  };
  const [one, other] = await objects(page);
  await collect(one, other, "left_of");
  await collect(other, one, "left_of");
  await page.click("#arrange");
  assert.match(await textOf(page, "#arranged-conflict", /./), /^Proven: .*contradict each other/);
  assert.equal(await page.locator("#run-arrangement").count(), 0);
  await screenshot(page, "13-contradiction");
  await page.click("#arrangement >> text=Clear");
  await page.click("#sequence >> text=Clear");
  await page.keyboard.press("Escape");

  // A pair that the arm has a way for; whichever relation holds between them already, the opposite one takes a move.
  const { query, anchor } = await planUntilFound(page);
  let answer = "";
  for (const relation of ["left_of", "right_of", "in_front_of", "behind"]) {
    await page.keyboard.press("Escape");
    await collect(query, anchor, relation);
    await page.click("#arrange");
    answer = await textOf(page, "#arranged", /./);
    if (/After \d moves?/.test(answer)) break;
    await page.click("#arrangement >> text=Clear");
    await page.click("#sequence >> text=Clear");
  }
  assert.match(answer, /After \d moves? all goals hold/, await page.locator("#arrangement").textContent());
  assert.match(await page.locator("#planned-moves").textContent(), /so that it is|to make room/);
  assert.match(await page.locator("#arranged-probability").textContent(), /\d %/);
  await screenshot(page, "14-together");
  await page.click("#run-arrangement");
  await textOf(page, "#arranged-end", /./);
  await screenshot(page, "15-together-done");
  const said = await page.locator("#arrangement").textContent();
  assert.match(said, /All goals hold|Given up|No moves were found|lost|Stopped/, said);
  assert.match(said, /panda/i, "how the robot stands is said");
});

test("a viewer that does not read slows nobody", async () => {
  const { hostname, port } = new URL(system.url);
  const slow = connect(Number(port), hostname);
  slow.write(`GET /socket HTTP/1.1\r\nHost: ${hostname}:${port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n`);
  await new Promise((resolve) => slow.once("data", resolve));
  // A masked text frame whose mask is zero.
  const watch = Buffer.from(JSON.stringify({ id: 1, ask: "watch", cell: "cell", camera: "front" }));
  slow.write(Buffer.concat([Buffer.from([0x81, 0x80 | watch.length, 0, 0, 0, 0]), watch]));
  slow.pause();
  // Pictures go on coming: more of them than could have been under way when it stopped to read.
  await page.evaluate((enough) => new Promise((resolve) => {
    const context = document.querySelector("#picture canvas").getContext("2d"), draw = context.drawImage;
    let n = 0;
    context.drawImage = function (...given) {
      if (++n === enough) context.drawImage = draw, resolve();
      return draw.apply(this, given);
    };
  }), 30);
  slow.destroy();
});

test("a page of another site is refused", async () => {
  const { hostname, port } = new URL(system.url);
  const status = (headers, path = "/") => new Promise((resolve, reject) => {
    request({ hostname, port, path, headers }, (response) => { response.resume(); resolve(response.statusCode); }).on("error", reject).end();
  });
  const upgrade = { Connection: "Upgrade", Upgrade: "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==" };
  assert.equal(await status({ ...upgrade, Origin: "http://evil.example" }, "/socket"), 403);
  assert.equal(await status({ Host: `evil.example:${port}` }), 403);
  assert.equal(await status({}), 200);
});

test("a page that lost its console says so and comes back by itself", async () => {
  await page.keyboard.press("Escape");
  process.kill(system.consoleProcess(), "SIGKILL");
  await Promise.all([textOf(page, "#link", /lost/), textOf(page, "#notice", /connection to the console is lost/i)]);
  await screenshot(page, "10-lost");
  await textOf(page, "#link", /Live/);
  await page.waitForFunction(() => !document.body.classList.contains("stale"));
  assertDrawn(await pixels(page, "#world canvas"));
});

test("a stop that nobody takes is not passed over in silence", async () => {
  await page.route("**/stop", (route) => route.abort());
  const before = await page.locator("#picture").boundingBox();
  await page.click("#stop");
  await textOf(page, "#notice", /Stop of panda in cell cell:/);
  assert.deepEqual(await page.locator("#picture").boundingBox(), before, "a notice moves nothing under the pointer");
  await page.click("#notice button");
  assert.ok(await page.locator("#notice").isHidden(), "what was read can be put away");
  await page.unroute("**/stop");
  // A network that is gone says nothing for minutes.
  let held;
  await page.route("**/stop", (route) => { held = route; });
  await page.click("#stop");
  await textOf(page, "#notice", /nobody has confirmed it yet/);
  // Not let go by the end of the test: the robot would stop.
  await held.abort();
  await textOf(page, "#notice", /nobody has confirmed it:/);
  await page.click("#notice button");
  await page.unroute("**/stop");
});

test("a connection that says nothing any more is given up though nobody has closed it", async () => {
  const context = await browser.newContext(), behind = await context.newPage();
  let isDeaf = false;
  await behind.routeWebSocket(/\/socket/, (socket) => {
    const server = socket.connectToServer();
    isDeaf = false;
    socket.onMessage((message) => isDeaf || server.send(message));
    server.onMessage((message) => isDeaf || socket.send(message));
  });
  await behind.goto(system.url);
  await textOf(behind, "#link", /Live/);
  isDeaf = true;
  await textOf(behind, "#link", /lost/);
  await textOf(behind, "#link", /Live/);
  await context.close();
});

test("a console that has no room says so, and is tried again", async () => {
  const context = await browser.newContext(), late = await context.newPage();
  let isFull = true;
  await late.routeWebSocket(/\/socket/, (socket) => {
    if (isFull) socket.close({ code: 4503, reason: "this console serves 32 pages at once" });
    else socket.connectToServer();
  });
  await late.goto(system.url);
  await textOf(late, "#link", /Full/);
  await textOf(late, "#notice", /serves 32 pages at once/);
  isFull = false;
  await textOf(late, "#link", /Live/);
  assert.ok(await late.locator("#notice").isHidden());
  await context.close();
});

test("a camera of another day is said to be gone, and those that are there are offered", async () => {
  const context = await browser.newContext(), late = await context.newPage();
  await context.addInitScript(() => sessionStorage.setItem("repose.camera", "yesterday"));
  await late.goto(system.url);
  await textOf(late, "#picture .empty", /no camera “yesterday”/);
  await late.click("#picture .empty button[data-camera=front]");
  await late.waitForSelector("body[data-ready=true]", { timeout: PATIENCE_MS });
  assert.equal(await late.locator("#camera").inputValue(), "front");
  await late.waitForSelector("#picture .empty", { state: "hidden", timeout: PATIENCE_MS });
  await context.close();
});

test("a narrow screen has everything, and the stop at the thumb", async () => {
  const phone = await open(browser, system.url, { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  const width = await phone.evaluate(() => document.documentElement.scrollWidth);
  assert.ok(width <= 390, `the page is ${width} pixels wide`);
  await phone.evaluate(() => scrollTo(0, 700));
  const box = await phone.locator("#stop").boundingBox();
  assert.ok(box.y > 0 && box.y + box.height <= 844 && box.height >= 44, JSON.stringify(box));
  // What comes of it is in sight, too, wherever the page is scrolled to.
  await phone.route("**/stop", (route) => route.abort());
  await phone.click("#stop");
  await textOf(phone, "#notice", /nobody has confirmed/);
  const said = await phone.locator("#notice").boundingBox();
  assert.ok(said.y >= 0 && said.y + said.height <= 844, JSON.stringify(said));
  await phone.click("#notice button");
  await phone.evaluate(() => scrollTo(0, 0));
  await screenshot(phone, "11-phone", { fullPage: true });
  await phone.context().close();
});

test("the system is listed with its workers", async () => {
  await page.click("#open-system");
  const text = await textOf(page, "#workers", /planner/);
  for (const service of ["perception", "inference", "motion", "simulator"]) assert.ok(text.includes(service), service);
  // Its rows are drawn anew with every message; what is typed in it stays.
  await page.fill("#scene-seed", "7");
  const row = await page.$("#workers tbody tr");
  await page.waitForFunction((row) => !row.isConnected, row);
  assert.deepEqual([await page.inputValue("#scene-seed"), await page.evaluate(() => document.activeElement.id)], ["7", "scene-seed"]);
  await screenshot(page, "12-system");
  // The page behind cannot be clicked while it is open.
  await page.route("**/stop", (route) => route.abort());
  await page.click("#system-stop");
  await textOf(page, "#notice", /nobody has confirmed/);
  assert.ok(await page.locator("#system").isHidden(), "what comes of it is in sight");
  await page.unroute("**/stop");
  assert.deepEqual(page.faults.filter((fault) => !/ERR_CONNECTION|WebSocket|Failed to load/.test(fault)), []);
});
