// Colours for canvases and the 3-D view, read from the style sheet, and dash patterns.

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

/** Dash patterns of curves [px]: by the number of a joint in its arm, or by coordinate. */
export const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3], [14, 4], [4, 4], [9, 3, 2, 3, 2, 3], [1, 5]];

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
