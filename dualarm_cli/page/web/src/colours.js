// Colours for canvases and the 3-D view, read from the style sheet: the palette of Okabe and Ito, which remains
// distinguishable with colour vision deficiencies.

/** @type {Map<string, string>} */
const cache = new Map();

/**
 * Look up a custom property of the style sheet in the current theme.
 * @param {string} name without the dashes
 * @returns {string}
 */
export function colour(name) {
  let value = cache.get(name);
  if (value === undefined) {
    value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    cache.set(name, value);
  }
  return value;
}

/** Colours of the curves of selected joints, in turn. */
export const CURVES = ["curve-1", "curve-2", "curve-3", "curve-4", "curve-5", "curve-6", "curve-7"];

/** Dash patterns of curves; the next one is used when all colours are taken. */
export const DASHES = [[], [6, 3], [2, 3]];

/**
 * Set up the dark and light themes; the system's preference applies until the user selects one.
 * @param {() => void} changed called after each change
 * @returns {{toggle: () => void, set: (theme: "dark" | "light") => void, name: () => string}}
 */
export function themes(changed) {
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  let isSelected = false;
  const set = (/** @type {"dark" | "light"} */ theme) => {
    root.dataset.theme = theme;
    cache.clear();
    changed();
  };
  root.dataset.theme = system.matches ? "dark" : "light";
  system.addEventListener("change", () => {
    if (!isSelected) set(system.matches ? "dark" : "light");
  });
  return {
    toggle: () => {
      isSelected = true;
      set(root.dataset.theme === "dark" ? "light" : "dark");
    },
    set,
    name: () => root.dataset.theme ?? "light",
  };
}
