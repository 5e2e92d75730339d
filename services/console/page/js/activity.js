// The robot and what it carries out: its mode and stop, the planned motion, the phases, and the sequence of goals.

import { isStale } from "./age.js";
import { el, fill, foldOut } from "./element.js";
import { faultBox } from "./goal.js";
import { STAGES, plain, seconds, sentence, termWords } from "./words.js";

const OUTCOMES = { done: "Done", stopped: "Stopped", grasp_lost: "The grasp was lost" };
const RECOVERIES = { open: "Open the hand", retreat: "Back off", home: "Home" };
const PREVIEW_STEP_MS = 50;

/** What is said of an arm that was brought back, or the refusal. */
export function recovered(move, { outcome, reason, checked_against: scene, camera }) {
  if (outcome !== "done") return { refusal: { code: outcome, message: reason ?? "it did not get there" } };
  if (move === "open") return { said: "The hand is open." };
  return { said: `${move === "home" ? "The arm is home" : "The hand has backed off"}; its way was checked against ${scene ? `the scene of camera ${camera}` : "itself and the keep-out zones only, not against its surroundings"}.` };
}

/** Whether a robot is stopped; it may be without saying why. */
export const isStopped = (state) => state?.mode === "stopped" || !!state?.stop;

const gripperWords = ({ gripper_width_m: width, gripper_holding: isHolding, held }) => `gripper ${(1000 * width).toFixed(0)} mm${isHolding ? `, holding${held ? ` object ${held.object}` : ""}` : ""}`;

export class Motion {
  #robot; #isSilent = false; #plan; #execution; #fault; #may = false; #playing; #isRecovering = false; #recovered; #drawn = ""; #at = 0; #way = [];

  /** `execute()`, `reset(robot, stop)`, `recover(robot, move, unchecked)`, which resolves to how it ended, and `preview(t_ms)` are what its parts ask for. */
  constructor(box, actions) {
    this.box = box;
    this.actions = actions;
    this.parts = [el("div"), el("div"), el("div")];
    box.append(...this.parts);
    this.render();
  }

