// The page put together: what the console says goes to the parts, what the parts ask goes to the console.

import { Motion, Sequence } from "./activity.js";
import { STALE_MS } from "./age.js";
import { Arrangement } from "./arrangement.js";
import { Connection } from "./connection.js";
import { byId, choices, el, fill } from "./element.js";
import { Goal } from "./goal.js";
import { Picture, labelsOf } from "./picture.js";
import { Placements, evidence } from "./placements.js";
import { World } from "./scene.js";
import { System } from "./system.js";
import { centimetres, colorOf } from "./words.js";

const LAYERS = { cloud: "Cloud", surfaces: "Surfaces", placements: "Places", arm: "Arm", way: "Way", zones: "Keep-out" };
/** How long a passing notice stays. */
const NOTICE_MS = 6000;
/** How far an object may seem to have moved between two segmentations of one picture, metres. */
const SAME_M = 0.03;
const ROLES = ["viewer", "planner", "operator"];
const stored = { get: (key) => sessionStorage.getItem(`repose.${key}`) ?? undefined, set: (key, value) => sessionStorage.setItem(`repose.${key}`, value) };

let role = "viewer", cell, camera, robot, page;
let scene, newest, isHeld = false, hasWatched = false, asked, myPlan, hadPlan;
/** The cell that the console's messages are of, and how often one was asked for. */
let toldOf, watches = 0;
/** How often an answer was cleared: one that comes after that is of a goal of before. */
let cleared = 0;
const robots = new Map();

// The console. First, so that it answers while the parts are made.

const connection = new Connection(heard, (state) => {
  byId("link").className = `link ${state}`;
  byId("link").lastElementChild.textContent = { live: "Live", lost: "Connection lost", token: "Signed out" }[state];
  document.body.classList.toggle("stale", state !== "live");
  if (state === "lost") notice({ message: "The connection to the console is lost. Trying again; what is shown may be out of date." }, "bad");
  if (state === "token") askForToken();
});

// The parts.

const tip = byId("tip");
function showTip(event, ...content) {
  tip.hidden = !content.length || !content[0];
  if (tip.hidden) return;
  fill(tip, ...content);
  const { width, height } = tip.getBoundingClientRect();
  tip.style.left = `${Math.min(event.clientX + 14, innerWidth - width - 8)}px`;
  tip.style.top = `${Math.min(event.clientY + 14, innerHeight - height - 8)}px`;
}

const picture = new Picture(byId("picture"), {
  picked: (id, { shift, pixel }) => (id ? goal.pick(id, { shift }) : segment(pixel)),
  hovered: (id, text, event) => showTip(event, text),
});
const world = new World(byId("world"), {
  hovered: (rank, event) => {
    lit(rank);
    const placed = placements.answer?.placed, placement = placed?.placements[rank];
    showTip(event, placement && el("b", { textContent: `Place ${rank + 1}` }), placement && evidence(placement, placed.goal));
  },
});
const goal = new Goal(byId("goal"), { changed: goalChanged, ask: find, collect: () => sequence.add(goal.request(scene.id, world.yaw)), cancel: giveUp });
const placements = new Placements(byId("answers"), { lit, reason: (reason) => world.litRejected(reason), plan: planMotion });
const motion = new Motion(byId("motion"), { execute, reset, recover, preview: (t) => world.previewAt(t) });
const arrangement = new Arrangement(byId("arrangement"), {
  ask: (request) => connection.ask("arrange", { request }), cancel: (request) => connection.cancel(request),
  run: (request) => connection.ask("bring_about", { robot, request }).then(() => { sequence.clear(); goal.clear(); release(); }), end: () => connection.ask("end_sequence").catch((refusal) => notice(refusal, "bad")),
});
const sequence = new Sequence(byId("sequence"), { run: runSequence, arrange: (goals) => arrangement.find(goals), end: () => connection.ask("end_sequence").catch((refusal) => sequence.fault(refusal)) });
const system = new System(byId("system"), { newScene: (seed) => connection.ask("new_scene", { seed }).then(() => release(), (refusal) => notice(refusal, "bad")) });

function lit(rank) {
  placements.lit(rank);
  world.lit(rank);
}

// What the console says.

