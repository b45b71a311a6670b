// Motion of joints: cubic pieces between knots, evaluated exactly as the schedule defines them.

/** @typedef {import("./types.js").Knots} Knots */
/** @typedef {"position" | "velocity" | "acceleration" | "jerk"} Quantity */

/** @type {Quantity[]} */
export const QUANTITIES = ["position", "velocity", "acceleration", "jerk"];

/**
 * Returns how many of the sorted numbers are at most (or, if `before`, less than) a value.
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
 * Returns position, velocity, acceleration and jerk of a joint at a time.
 *
 * Of two knots at one time the later one counts; before the first and after the last knot the joint rests there.
 * @param {Knots} knots
 * @param {number} time s
 * @param {boolean} [before] evaluate just before the time: at a jump the values that end there
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
 * Returns the positions of all joints at a time.
 * @param {{knots: Knots}[]} joints
 * @param {number} time s
 * @returns {Float64Array}
 */
export function positionsAt(joints, time) {
  return Float64Array.from(joints, (joint) => stateAt(joint.knots, time).position);
}

/**
 * Returns the times at which a curve of these joints is sampled: an even grid, and each knot twice (before and after it).
 *
 * Where there are more knots than the grid has instants, knots of one cell of the grid are reduced to
 * those with the least and the greatest value, so that peaks stay.
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
  const kept = instants.filter(
    (x, i) => i === 0 || x.time !== instants[i - 1].time || x.before !== instants[i - 1].before,
  );
  return {
    time: Float64Array.from(kept, (x) => x.time),
    values: joints.map((joint) =>
      Float64Array.from(kept, (x) => stateAt(joint.knots, x.time, x.before)[quantity]),
    ),
  };
}

/**
 * Returns the knots within a range of time, thinned to two per cell of the grid: least and greatest value.
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
  const found = [];
  const width = (to - from) / count;
  for (let k = first; k < end; ) {
    const cell = Math.floor((knots.time[k] - from) / width);
    let least = k;
    let most = k;
    const value = (/** @type {number} */ i) =>
      quantity === "jerk" ? stateAt(knots, knots.time[i]).jerk : knots[quantity][i];
    for (; k < end && Math.floor((knots.time[k] - from) / width) === cell; k++) {
      if (value(k) < value(least)) least = k;
      if (value(k) > value(most)) most = k;
    }
    found.push(knots.time[least], knots.time[most]);
  }
  return found;
}

/**
 * Returns the intervals in which a joint moves.
 * @param {Knots} knots
 * @param {number} still speeds below it are rest [rad/s or m/s]
 * @returns {{start: number, end: number}[]}
 */
export function movingIntervals(knots, still = 1e-7) {
  /** @type {{start: number, end: number}[]} */
  const found = [];
  for (let k = 0; k + 1 < knots.time.length; k++) {
    const start = knots.time[k];
    const end = knots.time[k + 1];
    if (end <= start) continue;
    const middle = Math.abs(stateAt(knots, (start + end) / 2).velocity);
    if (Math.max(Math.abs(knots.velocity[k]), Math.abs(knots.velocity[k + 1]), middle) <= still) {
      continue;
    }
    const last = found.at(-1);
    if (last && start - last.end < 1e-9) last.end = end;
    else found.push({ start, end });
  }
  return found;
}
