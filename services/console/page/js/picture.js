// The camera's picture with its objects outlined; a click means the object that the pixel shows.

import { el, fill } from "./element.js";
import { centimetres, colorOf } from "./words.js";

/** The label of each pixel from runs of [label, length]. */
export function labelsOf(runs, count) {
  const labels = new Uint16Array(count);
  let at = 0;
  for (let i = 0; i < runs.length; i += 2) {
    labels.fill(runs[i], at, at + runs[i + 1]);
    at += runs[i + 1];
  }
  return labels;
}

/** Outlines of the labels as paths in pixel coordinates, and where each object's number stands: the pixel deepest within it. */
function outlines(labels, width, height) {
  const paths = new Map(), sums = new Map();
  const at = (u, v) => (u < 0 || v < 0 || u >= width || v >= height ? 0 : labels[v * width + u]);
  for (let v = 0; v < height; v++) {
    for (let u = 0; u < width; u++) {
      const label = labels[v * width + u];
      if (!label) continue;
      let path = paths.get(label);
      if (!path) paths.set(label, (path = new Path2D())), sums.set(label, [0, 0, 0]);
      const sum = sums.get(label);
      sum[0] += u; sum[1] += v; sum[2] += 1;
      if (at(u - 1, v) !== label) path.moveTo(u, v), path.lineTo(u, v + 1);
      if (at(u + 1, v) !== label) path.moveTo(u + 1, v), path.lineTo(u + 1, v + 1);
      if (at(u, v - 1) !== label) path.moveTo(u, v), path.lineTo(u + 1, v);
      if (at(u, v + 1) !== label) path.moveTo(u, v + 1), path.lineTo(u + 1, v + 1);
    }
  }
  const middles = new Map();
  for (const [label, [u, v, n]] of sums) middles.set(label, nearestOf(labels, width, label, u / n, v / n));
  return { paths, middles };
}

/** The pixel of a label nearest to a place: the mean of a ring lies in its hole. */
function nearestOf(labels, width, label, u, v) {
  let best = [u, v], least = Infinity;
  for (let i = 0; i < labels.length; i += 3) {
    if (labels[i] !== label) continue;
    const x = i % width, y = (i / width) | 0, d = (x - u) ** 2 + (y - v) ** 2;
    if (d < least) (least = d), (best = [x + 0.5, y + 0.5]);
  }
  return best;
}

export class Picture {
  #scene; #bitmap; #hovered = 0; #said; #marks = { query: 0, anchors: [], active: 0 };

