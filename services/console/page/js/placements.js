// The planner's answer: placements in rank order with their evidence, or why there is none.

import { el, fill } from "./element.js";
import { MOTION_FAILURES, REJECTIONS, REJECTION_COLORS, SHORTFALLS, milliseconds, millimetres, percent, sentence, termWords } from "./words.js";
import { faultBox } from "./goal.js";

/** How likely a placement stays, where the planner says. */
const success = (placement) => placement.success ?? placement.realism;
const likely = (placement) => (typeof success(placement) === "number" ? `${percent(success(placement))} likely to stay` : "Stands by geometry");

/** The facts of a placement as a list. */
export function evidence(placement, goal) {
  const fact = (name, value, className) => [el("dt", { textContent: name }), el("dd", { textContent: value, className })];
  return el("dl", { className: "facts" },
    goal.map((term, k) => {
      const check = placement.geometric[k], probability = placement.relations[k];
      return fact(sentence(termWords(term)), `${typeof probability === "number" ? percent(probability) + " · " : ""}${check?.holds ? "holds" : "fails"} by rule`, check?.holds ? "holds" : "fails");
    }),
    typeof placement.realism === "number" && fact(placement.success === undefined ? "Stays" : "Realism", percent(placement.realism)),
    fact("Support margin", millimetres(placement.support_m)),
    fact("Clearance", millimetres(placement.clearance_m)),
    fact("Cost", placement.cost.toFixed(3)));
}

export class Placements {
  #answer; #plan; #lit = -1;

  /** `lit(rank)` and `reason(name)` are told what the pointer is over; `plan()` asks for the motion. */
  constructor(box, actions) {
    this.box = box;
    this.actions = actions;
    this.clear();
  }

