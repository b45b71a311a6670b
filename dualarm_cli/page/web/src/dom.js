// Elements of the page. Data become text nodes only, never markup.

/**
 * Create an element.
 * @param {string} tag
 * @param {Object<string, any>} [properties] `on…` are listeners, all others attributes
 * @param {...(Node | string | null)} children texts become text nodes
 * @returns {any}
 */
export function element(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children) if (child !== null) node.append(child);
  return node;
}

/** Split a text into plain spans and, where backticks mark them, code elements. @param {string} text @returns {(Node | string)[]} */
export const withCode = (text) => text.split(/`([^`]+)`/).map((span, i) => (i % 2 ? element("code", {}, span) : span));

/**
 * Create a button.
 * @param {string} text
 * @param {string} title tooltip
 * @param {() => void} action
 * @param {Object<string, any>} [properties]
 */
export function button(text, title, action, properties = {}) {
  return element(
    "button",
    { type: "button", title, "aria-label": title, onclick: action, ...properties },
    text,
  );
}

/**
 * Create a toggle button.
 * @param {string} text
 * @param {string} title
 * @param {boolean} on initial state
 * @param {(on: boolean) => void} action
 */
export function toggle(text, title, on, action) {
  const node = button(text, title, () => {
    const pressed = node.getAttribute("aria-pressed") !== "true";
    node.setAttribute("aria-pressed", String(pressed));
    action(pressed);
  });
  node.setAttribute("aria-pressed", String(on));
  return node;
}

/**
 * Create a sample of a line.
 * @param {string} colour
 * @param {number[]} dash
 */
export function lineSample(colour, dash) {
  const make = (/** @type {string} */ tag, /** @type {Object<string, any>} */ properties) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(properties)) node.setAttribute(name, String(value));
    return node;
  };
  const sample = make("svg", { class: "line", "aria-hidden": true });
  sample.append(make("line", { x2: "100%", y1: 2, y2: 2, stroke: colour, "stroke-width": 2, "stroke-dasharray": dash.join(" ") }));
  return sample;
}

/** Length above which texts may break anywhere. */
const BREAKABLE_LENGTH = 20;

/** @param {string | Node} cell @param {boolean} numeric */
function cellClass(cell, numeric) {
  if (numeric) return "number";
  return typeof cell === "string" && cell.length > BREAKABLE_LENGTH ? "long" : null;
}

/**
 * @typedef {object} Row
 * @property {(string | Node)[]} cells
 * @property {number} [time] target of a click [s]
 * @property {string} [mark] class
 */

/**
 * Create a table whose rows set the time cursor, in a box that scrolls sideways.
 * @param {string[]} heads those that end in ` #` mark columns of numbers
 * @param {Row[]} rows
 * @param {(time: number) => void} go
 */
export function table(heads, rows, go) {
  const numeric = heads.map((head) => head.endsWith(" #"));
  const head = heads.map((text, i) =>
    element("th", { class: numeric[i] ? "number" : null }, text.replace(/ #$/, "")),
  );
  const body = rows.map((row) => {
    const { time } = row;
    const isLink = time !== undefined && Number.isFinite(time);
    const tr = element(
      "tr",
      { class: [row.mark, isLink ? "leads" : ""].filter(Boolean).join(" ") || null },
      ...row.cells.map((cell, i) => element("td", { class: cellClass(cell, numeric[i]) }, ...(typeof cell === "string" ? withCode(cell) : [cell]))),
    );
    if (isLink) {
      tr.tabIndex = 0;
      tr.addEventListener("click", () => go(/** @type {number} */ (time)));
      tr.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
        if (event.key === "Enter") go(/** @type {number} */ (time));
      });
    }
    return tr;
  });
  const rowGroups = [element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...body)];
  return element("div", { class: "scroll" }, element("table", {}, ...rowGroups));
}
