// Elements of the page. Data reach them as text only: there is no way from data to markup.

/**
 * Returns a new element.
 * @param {string} tag
 * @param {Object<string, any>} [properties] `class` is the class, `on…` are listeners, the rest are attributes
 * @param {...(Node | string | null)} children texts become text nodes
 * @returns {any}
 */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children) if (child !== null) made.append(child);
  return made;
}

/**
 * Returns a button.
 * @param {string} text
 * @param {string} title what it does
 * @param {() => void} action
 * @param {Object<string, any>} [more]
 */
export function button(text, title, action, more = {}) {
  return element(
    "button",
    { type: "button", title, "aria-label": title, onclick: action, ...more },
    text,
  );
}

/**
 * Returns a button that is on or off.
 * @param {string} text
 * @param {string} title
 * @param {boolean} on at first
 * @param {(on: boolean) => void} action
 */
export function toggle(text, title, on, action) {
  const made = button(text, title, () => {
    const pressed = made.getAttribute("aria-pressed") !== "true";
    made.setAttribute("aria-pressed", String(pressed));
    action(pressed);
  });
  made.setAttribute("aria-pressed", String(on));
  return made;
}

/** Texts longer than this may break anywhere. */
const LONG = 20;

/** @param {string | Node} cell @param {boolean} numeric */
function cellClass(cell, numeric) {
  if (numeric) return "number";
  return typeof cell === "string" && cell.length > LONG ? "long" : null;
}

/**
 * @typedef {object} Row
 * @property {(string | Node)[]} cells
 * @property {number} [time] a click goes there [s]
 * @property {string} [mark] class
 */

/**
 * Returns a table whose rows lead to times.
 * @param {string[]} heads a head that ends in ` #` is a column of numbers
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
    const leads = time !== undefined && Number.isFinite(time);
    const made = element(
      "tr",
      { class: [row.mark, leads ? "leads" : ""].filter(Boolean).join(" ") || null },
      ...row.cells.map((cell, i) => element("td", { class: cellClass(cell, numeric[i]) }, cell)),
    );
    if (leads) {
      made.tabIndex = 0;
      made.addEventListener("click", () => go(/** @type {number} */ (time)));
      made.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
        if (event.key === "Enter") go(/** @type {number} */ (time));
      });
    }
    return made;
  });
  return element(
    "table",
    {},
    element("thead", {}, element("tr", {}, ...head)),
    element("tbody", {}, ...body),
  );
}
