// The page put together: what the console says goes to the parts, what the parts ask goes to the console.

import { Motion, Sequence, isStopped, recovered } from "./activity.js";
import { instantOf, isStale } from "./age.js";
import { Arrangement } from "./arrangement.js";
import { sceneOf } from "./bulk.js";
import { Connection } from "./connection.js";
import { byId, choices, el, fill, keep } from "./element.js";
import { Goal } from "./goal.js";
import { followKeys } from "./keys.js";
import { notice } from "./notice.js";
import { Picture, labelsOf } from "./picture.js";
import { Placements, evidence } from "./placements.js";
import { World } from "./scene.js";
import { Seen } from "./seen.js";
import { askForToken } from "./sign_in.js";
import { Stops } from "./stops.js";
import { Stored } from "./stored.js";
import { System } from "./system.js";
import { followTheme } from "./theme.js";
import { showTip } from "./tip.js";
import { centimetres, colorOf } from "./words.js";

const LAYERS = { cloud: "Cloud", surfaces: "Surfaces", placements: "Places", arm: "Arm", way: "Way", zones: "Keep-out" };
/** How far an object may seem to have moved between two segmentations of one picture, metres. */
const SAME_M = 0.03;
const ROLES = ["viewer", "planner", "operator"];
const stored = new Stored(() => sessionStorage), seen = new Seen(), stops = new Stops((text) => notice(text, "stop"));

let role = "viewer", cell, camera, robot, page;
let scene, newest, isHeld = false, hasWatched = false, myPlan, hadPlan;
/** The requests for places and for the motion to one that are under way. */
let asked, planning;
/** The cell that the console's messages are of, and how often one was asked for. */
let toldOf, watches = 0;
/** How often an answer was cleared: one that comes after that is of a goal of before. */
let cleared = 0;
/** The plan that this page has begun to carry out and whose places are still shown: they go with its end. */
let carriedOut;
/** Since when a camera is looked for. */
let watchedAt;
const robots = new Map();

/** Makes of a function one that does nothing once what `chosen()` gives is another than it is now: what is answered about one cell or robot changes nothing
 *  of what is shown of the next. */
const whileChosen = (chosen) => (then) => {
  const asked = String(chosen());
  return (told) => (String(chosen()) === asked ? then(told) : undefined);
};
const ofCell = whileChosen(() => [cell]), ofRobot = whileChosen(() => [cell, robot]);
const rejected = (refusal) => { throw refusal; };

// The console. First, so that it answers while the parts are made.

const connection = new Connection(heard, (state, reason) => {
  byId("link").className = `link ${state}`;
  byId("link").lastElementChild.textContent = { live: "Live", lost: "Connection lost", full: "Full", token: "Signed out" }[state];
  document.body.classList.toggle("stale", state !== "live");
  if (state === "lost") notice({ message: `The connection to the console is lost${reason ? `: ${reason}` : ""}. Trying again; what is shown may be out of date.` }, "bad");
  if (state === "full") notice({ message: `Not connected: ${reason || "as many pages are open as this console serves"}. Trying again; what is shown may be out of date.` }, "bad");
  if (state === "token") askForToken((token) => connection.signIn(token));
});

// The parts.

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
const goal = new Goal(byId("goal"), { changed: goalChanged, ask: find, collect: () => scene && sequence.add(goal.request(scene.id, world.yaw)), cancel: giveUp });
const placements = new Placements(byId("answers"), { lit, reason: (reason) => world.litRejected(reason), plan: planMotion });
const motion = new Motion(byId("motion"), { execute, reset, recover, preview: (t) => world.previewAt(t) });
const arrangement = new Arrangement(byId("arrangement"), {
  ask: (request) => connection.ask("arrange", { request }), cancel: (request) => connection.cancel(request),
  run: (request) => connection.ask("bring_about", { robot, request }).then(ofCell(() => { sequence.clear(); goal.clear(); release(); }), ofCell(rejected)),
  end: () => connection.ask("end_sequence").catch(ofCell((refusal) => notice(refusal, "bad"))),
});
const sequence = new Sequence(byId("sequence"), { run: runSequence, arrange: (goals) => arrangement.find(goals), end: () => connection.ask("end_sequence").catch(ofCell((refusal) => sequence.fault(refusal))) });
const system = new System(byId("system"), { stop, newScene: (seed) => connection.ask("new_scene", { seed }).then(ofCell(() => release()), ofCell((refusal) => notice(refusal, "bad"))) });

function lit(rank) {
  placements.lit(rank);
  world.lit(rank);
}

// What the console says.

