// Drawings: what grippers do when, which parts a tray is drawn for, and names of joints.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Fixtures, loads } from "../src/fixtures.js";
import { jointLabel } from "../src/labels.js";
import { Machine, closedAt, grips } from "../src/machine.js";
import { Scene } from "../src/scene.js";
import { Materials, meshOf } from "../src/shapes.js";
import { compose, inverse } from "../src/poses.js";

const event = (time, action, dwell, arm = "left") => ({ time, action, dwell, arm, task: "a" });

test("fingers close when the arm picks, and open at the end of the dwell when it places", () => {
  const changes = grips([event(1, "pick", 0.2), event(3, "place", 1), event(2, "pick", 0.2, "right")], "left");
  for (const [time, closed] of [[0, 0], [1, 0], [1.1, 0.5], [1.2, 1], [3.7, 1], [3.875, 0.5], [4, 0], [9, 0]]) {
    assert.ok(Math.abs(closedAt(changes, time) - closed) < 1e-9, `at ${time} s: ${closedAt(changes, time)}`);
  }
});

test("an arm that first gives a part away has its fingers on it from the start", () => {
  const changes = grips([event(2, "give", 0.1), event(5, "take", 0.1)], "left");
  assert.deepEqual([0, 2.1, 4, 5.1].map((time) => closedAt(changes, time)).map(Math.round), [1, 0, 0, 1]);
  assert.equal(closedAt(grips([event(1, "move", 0)], "left"), 5), 0);
});

test("a pose and its inverse are the identity", () => {
  const pose = { xyz: [0.3, -0.2, 0.9], quat: [0.5, -0.5, 0.1, Math.sqrt(0.49)] };
  const { xyz, quat } = compose(inverse(pose), pose);
  for (const [found, expected] of [...xyz, ...quat].map((x, i) => [x, i === 6 ? 1 : 0])) assert.ok(Math.abs(found - expected) < 1e-12);
});

test("joints have their number in the arm, unless the maker's name ends in it", () => {
  const joints = ["torso", "left_s", "left_2", "left_12"].map((name, i) => ({ name, group: i ? "left" : "platform" }));
  assert.deepEqual(joints.map(({ name }) => jointLabel(joints, name)), ["torso", "left_s (1)", "left_2", "left_12 (3)"]);
});

const upright = (x, y, z) => ({ xyz: [x, y, z], quat: [0, 0, 0, 1] });
const lies = (x, y, z, time = 0) => ({ time, body: -1, velocity: [0, 0, 0], ...upright(x, y, z) });
const table = (top) => ({ name: "table", role: "obstacle", kind: "box", size: [2, 2, 0.04], hull: null, body: -1, ...upright(0, 0, top - 0.02) });
const cell = (more) => ({
  frames: { tray: upright(0, 0, 0.8), carton: upright(0.5, 0, 0.8), idle: upright(-0.9, 0, 0.8) },
  bodies: [upright(0, 0, 0)],
  solids: [table(0.7)],
  hulls: [],
  objects: [
    { name: "near", role: "part", solids: [], keyframes: [lies(0, 0.05, 0.8), { ...lies(0, 0, 0, 1), body: 3 }, lies(0.5, 0, 0.8, 2)] },
    { role: "part", solids: [], keyframes: [lies(0, -0.05, 0.8)] },
    { role: "part", solids: [], keyframes: [{ ...lies(0.1, 0, 0.8), velocity: [0.2, 0, 0] }] },
    { name: "far", role: "part", solids: [], keyframes: [lies(5, 5, 0.8)] },
  ],
  ...more,
});

test("parts that lie near a frame share a tray, distant ones have their own, moving ones none", () => {
  const found = loads(cell({}));
  assert.deepEqual(found.map(({ name, boxes, isFilled }) => [name, boxes.length, isFilled]), [["tray", 2, false], ["carton", 1, true], ["place of far", 1, false]]);
  const { min, max } = found[0].boxes.reduce((union, box) => union.union(box));
  // Cubes of 30 mm at ±50 mm.
  assert.deepEqual([min.y, max.y, min.z, max.z].map((x) => Math.round(1e6 * x)), [-65e3, 65e3, -15e3, 15e3]);
  const tilted = cell({ frames: { tray: { xyz: [0, 0, 0.8], quat: [Math.SQRT1_2, 0, 0, Math.SQRT1_2] } } });
  assert.deepEqual(loads(tilted).map(({ name }) => name), ["place of near", "place of far"]);
});