function notice(text, kind = "") {
  const box = byId("notice");
  box.hidden = !text;
  box.className = `notice ${kind}`;
  clearTimeout(notice.over);
  // What is wrong stays until it is not; the rest is read and gone.
  if (text && !kind) notice.over = setTimeout(() => { box.hidden = true; }, NOTICE_MS);
  if (text) box.textContent = `${text.message}${text.field ? ` (${text.field})` : ""}`;
}

async function heard(kind, message) {
  switch (kind) {
    case "welcome": return welcomed(message);
    case "watching": toldOf = message.cell; return;
    case "cells": return choices(byId("cell"), [...new Set([cell, ...message.cells])].filter(Boolean).sort(), cell);
  }
  // What was on its way when another cell was chosen is not of that one.
  if (toldOf !== cell) return;
  switch (kind) {
    case "system": return systemShown(message);
    case "picture": return pictureShown(message);
    case "scene": return sceneShown(message);
    case "segmented": return segmented(message);
    case "robot": return robotShown(message);
    case "activity": return heardOfActivity(message);
    case "plan": return planShown(message.shown);
  }
}

function welcomed(welcome) {
  // A newer console has newer pages.
  if (page !== undefined && page !== welcome.page) return location.reload();
  page = welcome.page;
  toldOf = undefined;
  notice();
  role = welcome.role;
  system.welcome(welcome);
  const may = (needed) => ROLES.indexOf(role) >= ROLES.indexOf(needed);
  goal.may(may("planner"));
  placements.may(may("planner"));
  motion.may(may("operator"));
  sequence.may(may("operator"));
  arrangement.may(may("planner"), may("operator"));
  cell ??= stored.get("cell") ?? welcome.cell;
  choices(byId("cell"), [cell], cell);
  camera ??= stored.get("camera");
  // What was held is known to the console no longer, once it has ended.
  if (isHeld) connection.ask("watch", { cell, camera }).then(() => connection.ask("hold", { scene_id: scene.id })).catch(() => release());
  else watch();
}

async function watch() {
  hasWatched = true;
  const turn = ++watches;
  try {
    await connection.ask("watch", { cell, camera: camera ?? null });
  } catch (refusal) {
    // The choice that has overtaken this one has an answer of its own.
    if (turn !== watches) return;
    hasWatched = false;
    if (refusal.field !== "camera") notice(refusal, "bad");
    camera = undefined;
  }
}

function systemShown(message) {
  system.show(message);
  world.showZones(message.workers.flatMap(({ load }) => load?.keep_out ?? []));
  byId("recording").hidden = !message.workers.some(({ load }) => load?.journals);
  const names = message.cameras.map(({ name }) => name);
  if (!hasWatched && names.length) watch();
  choices(byId("camera"), names, camera ?? newest?.camera);
  choices(byId("robot"), message.robots, robot);
}

async function pictureShown({ tensors }) {
  pictureShown.at = performance.now();
  if (isHeld) return;
  // In the order in which they came: a recording that is played has stamps of before, and two cells have clocks of their own.
  const turn = ++pictureShown.came;
  const bitmap = await createImageBitmap(new Blob([tensors.jpeg], { type: "image/jpeg" }));
  // Of several that were being decoded, an older one may come last, or after another camera was chosen.
  if (isHeld || turn < pictureShown.first) return bitmap.close();
  pictureShown.first = turn;
  picture.show(bitmap);
  drawSeen();
}
[pictureShown.came, pictureShown.first] = [0, 0];

/** Pictures that are on their way are of a camera that is looked through no longer. */
function forgetPictures() {
  pictureShown.first = pictureShown.came + 1;
  pictureShown.at = undefined;
}

function sceneOf({ metadata, tensors }) {
  const meta = JSON.parse(metadata.scene), { width, height } = meta.camera;
  return { id: metadata.scene_id, camera: metadata.camera, grid: JSON.parse(metadata.grid), meta, width, height, tensors, objects: new Map(meta.objects.map((object) => [object.id, object])) };
}

function sceneShown(message) {
  newest = sceneOf(message);
  camera = newest.camera;
  choices(byId("camera"), [...byId("camera").options].map(({ value }) => value), camera);
  if (!isHeld) adopt(newest);
}

