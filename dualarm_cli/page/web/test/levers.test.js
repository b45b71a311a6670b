// Gains of levers that are chosen together.

import assert from "node:assert/strict";
import { test } from "node:test";

import { together } from "../src/levers.js";

const lever = (/** @type {number | null} */ gain) => ({ name: "a", change: "2 to 1", estimate: 0.5, gain, status: "", reason: "" });
const known = /** @type {any} */ ({
  levers: [lever(0.6), lever(null), lever(0.2)],
  combinations: [{ levers: [0, 2], gain: 0.9 }, { levers: [1, 2], gain: null }],
  sentences: [],
});
const chosen = (/** @type {[number, number][]} */ ...stops) => new Map(stops.map(([k, share]) => [k, { share, estimate: share / 2 }]));

test("gains add up as an estimate where no plan was made with exactly these levers", () => {
  assert.deepEqual(together(known, chosen([0, 0.5])), { gain: 0.25, verified: false });
  assert.deepEqual(together(known, chosen([0, 1], [1, 0.5])), { gain: 0.75, verified: false });
  assert.deepEqual(together(known, chosen([1, 1], [2, 1])), { gain: 1, verified: false });
});

test("whole levers that were re-planned have their verified gain", () => {
  assert.deepEqual(together(known, chosen([0, 1])), { gain: 0.6, verified: true });
  assert.deepEqual(together(known, chosen([0, 1], [2, 1])), { gain: 0.9, verified: true });
});
