// Joint motion: cubic pieces between knots, evaluated exactly as the schedule defines them.

/** @typedef {import("./types.js").Knots} Knots */
/** @typedef {"position" | "velocity" | "acceleration" | "jerk"} Quantity */

/** @type {Quantity[]} */
export const QUANTITIES = ["position", "velocity", "acceleration", "jerk"];

/**
 * Count the sorted numbers up to a value, or below it if `before`.
 * @param {ArrayLike<number>} sorted
 * @param {number} value
 * @param {boolean} [before]
 */
export function countUpTo(sorted, value, before = false) {
  let low = 0;
  let high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (before ? sorted[middle] < value : sorted[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return low;
}

/**
 * Evaluate position, velocity, acceleration and jerk of a joint at a time.
 *
 * The later one of two knots at the same time applies; before the first and after the last knot the joint is at rest.
 * @param {Knots} knots
 * @param {number} time s
 * @param {boolean} [before] evaluate just before the time, which matters at a jump
 * @returns {{position: number, velocity: number, acceleration: number, jerk: number}}
 */
export function stateAt(knots, time, before = false) {
  const last = knots.time.length - 1;
  const k = Math.min(Math.max(countUpTo(knots.time, time, before) - 1, 0), last);
  const position = knots.position[k];
  const velocity = knots.velocity[k];
  const acceleration = knots.acceleration[k];
  const dt = Math.max(time - knots.time[k], 0);
  if (k === last) {
    if (dt > 0) return { position, velocity: 0, acceleration: 0, jerk: 0 };
    return { position, velocity, acceleration, jerk: 0 };
  }
  const span = knots.time[k + 1] - knots.time[k];
  const jerk = span > 0 ? (knots.acceleration[k + 1] - acceleration) / span : 0;
  return {
    position: position + dt * (velocity + dt * (acceleration / 2 + (dt * jerk) / 6)),
    velocity: velocity + dt * (acceleration + (dt * jerk) / 2),
    acceleration: acceleration + dt * jerk,
    jerk,
  };
}

/**
 * Compute the positions of all joints at a time.
 * @param {{knots: Knots}[]} joints
 * @param {number} time s
 * @returns {Float64Array}
 */
export function positionsAt(joints, time) {
  return Float64Array.from(joints, (joint) => stateAt(joint.knots, time).position);
}

/**
 * Sample the curves of joints on an even grid, and at each knot just before and at it.
 *
 * If there are more knots than instants of the grid, the knots in a cell of the grid are reduced to those with the least
 * and the greatest value, so that peaks remain.
 * @param {{knots: Knots}[]} joints
 * @param {Quantity} quantity
 * @param {number} from s
 * @param {number} to s
 * @param {number} count instants of the grid
 * @returns {{time: Float64Array, values: Float64Array[]}} values: one row per joint
 */
export function sampleCurves(joints, quantity, from, to, count) {
  /** @type {{time: number, before: boolean}[]} */
  const instants = [];
  for (let i = 0; i < count; i++) {
    instants.push({ time: from + ((to - from) * i) / (count - 1), before: false });
  }
  for (const joint of joints) {
    for (const time of knotsToShow(joint.knots, quantity, from, to, count)) {
      instants.push({ time, before: true }, { time, before: false });
    }
  }
  instants.sort((a, b) => a.time - b.time || Number(b.before) - Number(a.before));
  const distinct = instants.filter(
    (x, i) => i === 0 || x.time !== instants[i - 1].time || x.before !== instants[i - 1].before,
  );
  return {
    time: Float64Array.from(distinct, (x) => x.time),
    values: joints.map((joint) =>
      Float64Array.from(distinct, (x) => stateAt(joint.knots, x.time, x.before)[quantity]),
    ),
  };
}

/**
 * Select knots within a time window, at most two per cell of the grid: least and greatest value.
 * @param {Knots} knots
 * @param {Quantity} quantity
 * @param {number} from
 * @param {number} to
 * @param {number} count
 * @returns {number[]}
 */
function knotsToShow(knots, quantity, from, to, count) {
  const first = countUpTo(knots.time, from, true);
  const end = countUpTo(knots.time, to);
  if (end - first <= count) return Array.from(knots.time.subarray(first, end));
  const times = [];
  const width = (to - from) / count;
  for (let k = first; k < end; ) {
    const cell = Math.floor((knots.time[k] - from) / width);
    let min = k;
    let max = k;
    const value = (/** @type {number} */ i) =>
      quantity === "jerk" ? stateAt(knots, knots.time[i]).jerk : knots[quantity][i];
    for (; k < end && Math.floor((knots.time[k] - from) / width) === cell; k++) {
      if (value(k) < value(min)) min = k;
      if (value(k) > value(max)) max = k;
    }
    times.push(knots.time[min], knots.time[max]);
  }
  return times;
}

/**
 * Find the intervals in which a joint moves.
 * @param {Knots} knots
 * @param {number} still largest speed at rest [rad/s or m/s]
 * @returns {{start: number, end: number}[]}
 */
export function movingIntervals(knots, still = 1e-7) {
  /** @type {{start: number, end: number}[]} */
  const intervals = [];
  for (let k = 0; k + 1 < knots.time.length; k++) {
    const start = knots.time[k];
    const end = knots.time[k + 1];
    if (end <= start) continue;
    const middle = Math.abs(stateAt(knots, (start + end) / 2).velocity);
    if (Math.max(Math.abs(knots.velocity[k]), Math.abs(knots.velocity[k + 1]), middle) <= still) {
      continue;
    }
    const last = intervals.at(-1);
    if (last && start - last.end < 1e-9) last.end = end;
    else intervals.push({ start, end });
  }
  return intervals;
}
