// How old what is shown of the camera is: its picture, and the objects that perception found there. Pictures go on coming where perception has died.

import { instantOf, isStale } from "./age.js";

/** Objects that are older than this are not called live, milliseconds: perception is asked for those of a camera that is looked through every four seconds. */
const OBJECTS_STALE_MS = 15000;

const secondsSince = (at) => Math.floor((performance.now() - at) / 1000);

export class Seen {
  #objectsAt;

  /** When the console was told of the picture that is shown (an instant of `performance.now()`). */
  pictureAt;

  /** Takes what the console says of a cell's cameras: how old the newest scene of the one that is looked through is. */
  cameras(cameras, name) {
    const own = cameras.find((camera) => camera.name === name);
    if (own) this.#objectsAt = instantOf(own);
  }

  /** Nothing is shown: what was is of another cell or camera. */
  forget() { this.pictureAt = this.#objectsAt = undefined; }

  get areObjectsOld() { return isStale(this.#objectsAt, OBJECTS_STALE_MS); }

  /** What the badge over the picture says, and its kind. */
  words(isHeld) {
    const at = this.pictureAt, [kind, text] = isHeld ? ["held", "held for the goal"] : at === undefined ? ["", ""] : isStale(at) ? ["bad", `${secondsSince(at)} s old`] : ["live", "live"];
    if (!this.areObjectsOld) return { kind, text };
    return { kind: "bad", text: [text, `objects ${secondsSince(this.#objectsAt)} s old`].filter(Boolean).join(", ") };
  }
}