  clear() { this.#answer = this.#plan = this.#fault = undefined; this.#isPlanning = false; this.render(); }
  show(answer) { this.#answer = answer; this.#plan = this.#fault = undefined; this.render(); }
  planned(plan) { this.#plan = plan; this.#isPlanning = false; this.render(); }
  planning(is) { this.#isPlanning = is; this.#fault = undefined; this.render(); }
  fault(refusal) { this.#fault = refusal; this.#isPlanning = false; this.render(); }
  may(may) { this.#may = may; this.render(); }
  get answer() { return this.#answer; }
  #fault; #isPlanning = false; #may = true;

  lit(rank) {
    if (rank === this.#lit) return;
    this.#lit = rank;
    this.box.querySelectorAll(".placement").forEach((row, k) => {
      row.classList.toggle("lit", k === rank);
      row.setAttribute("aria-selected", String(k === rank));
      if (k === rank) row.scrollIntoView({ block: "nearest" });
    });
  }

  render() {
    const answer = this.#answer, placed = answer?.placed;
    const heading = placed ? (placed.placements.length ? `${placed.placements.length} place${placed.placements.length > 1 ? "s" : ""}` : "No place") : "Places";
    fill(this.box,
      el("div", { className: "title" }, el("h2", { id: "answers-title", textContent: heading }),
        placed?.outcome === "partial" && el("span", { className: "badge held", textContent: "time ran out" }),
        el("span", { className: "grow" }),
        answer && el("span", { className: "muted small numbers", textContent: milliseconds(answer.took_ms), title: `by ${answer.worker}; ${placed.evaluated} candidates, weights ${placed.weights_hash.slice(0, 8) || "none"}, seed ${placed.seed}` })),
      !placed && el("p", { className: "hint", textContent: "Where the object can go will stand here, best first." }),
      placed && placed.placements.length > 0 && this.#list(placed),
      placed && placed.placements.length === 0 && none(placed, this.actions.reason),
      this.#fault && faultBox(this.#fault));
  }

  get #rows() { return [...this.box.querySelectorAll(".placement")]; }

  /** Makes one row the one that Tab goes to: the arrows go from there to the others. */
  #reach(rank) { this.#rows.forEach((row, k) => { row.tabIndex = k === rank ? 0 : -1; }); }

  /** Goes from a row to another by the keys of lists. */
  #step(event, rank) {
    const rows = this.#rows, to = { ArrowDown: rank + 1, ArrowUp: rank - 1, Home: 0, End: rows.length - 1 }[event.key];
    if (to === undefined) return;
    // Not even at the ends of the list do these keys scroll the page.
    event.preventDefault();
    rows[to]?.focus();
  }

  #list(placed) {
    const notChosen = new Map((this.#plan?.not_chosen ?? []).map(({ placement, reason, detail }) => [placement, { reason, detail }]));
    const row = (placement, rank) => {
      const passed = notChosen.get(rank), isChosen = this.#plan?.placement === rank;
      return el("li", { className: `placement${rank === this.#lit ? " lit" : ""}`, role: "option", "aria-selected": String(rank === this.#lit), tabIndex: rank ? -1 : 0,
        data: { key: `placement-${rank}` }, onpointerenter: () => this.actions.lit(rank), onpointerleave: () => this.actions.lit(-1),
        onfocus: () => { this.#reach(rank); this.actions.lit(rank); }, onblur: () => this.actions.lit(-1), onkeydown: (event) => this.#step(event, rank) },
        el("span", { className: "rank", textContent: rank + 1 }),
        el("div", { className: "main" }, el("span", { textContent: likely(placement) }), isChosen && el("span", { className: "badge live", textContent: "chosen" })),
        el("div", {}, evidence(placement, placed.goal),
          passed && el("p", { className: "small fails", textContent: `Not this one: ${MOTION_FAILURES[passed.reason] ?? passed.reason}`, title: passed.detail })));
    };
    return [
      el("ol", { className: "placements", role: "listbox", "aria-label": "Places, best first" }, placed.placements.map(row)),
      this.#plan?.ignored && el("p", { className: "hint small", style: "margin-top: 8px", textContent: `${sentence(this.#plan.ignored)}.` }),
      SHORTFALLS[placed.shortfall?.reason] && el("p", { className: "hint small", style: "margin-top: 8px", textContent: SHORTFALLS[placed.shortfall.reason] }),
      el("div", { className: "row", style: "margin-top: 10px" },
        el("button", { type: "button", id: "plan", className: this.#plan ? "" : "primary", disabled: !this.#may || this.#isPlanning, title: "How the arm would do it (P)",
          onclick: () => this.actions.plan(), textContent: this.#isPlanning ? "Planning …" : this.#plan ? "Plan again" : "Plan the motion" })),
    ];
  }
}

/** Why there is no placement. */
function none(placed, lit) {
  const counts = Object.entries(placed.rejections).sort((a, b) => b[1] - a[1]);
  const total = counts.reduce((sum, [, n]) => sum + n, 0);
  const [most] = counts;
  const { relaxation } = placed;
  return [
    el("p", { textContent: most ? `None of ${placed.evaluated} candidates passed; most were rejected because: ${REJECTIONS[most[0]] ?? most[0]}.` : `None of ${placed.evaluated} candidates passed.` }),
    el("ul", { className: "tally" }, counts.map(([reason, n]) => el("li", { own: REJECTION_COLORS[reason], tabIndex: 0,
      onpointerenter: () => lit(reason), onpointerleave: () => lit(), onfocus: () => lit(reason), onblur: () => lit() },
      el("span", { textContent: sentence(REJECTIONS[reason] ?? reason) }), el("span", { className: "numbers muted", textContent: `${n}` }),
      el("span", { className: "share" }, el("i", { style: `width: ${(100 * n / Math.max(1, total)).toFixed(1)}%` }))))),
    el("p", { className: "relax", textContent: relaxation
      ? `Without “${termWords(relaxation.term)}”, ${relaxation.admits} candidate${relaxation.admits === 1 ? "" : "s"} would have passed.`
      : "Giving up any one term would not have helped." }),
  ];
}
