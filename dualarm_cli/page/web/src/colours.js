// Colours for canvases and the 3-D view, read from the style sheet. The hues are those of Okabe and Ito, which people
// with any colour vision tell apart.

/** @type {Map<string, string>} */
const read = new Map();

/**
 * Returns a custom property of the style sheet, as the page shows it now.
 * @param {string} name without the dashes
 * @returns {string}
 */
export function colour(name) {
  let found = read.get(name);
  if (found === undefined) {
    found = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    read.set(name, found);
  }
  return found;
}

/** Colours of curves: one per joint that is chosen, in turn. */
export const CURVES = ["curve-1", "curve-2", "curve-3", "curve-4", "curve-5", "curve-6", "curve-7"];

/** Dashes of curves, once all colours are used. */
export const DASHES = [[], [6, 3], [2, 3]];

/**
 * Lets the page be dark or light: as the system says, until the reader decides.
 * @param {() => void} changed
 * @returns {{toggle: () => void, set: (theme: "dark" | "light") => void, name: () => string}}
 */
export function themes(changed) {
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  let decided = false;
  const set = (/** @type {"dark" | "light"} */ theme) => {
    root.dataset.theme = theme;
    read.clear();
    changed();
  };
  root.dataset.theme = system.matches ? "dark" : "light";
  system.addEventListener("change", () => {
    if (!decided) set(system.matches ? "dark" : "light");
  });
  return {
    toggle: () => {
      decided = true;
      set(root.dataset.theme === "dark" ? "light" : "dark");
    },
    set,
    name: () => root.dataset.theme ?? "light",
  };
}
