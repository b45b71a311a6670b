import assert from "node:assert/strict";
import { test } from "node:test";
import { clearanceAt } from "../src/clearance.js";
import { Clock, TimeWindow, neighbour } from "../src/clock.js";
import { readPlan } from "../src/data.js";
import { linkTo, linkedTime } from "../src/playing.js";

test("the time cursor stays within the plan and notifies its listeners", () => {
  const clock = new Clock(10, false);
  let told = 0;
  clock.onChange(() => told++);
  for (const [asked, found] of [[3, 3], [-1, 0], [11, 10], [NaN, 0]]) {
    clock.setTime(asked);
    assert.equal(clock.time, found);
  }
  assert.equal(told, 4);
});

test("playback follows the speed, repeats a cycle, and stops at the end of other motions", () => {
  const cycle = new Clock(10, true);
  cycle.play();
  cycle.setSpeed(2);
  cycle.advance(1.5);
  assert.equal(cycle.time, 3);
  cycle.advance(4);
  assert.equal(cycle.time, 1);
  const once = new Clock(10, false);
  once.play();
  once.advance(12);
  assert.deepEqual([once.time, once.playing], [10, false]);
  once.play();
  assert.equal(once.time, 0);
});

test("a page that plays by itself stops at the end, of a cycle too", () => {
  const cycle = new Clock(10, true);
  cycle.playOnce();
  cycle.advance(12);
  assert.deepEqual([cycle.time, cycle.playing], [10, false]);
  cycle.play();
  cycle.advance(12);
  assert.deepEqual([cycle.time, cycle.playing], [2, true]);
});

test("a link names an instant in seconds, and nothing else", () => {
  assert.equal(linkTo(12.34567), "#t=12.346");
  assert.equal(linkedTime(linkTo(0.1 + 0.2)), 0.3);
  for (const other of ["", "#", "#t=", "#t=-1", "#t=1e9", "#t=1;x", "#overview"]) assert.equal(linkedTime(other), undefined);
});

test("zooming keeps the instant under the pointer fixed and stays within the plan", () => {
  const shown = new TimeWindow(100);
  shown.zoom(30, 0.5);
  assert.deepEqual([shown.from, shown.to], [15, 65]);
  assert.ok(Math.abs((30 - shown.from) / (shown.to - shown.from) - 0.3) < 1e-12);
  shown.show(-20, 30);
  assert.deepEqual([shown.from, shown.to], [0, 50]);
  shown.reveal(80);
  assert.ok(shown.from <= 80 && shown.to >= 80 && shown.to <= 100);
  shown.zoom(80, 100);
  assert.deepEqual([shown.from, shown.to], [0, 100]);
});

test("a step leads to the next time if there is one", () => {
  assert.equal(neighbour([0, 2, 5], 2, 1), 5);
  assert.equal(neighbour([0, 2, 5], 2, -1), 0);
  assert.equal(neighbour([0, 2, 5], 5, 1), 5);
});

test("the closest pair is interpolated between samples of one pair, and not across pairs", () => {
  const clearance = {
    name: "clearance",
    time: Float64Array.of(0, 1, 2),
    distance: Float32Array.of(0.5, 0.25, 0.125),
    pair: Uint32Array.of(0, 0, 1),
    points: Float32Array.of(0, 0, 0, 1, 0, 0, 0, 2, 0, 1, 2, 0, 9, 9, 9, 8, 8, 8),
    pairs: /** @type {[string, string][]} */ ([["a", "b"], ["c", "d"]]),
    required: [0.01, 0.02],
  };
  const middle = clearanceAt(clearance, 0.5);
  assert.deepEqual([middle.distance, middle.points, middle.pair], [0.375, [0, 1, 0, 1, 1, 0], ["a", "b"]]);
  assert.deepEqual(clearanceAt(clearance, 1.2).pair, ["a", "b"]);
  assert.deepEqual(clearanceAt(clearance, 1.8).points, [9, 9, 9, 8, 8, 8]);
  assert.equal(clearanceAt(clearance, 7).required, 0.02);
});

test("arrays are decoded, and another format is refused", () => {
  const packed = (/** @type {Float64Array} */ a) => Buffer.from(a.buffer).toString("base64");
  const knots = Float64Array.of(0, 0.1, -1e300);
  const names = ["time", "position", "velocity", "acceleration"];
  const joint = { name: "a", knots: Object.fromEntries(names.map((n) => [n, packed(knots)])) };
  const document = { format: "dualarm.page/1", title: "job", robot: "arm", joints: [joint], hulls: [], clearances: [] };
  const plan = readPlan(JSON.stringify(document));
  assert.deepEqual(plan.joints[0].knots.velocity, knots);
  assert.throws(() => readPlan(JSON.stringify({ ...document, format: "other/2" })), /other\/2/);
});