test("a tray is drawn above a table, not where a bin is modelled or parts lie on an obstacle", () => {
  const drawn = (solids) => {
    const names = [];
    new Fixtures(cell({ solids }), new Materials()).group.traverse(({ name }) => names.push(name.replace(/: drawn, not checked$/, "")));
    return ["tray", "stand of tray", "leg of table"].map((name) => names.includes(name));
  };
  assert.deepEqual(drawn([table(0.7)]), [true, true, true]);
  assert.deepEqual(drawn([table(0.785)]), [false, false, true]);
  const wall = { ...table(0.82), name: "wall", size: [0.2, 0.02, 0.1], xyz: [0, 0.07, 0.77] };
  assert.deepEqual(drawn([table(0.7), wall]), [false, false, true]);
});

/** What a scene's own methods use of it, without a canvas. */
const sceneOf = (plan, meshes) => ({
  plan: { joints: [], duration: 1, ...plan },
  meshes,
  traces: [],
  objects: { positions: () => [] },
  world: { updateMatrixWorld: () => meshes.forEach((mesh) => mesh.updateMatrixWorld(true)) },
  setTime: () => {},
});

test("the fitted view holds the legs of a table down to the floor, and a table of 2.5 m by 2 m", () => {
  const wide = { ...table(0.7), size: [2.5, 2, 0.04] };
  const plan = cell({ solids: [wide], bodies: [{ parent: -1, joint: -1, axis: [0, 0, 1], slides: false, ...upright(0, 0, 1) }] });
  const scene = { ...sceneOf(plan, [meshOf(wide, [], new Materials().solid("obstacle"))]), fixtures: new Fixtures(plan, new Materials()) };
  scene.fixtures.group.updateMatrixWorld(true);
  const points = Scene.prototype.outline.call(scene);
  const least = (axis) => Math.min(...points.map((point) => point[axis]));
  assert.deepEqual([least("x"), least("y"), least("z")].map((x) => Math.round(1e3 * x + 1)), [-1249, -999, 1]);
});

test("the first view is from where a wall hides no target", () => {
  const wall = (y) => ({ ...table(0.3), name: "wall", size: [4, 0.02, 2], ...upright(0, y, 1) });
  const view = (y) => Scene.prototype.leastHidden.call(sceneOf({ events: [{ xyz: [0, 0, 0.2] }] }, [meshOf(wall(y), [], new Materials().solid("obstacle"))]));
  assert.deepEqual([view(-0.5), view(0.5)].map(([x, y]) => [x > 0, Math.sign(y)]), [[true, 1], [true, -1]]);
});

/** A robot of one arm with one joint, whose link has a shape. */
const robot = (solid, visuals = []) => ({
  joints: [{ name: "left_1", group: "left" }],
  bodies: [{ name: "", parent: -1, joint: -1, axis: [0, 0, 1], slides: false, ...upright(0, 0, 0) }, { name: "left_1", parent: 0, joint: 0, axis: [0, 0, 1], slides: false, ...upright(0, 0.3, 1) }],
  tcps: { left: { body: 1, ...upright(0, 0, 0.3) } },
  flanges: { left: upright(0, 0, 0.2) },
  solids: [{ name: "base", role: "link", kind: "box", size: [0.3, 0.3, 0.5], hull: null, body: 0, arm: "", ...upright(0, 0, 0.75) }, { name: "link", role: "link", hull: null, body: 1, arm: "left", ...upright(0, 0, 0.1), ...solid }],
  visuals,
  hulls: [{ corners: new Float32Array([0, 0, 0, 0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1]), triangles: new Uint32Array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]) }],
  objects: [],
  events: [],
});

const shapes = [{ kind: "capsule", size: [0.05, 0.2] }, { kind: "sphere", size: [0.05] }, { kind: "cylinder", size: [0.05, 0.2] }, { kind: "box", size: [0.1, 0.1, 0.1] }, { kind: "mesh", size: [], hull: 0 }];
for (const solid of shapes) {
  test(`a ${solid.kind} becomes a drawing of finite size with the link's and the joint's name`, () => {
    const names = [];
    for (const { body, mesh } of new Machine(robot(solid), new Materials()).pieces) {
      mesh.traverse((part) => {
        names.push(`${body} ${part.name}`);
        const points = part.geometry?.getAttribute("position").array ?? [];
        assert.ok([...points, ...part.position.toArray(), ...part.quaternion.toArray()].every(Number.isFinite), part.name);
      });
    }
    assert.ok(names.includes("1 link: joint left_1"));
    assert.ok(names.includes("0 base"));
  });
}

