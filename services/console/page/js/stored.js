// What a browser keeps for the page. One that is told to keep nothing refuses with an error: then it is kept as long as the page is open.

/** Text by name. `storage()` gives the browser's, which some refuse to give. */
export class Stored {
  #kept = new Map();

  constructor(storage) {
    this.storage = storage;
  }

  get(name) {
    try {
      return this.#kept.get(name) ?? this.storage().getItem(`repose.${name}`) ?? undefined;
    } catch {
      return undefined;
    }
  }

  set(name, text) {
    this.#kept.set(name, text);
    try {
      this.storage().setItem(`repose.${name}`, text);
    } catch {
      // It is kept here.
    }
  }
}
