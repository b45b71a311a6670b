// Texts of the overview.

import assert from "node:assert/strict";
import { test } from "node:test";

import { assumed, savings, verdict } from "../src/panels.js";

test("the overview shows the time saved by blending", () => {
  const [blending] = savings({ cycle_time: 9, blending: { gain: 1, share: 0.1 } });
  assert.match(blending, /^Blending saves 1\.000.s \(10\.0.%\) compared with stops/);
});

test("a plan whose collisions are not fully checked is not simply verified", () => {
  const open = { passed: true, caveats: ["collisions could not be fully checked: no shapes of left_tool"] };
  const { text, mark } = verdict({ verification: open });
  assert.equal(text, "verified, except that collisions could not be fully checked: no shapes of left_tool");
  assert.equal(mark, "warn");
  assert.deepEqual(verdict({ verification: { passed: true, caveats: [] } }), { text: "verified", mark: "good" });
  assert.deepEqual(verdict({ verification: { ...open, passed: false } }), { text: "verification failed", mark: "bad" });
  assert.deepEqual(verdict({ verification: null }), { text: "not verified", mark: "bad" });
});

test("without savings it shows nothing", () => {
  assert.deepEqual(savings({ cycle_time: 9, blending: { gain: 0, share: 0 } }), []);
  assert.deepEqual(savings({ cycle_time: 9, blending: null }), []);
});

test("the header has the assumptions of the report", () => {
  assert.equal(assumed({ assumed: ["limits of 2 joints", "clearance 0 mm"] }), "assumed: limits of 2 joints, clearance 0 mm");
  assert.equal(assumed({ assumed: [] }), "");
});
