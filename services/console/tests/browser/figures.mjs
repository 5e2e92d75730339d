// What looking at a cell and recording it cost, on a system that runs for nothing else: `scripts/browser-tests --figures`. Prints one JSON
// document. SECONDS is how long each cost is measured, MINUTES how long memory is watched, ROUNDS of REQUESTS the throughput; FIGURES names
// those that are wanted of `viewers,page,slowing,memory`, all without it.

import { execFile, spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { setTimeout as pause } from "node:timers/promises";
import { promisify } from "node:util";

import { clickObject, objects, open } from "./page.mjs";
import { cpuMs, residentMb, startBrowser, startSystem } from "./system.mjs";
import { viewer } from "./viewer.mjs";

const VIEWERS = 8, SECONDS = Number(process.env.SECONDS ?? 20), MINUTES = Number(process.env.MINUTES ?? 5);
const OPENINGS = 5, CLICKS = 5, ROUNDS = Number(process.env.ROUNDS ?? 4), REQUESTS = Number(process.env.REQUESTS ?? 60);
/** Between two openings: the console has let go by then of what it followed for the last one. */
const APART_MS = 6000;
const wanted = process.env.FIGURES?.split(",") ?? ["viewers", "page", "slowing", "memory"];

// What users get: not the thin cloud of the tests.
const DEFAULTS = { REPOSE_CONSOLE__CLOUD_POINTS: "60000", REPOSE_CONSOLE__SCENE_PERIOD_MS: "500" };

const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];
const rounded = (values) => values.map((value) => Math.round(10 * value) / 10);

/** Processor time of a process, percent of a core, while it goes on for SECONDS. */
async function cost(pid) {
  const before = cpuMs(pid), started = performance.now();
  await pause(SECONDS * 1000);
  return 100 * (cpuMs(pid) - before) / (performance.now() - started);
}

/** Eight viewers, then a ninth that has stopped to read: what they cost, and how many pictures a second each of the eight gets. */
async function viewers(system) {
  const pid = system.consoleProcess(), figures = { viewers: VIEWERS, percent_of_core_without: await cost(pid) };
  const watching = Array.from({ length: VIEWERS }, () => viewer(system.url));
  await pause(2000);
  const rates = async (name) => {
    const before = watching.map(({ pictures }) => pictures);
    figures[`percent_of_core${name}`] = await cost(pid);
    figures[`pictures_per_s${name}`] = rounded(watching.map(({ pictures }, k) => (pictures - before[k]) / SECONDS));
  };
  await rates("");
  const stuck = viewer(system.url);
  await pause(1000);
  stuck.pause();
  await rates("_beside_a_stuck_one");
  for (const { close } of [...watching, stuck]) close();
  return figures;
}

/** How long until the page is usable and a click on it shows, until its scene is drawn, and how much longer than the placement takes until its answer is. */
async function page(system) {
  const browser = await startBrowser(), opened = [], drawn = [], clicked = [], beyond = [];
  try {
    for (let k = 0; k < OPENINGS; k++) {
      const page = await open(browser, system.url, { atOnce: async (page) => clicked.push(await untilPicked(page)) });
      opened.push(page.openedMs);
      drawn.push(page.drawnMs);
      await page.context().close();
      await pause(APART_MS);
    }
    const page = await open(browser, system.url);
    const [query, anchor] = await objects(page);
    await clickObject(page, query);
    await clickObject(page, anchor);
    for (let k = 0; k < CLICKS; k++) beyond.push(await untilDrawn(page));
  } finally {
    await browser.close();
  }
  return {
    opened_ms: rounded(opened), opened_median_ms: Math.round(median(opened)),
    first_click_shown_after_ms: rounded(clicked), scene_drawn_ms: rounded(drawn), scene_drawn_median_ms: Math.round(median(drawn)),
    click_to_drawn_beyond_placement_ms: rounded(beyond), click_to_drawn_median_ms: Math.round(median(beyond)),
  };
}

/** Clicks the first object, and waits until it is marked and shown so; milliseconds. */
async function untilPicked(page) {
  const [first] = await objects(page), clicked = performance.now();
  await clickObject(page, first);
  await page.waitForSelector("#objects button.query");
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  return performance.now() - clicked;
}

/** Asks, and waits until the answer is drawn; milliseconds beyond the placement's own. */
async function untilDrawn(page) {
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
  return drawn - clicked - (own.endsWith("ms") ? parseFloat(own) : 1000 * parseFloat(own));
}