test("a link with a visual mesh is drawn with it alone", () => {
  const look = { name: "link", role: "link", kind: "mesh", size: [], hull: 0, body: 1, arm: "left", ...upright(0, 0, 0) };
  const { pieces } = new Machine(robot(shapes[0], [look]), new Materials());
  const drawn = pieces.filter(({ mesh }) => mesh.name === "link: joint left_1");
  assert.equal(drawn.length, 1);
  // Four faces with three corners each.
  assert.equal(drawn[0].mesh.geometry.getAttribute("position").count, 12);
});

const BASE = { role: "link", body: 0, kind: "cylinder", size: [0.07, 0.14], hull: null, name: "base" };
/** A base in the air at 1.2 m whose arm begins 0.3 m along the base's z axis. @param {[number, number, number, number]} quat */
const mounted = (quat) => {
  const root = { ...upright(0, 0, 1.2), quat, parent: -1, joint: -1, axis: [0, 0, 1], slides: false, name: "root" };
  const joint = { ...upright(0, 0, 0.3), parent: 0, joint: 0, axis: [0, 0, 1], slides: false, name: "joint" };
  const solids = [{ ...BASE, ...upright(0, 0, 0.07) }];
  const { group } = new Fixtures(cell({ frames: {}, objects: [], solids, bodies: [root, joint] }), new Materials(() => "#888888"));
  return Object.fromEntries(group.children.flatMap((child) => [child, ...child.children]).filter(({ name }) => name).map((child) => [child.name.split(":")[0], child]));
};

test("bases stand on pedestals, hang from beams, and have nothing below them when tilted", () => {
  const half = (/** @type {number} */ angle) => /** @type {[number, number, number, number]} */ ([Math.sin(angle / 2), 0, 0, Math.cos(angle / 2)]);
  assert.deepEqual(Object.keys(mounted(half(0))).sort(), ["foot plate", "pedestal"]);
  const hanging = mounted(half(Math.PI));
  assert.deepEqual(Object.keys(hanging).sort(), ["beam above", "mount from above", "mounting plate"]);
  // The base begins at 1.2 m: all that is drawn for it is above.
  assert.ok(hanging["mount from above"].position.z > 1.2 && hanging["beam above"].position.z > hanging["mount from above"].position.z);
  for (const angle of [(5 * Math.PI) / 6, Math.PI / 2]) assert.deepEqual(Object.keys(mounted(half(angle))), ["mounting plate"]);
});

test("a base stands on the side on which its first link is, wherever the joint has its origin", () => {
  const root = { ...upright(0, 0, 0), parent: -1, joint: -1, axis: [0, 0, 1], slides: false, name: "root" };
  const joint = { ...upright(0, 0, 0), parent: 0, joint: 0, axis: [0, 0, 1], slides: false, name: "joint" };
  const solids = [{ ...BASE, ...upright(0, 0, 0.07) }, { ...BASE, body: 1, ...upright(0, 0, 0.25) }];
  const { group } = new Fixtures(cell({ frames: {}, objects: [], solids, bodies: [root, joint] }), new Materials(() => "#888888"));
  assert.deepEqual(group.children.map(({ name }) => name.split(":")[0]), ["foot plate"]);
});

test("a robot on legs of its own has no pedestal", () => {
  const root = { ...upright(0, 0, 0.8), parent: -1, joint: -1, axis: [0, 0, 1], slides: false, name: "root" };
  const leg = (/** @type {number} */ y) => ({ ...BASE, kind: "box", size: [0.1, 0.1, 0.8], ...upright(0, y, -0.4) });
  const pelvis = { ...BASE, kind: "box", size: [0.2, 0.3, 0.2], ...upright(0, 0, 0.1) };
  const drawn = (/** @type {any[]} */ solids) => new Fixtures(cell({ frames: {}, objects: [], solids, bodies: [root] }), new Materials(() => "#888888")).group.children.map(({ name }) => name.split(":")[0]);
  assert.deepEqual(drawn([pelvis]), ["pedestal", "foot plate"]);
  assert.deepEqual(drawn([pelvis, leg(0.1), leg(-0.1)]), []);
});

test("the hand of a robot gets no drawn gripper", () => {
  const tools = (/** @type {any} */ plan) => new Machine(plan, new Materials()).grippers.map(({ group }) => group.children.length);
  const plan = robot(shapes[0]);
  assert.ok(tools(plan)[0] > 0);
  assert.deepEqual(tools({ ...plan, tcps: { left: { ...plan.tcps.left, hand: true } } }), [0]);
});
