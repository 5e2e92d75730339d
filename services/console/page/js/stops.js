// The stops that nobody has confirmed, each of a robot in its cell: another robot's stop, or that of one with the same name elsewhere, says nothing of it.

import { STALE_MS } from "./age.js";

const WHAT_TO_DO = "If a robot goes on, choose it and press again, or use the switch beside it.";

const keyOf = (cell, robot) => JSON.stringify([cell, robot]);
const who = (cell, robot) => `${robot ?? "every robot"}${cell === undefined ? "" : ` in cell ${cell}`}`;

export class Stops {
  #unconfirmed = new Map();

  /** `say(text)` gets the notice with all that is not confirmed, or nothing once there is nothing to say. */
  constructor(say) { this.say = say; }

  /** Waits for the answer to a stop of a robot, or of every robot of a cell where none is named, and says so where nobody confirms it. */
  async follow(cell, robot, answer) {
    // Over a network that has gone nothing comes back for minutes.
    const late = setTimeout(() => this.#failed(cell, robot, " yet"), STALE_MS);
    try {
      await answer;
      this.confirmed(cell, robot);
    } catch ({ message, field }) {
      this.#failed(cell, robot, `: ${message.replace(/\.$/, "")}${field ? ` (${field})` : ""}`);
    } finally {
      clearTimeout(late);
    }
  }

  /** A robot has stopped, whoever says so. */
  confirmed(cell, robot) {
    if (this.#unconfirmed.delete(keyOf(cell, robot))) this.#say();
  }

  #failed(cell, robot, why) {
    this.#unconfirmed.set(keyOf(cell, robot), `Stop of ${who(cell, robot)}: nobody has confirmed it${why}`);
    this.#say();
  }

  #say() {
    const told = [...this.#unconfirmed.values()];
    // What was read and put away is not said again with the next one.
    this.say(told.length ? { message: [...told, WHAT_TO_DO].join(". "), read: () => this.#unconfirmed.clear() } : undefined);
  }
}
