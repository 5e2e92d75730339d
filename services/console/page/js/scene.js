// The scene in three dimensions: cloud, surfaces, ghosts of placements, the arm and its way. Drawn only when something has changed.

import * as THREE from "three";
import { OrbitControls } from "/vendor/three/OrbitControls.js";
import { Arm } from "./arm.js";
import { el } from "./element.js";
import { REJECTION_COLORS } from "./words.js";

THREE.Object3D.DEFAULT_UP.set(0, 0, 1);

/** sRGB bytes as linear 16-bit numbers, in which three.js takes colors of points. */
const LINEAR = Uint16Array.from({ length: 256 }, (_, i) => {
  const s = i / 255;
  return Math.round(65535 * (s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4));
});
/** Kept free around what the scene is first looked at for, metres. */
const MARGIN_M = 0.12;
/** Surfaces smaller than this share of the largest are not drawn. */
const LEAST_SURFACE = 0.04;
const BEST = 0x16a34a, FURTHER = 0x6f8fb8, QUERY = 0x2f7df0, ANCHOR = 0xd9822b, WAY = 0x2f7df0, KEEP_OUT = 0xdc2828;

const matrixOf = (rows) => new THREE.Matrix4().set(...rows);

/** Empties a group. Its materials are left to be collected: they hold nothing but a share in a program, and the last share that is given back takes the
 *  program along, to be compiled anew for the next cloud or answer. That takes longer than drawing it. */
function dispose(group) {
  group.traverse((part) => {
    part.geometry?.dispose();
    part.material?.map?.dispose();
  });
  group.clear();
}

/** A round dot: points are squares without it. */
function dot() {
  const canvas = el("canvas", { width: 32, height: 32 }), context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.beginPath();
  context.arc(16, 16, 14, 0, 7);
  context.fill();
  return new THREE.CanvasTexture(canvas);
}

/** A number that always faces the viewer. */
function numberSprite(text, color) {
  const canvas = el("canvas", { width: 64, height: 64 }), context = canvas.getContext("2d");
  context.fillStyle = color;
  context.beginPath();
  context.arc(32, 32, 28, 0, 7);
  context.fill();
  Object.assign(context, { fillStyle: "#fff", font: "600 34px system-ui, sans-serif", textAlign: "center", textBaseline: "middle" });
  context.fillText(text, 32, 34);
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false, transparent: true }));
  sprite.scale.setScalar(0.045);
  sprite.renderOrder = 5;
  return sprite;
}

/** Whether WebGL is computed by the processor. */
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), named = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = named ? gl.getParameter(named.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** One of each kind of what answers are drawn with, never shown: so that its programs are there before the first answer. */
function samples() {
  const group = new THREE.Group(), geometry = new THREE.BufferGeometry();
  group.visible = false;
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(9), 3));
  group.add(new THREE.Points(geometry, new THREE.PointsMaterial({ transparent: true })),
    new THREE.Points(geometry, new THREE.PointsMaterial({ map: dot(), transparent: true, alphaTest: 0.3 })),
    new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ transparent: true, depthWrite: false })),
    new THREE.Box3Helper(new THREE.Box3(), BEST), numberSprite("1", "#16a34a"));
  return group;
}

export class World {
  #dirty = true; #zones = "[]"; #scene; #cloud; #ghosts = []; #lit = -1; #isTurned = false; #fitted = 0; #marks = { query: 0, anchors: [] }; #preview;
  #ray = new THREE.Raycaster();

