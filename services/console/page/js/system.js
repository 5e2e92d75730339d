// The system: every worker with its load, every camera with its rate.

import { el, fill } from "./element.js";
import { milliseconds } from "./words.js";

/** A worker that has told no load for so long is asked for nothing, milliseconds. */
const SUSPECT_MS = 1000;

export class System {
  #shown; #welcome; #seed = 1;

  /** `newScene(seed)` resets a simulated cell. */
  constructor(dialog, actions) {
    this.dialog = dialog;
    this.actions = actions;
  }

  open() { this.render(); this.dialog.showModal(); }
  show(shown) { this.#shown = shown; if (this.dialog.open) this.render(); }
  welcome(welcome) { this.#welcome = welcome; }

  render() {
    const { workers = [], cameras = [], cell = "" } = this.#shown ?? {}, { version = "", role = "" } = this.#welcome ?? {};
    const isSimulated = workers.some((worker) => worker.service === "simulator");
    fill(this.dialog,
      el("div", { className: "title" }, el("h2", { id: "system-title", textContent: `Cell ${cell}` }), el("span", { className: "badge", textContent: `console ${version}` }),
        el("span", { className: "badge", textContent: `you: ${role}` }), el("span", { className: "grow" }),
        el("button", { type: "button", className: "quiet small", textContent: "Close", data: { key: "close" }, onclick: () => this.dialog.close() })),
      el("div", { className: "scroll" }, el("table", { id: "workers" },
        el("thead", {}, el("tr", {}, ["Service", "Worker"].map((name) => el("th", { textContent: name })), ["Waiting", "In flight", "Time a call"].map((name) => el("th", { className: "num", textContent: name })),
          ["Version", "Weights", "Kernel", ""].map((name) => el("th", { textContent: name })))),
        el("tbody", {}, workers.map(worker), !workers.length && el("tr", {}, el("td", { colSpan: 9, className: "muted", textContent: "No worker is alive in this cell." }))))),
      el("h2", { textContent: "Cameras", style: "margin: 16px 0 4px" }),
      el("div", { className: "scroll" }, el("table", {}, el("tbody", {}, cameras.map(({ name, scenes_per_s, age_ms }) => el("tr", {}, el("td", { textContent: name }),
        el("td", { className: "num", textContent: `${scenes_per_s.toFixed(1)} scenes/s` }), el("td", { className: "num", textContent: `newest ${milliseconds(age_ms)} old` })))))),
      isSimulated && role === "operator" && this.#simulated(),
      el("h2", { textContent: "Keys", style: "margin: 16px 0 4px" }),
      el("div", { className: "keys" }, [["S", "stop the robot"], ["Enter", "find places"], ["P", "plan the motion"], ["E", "execute"], ["R", "clear the stop"], ["N", "not"], ["A", "another term"],
        ["1 – 9", "pick an object"], ["Esc", "clear the goal"]].map(([key, does]) => [el("kbd", { textContent: key }), el("span", { textContent: does })])));
  }

  #simulated() {
    // Kept here: this dialog is drawn anew with every message.
    const seed = el("input", { type: "number", min: 0, value: this.#seed, id: "scene-seed", data: { key: "scene-seed" }, oninput: ({ target }) => { this.#seed = target.value; } });
    return el("div", { className: "row", style: "margin-top: 16px" }, el("label", { htmlFor: "scene-seed", textContent: "Simulated scene" }), seed,
      el("button", { type: "button", textContent: "Set up", data: { key: "set-up" }, onclick: () => { this.actions.newScene(Number(this.#seed)); this.dialog.close(); } }));
  }
}

function worker({ service, name, load, silent_ms }) {
  const state = load?.draining ? "draining" : silent_ms > SUSPECT_MS ? `silent for ${milliseconds(silent_ms)}` : "";
  return el("tr", {},
    el("td", { textContent: service }), el("td", { textContent: name }),
    el("td", { className: "num", textContent: load ? `${load.queue_depth} of ${load.queue_capacity}` : "–" }),
    el("td", { className: "num", textContent: load?.in_flight ?? "–" }),
    el("td", { className: "num", textContent: load ? milliseconds(load.service_ms) : "–" }),
    el("td", { textContent: load?.version ?? "" }),
    el("td", {}, load?.weights_hash ? el("code", { textContent: load.weights_hash.slice(0, 8), title: load.weights_hash }) : ""),
    el("td", { textContent: load?.kernel ?? "" }),
    el("td", { className: "fails", textContent: state }));
}
