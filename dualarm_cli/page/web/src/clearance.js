// The closest pair at a time, from the samples of the clearance.

import { countUpTo } from "./trajectory.js";

/** @typedef {import("./types.js").Clearance} Clearance */

/**
 * Returns the closest pair at a time: between two samples of one pair its points are interpolated, else the nearest sample counts.
 * @param {Clearance} clearance
 * @param {number} time s
 * @returns {{distance: number, pair: [string, string], required: number, points: number[]}}
 */
export function clearanceAt(clearance, time) {
  const last = clearance.time.length - 1;
  const i = Math.min(Math.max(countUpTo(clearance.time, time) - 1, 0), last);
  const j = Math.min(i + 1, last);
  const span = clearance.time[j] - clearance.time[i];
  let share = span > 0 ? Math.min(Math.max((time - clearance.time[i]) / span, 0), 1) : 0;
  if (clearance.pair[i] !== clearance.pair[j]) share = Math.round(share);
  const number = clearance.pair[share < 1 ? i : j];
  const mix = (/** @type {number} */ a, /** @type {number} */ b) => a + share * (b - a);
  const points = [0, 1, 2, 3, 4, 5].map((k) =>
    mix(clearance.points[6 * i + k], clearance.points[6 * j + k]),
  );
  return {
    distance: mix(clearance.distance[i], clearance.distance[j]),
    pair: clearance.pairs[number],
    required: clearance.required[number],
    points,
  };
}

/**
 * Returns the name of the colour of a clearance's curve and pair.
 * @param {Clearance} clearance
 */
export const clearanceColour = ({ name }) => name.replace(" ", "-");
