// Formatting of numbers with units: seconds, millimetres, degrees, percent.

/** @typedef {import("./trajectory.js").Quantity} Quantity */

const MINUS = "\u2212";
const THIN = "\u202f";

/**
 * Format a number with fixed decimals and a typographic minus sign.
 * @param {number} value
 * @param {number} decimals
 */
export function fixed(value, decimals) {
  const text = Math.abs(value).toFixed(decimals);
  return value < 0 && Number(text) !== 0 ? MINUS + text : text;
}

/**
 * Format a time in seconds.
 * @param {number | null | undefined} value s
 * @param {number} [decimals]
 */
export function seconds(value, decimals = 3) {
  return value === null || value === undefined ? "–" : `${fixed(value, decimals)}${THIN}s`;
}

/** Format a length in millimetres. @param {number | null | undefined} value m */
export function millimetres(value) {
  return value === null || value === undefined ? "–" : `${fixed(value * 1e3, 1)}${THIN}mm`;
}

/** Format a fraction in percent. @param {number | null | undefined} value fraction */
export function percent(value, decimals = 1) {
  return value === null || value === undefined ? "–" : `${fixed(value * 100, decimals)}${THIN}%`;
}

/**
 * Format a number with four significant digits for tables.
 * @param {number | null | undefined} value
 */
export function significant(value) {
  if (value === null || value === undefined) return "–";
  if (value === 0 || Number.isInteger(value)) return String(value).replace("-", MINUS);
  const size = Math.abs(value);
  const text =
    size >= 1e5 || size < 1e-3 ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replace(/-/g, MINUS);
}

const ORDER = { position: "", velocity: "/s", acceleration: "/s²", jerk: "/s³" };

/**
 * Return the displayed unit of a joint's quantity.
 * @param {boolean} slides whether the joint is prismatic
 * @param {Quantity} quantity
 * @returns {{name: string, perUnit: number}} perUnit: displayed units per SI unit
 */
export function jointUnit(slides, quantity) {
  const per = ORDER[quantity];
  return slides
    ? { name: `mm${per}`, perUnit: 1e3 }
    : { name: per ? `°${per}` : "°", perUnit: 180 / Math.PI };
}

/**
 * Format a joint's quantity with its unit.
 * @param {number} value SI
 * @param {boolean} slides
 * @param {Quantity} quantity
 */
export function jointValue(value, slides, quantity) {
  const unit = jointUnit(slides, quantity);
  const displayed = value * unit.perUnit;
  const decimals = Math.abs(displayed) < 100 ? 2 : Math.abs(displayed) < 1000 ? 1 : 0;
  return `${fixed(displayed, decimals)}${unit.name.startsWith("°") ? "" : THIN}${unit.name}`;
}

/** Displayed names of kinds and actions. */
const WORDS = /** @type {Object<string, string>} */ ({
  take_tool: "take tool",
  leave_tool: "leave tool",
  seam_start: "seam start",
  seam_end: "seam end",
  path_start: "path start",
  path_end: "path end",
  partner: "other arm",
  after: "earlier task",
  window: "time window",
  end: "work is done",
});

/** What an arm waits for, by reason, unless the plan names an arm and a task. */
const AWAITED = /** @type {Object<string, string>} */ ({
  partner: "the other arm",
  shared_zone: "the other arm to leave the shared zone",
  after: "an earlier task",
  conveyor: "a part on the conveyor",
});

/**
 * Describe a wait.
 * @param {string} reason
 * @param {string} [awaited] arm and task that end it
 */
export function waitText(reason, awaited = "") {
  if (reason === "end") return word(reason);
  const by = reason === "shared_zone" && awaited ? `${awaited} to leave the shared zone` : awaited;
  return `waits for ${by || AWAITED[reason] || `the ${word(reason)}`}`;
}

/** Return the displayed name of a kind, an action or a reason. @param {string} name */
export function word(name) {
  return WORDS[name] ?? name.replaceAll("_", " ");
}

/**
 * Combine an action and a task; ids that contain the action, such as "take suction", stand alone.
 * @param {string} action
 * @param {string} task
 */
export function actionOn(action, task) {
  const done = word(action);
  const [verb] = done.split(" ");
  if (!action || task.startsWith(`${verb} `)) return task;
  return task === verb ? done : `${done} ${task}`;
}

/**
 * Describe an event: its action on a task, and the signal that it sets.
 * @param {{action: string, task: string, signal?: string}} event
 */
export function eventText({ action, task, signal }) {
  return signal ? `${actionOn(action, task)} → ${signal}` : actionOn(action, task);
}

/**
 * Compute the times of a ruler: multiples of 1, 2 or 5 times a power of ten.
 * @param {number} from
 * @param {number} to
 * @param {number} maxCount
 * @returns {{times: number[], decimals: number}}
 */
export function rulerTimes(from, to, maxCount) {
  const minStep = (to - from) / Math.max(maxCount, 1);
  let power = Math.floor(Math.log10(minStep));
  let step = 10 ** power;
  for (const factor of [1, 2, 5, 10]) {
    step = factor * 10 ** power;
    if (step >= minStep * (1 - 1e-9)) break;
  }
  power = Math.floor(Math.log10(step) + 1e-9);
  const times = [];
  for (let k = Math.ceil(from / step - 1e-9); k * step <= to + step * 1e-9; k++) times.push(k * step);
  return { times, decimals: Math.max(0, -power) };
}
