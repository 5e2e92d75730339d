// Light or dark: as the system has it, until somebody chooses.

import { byId } from "./element.js";

/** Follows the system's theme and the button; `changed()` is told where something drawn has other colors now. */
export function followTheme(changed) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const show = (name) => {
    const chosen = name ?? localStorage.getItem("repose.theme") ?? (dark.matches ? "dark" : "light");
    if (name) localStorage.setItem("repose.theme", name);
    document.documentElement.dataset.theme = chosen;
    byId("theme").textContent = chosen === "dark" ? "☀" : "☾";
    byId("theme").setAttribute("aria-label", chosen === "dark" ? "Light colors" : "Dark colors");
    changed();
  };
  byId("theme").addEventListener("click", () => show(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  dark.addEventListener("change", () => show());
  show();
}