  /** `picked(id, event)` gets the clicked object, or 0 and the pixel; `hovered(id, text)` what the pointer is over. */
  constructor(box, { picked, hovered }) {
    this.box = box;
    this.base = el("canvas", { role: "img", "aria-label": "The camera's picture" });
    this.over = el("canvas", { className: "over", "aria-hidden": "true" });
    this.empty = el("div", { className: "empty", role: "status" });
    this.waitFor();
    box.append(this.base, this.over, this.empty);
    this.over.addEventListener("pointermove", (event) => {
      const id = this.#idAt(event);
      if (id !== this.#hovered) this.lit(id);
      const object = this.#scene?.objects.get(id);
      hovered(id, object && `Object ${id} · ${centimetres(object.extent_m)}`, event);
    });
    this.over.addEventListener("pointerleave", (event) => { this.lit(0); hovered(0, undefined, event); });
    this.over.addEventListener("click", (event) => picked(this.#idAt(event), { shift: event.shiftKey, pixel: this.#pixelAt(event) }));
    new ResizeObserver(() => this.#draw()).observe(box);
  }

  /** The pixel of the scene, whose outlines are drawn: the picture under them may be a newer one of another size. */
  #pixelAt(event) {
    const box = this.over.getBoundingClientRect(), { width, height } = this.#scene ?? this.base;
    const within = (share, count) => Math.min(count - 1, Math.max(0, Math.floor(share * count)));
    return [within((event.clientX - box.left) / box.width, width), within((event.clientY - box.top) / box.height, height)];
  }

  #idAt(event) {
    if (!this.#scene) return 0;
    const [u, v] = this.#pixelAt(event);
    return this.#scene.labels[v * this.#scene.width + u] ?? 0;
  }

  /** Shows a picture under the outlines. */
  show(bitmap) {
    this.#bitmap?.close?.();
    this.#bitmap = bitmap;
    if (this.base.width !== bitmap.width || this.base.height !== bitmap.height) {
      Object.assign(this.base, { width: bitmap.width, height: bitmap.height });
      this.box.style.aspectRatio = `${bitmap.width} / ${bitmap.height}`;
    }
    this.base.getContext("2d").drawImage(bitmap, 0, 0);
    this.empty.hidden = true;
  }

  /** Shows nothing: what was shown is of another cell or camera, and no click is meant for it. */
  forget() {
    this.#bitmap?.close?.();
    this.#bitmap = this.#scene = undefined;
    this.base.getContext("2d").clearRect(0, 0, this.base.width, this.base.height);
    this.empty.hidden = false;
    this.#draw();
  }

  /** Says what is waited for: a picture, or that another camera is chosen in the place of one that is gone. */
  waitFor(gone, others = [], choose) {
    const said = gone === undefined ? "" : JSON.stringify([gone, others]);
    // Told every second; buttons that were drawn anew as often could not be clicked.
    if (said === this.#said) return;
    this.#said = said;
    fill(this.empty, gone === undefined ? "Waiting for the camera" : [
      el("p", { textContent: `There is no camera “${gone}” in this cell.` }),
      el("div", { className: "row" }, others.map((name) => el("button", { type: "button", textContent: `Look through ${name}`, data: { camera: name }, onclick: () => choose(name) })))]);
  }

  /** Takes the objects of a scene. */
  outline(scene) {
    this.#scene = Object.assign(scene, outlines(scene.labels, scene.width, scene.height));
    this.#draw();
  }

  /** Marks the object to move, the anchors, and the anchor that a click sets. */
  mark(marks) { this.#marks = marks; this.#draw(); }

  /** Lights one object up. */
  lit(id) { this.#hovered = id; this.#draw(); }

  #draw() {
    const { clientWidth, clientHeight } = this.box, ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(clientWidth * ratio), Math.round(clientHeight * ratio)];
    if (this.over.width !== width || this.over.height !== height) Object.assign(this.over, { width, height });
    const context = this.over.getContext("2d", { willReadFrequently: true });
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    const scene = this.#scene;
    if (!scene || !width) return;
    const scale = width / scene.width, style = getComputedStyle(this.box);
    const [query, anchor] = ["--query", "--anchor"].map((name) => style.getPropertyValue(name).trim());
    context.setTransform(scale, 0, 0, height / scene.height, 0, 0);
    context.lineJoin = context.lineCap = "round";
    for (const [id, path] of scene.paths) {
      const marked = id === this.#marks.query ? query : this.#marks.anchors.includes(id) ? anchor : undefined;
      const hovered = id === this.#hovered;
      context.globalAlpha = marked || hovered ? 0.85 : 0.5;
      context.strokeStyle = "#0b1016";
      context.lineWidth = ((marked ? 3.4 : 2.4) + (hovered ? 1.4 : 0)) * ratio / scale;
      context.stroke(path);
      context.globalAlpha = 1;
      context.strokeStyle = marked ?? colorOf(id);
      context.lineWidth = ((marked ? 2.4 : 1.3) + (hovered ? 1.2 : 0)) * ratio / scale;
      context.stroke(path);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = `600 11px ${style.fontFamily}`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [id, [u, v]] of scene.middles) {
      const [x, y] = [u * scale / ratio, v * scale / ratio];
      const marked = id === this.#marks.query ? query : this.#marks.anchors.includes(id) ? anchor : undefined;
      context.fillStyle = marked ?? "rgb(10 16 24 / 72%)";
      context.beginPath();
      context.arc(x, y, 9, 0, 7);
      context.fill();
      context.fillStyle = "#fff";
      context.fillText(String(id), x, y + 0.5);
    }
  }
}
