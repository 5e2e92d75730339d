// The whole page but for what it draws, with a console that answers when a test says so, without a browser: `node --test services/console/tests/page/`.

import assert from "node:assert/strict";
import { register } from "node:module";
import { beforeEach, test } from "node:test";
import { makeDocument, within } from "./dom.mjs";

// Neither WebGL nor canvases are here: what is drawn with them does nothing.
const source = (code) => `data:text/javascript,${encodeURIComponent(code)}`;
const blank = "new Proxy({}, { get: (_, name) => (name === 'yaw' ? 0 : name === 'outline' ? (scene) => { scene.middles = new Map(); } : () => Promise.resolve()) })";
const drawn = {
  scene: source(`export class World { constructor() { return ${blank}; } }`),
  picture: source(`export const labelsOf = () => []; export class Picture { constructor() { return ${blank}; } }`),
};
register(source(`const drawn = ${JSON.stringify(drawn)};
  export const resolve = (name, context, next) => (/^\\.\\/(scene|picture)\\.js$/.test(name) ? { url: drawn[name.slice(2, -3)], shortCircuit: true } : next(name, context));`));

let socket, asked = [];

/** A socket that is open, and keeps what is asked over it. */
class Socket {
  static OPEN = 1;
  readyState = 1;

  constructor() { socket = this; }
  send(text) { asked.push(JSON.parse(text)); }
  close() {}
}

Object.assign(globalThis, {
  WebSocket: Socket, location: { href: "http://console/" }, addEventListener: () => {}, setInterval: () => {}, requestAnimationFrame: () => {},
  matchMedia: () => ({ matches: false, addEventListener: () => {} }) });
const byId = makeDocument();
byId("link").append(document.createElement("span"));
await import("../../page/js/main.js");

const told = (message) => socket.onmessage({ data: JSON.stringify(message) });
/** Until all that was answered has had its consequences. */
const settled = () => new Promise(setImmediate);
const choose = (id, value) => byId(id).listeners.change({ target: { value } });
const click = (card, id) => within(byId(card), id).click();
const places = () => byId("answers").querySelectorAll(".placement").length;
const picked = () => byId("goal").querySelectorAll(".query").length;

/** The last request of a kind; answered by `answer` or `refuse`. */
function request(kind) {
  const { id, ...rest } = asked.findLast(({ ask }) => ask === kind);
  const end = async (message) => { told({ id, ...message }); await settled(); };
  return { ...rest, answer: (result = {}) => end({ kind: "answer", result }), refuse: (message) => end({ kind: "refused", error: { code: "failed_precondition", message } }) };
}

/** The bulk form, without tensors. */
function bulk(metadata) {
  const header = new TextEncoder().encode(JSON.stringify({ __metadata__: metadata })), whole = new Uint8Array(8 + header.length);
  new DataView(whole.buffer).setBigUint64(0, BigInt(header.length), true);
  whole.set(header, 8);
  return whole.buffer;
}

/** What the page is told of the cell that it has chosen: two robots, and a scene with three objects. */
async function watched(cell) {
  told({ kind: "watching", cell });
  for (const robot of ["left", "right"]) {
    told({ kind: "robot", robot, state: { mode: "idle", stop: null, owner: null, gripper_width_m: 0.04, gripper_holding: false, held: null } });
  }
  const objects = [1, 2, 3].map((id) => ({ id, extent_m: [0.1, 0.1, 0.1] }));
  const scene = { camera: { width: 1, height: 1 }, objects };
  socket.onmessage({ data: bulk({ kind: "scene", scene_id: `of-${cell}`, camera: "front", grid: "{}", scene: JSON.stringify(scene) }) });
  await settled();
}

async function chooseCell(cell) {
  choose("cell", cell);
  await watched(cell);
}

/** Makes a goal of two objects by their chips. */
function goal(query, anchor) {
  for (const id of [query, anchor]) byId("objects").children.find(({ dataset }) => dataset.id === id).click();
}

/** Has places found for a goal and a motion planned to one by the chosen robot. */
async function planned(plan, robot) {
  click("answers", "plan");
  assert.equal(request("plan").robot, robot);
  await request("plan").answer({ plan });
  told({ kind: "plan", shown: { plan, robot, query: 1, placement: 0, not_chosen: [], duration_ms: 1000, phases: [{ name: "approach", start_ms: 0 }], poses: [] } });
}

async function found() {
  goal(1, 2);
  click("goal", "ask");
  const asked = request("place"), { query, goal: terms, scene } = asked.request;
  const placement = { placed_from_observed: [], cost: 1, geometric: [{ holds: true }], relations: [0.9], realism: 0.9, support_m: 0.01, clearance_m: 0.01 };
  await asked.answer({ placed: { scene_id: scene.scene_id, query, goal: terms, placements: [placement], evaluated: 1, weights_hash: "", seed: 0 }, worker: "planner", took_ms: 1 });
}

told({ kind: "welcome", version: "1", page: "1", role: "operator", cell: "here" });
beforeEach(async () => {
  await chooseCell("elsewhere");
  await chooseCell("here");
  choose("robot", "left");
  asked = [];
});

test("a motion that ends in an error is no fault of the cell or robot that was chosen since", async () => {
  await found();
  await planned("p", "left");
  click("motion", "execute");
  await request("execute").refuse("the arm is elsewhere");
  assert.match(byId("motion").text, /the arm is elsewhere/);
  for (const chooseAnother of [() => chooseCell("there"), async () => choose("robot", "right")]) {
    await chooseCell("here");
    choose("robot", "left");
    await found();
    await planned("p", "left");
    click("motion", "execute");
    await chooseAnother();
    await request("execute").refuse("the arm is elsewhere");
    assert.doesNotMatch(byId("motion").text, /the arm is elsewhere/);
  }
});