/** Placements a second that a running cell answers, two clients asking. */
async function throughput(system) {
  const args = ["--json", "load", "--connect", system.endpoint, "--clients", "2", "--requests", String(REQUESTS), "--warm-up", "4"];
  const { stdout } = await promisify(execFile)(process.env.REPOSE, args, { maxBuffer: 1 << 26 });
  return JSON.parse(stdout).achieved_per_s;
}

/** Records a cell until `end` is called, which resolves to what the recorder says. */
async function recorder(system, folder) {
  const args = ["--json", "record", "--connect", system.endpoint, "--out", join(folder, `${Date.now()}.mcap`)];
  const child = spawn(process.env.REPOSE, args, { stdio: ["ignore", "pipe", "ignore"] });
  let text = "";
  child.stdout.on("data", (data) => { text += data; });
  // Workers copy their calls from the next report of their load on.
  await pause(2000);
  return { pid: child.pid, end: async () => { child.kill("SIGINT"); await once(child, "close"); return JSON.parse(text); } };
}

/** What eight viewers with a stuck one, and a recorder, take of the throughput: by turns, so that a machine that changes changes all alike. */
async function slowing(system, folder) {
  const rates = { alone: [], viewed: [], recorded: [] }, recorders = [];
  let lost = 0;
  for (let k = 0; k < ROUNDS; k++) {
    rates.alone.push(await throughput(system));
    const watching = Array.from({ length: VIEWERS + 1 }, () => viewer(system.url));
    await pause(1000);
    watching[0].pause();
    rates.viewed.push(await throughput(system));
    for (const { close } of watching) close();
    const recording = await recorder(system, folder);
    // What the recorder itself takes does not depend on what else the machine does; the throughput does.
    const before = cpuMs(recording.pid), started = performance.now();
    rates.recorded.push(await throughput(system));
    recorders.push(100 * (cpuMs(recording.pid) - before) / (performance.now() - started));
    lost += (await recording.end()).lost;
  }
  const share = (name) => 100 * (1 - median(rates[name].map((rate, k) => rate / rates.alone[k])));
  return {
    placements_per_s: Object.fromEntries(Object.entries(rates).map(([name, of]) => [name, rounded(of)])),
    viewers_cost_percent: share("viewed"), recording_costs_percent: share("recorded"), recorder_percent_of_core: rounded(recorders), lost_of_recordings: lost,
  };
}

/** Resident memory of every process once a minute, and how fast it grows over the second half, with eight viewers and a recorder; MiB. */
async function memory(system, folder) {
  const watching = Array.from({ length: VIEWERS }, () => viewer(system.url)), recording = await recorder(system, folder);
  const processes = { ...system.processes(), recorder: recording.pid }, resident = Object.fromEntries(Object.keys(processes).map((name) => [name, []]));
  for (let k = 0; k <= MINUTES; k++) {
    if (k) await pause(60_000);
    for (const [name, pid] of Object.entries(processes)) resident[name].push(Math.round(residentMb(pid)));
    console.error(`memory after ${k} minutes: ${JSON.stringify(Object.fromEntries(Object.entries(resident).map(([name, of]) => [name, of.at(-1)])))}`);
  }
  for (const { close } of watching) close();
  const pictures = watching.map((one) => one.pictures), { lost } = await recording.end();
  // What is filled once (buffers, remembered scenes) is filled in the first half.
  const late = (values) => slope(values.slice(Math.floor(values.length / 2)));
  const grows = Object.fromEntries(Object.entries(resident).map(([name, values]) => [name, Math.round(100 * late(values)) / 100]));
  return { minutes: MINUTES, resident_mb: resident, grows_mb_a_minute: grows, pictures_of_viewers: pictures, lost_in_memory_run: lost };
}

/** By how much the values of a line through them rise from one to the next. */
function slope(values) {
  const mean = (of) => of.reduce((sum, value) => sum + value, 0) / of.length;
  const [at, level] = [(values.length - 1) / 2, mean(values)];
  return mean(values.map((value, k) => (k - at) * (value - level))) / mean(values.map((_, k) => (k - at) ** 2));
}

const system = await startSystem({ environment: DEFAULTS }), folder = mkdtempSync(join(tmpdir(), "repose-figures-"));
const figures = {};
try {
  for (const figure of [viewers, page, slowing, memory].filter(({ name }) => wanted.includes(name))) Object.assign(figures, await figure(system, folder));
} finally {
  await system.stop();
  rmSync(folder, { recursive: true });
}
console.log(JSON.stringify(figures, null, 2));
