// Texts of the overview.

import assert from "node:assert/strict";
import { test } from "node:test";

import { readPlan, unfit } from "../src/data.js";
import { assumed, limiting, savings, slowed, verdict } from "../src/panels.js";

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

test("asynchronous arms have the cost of assumed limits 10 % lower", () => {
  const report = { mode: "free", assumed_limits: ["a"], sensitivity: [], cycle_time: 9 };
  // 9 / √0.9 = 9.487.
  assert.match(slowed(report), /takes 9\.487.s \(\+5\.4.%\)/);
  for (const change of [{ mode: "paired" }, { assumed_limits: [] }, { conveyors: [{}] }]) assert.equal(slowed({ ...report, ...change }), "");
});

test("the header names the joint that decides most stages", () => {
  const joints = [{ name: "left_s", group: "left" }];
  assert.equal(limiting({ joints, report: { bottlenecks: { left_x: 1, left_s: 3 }, stages: Array(5) } }), "limited by left_s (1) in 3 of 5 stages");
  assert.equal(limiting({ joints, report: { bottlenecks: {}, stages: [] } }), "");
});

test("data that do not fit the program are named, with what to do", () => {
  const text = unfit('{"version":"0.0.9"}', new Error("joints is undefined"));
  assert.match(text, /by dualarm 0\.0\.9 .*joints is undefined.*dualarm report PLAN/);
  assert.throws(() => readPlan('{"format":"dualarm.page/0"}'), /format/);
  assert.throws(() => readPlan('{"format":"dualarm.page/1","robot":"a"}'), /title is missing/);
});