/** Shows a scene: outlines, chips and cloud. */
function adopt(next) {
  scene = next;
  scene.labels ??= labelsOf(scene.tensors.label_runs, scene.width * scene.height);
  picture.outline(scene);
  world.show(scene);
  goal.keep(scene.objects);
  drawObjects();
  drawSeen();
  if (document.body.dataset.ready) return;
  document.body.dataset.ready = "true";
  // After the frame that shows all this.
  requestAnimationFrame(() => setTimeout(() => world.begin().catch(({ message }) => notice({ message: `The scene cannot be drawn here: ${message}` }, "bad"))));
}

function drawObjects() {
  const { query, anchors } = goal.marks;
  fill(byId("objects"), [...(scene?.objects.values() ?? [])].map(({ id, extent_m }) => el("button", {
    type: "button", className: `chip ${id === query ? "query" : anchors.includes(id) ? "anchor" : ""}`, own: colorOf(id),
    // Where it is in the picture: its number stands there.
    data: { key: `object-${id}`, id, u: scene.middles.get(id)?.[0], v: scene.middles.get(id)?.[1], width: scene.width, height: scene.height },
    "aria-pressed": String(id === query || anchors.includes(id)), title: centimetres(extent_m),
    onclick: (event) => goal.pick(id, { shift: event.shiftKey }), onpointerenter: () => picture.lit(id), onpointerleave: () => picture.lit(0), onfocus: () => picture.lit(id), onblur: () => picture.lit(0),
  }, el("i"), `Object ${id}`)));
}

function drawSeen() {
  const badge = byId("seen"), age_ms = performance.now() - (pictureShown.at ?? performance.now());
  badge.className = `badge ${isHeld ? "held" : age_ms > STALE_MS ? "bad" : scene ? "live" : ""}`;
  badge.textContent = isHeld ? "held for the goal" : age_ms > STALE_MS ? `${Math.floor(age_ms / 1000)} s old` : scene ? "live" : "";
  byId("follow").hidden = !isHeld;
}

// The goal.

function goalChanged() {
  // Ids mean what they mean in one scene: it is kept until the goal is done with.
  if (!goal.isEmpty && !isHeld && scene) hold();
  picture.mark(goal.marks);
  world.mark(goal.marks);
  clearAnswer();
  if (goal.isEmpty && sequence.isEmpty && isHeld) release();
  drawObjects();
}

async function hold() {
  isHeld = true;
  drawSeen();
  const { tensors, id } = scene;
  connection.ask("hold", { scene_id: id }).catch((refusal) => notice(refusal));
  if (tensors.jpeg) picture.show(await createImageBitmap(new Blob([tensors.jpeg], { type: "image/jpeg" })));
}

/** Asks perception for the object at a pixel that shows none. */
function segment(pixel) {
  if (!scene || segment.isAsking || ROLES.indexOf(role) < 1) return;
  segment.isAsking = true;
  segment.pixel = pixel;
  notice({ message: "Looking for an object there …" });
  connection.ask("segment", { scene_id: scene.id, pixel }).catch((refusal) => notice(refusal, "bad")).finally(() => { segment.isAsking = false; });
}

/** Takes the scene in which perception has looked for an object: what was picked is found in it by where it is. */
function segmented(message) {
  const found = sceneOf(message), [u, v] = segment.pixel;
  const again = (id) => {
    const was = scene.objects.get(id)?.centroid_m, distance = ({ centroid_m }) => Math.hypot(...centroid_m.map((x, k) => x - was[k]));
    const nearest = was && [...found.objects.values()].sort((a, b) => distance(a) - distance(b))[0];
    return nearest && distance(nearest) < SAME_M ? nearest.id : 0;
  };
  goal.rename(again);
  isHeld = true;
  adopt(found);
  const id = found.labels[v * found.width + u];
  notice(id ? undefined : { message: "Perception finds no object there." });
  if (id) goal.pick(id);
  else goalChanged();
}

/** Follows the camera again. */
function release() {
  isHeld = false;
  if (!goal.isEmpty) goal.clear();
  clearAnswer();
  if (newest) adopt(newest);
  picture.mark(goal.marks);
  world.mark(goal.marks);
  drawSeen();
}

/** Gives the search up that is under way. */
function giveUp() {
  if (asked) connection.cancel(asked);
}

function clearAnswer() {
  cleared++;
  giveUp();
  placements.clear();
  world.showPlacements(0, []);
  world.showRejected({});
  if (!myPlan) return;
  connection.ask("discard", { plan: myPlan }).catch(() => {});
  myPlan = undefined;
  planShown(undefined);
}