async function heard(kind, message) {
  switch (kind) {
    case "welcome": return welcomed(message);
    case "watching": toldOf = message.cell; return;
    case "cells": return choices(byId("cell"), [...new Set([cell, ...message.cells])].filter(Boolean).sort(), cell);
  }
  // What was on its way when another cell, or another of its cameras, was chosen is not of that one.
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
  notice();
  role = welcome.role;
  system.welcome(welcome);
  const may = (needed) => ROLES.indexOf(role) >= ROLES.indexOf(needed);
  goal.may(may("planner"));
  placements.may(may("planner"));
  motion.may(may("operator"));
  sequence.may(may("operator"));
  arrangement.may(may("planner"), may("operator"));
  cell ??= stored.get("cell") || welcome.cell;
  choices(byId("cell"), [cell], cell);
  camera ??= stored.get("camera") || undefined;
  // The console has forgotten this viewer's plan. What is under way is told again where it still is: a console that was started anew knows of nothing.
  myPlan = undefined;
  planShown(undefined);
  if (motion.isMoving || sequence.isUnderWay || arrangement.isUnderWay) heardOfActivity({});
  // The scenes of before are kept for a while.
  const released = () => { release(); notice({ message: "The held picture is known no longer: choose the goal again." }); };
  watch().then((isWatched) => isWatched && isHeld && connection.ask("hold", { scene_id: scene.id }).catch(ofCell(released)));
}

/** Looks at the chosen cell and camera; whether that is so. */
async function watch() {
  hasWatched = true;
  toldOf = undefined;
  // What was looked for before does not come any more.
  segment.isAsking = false;
  watchedAt = performance.now();
  const turn = ++watches;
  try {
    await connection.ask("watch", { cell, camera: camera ?? null });
    return true;
  } catch (refusal) {
    // The choice that has overtaken this one has an answer of its own.
    if (turn !== watches) return false;
    hasWatched = false;
    if (refusal.field !== "camera") notice(refusal, "bad");
    camera = undefined;
    return false;
  }
}

function systemShown(message) {
  system.show(message);
  world.showZones(message.workers.flatMap(({ load }) => load?.keep_out ?? []));
  byId("recording").hidden = !message.workers.some(({ load }) => load?.journals);
  const names = message.cameras.map(({ name }) => name);
  if (!hasWatched && names.length) watch();
  choices(byId("camera"), names, camera ?? newest?.camera);
  seen.cameras(message.cameras, camera ?? newest?.camera);
  drawSeen();
  forgetRobots(message.robots);
  choices(byId("robot"), message.robots, robot);
  // The name may be one of another day: where others are there, and nothing came of it, it is waited for in vain.
  const isGone = camera !== undefined && names.length > 0 && !names.includes(camera) && !newest && seen.pictureAt === undefined && isStale(watchedAt);
  picture.waitFor(isGone ? camera : undefined, names, lookThrough);
}

async function pictureShown({ metadata, tensors }) {
  const heardAt = instantOf(metadata);
  if (isHeld) return void (seen.pictureAt = heardAt);
  // In the order in which they came: a recording that is played has stamps of before, and two cells have clocks of their own.
  const turn = ++pictureShown.came;
  const bitmap = await createImageBitmap(new Blob([tensors.jpeg], { type: "image/jpeg" }));
  // Of several that were being decoded, an older one may come last, or after another camera was chosen.
  if (isHeld || turn < pictureShown.first) return bitmap.close();
  [pictureShown.first, seen.pictureAt] = [turn, heardAt];
  picture.show(bitmap);
  drawSeen();
}
[pictureShown.came, pictureShown.first] = [0, 0];

/** What is shown, and on its way, is of a camera that is looked through no longer. */
function forgetPictures() {
  [pictureShown.first, newest, scene] = [pictureShown.came + 1];
  seen.forget();
  picture.forget();
  drawObjects();
  drawSeen();
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
  const { query, anchors } = goal.marks, ids = new Map([...(scene?.objects.keys() ?? [])].map((id) => [`object-${id}`, id]));
  const chip = (key) => {
    const id = ids.get(key);
    return el("button", { type: "button", own: colorOf(id), data: { id },
      onclick: (event) => goal.pick(id, { shift: event.shiftKey }), onpointerenter: () => picture.lit(id), onpointerleave: () => picture.lit(0), onfocus: () => picture.lit(id), onblur: () => picture.lit(0),
    }, el("i"), `Object ${id}`);
  };
  keep(byId("objects"), [...ids.keys()], chip, (button, key) => {
    const id = ids.get(key), [u, v] = scene.middles.get(id) ?? [];
    button.className = `chip ${id === query ? "query" : anchors.includes(id) ? "anchor" : ""}`;
    button.setAttribute("aria-pressed", String(id === query || anchors.includes(id)));
    button.title = centimetres(scene.objects.get(id).extent_m);
    // Where it is in the picture: its number stands there.
    Object.assign(button.dataset, { u, v, width: scene.width, height: scene.height });
  });
}

