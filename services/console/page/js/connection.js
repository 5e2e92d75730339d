// The socket to the console: opened again whenever it is lost; requests with their answers; and the stop, which needs no socket.

import { Parts, readBulk } from "./bulk.js";

const FIRST_PAUSE_MS = 200;
const LONGEST_PAUSE_MS = 2000;
/** The console closes with this code when it wants a token. */
const NEEDS_TOKEN = 4401;
/** … and with this one where as many pages are open as it serves. */
const FULL = 4503;
/** How often it is looked whether anything was heard, and after how many looks without a word the console is asked for one, and given up. Looks are
 *  counted, not time: a page that was held up has not listened. */
const LOOK_MS = 2000;
const LOOKS_TO_ASK = 2;
const LOOKS_TO_GIVE_UP = 6;

/** An error of the contract's: `code`, `message`, `field`. */
export class Refusal extends Error {
  constructor({ code, message, field }) {
    super(message);
    Object.assign(this, { code, field });
  }
}

export class Connection {
  #socket;
  #open = new Map();
  #nextId = 1;
  #pauseMs = FIRST_PAUSE_MS;
  #retry;
  #silentLooks = 0;
  #state;

  /** `heard(kind, message)` gets every message but answers; `changed(state, reason)` gets "live", "lost", "full" or "token", each once until it is another,
   *  but for the last, which asks again. */
  constructor(heard, changed) {
    this.heard = heard;
    this.changed = changed;
    this.#connect();
    // A machine that wakes up, or finds its network again, need not wait.
    addEventListener("online", () => this.again());
    document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && this.again());
    setInterval(() => this.#look(), LOOK_MS);
  }

  /** A network that is gone without a word leaves the socket open for minutes, and one that is being opened as it is. */
  #look() {
    if (this.#socket.readyState > WebSocket.OPEN) return;
    this.#silentLooks += 1;
    // There is no request 0: the answer says that the console is there.
    if (this.#silentLooks === LOOKS_TO_ASK) this.cancel(0);
    if (this.#silentLooks === LOOKS_TO_GIVE_UP) this.#lost(this.#socket);
  }

  /** Tries at once, unless connected. */
  again() {
    if (this.#socket && this.#socket.readyState <= WebSocket.OPEN) return;
    clearTimeout(this.#retry);
    this.#connect();
  }

  #connect() {
    const address = new URL("/socket?paced", location.href);
    address.protocol = address.protocol.replace("http", "ws");
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#silentLooks = 0;
    // One that was still closing has no answers any more.
    this.#refuseAll();
    const parts = new Parts();
    socket.onmessage = ({ data }) => {
      if (socket !== this.#socket) return;
      this.#pauseMs = FIRST_PAUSE_MS;
      this.#silentLooks = 0;
      // Before anything is drawn: the console sends as much at once as comes soon.
      say(socket, { ask: "received" });
      if (typeof data === "string") return this.#take(JSON.parse(data));
      const bulk = readBulk(data);
      if (bulk.metadata.kind !== "part") return this.#show(socket, bulk);
      const whole = parts.join(bulk);
      if (typeof whole === "string") return this.#take(JSON.parse(whole));
      return whole && this.#show(socket, readBulk(whole), bulk.metadata.age_ms);
    };
    socket.onclose = ({ code, reason }) => this.#lost(socket, code, reason);
  }

  /** Passes on what came in the bulk form, so many milliseconds after it was begun to be sent. */
  #show(socket, bulk, lateMs = 0) {
    const { metadata } = bulk, { kind } = metadata;
    metadata.age_ms = Number(metadata.age_ms ?? 0) + Number(lateMs);
    // The next one comes when this one is drawn.
    return Promise.resolve(this.heard(kind, bulk)).finally(() => kind !== "segmented" && say(socket, { ask: "seen", what: kind }));
  }

  #lost(socket, code, reason) {
    if (socket !== this.#socket || socket.isOver) return;
    socket.isOver = true;
    socket.close();
    this.#refuseAll();
    if (code === NEEDS_TOKEN) return this.#become("token");
    this.#become(code === FULL ? "full" : "lost", reason);
    this.#retry = setTimeout(() => this.#connect(), this.#pauseMs);
    this.#pauseMs = Math.min(2 * this.#pauseMs, LONGEST_PAUSE_MS);
  }

  /** Tells of a state once: what is tried again every two seconds would be read out, and take the place of other notices, as often. */
  #become(state, reason) {
    if (state === this.#state && state !== "token") return;
    this.#state = state;
    this.changed(state, reason);
  }

  #refuseAll() {
    const gone = new Refusal({ code: "unavailable", message: "The connection was lost before an answer came." });
    for (const { reject } of this.#open.values()) reject(gone);
    this.#open.clear();
  }

  #take(message) {
    const asked = this.#open.get(message.id);
    switch (message.kind) {
      case "answer":
        this.#open.delete(message.id);
        return asked?.resolve(message.result);
      case "refused":
        this.#open.delete(message.id);
        return asked?.reject(new Refusal(message.error));
      case "progress":
        return asked?.progress?.(message.progress);
      case "welcome":
        this.#become("live");
    }
    this.heard(message.kind, message);
  }

  /** Asks; resolves to the result or rejects with a Refusal. The promise has the request's `id`, to cancel it by. */
  ask(ask, fields = {}, progress) {
    const id = this.#nextId++;
    const answered = new Promise((resolve, reject) => {
      if (this.#socket?.readyState !== WebSocket.OPEN) {
        return reject(new Refusal({ code: "unavailable", message: "There is no connection to the console." }));
      }
      this.#open.set(id, { resolve, reject, progress });
      this.#socket.send(JSON.stringify({ id, ask, ...fields }));
    });
    answered.id = id;
    return answered;
  }

  /** Gives a request of this page's up: its promise rejects with `cancelled`, unless it has ended. */
  cancel(request) {
    this.ask("cancel", { request }).catch(() => {});
  }

  /** Stops a robot, or every robot of the cell where none is named; resolves when they show the stop. */
  async stop(cell, robot, reason) {
    return post("/stop", JSON.stringify({ cell, robot, reason }));
  }

  /** Leaves a token with the console, and connects. */
  async signIn(token) {
    const answer = await post("/sign-in", token);
    this.again();
    return answer;
  }
}

/** Says what has no answer. */
function say(socket, said) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ id: 0, ...said }));
}

async function post(path, body) {
  let response;
  try {
    response = await fetch(path, { method: "POST", body, headers: { "Content-Type": "text/plain" }, keepalive: true });
  } catch {
    throw new Refusal({ code: "unavailable", message: "The console does not answer." });
  }
  const answer = await response.json().catch(() => ({}));
  if (!response.ok) throw new Refusal(answer.error ?? { code: "internal", message: `The console answers ${response.status}.` });
  return answer;
}
