// The goal: what to move, and what is to hold. Objects come from clicks on the picture or from their chips.

import { el, fill, foldOut } from "./element.js";
import { RELATIONS, VARIANTS, colorOf } from "./words.js";

const newTerm = () => ({ relation: "left_of", anchor: 0, holds: true });

export class Goal {
  query = 0;
  terms = [newTerm()];
  active = 0;
  options = { count: 3, rotation: "fixed", variant: "best", view: "camera", degrees: 0, clearance: "", seed: 0 };
  #isAsking = false; #fault; #may = true;

  /** `changed()` is told of every change; `ask()`, `collect()` and `cancel()` are the buttons. */
  constructor(box, actions) {
    this.box = box;
    this.actions = actions;
    this.render();
  }

  /** Takes a click on an object: the one to move first, then the anchor of the active term. */
  pick(id, { shift = false } = {}) {
    if (shift || !this.query) {
      this.query = id;
      this.terms.forEach((term) => { if (term.anchor === id) term.anchor = 0; });
    } else if (id === this.query) {
      this.query = 0;
    } else {
      const term = this.terms[this.active];
      term.anchor = term.anchor === id ? 0 : id;
    }
    this.#changed();
  }

  clear() {
    this.forget();
    this.actions.changed();
  }

  /** Clears the goal, and nothing that was found for it. */
  forget() {
    this.query = 0;
    this.terms = [newTerm()];
    this.active = 0;
    this.#fault = undefined;
    this.render();
  }

  /** Forgets objects that a scene does not have. */
  keep(ids) { this.rename((id) => (ids.has(id) ? id : 0)); }

  /** Gives every object the id that `again` gives for its old one. */
  rename(again) {
    const { query, anchors } = this.marks;
    if (this.query) this.query = again(this.query);
    this.terms.forEach((term) => { if (term.anchor) term.anchor = again(term.anchor); });
    if (query !== this.query || String(anchors) !== String(this.marks.anchors)) this.render();
  }

  get marks() {
    return { query: this.query, anchors: this.terms.map((term) => term.anchor).filter(Boolean), active: this.active };
  }

  get isEmpty() { return !this.query && this.terms.every((term) => !term.anchor); }
  get isComplete() { return !!this.query && this.terms.every((term) => term.anchor); }

  /** The request for a scene; `yaw` is the way the scene is looked at. */
  request(sceneId, yaw) {
    const { count, rotation, variant, view, degrees, clearance, seed } = this.options;
    const request = { scene: { scene_id: sceneId }, query: this.query, goal: this.terms.map((term) => ({ ...term })), count, rotation, variant, seed };
    if (view === "scene") request.view_yaw_rad = yaw;
    if (view === "degrees") request.view_yaw_rad = degrees * Math.PI / 180;
    if (clearance !== "") request.min_clearance_m = clearance / 1000;
    return request;
  }

  asking(is) { this.#isAsking = is; this.render(); }
  fault(refusal) {
    this.#fault = refusal;
    this.render();
    this.box.querySelector(".fault")?.scrollIntoView({ block: "nearest" });
  }
  /** Whether this viewer's role may ask. */
  may(may) { this.#may = may; this.render(); }

  #changed() {
    this.#fault = undefined;
    this.render();
    this.actions.changed();
  }

  /** Takes a number that was typed. The card stays as it is: a field tells of it when it is left, and what it is left for is pressed already. */
  #typed(name, field, number) {
    this.options[name] = number;
    field.value = number;
    this.#fault = undefined;
    this.box.querySelectorAll(".fault").forEach((fault) => fault.remove());
    this.box.querySelectorAll(".wrong").forEach((part) => part.classList.remove("wrong"));
    this.actions.changed();
  }

  /** Whether the fault is about a field that starts so. */
  #wrong(...fields) { return fields.some((field) => this.#fault?.field?.startsWith(field)) ? " wrong" : ""; }

