// What things are called, and how numbers read.

/** The relations, in the contract's order, as they read between the query and its anchor. */
export const RELATIONS = {
  left_of: "left of", right_of: "right of", in_front_of: "in front of", behind: "behind", above: "above", below: "below",
  near: "near", touching: "touching", centered: "centered on", aligned: "aligned with",
};

/** The planner's variants. */
export const VARIANTS = {
  best: "best", full: "full (paper)", full_lambda_1: "full, λ = 1", no_discriminator: "no discriminator",
  mean_only: "mean only", mdn_prior: "MDN prior", geometric: "geometric (no networks)",
};

/** What rejected candidates. */
export const REJECTIONS = {
  tips: "it leans and would tip", unsettles: "something rests against it and would come down", region: "outside the region",
  out_of_view: "out of view", collision: "would collide", clearance: "too close to something", unsupported: "not supported", goal: "goal would not hold",
  unrealistic: "not likely to stay", out_of_reach: "out of the robot's reach", unsure: "not as likely to succeed as asked",
};

/** A color for each of these. */
export const REJECTION_COLORS = {
  region: "#7c8798", out_of_view: "#a58fd0", collision: "#d9483b", clearance: "#e58b2f", unsupported: "#c9a400", goal: "#3f7de0",
  unrealistic: "#c2569b", out_of_reach: "#4b9a8e", unsure: "#b98ac0", tips: "#8a6d4b", unsettles: "#6f8f3a",
};

/** Why motion passed over a placement. */
export const MOTION_FAILURES = {
  no_grasp: "no grasp on the object", pick_unreachable: "no grasp can be reached at the object", pick_blocked: "every reachable grasp collides at the object",
  place_unreachable: "no grasp can be reached at the placement", place_blocked: "every reachable grasp collides at the placement",
  no_path: "no collision-free path",
};

/** Why there are fewer placements than were asked for. */
export const SHORTFALLS = {
  separation: "Every other candidate is too close to one of these.", constraints: "No other candidate that is far enough apart passed.",
  budget: "Time or questions ran out before more could be found.",
};

/** How far a step of a sequence is. */
export const STAGES = { waiting: "waiting", looking: "looking", placing: "placing", planning: "planning", moving: "moving", held: "holds", failed: "failed" };

/** Colors of objects, by id. */
const OBJECT_COLORS = ["#e0574f", "#3d8ef0", "#2fa866", "#b36ae2", "#e9a23b", "#19a7b5", "#e56aa6", "#8a9a2b", "#7b7ff0", "#c07a4c", "#4fb3e8", "#99c24d"];
export const colorOf = (id) => OBJECT_COLORS[(id - 1 + OBJECT_COLORS.length * 1000) % OBJECT_COLORS.length];

/** "not left of 3". */
export const termWords = (term) => `${term.holds ? "" : "not "}${RELATIONS[term.relation] ?? term.relation} ${term.anchor}`;

export const percent = (share) => `${(100 * share).toFixed(share > 0.995 || share < 0.1 ? 1 : 0)} %`;
export const millimetres = (metres) => (typeof metres === "number" ? `${(1000 * metres).toFixed(0)} mm` : "–");
export const centimetres = (extent) => extent.map((m) => (100 * m).toFixed(0)).join(" × ") + " cm";
export const milliseconds = (ms) => (ms < 10 ? `${ms.toFixed(1)} ms` : ms < 1000 ? `${ms.toFixed(0)} ms` : `${(ms / 1000).toFixed(ms < 10000 ? 2 : 1)} s`);
export const seconds = (ms) => `${(ms / 1000).toFixed(1)} s`;
export const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);
export const plain = (name) => name.replaceAll("_", " ");
