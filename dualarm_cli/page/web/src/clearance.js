// Closest pair over time, interpolated from samples of the clearance.

import { countUpTo } from "./trajectory.js";

/** @typedef {import("./types.js").Clearance} Clearance */

/**
 * Compute the closest pair at a time.
 *
 * Points are interpolated between two samples of the same pair; otherwise the nearest sample is taken.
 * @param {Clearance} clearance
 * @param {number} time s
 * @returns {{distance: number, pair: [string, string], required: number, points: number[]}}
 */
export function clearanceAt(clearance, time) {
  const last = clearance.time.length - 1;
  const i = Math.min(Math.max(countUpTo(clearance.time, time) - 1, 0), last);
  const j = Math.min(i + 1, last);
  const span = clearance.time[j] - clearance.time[i];
  let fraction = span > 0 ? Math.min(Math.max((time - clearance.time[i]) / span, 0), 1) : 0;
  if (clearance.pair[i] !== clearance.pair[j]) fraction = Math.round(fraction);
  const pair = clearance.pair[fraction < 1 ? i : j];
  const interpolate = (/** @type {number} */ a, /** @type {number} */ b) => a + fraction * (b - a);
  const points = [0, 1, 2, 3, 4, 5].map((k) =>
    interpolate(clearance.points[6 * i + k], clearance.points[6 * j + k]),
  );
  return {
    distance: interpolate(clearance.distance[i], clearance.distance[j]),
    pair: clearance.pairs[pair],
    required: clearance.required[pair],
    points,
  };
}

/**
 * Return the name of the colour of a clearance's curve and pair.
 * @param {Clearance} clearance
 */
export const clearanceColour = ({ name }) => name.replace(" ", "-");