function drawSeen() {
  const { kind, text } = seen.words(isHeld);
  Object.assign(byId("seen"), { className: `badge ${kind}`, textContent: text });
  document.body.classList.toggle("old-objects", seen.areObjectsOld);
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

function hold() {
  isHeld = true;
  drawSeen();
  connection.ask("hold", { scene_id: scene.id }).catch(ofCell((refusal) => notice(refusal)));
  showHeld();
}

/** Shows the picture of the scene's own instant, where it came with it: the live one may be of a later. */
async function showHeld() {
  const { tensors, id } = scene;
  if (!tensors.jpeg) return;
  const bitmap = await createImageBitmap(new Blob([tensors.jpeg], { type: "image/jpeg" }));
  // Let go of meanwhile, it is older than what is shown.
  if (isHeld && scene?.id === id) picture.show(bitmap);
  else bitmap.close();
}

/** Asks perception for the object at a pixel that shows none. */
function segment(pixel) {
  if (!scene || segment.isAsking || ROLES.indexOf(role) < 1) return;
  segment.isAsking = true;
  segment.pixel = pixel;
  notice({ message: "Looking for an object there …" });
  // Its answer says that it was found; the scene that it is in, which is larger, may come after that.
  connection.ask("segment", { scene_id: scene.id, pixel }).catch(ofCell((refusal) => {
    segment.isAsking = false;
    notice(refusal, "bad");
  }));
}

/** Takes the scene in which perception has looked for an object: what was picked is found in it by where it is. */
function segmented(message) {
  const found = sceneOf(message), [u, v] = segment.pixel;
  segment.isAsking = false;
  // Of the camera before: another was chosen meanwhile.
  if (camera && found.camera !== camera) return;
  const again = (id) => {
    const was = scene.objects.get(id)?.centroid_m, distance = ({ centroid_m }) => Math.hypot(...centroid_m.map((x, k) => x - was[k]));
    const nearest = was && [...found.objects.values()].sort((a, b) => distance(a) - distance(b))[0];
    return nearest && distance(nearest) < SAME_M ? nearest.id : 0;
  };
  goal.rename(again);
  isHeld = true;
  adopt(found);
  showHeld();
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

/** Gives up what is being asked about the goal: places for it, or the motion to one. */
function giveUp() {
  [asked, planning].forEach((request) => request && connection.cancel(request));
}

function clearAnswer() {
  cleared++;
  carriedOut = undefined;
  giveUp();
  placements.clear();
  world.showPlacements(0, []);
  world.showRejected({});
  discard();
}

/** Lets this viewer's plan go. */
function discard() {
  if (!myPlan) return;
  connection.ask("discard", { plan: myPlan }).catch(() => {});
  myPlan = undefined;
  planShown(undefined);
  placements.planned(undefined);
}

async function find() {
  if (asked || !scene || !goal.isComplete) return;
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
  if (planning || !placed?.placements.length) return;
  if (!robot) return placements.fault({ code: "unavailable", message: "No robot tells its state in this cell." });
  const turn = cleared, isWanted = ofRobot(() => turn === cleared);
  placements.planning(true);
  const answer = connection.ask("plan", {
    scene_id: placed.scene_id, robot, query: placed.query, placements: placed.placements.map((p) => p.placed_from_observed), seed: placed.seed });
  planning = answer.id;
  try {
    const { plan } = await answer;
    // The goal was changed while the motion was planned, or another robot was chosen: that one is nobody's.
    if (!isWanted()) return void connection.ask("discard", { plan }).catch(() => {});
    myPlan = plan;
    motion.mine(hadPlan?.plan === myPlan);
    placements.planned(hadPlan?.plan === myPlan ? hadPlan : undefined);
  } catch (refusal) {
    if (isWanted()) placements.fault(refusal);
  } finally {
    planning = undefined;
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
  // Only the page that asked has this answer: whoever else looks keeps goal and places.
  connection.ask("execute", { plan }).catch(ofRobot((refusal) => motion.fault(refusal))).finally(() => carriedOut === plan && clearAnswer());
  carriedOut = plan;
  follow();
}

/** The picture is live while the robot moves; the ghosts stay to compare with. The goal does not: its ids are those of the picture that is let go of. */
function follow() {
  isHeld = false;
  goal.forget();
  picture.mark(goal.marks);
  world.mark(goal.marks);
  if (newest) adopt(newest);
  drawSeen();
}

function heardOfActivity({ execution, sequence: several, arrangement: arranged }) {
  motion.execution(execution);
  sequence.running(several);
  arrangement.running(arranged);
}

function robotShown(shown) {
  shown.heardAt = instantOf(shown);
  robots.set(shown.robot, shown);
  if (!robot || !robots.has(robot)) {
    robot = shown.robot;
    choices(byId("robot"), [...robots.keys()].sort(), robot);
  }
  world.showRobot(shown);
  if (isStopped(shown.state) && !isStale(shown.heardAt)) stops.confirmed(toldOf, shown.robot);
  if (shown.robot === robot) chosenShown();
}

/** Lets robots go that the console knows no more: they have said nothing for long, and may have other names by now. */
function forgetRobots(known) {
  const gone = [...robots.values()].filter(({ robot: name, heardAt }) => !known.includes(name) && isStale(heardAt));
  for (const { robot: name } of gone) {
    robots.delete(name);
    world.forgetRobot(name);
  }
  if (!gone.some(({ robot: name }) => name === robot)) return;
  [robot] = [...robots.keys()].sort();
  robotChosen();
}

/** What is planned and carried out from here on is of the robot that was chosen. */
function robotChosen() {
  if (planning) connection.cancel(planning);
  placements.planning(false);
  discard();
  motion.fault();
  chosenShown();
}

/** Shows the chosen robot as it was last heard of. */
function chosenShown() {
  // A robot that has fallen silent may have been switched off and on since: its stop is none that anybody knows of now.
  const shown = robots.get(robot), hasStopped = isStopped(shown?.state) && !isStale(shown.heardAt), button = byId("stop");
  motion.robot(shown);
  button.classList.toggle("latched", hasStopped);
  // It stops one robot: of several it says which.
  button.textContent = `${hasStopped ? "Stopped" : "Stop"}${robots.size > 1 ? ` ${robot}` : ""}`;
}

/** Stops the chosen robot; where none is known, whichever is there. */
function stop() {
  // What comes of it stands on the page behind.
  system.close();
  stops.follow(cell, robot, connection.stop(cell, robot, "stopped from the console"));
}

/** Clears the stop that is shown, and none that has latched since. */
function reset(name, shown) {
  motion.fault();
  connection.ask("reset", { robot: name, stop: shown }).catch(ofRobot((refusal) => motion.fault(refusal)));
}

/** Brings an arm back; what is said of it, or the refusal. Neither is of a cell that was chosen meanwhile. */
async function recover(name, move, unchecked) {
  const answered = connection.ask("recover", { robot: name, move, unchecked });
  return await answered.then(ofCell((answer) => recovered(move, answer)), ofCell((refusal) => ({ refusal }))) ?? {};
}

function runSequence(goals) {
  return connection.ask("sequence", { scene_id: goals[0].scene.scene_id, robot, goals }).then(ofCell(() => { goal.clear(); release(); }), ofCell(rejected));
}

function lookThrough(name) {
  camera = name;
  stored.set("camera", camera);
  newest = undefined;
  goal.clear();
  release();
  forgetPictures();
  watch();
}

// The bar, the keys and the looks.

byId("stop").addEventListener("click", stop);
byId("follow").addEventListener("click", () => release());
byId("open-system").addEventListener("click", () => system.open());
byId("cell").addEventListener("change", ({ target }) => {
  cell = target.value;
  [camera, robot, newest, scene, myPlan] = [];
  robots.clear();
  world.forget();
  // An idle cell says nothing of what is carried out in it.
  planShown(undefined);
  heardOfActivity({});
  chosenShown();
  motion.fault();
  sequence.clear();
  arrangement.clear();
  isHeld = false;
  goal.clear();
  forgetPictures();
  stored.set("cell", cell);
  // Another cell's camera of that name is another camera.
  stored.set("camera", "");
  choices(byId("camera"), []);
  choices(byId("robot"), []);
  watch();
});
byId("camera").addEventListener("change", ({ target }) => lookThrough(target.value));
byId("robot").addEventListener("change", ({ target }) => {
  robot = target.value;
  robotChosen();
});

fill(byId("layers"), Object.entries(LAYERS).map(([name, text]) => el("button", { type: "button", textContent: text, "aria-pressed": "true", onclick: ({ currentTarget }) => {
  const on = currentTarget.getAttribute("aria-pressed") !== "true";
  currentTarget.setAttribute("aria-pressed", String(on));
  world.toggle(name, on);
  if (name === "placements") world.toggle("rejected", on);
} })), el("button", { type: "button", textContent: "Reset view", onclick: () => world.look() }));

followKeys({
  stop,
  pick: (id, how) => scene?.objects.has(id) && goal.pick(id, how),
  keys: {
    Enter: find, p: planMotion, e: () => byId("execute")?.click(), r: () => byId("reset")?.click(), n: () => goal.negate(), a: () => goal.addTerm(),
    Escape: () => { goal.clear(); release(); },
  },
});

followTheme(() => picture.mark(goal.marks));
drawSeen();
// What comes no longer says nothing by itself.
setInterval(() => { drawSeen(); chosenShown(); }, 1000);
