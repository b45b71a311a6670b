// Numbers as people read them: seconds, millimetres, degrees, percent.

/** @typedef {import("./trajectory.js").Quantity} Quantity */

const MINUS = "\u2212";
const THIN = "\u202f";

/**
 * Returns a number with a fixed count of decimals and a real minus sign.
 * @param {number} value
 * @param {number} decimals
 */
export function fixed(value, decimals) {
  const text = Math.abs(value).toFixed(decimals);
  return value < 0 && Number(text) !== 0 ? MINUS + text : text;
}

/**
 * @param {number | null | undefined} value s
 * @param {number} [decimals]
 */
export function seconds(value, decimals = 3) {
  return value === null || value === undefined ? "–" : `${fixed(value, decimals)}${THIN}s`;
}

/** @param {number | null | undefined} value m */
export function millimetres(value) {
  return value === null || value === undefined ? "–" : `${fixed(value * 1e3, 1)}${THIN}mm`;
}

/** @param {number | null | undefined} value share */
export function percent(value, decimals = 1) {
  return value === null || value === undefined ? "–" : `${fixed(value * 100, decimals)}${THIN}%`;
}

/**
 * Returns a number with a few significant digits, as a table shows it.
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
 * Returns the unit in which a joint's quantity is shown, and its size in SI units.
 * @param {boolean} slides whether the joint slides
 * @param {Quantity} quantity
 * @returns {{name: string, perUnit: number}} perUnit: shown units per SI unit
 */
export function jointUnit(slides, quantity) {
  const per = ORDER[quantity];
  return slides
    ? { name: `mm${per}`, perUnit: 1e3 }
    : { name: per ? `°${per}` : "°", perUnit: 180 / Math.PI };
}

/**
 * Returns a joint's quantity with its unit.
 * @param {number} value SI
 * @param {boolean} slides
 * @param {Quantity} quantity
 */
export function jointValue(value, slides, quantity) {
  const unit = jointUnit(slides, quantity);
  const shown = value * unit.perUnit;
  const decimals = Math.abs(shown) < 100 ? 2 : Math.abs(shown) < 1000 ? 1 : 0;
  return `${fixed(shown, decimals)}${unit.name.startsWith("°") ? "" : THIN}${unit.name}`;
}

/** Kinds and actions as words. */
const WORDS = /** @type {Object<string, string>} */ ({
  take_tool: "take tool",
  leave_tool: "leave tool",
  seam_start: "seam start",
  seam_end: "seam end",
  path_start: "path start",
  path_end: "path end",
  end: "work is done",
});

/** @param {string} name of a kind, an action or a reason in the schedule */
export function word(name) {
  return WORDS[name] ?? name.replaceAll("_", " ");
}

/**
 * Returns what is done with a task; ids that say it already, such as "take suction", stand alone.
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
 * Returns an event in words: what is done, and the signal that is set.
 * @param {{action: string, task: string, signal?: string}} event
 */
export function eventText({ action, task, signal }) {
  return signal ? `${actionOn(action, task)} → ${signal}` : actionOn(action, task);
}

/**
 * Returns times for a ruler: multiples of 1, 2 or 5 times a power of ten.
 * @param {number} from
 * @param {number} to
 * @param {number} most how many at most
 * @returns {{times: number[], decimals: number}}
 */
export function rulerTimes(from, to, most) {
  const least = (to - from) / Math.max(most, 1);
  let power = Math.floor(Math.log10(least));
  let step = 10 ** power;
  for (const factor of [1, 2, 5, 10]) {
    step = factor * 10 ** power;
    if (step >= least * (1 - 1e-9)) break;
  }
  power = Math.floor(Math.log10(step) + 1e-9);
  const times = [];
  for (let k = Math.ceil(from / step - 1e-9); k * step <= to + step * 1e-9; k++) times.push(k * step);
  return { times, decimals: Math.max(0, -power) };
}
