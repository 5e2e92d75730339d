// Goals that shall hold together at the end: the moves that bring it about, why there are none, and what carrying them out came to.

import { el, fill } from "./element.js";
import { faultBox } from "./goal.js";
import { STAGES, milliseconds, percent, sentence, termWords } from "./words.js";

const ENDS = {
  achieved: "All goals hold", no_arrangement: "No moves were found from here", gave_up: "Given up after several tries", lost: "An object is lost", stopped: "Stopped",
};

/** What is asked for once for all goals, and how it is called. */
const ALIKE = { view_yaw_rad: "Left and right as", rotation: "Turning", variant: "Method" };

/** The first option that not all of the collected goals have alike. */
const unlike = ([first, ...others]) => Object.keys(ALIKE).find((option) => others.some((goal) => goal[option] !== first[option]));

/** Whether a collected goal keeps a clearance: no arrangement is asked for one. */
const keepsClearance = (collected) => collected.some(({ min_clearance_m: clearance }) => clearance > 0);

/** Why what was collected cannot be asked for together without dropping something of it. */
function fault(collected) {
  const option = unlike(collected);
  if (option) return `Goals that shall hold together have one “${ALIKE[option]}”, and these have several.`;
  return keepsClearance(collected) ? "Goals together keep no clearance: clear that option, or carry them out one after another." : undefined;
}

/** One entry an object: what was collected about one object shall all hold. */
export function together(collected) {
  const [{ scene, view_yaw_rad, rotation, variant, seed }] = collected, goals = [];
  for (const { query, goal } of collected) {
    const own = goals.find(({ object }) => object === query) ?? goals[goals.push({ object: query, terms: [] }) - 1];
    const isKnown = (term) => own.terms.some((other) => other.relation === term.relation && other.anchor === term.anchor && other.holds === term.holds);
    own.terms.push(...goal.filter((term) => !isKnown(term)));
  }
  return { scene, goals, view_yaw_rad, rotation, variant, seed };
}

const goalWords = ({ object, terms }) => `${object} ${terms.map(termWords).join(", ")}`;
const purposeWords = ({ purpose, goal }) => (purpose === "aside" ? "set down aside, to make room" : `so that it is ${goal.map(termWords).join(" and ")}`);

/** Why there are no moves: the smallest set of goals, and whether that is proven. */
function conflictWords({ goals, proof, smallest }) {
  const named = goals.map((goal) => `“${goalWords(goal)}”`).join(" and ");
  if (proof === "contradiction") return `Proven: ${named} contradict each other on any table.`;
  const found = goals.length === 1 ? `No place was found for ${named} alone` : `No places were found for ${named} together; without any one of them there are`;
  return `${smallest || goals.length === 1 ? found : `No places were found for ${named} together; fewer of them may be to blame`}. Not proven: there may be an arrangement all the same.`;
}

export class Arrangement {
  #asked; #answer; #request; #running; #fault; #may = false; #mayRun = false; #isBegun = false;

  /** `ask(request)`, whose promise has the request's `id`, `cancel(id)`, `run(request)` and `end()` are what its buttons do. */
  constructor(box, actions) {
    this.box = box;
    this.actions = actions;
    this.render();
  }