async function find() {
  if (asked || !goal.isComplete) return;
  clearAnswer();
  const turn = cleared, request = goal.request(scene.id, world.yaw);
  const answer = connection.ask("place", { request }, (progress) => {
    byId("progress").textContent = `searching … round ${progress.iterations}, ${progress.evaluated} candidates`;
  });
  asked = answer.id;
  goal.asking(true);
  try {
    const found = await answer;
    if (turn !== cleared) return;
    placements.show(found);
    world.showPlacements(found.placed.query, found.placed.placements);
    world.showRejected(found.placed.rejected_at_m ?? {});
  } catch (refusal) {
    if (refusal.code !== "cancelled" && turn === cleared) goal.fault(refusal);
  } finally {
    asked = undefined;
    goal.asking(false);
  }
}

async function planMotion() {
  const placed = placements.answer?.placed;
  if (!placed?.placements.length) return;
  const turn = cleared;
  placements.planning(true);
  try {
    const { plan } = await connection.ask("plan", {
      scene_id: placed.scene_id, robot, query: placed.query, placements: placed.placements.map((p) => p.placed_from_observed), seed: placed.seed });
    // The goal was changed while the motion was planned: that one is nobody's.
    if (turn !== cleared) return void connection.ask("discard", { plan }).catch(() => {});
    myPlan = plan;
    motion.mine(hadPlan?.plan === myPlan);
    placements.planned(hadPlan?.plan === myPlan ? hadPlan : undefined);
  } catch (refusal) {
    if (turn === cleared) placements.fault(refusal);
  }
}

function planShown(plan) {
  hadPlan = plan ?? undefined;
  world.showPlan(hadPlan);
  motion.mine(!!hadPlan && hadPlan.plan === myPlan);
  motion.plan(hadPlan);
  if (hadPlan && hadPlan.plan === myPlan) placements.planned(hadPlan);
}

// The robot.

function execute() {
  if (!myPlan) return;
  const plan = myPlan;
  myPlan = undefined;
  motion.fault();
  connection.ask("execute", { plan }).catch((refusal) => motion.fault(refusal));
  follow();
}

/** The picture is live while the robot moves; the ghosts stay to compare with. */
function follow() {
  isHeld = false;
  if (newest) adopt(newest);
  drawSeen();
}

function heardOfActivity({ execution, sequence: several, arrangement: arranged }) {
  const wasMoving = motion.isMoving;
  motion.execution(execution);
  sequence.running(several);
  arrangement.running(arranged);
  if (wasMoving && !motion.isMoving && execution?.ended?.outcome?.outcome === "done") {
    goal.clear();
    clearAnswer();
  }
}

function robotShown(shown) {
  robots.set(shown.robot, shown);
  if (!robot || !robots.has(robot)) {
    robot = shown.robot;
    choices(byId("robot"), [...robots.keys()].sort(), robot);
  }
  world.showRobot(shown);
  if (shown.robot !== robot) return;
  motion.robot(shown);
  showStopped(!!shown.state.stop);
}

function robotForgotten() {
  motion.robot(undefined);
  motion.fault();
  showStopped(false);
}

function showStopped(isStopped) {
  const button = byId("stop");
  button.classList.toggle("latched", isStopped);
  button.textContent = isStopped ? "Stopped" : "Stop";
}

function stop() {
  connection.stop(cell, robot ?? "panda", "stopped from the console").then(() => notice(), (refusal) => notice({ message: `Stop: ${refusal.message}`, field: refusal.field }, "bad"));
}

/** Clears the stop that is shown, and none that has latched since. */
function reset(name, shown) {
  motion.fault();
  connection.ask("reset", { robot: name, stop: shown }).catch((refusal) => motion.fault(refusal));
}

/** Brings an arm back; what is said of it, or the refusal. Neither is of a cell that was chosen meanwhile. */
async function recover(name, move, unchecked) {
  const asked = cell, ended = await recovered(name, move, unchecked);
  return asked === cell ? ended : {};
}

async function recovered(name, move, unchecked) {
  try {
    const { outcome, reason, checked_against: scene, camera } = await connection.ask("recover", { robot: name, move, unchecked });
    if (outcome !== "done") return { refusal: { code: outcome, message: reason ?? "it did not get there" } };
    if (move === "open") return { said: "The hand is open." };
    return { said: `${move === "home" ? "The arm is home" : "The hand has backed off"}; its way was checked against ${scene ? `the scene of camera ${camera}` : "itself and the keep-out zones only, not against its surroundings"}.` };
  } catch (refusal) {
    return { refusal };
  }
}

