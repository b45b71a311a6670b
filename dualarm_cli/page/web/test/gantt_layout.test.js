import assert from "node:assert/strict";
import { test } from "node:test";
import { barAt, familyOf, ganttRows, segmentText, segmentsAt, visits, workText } from "../src/gantt_layout.js";
import { limitOf, stageWhy } from "../src/why.js";

const segment = (arm, kind, task, action, start, end, more = {}) => ({ arm, kind, task, action, start, end, ...more });

const SEGMENTS = [
  segment("left", "transfer", "a-1", "pick", 0, 1),
  segment("left", "approach", "a-1", "pick", 1, 2),
  segment("left", "dwell", "a-1", "pick", 2, 2.5),
  segment("left", "retract", "a-1", "pick", 2.5, 3),
  segment("left", "transfer", "a-1", "place", 3, 4),
  segment("left", "dwell", "a-1", "place", 4, 5),
  segment("left", "return", "", "", 5, 6),
  segment("right", "transfer", "b", "take_tool", 0, 2),
  segment("right", "wait", "", "", 2, 3, { reason: "partner" }),
];

const PLAN = /** @type {any} */ ({
  tcps: { left: {}, right: {} },
  segments: SEGMENTS,
  events: [
    { time: 2, arm: "left", task: "a-1", action: "pick", signal: "left_do1" },
    { time: 4, arm: "left", task: "a-1", action: "place" },
  ],
  joints: [
    {
      name: "torso", group: "platform",
      knots: {
        time: Float64Array.of(0, 1, 2), position: Float64Array.of(0, 1, 1),
        velocity: Float64Array.of(1, 0, 0), acceleration: Float64Array.of(0, 0, 0),
      },
    },
  ],
  report: { waits: [{ arm: "right", start: 2, for: { arm: "left", task: "a-1" } }] },
});

test("there is a row per arm and one for the platform", () => {
  const rows = ganttRows(PLAN);
  assert.deepEqual(rows.map((row) => row.name), ["left", "right", "platform"]);
  assert.deepEqual(rows.map((row) => row.bars.length), [7, 2, 1]);
  assert.deepEqual([rows[2].bars[0].start, rows[2].bars[0].end], [0, 1]);
});

test("a fixed or missing platform has no row", () => {
  assert.deepEqual(ganttRows({ ...PLAN, joints: [] }).map((row) => row.name), ["left", "right"]);
});

test("pick and place of one task are two visits", () => {
  const found = visits(SEGMENTS.filter((s) => s.arm === "left"));
  assert.deepEqual(found.map((v) => [v.start, v.end, v.action]), [[0, 3, "pick"], [3, 5, "place"]]);
});

test("a seam is a visit of its own between its start and its end", () => {
  const found = visits([
    segment("left", "approach", "s", "seam_start", 0, 1),
    segment("left", "seam", "s", "seam_end", 1, 2),
    segment("left", "retract", "s", "seam_end", 2, 3),
  ]);
  assert.deepEqual(found.map((v) => v.action), ["seam_start", "seam", "seam_end"]);
});

test("families distinguish the actions", () => {
  const actions = ["pick", "place", "give", "take", "seam_start", "path_end"];
  assert.equal(new Set(actions.map((action) => familyOf(action))).size, actions.length);
  assert.equal(familyOf("take_tool"), familyOf("leave_tool"));
  assert.equal(familyOf("", "seam"), "seam");
});

test("the bar at a time contains it, or is the nearest within the tolerance", () => {
  const [left] = ganttRows(PLAN);
  assert.equal(barAt(left.bars, 2.2)?.kind, "dwell");
  assert.equal(barAt(left.bars, 6.1)?.kind, undefined);
  assert.equal(barAt(left.bars, 6.1, 0.2)?.kind, "return");
});

test("a wait says what the arm waits for", () => {
  const wait = SEGMENTS[8];
  assert.match(segmentText(PLAN, wait), /^right: waits for the left arm, a-1, 2\.000–3\.000 s/);
  assert.equal(ganttRows(PLAN)[1].bars[1].label, "other arm");
  const texts = ["partner", "platform", "shared_zone", "window", "end"].map((reason) => workText(PLAN, { ...wait, start: 2.5, reason }));
  assert.deepEqual(texts, ["waits for the other arm", "waits for the platform", "waits for the other arm to leave the shared zone", "waits for the time window", "work is done"]);
});

