// The page as somebody at the screen sees and uses it.

import assert from "node:assert/strict";

import { decodePng } from "./png.mjs";

/** How long a state is waited for before the test gives up: a machine may be slow, and nothing here measures it. */
export const PATIENCE_MS = 120_000;

export const SCREENS = `${process.env.REPOSE_BROWSER_MODULES}/screens`;

/** Opens the page and waits until it can be used and its scene is drawn; milliseconds until then are in `openedMs` and `drawnMs`. With `atOnce(page)` that is
 *  done as soon as the page can be used. */
export async function open(browser, url, { atOnce, ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, colorScheme: "light", ...options });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  page.faults = [];
  page.on("pageerror", (error) => page.faults.push(String(error)));
  page.on("console", (message) => message.type() === "error" && page.faults.push(message.text()));
  const started = performance.now();
  await page.goto(url);
  await page.waitForSelector("body[data-ready=true]", { timeout: PATIENCE_MS });
  page.openedMs = performance.now() - started;
  await atOnce?.(page);
  await page.waitForSelector("body[data-drawn]", { timeout: PATIENCE_MS });
  page.drawnMs = performance.now() - started;
  return page;
}

/** Pixels of an element as they are on the screen: `{width, height, data}` with 4 bytes a pixel. */
export async function pixels(page, selector) {
  // Of the page, cut: a picture of the element alone waits for frames in which it stands still, which a machine without a free core draws minutes apart.
  await page.locator(selector).scrollIntoViewIfNeeded();
  return decodePng(await page.screenshot({ clip: await page.locator(selector).boundingBox(), animations: "disabled" }));
}

/** How many pixels pass. */
export const count = ({ data }, passes) => {
  let n = 0;
  for (let i = 0; i < data.length; i += 4) if (passes(data[i], data[i + 1], data[i + 2])) n += 1;
  return n;
};

/** How many pixels differ clearly between two pictures of one size. */
export function difference(a, b) {
  assert.deepEqual([a.width, a.height], [b.width, b.height]);
  let n = 0;
  for (let i = 0; i < a.data.length; i += 4) if (Math.abs(a.data[i] - b.data[i]) + Math.abs(a.data[i + 1] - b.data[i + 1]) + Math.abs(a.data[i + 2] - b.data[i + 2]) > 48) n += 1;
  return n;
}

/** Fails where a canvas shows one color, or nearly so. */
export function assertDrawn(picture, least = 0.02) {
  const seen = new Map();
  for (let i = 0; i < picture.data.length; i += 4) {
    const color = (picture.data[i] >> 4) << 8 | (picture.data[i + 1] >> 4) << 4 | picture.data[i + 2] >> 4;
    seen.set(color, (seen.get(color) ?? 0) + 1);
  }
  const most = Math.max(...seen.values()), all = picture.data.length / 4;
  assert.ok(seen.size > 24 && 1 - most / all > least, `the canvas is blank: ${seen.size} colors, ${(100 * most / all).toFixed(1)} % of one`);
}

/** The ids of the objects that the page lists. */
export const objects = (page) => page.locator("#objects button").evaluateAll((chips) => chips.map((chip) => Number(chip.dataset.id)));

/** Clicks an object in the camera's picture, where its number stands. */
export async function clickObject(page, id) {
  const chip = page.locator(`#objects button[data-id="${id}"]`);
  const [u, v, width, height] = await chip.evaluate(({ dataset }) => [dataset.u, dataset.v, dataset.width, dataset.height].map(Number));
  const box = await page.locator("#picture canvas.over").boundingBox();
  await page.mouse.click(box.x + u / width * box.width, box.y + v / height * box.height);
}

export const screenshot = (page, name, options) => page.screenshot({ path: `${SCREENS}/${name}.png`, ...options });

/** The text of an element, once it matches. */
export async function textOf(page, selector, matches, timeout = PATIENCE_MS) {
  const element = page.locator(selector);
  await page.waitForFunction(([selector, source]) => new RegExp(source, "i").test(document.querySelector(selector)?.textContent ?? ""), [selector, matches.source], { timeout });
  return element.textContent();
}