function runSequence(goals) {
  sequence.fault();
  connection.ask("sequence", { scene_id: goals[0].scene.scene_id, robot, goals }).then(() => { goal.clear(); release(); }, (refusal) => sequence.fault(refusal));
}

// The bar, the keys and the looks.

byId("stop").addEventListener("click", stop);
byId("follow").addEventListener("click", () => release());
byId("open-system").addEventListener("click", () => system.open());
byId("cell").addEventListener("change", ({ target }) => {
  cell = target.value;
  toldOf = undefined;
  [camera, robot, newest, scene, myPlan] = [];
  robots.clear();
  world.forget();
  // An idle cell says nothing of what is carried out in it.
  planShown(undefined);
  heardOfActivity({});
  robotForgotten();
  sequence.clear();
  arrangement.clear();
  forgetPictures();
  isHeld = false;
  goal.clear();
  stored.set("cell", cell);
  choices(byId("camera"), []);
  choices(byId("robot"), []);
  watch();
});
byId("camera").addEventListener("change", ({ target }) => {
  camera = target.value;
  stored.set("camera", camera);
  goal.clear();
  release();
  forgetPictures();
  watch();
});
byId("robot").addEventListener("change", ({ target }) => {
  robot = target.value;
  if (robots.has(robot)) motion.robot(robots.get(robot));
});

fill(byId("layers"), Object.entries(LAYERS).map(([name, text]) => el("button", { type: "button", textContent: text, "aria-pressed": "true", onclick: ({ currentTarget }) => {
  const on = currentTarget.getAttribute("aria-pressed") !== "true";
  currentTarget.setAttribute("aria-pressed", String(on));
  world.toggle(name, on);
  if (name === "placements") world.toggle("rejected", on);
} })), el("button", { type: "button", textContent: "Reset view", onclick: () => world.look() }));

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || byId("sign-in").open) return;
  if (event.key === "s" || event.key === "S") if (!event.target.matches("input")) return stop();
  // Giving a goal up works everywhere; other letters belong to the field that is being filled.
  if (byId("system").open || event.key !== "Escape" && event.target.matches("input, select, textarea")) return;
  const onButton = event.target.matches("button, summary, .placement");
  const keys = {
    Enter: () => !onButton && find(), p: planMotion, e: () => byId("execute")?.click(), r: () => byId("reset")?.click(), n: () => goal.negate(), a: () => goal.addTerm(),
    Escape: () => { goal.clear(); release(); },
  };
  if (/^[1-9]$/.test(event.key) && scene?.objects.has(Number(event.key))) goal.pick(Number(event.key), { shift: event.shiftKey });
  else keys[event.key]?.();
});

const dark = matchMedia("(prefers-color-scheme: dark)");
function theme(name) {
  const chosen = name ?? localStorage.getItem("repose.theme") ?? (dark.matches ? "dark" : "light");
  if (name) localStorage.setItem("repose.theme", name);
  document.documentElement.dataset.theme = chosen;
  byId("theme").textContent = chosen === "dark" ? "☀" : "☾";
  picture.mark(goal.marks);
}
byId("theme").addEventListener("click", () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
dark.addEventListener("change", () => theme());
theme();
drawSeen();
// What comes no longer says nothing by itself.
setInterval(() => { drawSeen(); motion.aged(); }, 1000);

function askForToken() {
  const dialog = byId("sign-in"), fault = el("div");
  const token = el("input", { type: "password", autocomplete: "current-password", required: true, "aria-label": "Token", style: "width: 100%" });
  fill(dialog, el("form", { onsubmit: async (event) => {
    event.preventDefault();
    try {
      await connection.signIn(token.value);
      dialog.close();
    } catch (refusal) {
      fill(fault, el("div", { className: "fault", textContent: refusal.message }));
    }
  } }, el("div", { className: "title" }, el("h2", { id: "sign-in-title", textContent: "This console asks for a token" })), token,
    el("div", { className: "row", style: "margin-top: 12px" }, el("button", { type: "submit", className: "primary", textContent: "Sign in" })), fault));
  if (!dialog.open) dialog.showModal();
}
