// A running system to look at, and a browser to look with. Both end with the tests.

import { spawn } from "node:child_process";
import { readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { createServer } from "node:net";
import { createInterface } from "node:readline";

const require = createRequire(`${process.env.REPOSE_BROWSER_MODULES}/`);
const { chromium } = require("playwright-core");

const READY_WITHIN_MS = 120_000;

/** A port that nobody listens at. */
export async function freePort() {
  const server = createServer();
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address();
  await new Promise((resolve) => server.close(resolve));
  return port;
}

/** `repose up` with a simulated cell; resolves when it is up. */
export async function startSystem({ seed = 1, environment = {} } = {}) {
  const [router, page] = [await freePort(), await freePort()];
  const child = spawn(process.env.REPOSE, ["--json", "up", "--listen", `tcp/127.0.0.1:${router}`, "--seed", String(seed)], {
    // A browser that draws in software, on cores that others need too: a thinner cloud, seldom anew; and a motion process that waits half a second
    // for a core is not lost, nor one that waits longer where the environment has it so.
    env: { REPOSE_MOTION__COMMAND_TTL_MS: "2000", ...process.env, REPOSE_CONSOLE__LISTEN: `127.0.0.1:${page}`, REPOSE_CONSOLE__CLOUD_POINTS: "20000", REPOSE_CONSOLE__SCENE_PERIOD_MS: "1000", ...environment },
    stdio: ["ignore", "pipe", "pipe"],
  });
  const said = [];
  createInterface({ input: child.stderr }).on("line", (line) => said.push(line));
  let text = "";
  const document = await new Promise((resolve, reject) => {
    const late = setTimeout(() => reject(new Error(`not up in time:\n${said.join("\n")}`)), READY_WITHIN_MS);
    child.on("exit", (code) => reject(new Error(`repose up ended with ${code}:\n${said.join("\n")}`)));
    child.stdout.on("data", (data) => {
      text += data;
      try { resolve(JSON.parse(text)); clearTimeout(late); } catch { /* More is to come. */ }
    });
  });
  return {
    url: document.console, said, endpoint: `tcp/127.0.0.1:${router}`,
    /** The services' processes, by name. */
    processes: () => Object.fromEntries(children(child.pid).map((pid) => [commandOf(pid)[2] ?? "", pid])),
    /** The process that serves the page: the child of `up` that was started for it. */
    consoleProcess: () => children(child.pid).find((pid) => commandOf(pid).includes("console")),
    stop: () => new Promise((resolve) => { child.on("exit", resolve); child.kill("SIGINT"); }),
  };
}

function commandOf(pid) {
  try { return readFileSync(`/proc/${pid}/cmdline`, "utf8").split("\0"); } catch { return []; }
}

function children(parent) {
  return readdirSync("/proc").filter((name) => /^\d+$/.test(name)).map(Number).filter((pid) => {
    try { return Number(readFileSync(`/proc/${pid}/stat`, "utf8").split(") ").at(-1).split(" ")[1]) === parent; } catch { return false; }
  });
}

/** Processor time that a process has used, milliseconds. */
export function cpuMs(pid) {
  const fields = readFileSync(`/proc/${pid}/stat`, "utf8").split(") ").at(-1).split(" ");
  return (Number(fields[11]) + Number(fields[12])) * 10;
}

/** Resident memory of a process, MiB. */
export function residentMb(pid) {
  return Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1]) / 1024;
}

/** Debian's Chromium with WebGL in software. */
export function startBrowser() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM?.includes("/") ? process.env.CHROMIUM : `/usr/bin/${process.env.CHROMIUM ?? "chromium"}`,
    args: ["--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist", ...(process.getuid() === 0 ? ["--no-sandbox"] : [])],
  });
}