  /** `hovered(rank, event)` gets the ghost under the pointer, or -1; `moved()` is told when the viewer turns the scene. */
  constructor(box, { hovered, moved }) {
    this.box = box;
    this.canvas = el("canvas", { tabIndex: 0, role: "img", "aria-label": "The scene in three dimensions. Drag to turn, scroll to come nearer, arrow keys to move." });
    box.append(this.canvas);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(46, 1, 0.02, 60);
    this.camera.position.set(1.6, -1.2, 1.1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    Object.assign(this.controls, { enableDamping: false, minDistance: 0.1, maxDistance: 12, target: new THREE.Vector3(0.5, 0, 0.1) });
    this.controls.listenToKeyEvents(this.canvas);
    this.controls.addEventListener("start", () => { this.#isTurned = true; });
    this.controls.addEventListener("change", () => { this.redraw(); moved?.(); });
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x9aa6b5, 2.1));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(1, -1.5, 3);
    this.scene.add(sun);
    this.layers = Object.fromEntries(["cloud", "surfaces", "placements", "rejected", "arm", "way", "zones"].map((name) => {
      const group = new THREE.Group();
      this.scene.add(group);
      return [name, group];
    }));
    this.marked = new THREE.Group();
    this.scene.add(this.marked);
    this.arms = new Map();
    this.ghostArm = new Arm({ ghost: true });
    this.layers.way.add(this.ghostArm.group);
    this.canvas.addEventListener("pointermove", (event) => hovered(this.#ghostAt(event), event));
    this.canvas.addEventListener("pointerleave", (event) => hovered(-1, event));
    new ResizeObserver(() => this.#resize()).observe(box);
    this.#resize();
  }

  /** Begins to draw. Getting WebGL, and its first frame, hold the page up for a good part of a second where it is drawn in software: for when what
   *  comes first is shown. */
  async begin() {
    // In software smooth edges make a frame three times as long.
    const renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: !isSoftware(), alpha: true, powerPreference: "low-power" });
    renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
    // Asking for a program's errors waits until it is compiled.
    renderer.debug.checkShaderErrors = false;
    this.scene.add(samples());
    // Beside the page, which goes on meanwhile.
    await renderer.compileAsync(this.scene, this.camera);
    this.renderer = renderer;
    // A machine that slept, or whose driver started anew, takes all that was drawn with it. After the renderer's own listener, which makes it ready again.
    this.canvas.addEventListener("webglcontextrestored", () => this.redraw());
    this.#resize();
    const frame = () => {
      if (this.#dirty && !document.hidden) {
        this.#dirty = false;
        renderer.render(this.scene, this.camera);
        document.body.dataset.drawn ??= Math.round(performance.now());
      }
      requestAnimationFrame(frame);
    };
    frame();
  }

  redraw() { this.#dirty = true; }

  /** Looks at everything when there is more to see, until the viewer has turned the scene. */
  #fit() {
    const shown = (this.boxes?.size ? 1 : 0) + this.arms.size;
    if (!this.#isTurned && shown > this.#fitted && this.look()) this.#fitted = shown;
  }

  #resize() {
    const { clientWidth, clientHeight } = this.box;
    if (!clientWidth || !clientHeight) return;
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.renderer?.setSize(clientWidth, clientHeight, true);
    // At once: a resized canvas is empty until it is drawn.
    this.renderer?.render(this.scene, this.camera);
  }

  /** Shows or hides a layer. */
  toggle(name, on) { this.layers[name].visible = on; this.redraw(); }

  /** The viewer's yaw as the scene is looked at now: which way is "away", radians. It is never rolled, so that its line of sight tells. */
  get yaw() {
    const away = this.controls.target.clone().sub(this.camera.position);
    return Math.atan2(-away.x, away.y);
  }

  /** Takes a scene: its cloud and its surfaces. */
  show(scene) {
    this.#scene = scene;
    dispose(this.layers.cloud);
    dispose(this.layers.surfaces);
    const { points, point_labels: labels, colors } = scene.tensors, { low_m: low, step_m: step } = scene.grid;
    const linear = new Uint16Array(points.length).fill(30000);
    if (colors) for (let i = 0; i < colors.length; i++) linear[i] = LINEAR[colors[i]];
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(linear, 3, true));
    const span = 65535 * step;
    geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(32768, 32768, 32768), 65536);
    const size = Math.min(0.012, Math.max(0.003, 1.1 * span / Math.sqrt(Math.max(1, labels.length))));
    this.#cloud = new THREE.Points(geometry, new THREE.PointsMaterial({ size, vertexColors: true }));
    this.#cloud.position.set(...low);
    this.#cloud.scale.setScalar(step);
    this.layers.cloud.add(this.#cloud);
    const least = LEAST_SURFACE * Math.max(...scene.meta.surfaces.map(({ area_m2 }) => area_m2));
    for (const surface of scene.meta.surfaces) if (surface.area_m2 >= least) this.#addSurface(surface);
    this.boxes = boxesOf(points, labels, low, step);
    this.#drawMarks();
    this.#fit();
    this.redraw();
  }

  #addSurface({ outline_m: outline, height_m: height, object }) {
    if (outline.length < 3 || object) return;
    const flat = new THREE.ShapeGeometry(new THREE.Shape(outline.map(([x, y]) => new THREE.Vector2(x, y))));
    const color = 0x6b9080;
    const area = new THREE.Mesh(flat, new THREE.MeshBasicMaterial({ color, transparent: true, opacity: 0.13, side: THREE.DoubleSide, depthWrite: false }));
    area.position.z = height - 0.002;
    const ring = [...outline, outline[0]].map(([x, y]) => new THREE.Vector3(x, y, height));
    this.layers.surfaces.add(area, new THREE.Line(new THREE.BufferGeometry().setFromPoints(ring), new THREE.LineBasicMaterial({ color })));
  }