  #chip(id, kind, text, pressed) {
    const label = id ? `Object ${id}` : text;
    return el("button", {
      type: "button", className: `chip ${id ? kind : "open"}${pressed.active ? " active" : ""}`, own: id ? colorOf(id) : undefined,
      onclick: pressed.click, data: { key: pressed.key }, "aria-label": pressed.label, title: pressed.title,
    }, id ? el("i") : null, label);
  }

  render() {
    const complete = this.isComplete;
    fill(this.box,
      el("div", { className: "title" }, el("h2", { id: "goal-title", textContent: "Goal" }), el("span", { className: "grow" }),
        el("button", { type: "button", className: "quiet small", textContent: "Clear", data: { key: "clear" }, disabled: this.isEmpty && this.terms.length < 2, onclick: () => this.clear() })),
      el("div", { className: `sentence${this.#wrong("query")}` }, "Move",
        this.#chip(this.query, "query", "click an object", { key: "query", label: this.query ? `Move object ${this.query}` : "Object to move: none yet", title: "The object to move",
          click: () => { this.query = 0; this.#changed(); } }),
        this.query ? "so that it is" : ""),
      el("ul", { className: "terms" }, this.terms.map((term, k) => this.#term(term, k))),
      el("button", { type: "button", className: "quiet small", textContent: "+ and …", title: "Another term (A)", data: { key: "add" }, onclick: () => this.addTerm() }),
      this.#more(),
      el("div", { className: "row" },
        this.#isAsking
          ? el("button", { type: "button", textContent: "Give up", data: { key: "ask" }, onclick: () => this.actions.cancel() })
          : el("button", { type: "button", className: "primary", textContent: "Find places", title: "Ask the planner (Enter)", data: { key: "ask" },
              id: "ask", disabled: !complete || !this.#may, onclick: () => this.actions.ask() }),
        el("button", { type: "button", textContent: "Add to sequence", id: "collect", disabled: !complete || !this.#may, onclick: () => this.actions.collect() }),
        el("span", { className: "hint small", id: "progress", role: "status", textContent: this.#isAsking ? "searching …" : complete ? "" : this.#hint() })),
      this.#fault && faultBox(this.#fault));
  }

  #hint() {
    if (!this.query) return "Click the object to move.";
    return "Click the object that it goes by.";
  }

  addTerm() {
    this.terms.push(newTerm());
    this.active = this.terms.length - 1;
    this.#changed();
  }

  /** Turns the active term into its negation, and back. */
  negate() {
    const term = this.terms[this.active];
    term.holds = !term.holds;
    this.#changed();
  }

  #term(term, k) {
    const isActive = k === this.active && this.terms.length > 1;
    return el("li", { className: `term${this.#wrong(`goal[${k}]`)}` },
      k ? el("span", { className: "muted", textContent: "and" }) : null,
      el("button", { type: "button", className: "toggle", textContent: "not", "aria-pressed": String(!term.holds), title: "Must not hold (N)", data: { key: `not-${k}` },
        onclick: () => { term.holds = !term.holds; this.active = k; this.#changed(); } }),
      el("select", { "aria-label": `Relation ${k + 1}`, data: { key: `relation-${k}` }, onchange: ({ target }) => { term.relation = target.value; this.active = k; this.#changed(); } },
        Object.entries(RELATIONS).map(([value, text]) => el("option", { value, textContent: text, selected: value === term.relation }))),
      this.#chip(term.anchor, "anchor", "click its anchor", { key: `anchor-${k}`, active: isActive, title: "The next click on an object sets this anchor",
        label: term.anchor ? `Anchor: object ${term.anchor}` : "Anchor: none yet", click: () => { this.active = k; term.anchor = 0; this.#changed(); } }),
      this.terms.length > 1 && el("button", { type: "button", className: "quiet small", textContent: "✕", "aria-label": `Remove term ${k + 1}`,
        data: { key: `remove-${k}` }, onclick: () => {
          this.terms.splice(k, 1);
          // The active term stays the same one, unless it is this.
          this.active = Math.min(this.active - (k < this.active ? 1 : 0), this.terms.length - 1);
          this.#changed();
        } }));
  }

  #more() {
    const options = this.options;
    const select = (name, values, label) => el("select", { id: `option-${name}`, data: { key: `option-${name}` }, "aria-label": label, onchange: ({ target }) => { options[name] = target.value; this.#changed(); } },
      Object.entries(values).map(([value, text]) => el("option", { value, textContent: text, selected: value === options[name] })));
    const number = (name, fields, extra) => el("input", { type: "number", id: `option-${name}`, data: { key: `option-${name}` }, className: this.#wrong(fields).trim(), value: options[name],
      onchange: ({ target }) => this.#typed(name, target, target.value === "" ? (name === "clearance" ? "" : 0) : Number(target.value)), ...extra });
    const field = (name, text, ...inputs) => [el("label", { htmlFor: `option-${name}`, textContent: text }), el("div", { className: "row" }, inputs)];
    return foldOut(this, {}, { textContent: "Options", data: { key: "options" } },
      el("div", { className: "fields" },
        field("count", "Places wanted", number("count", "count", { min: 1, max: 64 })),
        field("rotation", "Turning", select("rotation", { fixed: "keep its direction", yaw: "may be turned upright", stable: "may be set on another side" })),
        field("view", "Left and right as", select("view", { camera: "the camera sees it", scene: "I look at the scene", degrees: "from a direction" }),
          options.view === "degrees" && number("degrees", "view_yaw_rad", { min: -180, max: 180, step: 5, "aria-label": "Direction, degrees" }), options.view === "degrees" && "°"),
        field("variant", "Method", select("variant", VARIANTS)),
        field("clearance", "Clearance", number("clearance", "min_clearance_m", { min: 0, max: 500, placeholder: "any" }), "mm"),
        field("seed", "Seed", number("seed", "seed", { min: 0 }))));
  }
}

/** An error of the contract's, in words. */
export function faultBox({ code, message, field }) {
  return el("div", { className: "fault", role: "alert" }, el("b", { textContent: `${code?.replaceAll("_", " ") ?? "error"}: ` }), message,
    field && el("span", {}, " (", el("code", { textContent: field }), ")"));
}