test("of a seam, one arm holds the part and the other one follows the curve", () => {
  const plan = { ...PLAN, report: { seams: [{ task: "seam", master: "left", slave: "right" }, { task: "rim", master: null, slave: "right" }] } };
  const works = [["left", "seam"], ["right", "seam"], ["right", "rim"]].map(([arm, task]) => workText(plan, segment(arm, "seam", task, "", 0, 1)));
  assert.deepEqual(works, ["holds the part of the seam", "follows the seam", "follows seam rim"]);
});

test("the segment of each arm at a time", () => {
  assert.equal(segmentsAt(PLAN, 1.5).left?.kind, "approach");
  assert.equal(segmentsAt(PLAN, 2.5).left?.kind, "retract");
  assert.equal(segmentsAt(PLAN, 4.5).right, undefined);
});

test("a signal is shown at the dwell in which it is set", () => {
  const [left] = ganttRows(PLAN);
  assert.match(left.bars[2].text, /^left: pick a-1: dwell → left_do1, 2\.000–2\.500 s/);
  assert.equal(left.bars.filter(({ text }) => text.includes("→")).length, 1);
});

// One joint at 1/s for a second, its limit, then braking with 0.5/s² of 1/s² for two seconds.
const JOINT = {
  name: "left_s", group: "left", limits: { velocity: 1, acceleration: 1, jerk: null },
  knots: {
    time: Float64Array.of(0, 1, 1, 3), position: Float64Array.of(0, 1, 1, 2),
    velocity: Float64Array.of(1, 1, 1, 0), acceleration: Float64Array.of(0, 0, -0.5, -0.5),
  },
};

test("a motion is limited by the joint that is at a limit longest", () => {
  const plan = /** @type {any} */ ({ joints: [JOINT, { ...JOINT, name: "left_l", limits: { velocity: 2, acceleration: null, jerk: null } }], report: {} });
  assert.deepEqual(limitOf(plan, "left", 0, 3), { joint: "left_s", limit: "velocity", share: 1 / 3 });
  // At half the speed a quarter of the acceleration is left.
  assert.equal(limitOf({ ...plan, report: { speed: 0.5 } }, "left", 2, 3)?.limit, "acceleration");
  assert.equal(limitOf(plan, "right", 0, 3), null);
});

test("a bar and its stage say what decides, and the slack of the rest", () => {
  const pieces = [{ segment: 0, stage: 0, length: 1, slack: 0 }, { segment: 7, stage: 0, length: 1.5, slack: 0.25 }, { segment: 2, stage: 0, length: 0.5, slack: 0 }];
  const plan = /** @type {any} */ ({ ...PLAN, joints: [{ ...JOINT, group: "left" }], pieces, stages: [{ start: 0, end: 6, bottleneck: "left_s" }] });
  const [left, right] = ganttRows(plan);
  assert.deepEqual(left.bars.map((bar) => bar.critical ?? null), [true, null, true, null, null, null, null]);
  assert.match(String(left.bars[0].why?.()), /^decides the cycle time; limited by left_s \(1\): at a limit 100.% of the time, mostly velocity$/);
  const [slowed] = ganttRows({ ...plan, report: { stages: [{ care: "cup: speed 0.5" }] } });
  assert.equal(slowed.bars[0].why?.(), "decides the cycle time; limited by cup: speed 0.5");
  assert.match(String(left.bars[2].why?.()), /its time is in the task file$/);
  assert.match(String(right.bars[0].why?.()), /^slack 0\.250.s; 1\.500.s by itself, slowed to arrive with the platform$/);
  assert.equal(right.bars[1].why, undefined);
  assert.deepEqual(stageWhy(plan, 0).split("\n").slice(1).map((text) => text.replace(/\u202f/g, " ")), ["decided by left: transfer, dwell", "right: slack 0.250 s"]);
  assert.match(stageWhy({ ...plan, report: { mode: "free" } }, 0), /right: slack at most/);
});