  may(may) { this.#may = may; this.render(); }
  fault(refusal) { this.#fault = refusal; this.render(); }

  /** Takes a robot's state and when it was heard, or that there is none; draws only what a person would see change. */
  robot(shown) {
    this.#robot = shown;
    this.aged();
    const { state } = shown ?? {};
    // The gripper is not of these: its width flickers, and what somebody is about to click would be drawn anew under the pointer.
    const drawn = state && JSON.stringify([shown.robot, state.mode, state.stop, state.owner?.id]);
    if (drawn !== this.#drawn) {
      this.#drawn = drawn;
      this.render();
    }
    const gripper = this.box.querySelector("#gripper"), text = state && gripperWords(state);
    if (gripper && gripper.textContent !== text) gripper.textContent = text;
  }

  /** Looks whether the robot still tells its state. */
  aged() {
    const isSilent = isStale(this.#robot?.heardAt);
    if (isSilent === this.#isSilent) return;
    this.#isSilent = isSilent;
    this.render();
  }

  plan(plan) {
    clearInterval(this.#playing);
    this.#playing = undefined;
    this.#plan = plan;
    this.#at = 0;
    this.#fault = undefined;
    this.render();
  }

  execution(execution) {
    this.#execution = execution;
    if (this.#moves) this.#recovered = undefined;
    this.render();
  }

  /** Whether a robot of the cell carries something out. */
  get isMoving() { return !!this.#execution && !this.#execution.ended; }
  /** Whether that is not the robot that is shown. */
  get #isOfAnother() { return !!this.#robot && !!this.#execution && this.#execution.robot !== this.#robot.robot; }
  get #moves() { return this.isMoving && !this.#isOfAnother; }
  get isStopped() { return isStopped(this.#robot?.state); }

  render() {
    const { robot, state } = this.#robot ?? {}, [before, preview, after] = this.parts;
    fill(before,
      el("div", { className: "title" }, el("h2", { id: "motion-title", textContent: robot ? sentence(robot) : "Robot" }),
        state && el("span", { className: `badge ${this.#isSilent || state.mode === "stopped" ? "bad" : state.mode === "moving" ? "live" : ""}`, id: "mode",
          textContent: this.#isSilent ? `silent, was ${state.mode}` : state.mode }),
        el("span", { className: "grow" }),
        state && el("span", { className: "muted small numbers", id: "gripper", textContent: gripperWords(state) })),
      !state && el("p", { className: "hint", textContent: "No robot tells its state." }),
      this.isStopped && this.#stopped(robot, state.stop ?? undefined),
      this.#execution && this.#phases(this.#execution));
    // A slider that is drawn anew is let go of: it is, where another plan is shown or another may carry it out.
    const way = [this.#moves ? undefined : this.#plan, this.#mine, this.#may, this.isStopped];
    if (way.some((part, k) => part !== this.#way[k])) {
      this.#way = way;
      fill(preview, this.#plan && !this.#moves && this.#preview(this.#plan));
    }
    fill(after,
      state?.mode === "idle" && !this.#moves && this.#may && this.#recovery(robot),
      this.#fault && faultBox(this.#fault));
  }

  /** After a stop an arm may stand anywhere, with something in its hand. */
  #recovery(robot) {
    const recover = async (move, unchecked) => {
      this.#isRecovering = true;
      this.#fault = this.#recovered = undefined;
      this.render();
      this.#recovered = { robot, move, ...await this.actions.recover(robot, move, unchecked) };
      // Another robot may be shown by now, whose fault it is not.
      if (this.#robot?.robot === robot) this.#fault = this.#recovered.refusal;
      this.#isRecovering = false;
      this.render();
    };
    const button = (move, textContent, title) => el("button", { type: "button", className: "small", textContent, title, disabled: this.#isRecovering, data: { key: `recover-${move}` }, onclick: () => recover(move, false) });
    const { move, said, refusal } = this.#recovered?.robot === robot ? this.#recovered : {};
    return foldOut(this, { id: "recovery" }, { textContent: "Bring the arm back" },
      el("div", { className: "row", style: "margin-top: 8px" },
        button("open", "Open the hand", "What it holds falls, or stays where it stands"), button("retreat", "Back off", "Along the fingers, as far as the way is free"),
        button("home", "Home", "To the ready pose"), this.#isRecovering && el("span", { className: "hint small", textContent: "moving …" })),
      said && el("p", { className: "small", role: "status", id: "recovered", textContent: said }),
      // Where there is no scene to check the way against, or motion takes it for no good, a person says a second time that the arm may move.
      refusal && refusal === this.#fault && /^(unchecked|scene)/.test(refusal.field ?? "") && el("div", { className: "row" },
        el("button", { type: "button", className: "small", id: "recover-unchecked", textContent: `${RECOVERIES[move]} without a check`, disabled: this.#isRecovering,
          title: "Look at the cell first: the arm keeps clear of itself and of the keep-out zones, and of nothing else", onclick: () => recover(move, true) })));
  }

  #stopped(robot, stop) {
    return el("div", { className: "stopped" }, el("b", { textContent: "Stopped" }), stop ? `${sentence(stop.reason)} (${plain(stop.kind)})` : "The robot does not say why.",
      el("div", {}, el("button", { type: "button", id: "reset", textContent: "Clear the stop", disabled: !this.#may, title: "The robot may move again (R)", onclick: () => this.actions.reset(robot, stop) })));
  }

  #phases({ robot, phases, phase, ended, query, said }) {
    const isDone = ended?.outcome?.outcome === "done";
    const at = (k) => (isDone || k < phase ? "done" : k > phase ? "" : ended ? "failed" : "now");
    const text = !ended ? `Moving object ${query}: ${plain(phases[phase] ?? "")}` : ended.outcome
      ? `${OUTCOMES[ended.outcome.outcome] ?? ended.outcome.outcome}${isDone ? "" : ` in ${plain(phases[phase] ?? "")}`}` : `Ended in ${plain(phases[phase] ?? "")}`;
    return el("div", { id: "execution" },
      el("ol", { className: "phases", "aria-hidden": "true" }, phases.map((name, k) => el("li", { className: at(k), title: plain(name) }))),
      el("p", { className: "small", role: "status", id: "phase", textContent: this.#isOfAnother ? `Robot ${robot}: ${text}` : text }),
      ended?.outcome?.reason && el("p", { className: "small fails", textContent: ended.outcome.reason }),
      said?.map((line) => el("p", { className: "small muted said", textContent: sentence(line) })),
      ended?.error && faultBox(ended.error));
  }

  #preview(plan) {
    const slider = el("input", { type: "range", min: 0, max: Math.ceil(plan.duration_ms), step: 10, value: this.#at, "aria-label": "Instant of the planned motion", data: { key: "scrub" } });
    const label = el("span", { className: "muted small numbers" });
    const show = () => {
      const t = Number(slider.value), phase = plan.phases.findLast((p) => p.start_ms <= t);
      label.textContent = `${seconds(t)} of ${seconds(plan.duration_ms)} · ${plain(phase?.name ?? "")}`;
      this.#at = t;
      // At its start the plan has the arm where it is.
      this.actions.preview(t || undefined);
    };
    slider.addEventListener("input", show);
    const play = el("button", { type: "button", className: "quiet small", textContent: "▶ Preview", data: { key: "play" }, onclick: () => {
      clearInterval(this.#playing);
      slider.value = 0;
      this.#playing = setInterval(() => {
        const now = this.box.querySelector("input[type=range]");
        if (!now || Number(now.value) >= Number(now.max)) return clearInterval(this.#playing);
        now.value = Number(now.value) + 2 * PREVIEW_STEP_MS;
        now.dispatchEvent(new Event("input"));
      }, PREVIEW_STEP_MS);
    } });
    show();
    return el("div", { className: "scrub" }, slider, el("div", { className: "row" }, play, label, el("span", { className: "grow" }),
      this.#mine && el("button", { type: "button", className: "primary", id: "execute", textContent: "Execute", title: "The robot moves (E)", disabled: !this.#may || this.isStopped, onclick: () => this.actions.execute() })));
  }

  #mine = false;
  /** Whether the plan that is shown is this viewer's to carry out. */
  mine(mine) { this.#mine = mine; this.render(); }
}

/** Whether the steps of a sequence are the goals that were collected here: what somebody else has begun leaves them as they are. */
export function areOf(steps, goals) {
  const told = (of) => JSON.stringify(of.map(({ query, goal }) => [query, goal.map(({ relation, anchor, holds }) => [relation, anchor, holds])]));
  return told(steps) === told(goals);
}

export class Sequence {
  #goals = []; #running; #fault; #may = false; #isAsked = false;

  /** `run(goals)`, which ends when it has begun, `arrange(goals)` and `end()` are its buttons. */
  constructor(box, actions) {
    this.box = box;
    this.actions = actions;
    this.render();
  }

  may(may) { this.#may = may; this.render(); }
  fault(refusal) { this.#fault = refusal; this.render(); }
  /** Collects a goal. Objects have other numbers in another scene, so all that is collected is of one. */
  add(request) {
    const isOfAnother = this.#goals.some((goal) => goal.scene.scene_id !== request.scene.scene_id);
    if (isOfAnother) return this.fault({ code: "failed_precondition", message: "The goals here are of an earlier picture, in which objects had other numbers: carry them out or clear them first." });
    this.#goals.push(request);
    this.#fault = undefined;
    this.render();
  }
  clear() { this.#goals = []; this.#fault = undefined; this.render(); }
  get isEmpty() { return !this.#goals.length; }
  get isUnderWay() { return !!this.#running && !this.#running.ended; }

  /** Takes the sequence that the cell carries out. */
  running(sequence) {
    const began = sequence && !sequence.ended && (!this.#running || this.#running.ended);
    this.#running = sequence;
    if (began && areOf(sequence.steps, this.#goals)) this.#goals = [];
    this.render();
  }

  /** Has the goals carried out; a second click comes before the cell tells what the first has begun. */
  async #run() {
    if (this.#isAsked) return;
    [this.#isAsked, this.#fault] = [true];
    this.render();
    await this.actions.run(this.#goals).catch((refusal) => { this.#fault = refusal; });
    this.#isAsked = false;
    this.render();
  }

  render() {
    const running = this.#running, isUnderWay = this.isUnderWay;
    fill(this.box,
      el("div", { className: "title" }, el("h2", { id: "sequence-title", textContent: "Sequence" }), el("span", { className: "grow" }),
        isUnderWay && el("button", { type: "button", className: "small", id: "end-sequence", textContent: running.ending ? "Ends after this goal" : "End after this goal", disabled: !this.#may || running.ending, onclick: () => this.actions.end() })),
      !running && !this.#goals.length && el("p", { className: "hint", textContent: "Goals added here are carried out one after another, or brought about together." }),
      running && el("ol", { className: "steps", id: "steps" }, running.steps.map((step) => el("li", {},
        el("span", {}, `${step.query} `, step.goal.map((term, k) => [k ? ", " : "",
          el("span", { className: step.holds.length ? (step.holds[k] ? "holds" : "fails") : "", textContent: termWords(term) })])),
        el("span", { className: `badge ${step.stage === "held" ? "live" : step.stage === "failed" ? "bad" : ""}`, textContent: STAGES[step.stage] ?? step.stage }),
        step.said?.map((line) => el("span", { className: "said muted", textContent: sentence(line) })),
        step.error && el("span", { className: "why", textContent: `${step.error.message}${step.error.field ? ` (${step.error.field})` : ""}` })))),
      this.#goals.length > 0 && [
        el("ol", { className: "steps", id: "collected", style: running ? "margin-top: 8px" : "" }, this.#goals.map((goal, k) => el("li", {},
          el("span", { textContent: `${goal.query} ${goal.goal.map(termWords).join(", ")}` }),
          el("button", { type: "button", className: "quiet small", textContent: "✕", "aria-label": `Remove goal ${k + 1}`, data: { key: `remove-${k}` }, onclick: () => { this.#goals.splice(k, 1); this.render(); } })))),
        el("div", { className: "row", style: "margin-top: 8px" },
          el("button", { type: "button", className: "primary", id: "run", textContent: "One after another", disabled: !this.#may || isUnderWay || this.#isAsked, onclick: () => this.#run() }),
          el("button", { type: "button", id: "arrange", textContent: "All together", title: "Find moves after which all of them hold", onclick: () => this.actions.arrange(this.#goals) }),
          el("button", { type: "button", className: "quiet small", textContent: "Clear", onclick: () => this.clear() }))],
      this.#fault && faultBox(this.#fault));
  }
}
