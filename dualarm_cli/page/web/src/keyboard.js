// Keyboard commands and the overlay that lists them.

import { button, element } from "./dom.js";

/** @typedef {{keys: string[], label: string, text: string, action: (event: KeyboardEvent) => void}} Command */

/**
 * Listen to keys outside of input fields and lists.
 * @param {Command[]} commands
 */
export function listenToKeys(commands) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = /** @type {HTMLElement} */ (event.target);
    if (target.closest("select, input, textarea")) return;
    if (event.key === " " && target.closest("button, summary")) return;
    const command = commands.find(({ keys }) => keys.includes(event.key));
    if (!command) return;
    event.preventDefault();
    command.action(event);
  });
}

/**
 * Create the help overlay for keys and pointer.
 * @param {Command[]} commands
 * @returns {HTMLDialogElement}
 */
export function helpOverlay(commands) {
  const rows = [
    ...commands.map(({ label, text }) => [label, text]),
    ["drag, right drag, wheel", "3-D view: orbit, pan, zoom"],
    ["drag, pinch, two fingers", "3-D view by touch: orbit, zoom, pan"],
    ["click or tap", "timeline or row of a table: go to its time"],
    ["wheel, drag", "timeline: zoom, pan; Shift and wheel pan, Alt and wheel scroll"],
    ["double click", "timeline: zoom to the stage"],
  ];
  const list = rows.map(([keys, text]) =>
    element("tr", {}, element("td", {}, element("kbd", {}, keys)), element("td", {}, text)),
  );
  const dialog = element(
    "dialog",
    { class: "help", "aria-label": "Help" },
    element("h2", { tabindex: "-1", autofocus: "" }, "Keys, pointer and touch"),
    element("table", {}, element("tbody", {}, ...list)),
    button("Close", "Close", () => dialog.close()),
  );
  dialog.addEventListener("click", (/** @type {Event} */ event) => {
    if (event.target === dialog) dialog.close();
  });
  return dialog;
}
