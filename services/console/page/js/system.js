// The system: every worker with its load, every camera with its rate.

import { el, fill } from "./element.js";
import { milliseconds } from "./words.js";

/** A worker that has told no load for so long is asked for nothing, milliseconds. */
const SUSPECT_MS = 1000;

export class System {
  #shown; #welcome; #parts; #seed = 1;

  /** `newScene(seed)` resets a simulated cell; `stop()` stops the robot. */
  constructor(dialog, actions) {
    this.dialog = dialog;
    this.actions = actions;
  }

  open() { this.#draw(); this.#refresh(); this.dialog.showModal(); }
  close() { this.dialog.close(); }
  show(shown) { this.#shown = shown; if (this.dialog.open) this.#refresh(); }
  welcome(welcome) { this.#welcome = welcome; }

  /** Draws what stays while it is open. Only the tables' rows are drawn anew with every message: what is clicked, typed into or scrolled is left as it is. */
  #draw() {
    const { title, version, role, workers, cameras, simulated } = this.#parts = {
      title: el("h2", { id: "system-title" }), version: el("span", { className: "badge" }), role: el("span", { className: "badge" }),
      workers: el("tbody"), cameras: el("tbody"), simulated: this.#simulated(),
    };
    fill(this.dialog,
      // A stop, too: nothing of the page behind can be clicked.
      el("div", { className: "title" }, title, version, role, el("span", { className: "grow" }),
        el("button", { type: "button", className: "stop", id: "system-stop", textContent: "Stop", title: "Emergency stop (S)", onclick: () => this.actions.stop() }),
        el("button", { type: "button", className: "quiet small", textContent: "Close", autofocus: true, onclick: () => this.close() })),
      el("div", { className: "scroll" }, el("table", { id: "workers" },
        el("thead", {}, el("tr", {}, ["Service", "Worker"].map((name) => el("th", { textContent: name })), ["Waiting", "In flight", "Time a call"].map((name) => el("th", { className: "num", textContent: name })),
          ["Version", "Weights", "Kernel", ""].map((name) => el("th", { textContent: name })))),
        workers)),
      el("h2", { textContent: "Cameras", style: "margin: 16px 0 4px" }),
      el("div", { className: "scroll" }, el("table", {}, cameras)),
      simulated,
      el("h2", { textContent: "Keys", style: "margin: 16px 0 4px" }),
      el("div", { className: "keys" }, [["S", "stop the robot"], ["Enter", "find places"], ["P", "plan the motion"], ["E", "execute"], ["R", "clear the stop"], ["N", "not"], ["A", "another term"],
        ["1 – 9", "pick an object"], ["Esc", "clear the goal"]].map(([key, does]) => [el("kbd", { textContent: key }), el("span", { textContent: does })])));
  }

  #refresh() {
    const { workers = [], cameras = [], cell = "" } = this.#shown ?? {}, { version = "", role = "" } = this.#welcome ?? {}, parts = this.#parts;
    parts.title.textContent = `Cell ${cell}`;
    parts.version.textContent = `console ${version}`;
    parts.role.textContent = `you: ${role}`;
    fill(parts.workers, workers.map(worker), !workers.length && el("tr", {}, el("td", { colSpan: 9, className: "muted", textContent: "No worker is alive in this cell." })));
    fill(parts.cameras, cameras.map(({ name, scenes_per_s, age_ms }) => el("tr", {}, el("td", { textContent: name }),
      el("td", { className: "num", textContent: `${scenes_per_s.toFixed(1)} scenes/s` }), el("td", { className: "num", textContent: `newest ${milliseconds(age_ms)} old` }))));
    parts.simulated.hidden = role !== "operator" || !workers.some(({ service }) => service === "simulator");
  }

  #simulated() {
    const seed = el("input", { type: "number", min: 0, value: this.#seed, id: "scene-seed", oninput: ({ target }) => { this.#seed = target.value; } });
    return el("div", { className: "row", style: "margin-top: 16px" }, el("label", { htmlFor: "scene-seed", textContent: "Simulated scene" }), seed,
      el("button", { type: "button", textContent: "Set up", onclick: () => { this.actions.newScene(Number(this.#seed)); this.close(); } }));
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
