import assert from "node:assert/strict";
import { test } from "node:test";
import { compose, forwardKinematics, objectPose, product, rotate, transform, turn } from "../src/poses.js";

const near = (/** @type {number[]} */ a, /** @type {number[]} */ b, tolerance = 1e-12) =>
  a.forEach((x, i) => assert.ok(Math.abs(x - b[i]) <= tolerance, `${a} is not ${b}`));

/** @returns {import("../src/types.js").Body} */
const body = (parent, joint, xyz, axis = [0, 0, 1], slides = false) => ({
  name: `body ${joint}`, parent, joint, axis, slides, xyz, quat: [0, 0, 0, 1],
});

test("a quarter turn about z takes x to y", () => {
  near(rotate(turn([0, 0, 1], Math.PI / 2), [1, 0, 0]), [0, 1, 0]);
  near(rotate(turn([1, 0, 0], Math.PI / 2), [0, 1, 0]), [0, 0, 1]);
});

test("rotation by a unit quaternion agrees with its matrix", () => {
  const [x, y, z, w] = [0.1, -0.5, 0.7, 0.5].map((v) => v / Math.hypot(0.1, -0.5, 0.7, 0.5));
  const matrix = [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
  const v = /** @type {[number, number, number]} */ ([0.3, -2, 1.1]);
  near(rotate([x, y, z, w], v), matrix.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]));
});

test("two rotations in turn are the rotation by the product", () => {
  const p = turn([0, 1, 0], 0.7);
  const q = turn([0.6, 0, 0.8], -1.3);
  near(rotate(product(p, q), [1, 2, 3]), rotate(p, rotate(q, [1, 2, 3])));
});

test("the forward kinematics of a planar two-link arm agrees with its closed form", () => {
  const [a, b] = [0.4, 0.3];
  const bodies = [body(-1, 0, [0, 0, 1]), body(0, 1, [a, 0, 0])];
  for (const [p, q] of [[0, 0], [0.3, -1.2], [-2, 0.9], [3, 3]]) {
    const poses = forwardKinematics(bodies, [p, q]);
    const tip = transform(poses[1], [b, 0, 0]);
    near(tip, [a * Math.cos(p) + b * Math.cos(p + q), a * Math.sin(p) + b * Math.sin(p + q), 1]);
  }
});

test("a prismatic joint moves along its axis, rotated with its parent", () => {
  const bodies = [body(-1, 0, [0, 0, 0]), body(0, 1, [1, 0, 0], [0, 1, 0], true)];
  near(forwardKinematics(bodies, [Math.PI / 2, 0.5])[1].xyz, [-0.5, 1, 0]);
});

test("a fixed body stays on its parent", () => {
  const bodies = [body(-1, -1, [1, 2, 3]), body(0, -1, [0, 0, 1])];
  near(forwardKinematics(bodies, [])[1].xyz, [1, 2, 4]);
});

test("an object lies, is carried, and moves with a belt", () => {
  const quat = /** @type {[number, number, number, number]} */ ([0, 0, 0, 1]);
  /** @type {import("../src/types.js").CarriedObject} */
  const object = {
    name: "part", role: "part", solids: [],
    keyframes: [
      { time: 0, body: -1, xyz: [1, 0, 0], quat, velocity: [0, 0.5, 0] },
      { time: 2, body: 0, xyz: [0, 0, -0.1], quat, velocity: [0, 0, 0] },
      { time: 3, body: null, xyz: [0, 0, 0], quat, velocity: [0, 0, 0] },
    ],
  };
  const poses = [{ xyz: /** @type {[number, number, number]} */ ([5, 5, 5]), quat }];
  near(objectPose(object, 0, poses)?.xyz ?? [], [1, 0, 0]);
  near(objectPose(object, 1.5, poses)?.xyz ?? [], [1, 0.75, 0]);
  near(objectPose(object, 2, poses)?.xyz ?? [], [5, 5, 4.9]);
  assert.equal(objectPose(object, 3.5, poses), null);
  assert.equal(objectPose({ ...object, keyframes: [] }, 0, poses), null);
});

test("composing a pose with its inverse gives the identity", () => {
  const pose = { xyz: /** @type {[number, number, number]} */ ([1, 2, 3]), quat: turn([0, 0, 1], 0.4) };
  const back = turn([0, 0, 1], -0.4);
  const [x, y, z] = rotate(back, [-1, -2, -3]);
  const found = compose(pose, { xyz: [x, y, z], quat: back });
  near(found.xyz, [0, 0, 0]);
  near(found.quat, [0, 0, 0, 1]);
});