  /** Looks from beside the sensor at the objects and the robots, from so far that all of them are in sight; whether there are any. */
  look() {
    if (!this.#scene || !this.boxes) return false;
    const places = [];
    for (const { min, max } of this.boxes.values()) places.push(min, max);
    places.push(...this.#ghosts.map(middleOf));
    for (const { links } of this.arms.values()) links.forEach(({ matrix }) => places.push(new THREE.Vector3().setFromMatrixPosition(matrix)));
    if (!places.length) return false;
    const center = new THREE.Box3().setFromPoints(places).getCenter(new THREE.Vector3());
    const { camera, view_yaw_rad: yaw } = this.#scene.meta;
    const eye = new THREE.Vector3().setFromMatrixPosition(matrixOf(camera.world_from_camera)).sub(center);
    // From the viewer's side: a camera right above the objects is on no side of them.
    const level = Math.max(0.01, Math.hypot(eye.x, eye.y));
    const away = new THREE.Vector3(Math.sin(yaw) * level, -Math.cos(yaw) * level, eye.z).applyAxisAngle(new THREE.Vector3(0, 0, 1), 0.5).normalize();
    away.z = Math.max(away.z, 0.45);
    away.normalize();
    const right = new THREE.Vector3(0, 0, 1).cross(away).normalize(), up = away.clone().cross(right);
    const tall = Math.tan(0.5 * THREE.MathUtils.degToRad(this.camera.fov)), wide = tall * this.camera.aspect;
    // Each place must lie within the cone of sight, with a margin for what stands around it.
    const distance = Math.max(...places.map((place) => {
      const p = place.clone().sub(center);
      return p.dot(away) + Math.max((Math.abs(p.dot(right)) + MARGIN_M) / wide, (Math.abs(p.dot(up)) + MARGIN_M) / tall);
    }));
    this.controls.target.copy(center);
    this.camera.position.copy(center).addScaledVector(away, distance);
    this.controls.update();
    return true;
  }

  /** Marks the object to move and the anchors with boxes. */
  mark(marks) { this.#marks = marks; this.#drawMarks(); }

  #drawMarks() {
    dispose(this.marked);
    const draw = (id, color) => {
      const bounds = this.boxes?.get(id);
      if (bounds) this.marked.add(new THREE.Box3Helper(bounds, color));
    };
    draw(this.#marks.query, QUERY);
    new Set(this.#marks.anchors).forEach((id) => draw(id, ANCHOR));
    this.redraw();
  }

  /** Shows the boxes that no arm may enter. They are told of again and again, and hardly ever change. */
  showZones(zones) {
    const shown = JSON.stringify(zones);
    if (shown === this.#zones) return;
    this.#zones = shown;
    dispose(this.layers.zones);
    for (const { min_m, max_m } of zones) {
      const bounds = new THREE.Box3(new THREE.Vector3(...min_m), new THREE.Vector3(...max_m));
      const body = new THREE.Mesh(new THREE.BoxGeometry(...bounds.getSize(new THREE.Vector3()).toArray()),
        new THREE.MeshBasicMaterial({ color: KEEP_OUT, transparent: true, opacity: 0.08, depthWrite: false }));
      bounds.getCenter(body.position);
      this.layers.zones.add(body, new THREE.Box3Helper(bounds, KEEP_OUT));
    }
    this.redraw();
  }

  /** Shows placements of an object as ghosts, best first. */
  showPlacements(query, placements) {
    dispose(this.layers.placements);
    this.#ghosts = [];
    this.#lit = -1;
    if (!this.#scene) return;
    const own = this.#cloud && ownPoints(this.#scene, query);
    const bounds = this.boxes?.get(query);
    placements.forEach(({ placed_from_observed: rows }, rank) => {
      const ghost = new THREE.Group(), color = rank === 0 ? BEST : FURTHER;
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(own ?? new Float32Array(), 3));
      const material = new THREE.PointsMaterial({ color, size: 0.0055, transparent: true, opacity: rank === 0 ? 0.95 : 0.5 });
      ghost.add(new THREE.Points(geometry, material));
      if (bounds) {
        const frame = new THREE.Box3Helper(bounds, color);
        const body = new THREE.Mesh(new THREE.BoxGeometry(...bounds.getSize(new THREE.Vector3()).toArray()),
          new THREE.MeshBasicMaterial({ color, transparent: true, opacity: 0.1, depthWrite: false }));
        bounds.getCenter(body.position);
        const number = numberSprite(String(rank + 1), rank === 0 ? "#16a34a" : "#5d7797");
        number.position.set(body.position.x, body.position.y, bounds.max.z + 0.04);
        body.userData.rank = rank;
        ghost.add(frame, body, number);
        ghost.userData = { body, material };
      }
      ghost.applyMatrix4(matrixOf(rows));
      this.layers.placements.add(ghost);
      this.#ghosts.push(ghost);
    });
    // An answer that lies outside of what is seen is no answer to whoever looks.
    if (!this.#ghosts.every((ghost) => this.#isInSight(middleOf(ghost)))) this.look();
    this.redraw();
  }

  #isInSight(place) {
    const seen = place.clone().project(this.camera);
    return Math.max(Math.abs(seen.x), Math.abs(seen.y)) < 0.95 && seen.z < 1;
  }

  /** Lights a ghost up; -1 for none. */
  lit(rank) {
    if (rank === this.#lit) return;
    this.#lit = rank;
    this.#ghosts.forEach(({ userData: { body, material } }, k) => {
      if (!body) return;
      body.material.opacity = k === rank ? 0.38 : 0.1;
      material.opacity = k === rank || k === 0 ? 0.95 : 0.5;
    });
    this.redraw();
  }

  /** Shows where rejected candidates were, `{reason: [[x, y, z], …]}`: a dot each, in the reason's color. */
  showRejected(places) {
    dispose(this.layers.rejected);
    for (const [reason, at_m] of Object.entries(places)) {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(at_m.flat()), 3));
      const dots = new THREE.Points(geometry, new THREE.PointsMaterial({ color: REJECTION_COLORS[reason] ?? "#888888", map: dot(), size: 0.016, transparent: true, alphaTest: 0.3 }));
      dots.userData.reason = reason;
      this.layers.rejected.add(dots);
    }
    this.redraw();
  }

  /** Shows the candidates that were rejected for one reason alone; all of them for none. */
  litRejected(reason) {
    this.layers.rejected.children.forEach((dots) => { dots.visible = !reason || dots.userData.reason === reason; });
    this.redraw();
  }

  #ghostAt(event) {
    if (!this.#ghosts.length || !this.layers.placements.visible || event.buttons) return -1;
    const box = this.canvas.getBoundingClientRect();
    const at = new THREE.Vector2(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
    this.#ray.setFromCamera(at, this.camera);
    const bodies = this.#ghosts.map((ghost) => ghost.userData.body).filter(Boolean);
    return this.#ray.intersectObjects(bodies, false)[0]?.object.userData.rank ?? -1;
  }

  /** Moves a robot; one of whose links nobody knows where they are is not drawn. */
  showRobot({ robot, state, links }) {
    if (!links) return this.forgetRobot(robot);
    let arm = this.arms.get(robot);
    if (!arm) {
      this.arms.set(robot, (arm = new Arm()));
      this.layers.arm.add(arm.group);
    }
    // An arm that stands is told of twenty times a second: nothing needs to be drawn for it.
    const shown = `${links} ${state.gripper_width_m.toFixed(4)}`;
    if (arm.shown === shown) return;
    arm.shown = shown;
    arm.setLinks(links);
    arm.setOpening(state.gripper_width_m);
    this.#fit();
    this.redraw();
  }

  /** Takes a robot away. */
  forgetRobot(robot) {
    const arm = this.arms.get(robot);
    if (!arm) return;
    this.layers.arm.remove(arm.group);
    dispose(arm.group);
    this.arms.delete(robot);
    this.redraw();
  }

  /** Takes the robots away: another cell's come. */
  forget() {
    for (const { group } of this.arms.values()) dispose(group);
    this.arms.clear();
    Object.values(this.layers).forEach((group) => group !== this.layers.way && dispose(group));
    // Else zones like those of before would count as drawn.
    this.#zones = "[]";
    this.#scene = this.#cloud = this.boxes = undefined;
    this.#isTurned = false;
    this.#fitted = 0;
    this.showPlan(undefined);
  }

  /** Shows the way of a planned motion; none hides it. */
  showPlan(plan) {
    if (this.#preview) {
      this.layers.way.remove(this.#preview);
      dispose(this.#preview);
      this.#preview = undefined;
    }
    this.ghostArm.group.visible = false;
    this.plan = plan;
    if (plan?.poses.length > 1) {
      const places = [];
      for (const { tcp_m } of plan.poses) {
        const place = new THREE.Vector3(...tcp_m);
        if (!places.length || place.distanceTo(places.at(-1)) > 1e-3) places.push(place);
      }
      if (places.length > 1) {
        const way = new THREE.CatmullRomCurve3(places, false, "centripetal");
        this.#preview = new THREE.Mesh(new THREE.TubeGeometry(way, 160, 0.0045, 8), new THREE.MeshBasicMaterial({ color: WAY, transparent: true, opacity: 0.85 }));
        this.layers.way.add(this.#preview);
      }
    }
    this.redraw();
  }

  /** Shows the arm at an instant of the plan; none hides it. */
  previewAt(t_ms) {
    const poses = this.plan?.poses;
    this.ghostArm.group.visible = t_ms !== undefined && !!poses?.length;
    if (this.ghostArm.group.visible) {
      const pose = poses.findLast((p) => p.t_ms <= t_ms) ?? poses[0];
      this.ghostArm.setLinks(pose.links);
      this.ghostArm.setOpening(pose.gripper_m ?? 0.08);
    }
    this.redraw();
  }
}

/** Each object's box, world frame. */
function boxesOf(points, labels, low, step) {
  const boxes = new Map(), place = new THREE.Vector3();
  for (let i = 0; i < labels.length; i++) {
    if (!labels[i]) continue;
    let bounds = boxes.get(labels[i]);
    if (!bounds) boxes.set(labels[i], (bounds = new THREE.Box3()));
    bounds.expandByPoint(place.set(low[0] + step * points[3 * i], low[1] + step * points[3 * i + 1], low[2] + step * points[3 * i + 2]));
  }
  return boxes;
}

/** Where a ghost stands, world frame. */
const middleOf = (ghost) => (ghost.userData.body?.position.clone() ?? new THREE.Vector3()).applyMatrix4(ghost.matrix);

/** The points of one object, world frame. */
function ownPoints({ tensors: { points, point_labels: labels }, grid: { low_m: low, step_m: step } }, id) {
  const own = [];
  for (let i = 0; i < labels.length; i++) {
    if (labels[i] === id) for (let k = 0; k < 3; k++) own.push(low[k] + step * points[3 * i + k]);
  }
  return new Float32Array(own);
}