test("the end of a motion takes its own places from the page, and not those of another that is carried out", async () => {
  await found();
  await planned("p", "left");
  click("motion", "execute");
  assert.equal(places(), 1, "they stay to compare with");
  const first = request("execute");
  // The other robot of the cell goes to the same places.
  choose("robot", "right");
  await planned("q", "right");
  click("motion", "execute");
  const second = request("execute");
  await first.answer({ outcome: "done" });
  assert.equal(places(), 1);
  await second.answer({ outcome: "done" });
  assert.equal(places(), 0);

  await found();
  await planned("r", "right");
  click("motion", "execute");
  const here = request("execute");
  await chooseCell("there");
  await found();
  await planned("s", "left");
  click("motion", "execute");
  await here.answer({ outcome: "done" });
  assert.equal(places(), 1);
});

test("what begins in one cell clears no goal of another that was chosen since", async () => {
  const collected = async () => {
    goal(1, 2);
    click("goal", "collect");
  };
  const begin = {
    sequence: async () => { await collected(); click("sequence", "run"); },
    bring_about: async () => {
      await collected();
      click("sequence", "arrange");
      const move = { object: 1, purpose: "goal", goal: [], placement: {} };
      const arranged = { outcome: "found", moves: [move], satisfied: [], open: [] };
      await request("arrange").answer({ arranged, worker: "planner", took_ms: 1 });
      click("arrangement", "run-arrangement");
    },
    new_scene: async () => {
      goal(1, 2);
      told({ kind: "system", cell: "here", workers: [{ service: "simulator", name: "s", silent_ms: 0 }], cameras: [], robots: ["left", "right"] });
      byId("open-system").listeners.click();
      byId("system").all.find(({ textContent }) => textContent === "Set up").click();
    },
  };
  for (const [kind, begins] of Object.entries(begin)) {
    await chooseCell("here");
    await begins();
    await request(kind).answer();
    assert.equal(picked(), 0, `${kind}: what has begun here is done with`);
    for (const end of ["answer", "refuse"]) {
      await chooseCell("here");
      await begins();
      const begun = request(kind);
      await chooseCell("there");
      await collected();
      await begun[end]("something else is under way");
      assert.deepEqual([picked(), !!within(byId("sequence"), "collected")], [1, true], `${kind}: ${end}`);
      assert.doesNotMatch(["sequence", "arrangement", "notice"].map((card) => byId(card).text).join(" "), /something else/, kind);
    }
  }
});

test("a motion that is planned for a robot is not carried out once another is chosen", async () => {
  await found();
  click("answers", "plan");
  const asked = request("plan");
  choose("robot", "right");
  assert.ok(!within(byId("answers"), "plan").disabled, "the other one may go there");
  await asked.answer({ plan: "p" });
  told({ kind: "plan", shown: { plan: "p", robot: "left", query: 1, duration_ms: 1000, phases: [], poses: [] } });
  assert.deepEqual([within(byId("motion"), "execute"), request("discard").plan], [undefined, "p"]);
});

test("a stop that is not cleared and an arm that is not brought back are no fault of another robot", async () => {
  told({ kind: "robot", robot: "left", state: { mode: "stopped", stop: { kind: "estop", reason: "a hand" }, owner: null, gripper_width_m: 0.04, gripper_holding: false, held: null } });
  click("motion", "reset");
  choose("robot", "right");
  await request("reset").refuse("it is pressed still");
  assert.doesNotMatch(byId("motion").text, /it is pressed still/);
  byId("motion").all.find(({ dataset }) => dataset.key === "recover-home").click();
  choose("robot", "left");
  await request("recover").refuse("the way is blocked");
  assert.doesNotMatch(byId("motion").text, /the way is blocked/);
});

test("what was under way is not shown as that by a page that has found its console again, and how it ended is", async () => {
  const motion = { robot: "left", query: 1, phases: ["approach"], phase: 0 };
  const step = { query: 1, goal: [], stage: "moving", holds: [] };
  const undone = { code: "unavailable", message: "the console has ended before this was over" };
  const { setTimeout } = globalThis;
  const lost = (reason) => {
    let tries;
    globalThis.setTimeout = (again) => { tries = again; };
    socket.onclose({ code: 1012, reason });
    globalThis.setTimeout = setTimeout;
    tries();
  };
  const isShown = () => [!!within(byId("motion"), "phase"), !!within(byId("sequence"), "steps")];
  told({ kind: "activity", execution: motion, sequence: { steps: [step], ending: false, ended: false } });
  assert.deepEqual(isShown(), [true, true]);
  lost("");
  told({ kind: "welcome", version: "1", page: "1", role: "operator", cell: "here" });
  await watched("here");
  assert.deepEqual(isShown(), [false, false], "nobody knows what came of it");
  const failed = { ...step, stage: "failed", error: undone };
  told({ kind: "activity", execution: { ...motion, ended: { error: undone } }, sequence: { steps: [failed], ending: true, ended: true } });
  lost("the console is ending");
  assert.match(byId("notice").text, /The connection to the console is lost: the console is ending\. Trying again/);
  told({ kind: "welcome", version: "1", page: "1", role: "operator", cell: "here" });
  await watched("here");
  for (const card of ["motion", "sequence"]) assert.match(byId(card).text, /the console has ended before this was over/);
  assert.ok(!within(byId("sequence"), "end-sequence"));
});
