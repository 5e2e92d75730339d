// Light or dark: as the system has it, until somebody chooses.

import { byId } from "./element.js";
import { Stored } from "./stored.js";

/** Follows the system's theme and the button; `changed()` is told where something drawn has other colors now. */
export function followTheme(changed) {
  const dark = matchMedia("(prefers-color-scheme: dark)"), stored = new Stored(() => localStorage);
  const show = (name) => {
    const chosen = name ?? stored.get("theme") ?? (dark.matches ? "dark" : "light");
    if (name) stored.set("theme", name);
    document.documentElement.dataset.theme = chosen;
    byId("theme").textContent = chosen === "dark" ? "☀" : "☾";
    byId("theme").setAttribute("aria-label", chosen === "dark" ? "Light colors" : "Dark colors");
    changed();
  };
  byId("theme").addEventListener("click", () => show(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  dark.addEventListener("change", () => show());
  show();
}
