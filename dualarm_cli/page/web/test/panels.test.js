// What the overview says of a report.

import assert from "node:assert/strict";
import { test } from "node:test";

import { savings } from "../src/panels.js";

test("the overview says what blending and motion in dwells and on lines save", () => {
  const report = { cycle_time: 9, blending: { gain: 1, share: 0.1 }, motion_gain: 1, motion_allowed: ["dwell_motion", "line_motion"] };
  const [blending, motion] = savings(report);
  assert.match(blending, /^Blending saves 1\.000.s \(10\.0.%\) compared with stops/);
  assert.match(motion, /^Motion in dwells and on lines saves 1\.000.s \(10\.0.%\)\.$/);
  assert.match(savings({ ...report, motion_allowed: ["line_motion"] })[1], /^Motion on lines saves/);
});

test("where nothing is saved it says nothing", () => {
  assert.deepEqual(savings({ cycle_time: 9, blending: null, motion_gain: null, motion_allowed: null }), []);
  assert.deepEqual(savings({ cycle_time: 9, blending: { gain: 0, share: 0 }, motion_gain: 0, motion_allowed: ["dwell_motion"] }), []);
  assert.deepEqual(savings({ cycle_time: 9, blending: null }), []);
});
