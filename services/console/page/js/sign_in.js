// The dialog that asks for a token.

import { byId, el, fill } from "./element.js";

/** Asks until `signIn(token)` resolves. Asked again meanwhile, it stays as it is: somebody types. */
export function askForToken(signIn) {
  const dialog = byId("sign-in"), fault = el("div", { role: "alert" });
  if (dialog.open) return;
  const token = el("input", { type: "password", autocomplete: "current-password", required: true, "aria-label": "Token", style: "width: 100%" });
  fill(dialog, el("form", { onsubmit: async (event) => {
    event.preventDefault();
    try {
      await signIn(token.value);
      dialog.close();
    } catch (refusal) {
      fill(fault, el("div", { className: "fault", textContent: refusal.message }));
    }
  } }, el("div", { className: "title" }, el("h2", { id: "sign-in-title", textContent: "This console asks for a token" })), token,
    el("div", { className: "row", style: "margin-top: 12px" }, el("button", { type: "submit", className: "primary", textContent: "Sign in" })), fault));
  // Without a token there is nothing behind it.
  dialog.oncancel = (event) => event.preventDefault();
  dialog.showModal();
}
