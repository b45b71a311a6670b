import assert from "node:assert/strict";
import { test } from "node:test";
import { countUpTo, movingIntervals, positionsAt, sampleCurves, stateAt } from "../src/trajectory.js";
import { toolState } from "../src/tools.js";

/** Two seconds from rest with jerk 6, then two seconds with jerk −6; by hand: q(2) = 8, v(2) = 12, a(2) = 12. */
const KNOTS = {
  time: Float64Array.of(0, 2, 4),
  position: Float64Array.of(0, 8, 8 + 12 * 2 + (12 * 4) / 2 - 8),
  velocity: Float64Array.of(0, 12, 12 + 12 * 2 - 12),
  acceleration: Float64Array.of(0, 12, 0),
};

/** Constant acceleration 2 for a second, then −2: two knots at one time are the jump. */
const JUMP = {
  time: Float64Array.of(0, 1, 1, 2),
  position: Float64Array.of(0, 1, 1, 2),
  velocity: Float64Array.of(0, 2, 2, 0),
  acceleration: Float64Array.of(2, 2, -2, -2),
};

test("a cubic piece has the values of its polynomial", () => {
  const { position, velocity, acceleration, jerk } = stateAt(KNOTS, 1);
  assert.deepEqual([position, velocity, acceleration, jerk], [1, 3, 6, 6]);
  assert.equal(stateAt(KNOTS, 3).position, 8 + 12 + 6 - 1);
  assert.equal(stateAt(KNOTS, 3).velocity, 12 + 12 - 3);
});

test("knots are reached exactly, and the motion is at rest beyond them", () => {
  for (const [i, time] of KNOTS.time.entries()) {
    assert.equal(stateAt(KNOTS, time).position, KNOTS.position[i]);
    assert.equal(stateAt(KNOTS, time).velocity, KNOTS.velocity[i]);
  }
  assert.equal(stateAt(KNOTS, 5).position, KNOTS.position[2]);
  assert.equal(stateAt(KNOTS, 5).velocity, 0);
  assert.equal(stateAt(KNOTS, -1).position, 0);
});

test("velocity, acceleration and jerk are the derivatives of position", () => {
  const h = 1e-4;
  for (const time of [0.3, 1.1, 1.9, 2.4, 3.3]) {
    const at = stateAt(KNOTS, time);
    const next = stateAt(KNOTS, time + h);
    const previous = stateAt(KNOTS, time - h);
    assert.ok(Math.abs((next.position - previous.position) / (2 * h) - at.velocity) < 1e-6);
    assert.ok(Math.abs((next.velocity - previous.velocity) / (2 * h) - at.acceleration) < 1e-6);
    assert.ok(Math.abs((next.acceleration - previous.acceleration) / (2 * h) - at.jerk) < 1e-6);
  }
});

test("the later one of two knots at the same time applies, and the earlier one just before it", () => {
  assert.equal(stateAt(JUMP, 1).acceleration, -2);
  assert.equal(stateAt(JUMP, 1, true).acceleration, 2);
  assert.equal(stateAt(JUMP, 1).jerk, 0);
  assert.equal(stateAt(JUMP, 0.5).position, 0.25);
  assert.equal(stateAt(JUMP, 1.5).position, 1 + 1 - 0.25);
});

test("counting agrees with counting one by one", () => {
  const sorted = [0, 1, 1, 2, 5];
  for (const value of [-1, 0, 0.5, 1, 1.5, 2, 5, 6]) {
    assert.equal(countUpTo(sorted, value), sorted.filter((x) => x <= value).length);
    assert.equal(countUpTo(sorted, value, true), sorted.filter((x) => x < value).length);
  }
});

test("sampled curves are ordered in time, contain both sides of a jump, and follow the motion", () => {
  const { time, values } = sampleCurves([{ knots: JUMP }, { knots: KNOTS }], "acceleration", 0, 2, 5);
  for (let i = 1; i < time.length; i++) assert.ok(time[i] >= time[i - 1]);
  const atJump = [...time].flatMap((t, i) => (t === 1 ? [values[0][i]] : []));
  assert.deepEqual(atJump, [2, -2]);
  time.forEach((t, i) => assert.ok([stateAt(KNOTS, t).acceleration, 12].includes(values[1][i])));
});

test("many knots are thinned, and peaks remain", () => {
  const count = 5000;
  const time = Float64Array.from({ length: count }, (_, i) => i * 0.001);
  const peak = 3210;
  const knots = {
    time,
    position: new Float64Array(count),
    velocity: new Float64Array(count),
    acceleration: Float64Array.from({ length: count }, (_, i) => (i === peak ? 7 : Math.sin(i))),
  };
  const sampled = sampleCurves([{ knots }], "acceleration", 0, 4.999, 100);
  assert.ok(sampled.time.length < 100 + 4 * 101 + 2, String(sampled.time.length));
  assert.equal(Math.max(...sampled.values[0]), 7);
});

test("a joint moves while its speed is not zero", () => {
  const knots = {
    time: Float64Array.of(0, 1, 2, 3, 4),
    position: Float64Array.of(0, 0, 0.5, 1, 1),
    velocity: Float64Array.of(0, 0, 1, 0, 0),
    acceleration: Float64Array.of(0, 0, 0, 0, 0),
  };
  assert.deepEqual(movingIntervals(knots), [{ start: 1, end: 3 }]);
});

test("positions are in the order of the joints", () => {
  assert.deepEqual([...positionsAt([{ knots: JUMP }, { knots: KNOTS }], 1)], [1, 1]);
});

test("the tool's speed is that of a turning joint on a sliding one", () => {
  const knots = (velocity) => ({ time: [0, 1], position: [0, velocity], velocity: [velocity, velocity], acceleration: [0, 0] });
  const body = (more) => ({ parent: -1, xyz: [0, 0, 0], quat: [0, 0, 0, 1], slides: false, ...more });
  const plan = {
    joints: [{ knots: knots(0.5) }, { knots: knots(3) }],
    bodies: [body({ joint: -1, axis: [0, 0, 1] }), body({ parent: 0, joint: 0, axis: [1, 0, 0], slides: true }), body({ parent: 1, joint: 1, axis: [0, 0, 1] })],
    tcps: { left: { body: 2, xyz: [2, 0, 0.1], quat: [0, 0, 0, 1] } },
  };
  // At the start the tool is 2 m along x: 3 rad/s move it along y by 6 m/s, the slide along x by 0.5 m/s.
  const { xyz, speed } = toolState(plan, "left", 0);
  assert.deepEqual(xyz, [2, 0, 0.1]);
  assert.ok(Math.abs(speed - Math.hypot(6, 0.5)) < 1e-12);
  const step = 1e-6;
  const [before, after] = [0.4 - step, 0.4 + step].map((time) => toolState(plan, "left", time).xyz);
  const found = Math.hypot(...after.map((value, i) => value - before[i])) / (2 * step);
  assert.ok(Math.abs(toolState(plan, "left", 0.4).speed - found) < 1e-8);
});