  may(may, mayRun) { this.#may = may; this.#mayRun = mayRun; this.render(); }
  get isUnderWay() { return !!this.#running && !this.#running.ended; }

  /** Asks for moves after which all that was collected holds. */
  async find(collected) {
    if (!this.#may || !collected.length) return;
    const message = fault(collected);
    if (message) {
      this.#fault = { code: "invalid_argument", message };
      return this.render();
    }
    this.#giveUp();
    this.#request = together(collected);
    this.#answer = this.#fault = undefined;
    const answer = this.actions.ask(this.#request);
    this.#asked = answer.id;
    this.render();
    try {
      const found = await answer;
      if (this.#asked === answer.id) this.#answer = found;
    } catch (refusal) {
      if (this.#asked === answer.id && refusal.code !== "cancelled") this.#fault = refusal;
    }
    if (this.#asked !== answer.id) return;
    this.#asked = undefined;
    this.render();
    this.box.scrollIntoView({ block: "nearest" });
  }

  /** Takes the arrangement that the cell brings about. */
  running(running) {
    if (running && !running.ended) this.#answer = undefined;
    this.#running = running;
    this.render();
  }

  /** Has it brought about; a second click comes before the cell tells what the first has begun. */
  async #run() {
    if (this.#isBegun) return;
    [this.#isBegun, this.#fault] = [true];
    this.render();
    await this.actions.run(this.#request).catch((refusal) => { this.#fault = refusal; });
    this.#isBegun = false;
    this.render();
  }

  #giveUp() { if (this.#asked) this.actions.cancel(this.#asked); }

  clear() {
    this.#giveUp();
    this.#asked = this.#answer = this.#request = this.#fault = undefined;
    this.render();
  }

  render() {
    const answer = this.#answer, running = answer || this.#asked ? undefined : this.#running;
    this.box.hidden = !answer && !this.#asked && !running && !this.#fault;
    fill(this.box,
      el("div", { className: "title" }, el("h2", { id: "arrangement-title", textContent: "Together" }), el("span", { className: "grow" }),
        answer && el("span", { className: "muted small numbers", textContent: milliseconds(answer.took_ms), title: `by ${answer.worker}; ${answer.arranged.searches} placements searched` }),
        this.isUnderWay && el("button", { type: "button", className: "small", id: "end-arrangement", textContent: this.#running.ending ? "Ends after this move" : "End after this move",
          disabled: !this.#mayRun || this.#running.ending, onclick: () => this.actions.end() })),
      this.#asked && el("div", { className: "row" }, el("span", { className: "hint", role: "status", textContent: "searching for moves …" }),
        el("button", { type: "button", className: "small", textContent: "Give up", data: { key: "give-up" }, onclick: () => this.#giveUp() })),
      answer && this.#found(answer.arranged),
      running && this.#carriedOut(running),
      this.#fault && faultBox(this.#fault));
  }

  #found({ outcome, moves, satisfied, open, needs_view: needsView = [], probability, conflict }) {
    const count = `${moves.length} move${moves.length === 1 ? "" : "s"}`;
    const heading = outcome === "none" ? "There is no such arrangement." : needsView.length ? `After ${count} another view is needed.` : outcome === "partial" ? `The search was cut short; its best so far has ${count}.`
      : moves.length ? `After ${count} all goals hold.` : "All goals hold as things stand.";
    return [
      el("p", { id: "arranged", textContent: heading }),
      this.#moves(moves.map((move) => ({ ...move, success: move.placement.success })), "planned-moves"),
      typeof probability === "number" && el("p", { className: "small", id: "arranged-probability", textContent: `Probability that all moves succeed: ${percent(probability)}` }),
      satisfied.length > 0 && outcome !== "none" && el("p", { className: "small muted", textContent: `Their goals hold already: ${satisfied.join(", ")}` }),
      open.length > 0 && outcome === "partial" && el("p", { className: "small fails", textContent: `Still open: ${open.join(", ")}` }),
      needsView.length > 0 && el("p", { className: "small muted", id: "arranged-covered", textContent: `Covered in this view: the top of ${needsView.join(", ")}. Carried out together, the rest is planned when it is seen.` }),
      conflict && el("p", { className: "relax", id: "arranged-conflict", textContent: conflictWords(conflict) }),
      el("div", { className: "row", style: "margin-top: 8px" },
        (outcome === "found" || needsView.length > 0) && moves.length > 0 && el("button", { type: "button", className: "primary", id: "run-arrangement", textContent: "Carry out together", disabled: !this.#mayRun || this.isUnderWay || this.#isBegun,
          title: "Move by move, each planned anew on a fresh view", onclick: () => this.#run() }),
        el("button", { type: "button", className: "quiet small", textContent: "Clear", onclick: () => this.clear() })),
    ];
  }

  #moves(moves, id, badge) {
    return moves.length > 0 && el("ol", { className: "steps", id }, moves.map((move, k) => el("li", {},
      el("span", { textContent: `${move.object ?? "something new"} ${purposeWords(move)}` }),
      badge?.(move, k) ?? (typeof move.success === "number" && el("span", { className: "muted small numbers", textContent: percent(move.success) })),
      move.said?.map((line) => el("span", { className: "said muted", textContent: sentence(line) })))));
  }

  #carriedOut({ goals, steps, to_come: toCome, stage, probability, conflict, ended, end, said, error }) {
    const badge = (move, k) => el("span", { className: "badge", textContent: k < steps.length ? "tried" : k > steps.length ? STAGES.waiting : STAGES[stage] ?? stage });
    return [
      el("ul", { className: "steps", id: "arranged-goals" }, goals.map((goal) => el("li", {}, el("span", { textContent: goalWords(goal) }),
        el("span", { className: `badge ${goal.holds ? "live" : goal.holds === false ? "bad" : ""}`, textContent: goal.holds ? "holds" : goal.holds === false ? "does not hold" : ended ? "not seen" : "" })))),
      el("h3", { className: "small muted", style: "margin: 8px 0 4px", textContent: "Moves" }),
      this.#moves([...steps, ...toCome], "arranged-moves", badge) || el("p", { className: "hint small", textContent: ended ? "None was made." : STAGES[stage] ?? stage }),
      !ended && typeof probability === "number" && el("p", { className: "small", textContent: `Probability that the rest succeeds: ${percent(probability)}` }),
      conflict && el("p", { className: "relax", textContent: conflictWords(conflict) }),
      ended && el("p", { role: "status", id: "arranged-end", className: end === "achieved" ? "holds" : "fails", textContent: ENDS[end] ?? "Ended" }),
      said?.map((line) => el("p", { className: "small muted", textContent: sentence(line) })),
      error && faultBox(error)];
  }
}
